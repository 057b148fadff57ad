use glam::{DVec3, IVec3};

use super::*;
use crate::assets::fields::Scale;
use crate::assets::{Field, Fields, Polylines};
use crate::bake::pack::{LINE_WORDS, PackedChunk, PackedKind, pack_lines};
use crate::scene::random::SplitMix64;

/// Strands of `count` vertices each, by the place of a strand's vertex.
fn lines(
    strands: usize,
    count: usize,
    radius: f32,
    mut place: impl FnMut(usize, usize) -> DVec3,
) -> PackedLines {
    let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
    for strand in 0..strands {
        lines.positions.extend((0..count).map(|vertex| place(strand, vertex)));
        lines.strands.push(lines.positions.len() as u32);
    }
    let all = lines.positions.len();
    lines.radii = Some(vec![radius; all]);
    lines.colors = Some((0..all).map(|v| [(v / count * 40 % 256) as u8, 90, 200, 255]).collect());
    pack_lines(&lines).unwrap()
}

/// A helix of one turn in 60 vertices.
fn helix(strand: usize, vertex: usize) -> DVec3 {
    let t = vertex as f64 * 0.1;
    DVec3::new(t.cos() + 30.0 * strand as f64, t.sin(), 0.2 * t)
}

/// Parallel fibres in a square of `edge`.
fn bundle(edge: f64) -> impl FnMut(usize, usize) -> DVec3 {
    let mut random = SplitMix64::new(3);
    let mut at = DVec3::ZERO;
    move |_, vertex| {
        if vertex == 0 {
            at = DVec3::new(random.range(0.0, edge), random.range(0.0, edge), 0.0);
        }
        at + DVec3::Z * (0.05 * vertex as f64)
    }
}

/// A straight strand whose values are the numbers of its vertices.
#[test]
fn vertices_of_levels_have_the_values_of_what_they_stand_for() {
    const COUNT: u16 = 1000;
    let classes = (0..COUNT).map(|vertex| if vertex < 500 { 2 } else { 5 }).collect();
    let numbers = (0..COUNT).collect();
    let lines = Polylines {
        positions: (0..COUNT).map(|vertex| DVec3::X * f64::from(vertex)).collect(),
        strands: vec![0, COUNT.into()],
        radii: Some(vec![0.01; COUNT.into()]),
        fields: Fields::of_numbers(vec![("number", numbers), ("classification", classes)]),
        ..Polylines::default()
    };
    let levels = line_levels(&pack_lines(&lines).unwrap()).unwrap();
    let (mut fewest, mut segments) = (f64::INFINITY, 0);
    for chunk in &levels.chunks {
        for segment in chunk.elements() {
            let ends = levels.ends(chunk, segment).unwrap().map(|end| end.position.x);
            let length = (ends[1] - ends[0]).abs();
            let values = levels.end_values(chunk, segment).unwrap();
            for (x, words) in ends.into_iter().zip(values) {
                let [number, class] =
                    [0, 1].map(|field| levels.fields[field].value(words).unwrap());
                assert!((number - x).abs() <= 0.5 * length + 1.0, "{number} at {x}, {length}");
                if (x - 499.5).abs() > length {
                    assert_eq!(class, if x < 500.0 { 2.0 } else { 5.0 }, "at {x}, {length}");
                }
                assert!(class == 2.0 || class == 5.0);
            }
            fewest = fewest.min(1.0 / length);
            segments += 1;
        }
    }
    assert!(fewest < 0.2 && segments > 1000, "{fewest} {segments}");
}

struct Level<'a> {
    error: f64,
    parent: f64,
    chunks: Vec<&'a PackedChunk>,
}

/// The levels of packed lines, finest first; errors in units of the asset.
fn levels_of(packed: &PackedLines) -> Vec<Level<'_>> {
    let mut levels: Vec<Level<'_>> = Vec::new();
    for chunk in packed.chunks.iter().rev() {
        let [error, parent] = [chunk.range.error_least, chunk.range.error_parent]
            .map(|cells| f64::from(cells) * packed.grid.step);
        match levels.last_mut().filter(|level| level.error == error) {
            Some(level) => level.chunks.push(chunk),
            None => levels.push(Level { error, parent, chunks: vec![chunk] }),
        }
    }
    levels
}

