//! Arrays of a TRX file: what the names of entries say, `NAME.TYPE` or `NAME.COLUMNS.TYPE`. Rows lie one after the other, and
//! numbers are little-endian.

use half::f16;

use super::super::AssetError;
use super::archive::Entry;

/// A type of numbers.
#[derive(Debug)]
pub(super) struct Kind {
    /// As entries name it.
    pub name: &'static str,
    pub bytes: usize,
    number: fn(&[u8]) -> f64,
}

/// Bits, which take a byte each, as NumPy stores them.
pub(super) const BIT: Kind =
    Kind { name: "bit", bytes: 1, number: |bytes| u8::from_le_bytes(first(bytes)).into() };

static KINDS: [Kind; 12] = [
    BIT,
    Kind { name: "uint8", bytes: 1, number: |bytes| u8::from_le_bytes(first(bytes)).into() },
    Kind { name: "uint16", bytes: 2, number: |bytes| u16::from_le_bytes(first(bytes)).into() },
    Kind { name: "uint32", bytes: 4, number: |bytes| u32::from_le_bytes(first(bytes)).into() },
    Kind { name: "uint64", bytes: 8, number: |bytes| u64::from_le_bytes(first(bytes)) as f64 },
    Kind { name: "int8", bytes: 1, number: |bytes| i8::from_le_bytes(first(bytes)).into() },
    Kind { name: "int16", bytes: 2, number: |bytes| i16::from_le_bytes(first(bytes)).into() },
    Kind { name: "int32", bytes: 4, number: |bytes| i32::from_le_bytes(first(bytes)).into() },
    Kind { name: "int64", bytes: 8, number: |bytes| i64::from_le_bytes(first(bytes)) as f64 },
    Kind { name: "float16", bytes: 2, number: |bytes| f16::from_le_bytes(first(bytes)).into() },
    Kind { name: "float32", bytes: 4, number: |bytes| f32::from_le_bytes(first(bytes)).into() },
    Kind { name: "float64", bytes: 8, number: |bytes| f64::from_le_bytes(first(bytes)) },
];

fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.first_chunk().copied().unwrap_or([0; N])
}

impl Kind {
    /// The number at the beginning of these bytes.
    pub fn number(&self, bytes: &[u8]) -> f64 {
        (self.number)(bytes)
    }
}

/// An array that an entry holds.
#[derive(Debug)]
pub(super) struct Array {
    pub entry: Entry,
    pub name: String,
    /// Numbers of a row.
    pub columns: u64,
    pub kind: &'static Kind,
}

impl Array {
    /// The array of an entry whose path ends in `leaf`; `None` if that is no name of an array.
    pub fn of(entry: Entry, leaf: &str) -> Option<Array> {
        let (rest, kind) = leaf.rsplit_once('.')?;
        let kind = KINDS.iter().find(|known| known.name == kind)?;
        let columns =
            rest.rsplit_once('.').and_then(|(name, count)| Some((name, count.parse().ok()?)));
        let (name, columns) = columns.unwrap_or((rest, 1));
        (columns > 0).then(|| Array { name: name.to_owned(), entry, columns, kind })
    }

    /// Checks that the entry has as many rows.
    ///
    /// # Errors
    /// [`AssetError::Malformed`] at the entry.
    pub fn check_rows(&self, file: &str, rows: u64, what: &str) -> Result<(), AssetError> {
        let Array { entry, columns, kind, .. } = self;
        let row = u128::from(*columns) * kind.bytes as u128;
        let needed = u128::from(rows) * row;
        if needed == u128::from(entry.bytes) {
            return Ok(());
        }
        let reason = format!(
            "has {} bytes, but the {rows} {what} of header.json take {row} bytes each, {needed} in all",
            entry.bytes
        );
        Err(AssetError::malformed(file, &*entry.place, reason))
    }
}
