//! Short names, such as those of nodes and fields.

use std::fmt;
use std::str::FromStr;

/// A name of 1 to [`Name::MOST_CHARS`] characters, none of which is a control character.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Name {
    bytes: [u8; 4 * Name::MOST_CHARS],
    /// Bytes of the name.
    length: u16,
}

impl Name {
    pub const MOST_CHARS: usize = 64;

    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..usize::from(self.length)]).unwrap_or_default()
    }

    /// A regular expression of names.
    pub const PATTERN: &str = r"^[^\u0000-\u001f\u007f-\u009f]{1,64}$";
}

impl FromStr for Name {
    type Err = String;

    fn from_str(text: &str) -> Result<Name, String> {
        let is_name = (1..=Name::MOST_CHARS).contains(&text.chars().count());
        if !is_name || text.chars().any(char::is_control) {
            let most = Name::MOST_CHARS;
            return Err(format!("not a name of 1 to {most} characters without control characters"));
        }
        let mut bytes = [0; 4 * Name::MOST_CHARS];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        Ok(Name { bytes, length: text.len() as u16 })
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

crate::json::as_text!(Name, Name::PATTERN);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_and_printable() {
        for text in ["a", "Turm 7", "höhe", &"x".repeat(64), &"😀".repeat(64)] {
            assert_eq!(text.parse::<Name>().unwrap().as_str(), text);
        }
        for text in ["", "a\nb", "a\u{85}", &"x".repeat(65), &"ä".repeat(65)] {
            assert!(text.parse::<Name>().is_err(), "{text}");
        }
    }
}
