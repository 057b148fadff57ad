//! Up to two clip lines that stand for all edges which a disk crosses.

use glam::DVec2;

use super::edges::Sharp;
use crate::assets::{Clip, ClipLine};

/// Maximum length by which a disk may jut out or fall short, in radii of the disk.
const TOLERANCE: f64 = 0.04;
/// Lines reach this much (in standard deviations) beyond their edge, so that both sides meet whatever the rounding.
const OVERLAP: f64 = 1e-4;

/// Lines in the plane of the kernel's axes, in mesh units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lines {
    lines: [Option<(DVec2, f64)>; 2],
    either: bool,
}

/// The lines at which a disk of `radius` ends, or `None` if it takes more than two and is not the `last` try.
///
/// The nearest edge gives the first line. Edges that lie behind it, or on it (a straight or slightly curved edge in pieces), need
/// none. The nearest of the others gives the second; both lines have to keep (a convex corner). Where no other is left, but an
/// edge leads from the first one's end to the region behind the line, the face goes on there: a reflex corner, where either line
/// may keep.
pub(super) fn choose(edges: &[Sharp], radius: f64, last: bool) -> Option<Lines> {
    let slack = TOLERANCE * radius;
    let crossed: Vec<(&Sharp, [DVec2; 2])> = edges
        .iter()
        .take_while(|edge| edge.distance < radius)
        .filter_map(|edge| Some((edge, within(edge.ends, radius)?)))
        .collect();
    let keeps_centre = |edge: &Sharp| edge.offset <= 1e-9 * radius;
    let value = |edge: &Sharp, at: DVec2| edge.normal.dot(at) - edge.offset;
    let Some(&(first, part)) = crossed.iter().find(|(edge, _)| keeps_centre(edge)) else {
        return (crossed.is_empty() || last).then(Lines::default);
    };
    // Only an edge that runs the same way may lie a little before a line: the far side of a needle is an edge of its own.
    let behind = |edge: &Sharp, other: &Sharp, part: [DVec2; 2]| {
        let slack = if edge.normal.dot(other.normal) > 0.5 { slack } else { 1e-6 * radius };
        part.iter().all(|&at| value(edge, at) <= slack)
    };
    let open = |&&(other, part): &&(&Sharp, [DVec2; 2])| !behind(first, other, part);
    let line = |edge: &Sharp| Some((edge.normal, edge.offset));
    let Some(&(second, _)) = crossed.iter().filter(open).find(|(edge, _)| keeps_centre(edge))
    else {
        if !last && crossed.iter().any(|crossed| open(&crossed)) {
            return None;
        }
        let reflex = crossed.iter().find(|(other, others)| {
            other.places.iter().any(|place| first.places.contains(place))
                && others.iter().any(|&at| value(first, at) < -slack)
                && part.iter().all(|&at| value(other, at) <= slack)
                && part.iter().any(|&at| value(other, at) < -slack)
        });
        let lines = [line(first), reflex.and_then(|(other, _)| line(other))];
        return Some(Lines { lines, either: reflex.is_some() });
    };
    let is_left = crossed.iter().filter(open).any(|&(other, part)| !behind(second, other, part));
    (last || !is_left).then(|| Lines { lines: [line(first), line(second)], either: false })
}

/// The part of a segment in a disk about the origin.
fn within([a, b]: [DVec2; 2], radius: f64) -> Option<[DVec2; 2]> {
    let along = b - a;
    let square = along.length_squared();
    let nearest = -a.dot(along) / square;
    let half = ((radius * radius - (a + along * nearest).length_squared()) / square).sqrt();
    if half.is_nan() {
        return None;
    }
    let ends = [(nearest - half).clamp(0.0, 1.0), (nearest + half).clamp(0.0, 1.0)];
    (ends[0] < ends[1]).then(|| ends.map(|part| a + along * part))
}

/// Lines in units of the kernel.
pub(super) fn in_kernel(lines: &Lines, deviation: f64) -> Clip {
    Clip {
        lines: lines.lines.map(|line| {
            line.map(|(normal, offset)| ClipLine {
                normal: normal.as_vec2(),
                offset: (offset / deviation - OVERLAP) as f32,
            })
        }),
        either: lines.either,
    }
}