fn segments(level: &Level<'_>) -> usize {
    level.chunks.iter().map(|chunk| chunk.count as usize).sum()
}

fn ends_of<'a>(
    packed: &'a PackedLines,
    level: &'a Level<'_>,
) -> impl Iterator<Item = [DVec3; 2]> + 'a {
    level.chunks.iter().flat_map(move |chunk| {
        chunk
            .elements()
            .map(move |segment| packed.ends(chunk, segment).unwrap().map(|end| end.position))
    })
}

/// Numbers of the strands that a level has something of.
fn strands_of(packed: &PackedLines, level: &Level<'_>) -> Vec<u32> {
    let segments = level.chunks.iter().flat_map(|chunk| chunk.elements());
    let mut strands: Vec<u32> =
        segments.map(|segment| packed.strand_of(segment).unwrap().0).collect();
    strands.sort_unstable();
    strands.dedup();
    strands
}

/// Area of all strips.
fn area(packed: &PackedLines, level: &Level<'_>) -> f64 {
    let chunks = level.chunks.iter();
    chunks
        .flat_map(|chunk| {
            chunk.elements().map(|segment| {
                let [a, b] = packed.ends(chunk, segment).unwrap();
                a.position.distance(b.position) * (a.radius + b.radius)
            })
        })
        .sum()
}

#[test]
fn levels_follow_each_other_without_a_gap_and_get_smaller() {
    let own = lines(40, 600, 0.002, helix);
    let packed = line_levels(&own).unwrap();
    packed.check().unwrap();
    let levels = levels_of(&packed);
    assert!(levels.len() >= 5, "{}", levels.len());
    assert_eq!(levels[0].error, 0.0);
    assert_eq!(segments(&levels[0]), own.len(), "full detail is whole");
    for pair in levels.windows(2) {
        assert_eq!(pair[0].parent, pair[1].error);
        assert!(segments(&pair[1]) as f64 <= 0.7 * segments(&pair[0]) as f64);
    }
    assert!(levels.last().unwrap().parent > 1e20);
    // Chunks of a coarser level come first, and are as far from their parents as those behind them, or farther.
    let ranges: Vec<_> = packed.chunks.iter().map(|chunk| chunk.range).collect();
    assert!(ranges.windows(2).all(|pair| pair[0].error_parent >= pair[1].error_parent));
}

#[test]
fn every_place_of_a_strand_is_within_the_error_of_each_level() {
    let own = lines(3, 600, 0.002, helix);
    let packed = line_levels(&own).unwrap();
    let levels = levels_of(&packed);
    let distance = |place: DVec3, [a, b]: [DVec3; 2]| {
        let way = b - a;
        let share = ((place - a).dot(way) / way.length_squared()).clamp(0.0, 1.0);
        place.distance(a + way * share)
    };
    // Helices lie 30 apart: none is pruned below that.
    for level in levels[1..].iter().filter(|level| level.error < 8.0) {
        let all: Vec<[DVec3; 2]> = ends_of(&packed, level).collect();
        for strand in 0..3 {
            for vertex in 0..600 {
                let place = helix(strand, vertex);
                let nearest =
                    all.iter().map(|&ends| distance(place, ends)).fold(f64::INFINITY, f64::min);
                assert!(nearest <= 0.5 * level.error + 1e-6, "{nearest} at {}", level.error);
            }
        }
    }
}

/// Shaders derive dither keys from a segment's number and the hash above its flags.
#[test]
fn parts_of_a_split_segment_have_dither_keys_of_their_own() {
    // Steps of 1, and one of 40.
    let own = lines(1, 200, 0.001, |_, vertex| {
        let gap = if vertex > 100 { 39.0 } else { 0.0 };
        DVec3::X * (vertex as f64 + gap)
    });
    let packed = line_levels(&own).unwrap();
    let full = levels_of(&packed).remove(0);
    let mut keys: Vec<(u32, u32)> = full
        .chunks
        .iter()
        .flat_map(|chunk| chunk.elements())
        .map(|segment| packed.segments[segment])
        .map(|[link, number]| (number, link >> 22))
        .collect();
    let all = keys.len();
    assert!(all > own.len() + 10, "{all}");
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), all);
    // A segment that is not split has the hash of full detail.
    let [link, _] = own.segments[0];
    assert!(keys.contains(&(0, link >> 22)));
}

