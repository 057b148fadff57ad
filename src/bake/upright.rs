//! Guesses which way is up in a file that does not say.
//!
//! Each of the six axis directions collects weighted evidence, and the best direction wins. The evidence comes from the file's
//! format and from the asset's [`Shape`], which [`Shape::of`] measures on a few thousand samples of its surface. The "end" of a
//! direction is the end of the asset that would be at the bottom.
//!
//! | evidence for a direction | weight |
//! |---|---|
//! | glTF, whose specification says +y | 9 for +y |
//! | survey formats (LAS, LAZ and so COPC, PTX), and tracts (TCK, TRK, TRX), whose z leads from the feet to the head | 2 for +z |
//! | coordinates of a national or world-wide grid | 2.5 for +z |
//! | E57; XYZ with PTS, CSV and TSV, PCD, STL; PLY, OBJ, OFF | 1.0; 0.7; 0.2 for +z and 0.2; 0.2; 0.7 for +y |
//! | the asset stands on this end: wide support below its centre of mass | up to 1.8 |
//! | the asset stands on the other end | down to −0.8 |
//! | this end is flat | up to 0.9, down to −0.5 where the other end is |
//! | the surface is open at this end, as scans of statues are | up to ±0.8 |
//! | the centre of mass is low | up to ±0.3 |
//! | the asset stands on a stem, as trees do | up to 1.0 |
//! | the asset is a mirror image of itself along this axis alone: left and right | down to −1.2 |
//! | the asset is alike along both other axes, but not along this one: round things | up to 0.8 |
//! | the asset is thinnest this way | up to 1.0 for points, 0.5 for meshes |
//! | the asset has no thickness this way: a drawing | −2 |
//! | the direction is −x, −y or −z | −0.7 |
//! | the direction is x or −x | −0.8 |
//!
//! A negative direction must be better than every positive one by [`CLEARLY`]: few files are upside down.

mod lightness;
mod parts;
mod shape;

use glam::DVec3;

pub use self::shape::{End, Shape};
use crate::math::Bounds;

#[cfg(test)]
mod tests;

/// By how much a negative direction must be better than the best positive one.
const CLEARLY: f64 = 1.5;
/// Evidence of less weight is not mentioned.
const WORTH_MENTIONING: f64 = 0.25;
const NAMES: [&str; 3] = ["x", "y", "z"];

/// The direction that is taken for up, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Guess {
    pub up: DVec3,
    /// The evidence that weighed most, in words.
    pub because: String,
}

/// One piece of evidence for a direction.
type Evidence = (f64, String);

/// Guesses the up of a file of this format. `shape` is missing where there is too little to measure.
pub fn guess(format: &str, bounds: &Bounds, shape: Option<&Shape>) -> Guess {
    let mut best: Option<(f64, usize, usize, Vec<Evidence>)> = None;
    // Positive directions come first, and ties go to y, then z.
    for (end, axis) in [(0, 1), (0, 2), (0, 0), (1, 1), (1, 2), (1, 0)] {
        let mut evidence = custom(format, axis, end);
        if end == 0 && axis == 2 && is_georeferenced(format, bounds) {
            evidence.push((2.5, "its coordinates are those of a survey grid".to_owned()));
        }
        if let Some(shape) = shape {
            evidence.extend(of_shape(shape, axis, end));
        }
        let sum: f64 = evidence.iter().map(|(weight, _)| weight).sum();
        let needed = if end == 1 { CLEARLY } else { 0.0 };
        if best.as_ref().is_none_or(|(most, _, before, _)| {
            sum > most + if *before == end { 0.0 } else { needed }
        }) {
            best = Some((sum, axis, end, evidence));
        }
    }
    let Some((_, axis, end, mut evidence)) = best else {
        return Guess { up: DVec3::Y, because: String::new() };
    };
    evidence.retain(|(weight, _)| *weight >= WORTH_MENTIONING);
    evidence.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    evidence.truncate(3);
    let because = match evidence[..] {
        [] => "nothing tells another direction".to_owned(),
        _ => evidence.into_iter().map(|(_, words)| words).collect::<Vec<_>>().join("; "),
    };
    Guess { up: DVec3::AXES[axis] * if end == 0 { 1.0 } else { -1.0 }, because }
}

