//! Directions that are up, by the name of an axis or as a vector.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use schemars::JsonSchema;
use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};
use utoipa::ToSchema;

use super::wire::three;

/// Which way is up: `x`, `y`, `z`, `-x`, `-y`, `-z`, or a vector. JSON has a string or three numbers.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema)]
#[schemars(with = "UpForm")]
pub struct Up(pub DVec3);

/// Ways to write an [`Up`], for schemas.
#[derive(JsonSchema, ToSchema)]
#[serde(untagged)]
#[schema(as = Up)]
#[allow(dead_code, reason = "schemas are derived from it; values are read by `Up`")]
pub enum UpForm {
    /// An axis by name.
    Axis(Axis),
    /// A vector of any length but zero.
    Vector([f64; 3]),
}

/// Names of the axes.
#[derive(JsonSchema, ToSchema)]
#[allow(dead_code, reason = "schemas are derived from it; values are read by `Up`")]
pub enum Axis {
    #[serde(rename = "x")]
    X,
    #[serde(rename = "y")]
    Y,
    #[serde(rename = "z")]
    Z,
    #[serde(rename = "-x")]
    MinusX,
    #[serde(rename = "-y")]
    MinusY,
    #[serde(rename = "-z")]
    MinusZ,
}

impl Up {
    /// Forms that a text may have, for messages.
    pub const ACCEPTED: &'static str = "x, y, z, -x, -y, -z, or three finite numbers: 0,0,1";

    fn axis(name: &str) -> Option<Up> {
        let (sign, name) = match name.strip_prefix('-') {
            Some(name) => (-1.0, name),
            None => (1.0, name.strip_prefix('+').unwrap_or(name)),
        };
        let axis = match name {
            "x" | "X" => DVec3::X,
            "y" | "Y" => DVec3::Y,
            "z" | "Z" => DVec3::Z,
            _ => return None,
        };
        Some(Up(sign * axis))
    }
}

impl FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> Result<Up, String> {
        if let Some(up) = Up::axis(text.trim()) {
            return Ok(up);
        }
        let number =
            |part: &str| part.trim().parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
        match numbers.as_deref() {
            Some(&[x, y, z]) if [x, y, z] != [0.0; 3] => Ok(Up(DVec3::new(x, y, z))),
            _ => Err(format!("expected {}", Up::ACCEPTED)),
        }
    }
}

impl<'de> Deserialize<'de> for Up {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Form;
        impl<'de> Visitor<'de> for Form {
            type Value = Up;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(
                    "an axis (`x`, `y`, `z`, `-x`, `-y`, `-z`) or a vector of three numbers",
                )
            }
            fn visit_str<E: de::Error>(self, name: &str) -> Result<Up, E> {
                Up::axis(name).ok_or_else(|| {
                    let name: String = name.chars().take(40).collect();
                    E::custom(format!("`{name}` is no axis; accepted are `x`, `y`, `z`, `-x`, `-y`, `-z` or a vector"))
                })
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Up, A::Error> {
                three(seq, &self).map(|vector| Up(vector.into()))
            }
        }
        deserializer.deserialize_any(Form)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_and_vectors_are_read() {
        for (text, up) in [
            ("z", DVec3::Z),
            ("-z", DVec3::NEG_Z),
            ("+x", DVec3::X),
            ("Y", DVec3::Y),
            ("0,0,1", DVec3::Z),
            ("1, -2,3e1", DVec3::new(1.0, -2.0, 30.0)),
        ] {
            assert_eq!(text.parse(), Ok(Up(up)), "{text}");
        }
        for text in ["", "w", "--z", "1,2", "1,2,3,4", "1,2,nan", "0,0,inf", "0,0,-0"] {
            let refused = text.parse::<Up>().unwrap_err();
            assert!(refused.contains("x, y, z, -x, -y, -z"), "{text}: {refused}");
        }
    }

    #[test]
    fn json_has_strings_and_arrays() {
        let read = |json: &str| serde_json::from_str::<Up>(json).map(|up| up.0);
        assert_eq!(read(r#""-y""#).unwrap(), DVec3::NEG_Y);
        assert_eq!(read("[0, 0, 2]").unwrap(), DVec3::Z * 2.0);
        for json in [r#""up""#, "[0, 1]", "[0, 1, 2, 3]", "1", "null", r#""0,0,1""#] {
            assert!(read(json).is_err(), "{json}");
        }
    }
}
