//! Where nodes stand and how often: transforms and repeats.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::super::Repeat;
use super::super::wire::{NodeWire, OperandWire, RepeatWire, ScaleWire};
use super::{LARGEST_COORDINATE, LARGEST_SCALE, Place, Valid, coordinates, within};
use crate::json::whole::Whole;

/// The keys that move something, wherever they stand.
pub(super) struct TransformKeys {
    translate: Option<[f64; 3]>,
    rotate: Option<[f64; 3]>,
    quaternion: Option<[f64; 4]>,
    scale: Option<ScaleWire>,
    matrix: Option<[f64; 16]>,
}

impl From<&NodeWire> for TransformKeys {
    fn from(wire: &NodeWire) -> Self {
        let NodeWire { translate, rotate, quaternion, scale, matrix, .. } = *wire;
        Self { translate, rotate, quaternion, scale, matrix }
    }
}

impl From<&OperandWire> for TransformKeys {
    fn from(wire: &OperandWire) -> Self {
        let OperandWire { translate, rotate, quaternion, scale, matrix, .. } = *wire;
        Self { translate, rotate, quaternion, scale, matrix }
    }
}

pub(super) fn transform(wire: impl Into<TransformKeys>, place: Place<'_>) -> Valid<DAffine3> {
    let wire: TransformKeys = wire.into();
    if let Some(columns) = &wire.matrix {
        let others = [
            ("translate", wire.translate.is_some()),
            ("rotate", wire.rotate.is_some()),
            ("quaternion", wire.quaternion.is_some()),
            ("scale", wire.scale.is_some()),
        ];
        if let Some((other, _)) = others.iter().find(|(_, present)| *present) {
            return place.key(other).refuse("cannot stand beside `matrix`, which says it all");
        }
        return matrix(columns, place.key("matrix"));
    }
    let translation = match wire.translate {
        Some(v) => coordinates(v, place.key("translate"))?,
        None => DVec3::ZERO,
    };
    let rotation = match (wire.rotate, wire.quaternion) {
        (Some(_), Some(_)) => {
            return place.key("quaternion").refuse("cannot stand beside `rotate`");
        }
        (Some(angles), None) => rotation_from_degrees(angles, place.key("rotate"))?,
        (None, Some(q)) => rotation_from_quaternion(q, place.key("quaternion"))?,
        (None, None) => DMat3::IDENTITY,
    };
    let scale = match wire.scale {
        Some(wire) => scale(wire, place.key("scale"))?,
        None => DVec3::ONE,
    };
    Ok(DAffine3::from_mat3_translation(rotation * DMat3::from_diagonal(scale), translation))
}

fn matrix(columns: &[f64; 16], place: Place<'_>) -> Valid<DAffine3> {
    for (index, &number) in columns.iter().enumerate() {
        let largest = if index >= 12 { LARGEST_COORDINATE } else { LARGEST_SCALE };
        within(number, -largest, largest, place.index(index))?;
    }
    for (index, expected) in [(3, 0.0), (7, 0.0), (11, 0.0), (15, 1.0)] {
        if columns[index] != expected {
            let found = columns[index];
            return place.index(index).refuse(format!(
                "is {found}; the last row must be 0 0 0 1 (numbers go column by column)"
            ));
        }
    }
    let column = |i: usize| DVec3::new(columns[i], columns[i + 1], columns[i + 2]);
    let linear = DMat3::from_cols(column(0), column(4), column(8));
    if is_singular(&linear) {
        return place.refuse("flattens space: its determinant is zero");
    }
    Ok(DAffine3::from_mat3_translation(linear, column(12)))
}

/// Whether a map squeezes some direction to nothing, relative to its largest stretch.
fn is_singular(linear: &DMat3) -> bool {
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis].map(DVec3::length);
    let volume = x * y * z;
    volume.is_nan() || volume < 1e-27 || linear.determinant().abs() < 1e-12 * volume
}

/// Euler angles: about x first, then y, then z, each about the parent's axes.
fn rotation_from_degrees(angles: [f64; 3], place: Place<'_>) -> Valid<DMat3> {
    for (index, &angle) in angles.iter().enumerate() {
        within(angle, -1e6, 1e6, place.index(index))?;
    }
    let [x, y, z] = angles.map(sin_cos_degrees);
    let about_x = DMat3::from_cols(DVec3::X, DVec3::new(0.0, x.1, x.0), DVec3::new(0.0, -x.0, x.1));
    let about_y = DMat3::from_cols(DVec3::new(y.1, 0.0, -y.0), DVec3::Y, DVec3::new(y.0, 0.0, y.1));
    let about_z = DMat3::from_cols(DVec3::new(z.1, z.0, 0.0), DVec3::new(-z.0, z.1, 0.0), DVec3::Z);
    Ok(about_z * about_y * about_x)
}

