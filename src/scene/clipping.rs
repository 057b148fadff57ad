//! Boxes that a scene is clipped with.

use std::fmt;
use std::str::FromStr;

use glam::{DAffine3, DVec3};

/// Largest number of boxes.
pub const MOST_BOXES: usize = 8;

/// Which side of a box is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Side {
    #[default]
    Inside,
    Outside,
}

/// A box along the axes of a coordinate system. A bound that is left open is infinite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClipBox {
    pub low: DVec3,
    pub high: DVec3,
    pub side: Side,
}

/// One to [`MOST_BOXES`] boxes. Shown is what lies in any of the boxes whose inside is shown, if there are such boxes, and in none of
/// those whose outside is shown. A box contains its border.
///
/// As text: `x,y,z,x,y,z`, the least and the largest corner, with `*` for an open bound and `outside:` before a box whose outside is
/// shown; `;` separates boxes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipBoxes {
    boxes: [ClipBox; MOST_BOXES],
    count: usize,
}

/// Boxes with their place in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipRegion {
    pub boxes: ClipBoxes,
    /// The boxes' coordinates, of a place in the scene.
    pub box_from_world: DAffine3,
}

impl ClipBox {
    fn contains(&self, place: DVec3) -> bool {
        place.cmpge(self.low).all() && place.cmple(self.high).all()
    }

    /// Reads the text of one box; errors do not say which box it is.
    fn parse(text: &str) -> Result<ClipBox, String> {
        let (side, bounds) = match text.split_once(':') {
            None => (Side::Inside, text),
            Some(("inside", bounds)) => (Side::Inside, bounds),
            Some(("outside", bounds)) => (Side::Outside, bounds),
            Some((word, _)) => {
                return Err(format!("`{word}:` is neither `inside:` nor `outside:`"));
            }
        };
        let words: Vec<&str> = bounds.split(',').map(str::trim).collect();
        if words.len() != 6 {
            return Err(format!("has {} numbers instead of 6", words.len()));
        }
        let mut numbers = [0.0; 6];
        for (index, (number, word)) in numbers.iter_mut().zip(words).enumerate() {
            *number = match word {
                "*" if index < 3 => f64::NEG_INFINITY,
                "*" => f64::INFINITY,
                _ => word.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(
                    || {
                        format!(
                            "`{}` is not a finite number",
                            word.chars().take(64).collect::<String>()
                        )
                    },
                )?,
            };
            // One form for both zeros.
            *number += 0.0;
        }
        let [low, high] = [0, 3].map(|first| DVec3::from_slice(&numbers[first..]));
        for axis in 0..3 {
            if low[axis] >= high[axis] {
                let name = ["x", "y", "z"][axis];
                return Err(format!(
                    "has its largest {name}, {}, not above its least, {}",
                    high[axis], low[axis]
                ));
            }
        }
        Ok(ClipBox { low, high, side })
    }
}

impl fmt::Display for ClipBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.side == Side::Outside {
            write!(f, "outside:")?;
        }
        for (index, number) in
            self.low.to_array().into_iter().chain(self.high.to_array()).enumerate()
        {
            let comma = if index > 0 { "," } else { "" };
            if number.is_finite() { write!(f, "{comma}{number}")? } else { write!(f, "{comma}*")? }
        }
        Ok(())
    }
}

impl ClipBoxes {
    /// A box without bounds, which shows everything.
    pub const EVERYTHING: ClipBoxes = {
        // Unused boxes are as in boxes that are read from text, since all are compared.
        let unused = ClipBox { low: DVec3::ZERO, high: DVec3::ZERO, side: Side::Inside };
        let mut boxes = [unused; MOST_BOXES];
        boxes[0] = ClipBox { low: DVec3::NEG_INFINITY, high: DVec3::INFINITY, side: Side::Inside };
        ClipBoxes { boxes, count: 1 }
    };

    /// A regular expression that matches every text of boxes, and possibly others.
    pub fn pattern() -> String {
        // Browsers read patterns with the flag `v`, in which a bare `-` in brackets is an error.
        let number = r"(\*|[+\-]?[0-9]*\.?[0-9]*([eE][+\-]?[0-9]+)?)";
        let clip = format!("((in|out)side:)?{number}( *, *{number}){{5}}");
        format!("^ *{clip}( *; *{clip}){{0,{}}} *$", MOST_BOXES - 1)
    }

    /// The boxes, at least one.
    pub fn boxes(&self) -> &[ClipBox] {
        &self.boxes[..self.count]
    }