/// Classes, and values that one end of a segment lacks, change in its middle, also where levels split the segment.
#[test]
fn fields_of_a_split_segment_change_in_its_middle() {
    let scale = |least, most, has_gaps| Scale { least, step: 1.0, most, has_gaps };
    let fields = vec![
        Field { name: "classification".to_owned(), scale: scale(2.0, 3, false), place: 0 },
        Field { name: "number".to_owned(), scale: scale(0.0, 100, true), place: 2 },
    ];
    let is_far = |vertex: u32| vertex > 100;
    // The class 5 and the number 50, or the class 2 and no number.
    let words = |vertex: u32| if is_far(vertex) { 3 | 50 << 2 } else { 101 << 2 };
    // Steps of 1, and one of 47, for which 20 parts would be short enough.
    let place = |vertex: u32| f64::from(vertex) + if is_far(vertex) { 46.0 } else { 0.0 };
    let own = Polylines {
        positions: (0..200).map(|vertex| DVec3::X * place(vertex)).collect(),
        strands: vec![0, 200],
        fields: Fields::from_words(fields, (0..200).map(words).collect()),
        ..Polylines::default()
    };
    let packed = line_levels(&pack_lines(&own).unwrap()).unwrap();
    let full = levels_of(&packed).remove(0);
    let mut changes = Vec::new();
    for chunk in &full.chunks {
        for segment in chunk.elements() {
            let [a, b] = packed.ends(chunk, segment).unwrap().map(|end| end.position.x);
            let words = packed.end_values(chunk, segment).unwrap();
            let values = |field: usize| words.map(|words| packed.fields[field].value(words));
            if values(0) == [Some(2.0), Some(5.0)] && values(1) == [None, Some(50.0)] {
                changes.push(0.5 * (a + b));
            } else {
                assert!(values(0)[0] == values(0)[1] && values(1)[0] == values(1)[1]);
            }
        }
    }
    assert!(changes.len() == 1 && (changes[0] - 123.5).abs() < 1e-3, "{changes:?}");
}

#[test]
fn bundles_thin_out_and_keep_their_area() {
    let own = lines(4000, 40, 0.0004, bundle(1.0));
    let packed = line_levels(&own).unwrap();
    let levels = levels_of(&packed);
    let whole = area(&packed, &levels[0]);
    let mut before = strands_of(&packed, &levels[0]);
    let mut least = before.len();
    for level in &levels[1..] {
        let now = strands_of(&packed, level);
        assert!(
            now.iter().all(|strand| before.binary_search(strand).is_ok()),
            "a strand came back"
        );
        // From an error of a quarter of the bundle on, too few strands are left for a mean.
        if level.error < 0.25 {
            let ratio = area(&packed, level) / whole;
            assert!((0.75..1.3).contains(&ratio), "{ratio} at {}", level.error);
        }
        least = now.len();
        before = now;
    }
    assert!(least < 40, "{least} strands are left of 4000");
}

/// Places at the border of the grid have cells of their own, even where cells are smallest.
#[test]
fn cells_tell_the_farthest_places_apart() {
    let far = 2f32.powi(28) - 2f32.powi(12);
    let key = |at: [f32; 3]| key_of(Vec3::from_array(at), LEAST_ERROR);
    for sign in [-1.0, 1.0] {
        for axis in 0..3 {
            let mut places = [[0.0; 3]; 3];
            places[1][axis] = sign * far;
            places[2][axis] = sign * 0.5 * far;
            let [zero, border, half] = places.map(key);
            assert!(zero != border && border != half && half != zero, "{border:?} {half:?}");
        }
    }
}

