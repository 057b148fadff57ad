//! The outer shell: GLB chunks, JSON, data URIs.

use std::io::Read;

use ::gltf::json::Root;
use percent_encoding::percent_decode_str;
use serde::Deserialize;

use super::super::{AssetError, base64};
use crate::json::{self, Limits};
use crate::memory::Admission;

/// Bytes of an object of the document in memory at most.
const OBJECT_BYTES: usize = 512;
pub(super) const MAGIC: &[u8] = b"glTF";
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;

/// Longest JSON chunk that is searched for names of other files.
const SEARCHED_BYTES: u64 = 16 << 20;

/// Whether a document is a GLB whose JSON mentions no URI, so that all of its content is its own. Documents of another form, and those whose
/// JSON is long or has escapes, may name files.
pub fn names_no_files(reader: &mut dyn Read) -> bool {
    let mut head = [0; 20];
    if reader.read_exact(&mut head).is_err() || !head.starts_with(b"glTF") || head[16..] != *b"JSON"
    {
        return false;
    }
    let length = u64::from(u32::from_le_bytes([head[12], head[13], head[14], head[15]]));
    let mut json = Vec::new();
    let read = reader.take(length.min(SEARCHED_BYTES)).read_to_end(&mut json);
    let mentions = |word: &[u8]| json.windows(word.len()).any(|window| window == word);
    read.is_ok() && json.len() as u64 == length && !mentions(b"\"uri\"") && !mentions(b"\\u")
}

/// The JSON text and, of a GLB, the binary chunk.
pub(super) fn split<'a>(
    bytes: &'a [u8],
    file: &str,
) -> Result<(&'a [u8], Option<&'a [u8]>), AssetError> {
    if !bytes.starts_with(MAGIC) {
        return Ok((bytes, None));
    }
    let fail = |reason: String| AssetError::malformed(file, "GLB header", reason);
    let word =
        |at: usize| -> Option<u32> { Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?)) };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(fail("the file ends inside the header".to_owned()));
    };
    if version != 2 {
        let reason = format!("is glTF version {version}; only 2 is offered");
        return Err(AssetError::unsupported(file, reason));
    }
    if u64::from(length) > bytes.len() as u64 {
        return Err(fail(format!("declares {length} bytes, but the file has {}", bytes.len())));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12usize;
    while at < length as usize {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            return Err(fail(format!("the chunk at byte {at} has no header")));
        };
        let body = bytes.get(at + 8..).and_then(|rest| rest.get(..size as usize));
        let Some(body) = body else {
            return Err(fail(format!("the chunk at byte {at} declares {size} bytes, too many")));
        };
        match kind {
            JSON_CHUNK => json = json.or(Some(body)),
            BINARY_CHUNK => binary = binary.or(Some(body)),
            _ => {}
        }
        at += 8 + size as usize;
    }
    let json = json.ok_or_else(|| fail("there is no JSON chunk".to_owned()))?;
    Ok((json, binary))
}

/// The document. Structure only; indices are checked where they are followed.
pub(super) fn parse(json: &[u8], file: &str, admission: &Admission) -> Result<Root, AssetError> {
    // Some editors put a byte order mark before text.
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    // Strings may be buffers, whose bytes are kept as they are.
    let limits =
        Limits { nodes: u64::MAX, objects: u64::MAX, values: u64::MAX, string_bytes: u64::MAX };
    if let Ok(census) = json::count(json, &limits) {
        admission.grow(file, census.bytes(OBJECT_BYTES))?;
    }
    #[derive(Deserialize)]
    struct Probe {
        asset: Version,
    }
    #[derive(Deserialize)]
    struct Version {
        version: String,
    }
    if let Ok(probe) = serde_json::from_slice::<Probe>(json)
        && !probe.asset.version.starts_with("2.")
    {
        let reason = format!("is glTF version {}; only 2 is offered", probe.asset.version);
        return Err(AssetError::unsupported(file, reason));
    }
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let place = match error.path().to_string() {
            path if path == "." => "JSON".to_owned(),
            path => path,
        };
        AssetError::malformed(file, place, json::plain(&error.inner().to_string()))
    })
}

/// The bytes of a `data:` URI; `None` when `uri` is something else.
pub(super) fn data_uri(uri: &str) -> Option<Result<Vec<u8>, String>> {
    let (head, body) = uri.strip_prefix("data:")?.split_once(',')?;
    let is_base64 = head.ends_with(";base64");
    Some(if is_base64 {
        let bytes = base64::decode(body.as_bytes(), usize::MAX);
        bytes.ok_or_else(|| "its data URI is no base 64".to_owned())
    } else {
        Ok(percent_decode_str(body).collect())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris() {
        assert_eq!(data_uri("data:a/b;base64,SGFsbG8=").unwrap().unwrap(), b"Hallo");
        assert_eq!(data_uri("data:;base64,SGFsbG8h").unwrap().unwrap(), b"Hallo!");
        assert_eq!(data_uri("data:,a%20b%").unwrap().unwrap(), b"a b%");
        assert!(data_uri("data:;base64,*").unwrap().is_err());
        assert!(data_uri("x.bin").is_none());
        assert_eq!(data_uri("data:,%C3%A4%zz%+f%").unwrap().unwrap(), "ä%zz%+f%".as_bytes());
    }
}
