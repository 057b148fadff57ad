//! Text: bounded lines, blank-separated tokens, numbers.

use std::io::{BufRead, Read};

use super::AssetError;

/// Longer lines are refused: no text format has them, but binary data read as text does.
const MAX_LINE_BYTES: u64 = 64 << 20;

/// UTF-8's byte order mark, which some software puts before text.
pub(crate) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Powers of ten that f64 holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// Reads lines and counts them.
pub(crate) struct Lines<'a, R> {
    reader: R,
    file: &'a str,
    line: Vec<u8>,
    /// Last byte of a line.
    end: u8,
    /// Number of the line read last, from 1.
    pub number: u64,
}

impl<'a, R: BufRead> Lines<'a, R> {
    pub fn new(reader: R, file: &'a str) -> Self {
        Self { reader, file, line: Vec::new(), end: b'\n', number: 0 }
    }

    /// Takes a carriage return alone for the end of a line, as old Macintosh software writes it, if the text begins with
    /// `first` and one that no line feed follows.
    pub fn end_at_carriage_returns_after(&mut self, first: &[u8]) -> Result<(), AssetError> {
        let begin = self.reader.fill_buf().map_err(|source| AssetError::io(self.file, source))?;
        if let Some([b'\r', next, ..]) = begin.strip_prefix(first)
            && *next != b'\n'
        {
            self.end = b'\r';
        }
        Ok(())
    }

    /// Takes carriage returns for the ends of lines if the beginning of the text has them alone.
    pub fn end_at_carriage_returns_if_alone(&mut self) -> Result<(), AssetError> {
        let begin = self.reader.fill_buf().map_err(|source| AssetError::io(self.file, source))?;
        self.end = line_end(begin);
        Ok(())
    }

    /// Reads the next line; false at the end of the file.
    pub fn advance(&mut self) -> Result<bool, AssetError> {
        self.line.clear();
        self.append()
    }

    /// Reads one more line behind what `line` holds.
    fn append(&mut self) -> Result<bool, AssetError> {
        let count = (&mut self.reader)
            .take(MAX_LINE_BYTES)
            .read_until(self.end, &mut self.line)
            .map_err(|source| AssetError::io(self.file, source))?;
        self.number += 1;
        if self.number == 1 && self.line.starts_with(BYTE_ORDER_MARK) {
            self.line.drain(..BYTE_ORDER_MARK.len());
        }
        if self.line.len() as u64 >= MAX_LINE_BYTES {
            return Err(AssetError::malformed(
                self.file,
                format!("line {}", self.number),
                "the line is too long for text",
            ));
        }
        Ok(count > 0)
    }

    /// Reads the next line that is not blank once `comment` and what follows it is cut off.
    pub fn advance_to_content(&mut self, comment: u8) -> Result<bool, AssetError> {
        while self.advance()? {
            if let Some(at) = self.line.iter().position(|&byte| byte == comment) {
                self.line.truncate(at);
            }
            if self.line.iter().any(|byte| !is_blank(*byte)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Appends the next line in place of the backslash that ends this one.
    pub fn join_continuations(&mut self) -> Result<(), AssetError> {
        while self.text().last() == Some(&b'\\') {
            let cut = self.text().len() - 1;
            self.line.truncate(cut);
            self.line.push(b' ');
            if !self.append()? {
                break;
            }
        }
        Ok(())
    }

    /// The line read last, without its end.
    pub fn text(&self) -> &[u8] {
        let mut line = self.line.as_slice();
        while let [rest @ .., b'\n' | b'\r'] = line {
            line = rest;
        }
        line
    }

    pub fn tokens(&self) -> Tokens<'_> {
        Tokens(self.text())
    }

    pub fn file(&self) -> &'a str {
        self.file
    }

    pub fn into_reader(self) -> R {
        self.reader
    }
}

/// The byte that ends the lines of a text with this beginning: a carriage return, as old Macintosh software writes it, if the
/// beginning has one and no line feed.
pub(crate) fn line_end(begin: &[u8]) -> u8 {
    // A line feed may follow the last byte.
    let has_returns = begin.split_last().is_some_and(|(_, rest)| rest.contains(&b'\r'));
    if has_returns && !begin.contains(&b'\n') { b'\r' } else { b'\n' }
}

pub(crate) fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\r' | b'\n' | 0x0b | 0x0c)
}

/// The blank-separated tokens of a text.
#[derive(Clone)]
pub(crate) struct Tokens<'a>(pub &'a [u8]);

impl<'a> Iterator for Tokens<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.0.iter().position(|byte| !is_blank(*byte))?;
        let text = &self.0[start..];
        let end = text.iter().position(|byte| is_blank(*byte)).unwrap_or(text.len());
        self.0 = &text[end..];
        Some(&text[..end])
    }
}

impl Tokens<'_> {
    /// The rest, without blanks around it.
    pub fn rest(&self) -> String {
        String::from_utf8_lossy(self.0).trim().to_owned()
    }
}

