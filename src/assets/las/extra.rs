//! Extra bytes: fields behind those of the point format, as a variable length record declares them, extended or not (LAS 1.4 R15, §2.7).

use super::super::fields::name_of;

/// Bytes of a declaration.
const DECLARATION_BYTES: usize = 192;
/// Bytes of all declarations at most: the length of a record has 16 bits.
pub(super) const MOST_BYTES: u64 = DECLARATION_BYTES as u64 * u16::MAX as u64;
/// Flags that a value stands for none, and that a scale and an offset are given.
const HAS_NO_DATA: u8 = 1;
const HAS_SCALE: u8 = 8;
const HAS_OFFSET: u8 = 16;

/// A field behind those of the point format.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ExtraField {
    pub name: String,
    /// Place in a record.
    at: usize,
    /// Number of the type, 1 to 10.
    kind: u8,
    scale: f64,
    offset: f64,
    /// The stored number that stands for no value.
    no_data: Option<f64>,
}

/// Bytes of a type; `None` for types that the standard does not have.
fn size_of_kind(kind: u8) -> Option<usize> {
    match kind {
        1 | 2 => Some(1),
        3 | 4 => Some(2),
        5 | 6 | 9 => Some(4),
        7 | 8 | 10 => Some(8),
        // Two or three numbers, deprecated.
        11..=20 => size_of_kind(kind - 10).map(|size| 2 * size),
        21..=30 => size_of_kind(kind - 20).map(|size| 3 * size),
        _ => None,
    }
}

fn number(kind: u8, bytes: &[u8]) -> Option<f64> {
    fn first<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
        bytes.first_chunk().copied()
    }
    Some(match kind {
        1 => u8::from_le_bytes(first(bytes)?).into(),
        2 => i8::from_le_bytes(first(bytes)?).into(),
        3 => u16::from_le_bytes(first(bytes)?).into(),
        4 => i16::from_le_bytes(first(bytes)?).into(),
        5 => u32::from_le_bytes(first(bytes)?).into(),
        6 => i32::from_le_bytes(first(bytes)?).into(),
        7 => u64::from_le_bytes(first(bytes)?) as f64,
        8 => i64::from_le_bytes(first(bytes)?) as f64,
        9 => f32::from_le_bytes(first(bytes)?).into(),
        10 => f64::from_le_bytes(first(bytes)?),
        _ => return None,
    })
}

/// The number in a declaration's eight bytes: integers are widened to 64 bits, floating-point numbers to f64.
fn widened(kind: u8, bytes: &[u8]) -> Option<f64> {
    match kind {
        1 | 3 | 5 | 7 => number(7, bytes),
        2 | 4 | 6 | 8 => number(8, bytes),
        9 | 10 => number(10, bytes),
        _ => None,
    }
}

/// The declared fields between `begin` and `end` of a record. What lies behind an unknown type is not read.
pub(super) fn declared(record: &[u8], begin: usize, end: usize) -> Vec<ExtraField> {
    let mut fields = Vec::new();
    let mut at = begin;
    for declaration in record.chunks_exact(DECLARATION_BYTES) {
        let (kind, options) = (declaration[2], declaration[3]);
        let size = match kind {
            // Undocumented bytes: the options are their number.
            0 => Some(usize::from(options)),
            kind => size_of_kind(kind),
        };
        let Some(size) = size.filter(|size| at + size <= end) else { break };
        let name = String::from_utf8_lossy(&declaration[4..36]);
        let name = name_of(name.trim_end_matches('\0'));
        let given = |flag: u8, place: usize| {
            let value = number(10, &declaration[place..]).filter(|value| value.is_finite());
            value.filter(|_| options & flag != 0)
        };
        if (1..=10).contains(&kind) && !name.is_empty() {
            let scale = given(HAS_SCALE, 112).unwrap_or(1.0);
            let offset = given(HAS_OFFSET, 136).unwrap_or(0.0);
            let no_data = widened(kind, &declaration[40..]).filter(|_| options & HAS_NO_DATA != 0);
            fields.push(ExtraField { name, at, kind, scale, offset, no_data });
        }
        at += size;
    }
    fields
}

impl ExtraField {
    /// The value of a record; NaN where it has none.
    pub(super) fn value(&self, record: &[u8]) -> f64 {
        let stored = record.get(self.at..).and_then(|bytes| number(self.kind, bytes));
        match stored {
            Some(stored) if Some(stored) != self.no_data => stored * self.scale + self.offset,
            _ => f64::NAN,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A declaration with these flags, and no data, scale and offset.
    pub(crate) fn declaration(kind: u8, options: u8, name: &str, numbers: [f64; 2]) -> Vec<u8> {
        let mut bytes = vec![0; DECLARATION_BYTES];
        (bytes[2], bytes[3]) = (kind, options);
        bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
        bytes[40..48].copy_from_slice(&9999u64.to_le_bytes());
        bytes[112..120].copy_from_slice(&numbers[0].to_le_bytes());
        bytes[136..144].copy_from_slice(&numbers[1].to_le_bytes());
        bytes
    }

    #[test]
    fn fields_have_types_scales_and_missing_values() {
        let record = [
            declaration(3, HAS_NO_DATA | HAS_SCALE | HAS_OFFSET, "Amplitude", [0.5, 10.0]),
            declaration(0, 2, "", [1.0, 0.0]),
            declaration(9, 0, "height above ground", [7.0, 7.0]),
            declaration(21, 0, "colour", [1.0, 0.0]),
            declaration(10, 0, "beyond", [1.0, 0.0]),
        ]
        .concat();
        let fields = declared(&record, 20, 31);
        let names: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
        assert_eq!(names, ["Amplitude", "height above ground"]);
        let mut point = [0; 31];
        point[20..22].copy_from_slice(&40u16.to_le_bytes());
        point[24..28].copy_from_slice(&2.5f32.to_le_bytes());
        assert_eq!(fields[0].value(&point), 30.0);
        assert_eq!(fields[1].value(&point), 2.5);
        point[20..22].copy_from_slice(&9999u16.to_le_bytes());
        assert!(fields[0].value(&point).is_nan());
        assert!(fields[1].value(&point[..20]).is_nan());
        assert!(declared(&[3; 191], 20, 31).is_empty());
    }
}
