//! The header, and the way from its coordinates to millimetres.
//!
//! A point counts millimetres from the outer corner of the first voxel, along the axes of the stored image (`voxel_order`).
//! Divided by the voxel's size and moved by half a voxel it is an index of the image; its axes are then turned and mirrored to
//! those of the matrix `vox_to_ras`, which leads to the scanner's coordinates. NiBabel does the same for
//! axes that are only mirrored; where they change places, it applies the inverse of the permutation that is meant here.

use std::ops::Range;

use glam::{DAffine3, DMat3, DVec3, DVec4};

use super::super::AssetError;
use super::super::tokens::shown;
use super::COLORS;

pub(super) const HEADER_BYTES: usize = 1000;
/// Most scalars, and most properties.
const MOST_NAMES: i16 = 10;
const NAME_BYTES: usize = 20;
/// Steps of the iteration to the nearest rotation, which doubles the number of right digits each time.
const ROTATION_STEPS: u32 = 30;

/// The order of bytes in a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Little,
    Big,
}

impl Order {
    pub fn int(self, bytes: [u8; 4]) -> i32 {
        match self {
            Order::Little => i32::from_le_bytes(bytes),
            Order::Big => i32::from_be_bytes(bytes),
        }
    }

    pub fn float(self, bytes: [u8; 4]) -> f32 {
        f32::from_bits(self.int(bytes) as u32)
    }

    fn short(self, bytes: [u8; 2]) -> i16 {
        match self {
            Order::Little => i16::from_le_bytes(bytes),
            Order::Big => i16::from_be_bytes(bytes),
        }
    }
}

#[derive(Debug)]
pub(super) struct Header {
    pub order: Order,
    /// A name for each scalar of a point.
    pub scalars: Vec<String>,
    /// A name for each property of a streamline.
    pub properties: Vec<String>,
    /// The scalars that are red, green and blue.
    pub color: Option<[usize; 3]>,
    /// Number of streamlines; 0 if the file does not say.
    pub count: u64,
    pub ras_from_file: DAffine3,
}

/// The header's bytes, with their order.
struct Bytes<'a>(&'a [u8], Order);

impl Bytes<'_> {
    fn at<const N: usize>(&self, offset: usize) -> [u8; N] {
        self.0.get(offset..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
    }

    fn short(&self, offset: usize) -> i16 {
        self.1.short(self.at(offset))
    }

    fn int(&self, offset: usize) -> i32 {
        self.1.int(self.at(offset))
    }

    fn floats<const N: usize>(&self, offset: usize) -> [f64; N] {
        std::array::from_fn(|index| f64::from(self.1.float(self.at(offset + 4 * index))))
    }
}