/// The number that a token spells, correctly rounded; `None` when it spells none. Infinities and
/// not-a-number in C's and Microsoft's spellings are numbers here: what they mean is the caller's.
pub(crate) fn number(token: &[u8]) -> Option<f64> {
    fast_number(token).or_else(|| slow_number(token))
}

/// Clinger's fast path: mantissa below 2⁵³ and a power of ten within ±22 give one correctly rounded
/// multiplication or division.
fn fast_number(token: &[u8]) -> Option<f64> {
    let (negative, digits) = match token {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, token),
    };
    let mut mantissa = 0u64;
    let mut count = 0u32;
    let mut scale = 0i32;
    let mut point = false;
    let mut at = 0;
    while let Some(&byte) = digits.get(at) {
        match byte {
            b'0'..=b'9' => {
                mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(byte - b'0'));
                count += 1;
                scale -= i32::from(point);
            }
            b'.' if !point => point = true,
            _ => break,
        }
        at += 1;
    }
    if count == 0 || count > 19 || mantissa > 1 << 53 {
        return None;
    }
    if let Some(b'e' | b'E') = digits.get(at) {
        let exponent = std::str::from_utf8(&digits[at + 1..]).ok()?;
        scale = scale.checked_add(exponent.parse::<i32>().ok()?)?;
    } else if at < digits.len() {
        return None;
    }
    let power = *EXACT_POWERS.get(scale.unsigned_abs() as usize)?;
    let value = mantissa as f64;
    let value = if scale < 0 { value / power } else { value * power };
    Some(if negative { -value } else { value })
}

fn slow_number(token: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(token).ok()?;
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    let upper = text.to_ascii_uppercase();
    let (negative, body) = match upper.strip_prefix('-') {
        Some(body) => (true, body),
        None => (false, upper.strip_prefix('+').unwrap_or(&upper)),
    };
    if body.starts_with("1.#INF") {
        return Some(if negative { f64::NEG_INFINITY } else { f64::INFINITY });
    }
    let unknown = body.starts_with("1.#") || body.starts_with("NAN(");
    unknown.then_some(f64::NAN)
}

/// A token for an error message, shortened and printable.
pub(crate) fn shown(token: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(token).chars().take(40).collect();
    format!("\"{}\"", text.escape_debug())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers() {
        for (text, value) in [
            ("0", 0.0),
            ("-1.5", -1.5),
            ("+2.", 2.0),
            (".5", 0.5),
            ("1e3", 1000.0),
            ("3.274081e-033", 3.274081e-33),
            ("0.28764899999999999", 0.287649),
            ("123456789012345678901234567890", 1.2345678901234568e29),
            ("1e400", f64::INFINITY),
            ("+inf", f64::INFINITY),
            ("-1.#INF", f64::NEG_INFINITY),
        ] {
            assert_eq!(number(text.as_bytes()), Some(value), "{text}");
        }
        assert!(number(b"-1.#IND").unwrap().is_nan());
        assert!(number(b"nan").unwrap().is_nan());
        for text in ["", "-", ".", "1,5", "XXX0.5", "1e", "0x10", "1.2.3", "--1", "e5"] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
        assert!(number(b"-0").unwrap().is_sign_negative());
    }

    #[test]
    fn lines_continue_and_end_anyhow() {
        let mut lines = Lines::new(&b"a \\\r\n b\r\nc\n\n# x\nd # y"[..], "f");
        assert!(lines.advance().unwrap());
        lines.join_continuations().unwrap();
        assert_eq!(lines.tokens().collect::<Vec<_>>(), [b"a", b"b"]);
        assert!(lines.advance_to_content(b'#').unwrap());
        assert_eq!(lines.text(), b"c");
        assert!(lines.advance_to_content(b'#').unwrap());
        assert_eq!(lines.tokens().collect::<Vec<_>>(), [b"d"]);
        assert!(!lines.advance().unwrap());
    }

    #[test]
    fn a_byte_order_mark_is_no_text() {
        let mut lines = Lines::new(&b"\xef\xbb\xbfv 1\n\xef\xbb\xbfv 2\n"[..], "f");
        assert!(lines.advance().unwrap());
        assert_eq!(lines.text(), b"v 1");
        assert!(lines.advance().unwrap());
        assert_eq!(lines.text(), b"\xef\xbb\xbfv 2", "only the first line");
    }

    #[test]
    fn endless_lines_are_refused() {
        let mut lines = Lines::new(std::io::BufReader::new(std::io::repeat(b'x')), "f");
        assert!(lines.advance().is_err());
    }

    proptest! {
        #[test]
        fn agrees_with_the_standard_library(value in any::<f64>(), places in 0usize..12) {
            for text in [format!("{value}"), format!("{value:e}"), format!("{value:.places$}")] {
                let expected: f64 = text.parse().unwrap();
                let found = number(text.as_bytes()).unwrap();
                prop_assert!(found.to_bits() == expected.to_bits() || expected.is_nan(), "{}", text);
            }
        }

        #[test]
        fn small_decimals_are_exact(mantissa in any::<i64>(), scale in -30i32..30) {
            let text = format!("{mantissa}e{scale}");
            prop_assert_eq!(number(text.as_bytes()), text.parse().ok());
        }
    }
}
