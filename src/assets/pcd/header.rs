//! The text header of a PCD file.

use std::io::BufRead;

use glam::DAffine3;

use super::{AssetError, Lines, malformed, quote, sensor};
use crate::assets::points::unsupported;

const MAX_HEADER_LINES: u64 = 1000;
const MAX_FIELDS: usize = 1024;
const MAX_STRIDE_BYTES: usize = 1 << 20;

/// The part of a point that a field gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    Position(usize),
    Normal(usize),
    Rgb(usize),
    /// `0xAARRGGBB` in the bits of one field.
    Packed {
        alpha: bool,
    },
    /// A scalar field, by its number.
    Scalar(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Float,
    Signed,
    Unsigned,
}

#[derive(Clone, Debug)]
pub(super) struct Field {
    pub name: String,
    /// Bytes of one value: 1, 2, 4 or 8.
    pub size: usize,
    pub kind: Kind,
    /// Values in the field.
    pub count: usize,
    /// Bytes before it in a record.
    pub offset: usize,
    pub wanted: Option<Wanted>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Body {
    Ascii,
    Binary,
    Compressed,
}

#[derive(Clone, Debug)]
pub(super) struct Header {
    pub fields: Vec<Field>,
    pub points: u64,
    /// Width and height of an organised cloud.
    pub image: Option<[u64; 2]>,
    /// `VIEWPOINT`, if it is not the identity.
    pub viewpoint: Option<DAffine3>,
    pub warnings: Vec<String>,
    pub body: Body,
    /// Bytes of a record.
    pub stride: usize,
}

/// The header's lines, as words.
#[derive(Default)]
struct Entries {
    fields: Vec<String>,
    sizes: Option<Vec<String>>,
    types: Option<Vec<String>>,
    counts: Option<Vec<String>>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    viewpoint: Option<DAffine3>,
    warnings: Vec<String>,
}

impl Header {
    /// Reads up to and including the `DATA` line.
    pub(super) fn read(lines: &mut Lines<impl BufRead>, name: &str) -> Result<Self, AssetError> {
        let mut entries = Entries::default();
        while lines.number() < MAX_HEADER_LINES {
            let Some(line) = lines.next_line()? else { break };
            let mut words = line.split_ascii_whitespace();
            let Some(keyword) = words.next().filter(|word| !word.starts_with('#')) else {
                continue;
            };
            let list = || words.clone().map(str::to_owned).collect::<Vec<_>>();
            let number = || match words.clone().next().map(str::parse) {
                Some(Ok(value)) => Ok(Some(value)),
                _ => Err(malformed(name, format!("header, {keyword}"), "expected a whole number")),
            };
            match keyword {
                "VERSION" => {}
                "VIEWPOINT" => {
                    let numbers: Vec<f64> = list().iter().flat_map(|word| word.parse()).collect();
                    match <[f64; 7]>::try_from(numbers) {
                        Ok(numbers) => entries.viewpoint = sensor::pose(numbers),
                        Err(_) => entries.warnings.push(
                            "VIEWPOINT is ignored: it is not seven numbers, a translation and a quaternion (w x y z)"
                                .to_owned(),
                        ),
                    }
                }
                "FIELDS" | "COLUMNS" => entries.fields = list(),
                "SIZE" => entries.sizes = Some(list()),
                "TYPE" => entries.types = Some(list()),
                "COUNT" => entries.counts = Some(list()),
                "WIDTH" => entries.width = number()?,
                "HEIGHT" => entries.height = number()?,
                "POINTS" => entries.points = number()?,
                "DATA" => {
                    let body = match words.next() {
                        Some("ascii") => Body::Ascii,
                        Some("binary") => Body::Binary,
                        Some("binary_compressed") => Body::Compressed,
                        other => {
                            return Err(unsupported(
                                name,
                                format!(
                                    "PCD data {}; ascii, binary and binary_compressed are read",
                                    quote(other.unwrap_or(""))
                                ),
                            ));
                        }
                    };
                    return entries.header(body, name);
                }
                other => {
                    let reason = format!("{} is no PCD keyword", quote(other));
                    let place = format!("header, line {}", lines.number());
                    return Err(malformed(name, place, reason));
                }
            }
        }
        Err(malformed(name, "header", "has no DATA line"))
    }

