//! Cuts one sample: keeps all of it, nothing, or a part behind clip lines.

use glam::{DVec2, Vec2};

use super::surface::{Local, Plane, Surface};
use super::{CUTOFF, Rule, Sample};
use crate::assets::{Clip, ClipLine};

/// Steps along the sample's tangent plane to the place where it meets the other surface.
const STEPS: usize = 3;
/// Sine of the angle below which two planes count as parallel (3°).
const PARALLEL: f64 = 0.052;
/// Parallel planes nearer than this, in radii, are one.
const COINCIDENT: f64 = 0.05;
/// Minimum distance, in radii, that a kept part must reach beyond the other surface. It removes slivers that rounding leaves
/// along an edge that both solids share.
const SLIVER: f64 = 0.01;
/// Points along each axis of the grid on which ways of clipping a disk are compared.
const GRID: usize = 21;

/// The sample as far as `rule` keeps it against the other surface.
pub(super) fn keep(sample: &Sample, other: &Surface, rule: Rule) -> Option<Sample> {
    let radius = sample.radius();
    let whole = |inside: bool| (inside == rule.keep_inside).then_some(*sample);
    if !other.may_reach(sample.position, radius) {
        return whole(false);
    }
    let local = other.local(sample.position, radius)?;
    if local.distance > 1.5 * radius {
        return whole(local.value(|face| local.faces[face].plane.distance(sample.position)) < 0.0);
    }
    let sides: Vec<Side> = local
        .faces
        .iter()
        .map(|face| side(sample, radius, other, (face.plane, face.seed), rule))
        .collect();
    clip(sample, &local, &sides, rule)
}

/// A face of the other solid as seen in the sample's tangent plane: its signed distance, by kernel coordinates.
#[derive(Clone, Copy, Debug)]
enum Side {
    /// Parallel planes: the same everywhere.
    Everywhere(f64),
    /// `slope · (s, t) + height`.
    Across { slope: DVec2, height: f64 },
}

impl Side {
    fn at(&self, kernel: Vec2) -> f64 {
        match *self {
            Side::Everywhere(distance) => distance,
            Side::Across { slope, height } => slope.dot(kernel.as_dvec2()) + height,
        }
    }

    /// The line along which the sample is cut, if it meets the disk.
    fn line(&self, keep_inside: bool) -> Option<ClipLine> {
        let Side::Across { slope, height } = *self else { return None };
        let length = slope.length();
        let sign = if keep_inside { -1.0 } else { 1.0 };
        let (normal, offset) = (slope * (sign / length), -sign * height / length);
        let usable = normal.is_finite() && offset.abs() < CUTOFF;
        usable.then(|| ClipLine { normal: normal.as_vec2(), offset: offset as f32 })
    }
}

/// Follows a face to where the sample's tangent plane meets it.
fn side(
    sample: &Sample,
    radius: f64,
    other: &Surface,
    (mut plane, seed): (Plane, usize),
    rule: Rule,
) -> Side {
    let mut at = sample.position;
    for step in 0..=STEPS {
        let across = plane.normal - sample.normal * plane.normal.dot(sample.normal);
        if across.length() < PARALLEL {
            // On a curved face, only where it is met counts.
            if step == 0 {
                return parallel(sample, radius, &plane, rule);
            }
            break;
        }
        let next = at - across * (plane.distance(at) / across.length_squared());
        // Beyond the disk no line is drawn, and the face need not be as it looks from here.
        if step == STEPS || next.distance(sample.position) > 1.5 * radius {
            break;
        }
        at = next;
        plane = other.follow(at, seed);
    }
    let slope = DVec2::new(plane.normal.dot(sample.u), plane.normal.dot(sample.v));
    Side::Across { slope, height: plane.distance(sample.position) }
}

fn parallel(sample: &Sample, radius: f64, plane: &Plane, rule: Rule) -> Side {
    let distance = plane.distance(sample.position);
    if distance.abs() > COINCIDENT * radius {
        return Side::Everywhere(distance);
    }
    let same = plane.normal.dot(sample.normal) > 0.0;
    let keep = if same { rule.keep_same } else { rule.keep_opposite };
    // The sample is treated as if it lay on the side that the rule keeps, or on the side that it drops.
    Side::Everywhere(if keep == rule.keep_inside { -radius } else { radius })
}

/// Clips with up to two lines, choosing the way that comes nearest to the part to be kept.
fn clip(sample: &Sample, local: &Local, sides: &[Side], rule: Rule) -> Option<Sample> {
    let value = |kernel: Vec2| local.value(|face| sides[face].at(kernel));
    let inside = |kernel: Vec2| value(kernel) < 0.0;
    let well_kept = |kernel: Vec2| {
        let depth = if rule.keep_inside { -value(kernel) } else { value(kernel) };
        sample.clip.keeps(kernel) && depth > SLIVER * sample.radius()
    };
    if !grid().any(well_kept) {
        return None;
    }
    let wanted: Vec<(Vec2, bool)> =
        grid().map(|at| (at, sample.clip.keeps(at) && inside(at) == rule.keep_inside)).collect();
    let own = sample.clip.lines.iter().flatten().copied();
    let lines: Vec<ClipLine> =
        own.chain(sides.iter().filter_map(|side| side.line(rule.keep_inside))).collect();
    let error = |clip: &Clip| -> f32 {
        let wrong = wanted.iter().filter(|&&(at, kept)| clip.keeps(at) != kept);
        wrong.map(|(at, _)| (-0.5 * at.length_squared()).exp()).sum()
    };
    let mut best = (error(&sample.clip), sample.clip);
    let mut offer = |lines: [Option<ClipLine>; 2], either: bool| {
        let clip = Clip { lines, either };
        let found = error(&clip);
        // Ties go to the later: a line that only grazes the disk between the grid's points still cuts it.
        if found <= best.0 {
            best = (found, clip);
        }
    };
    offer([None; 2], false);
    for (index, &a) in lines.iter().enumerate() {
        offer([Some(a), None], false);
        for &b in &lines[..index] {
            offer([Some(b), Some(a)], true);
            offer([Some(b), Some(a)], false);
        }
    }
    Some(Sample { clip: best.1, ..*sample })
}

/// Points all over the disk, in kernel coordinates.
fn grid() -> impl Iterator<Item = Vec2> {
    let coordinate = |i: usize| CUTOFF as f32 * (2.0 * i as f32 / (GRID - 1) as f32 - 1.0);
    (0..GRID * GRID)
        .map(move |i| Vec2::new(coordinate(i % GRID), coordinate(i / GRID)))
        .filter(|at| at.length() <= CUTOFF as f32)
}
