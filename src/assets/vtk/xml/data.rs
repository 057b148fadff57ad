//! The bytes and numbers of an array.

use std::borrow::Cow;
use std::io::Read;

use flate2::read::ZlibDecoder;
use roxmltree::Node;

use super::super::super::base64;
use super::super::super::input::Origin;
use super::super::super::tokens::{Tokens, number, shown};
use super::super::super::{AssetError, ReadOptions};
use super::super::values::Kind;

/// Deflate cannot expand a byte to more than this.
const DEFLATE_RATIO: u64 = 1032;
/// A text of no more bytes is judged by itself.
const SMALL: u64 = 64 << 10;
const ZLIB: &str = "vtkZLibDataCompressor";

/// The appended data: all bytes behind the underscore, and their encoding.
#[derive(Clone, Copy, Debug)]
pub(super) struct Appended<'a> {
    bytes: &'a [u8],
    is_raw: bool,
}

fn find(bytes: &[u8], needle: &[u8]) -> Option<usize> {
    bytes.windows(needle.len()).position(|window| window == needle)
}

/// Cuts the appended data out of the document; otherwise a reason why not.
pub(super) fn split(bytes: &[u8]) -> Result<(Cow<'_, [u8]>, Option<Appended<'_>>), String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let Some(begin) = find(bytes, b"<AppendedData") else {
        return Ok((Cow::Borrowed(bytes), None));
    };
    let rest = &bytes[begin..];
    let tag_end = find(rest, b">").ok_or("the element AppendedData does not end")?;
    let tag = &rest[..tag_end];
    let is_raw = match find(tag, b"encoding").map(|at| &tag[at..]) {
        Some(value) if find(value, b"base64").is_some() => false,
        Some(value) if find(value, b"raw").is_some() => true,
        _ => return Err("the encoding of AppendedData is neither raw nor base64".to_owned()),
    };
    let data = rest[tag_end + 1..].trim_ascii_start();
    let data = data.strip_prefix(b"_").ok_or("the appended data do not begin with _")?;
    let mut text = bytes[..begin].to_vec();
    text.extend_from_slice(b"</VTKFile>");
    Ok((Cow::Owned(text), Some(Appended { bytes: data, is_raw })))
}

/// How the file stores numbers.
pub(super) struct Decoder<'a> {
    origin: &'a Origin,
    is_big: bool,
    /// Bytes of each number of a header, 4 or 8.
    header: usize,
    is_compressed: bool,
    appended: Option<Appended<'a>>,
    max_bytes: u64,
}