/// Evidence from what files of a format usually have.
fn custom(format: &str, axis: usize, end: usize) -> Vec<Evidence> {
    let mut evidence = Vec::new();
    let mut add = |weight: f64, words: String| evidence.push((weight, words));
    if end == 1 {
        add(-0.7, String::new());
    }
    if axis == 0 {
        add(-0.8, String::new());
    }
    if axis == 0 || end == 1 {
        return evidence;
    }
    let [y, z] = match format {
        "glb" | "gltf" => [9.0, 0.0],
        "las" | "laz" | "ptx" | "tck" | "trk" | "trx" => [0.0, 2.0],
        "e57" => [0.2, 1.0],
        "xyz" | "pcd" | "stl" => [0.2, 0.7],
        _ => [0.7, 0.2],
    };
    let weight = if axis == 1 { y } else { z };
    let how = if weight >= 2.0 { "" } else { "usually " };
    add(weight, format!("{} files {how}have {} up", format.to_uppercase(), NAMES[axis]));
    evidence
}

/// Coordinates of a national or world-wide grid: x and y count from far away, and the land is flatter than it is wide.
fn is_georeferenced(format: &str, bounds: &Bounds) -> bool {
    let (centre, extent) = (bounds.centre(), bounds.extent());
    !format.starts_with("gl")
        && centre.truncate().abs().min_element() > 50_000.0
        && extent.truncate().max_element() > extent.z
        && extent.max_element() < centre.truncate().abs().max_element()
}

/// Rises smoothly from 0 at `low` to 1 at `high`.
fn ramp(value: f64, low: f64, high: f64) -> f64 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Score of how well the asset stands on an end, 0 to 1.
fn stands(end: &End) -> f64 {
    (end.footprint / 0.5).min(1.0) * firmness(end)
}

/// Score of how flat an end is on which the asset stands, 0 to 1.
fn flatness(end: &End) -> f64 {
    (end.flat_footprint / 0.4).min(1.0) * ramp(end.flat, 0.002, 0.02) * firmness(end)
}

/// Measures how well the centre of mass lies above a support of some substance, 0 to 1.
fn firmness(end: &End) -> f64 {
    ramp(end.balance, 0.0, 0.1) * ramp(end.tilt, 0.03, 0.12) * ramp(end.contact, 0.006, 0.015)
}

fn of_shape(shape: &Shape, axis: usize, end: usize) -> Vec<Evidence> {
    let (here, there) = (&shape.ends[axis][end], &shape.ends[axis][1 - end]);
    let mut evidence = Vec::new();
    let mut add = |weight: f64, words: String| evidence.push((weight, words));
    let standing = stands(here);
    let percent = (here.footprint * 100.0).round();
    add(
        1.8 * standing - 0.8 * stands(there),
        format!("it stands on this end, on {percent} % of its outline"),
    );
    add(0.9 * flatness(here) - 0.5 * flatness(there), "this end is flat".to_owned());
    let opening = (4.0 * here.opening).clamp(-0.8, 0.8) * (0.3 + 0.7 * standing);
    add(opening, "its surface is open at this end".to_owned());
    let low = 0.3 * ((0.5 - here.centroid_height) * 5.0).clamp(-1.0, 1.0);
    add(low, "its centre of mass is low".to_owned());
    let is_narrow = 1.0 - ramp(here.footprint, 0.005, 0.03);
    let is_below_centre = 1.0 - ramp(-here.balance, 0.03, 0.12);
    let is_wide_above = ramp(stands(there) + there.footprint, 0.1, 0.3);
    add(is_narrow * is_below_centre * is_wide_above, "it stands on a stem".to_owned());
    let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
    let own = shape.symmetry[axis];
    let (more, less) =
        (shape.symmetry[a].max(shape.symmetry[b]), shape.symmetry[a].min(shape.symmetry[b]));
    add(-1.2 * ramp(own - more, 0.1, 0.4) * ramp(own, 0.4, 0.8), String::new());
    let round = 0.8 * ramp(less - own, 0.1, 0.4) * ramp(less, 0.5, 0.8);
    add(round, "it is alike on all sides about this axis".to_owned());
    let extent = shape.extent[axis];
    if extent < 1e-6 {
        add(-2.0, String::new());
    } else if extent <= shape.extent[a].min(shape.extent[b]) {
        let ratio = shape.extent[a].min(shape.extent[b]) / extent;
        let weight = if shape.is_cloud { 1.0 } else { 0.5 };
        add(weight * ramp(ratio, 2.0, 6.0), "it is flattest this way".to_owned());
    }
    evidence
}
