//! Picks of lines: where a pixel's ray meets a tube or a ribbon, and which place of the file's strand is there.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::{Element, HitKind, PickedStrand, Tint, base, linear};
use crate::bake::pack::{NO_NORMAL, PackedChunk, PackedField, PackedLines, octahedral_decode};
use crate::math::Tube;

/// The vertices of strands as the file has them, by the number of the strand, in the axes of the geometry.
pub(super) type Strands = HashMap<u32, Vec<DVec3>>;

/// The segments that a frame draws.
#[derive(Clone, Copy)]
pub(super) enum Detail<'s> {
    /// The frame draws the segments of the file.
    Full,
    /// The frame draws segments of levels of detail, each for a run or a part of the file's segments. The strands are those of the file; a
    /// segment whose strand is not among them has no place.
    Levels(Option<&'s Strands>),
}

/// Returns the point of a segment where a ray from the eye meets it. Thin lines are drawn wider than they are: a ray that misses a tube gets the
/// nearest point of its axis, and a ray that misses a ribbon a point of the ribbon beside the ray.
pub(super) fn segment(
    lines: &PackedLines,
    (record, index): (&PackedChunk, usize),
    world: &DAffine3,
    (origin, way): (DVec3, DVec3),
    tint: Tint,
    detail: Detail,
) -> Option<Element> {
    let ends = lines.ends(record, index)?;
    let axes = world.matrix3;
    let stretch = axes.x_axis.length().max(axes.y_axis.length()).max(axes.z_axis.length());
    let tube = Tube {
        ends: ends.map(|end| world.transform_point3(end.position)),
        radii: ends.map(|end| end.radius * stretch),
    };
    let is_ribbon = ends.iter().any(|end| end.normal != NO_NORMAL);
    let surface = if is_ribbon {
        let sides = ends.map(|end| {
            let side = axes * octahedral_decode(end.side).as_dvec3();
            side.normalize_or_zero() * (end.radius * stretch)
        });
        Some(meet_ribbon(&tube, sides, (origin, way)))
    } else {
        let entry = tube.enter(origin, way).filter(|found| found.at > 0.0);
        entry.map(|entry| (origin + way * entry.at, entry.share))
    };
    let share = surface.map_or_else(|| tube.nearest_share(origin, way), |(_, share)| share);
    let on_axis = ends[0].position.lerp(ends[1].position, share);
    let back = world.inverse();
    let local = match surface {
        Some((place, _)) if back.is_finite() => back.transform_point3(place),
        _ => on_axis,
    };
    let normals = ends.map(|end| octahedral_decode(end.normal).as_dvec3());
    let colors = ends.map(|end| linear(end.color));
    let (strand, first) = lines.strand_of(index)?;
    let place = match detail {
        Detail::Full => Some((first, share)),
        Detail::Levels(strands) => strands.and_then(|strands| {
            along(strands.get(&strand)?, first, (on_axis, ends[1].position), lines.grid.step)
        }),
    };
    Some(Element {
        kind: HitKind::Segment,
        local,
        normal: if is_ribbon { normals[0].lerp(normals[1], share) } else { local - on_axis },
        color: colors[0].lerp(colors[1], share) * base(tint.unwrap_or([1.0; 4])),
        fields: fields(lines, record, index, share),
        strand: place.map(|(vertex, share)| PickedStrand { index: strand, vertex, share }),
    })
}

/// Returns the values of scalar fields at a share of the way along a segment.
fn fields(
    lines: &PackedLines,
    record: &PackedChunk,
    index: usize,
    share: f64,
) -> BTreeMap<String, f64> {
    let Some(values) = lines.end_values(record, index) else { return BTreeMap::new() };
    let value =
        |field: &PackedField| Some((field.name().to_owned(), field.between(values, share)?));
    lines.fields.iter().filter_map(value).collect()
}

