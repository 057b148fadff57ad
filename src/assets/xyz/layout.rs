//! What the columns of a text point cloud mean.

use glam::DVec3;

use super::PointCloud;
use crate::assets::points::{bytes, class_of, colors, intensities, unit_or_zero};

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
    Intensity,
    Class,
    Radius,
    Unknown,
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
            "i" | "intensity" | "reflectance" => Self::Intensity,
            "class" | "classification" | "label" => Self::Class,
            "radius" => Self::Radius,
            _ => Self::Unknown,
        }
    }

    /// Whether a column of this role is stored beside the position.
    pub(super) fn is_kept(self) -> bool {
        !matches!(self, Self::X | Self::Y | Self::Z | Self::Unknown)
    }
}

/// The columns of x, y and z, if all three are named.
pub(super) fn position(roles: &[Role]) -> Option<[usize; 3]> {
    let find = |role| roles.iter().position(|&r| r == role);
    Some([find(Role::X)?, find(Role::Y)?, find(Role::Z)?])
}

/// The roles of the columns after x, y, z, from what they hold.
pub(super) fn by_content(columns: &[Vec<f32>]) -> Vec<Role> {
    const NORMAL: [Role; 3] = [Role::NormalX, Role::NormalY, Role::NormalZ];
    const COLOR: [Role; 3] = [Role::Red, Role::Green, Role::Blue];
    let total = columns.len();
    let mut roles: Vec<Role> = Vec::with_capacity(total);
    while roles.len() < total {
        let at = roles.len();
        let left = total - at;
        let has = |role| roles.contains(&role);
        let triple = |at: usize| Triple::of(columns.get(at..at + 3));
        let here = triple(at);
        if here == Triple::Unit && !has(Role::NormalX) {
            roles.extend(NORMAL);
        } else if left % 3 == 1 && triple(at + 1).is_color() && !has(Role::Intensity) {
            // PTS writes the intensity first, also where it would pass for a colour.
            roles.push(Role::Intensity);
        } else if here.is_color() && !has(Role::Red) {
            roles.extend(COLOR);
        } else if here == Triple::Other && left == 3 && !has(Role::NormalX) {
            roles.extend(NORMAL);
        } else if !has(Role::Intensity) {
            roles.push(Role::Intensity);
        } else if !has(Role::Class) && is_whole(&columns[at], 255.0) {
            roles.push(Role::Class);
        } else {
            roles.push(Role::Unknown);
        }
    }
    roles
}

/// What three columns in a row may be.
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
    fn of(columns: Option<&[Vec<f32>]>) -> Self {
        let Some([a, b, c]) = columns else { return Self::None };
        if is_unit(a, b, c) {
            return Self::Unit;
        }
        let all = |test: &dyn Fn(&Vec<f32>) -> bool| test(a) && test(b) && test(c);
        if all(&|column| is_whole(column, 255.0)) {
            Self::Bytes
        } else if all(&|column| is_whole(column, 65535.0)) {
            Self::Words
        } else if all(&|column| column.iter().all(|value| (0.0..=1.0).contains(value))) {
            Self::Fractions
        } else {
            Self::Other
        }
    }

    fn is_color(self) -> bool {
        matches!(self, Self::Bytes | Self::Words | Self::Fractions)
    }
}

fn is_whole(column: &[f32], max: f32) -> bool {
    column.iter().all(|&value| (0.0..=max).contains(&value) && value.fract() == 0.0)
}

/// Whether nearly all rows have length 1, apart from zero vectors, which mean "unknown".
fn is_unit(a: &[f32], b: &[f32], c: &[f32]) -> bool {
    let (mut unit, mut other) = (0u64, 0u64);
    for ((a, b), c) in a.iter().zip(b).zip(c) {
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
pub(super) fn cloud(positions: Vec<DVec3>, columns: &[Vec<f32>], roles: &[Role]) -> PointCloud {
    let count = positions.len();
    let column = |role| {
        let found = roles.iter().position(|&r| r == role)?;
        columns.get(found).filter(|column| column.len() == count)
    };
    let triple = |a, b, c| Some([column(a)?, column(b)?, column(c)?]);
    let row = |[a, b, c]: [&Vec<f32>; 3], point: usize| [a[point], b[point], c[point]];

    let rgb = triple(Role::Red, Role::Green, Role::Blue);
    let normal = triple(Role::NormalX, Role::NormalY, Role::NormalZ);
    let mut rgba = rgb.and_then(|rgb| colors(count, |point| row(rgb, point)));
    if let (Some(rgba), Some(alpha)) = (&mut rgba, column(Role::Alpha)) {
        let alpha = bytes(count, |point| [alpha[point]; 3]);
        rgba.iter_mut().zip(alpha).for_each(|(color, [value, ..])| color[3] = value);
    }
    let radius =
        column(Role::Radius).filter(|radii| radii.iter().all(|&r| r > 0.0 && r.is_finite()));
    PointCloud {
        positions,
        colors: rgba,
        normals: normal
            .map(|normal| (0..count).map(|point| unit_or_zero(row(normal, point))).collect()),
        intensity: column(Role::Intensity).and_then(|values| intensities(values)),
        classification: column(Role::Class)
            .map(|labels| labels.iter().map(|&label| class_of(f64::from(label))).collect()),
        radii: radius.cloned(),
        oriented: false,
        kernels: None,
        clips: None,
    }
}
