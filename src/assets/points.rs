//! Parts that point readers share: bounded text lines, and turning raw columns into attributes.
//!
//! A reader collects columns as the file has them and decides at the end what their range means,
//! because only the whole file tells 8-bit colours in 16-bit fields from true 16-bit ones.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::fault::interrupt_of;
use super::tokens::line_end;
use super::{AssetError, Progress, ReadOptions, tidy};
use crate::memory::Admission;

/// A line longer than this is no line of a text point cloud.
const MAX_LINE_BYTES: u64 = 64 << 10;

/// The error for content that is damaged or lies; `place` names element, index and property.
pub(super) fn malformed(
    name: &str,
    place: impl Into<String>,
    reason: impl Into<String>,
) -> AssetError {
    AssetError::Malformed { file: name.to_owned(), place: place.into(), reason: reason.into() }
}

pub(super) fn unsupported(name: &str, reason: impl Into<String>) -> AssetError {
    AssetError::Unsupported { file: name.to_owned(), reason: reason.into() }
}

pub(super) fn io_error(name: &str, source: std::io::Error) -> AssetError {
    if let Some(interrupt) = interrupt_of(&source) {
        return interrupt.into();
    }
    AssetError::Io { file: name.to_owned(), source }
}

/// Refuses more points than the options allow.
pub(super) fn check_count(name: &str, found: u64, options: &ReadOptions) -> Result<(), AssetError> {
    if found > options.max_vertices {
        return Err(AssetError::TooLarge {
            file: name.to_owned(),
            what: "number of points",
            found,
            limit: options.max_vertices,
        });
    }
    Ok(())
}

/// Host memory that a reader holds for a point at most, with everything that formats know of one.
pub(super) const POINT_BYTES: u64 = 64;

/// Refuses a declared number of points that the options do not allow or that there is no memory for.
pub(super) fn admit(name: &str, found: u64, options: &ReadOptions) -> Result<(), AssetError> {
    check_count(name, found, options)?;
    Ok(options.admission.grow(name, found.saturating_mul(POINT_BYTES))?)
}

/// Opens a file for streaming; reading it reports progress by bytes and ends when the load is cancelled.
pub(super) fn open(
    path: &Path,
    name: &str,
    options: &ReadOptions,
) -> Result<BufReader<ProgressReader>, AssetError> {
    let file = File::open(path).map_err(|source| io_error(name, source))?;
    let length = file.metadata().map_err(|source| io_error(name, source))?.len();
    let (progress, admission) = (options.progress.clone(), options.admission.clone());
    let reader = ProgressReader { file, read: 0, length, reported: 0, progress, admission };
    Ok(BufReader::with_capacity(1 << 18, reader))
}

/// A file that reports what fraction of it has been read, every few megabytes.
pub(super) struct ProgressReader {
    file: File,
    read: u64,
    length: u64,
    reported: u64,
    progress: Progress,
    admission: Admission,
}

impl Read for ProgressReader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.admission.check().map_err(std::io::Error::other)?;
        let count = self.file.read(buffer)?;
        self.read += count as u64;
        if self.read - self.reported >= 4 << 20 {
            self.reported = self.read;
            self.progress.report((self.read as f64 / self.length.max(1) as f64).min(1.0) as f32);
        }
        Ok(count)
    }
}

/// Lines of a text file, with their numbers, bounded in length and in sum.
pub(super) struct Lines<'a, R> {
    reader: R,
    name: &'a str,
    buffer: Vec<u8>,
    /// Last byte of a line.
    end: u8,
    number: u64,
    bytes: u64,
    max_bytes: u64,
}

impl<'a, R: BufRead> Lines<'a, R> {
    pub(super) fn new(reader: R, name: &'a str, options: &ReadOptions) -> Self {
        let max_bytes = options.max_decompressed_bytes;
        Self { reader, name, buffer: Vec::new(), end: b'\n', number: 0, bytes: 0, max_bytes }
    }

    /// Number of the line that was returned last, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// The text behind the line that was returned last.
    pub(super) fn into_inner(self) -> R {
        self.reader
    }

