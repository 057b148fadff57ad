//! Words, lines and numbers of a file that is text with binary parts in it.

use std::io::{BufRead, Read};

use super::super::super::AssetError;
use super::super::super::tokens::{is_blank, number, shown};
use super::super::values::Kind;

/// Longer words and lines are refused: binary data read as text have them.
const MAX_TEXT_BYTES: usize = 64 << 10;
/// Bytes of numbers that are decoded at a time.
const BLOCK_BYTES: usize = 64 << 10;

pub(super) struct Scanner<'a, R> {
    reader: R,
    file: &'a str,
    pub is_binary: bool,
    /// Number of the current line, from 1.
    line: u64,
    word: Vec<u8>,
    block: Vec<u8>,
}

impl<'a, R: BufRead> Scanner<'a, R> {
    pub fn new(reader: R, file: &'a str) -> Self {
        Self { reader, file, is_binary: false, line: 1, word: Vec::new(), block: Vec::new() }
    }

    /// An error at the current line; binary files have none that could be counted.
    pub fn fail(&self, place: &str, reason: impl Into<String>) -> AssetError {
        let place = match self.is_binary {
            true => place.to_owned(),
            false => format!("{place} (line {})", self.line),
        };
        AssetError::malformed(self.file, place, reason)
    }

    /// The next line, without its end.
    pub fn line(&mut self) -> Result<String, AssetError> {
        self.word.clear();
        (&mut self.reader)
            .take(MAX_TEXT_BYTES as u64)
            .read_until(b'\n', &mut self.word)
            .map_err(|source| AssetError::io(self.file, source))?;
        let text = String::from_utf8_lossy(&self.word).trim_end().to_owned();
        if self.word.last() != Some(&b'\n') {
            let reason = match self.word.len() {
                MAX_TEXT_BYTES => "the line is too long for text",
                _ => "the file ends here",
            };
            return Err(self.fail("header", reason));
        }
        self.line += 1;
        Ok(text)
    }

    /// The next word; `None` at the end of the file.
    pub fn token(&mut self) -> Result<Option<String>, AssetError> {
        let found = self.next_word()?;
        Ok(found.then(|| String::from_utf8_lossy(&self.word).into_owned()))
    }

    /// Reads a word into `word`, but not the blank behind it; false at the end of the file.
    fn next_word(&mut self) -> Result<bool, AssetError> {
        self.word.clear();
        loop {
            let bytes =
                self.reader.fill_buf().map_err(|source| AssetError::io(self.file, source))?;
            if bytes.is_empty() {
                return Ok(!self.word.is_empty());
            }
            let mut used = 0;
            if self.word.is_empty() {
                used = bytes.iter().position(|byte| !is_blank(*byte)).unwrap_or(bytes.len());
                self.line += bytes[..used].iter().filter(|byte| **byte == b'\n').count() as u64;
            }
            let rest = &bytes[used..];
            let end = rest.iter().position(|byte| is_blank(*byte));
            self.word.extend_from_slice(&rest[..end.unwrap_or(rest.len())]);
            used += end.unwrap_or(rest.len());
            self.reader.consume(used);
            if self.word.len() > MAX_TEXT_BYTES {
                return Err(self.fail("section", "the word is too long for text"));
            }
            if end.is_some() && !self.word.is_empty() {
                return Ok(true);
            }
        }
    }

    /// Steps over lines up to a blank one, which ends the description of an array.
    pub fn skip_to_blank_line(&mut self) -> Result<(), AssetError> {
        // The rest of the line with the keyword.
        self.rest_of_line()?;
        while self.rest_of_line()? {}
        Ok(())
    }