    /// Whether a place in the boxes' coordinates is shown.
    pub fn show(&self, place: DVec3) -> bool {
        let of = |side| self.boxes().iter().filter(move |clip| clip.side == side);
        let is_kept =
            of(Side::Inside).next().is_none() || of(Side::Inside).any(|clip| clip.contains(place));
        is_kept && !of(Side::Outside).any(|clip| clip.contains(place))
    }
}

impl FromStr for ClipBoxes {
    type Err = String;

    fn from_str(text: &str) -> Result<ClipBoxes, String> {
        let mut boxes = [ClipBox::default(); MOST_BOXES];
        let mut count = 0;
        for (index, word) in text.split(';').enumerate() {
            let place = boxes
                .get_mut(index)
                .ok_or_else(|| format!("there are more than {MOST_BOXES} boxes"))?;
            *place = ClipBox::parse(word.trim())
                .map_err(|fault| format!("box {} {fault}", index + 1))?;
            count = index + 1;
        }
        Ok(ClipBoxes { boxes, count })
    }
}

impl fmt::Display for ClipBoxes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, clip) in self.boxes().iter().enumerate() {
            if index > 0 {
                write!(f, ";")?;
            }
            write!(f, "{clip}")?;
        }
        Ok(())
    }
}

// No bound is NaN.
impl Eq for ClipBoxes {}

impl std::hash::Hash for ClipBoxes {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        for clip in self.boxes() {
            clip.side.hash(state);
            for number in clip.low.to_array().into_iter().chain(clip.high.to_array()) {
                number.to_bits().hash(state);
            }
        }
    }
}

crate::json::as_text!(ClipBoxes, ClipBoxes::pattern());

impl ClipRegion {
    /// Whether a place in the scene is shown.
    pub fn shows(&self, world: DVec3) -> bool {
        self.boxes.show(self.box_from_world.transform_point3(world))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxes(text: &str) -> ClipBoxes {
        text.parse().unwrap()
    }

    #[test]
    fn text_goes_there_and_back() {
        for text in [
            "-1,-1,0,1,1,2.5",
            "412000.125,5653000,*,*,5653100,40",
            "0,0,0,1,1,1;outside:0.1,0,0,1e-7,1,1;outside:*,*,*,*,*,0",
        ] {
            let Ok(clip) = text.parse::<ClipBoxes>() else { continue };
            assert_eq!(boxes(&clip.to_string()), clip, "{text}");
        }
        assert_eq!(boxes("inside:-1, 2,*,1,3,*").to_string(), "-1,2,*,1,3,*");
        assert_eq!(boxes("-0,0,0,1,1,1"), boxes("0,0,0,1,1,1"));
        assert_eq!(boxes(&ClipBoxes::EVERYTHING.to_string()), ClipBoxes::EVERYTHING);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, expected) in [
            ("", "box 1 has 1 numbers instead of 6"),
            ("0,0,0,1,1,1;0,0,0,1,1", "box 2 has 5 numbers instead of 6"),
            ("0,0,0,1,inf,1", "box 1 `inf` is not a finite number"),
            ("0,0,0,1,x,1", "box 1 `x` is not a finite number"),
            ("0,2,0,1,1,1", "box 1 has its largest y, 1, not above its least, 2"),
            ("0,0,0,1,0,1", "box 1 has its largest y, 0, not above its least, 0"),
            ("beside:0,0,0,1,1,1", "box 1 `beside:` is neither `inside:` nor `outside:`"),
        ] {
            assert_eq!(text.parse::<ClipBoxes>().unwrap_err(), expected);
        }
        let many = ["0,0,0,1,1,1"; MOST_BOXES + 1].join(";");
        assert_eq!(many.parse::<ClipBoxes>().unwrap_err(), "there are more than 8 boxes");
        boxes(&["0,0,0,1,1,1"; MOST_BOXES].join(";"));
    }

    #[test]
    fn any_inside_and_no_outside() {
        let clip = boxes("0,0,0,1,1,1;2,0,0,3,1,1;outside:*,0.5,*,2.5,*,*");
        for (place, is_shown) in [
            ([0.0, 0.0, 0.0], true),
            ([1.0, 0.25, 1.0], true),
            ([1.5, 0.25, 0.5], false),
            ([0.5, 0.5, 0.5], false),
            ([2.75, 0.75, 0.5], true),
            ([2.5, 0.75, 0.5], false),
        ] {
            assert_eq!(clip.show(DVec3::from(place)), is_shown, "{place:?}");
        }
        let holes = boxes("outside:0,0,0,1,1,1");
        assert!(holes.show(DVec3::splat(5.0)) && !holes.show(DVec3::splat(0.5)));
    }
}
