//! `part_of`: a frame that is a part of a larger image.

use std::fmt;
use std::str::FromStr;

use super::{SettingKind, Settings};

/// Longest side of an image whose parts are drawn: single precision tells a 64th of a pixel there.
pub const MOST_WHOLE_PX: u32 = 1 << 18;

/// An image, and where a frame lies in it. As text: `WIDTH,HEIGHT,X,Y`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ImagePart {
    /// Size of the whole image in pixels.
    pub width: u32,
    pub height: u32,
    /// The frame's first column and row.
    pub x: u32,
    pub y: u32,
}

impl ImagePart {
    /// The setting's name.
    pub const NAME: &str = "part_of";
    const PATTERN: &str = "^ *[0-9]{1,6}( *, *[0-9]{1,6}){3} *$";

    pub(super) fn kind() -> SettingKind {
        SettingKind::Text {
            default: "the frame is the whole image",
            accepted: "`WIDTH,HEIGHT,X,Y`: size of the whole image, up to 262144 pixels a side, and the frame's first column and row",
            pattern: Self::PATTERN.to_owned(),
            examples: &["65536,65536,1024,2048"],
        }
    }
}

impl Settings {
    /// These settings for a part of an image.
    #[must_use]
    pub fn as_part(self, part: ImagePart) -> Settings {
        Settings { part_of: Some(part), ..self }
    }

    /// Whether the frame is a part of a larger image.
    pub fn is_part(&self) -> bool {
        self.part_of.is_some()
    }

    /// Height of the image that the frame is a part of.
    pub fn image_rows(&self) -> Option<u32> {
        self.part_of.map(|part| part.height)
    }

    /// The settings for a frame of so many times the pixels along each side.
    #[must_use]
    pub(super) fn of_part_times(self, factor: u32) -> Settings {
        let times = |side: u32| side.saturating_mul(factor);
        let part_of = self.part_of.map(|ImagePart { width, height, x, y }| ImagePart {
            width: times(width),
            height: times(height),
            x: times(x),
            y: times(y),
        });
        Settings { part_of, ..self }
    }
}

impl FromStr for ImagePart {
    type Err = String;

    fn from_str(text: &str) -> Result<ImagePart, String> {
        let words: Vec<&str> = text.split(',').map(str::trim).collect();
        let [width, height, x, y] = words[..] else {
            return Err(format!("has {} numbers instead of 4", words.len()));
        };
        let number = |word: &str, least: u32, most: u32| {
            let read =
                word.bytes().all(|c| c.is_ascii_digit()).then(|| word.parse().ok()).flatten();
            read.filter(|number| (least..=most).contains(number)).ok_or_else(|| {
                let word: String = word.chars().take(64).collect();
                format!("`{word}` is no whole number from {least} to {most}")
            })
        };
        let side = |word| number(word, 1, MOST_WHOLE_PX);
        let place = |word| number(word, 0, MOST_WHOLE_PX - 1);
        Ok(ImagePart { width: side(width)?, height: side(height)?, x: place(x)?, y: place(y)? })
    }
}

impl fmt::Display for ImagePart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ImagePart { width, height, x, y } = self;
        write!(f, "{width},{height},{x},{y}")
    }
}

crate::json::as_text!(ImagePart, ImagePart::PATTERN);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finer_frames_are_the_same_part() {
        let settings = Settings { part_of: "100,80,30,20".parse().ok(), ..Settings::default() };
        let finer = settings.finer(4, false).part_of;
        assert_eq!(finer.map(|part| part.to_string()).as_deref(), Some("400,320,120,80"));
        assert!(settings.is_part() && !Settings::default().finer(4, false).is_part());
    }

    #[test]
    fn parts_are_read_and_written() {
        let part: ImagePart = "65536, 32768,1024 ,0".parse().unwrap();
        assert_eq!(part, ImagePart { width: 65536, height: 32768, x: 1024, y: 0 });
        assert_eq!(part.to_string(), "65536,32768,1024,0");
        for (text, fault) in [
            ("1,2,3", "3 numbers"),
            ("0,5,0,0", "`0`"),
            ("262145,5,0,0", "262144"),
            ("5,5,-1,0", "`-1`"),
            ("5,5,1.5,0", "`1.5`"),
            ("5,5,+1,0", "`+1`"),
        ] {
            let refused = text.parse::<ImagePart>().unwrap_err();
            assert!(refused.contains(fault), "{text}: {refused}");
        }
    }
}
