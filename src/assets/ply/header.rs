//! The header: encoding, elements, their properties.

use std::io::BufRead;

use super::super::AssetError;
use super::super::tokens::{Lines, shown};
use super::super::warnings::counted;

/// More header lines than this are no header.
const MAX_LINES: u64 = 100_000;
/// Keywords without which the body cannot be understood.
const STRUCTURE: [&str; 4] = ["format", "element", "property", "end_header"];
/// Ignored lines that are quoted one by one; the others are counted.
const QUOTED_LINES: usize = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug)]
pub(super) struct Property {
    pub name: String,
    pub kind: Kind,
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

#[derive(Clone, Debug)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// From MeshLab's `comment TextureFile NAME`.
    pub texture_file: Option<String>,
    /// Lines that are not part of the format, and were ignored.
    pub warnings: Vec<String>,
}

impl Scalar {
    fn parse(name: &[u8]) -> Option<Scalar> {
        Some(match name {
            b"char" | b"int8" => Scalar::I8,
            b"uchar" | b"uint8" => Scalar::U8,
            b"short" | b"int16" => Scalar::I16,
            b"ushort" | b"uint16" => Scalar::U16,
            b"int" | b"int32" => Scalar::I32,
            b"uint" | b"uint32" => Scalar::U32,
            b"int64" => Scalar::I64,
            b"uint64" => Scalar::U64,
            b"float" | b"float32" => Scalar::F32,
            b"double" | b"float64" => Scalar::F64,
            _ => return None,
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// The value at the start of `bytes`, which holds at least [`Scalar::bytes`].
    #[inline]
    pub fn decode(self, bytes: &[u8], big: bool) -> f64 {
        fn word<const N: usize>(bytes: &[u8], big: bool) -> [u8; N] {
            let mut word = [0; N];
            word.copy_from_slice(&bytes[..N]);
            if big {
                word.reverse();
            }
            word
        }
        match self {
            Scalar::I8 => f64::from(bytes[0] as i8),
            Scalar::U8 => f64::from(bytes[0]),
            Scalar::I16 => f64::from(i16::from_le_bytes(word(bytes, big))),
            Scalar::U16 => f64::from(u16::from_le_bytes(word(bytes, big))),
            Scalar::I32 => f64::from(i32::from_le_bytes(word(bytes, big))),
            Scalar::U32 => f64::from(u32::from_le_bytes(word(bytes, big))),
            Scalar::I64 => i64::from_le_bytes(word(bytes, big)) as f64,
            Scalar::U64 => u64::from_le_bytes(word(bytes, big)) as f64,
            Scalar::F32 => f64::from(f32::from_le_bytes(word(bytes, big))),
            Scalar::F64 => f64::from_le_bytes(word(bytes, big)),
        }
    }
}

impl Element {
    /// The least that one of them takes in the body.
    pub fn min_bytes(&self, encoding: Encoding) -> u64 {
        let bytes = |property: &Property| match (encoding, property.kind) {
            (Encoding::Ascii, _) => 2,
            (_, Kind::Scalar(scalar) | Kind::List { count: scalar, .. }) => scalar.bytes() as u64,
        };
        self.properties.iter().map(bytes).sum()
    }

    /// Bytes of one element when none of its properties is a list.
    pub fn fixed_bytes(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, property| match property.kind {
            Kind::Scalar(scalar) => Some(sum + scalar.bytes()),
            Kind::List { .. } => None,
        })
    }

    /// The first of `names` that is a scalar property.
    pub fn scalar(&self, names: &[&str]) -> Option<usize> {
        let is = |property: &Property, name: &str| {
            property.name.eq_ignore_ascii_case(name) && matches!(property.kind, Kind::Scalar(_))
        };
        names.iter().find_map(|name| self.properties.iter().position(|p| is(p, name)))
    }

    /// The first of `names` that is a list property.
    pub fn list(&self, names: &[&str]) -> Option<usize> {
        let is = |property: &Property, name: &str| {
            property.name.eq_ignore_ascii_case(name) && matches!(property.kind, Kind::List { .. })
        };
        names.iter().find_map(|name| self.properties.iter().position(|p| is(p, name)))
    }
}

impl Header {
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name.eq_ignore_ascii_case(name))
    }
}