/// Returns the point where a ray meets a ribbon, and its share of the way along the segment. `tube` has the ends of the segment; `sides` are
/// half the widths there.
fn meet_ribbon(
    tube: &Tube,
    [side_a, side_b]: [DVec3; 2],
    (origin, way): (DVec3, DVec3),
) -> (DVec3, f64) {
    let [a, b] = tube.ends;
    // The triangles that the renderer draws, with the share of the segment at each corner.
    let triangles = [
        ([a - side_a, a + side_a, b + side_b], [0.0, 0.0, 1.0]),
        ([a - side_a, b + side_b, b - side_b], [0.0, 1.0, 1.0]),
    ];
    for (corners, shares) in triangles {
        if let Some(weights) = weights(corners.map(|corner| corner - origin), way) {
            let place = corners.into_iter().zip(weights).map(|(corner, w)| corner * w).sum();
            let share: f64 = shares.into_iter().zip(weights).map(|(share, w)| share * w).sum();
            return (place, share);
        }
    }
    let share = tube.nearest_share(origin, way);
    let (middle, side) = (a.lerp(b, share), side_a.lerp(side_b, share));
    let [left, right] = [middle - side, middle + side];
    let across = Tube { ends: [left, right], radii: [0.0; 2] };
    (left.lerp(right, across.nearest_share(origin, way)), share)
}

/// Returns the barycentric coordinates of the point where a ray meets a triangle, whose corners are relative to the ray's origin; `None` where the
/// ray misses it.
fn weights([a, b, c]: [DVec3; 3], way: DVec3) -> Option<[f64; 3]> {
    // b × c = b × (c − b), with less cancellation for a small triangle far away.
    let volumes = [b.cross(c - b), c.cross(a - c), a.cross(b - a)].map(|plane| way.dot(plane));
    let sum: f64 = volumes.iter().sum();
    let weights = volumes.map(|volume| volume / sum);
    let place = a * weights[0] + b * weights[1] + c * weights[2];
    // Comparisons with not-a-number are false: a triangle that is seen edge-on is missed.
    let is_met = weights.iter().all(|&weight| weight >= 0.0) && place.dot(way) > 0.0;
    is_met.then_some(weights)
}

/// Returns the vertices of the wanted strands. `lines` are at full detail.
///
/// Segments are sorted by place, so those of a strand may lie in any chunk. Chunks are searched in parallel. A segment whose number lies before
/// or behind all wanted strands is dismissed without a search.
pub(super) fn strands(lines: &PackedLines, wanted: &BTreeSet<u32>) -> Strands {
    // The number of each wanted strand, and the numbers of its vertices; both ascend, as in the file.
    let spans: Vec<(u32, Range<u32>)> = wanted
        .iter()
        .filter_map(|&strand| {
            let [first, end] = *lines.strands.get(strand as usize..)?.first_chunk::<2>()?;
            Some((strand, first..end))
        })
        .collect();
    let (Some((_, first)), Some((_, last))) = (spans.first(), spans.last()) else {
        return Strands::new();
    };
    let all = first.start..last.end;
    // The index of the wanted strand of a segment.
    let strand_of = |number: u32| {
        let after = spans.partition_point(|(_, span)| span.start <= number);
        let before = after.checked_sub(1)?;
        spans.get(before).is_some_and(|(_, span)| span.contains(&number)).then_some(before)
    };
    let of_chunk = |chunk: &PackedChunk| -> Vec<(usize, u32, [DVec3; 2])> {
        let found = chunk.elements().filter_map(|segment| {
            let &[_, number] = lines.segments.get(segment)?;
            if !all.contains(&number) {
                return None;
            }
            let strand = strand_of(number)?;
            Some((strand, number, lines.ends(chunk, segment)?.map(|end| end.position)))
        });
        found.collect()
    };
    let found: Vec<_> = lines.chunks.par_iter().map(of_chunk).collect();
    let mut vertices: Vec<Vec<DVec3>> =
        spans.iter().map(|(_, span)| vec![DVec3::NAN; span.len()]).collect();
    for (strand, number, ends) in found.into_iter().flatten() {
        let at = (number - spans[strand].1.start) as usize;
        if let Some(pair) = vertices[strand].get_mut(at..at + 2) {
            pair.copy_from_slice(&ends);
        }
    }
    spans.into_iter().zip(vertices).map(|((strand, _), vertices)| (strand, vertices)).collect()
}

