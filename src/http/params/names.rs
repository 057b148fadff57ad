//! Names of parameters, and the problems for unknown names.

use crate::http::problem::{Kind, Problem};
use crate::plan::Given;
use crate::spelling::nearest;

/// Parameters that are not settings.
const OTHERS: [&str; 15] = [
    "camera",
    "eye",
    "target",
    "up",
    "fov",
    "ortho_height",
    "view",
    "proj",
    "w",
    "h",
    "format",
    "quality",
    "output",
    "wait",
    "deadline_ms",
];

/// Names of all parameters of a frame.
pub fn names() -> impl Iterator<Item = &'static str> {
    OTHERS.into_iter().chain(Given::NAMES.iter().copied())
}

/// Parameters of the contract that this version does not have, and what to do instead.
const UNAVAILABLE: [(&str, &str); 1] = [("effects", "leave it out: there are none")];

/// Synonyms that clients may try, and the parameter that is meant.
const SYNONYMS: [(&str, &str); 9] = [
    ("width", "w"),
    ("height", "h"),
    ("size", "w"),
    ("q", "quality"),
    ("position", "eye"),
    ("center", "target"),
    ("fovy", "fov"),
    ("ymag", "ortho_height"),
    ("timeout", "deadline_ms"),
];

/// Parameter names that an operation accepts.
#[derive(Debug)]
pub struct Names {
    /// Parameters of the operation beside a frame's.
    pub own: &'static [&'static str],
    /// A frame's parameters that the operation refuses, and why.
    pub without: &'static [(&'static str, &'static str)],
}

impl Names {
    /// Names that an operation for a plain frame accepts.
    pub const FRAME: Names = Names { own: &[], without: &[] };

    /// Refuses a name that the operation does not accept, or that this version does not have.
    ///
    /// # Errors
    /// Says what is wrong with the name, and which names there are.
    pub fn check(&self, name: &str) -> Result<(), Problem> {
        let refused = |name: &str, why: &str, accepted: &str| {
            Problem::new(Kind::Unavailable, format!("{name}: {why}")).at(name).accepted(accepted)
        };
        if let Some((name, why)) = self.without.iter().find(|(known, _)| *known == name) {
            return Err(refused(name, why, "leave it out"));
        }
        if self.own.contains(&name) || names().any(|known| known == name) {
            return Ok(());
        }
        if let Some((name, accepted)) = UNAVAILABLE.iter().find(|(known, _)| *known == name) {
            return Err(refused(name, "not available in this version", accepted));
        }
        let is_here = |name: &&str| !self.without.iter().any(|(not, _)| not == name);
        let known: Vec<&str> = self.own.iter().copied().chain(names().filter(is_here)).collect();
        let synonyms: Vec<(&str, &str)> =
            SYNONYMS.into_iter().filter(|(_, meant)| is_here(meant)).collect();
        Err(unknown_name(name, &known, &synonyms))
    }
}

/// Refuses a name that is not a parameter of this version.
pub fn check_name(name: &str) -> Result<(), Problem> {
    Names::FRAME.check(name)
}

/// Builds the problem for a name that is not in `known`.
pub fn unknown_name(
    name: &str,
    known: &[&'static str],
    synonyms: &[(&str, &'static str)],
) -> Problem {
    let meant = synonyms
        .iter()
        .find(|(word, _)| word.eq_ignore_ascii_case(name))
        .map(|(_, meant)| *meant)
        .or_else(|| nearest(name, known.iter().copied()));
    let shown: String = name.chars().take(64).collect();
    let detail = match meant {
        Some(meant) => format!("there is no parameter `{shown}`; did you mean `{meant}`?"),
        None => format!("there is no parameter `{shown}`"),
    };
    Problem::new(Kind::UnknownParameter, detail).at(shown).accepted(known.join(", "))
}