    /// The next line without its end and the blanks around it, `None` at the end of the file. Tabs stay, because they may
    /// separate empty columns.
    ///
    /// # Errors
    /// A line over 64 KiB, NUL bytes, more bytes than the options allow, anything unreadable.
    pub(super) fn next_line(&mut self) -> Result<Option<&str>, AssetError> {
        self.buffer.clear();
        if self.number == 0 {
            let begin = self.reader.fill_buf().map_err(|source| io_error(self.name, source))?;
            self.end = line_end(begin);
        }
        self.number += 1;
        let count = (&mut self.reader)
            .take(MAX_LINE_BYTES + 1)
            .read_until(self.end, &mut self.buffer)
            .map_err(|source| io_error(self.name, source))?;
        if count == 0 {
            return Ok(None);
        }
        self.bytes += count as u64;
        if self.bytes > self.max_bytes {
            return Err(AssetError::TooLarge {
                file: self.name.to_owned(),
                what: "number of bytes",
                found: self.bytes,
                limit: self.max_bytes,
            });
        }
        if count as u64 > MAX_LINE_BYTES {
            return Err(self.bad("is longer than 65536 bytes: not a text file of points"));
        }
        if self.number == 1 && self.buffer.starts_with(b"\xef\xbb\xbf") {
            self.buffer.drain(..3);
        }
        match std::str::from_utf8(&self.buffer) {
            Ok(line) if !line.contains('\0') => {
                Ok(Some(line.trim_matches(|letter: char| letter.is_whitespace() && letter != '\t')))
            }
            _ => Err(malformed(
                self.name,
                format!("line {}", self.number),
                "is not text (neither ASCII nor UTF-8)",
            )),
        }
    }

    fn bad(&self, reason: &str) -> AssetError {
        malformed(self.name, format!("line {}", self.number), reason)
    }
}

/// A token as the start of an error may quote it.
pub(super) fn quote(token: &str) -> String {
    let mut short: String = token.chars().take(24).collect();
    if short.len() < token.len() {
        short.push('…');
    }
    format!("\"{short}\"")
}

/// How the numbers of colour channels map to 0..=255.
#[derive(Clone, Copy, Debug, PartialEq)]
enum ColorRange {
    /// 0..=1.
    Unit,
    /// 0..=255.
    Byte,
    /// 8-bit values in the high byte of 16-bit fields.
    HighByte,
    /// 0..=65535.
    Word,
}

impl ColorRange {
    /// The range that explains every channel value of a file.
    fn of(values: impl Iterator<Item = f32>) -> Self {
        let (mut max, mut whole, mut high_bytes) = (0.0f32, true, true);
        for value in values.filter(|value| value.is_finite()) {
            max = max.max(value);
            whole &= value.fract() == 0.0;
            high_bytes &= value % 256.0 == 0.0;
        }
        match max {
            _ if max <= 1.0 || (!whole && max <= tidy::MOST_OF_UNIT) => Self::Unit,
            _ if max <= 255.0 => Self::Byte,
            _ if whole && high_bytes => Self::HighByte,
            _ => Self::Word,
        }
    }

    fn byte(self, value: f32) -> u8 {
        // Casts saturate, and take NaN to 0.
        match self {
            Self::Unit => (value * 255.0).round() as u8,
            Self::Byte => value.round() as u8,
            Self::HighByte => (value / 256.0) as u8,
            Self::Word => (value / 257.0).round() as u8,
        }
    }
}

/// Colours of `count` points from channels in whatever range the file uses; `None` when all are zero or unknown, which means
/// that the fields were never filled.
pub(super) fn colors(count: usize, rgb: impl Fn(usize) -> [f32; 3]) -> Option<Vec<[u8; 4]>> {
    (0..count)
        .flat_map(&rgb)
        .any(|value| value.is_finite() && value != 0.0)
        .then(|| bytes(count, rgb))
}

/// Channels in whatever range the file uses as bytes, with full alpha.
pub(super) fn bytes(count: usize, rgb: impl Fn(usize) -> [f32; 3]) -> Vec<[u8; 4]> {
    let range = ColorRange::of((0..count).flat_map(&rgb));
    (0..count)
        .map(|point| {
            let [r, g, b] = rgb(point).map(|channel| range.byte(channel));
            [r, g, b, 255]
        })
        .collect()
}

/// Largest value and used bits of all 16-bit integer colours (LAS) of a file.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WordColors {
    max: u16,
    bits: u16,
}

impl WordColors {
    pub(super) fn add(&mut self, words: &[[u16; 3]]) {
        for &word in words.as_flattened() {
            self.max = self.max.max(word);
            self.bits |= word;
        }
    }