/// Returns the place of a strand of the file that is nearest to `place`: the vertex before it, and the share of the way to the next vertex.
///
/// The drawn segment that holds `place` begins between the vertex `first` and the next one. It ends at `end`, which lies within `step` of the
/// strand, so that only that part of the strand is searched.
fn along(
    vertices: &[DVec3],
    first: u32,
    (place, end): (DVec3, DVec3),
    step: f64,
) -> Option<(u32, f64)> {
    let mut nearest: Option<(f64, u32, f64)> = None;
    for (vertex, pair) in (first..).zip(vertices.get(first as usize..)?.windows(2)) {
        let &[a, b] = pair else { continue };
        let way = b - a;
        let square = way.length_squared();
        let to = |point: DVec3| {
            let share =
                if square > 0.0 { ((point - a).dot(way) / square).clamp(0.0, 1.0) } else { 0.0 };
            (point.distance(a + way * share), share)
        };
        let (distance, share) = to(place);
        if nearest.is_none_or(|(least, ..)| distance < least) {
            nearest = Some((distance, vertex, share));
        }
        if to(end).0 <= step {
            break;
        }
    }
    nearest.map(|(_, vertex, share)| (vertex, share))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::assets::{Fields, Polylines};
    use crate::bake::line_levels::line_levels;
    use crate::bake::pack::pack_lines;

    #[test]
    fn picks_of_ribbons_lie_on_the_ribbon() {
        let normal = Vec3::new(0.0, 0.6, 0.8);
        let lines = Polylines {
            positions: vec![DVec3::ZERO, DVec3::X * 4.0],
            strands: vec![0, 2],
            radii: Some(vec![0.5; 2]),
            normals: Some(vec![normal; 2]),
            ..Polylines::default()
        };
        let packed = pack_lines(&lines).unwrap();
        let pick = |x: f64, y: f64| {
            let ray = (DVec3::new(x, y, 10.0), -DVec3::Z);
            let segment = (&packed.chunks[0], 0);
            super::segment(&packed, segment, &DAffine3::IDENTITY, ray, None, Detail::Full).unwrap()
        };
        // The ribbon is half a unit wide to either side, along 0, 0.8, −0.6.
        for (x, y) in [(1.0, 0.2), (3.0, 0.2), (1.0, -0.3), (3.5, -0.35), (2.0, 0.0)] {
            let element = pick(x, y);
            let expected = DVec3::new(x, y, -0.75 * y);
            assert!(element.local.distance(expected) < 1e-3, "{} {expected}", element.local);
            assert!(element.normal.distance(normal.as_dvec3()) < 1e-3);
            let strand = element.strand.unwrap();
            assert_eq!((strand.index, strand.vertex), (0, 0));
            assert!((strand.share - 0.25 * x).abs() < 1e-4, "{strand:?}");
        }
        // A ray beside the ribbon gets a point of its border.
        for y in [0.6f64, -0.6] {
            let expected = DVec3::new(1.0, 0.4 * y.signum(), -0.3 * y.signum());
            assert!(pick(1.0, y).local.distance(expected) < 1e-3, "{}", pick(1.0, y).local);
        }
    }

    #[test]
    fn values_change_evenly_along_a_segment() {
        let lines = Polylines {
            positions: vec![DVec3::ZERO, DVec3::X * 4.0],
            strands: vec![0, 2],
            radii: Some(vec![0.5; 2]),
            fields: Fields::of_numbers(vec![
                ("size", vec![100, 300]),
                ("classification", vec![2, 9]),
            ]),
            ..Polylines::default()
        };
        let packed = pack_lines(&lines).unwrap();
        for (x, class) in [(1.0, 2.0), (1.9, 2.0), (2.1, 9.0), (3.5, 9.0)] {
            let ray = (DVec3::new(x, 0.0, 10.0), -DVec3::Z);
            let (chunk, world) = (&packed.chunks[0], DAffine3::IDENTITY);
            let found = segment(&packed, (chunk, 0), &world, ray, None, Detail::Full).unwrap();
            assert!((found.fields["size"] - (100.0 + 50.0 * x)).abs() < 0.1, "{:?}", found.fields);
            assert_eq!(found.fields["classification"], class, "{x}");
        }
    }

    #[test]
    fn triangles_behind_the_eye_are_not_met() {
        let corners = [DVec3::new(-1.0, -1.0, 2.0), DVec3::new(1.0, -1.0, 2.0), DVec3::Z * 2.0];
        let way = DVec3::new(0.0, -0.1, 1.0);
        assert!(weights(corners, way).is_some());
        assert!(weights(corners, -way).is_none());
        assert!(weights(corners, DVec3::X).is_none());
        assert!(weights([DVec3::Z; 3], way).is_none());
    }

    /// Strands along x, whose vertices have different distances. One segment is long and therefore split.
    #[test]
    fn segments_of_levels_lead_to_places_of_the_file() {
        let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
        for strand in 0..2 {
            lines.positions.extend((0..500).map(|vertex| {
                let x = f64::from(vertex) + 0.4 * f64::from(vertex).sin();
                let gap = if vertex > 60 { 25.0 } else { 0.0 };
                DVec3::new(x + gap, 50.0 * f64::from(strand), 0.0)
            }));
            lines.strands.push(lines.positions.len() as u32);
        }
        let full = pack_lines(&lines).unwrap();
        let levels = line_levels(&full).unwrap();
        let strands = super::strands(&full, &BTreeSet::from([1]));
        assert_eq!(strands.keys().collect::<Vec<_>>(), [&1]);
        let vertices = &strands[&1];
        let step = full.grid.step;
        for (found, expected) in vertices.iter().zip(&lines.positions[500..]) {
            assert!(found.distance(*expected) <= step, "{found} {expected}");
        }
        assert_eq!(vertices.len(), 500);
        let both = super::strands(&full, &BTreeSet::from([0, 1, 7]));
        assert_eq!((both.len(), &both[&1], both[&0].len()), (2, vertices, 500));
        assert!(both[&0].iter().all(|vertex| vertex.is_finite() && vertex.y.abs() <= step));
        assert_eq!(super::strands(&full, &BTreeSet::from([7])), Strands::new());
        let (mut runs, mut parts) = (0, 0);
        for chunk in &levels.chunks {
            for segment in chunk.elements() {
                let (strand, first) = levels.strand_of(segment).unwrap();
                if strand != 1 {
                    continue;
                }
                let [a, b] = levels.ends(chunk, segment).unwrap().map(|end| end.position);
                for share in [0.1, 0.5, 0.9] {
                    let place = a.lerp(b, share);
                    let (vertex, share) = along(vertices, first, (place, b), step).unwrap();
                    let [from, to] = [0, 1].map(|at| vertices[vertex as usize + at]);
                    let found = from.lerp(to, share);
                    assert!(found.distance(place) < 4.0 * step, "{found} {place}");
                    runs += usize::from(vertex > first);
                }
                parts += usize::from(first == 60 && b.x - a.x < 20.0);
            }
        }
        assert!(runs > 20 && parts > 2, "{runs} {parts}");
        let ray = (DVec3::new(1.0, 0.0, 10.0), -DVec3::Z);
        let (chunk, world) = (&levels.chunks[0], DAffine3::IDENTITY);
        let detail = Detail::Levels(None);
        let element = super::segment(&levels, (chunk, 0), &world, ray, None, detail).unwrap();
        assert_eq!(element.strand, None);
    }
}