/// Sine and cosine, exact at multiples of 90°, where scenes have most of their angles.
fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let turn = degrees.rem_euclid(360.0);
    match turn {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turn.to_radians().sin_cos(),
    }
}

fn rotation_from_quaternion(numbers: [f64; 4], place: Place<'_>) -> Valid<DMat3> {
    for (index, &number) in numbers.iter().enumerate() {
        within(number, -1e6, 1e6, place.index(index))?;
    }
    let q = DQuat::from_array(numbers);
    if q.length() < 1e-9 {
        return place.refuse("is zero, which is no rotation; [0, 0, 0, 1] turns nothing");
    }
    Ok(DMat3::from_quat(q * (1.0 / q.length())))
}

fn scale(wire: ScaleWire, place: Place<'_>) -> Valid<DVec3> {
    let check = |factor: f64, place: Place<'_>| {
        if factor.abs() < 1.0 / LARGEST_SCALE {
            return place.refuse("flattens space; it must not be zero");
        }
        within(factor, -LARGEST_SCALE, LARGEST_SCALE, place)
    };
    match wire {
        ScaleWire::Uniform(factor) => Ok(DVec3::splat(check(factor, place)?)),
        ScaleWire::Axes(factors) => {
            for (index, &factor) in factors.iter().enumerate() {
                check(factor, place.index(index))?;
            }
            Ok(DVec3::from_array(factors))
        }
    }
}

pub(super) fn repeat(wire: &RepeatWire, place: Place<'_>) -> Valid<Repeat> {
    let (own, foreign): (&str, [(&str, bool); 5]) = match (wire.grid, wire.scatter) {
        (Some(_), Some(_)) => {
            return place.refuse("has both `grid` and `scatter`; only one can be");
        }
        (None, None) => {
            return place.refuse("needs `grid` (with `step`) or `scatter` (with `half_extent`)");
        }
        (Some(_), None) => (
            "grid",
            [
                ("half_extent", wire.half_extent.is_some()),
                ("scale", wire.scale.is_some()),
                ("turn", wire.turn.is_some()),
                ("seed", wire.seed.is_some()),
                ("", false),
            ],
        ),
        (None, Some(_)) => (
            "scatter",
            [("step", wire.step.is_some()), ("", false), ("", false), ("", false), ("", false)],
        ),
    };
    if let Some((key, _)) = foreign.iter().find(|(_, present)| *present) {
        return place.key(key).refuse(format!("means nothing beside `{own}`"));
    }
    if let Some(counts) = wire.grid {
        return grid(counts.map(|Whole(count)| count), wire.step, place);
    }
    let count = wire.scatter.unwrap_or(0);
    if count == 0 {
        return place.key("scatter").refuse("must be at least 1");
    }
    let Some(half_extent) = wire.half_extent else {
        return place
            .refuse("`scatter` needs `half_extent`, half the edges of the box to strew in");
    };
    let half_extent = coordinates(half_extent, place.key("half_extent"))?;
    for axis in 0..3 {
        within(half_extent[axis], 0.0, LARGEST_COORDINATE, place.key("half_extent").index(axis))?;
    }
    let scale = wire.scale.unwrap_or([1.0, 1.0]);
    for (index, &factor) in scale.iter().enumerate() {
        within(factor, 1.0 / LARGEST_SCALE, LARGEST_SCALE, place.key("scale").index(index))?;
    }
    if scale[0] > scale[1] {
        return place.key("scale").refuse("the smallest comes first");
    }
    let (turn, seed) = (wire.turn.unwrap_or(false), wire.seed.unwrap_or(0));
    Ok(Repeat::Scatter { count, half_extent, scale, turn, seed })
}

fn grid(counts: [u32; 3], step: Option<[f64; 3]>, place: Place<'_>) -> Valid<Repeat> {
    for (axis, &count) in counts.iter().enumerate() {
        if count == 0 {
            return place.key("grid").index(axis).refuse("must be at least 1");
        }
    }
    let Some(step) = step else {
        return place.refuse("`grid` needs `step`, the distance between neighbours");
    };
    let step = coordinates(step, place.key("step"))?;
    for axis in 0..3 {
        if (step[axis] * f64::from(counts[axis])).abs() > LARGEST_COORDINATE {
            return place.key("step").index(axis).refuse("the grid would reach too far out");
        }
    }
    Ok(Repeat::Grid { counts, step })
}
