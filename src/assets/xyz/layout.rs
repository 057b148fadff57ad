//! Meaning of the columns of a text point cloud.

use glam::DVec3;

use super::PointCloud;
use crate::assets::fields::{self, CLASSIFICATION, Column, INTENSITY, Numbers, name_of};
use crate::assets::points::{bytes, colors, unit_or_zero};

/// The meaning of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    X,
    Y,
    Z,
    Red,
    Green,
    Blue,
    Alpha,
    NormalX,
    NormalY,
    NormalZ,
    Radius,
    /// A scalar field.
    Field,
}

impl Role {
    /// The role that a header's name stands for, in any case, quoted or not.
    pub(super) fn named(name: &str) -> Self {
        let name = name.trim_matches(['"', '\'', ' ', '/', '#']).to_ascii_lowercase();
        match name.strip_prefix("scalar_").unwrap_or(&name) {
            "x" | "easting" | "longitude" | "lon" | "points:0" => Self::X,
            "y" | "northing" | "latitude" | "lat" | "points:1" => Self::Y,
            "z" | "elevation" | "altitude" | "height" | "alt" | "points:2" => Self::Z,
            "r" | "red" | "diffuse_red" => Self::Red,
            "g" | "green" | "diffuse_green" => Self::Green,
            "b" | "blue" | "diffuse_blue" => Self::Blue,
            "a" | "alpha" => Self::Alpha,
            "nx" | "normal_x" | "normalx" => Self::NormalX,
            "ny" | "normal_y" | "normaly" => Self::NormalY,
            "nz" | "normal_z" | "normalz" => Self::NormalZ,
            "radius" => Self::Radius,
            _ => Self::Field,
        }
    }

    /// Whether a column of this role is part of the position.
    pub(super) fn is_position(self) -> bool {
        matches!(self, Self::X | Self::Y | Self::Z)
    }
}

/// A column beside the position.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Kept {
    pub(super) role: Role,
    /// Name of a scalar field.
    pub(super) name: String,
}

impl Kept {
    /// The column that a header's name stands for.
    pub(super) fn named(name: &str) -> Kept {
        let bare = name.trim_matches(['"', '\'', ' ', '/', '#']);
        let name =
            if bare.eq_ignore_ascii_case("i") { INTENSITY.to_owned() } else { name_of(bare) };
        match Role::named(bare) {
            Role::Field => Kept::field(name),
            role => role.into(),
        }
    }

    /// Whether the column may hold text in place of numbers: its name has no known meaning.
    pub(super) fn is_optional(&self) -> bool {
        self.role == Role::Field && self.name != INTENSITY && self.name != CLASSIFICATION
    }

    fn field(name: impl Into<String>) -> Kept {
        Kept { role: Role::Field, name: name.into() }
    }
}

impl From<Role> for Kept {
    fn from(role: Role) -> Kept {
        Kept { role, name: String::new() }
    }
}

/// The columns of x, y and z, if all three are named.
pub(super) fn position(columns: &[Kept]) -> Option<[usize; 3]> {
    let find = |role| columns.iter().position(|column| column.role == role);
    Some([find(Role::X)?, find(Role::Y)?, find(Role::Z)?])
}

/// The meaning of the columns after x, y, z, from their content.
pub(super) fn by_content(columns: &[Vec<f64>]) -> Vec<Kept> {
    const NORMAL: [Role; 3] = [Role::NormalX, Role::NormalY, Role::NormalZ];
    const COLOR: [Role; 3] = [Role::Red, Role::Green, Role::Blue];
    let total = columns.len();
    let mut roles: Vec<Kept> = Vec::with_capacity(total);
    while roles.len() < total {
        let at = roles.len();
        let left = total - at;
        let has = |role| roles.iter().any(|kept| kept.role == role);
        let has_field = |name| roles.iter().any(|kept| kept.name == name);
        let triple = |at: usize| Triple::of(columns.get(at..at + 3));
        let here = triple(at);
        if here == Triple::Unit && !has(Role::NormalX) {
            roles.extend(NORMAL.map(Kept::from));
        } else if left % 3 == 1 && triple(at + 1).is_color() && !has_field(INTENSITY) {
            // PTS writes the intensity first, also where it would pass for a colour.
            roles.push(Kept::field(INTENSITY));
        } else if here.is_color() && !has(Role::Red) {
            roles.extend(COLOR.map(Kept::from));
        } else if here == Triple::Other && left == 3 && !has(Role::NormalX) {
            roles.extend(NORMAL.map(Kept::from));
        } else if !has_field(INTENSITY) {
            roles.push(Kept::field(INTENSITY));
        } else if !has_field(CLASSIFICATION) && is_whole(&columns[at], 255.0) {
            roles.push(Kept::field(CLASSIFICATION));
        } else {
            // Counted from 1, x, y and z included.
            roles.push(Kept::field(format!("column_{}", at + 4)));
        }
    }
    roles
}