    pub(super) fn has(&self, wanted: Wanted) -> bool {
        self.fields.iter().any(|field| field.wanted == Some(wanted))
    }

    /// Whether the packed colour field, if there is one, has an alpha.
    pub(super) fn packed_color(&self) -> Option<bool> {
        self.fields.iter().find_map(|field| match field.wanted {
            Some(Wanted::Packed { alpha }) => Some(alpha),
            _ => None,
        })
    }

    pub(super) fn wanted(&self) -> impl Iterator<Item = (Wanted, &Field)> {
        self.fields.iter().filter_map(|field| Some((field.wanted?, field)))
    }
}

impl Entries {
    fn header(self, body: Body, name: &str) -> Result<Header, AssetError> {
        let bad = |place: &str, reason: String| malformed(name, format!("header, {place}"), reason);
        let count = self.fields.len();
        if count == 0 || count > MAX_FIELDS {
            return Err(bad("FIELDS", format!("names {count} fields, expected 1 to {MAX_FIELDS}")));
        }
        let sizes = self.sizes.unwrap_or_else(|| vec!["4".to_owned(); count]);
        let types = self.types.unwrap_or_else(|| vec!["F".to_owned(); count]);
        let counts = self.counts.unwrap_or_else(|| vec!["1".to_owned(); count]);
        for (list, keyword) in [(&sizes, "SIZE"), (&types, "TYPE"), (&counts, "COUNT")] {
            if list.len() != count {
                let reason = format!("has {} entries for {count} fields", list.len());
                return Err(bad(keyword, reason));
            }
        }
        let mut fields: Vec<Field> = Vec::with_capacity(count);
        let mut offset = 0;
        for (((field_name, size), kind), times) in
            self.fields.into_iter().zip(&sizes).zip(&types).zip(&counts)
        {
            let mut field = Field::new(field_name, size, kind, times, offset)
                .map_err(|(keyword, reason)| bad(keyword, reason))?;
            // All scalar fields are alike until they have their numbers.
            let is_scalar = matches!(field.wanted, Some(Wanted::Scalar(_)));
            if !is_scalar && fields.iter().any(|other| other.wanted == field.wanted) {
                field.wanted = None;
            }
            offset += field.bytes();
            if offset > MAX_STRIDE_BYTES {
                let reason = format!("a point of more than {MAX_STRIDE_BYTES} bytes");
                return Err(bad("COUNT", reason));
            }
            fields.push(field);
        }
        let grid = match (self.width, self.height.or(Some(1))) {
            (Some(width), Some(height)) => Some(width.saturating_mul(height)),
            _ => None,
        };
        let points = match (self.points, grid) {
            (Some(points), Some(grid)) if points != grid => {
                let reason = format!("is {points}, but WIDTH · HEIGHT is {grid}");
                return Err(bad("POINTS", reason));
            }
            (points, grid) => points.or(grid).ok_or_else(|| {
                bad("POINTS", "the number of points is missing (POINTS, WIDTH)".to_owned())
            })?,
        };
        let image = match (self.width, self.height) {
            (Some(width), Some(height)) if width > 1 && height > 1 => Some([width, height]),
            _ => None,
        };
        let (viewpoint, warnings) = (self.viewpoint, self.warnings);
        let mut scalars = 0;
        for field in &mut fields {
            if let Some(Wanted::Scalar(number)) = &mut field.wanted {
                *number = scalars;
                scalars += 1;
            }
        }
        let header = Header { fields, points, image, viewpoint, warnings, body, stride: offset };
        for (axis, label) in ["x", "y", "z"].into_iter().enumerate() {
            if !header.has(Wanted::Position(axis)) {
                return Err(bad("FIELDS", format!("there is no field {label}")));
            }
        }
        Ok(header)
    }
}

impl Field {
    fn new(
        name: String,
        size: &str,
        kind: &str,
        count: &str,
        offset: usize,
    ) -> Result<Self, (&'static str, String)> {
        let kind = match kind {
            "F" | "f" => Kind::Float,
            "I" | "i" => Kind::Signed,
            "U" | "u" => Kind::Unsigned,
            other => return Err(("TYPE", format!("{} of field {name}", quote(other)))),
        };
        let size = match (size, kind) {
            ("4", _) => 4,
            ("8", _) => 8,
            ("1", Kind::Signed | Kind::Unsigned) => 1,
            ("2", Kind::Signed | Kind::Unsigned) => 2,
            (other, _) => return Err(("SIZE", format!("{} of field {name}", quote(other)))),
        };
        let Some(count) =
            count.parse().ok().filter(|&n: &usize| (1..=MAX_STRIDE_BYTES).contains(&n))
        else {
            return Err(("COUNT", format!("{} of field {name}", quote(count))));
        };
        let lower = name.to_ascii_lowercase();
        let wanted = match lower.as_str() {
            "x" => Some(Wanted::Position(0)),
            "y" => Some(Wanted::Position(1)),
            "z" => Some(Wanted::Position(2)),
            "normal_x" | "nx" => Some(Wanted::Normal(0)),
            "normal_y" | "ny" => Some(Wanted::Normal(1)),
            "normal_z" | "nz" => Some(Wanted::Normal(2)),
            "r" | "red" => Some(Wanted::Rgb(0)),
            "g" | "green" => Some(Wanted::Rgb(1)),
            "b" | "blue" => Some(Wanted::Rgb(2)),
            "rgb" if size == 4 => Some(Wanted::Packed { alpha: false }),
            "rgba" if size == 4 => Some(Wanted::Packed { alpha: true }),
            // The header numbers scalar fields once it knows them all.
            "_" => None,
            _ => Some(Wanted::Scalar(0)),
        };
        Ok(Self { name, size, kind, count, offset, wanted: wanted.filter(|_| count == 1) })
    }

