//! Settings that are text.

use super::SettingKind;
use crate::scene::clipping::ClipBoxes;
use crate::scene::name::Name;

/// The kind of a name.
pub(super) fn name(
    default: &'static str,
    accepted: &'static str,
    examples: &'static [&'static str],
) -> SettingKind {
    SettingKind::Text { default, accepted, pattern: Name::PATTERN.to_owned(), examples }
}

/// The kind of `clip_boxes`.
pub(super) fn boxes() -> SettingKind {
    SettingKind::Text {
        default: "none",
        accepted: "1 to 8 boxes `x,y,z,x,y,z`, `*` for an open bound, `outside:` before a box that hides, `;` between boxes",
        pattern: ClipBoxes::pattern(),
        examples: &["-1,-1,-1,1,1,0.5", "outside:0,0,0,1,1,1"],
    }
}