/// Kind of three columns in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Triple {
    /// There are no three.
    None,
    /// Unit vectors (or a few zeros).
    Unit,
    /// Whole numbers in 0..=255.
    Bytes,
    /// Whole numbers in 0..=65535.
    Words,
    /// Fractions in 0..=1 that are no unit vectors.
    Fractions,
    Other,
}

impl Triple {
    fn of(columns: Option<&[Vec<f64>]>) -> Self {
        let Some([a, b, c]) = columns else { return Self::None };
        if is_unit(a, b, c) {
            return Self::Unit;
        }
        let all = |test: &dyn Fn(&Vec<f64>) -> bool| test(a) && test(b) && test(c);
        if all(&|column| is_whole(column, 255.0)) {
            Self::Bytes
        } else if all(&|column| is_whole(column, 65535.0)) {
            Self::Words
        } else if all(&|column| singles(column).all(|value| (0.0..=1.0).contains(&value))) {
            Self::Fractions
        } else {
            Self::Other
        }
    }

    fn is_color(self) -> bool {
        matches!(self, Self::Bytes | Self::Words | Self::Fractions)
    }
}

/// The numbers of a column in the precision of colours, normals and radii.
fn singles(column: &[f64]) -> impl Iterator<Item = f32> {
    column.iter().map(|&value| value as f32)
}

fn is_whole(column: &[f64], max: f32) -> bool {
    singles(column).all(|value| (0.0..=max).contains(&value) && value.fract() == 0.0)
}

/// Whether nearly all rows have length 1, apart from zero vectors, which mean "unknown".
fn is_unit(a: &[f64], b: &[f64], c: &[f64]) -> bool {
    let (mut unit, mut other) = (0u64, 0u64);
    for ((a, b), c) in singles(a).zip(singles(b)).zip(singles(c)) {
        let squared = a * a + b * b + c * c;
        if (squared - 1.0).abs() < 0.05 {
            unit += 1;
        } else if squared != 0.0 {
            other += 1;
        }
    }
    unit > 0 && other * 50 <= unit
}

/// The point cloud of kept columns with known roles.
pub(super) fn cloud(
    positions: Vec<DVec3>,
    columns: Vec<Vec<f64>>,
    kept: &[Kept],
    warnings: &mut Vec<String>,
) -> PointCloud {
    let count = positions.len();
    let column = |role| {
        let found = kept.iter().position(|kept| kept.role == role)?;
        columns.get(found).filter(|column| column.len() == count)
    };
    let triple = |a, b, c| Some([column(a)?, column(b)?, column(c)?]);
    let row = |columns: [&Vec<f64>; 3], point: usize| columns.map(|column| column[point] as f32);

    let rgb = triple(Role::Red, Role::Green, Role::Blue);
    let normal = triple(Role::NormalX, Role::NormalY, Role::NormalZ);
    let mut rgba = rgb.and_then(|rgb| colors(count, |point| row(rgb, point)));
    if let (Some(rgba), Some(alpha)) = (&mut rgba, column(Role::Alpha)) {
        let alpha = bytes(count, |point| [alpha[point] as f32; 3]);
        rgba.iter_mut().zip(alpha).for_each(|(color, [value, ..])| color[3] = value);
    }
    let radii = column(Role::Radius).map(|radii| singles(radii).collect::<Vec<f32>>());
    let radii = radii.filter(|radii| radii.iter().all(|&r| r > 0.0 && r.is_finite()));
    let normals = normal
        .map(|normal| (0..count).map(|point| unit_or_zero(row(normal, point))).collect::<Vec<_>>());
    let fields = kept.iter().zip(columns).filter(|(kept, _)| kept.role == Role::Field);
    let fields = fields.map(|(kept, column)| Column::of(&kept.name, Numbers::Doubles(column)));
    PointCloud {
        positions,
        colors: rgba,
        normals,
        fields: fields::encoded(fields.collect(), warnings),
        radii,
        oriented: false,
        kernels: None,
        clips: None,
    }
}
