//! Which parameters there are, and what is said to who gives another.

use crate::http::problem::{Kind, Problem, nearest};
use crate::plan::Given;

/// Parameters beside the settings.
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

/// Every parameter of a frame.
pub fn names() -> impl Iterator<Item = &'static str> {
    OTHERS.into_iter().chain(Given::NAMES.iter().copied())
}

/// Parameters of the contract that this version does not have, and what it does instead.
const UNAVAILABLE: [(&str, &str); 2] = [
    ("budget_ms", "leave it out, or give `deadline_ms`"),
    ("effects", "leave it out: there are none"),
];

/// Other words for the same thing.
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

/// The names that one way of asking for frames takes.
#[derive(Debug)]
pub struct Names {
    /// Beside a frame's parameters.
    pub own: &'static [&'static str],
    /// A frame's parameters that it does not have, and why.
    pub without: &'static [(&'static str, &'static str)],
}

impl Names {
    /// Of a plain frame.
    pub const FRAME: Names = Names { own: &[], without: &[] };

    /// Refuses a name that is not one of these, or not in this version.
    ///
    /// # Errors
    /// What is wrong with it, and which names there are.
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

/// The problem for a name that is not in `known`.
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