impl Header {
    pub fn parse(
        bytes: &[u8],
        file: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Header, AssetError> {
        let fail = |field: &str, reason: String| {
            AssetError::malformed(file, format!("header, {field}"), reason)
        };
        if !bytes.starts_with(b"TRACK") {
            let found = shown(bytes.get(..5).unwrap_or(bytes));
            return Err(fail(
                "id_string",
                format!("is {found}; a TrackVis file begins with TRACK"),
            ));
        }
        if bytes.len() < HEADER_BYTES {
            let reason = format!("the file ends after {} of {HEADER_BYTES} bytes", bytes.len());
            return Err(AssetError::malformed(file, "header", reason));
        }
        let sizes = [Order::Little, Order::Big].map(|order| Bytes(bytes, order).int(996));
        let order = match sizes {
            [1000, _] => Order::Little,
            [_, 1000] => Order::Big,
            [size, _] => {
                return Err(fail("hdr_size", format!("is {size} in neither byte order 1000")));
            }
        };
        let bytes = Bytes(bytes, order);
        let version = bytes.int(992);
        if !(1..=3).contains(&version) {
            let reason = format!("{version} is unknown; accepted are 1, 2 and 3");
            return Err(fail("version", reason));
        }
        let scalars =
            names(&bytes, "n_scalars", 36..38).map_err(|reason| fail("n_scalars", reason))?;
        let properties = names(&bytes, "n_properties", 238..240)
            .map_err(|reason| fail("n_properties", reason))?;
        let count = u64::try_from(bytes.int(988))
            .map_err(|_| fail("n_count", format!("{} is negative", bytes.int(988))))?;
        let color = color_of(&scalars);
        let ras_from_file =
            transform(&bytes, version, warnings).map_err(|(field, reason)| fail(field, reason))?;
        Ok(Header { order, scalars, properties, color, count, ras_from_file })
    }

    pub fn point_bytes(&self) -> usize {
        4 * (3 + self.scalars.len())
    }

    /// The fewest bytes of a streamline.
    pub fn streamline_bytes(&self) -> usize {
        4 * (1 + self.properties.len())
    }
}

/// The names of scalars or of properties: one for each number. A name may end in `\0` and the number of values it stands for.
fn names(bytes: &Bytes, field: &str, count_at: Range<usize>) -> Result<Vec<String>, String> {
    let count = bytes.short(count_at.start);
    if !(0..=MOST_NAMES).contains(&count) {
        return Err(format!("{field} is {count}; a file has 0 to {MOST_NAMES}"));
    }
    let count = count as usize;
    let mut names = Vec::new();
    for at in 0..MOST_NAMES as usize {
        let raw: [u8; NAME_BYTES] = bytes.at(count_at.end + NAME_BYTES * at);
        let mut parts = raw.split(|byte| *byte == 0);
        let name = String::from_utf8_lossy(parts.next().unwrap_or_default()).trim().to_owned();
        let values = parts.next().and_then(|digits| std::str::from_utf8(digits).ok()?.parse().ok());
        let values: usize = values.unwrap_or(1);
        if name.is_empty() || names.len() == count {
            break;
        }
        let values = values.min(count - names.len());
        if values == 1 {
            names.push(name);
        } else {
            names.extend((0..values).map(|value| format!("{name}_{value}")));
        }
    }
    // Values without a name are none the less there.
    let what = if field == "n_scalars" { "value" } else { "property" };
    names.extend((names.len()..count).map(|at| format!("{what}_{at}")));
    Ok(names)
}

fn color_of(scalars: &[String]) -> Option<[usize; 3]> {
    let is_first = |name: &String| {
        let name = name.to_ascii_lowercase();
        name.strip_suffix("_0").is_some_and(|name| COLORS.contains(&name))
    };
    let first = scalars.iter().position(is_first)?;
    let stem = scalars[first].strip_suffix("_0")?;
    let follows = |at: usize| scalars.get(first + at).is_some_and(|n| *n == format!("{stem}_{at}"));
    (follows(1) && follows(2) && !follows(3)).then_some([first, first + 1, first + 2])
}

/// The way from the file's coordinates to the scanner's; otherwise the field at fault and the reason.
fn transform(
    bytes: &Bytes,
    version: i32,
    warnings: &mut Vec<String>,
) -> Result<DAffine3, (&'static str, String)> {
    let voxel: DVec3 = bytes.floats(12).into();
    if !(voxel.min_element() > 0.0 && voxel.is_finite()) {
        return Err(("voxel_size", format!("{voxel} is no size of a voxel")));
    }
    let rows: [DVec4; 4] =
        std::array::from_fn(|row| DVec4::from_array(bytes.floats(440 + 16 * row)));
    // Version 1 has no matrix; later ones leave it zero where it is unknown.
    let mut matrix = DAffine3::IDENTITY;
    if version > 1 && rows[3].w != 0.0 {
        let column = |at: usize| DVec3::new(rows[0][at], rows[1][at], rows[2][at]);
        matrix = DAffine3::from_cols(column(0), column(1), column(2), column(3));
    } else {
        warnings.push("the header has no vox_to_ras; the identity is taken for it".to_owned());
    }
    let stored = axes_of(&matrix.matrix3).filter(|_| matrix.is_finite());
    let wanted = stored.ok_or_else(|| {
        ("vox_to_ras", "the matrix is singular or no number and leads to no place".to_owned())
    })?;
    let order: [u8; 4] = bytes.at(948);
    let order = order.split(|byte| *byte == 0).next().unwrap_or_default().trim_ascii();
    let order = if order.is_empty() {
        warnings.push("the header has no voxel_order; LPS is taken for it".to_owned());
        b"LPS"
    } else {
        order
    };
    let given = axes_named(order).ok_or_else(|| {
        let reason = format!(
            "{} names no three axes; accepted are one of L and R, one of P and A, and one of I and S, in any order",
            shown(order)
        );
        ("voxel_order", reason)
    })?;
    // For each axis of the matrix's image, the one of the stored image that lies along it.
    let mut turned = DMat3::ZERO;
    let mut shift = DVec3::ZERO;
    for (to, (axis, sign)) in wanted.into_iter().enumerate() {
        let Some(from) = given.iter().position(|(other, _)| *other == axis) else { continue };
        if given[from].1 == sign {
            turned.col_mut(from)[to] = 1.0;
        } else {
            turned.col_mut(from)[to] = -1.0;
            shift[to] = f64::from(bytes.short(6 + 2 * from)) - 1.0;
        }
    }
    let index_from_file =
        DAffine3::from_translation(DVec3::splat(-0.5)) * DAffine3::from_scale(voxel.recip());
    let turn = DAffine3 { matrix3: turned, translation: shift };
    Ok(matrix * turn * index_from_file)
}

/// For each axis of an image, the axis of space that it lies along and its sign; `None` for a singular matrix.
fn axes_of(matrix: &DMat3) -> Option<[(usize, f64); 3]> {
    let lengths = [0, 1, 2].map(|axis| matrix.col(axis).length());
    if !lengths.iter().all(|length| *length > 0.0 && length.is_finite()) {
        return None;
    }
    // The nearest rotation, by Newton's iteration to the polar decomposition.
    let mut rotation = DMat3::from_cols(
        matrix.col(0) / lengths[0],
        matrix.col(1) / lengths[1],
        matrix.col(2) / lengths[2],
    );
    if rotation.determinant().abs() < 1e-9 {
        return None;
    }
    for _ in 0..ROTATION_STEPS {
        rotation = (rotation + rotation.inverse().transpose()) * 0.5;
    }
    let mut free = [true; 3];
    let mut axes = [(0, 1.0); 3];
    for (axis, slot) in axes.iter_mut().enumerate() {
        let column = rotation.col(axis);
        let weight = |of: usize| if free[of] { column[of].abs() } else { -1.0 };
        let best = (1..3).fold(0, |best, of| if weight(of) > weight(best) { of } else { best });
        free[best] = false;
        *slot = (best, if column[best] < 0.0 { -1.0 } else { 1.0 });
    }
    Some(axes)
}

/// The axes that three letters name.
fn axes_named(order: &[u8]) -> Option<[(usize, f64); 3]> {
    let axis = |letter: &u8| match letter.to_ascii_uppercase() {
        b'R' => Some((0, 1.0)),
        b'L' => Some((0, -1.0)),
        b'A' => Some((1, 1.0)),
        b'P' => Some((1, -1.0)),
        b'S' => Some((2, 1.0)),
        b'I' => Some((2, -1.0)),
        _ => None,
    };
    let [a, b, c] = order else { return None };
    let axes = [axis(a)?, axis(b)?, axis(c)?];
    let is_each = (0..3).all(|wanted| axes.iter().any(|(axis, _)| *axis == wanted));
    is_each.then_some(axes)
}
