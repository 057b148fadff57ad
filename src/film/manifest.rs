//! The manifest of a folder of frames: lines of JSON, the first about all frames, each other one about a single frame. Also
//! checks files against their records.
//!
//! A run appends lines, so a crash cuts off only the last one. If a frame has several lines, the last one counts. A manifest that
//! is written anew is in the order of the frames.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::shots::is_file_name;
use crate::encode::ImageFormat;
use crate::plan::Output;

/// Version of the format.
pub const VERSION: u32 = 1;

/// The first line: what all frames share. A folder is complete when it has as many records as `frames`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`VERSION`].
    pub manifest: u32,
    /// The scene's name.
    pub scene: String,
    pub fps: f64,
    /// Number of frames of the whole path.
    pub frames: u64,
    pub width: u32,
    pub height: u32,
    pub output: Output,
    pub format: ImageFormat,
}

/// A finished frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub frame: u64,
    /// Time on the path, in seconds.
    pub t: f64,
    /// Name of the file in the manifest's folder.
    pub file: String,
    pub bytes: u64,
    /// Hash of the file, in hexadecimal digits.
    pub sha256: String,
    /// Hash of everything that decides what the frame shows, in hexadecimal digits.
    pub tag: String,
}

/// Records by frame number. They are shared, because a film may have a million of them and several readers.
pub type Records = BTreeMap<u64, Arc<Record>>;

/// Parses a manifest into records by frame number.
///
/// # Errors
/// The text is not a manifest, or has another version. Damaged lines are no errors: their frames count as missing.
pub fn parse(text: &[u8]) -> Result<Records, String> {
    if text.is_empty() {
        return Ok(Records::new());
    }
    // Text after the last line end was not written completely.
    let mut lines =
        text.split_inclusive(|&byte| byte == b'\n').filter_map(|line| line.strip_suffix(b"\n"));
    let first = lines.next().ok_or("its first line has no end")?;
    let version = serde_json::from_slice::<serde_json::Value>(first)
        .ok()
        .and_then(|value| value.get("manifest")?.as_u64())
        .ok_or("its first line has no `manifest` version")?;
    if version != u64::from(VERSION) {
        return Err(format!("its version is {version}, and this program reads version {VERSION}"));
    }
    Ok(lines
        .filter_map(|line| serde_json::from_slice::<Record>(line).ok())
        .filter(|record| is_file_name(&record.file))
        .map(|record| (record.frame, Arc::new(record)))
        .collect())
}

/// Formats a manifest.
///
/// # Errors
/// A number that JSON does not have.
pub fn text<'a>(
    header: &Header,
    records: impl IntoIterator<Item = &'a Record>,
) -> serde_json::Result<Vec<u8>> {
    let mut text = serde_json::to_vec(header)?;
    text.push(b'\n');
    for record in records {
        text.extend(line(record)?);
    }
    Ok(text)
}

/// Formats one frame's line, including the line end.
///
/// # Errors
/// A number that JSON does not have.
pub fn line(record: &Record) -> serde_json::Result<Vec<u8>> {
    let mut line = serde_json::to_vec(record)?;
    line.push(b'\n');
    Ok(line)
}

/// The checksum of a file's content, as in records.
pub fn checksum(bytes: &[u8]) -> String {
    digits(&Sha256::digest(bytes))
}

/// The length and checksum of what `reader` reads.
///
/// # Errors
/// The reader's errors.
pub fn digest(mut reader: impl Read) -> io::Result<(u64, String)> {
    let (mut hasher, mut length) = (Sha256::new(), 0);
    let mut buffer = vec![0; 1 << 16];
    loop {
        match reader.read(&mut buffer) {
            Ok(0) => return Ok((length, digits(&hasher.finalize()))),
            Ok(read) => {
                hasher.update(&buffer[..read]);
                length += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

/// Reads the file of a record in `folder`; `None` if the file is missing or does not match the record.
///
/// # Errors
/// The file exists and cannot be read.
pub fn read_sound(folder: &Path, record: &Record) -> io::Result<Option<Vec<u8>>> {
    match std::fs::read(folder.join(&record.file)) {
        Ok(bytes) => {
            let is_sound = bytes.len() as u64 == record.bytes && checksum(&bytes) == record.sha256;
            Ok(is_sound.then_some(bytes))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Returns whether a text is so many hexadecimal digits, as [`digits`] writes them.
pub fn are_digits(text: &str, count: usize) -> bool {
    text.len() == count && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// Bytes as hexadecimal digits.
pub fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn header() -> Header {
        Header {
            manifest: VERSION,
            scene: "town\n".to_owned(),
            fps: 30.0,
            frames: 5,
            width: 64,
            height: 48,
            output: Output::Color,
            format: ImageFormat::Png,
        }
    }

    fn record(frame: u64, seed: u8) -> Record {
        Record {
            frame,
            t: frame as f64 / 30.0,
            file: format!("frame-{frame:05}.png"),
            bytes: 100 + u64::from(seed),
            sha256: checksum(&[seed]),
            tag: format!("{seed:032x}"),
        }
    }

    fn parsed(text: &[u8]) -> Vec<Record> {
        parse(text).unwrap().into_values().map(Arc::unwrap_or_clone).collect()
    }

    #[test]
    fn what_is_written_is_read() {
        let records = [record(0, 1), record(4, 2)];
        let mut written = text(&header(), &records).unwrap();
        written.extend(line(&record(0, 9)).unwrap());
        let read: Vec<Record> = parsed(&written);
        assert_eq!(read, [record(0, 9), record(4, 2)]);
        let first =
            serde_json::from_slice::<Header>(written.split(|&b| b == b'\n').next().unwrap());
        assert_eq!(first.unwrap(), header());
        assert_eq!(
            checksum(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        let long = vec![7; 100_000];
        assert_eq!(digest(&long[..]).unwrap(), (100_000, checksum(&long)));
    }

    #[test]
    fn what_is_no_manifest_is_refused() {
        assert!(parse(b"").unwrap().is_empty());
        for other in ["{", "{}\n", "hello\nworld\n", "{\"manifest\": 2}\n", "\n"] {
            assert!(parse(other.as_bytes()).is_err(), "{other}");
        }
    }

    #[test]
    fn files_elsewhere_are_not_believed() {
        let mut written = text(&header(), []).unwrap();
        for file in ["../frame-00000.png", "/etc/passwd", "", "frames.jsonl"] {
            written.extend(line(&Record { file: file.to_owned(), ..record(0, 1) }).unwrap());
        }
        assert!(parse(&written).unwrap().is_empty());
    }

    proptest! {
        /// Wherever a crash cuts the text, all complete lines are read.
        #[test]
        fn a_cut_costs_the_line_that_it_hits(count in 0u64..6, kept in 0.0..=1.0f64) {
            let records: Vec<Record> = (0..count).map(|frame| record(frame, frame as u8)).collect();
            let whole = text(&header(), &records).unwrap();
            let first = text(&header(), []).unwrap().len();
            let length = first + ((whole.len() - first) as f64 * kept) as usize;
            let ends = whole[first..length].iter().filter(|&&byte| byte == b'\n').count();
            prop_assert_eq!(parsed(&whole[..length]), records[..ends].to_vec());
        }

        #[test]
        fn damage_never_panics(at in 0usize..600, byte in any::<u8>()) {
            let records: Vec<Record> = (0..3).map(|frame| record(frame, frame as u8)).collect();
            let mut damaged = text(&header(), &records).unwrap();
            let at = at % damaged.len();
            damaged[at] = byte;
            let _ = parse(&damaged);
        }
    }
}