#[test]
fn single_strands_and_wide_ones_stay() {
    // Fibres far apart, of all widths.
    for radius in [1e-5, 0.01, 0.3] {
        let own = lines(9, 50, radius, |strand, vertex| {
            DVec3::new(20.0 * strand as f64, 0.0, vertex as f64)
        });
        let packed = line_levels(&own).unwrap();
        for level in levels_of(&packed).iter().filter(|level| level.error < 8.0) {
            let strands = strands_of(&packed, level);
            assert_eq!(strands.len(), 9, "radius {radius}, error {}", level.error);
        }
    }
}

#[test]
fn odd_lines_have_levels_as_well() {
    // Strands at one place, turning back, of length 0 and of width 0, and one that fills a cube by itself.
    let mut random = SplitMix64::new(8);
    let cases = [
        lines(200, 3, 0.1, |_, _| DVec3::ONE),
        lines(200, 9, 0.1, |strand, vertex| DVec3::new((vertex % 2) as f64, strand as f64, 0.0)),
        lines(200, 9, 0.0, |strand, vertex| DVec3::new(vertex as f64, strand as f64, 0.0)),
        lines(1, 2, 1e9, |_, vertex| DVec3::X * vertex as f64),
        lines(1, 50_000, 0.001, |_, _| {
            DVec3::new(random.range(0.0, 1.0), random.range(0.0, 1.0), random.range(0.0, 1.0))
        }),
    ];
    for own in &cases {
        let packed = line_levels(own).unwrap();
        packed.check().unwrap();
        let levels = levels_of(&packed);
        assert!(segments(&levels[0]) >= own.len());
        let is_finite = |words: &[u32; LINE_WORDS]| f32::from_bits(words[4]).is_finite();
        assert!(packed.vertices.iter().all(is_finite));
    }
    let packed = line_levels(&cases[4]).unwrap();
    let levels = levels_of(&packed);
    let top = segments(levels.last().unwrap());
    assert!((1..=2000).contains(&top), "{top} segments of 49,999 are left");
    let none = pack_lines(&Polylines::default()).unwrap();
    assert_eq!(line_levels(&none).unwrap().len(), 0);
}

#[test]
fn segments_between_levels_are_tested_near_each_other() {
    // Along a line that recedes, each place has a segment whose test passes, at every accepted error.
    let own = lines(1, 3000, 0.001, |_, vertex| {
        let t = 0.01 * f64::from(vertex as u32);
        DVec3::new(0.02 * (7.0 * t).sin(), 0.02 * (5.0 * t).cos(), t)
    });
    let packed = line_levels(&own).unwrap();
    let eye = DVec3::new(0.1, 0.0, -1.0);
    for angle in [1e-4, 1e-3, 1e-2] {
        let accepted = |distance: f64| angle * distance;
        let mut drawn: Vec<[f64; 2]> = Vec::new();
        for chunk in &packed.chunks {
            let range = chunk.range;
            let [least, parent, delta] = [range.error_least, range.error_parent, range.delta_most]
                .map(|cells| f64::from(cells) * packed.grid.step);
            for segment in chunk.elements() {
                let [a, b] = packed.ends(chunk, segment).unwrap().map(|end| end.position);
                let far = eye.distance((a + b) * 0.5);
                if least <= accepted(far) && parent > accepted(far - delta) {
                    drawn.push([a.z.min(b.z), a.z.max(b.z)]);
                }
            }
        }
        drawn.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut end = 0.0;
        for [from, to] in drawn {
            assert!(from <= end + 1e-6, "nothing from {end} to {from} at {angle}");
            end = f64::max(end, to);
        }
        assert!(end > 29.98, "{end}");
    }
}

#[test]
fn equal_lines_have_equal_levels() {
    let [a, b] = [0, 1].map(|_| line_levels(&lines(3000, 20, 0.001, bundle(0.5))).unwrap());
    assert_eq!(a.vertices, b.vertices);
    assert_eq!(a.segments, b.segments);
    assert_eq!(a.chunks, b.chunks);
    assert_ne!(a.chunks[0].origin, IVec3::MAX);
}