    /// How they are to be read, or `None` when all are zero, which means no colour. A maximum of 1 in integer fields is taken for
    /// black, not for full intensity.
    fn range(self) -> Option<ColorRange> {
        match self.max {
            0 => None,
            1..=255 => Some(ColorRange::Byte),
            _ if self.bits & 0xff == 0 => Some(ColorRange::HighByte),
            _ => Some(ColorRange::Word),
        }
    }

    /// An alpha that stands beside the colours, in their range.
    pub(super) fn alpha(self, word: u16) -> u8 {
        match self.range() {
            Some(ColorRange::Byte) => word.min(255) as u8,
            Some(ColorRange::HighByte) => (word >> 8) as u8,
            _ => ColorRange::Word.byte(f32::from(word)),
        }
    }

    /// Some of the file's colours.
    pub(super) fn colors(self, words: &[[u16; 3]]) -> Option<Vec<[u8; 4]>> {
        let range = self.range()?;
        let bytes: Vec<u8> =
            (0..=self.max).into_par_iter().map(|word| range.byte(f32::from(word))).collect();
        let color = |rgb: &[u16; 3]| {
            let [r, g, b] = rgb.map(|word| bytes.get(usize::from(word)).copied().unwrap_or(255));
            [r, g, b, 255]
        };
        Some(words.par_iter().map(color).collect())
    }
}

/// Unit length, or zero for what has no direction.
pub(super) fn unit_or_zero(normal: [f32; 3]) -> Vec3 {
    let direction = DVec3::from(normal.map(f64::from));
    let length = direction.length();
    if length > 0.0 && length.is_finite() { (direction / length).as_vec3() } else { Vec3::ZERO }
}

/// "3 points skipped: no finite position".
pub(super) fn skipped_warning(count: u64, why: &str) -> Option<String> {
    match count {
        0 => None,
        1 => Some(format!("1 point skipped: {why}")),
        n => Some(format!("{n} points skipped: {why}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colors_from_words(words: &[[u16; 3]]) -> Option<Vec<[u8; 4]>> {
        let mut all = WordColors::default();
        all.add(words);
        all.colors(words)
    }

    #[test]
    fn color_ranges_are_recognised() {
        let one = |rgb: [f32; 3]| colors(1, |_| rgb).unwrap()[0];
        assert_eq!(colors(2, |_| [0.0, f32::NAN, 0.0]), None);
        assert_eq!(one([0.0, 0.5, 1.0]), [0, 128, 255, 255]);
        assert_eq!(one([0.5, 1.0, 1.000_000_1]), [128, 255, 255, 255]);
        assert_eq!(one([0.0, 1.0, 2.0]), [0, 1, 2, 255]);
        assert_eq!(one([0.0, 128.0, 255.0]), [0, 128, 255, 255]);
        assert_eq!(one([0.0, 32768.0, 65280.0]), [0, 128, 255, 255]);
        assert_eq!(one([0.0, 32896.0, 65535.0]), [0, 128, 255, 255]);
        assert_eq!(colors_from_words(&[[0; 3]]), None);
        assert_eq!(colors_from_words(&[[1, 0, 236]]), Some(vec![[1, 0, 236, 255]]));
        assert_eq!(colors_from_words(&[[256, 0, 65280]]), Some(vec![[1, 0, 255, 255]]));
        assert_eq!(colors_from_words(&[[257, 0, 65535]]), Some(vec![[1, 0, 255, 255]]));
    }

    #[test]
    fn lines_are_bounded() {
        let options = ReadOptions::default();
        let text = "\u{feff}a b\t \r\n\nlast";
        let mut lines = Lines::new(text.as_bytes(), "t", &options);
        assert_eq!(lines.next_line().unwrap(), Some("a b\t"));
        assert_eq!(lines.next_line().unwrap(), Some(""));
        assert_eq!(lines.next_line().unwrap(), Some("last"));
        assert_eq!(lines.number(), 3);
        assert_eq!(lines.next_line().unwrap(), None);
        let mut lines = Lines::new("a b\r\rlast".as_bytes(), "t", &options);
        for line in [Some("a b"), Some(""), Some("last"), None] {
            assert_eq!(lines.next_line().unwrap(), line, "ends with carriage returns alone");
        }
        let long = "x".repeat(70_000);
        let error = Lines::new(long.as_bytes(), "t", &options).next_line().unwrap_err();
        assert!(error.to_string().starts_with("t: line 1: "), "{error}");
        let few = ReadOptions { max_decompressed_bytes: 3, ..ReadOptions::default() };
        assert!(Lines::new("abcd\n".as_bytes(), "t", &few).next_line().is_err());
    }
}