    /// Bytes of all its values in a record.
    pub(super) fn bytes(&self) -> usize {
        self.size * self.count
    }

    fn is_packed(&self) -> bool {
        matches!(self.wanted, Some(Wanted::Packed { .. }))
    }

    /// Its first value, from little-endian bytes; the bits of a packed colour.
    pub(super) fn decode(&self, bytes: &[u8]) -> f64 {
        fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
            bytes.first_chunk().copied().unwrap_or([0; N])
        }
        match (self.kind, self.size) {
            (Kind::Float, 4) if self.is_packed() => u32::from_le_bytes(first(bytes)).into(),
            (Kind::Signed, 4) if self.is_packed() => u32::from_le_bytes(first(bytes)).into(),
            (Kind::Float, 4) => f32::from_le_bytes(first(bytes)).into(),
            (Kind::Float, _) => f64::from_le_bytes(first(bytes)),
            (Kind::Signed, 1) => i8::from_le_bytes(first(bytes)).into(),
            (Kind::Signed, 2) => i16::from_le_bytes(first(bytes)).into(),
            (Kind::Signed, 4) => i32::from_le_bytes(first(bytes)).into(),
            (Kind::Signed, _) => i64::from_le_bytes(first(bytes)) as f64,
            (Kind::Unsigned, 1) => u8::from_le_bytes(first(bytes)).into(),
            (Kind::Unsigned, 2) => u16::from_le_bytes(first(bytes)).into(),
            (Kind::Unsigned, 4) => u32::from_le_bytes(first(bytes)).into(),
            (Kind::Unsigned, _) => u64::from_le_bytes(first(bytes)) as f64,
        }
    }

    /// A value as text; a packed colour is text of its type, whose bits count.
    pub(super) fn parse(&self, token: &str) -> Option<f64> {
        if !self.is_packed() {
            return token.parse().ok();
        }
        match self.kind {
            Kind::Float => token.parse::<f32>().ok().map(|value| value.to_bits().into()),
            Kind::Signed => token.parse::<i32>().ok().map(|value| (value as u32).into()),
            Kind::Unsigned => token.parse::<u32>().ok().map(Into::into),
        }
    }
}