impl<'a> Decoder<'a> {
    pub fn new(
        root: &Node,
        appended: Option<Appended<'a>>,
        origin: &'a Origin,
        options: &ReadOptions,
    ) -> Result<Decoder<'a>, AssetError> {
        let file = origin.name.as_str();
        let fail = |name: &str, value: &str, accepted: &str| {
            let reason =
                format!("{name} {} is unknown; accepted are {accepted}", shown(value.as_bytes()));
            AssetError::unsupported(file, reason)
        };
        if !root.has_tag_name("VTKFile") {
            let reason =
                format!("the outermost element is {}, not VTKFile", root.tag_name().name());
            return Err(AssetError::malformed(file, "XML", reason));
        }
        let attribute = |name: &str| root.attribute(name).unwrap_or_default();
        let is_big = match attribute("byte_order") {
            "LittleEndian" | "" => false,
            "BigEndian" => true,
            other => return Err(fail("byte_order", other, "LittleEndian and BigEndian")),
        };
        let header = match attribute("header_type") {
            "UInt32" | "" => 4,
            "UInt64" => 8,
            other => return Err(fail("header_type", other, "UInt32 and UInt64")),
        };
        let is_compressed = match attribute("compressor") {
            "" => false,
            ZLIB => true,
            other => return Err(fail("compressor", other, &format!("none and {ZLIB}"))),
        };
        let max_bytes = options.max_decompressed_bytes;
        Ok(Decoder { origin, is_big, header, is_compressed, appended, max_bytes })
    }

    fn fail(&self, place: &str, reason: impl Into<String>) -> AssetError {
        AssetError::malformed(&self.origin.name, place, reason)
    }

    /// Calls `visit` with the numbers of an array.
    pub fn numbers(
        &self,
        place: &str,
        node: &Node,
        visit: &mut dyn FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        let name = node.attribute("type").unwrap_or_default();
        let kind = Kind::of_xml(name).ok_or_else(|| {
            let reason = format!("type {} holds no numbers", shown(name.as_bytes()));
            self.fail(place, reason)
        })?;
        let text = || node.text().unwrap_or_default().as_bytes();
        let stream = match node.attribute("format").unwrap_or("ascii") {
            "ascii" => return self.ascii(place, text(), visit),
            "binary" => Stream { bytes: text().trim_ascii(), is_raw: false },
            "appended" => {
                let offset = node.attribute("offset").and_then(|at| at.trim().parse().ok());
                let offset: usize = offset
                    .ok_or_else(|| self.fail(place, "has no offset into the appended data"))?;
                let missing = || self.fail(place, "refers to appended data, which the file lacks");
                let Appended { bytes, is_raw } = self.appended.ok_or_else(missing)?;
                let bytes = bytes.get(offset..).ok_or_else(|| {
                    let length = bytes.len();
                    let reason = format!("offset {offset} lies behind the {length} appended bytes");
                    self.fail(place, reason)
                })?;
                Stream { bytes, is_raw }
            }
            other => {
                let shown = shown(other.as_bytes());
                let reason =
                    format!("format {shown} is unknown; accepted are ascii, binary and appended");
                return Err(self.fail(place, reason));
            }
        };
        let size = kind.bytes() as u64;
        if self.is_compressed {
            self.compressed(place, &stream, kind, visit)
        } else {
            let length = self.header(place, &stream, 1)?[0];
            self.check_length(place, length, size)?;
            let bytes = self.take(place, &stream, self.header as u64 + length)?;
            self.decode(&bytes[self.header..], kind, visit)
        }
    }

    fn check_length(&self, place: &str, length: u64, size: u64) -> Result<(), AssetError> {
        if length.is_multiple_of(size) {
            return Ok(());
        }
        Err(self.fail(place, format!("{length} bytes are no whole number of items of {size}")))
    }

    fn ascii(
        &self,
        place: &str,
        text: &[u8],
        visit: &mut dyn FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        for (index, token) in Tokens(text).enumerate() {
            let value = number(token).ok_or_else(|| {
                let reason = format!("{} is not a number", shown(token));
                self.fail(&format!("{place}, number {index}"), reason)
            })?;
            visit(value)?;
        }
        Ok(())
    }

    fn decode(
        &self,
        bytes: &[u8],
        kind: Kind,
        visit: &mut dyn FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        for item in bytes.chunks_exact(kind.bytes()) {
            visit(kind.decode(item, self.is_big))?;
        }
        Ok(())
    }

    /// The first numbers of a header.
    fn header(&self, place: &str, stream: &Stream, count: usize) -> Result<Vec<u64>, AssetError> {
        let bytes = self.take(place, stream, (self.header * count) as u64)?;
        let kind = if self.header == 4 { Kind::U32 } else { Kind::U64 };
        let numbers = bytes.chunks_exact(self.header);
        Ok(numbers.map(|bytes| kind.decode(bytes, self.is_big) as u64).collect())
    }

    /// The first bytes of a stream, all of which must be there.
    fn take<'s>(
        &self,
        place: &str,
        stream: &Stream<'s>,
        most: u64,
    ) -> Result<Cow<'s, [u8]>, AssetError> {
        let ended = |found: usize| {
            let reason =
                format!("needs {most} bytes, but {found} follow: the file is truncated or lies");
            self.fail(place, reason)
        };
        let wish = usize::try_from(most).unwrap_or(usize::MAX);
        if stream.is_raw {
            let bytes = stream.bytes.get(..wish).ok_or_else(|| ended(stream.bytes.len()))?;
            return Ok(Cow::Borrowed(bytes));
        }
        if most > stream.bytes.len() as u64 {
            return Err(ended(stream.bytes.len() / 4 * 3));
        }
        // Line breaks aside, four characters are three bytes, and headers may be padded.
        if most > SMALL {
            self.origin.admission.grow(&self.origin.name, most + 3)?;
        }
        let end = stream.bytes.iter().take(2 * wish + 64).position(|byte| *byte == b'<');
        let text = &stream.bytes[..end.unwrap_or(stream.bytes.len())];
        let bytes = base64::decode(text, wish)
            .ok_or_else(|| self.fail(place, "its data are no base 64"))?;
        if bytes.len() < wish { Err(ended(bytes.len())) } else { Ok(Cow::Owned(bytes)) }
    }

    /// Blocks of zlib: their number, their size, that of the last if it is another, the compressed size of each, and they.
    fn compressed(
        &self,
        place: &str,
        stream: &Stream,
        kind: Kind,
        visit: &mut dyn FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        let blocks = self.header(place, stream, 1)?[0];
        let most = stream.bytes.len() / self.header;
        let blocks = usize::try_from(blocks).ok().filter(|blocks| *blocks <= most);
        let blocks =
            blocks.ok_or_else(|| self.fail(place, "declares more blocks than the file holds"))?;
        if blocks == 0 {
            return Ok(());
        }
        let header = self.header(place, stream, 3 + blocks)?;
        let (size, last) = (header[1], if header[2] == 0 { header[1] } else { header[2] });
        let sizes = &header[3..];
        let packed = sizes.iter().fold(0u64, |sum, size| sum.saturating_add(*size));
        let begin = (self.header * header.len()) as u64;
        let unpacked = size.saturating_mul(blocks as u64 - 1).saturating_add(last);
        if unpacked > packed.saturating_mul(DEFLATE_RATIO) {
            let reason =
                format!("{packed} bytes of zlib cannot hold the {unpacked} that they declare");
            return Err(self.fail(place, reason));
        }
        AssetError::check_limit(&self.origin.name, "decompressed bytes", unpacked, self.max_bytes)?;
        self.check_length(place, unpacked, kind.bytes() as u64)?;
        let bytes = self.take(place, stream, begin.saturating_add(packed))?;
        let mut rest = &bytes[begin as usize..];
        if unpacked > SMALL {
            self.origin.admission.grow(&self.origin.name, unpacked)?;
        }
        let mut all = Vec::with_capacity(unpacked as usize);
        for (block, &packed) in sizes.iter().enumerate() {
            self.origin.admission.check()?;
            let expected = if block + 1 == blocks { last } else { size };
            let (own, others) = rest.split_at(packed as usize);
            rest = others;
            let before = all.len() as u64;
            let read = ZlibDecoder::new(own).take(expected + 1).read_to_end(&mut all);
            let is_whole = read.is_ok() && all.len() as u64 - before == expected;
            if !is_whole {
                let found = all.len() as u64 - before;
                let reason = match read {
                    Err(error) => error.to_string(),
                    Ok(_) => format!("holds {found} or more bytes instead of {expected}"),
                };
                return Err(self.fail(place, format!("block {block} of zlib: {reason}")));
            }
        }
        self.decode(&all, kind, visit)
    }
}

/// Where an array's bytes begin.
struct Stream<'a> {
    bytes: &'a [u8],
    is_raw: bool,
}