/// Reads up to and including `end_header`.
pub(super) fn read<R: BufRead>(lines: &mut Lines<R>, file: &str) -> Result<Header, AssetError> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut texture_file: Option<String> = None;
    let mut more_textures = 0u64;
    let mut ignored = Ignored::default();
    lines.end_at_carriage_returns_after(b"ply")?;
    loop {
        let more = lines.advance()?;
        let place = format!("header line {}", lines.number);
        let fail = |reason: String| Err(AssetError::malformed(file, place.clone(), reason));
        if !more {
            return fail("the header ends without end_header".to_owned());
        }
        if lines.number > MAX_LINES {
            return fail("the header is too long".to_owned());
        }
        let mut tokens = lines.tokens();
        let keyword = tokens.next().unwrap_or_default();
        if lines.number == 1 {
            if keyword != b"ply" {
                return fail("the first line must be \"ply\"".to_owned());
            }
            continue;
        }
        match keyword {
            b"" | b"obj_info" => {}
            b"comment" => {
                if tokens.next() == Some(b"TextureFile") {
                    let name = tokens.rest();
                    more_textures += u64::from(texture_file.as_ref().is_some_and(|it| *it != name));
                    texture_file = texture_file.or(Some(name));
                }
            }
            b"format" => match tokens.next() {
                Some(b"ascii") => encoding = Some(Encoding::Ascii),
                Some(b"binary_little_endian") => encoding = Some(Encoding::Little),
                Some(b"binary_big_endian") => encoding = Some(Encoding::Big),
                other => {
                    return fail(format!("unknown format {}", shown(other.unwrap_or_default())));
                }
            },
            b"element" => {
                let name = tokens.next().unwrap_or_default();
                let digits = tokens.next().unwrap_or_default();
                let count = std::str::from_utf8(digits).ok().and_then(|text| text.parse().ok());
                let Some(count) = count else {
                    return fail(format!("element {}: {} is no count", shown(name), shown(digits)));
                };
                let name = String::from_utf8_lossy(name).into_owned();
                elements.push(Element { name, count, properties: Vec::new() });
            }
            b"property" => {
                let Some(element) = elements.last_mut() else {
                    return fail("a property before any element".to_owned());
                };
                match property(tokens) {
                    Ok(property) => element.properties.push(property),
                    Err(reason) => return fail(reason),
                }
            }
            b"end_header" => break,
            other => match damage(other, lines.text()) {
                Some(reason) => return fail(reason),
                None => ignored.add(lines.number, lines.text()),
            },
        }
    }
    let mut warnings = ignored.warnings();
    warnings.extend(counted(
        more_textures,
        "more texture file is ignored: all faces have the first",
        "more texture files are ignored: all faces have the first",
    ));
    match encoding {
        Some(encoding) => Ok(Header { encoding, elements, texture_file, warnings }),
        None => Err(AssetError::malformed(file, "header", "there is no format line")),
    }
}

/// Explains why a line with an unknown keyword is damage. Software writes lines of its own into headers, which say nothing
/// about the body and can be ignored.
fn damage(keyword: &[u8], line: &[u8]) -> Option<String> {
    let is_text = |byte: &u8| *byte >= b' ' || *byte == b'\t';
    if !line.iter().all(is_text) {
        return Some("is not text: end_header is missing before it".to_owned());
    }
    let keyword_text = String::from_utf8_lossy(keyword).to_ascii_lowercase();
    if keyword_text.parse::<f64>().is_ok() {
        return Some(format!("{} is data: end_header is missing before it", shown(keyword)));
    }
    let is_near = |known: &&&str| strsim::damerau_levenshtein(&keyword_text, known) <= 2;
    let meant = STRUCTURE.iter().filter(|_| keyword.len() <= 16).find(is_near)?;
    Some(format!("unknown keyword {}; did you mean {meant}?", shown(keyword)))
}

/// Header lines that are not part of the format.
#[derive(Default)]
struct Ignored {
    quoted: Vec<String>,
    more: u64,
}

impl Ignored {
    fn add(&mut self, number: u64, line: &[u8]) {
        if self.quoted.len() < QUOTED_LINES {
            let line = shown(line.trim_ascii());
            self.quoted.push(format!(
                "header line {number} is not part of the PLY format and is ignored: {line}"
            ));
        } else {
            self.more += 1;
        }
    }

    fn warnings(self) -> Vec<String> {
        let Ignored { quoted: mut warnings, more } = self;
        if more > 0 {
            warnings.push(format!(
                "{more} more header lines are not part of the PLY format and are ignored"
            ));
        }
        warnings
    }
}

fn property<'a>(mut tokens: impl Iterator<Item = &'a [u8]>) -> Result<Property, String> {
    let scalar = |token: Option<&'a [u8]>| {
        let token = token.unwrap_or_default();
        Scalar::parse(token).ok_or_else(|| format!("unknown property type {}", shown(token)))
    };
    let first = tokens.next();
    let kind = if first == Some(b"list") {
        let count = scalar(tokens.next())?;
        if count.is_float() {
            return Err("the length of a list must have an integer type".to_owned());
        }
        Kind::List { count, item: scalar(tokens.next())? }
    } else {
        Kind::Scalar(scalar(first)?)
    };
    let name = tokens.next().ok_or("a property without a name")?;
    Ok(Property { name: String::from_utf8_lossy(name).into_owned(), kind })
}