    /// Reads the rest of a line; false if it is blank, or at the end of the file.
    fn rest_of_line(&mut self) -> Result<bool, AssetError> {
        self.word.clear();
        (&mut self.reader)
            .take(MAX_TEXT_BYTES as u64)
            .read_until(b'\n', &mut self.word)
            .map_err(|source| AssetError::io(self.file, source))?;
        if self.word.len() == MAX_TEXT_BYTES {
            return Err(self.fail("section", "the line is too long for text"));
        }
        self.line += 1;
        Ok(self.word.iter().any(|byte| !is_blank(*byte)))
    }

    /// Calls `visit` with `count` numbers.
    pub fn numbers(
        &mut self,
        place: &str,
        count: u64,
        kind: Kind,
        mut visit: impl FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        if self.is_binary {
            return self.binary(place, count, kind, visit);
        }
        for index in 0..count {
            if !self.next_word()? {
                let reason = format!("the file ends after {index} of {count} numbers");
                return Err(self.fail(place, reason));
            }
            let Some(number) = number(&self.word) else {
                let reason = format!("{} is not a number", shown(&self.word));
                return Err(self.fail(&format!("{place}, number {index}"), reason));
            };
            visit(number)?;
        }
        Ok(())
    }

    fn binary(
        &mut self,
        place: &str,
        count: u64,
        kind: Kind,
        mut visit: impl FnMut(f64) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        // The line with the keyword ends before the numbers.
        if self.rest_of_line()? {
            let reason = format!("{} stands before the numbers", shown(&self.word));
            return Err(self.fail(place, reason));
        }
        let is_bits = kind == Kind::Bit;
        let bytes = if is_bits { count.div_ceil(8) } else { count * kind.bytes() as u64 };
        let (mut left, mut index) = (bytes, 0);
        let mut block = std::mem::take(&mut self.block);
        while left > 0 {
            let wish = left.min(BLOCK_BYTES as u64);
            block.clear();
            let got = (&mut self.reader).take(wish).read_to_end(&mut block);
            let got = got.map_err(|source| AssetError::io(self.file, source))? as u64;
            for bytes in block.chunks_exact(kind.bytes()) {
                if !is_bits {
                    visit(kind.decode(bytes, true))?;
                    index += 1;
                    continue;
                }
                for bit in (0..8).rev() {
                    if index < count {
                        visit(f64::from(bytes[0] >> bit & 1))?;
                        index += 1;
                    }
                }
            }
            if got < wish {
                let reason = format!("the file ends after {index} of {count} numbers");
                return Err(self.fail(place, reason));
            }
            left -= got;
        }
        self.block = block;
        Ok(())
    }

    /// Steps over strings: lines in text; in binary a length, in a few bytes of which the first two bits tell how many, and as
    /// many bytes.
    pub fn skip_strings(&mut self, place: &str, count: u64) -> Result<(), AssetError> {
        self.rest_of_line()?;
        for index in 0..count {
            let ended = format!("the file ends after {index} of {count} strings");
            if !self.is_binary {
                self.rest_of_line()?;
                if self.word.is_empty() {
                    return Err(self.fail(place, ended));
                }
                continue;
            }
            let mut first = [0];
            let io = |file: &str, error: std::io::Error| match error.kind() {
                std::io::ErrorKind::UnexpectedEof => AssetError::malformed(file, place, &ended),
                _ => AssetError::io(file, error),
            };
            self.reader.read_exact(&mut first).map_err(|error| io(self.file, error))?;
            let more = match first[0] >> 6 {
                3 => 0,
                2 => 1,
                1 => 3,
                _ => 7,
            };
            let mut length = u64::from(first[0] & 0x3f);
            for _ in 0..more {
                let mut next = [0];
                self.reader.read_exact(&mut next).map_err(|error| io(self.file, error))?;
                length = length << 8 | u64::from(next[0]);
            }
            let skipped = std::io::copy(&mut (&mut self.reader).take(length), &mut std::io::sink());
            if skipped.map_err(|source| AssetError::io(self.file, source))? < length {
                return Err(self.fail(place, ended));
            }
        }
        Ok(())
    }
}
