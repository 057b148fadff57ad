//! Which entries of a TRX file are read, and as what.

use super::super::AssetError;
use super::super::warnings::counted;
use super::archive::Entry;
use super::array::Array;

/// Most columns of data that are read. A vertex keeps 64 bits of fields.
const MOST_COLUMNS: u64 = 64;

/// What the rows of an array belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Per {
    Vertex,
    Streamline,
    /// The rows are the streamlines of a group.
    Group,
}

/// The entries that are read.
pub(super) struct Contents {
    pub header: Entry,
    pub positions: Array,
    pub offsets: Array,
    /// Data of vertices, of streamlines, then groups.
    pub data: Vec<(Per, Array)>,
}

impl Contents {
    /// Sorts entries by what their paths say.
    ///
    /// # Errors
    /// An array that every file has is missing, is there twice, or has rows that are not accepted.
    pub fn of(
        entries: Vec<Entry>,
        file: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Contents, AssetError> {
        let (mut header, mut positions, mut offsets) = (None, None, None);
        let mut data = Vec::new();
        for entry in entries {
            let (path, place) = (entry.path.clone(), entry.place.clone());
            let (folder, leaf) = path.split_once('/').unwrap_or(("", &path));
            if path == "header.json" {
                header = Some(entry);
                continue;
            }
            // Nothing that is drawn.
            if folder == "dpg" || leaf.ends_with(".json") {
                continue;
            }
            let array = Array::of(entry, leaf);
            let fail = |reason: String| AssetError::malformed(file, &*place, reason);
            let rows_of = |array: Option<Array>, columns: u64, kinds: &[&str]| {
                let fits =
                    |array: &Array| array.columns == columns && kinds.contains(&array.kind.name);
                let kinds = kinds.join(" or ");
                array.filter(fits).ok_or_else(|| {
                    fail(format!("has other rows; accepted are rows of {columns} × {kinds}"))
                })
            };
            let is_second = match (folder, array) {
                ("", array) if leaf.starts_with("positions.") => {
                    let array = rows_of(array, 3, &["float16", "float32", "float64"])?;
                    positions.replace(array).is_some()
                }
                ("", array) if leaf.starts_with("offsets.") => {
                    let array = rows_of(array, 1, &["uint32", "uint64"])?;
                    offsets.replace(array).is_some()
                }
                ("groups", array) => {
                    data.push((Per::Group, rows_of(array, 1, &["uint32", "uint64"])?));
                    false
                }
                ("dpv", Some(array)) => {
                    data.push((Per::Vertex, array));
                    false
                }
                ("dps", Some(array)) => {
                    data.push((Per::Streamline, array));
                    false
                }
                _ => {
                    warnings.push(format!("entry \"{place}\" is ignored: no array of TRX"));
                    false
                }
            };
            if is_second {
                return Err(fail("another entry holds the same; accepted is one".to_owned()));
            }
        }
        let missing = |names: &str| {
            AssetError::malformed(file, "ZIP directory", format!("has no entry {names}"))
        };
        data.sort_by_key(|(per, _)| *per);
        retain_few(&mut data, warnings);
        Ok(Contents {
            header: header.ok_or_else(|| missing("header.json"))?,
            positions: positions.ok_or_else(|| {
                missing("positions.3.float16, positions.3.float32 or positions.3.float64")
            })?,
            offsets: offsets.ok_or_else(|| missing("offsets.uint32 or offsets.uint64"))?,
            data,
        })
    }
}

/// Keeps the first data, as many as are read.
fn retain_few(data: &mut Vec<(Per, Array)>, warnings: &mut Vec<String>) {
    let mut columns = 0u64;
    let mut lost = Vec::new();
    data.retain(|(_, array)| {
        let sum = columns.saturating_add(array.columns);
        let fits = sum <= MOST_COLUMNS;
        if fits {
            columns = sum;
        } else {
            lost.push(array.entry.place.clone());
        }
        fits
    });
    if let Some(first) = lost.first() {
        let text = counted(lost.len() as u64, "entry is", "entries are").unwrap_or_default();
        warnings.push(format!(
            "{text} left out: up to {MOST_COLUMNS} columns of data are read; the first is \"{first}\""
        ));
    }
}
