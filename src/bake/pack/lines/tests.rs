use glam::Vec3;

use super::write::strand_word;
use super::*;
use crate::assets::{Fields, Polylines};
use crate::bake::pack::{Grid, PackError, morton, octahedral_decode};

fn wave(count: usize, phase: f64) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |i| {
        let t = i as f64 * 0.05;
        DVec3::new(t, (t + phase).sin(), phase * 0.1)
    })
}

fn many(strands: usize, count: usize) -> Polylines {
    let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
    for strand in 0..strands {
        lines.positions.extend(wave(count, strand as f64 * 0.37));
        lines.strands.push(lines.positions.len() as u32);
    }
    let vertices = lines.positions.len();
    lines.radii = Some((0..vertices).map(|i| 0.01 + (i % 7) as f32 * 0.002).collect());
    lines.colors = Some((0..vertices).map(|i| [i as u8, (i >> 8) as u8, 7, 255]).collect());
    lines
}

#[test]
fn every_segment_is_packed_once_with_the_words_of_its_vertices() {
    let mut lines = many(30, 101);
    lines.fields =
        Fields::of_numbers(vec![("one", vec![1; 30 * 101]), ("number", (0..30 * 101).collect())]);
    let packed = pack_lines(&lines).unwrap();
    packed.check().unwrap();
    assert_eq!(packed.len(), 30 * 100);
    let mut seen = vec![0; lines.positions.len()];
    for chunk in &packed.chunks {
        assert!(chunk.count as usize <= CHUNK && chunk.vertex_count as usize <= CHUNK);
        for segment in chunk.elements() {
            let [link, vertex] = packed.segments[segment];
            let vertex = vertex as usize;
            seen[vertex] += 1;
            for (end, v) in packed.ends(chunk, segment).unwrap().iter().zip([vertex, vertex + 1]) {
                assert!(end.position.distance(lines.positions[v]) < 2.0 * packed.grid.step);
                let radius = f64::from(lines.radii.as_ref().unwrap()[v]);
                assert!((end.radius / radius - 1.0).abs() < 1e-6);
                assert!(radius / packed.grid.step <= f64::from(chunk.kernel_base) * (1.0 + 1e-6));
                assert_eq!(end.color.to_le_bytes(), lines.colors.as_ref().unwrap()[v]);
                assert_eq!((end.normal, end.side), (NO_NORMAL, NO_NORMAL));
            }
            let values = packed.end_values(chunk, segment).unwrap();
            let numbers = values.map(|words| packed.fields[1].value(words).unwrap());
            assert_eq!(numbers, [vertex as f64, vertex as f64 + 1.0]);
            let (strand, place) = packed.strand_of(segment).unwrap();
            assert_eq!((strand as usize, place as usize), (vertex / 101, vertex % 101));
            assert_eq!(link & BEGINS != 0, place == 0);
            assert_eq!(link & ENDS != 0, place == 99);
        }
    }
    let expected = |v: usize| i32::from(v % 101 != 100);
    assert!((0..seen.len()).all(|v| seen[v] == expected(v)));
    // A shared vertex has equal words wherever it is stored.
    let mut words = std::collections::HashMap::new();
    for chunk in &packed.chunks {
        for [link, vertex] in &packed.segments[chunk.elements()] {
            for (shift, v) in [(0, *vertex), (10, vertex + 1)] {
                let own = packed.vertices[(chunk.vertex_first + (link >> shift & 0x3ff)) as usize];
                assert_eq!(*words.entry(v).or_insert(own), own);
            }
        }
    }
    assert!(packed.vertices.len() < 2 * lines.positions.len(), "{}", packed.vertices.len());
}

/// Packs one segment after the other into chunks. Returns the vertices of each chunk, and for each segment its chunk, the indices of both ends
/// there, and its number.
fn packed_in_turn(lines: &Polylines, grid: &Grid) -> (Vec<Vec<u32>>, Vec<[u32; 4]>) {
    let cells: Vec<IVec3> = lines.positions.iter().map(|&p| grid.quantise(p)).collect();
    let middle = |v: u32| morton((cells[v as usize] + cells[v as usize + 1]) / 2);
    let mut order: Vec<u32> = lines.segments().collect();
    order.sort_by_key(|&v| (middle(v), v));
    let (mut chunks, mut segments) = (Vec::<Vec<u32>>::new(), Vec::new());
    let mut in_last = 0;
    for v in order {
        let fits = chunks.last().is_some_and(|chunk| {
            let fresh = [v, v + 1].iter().filter(|end| !chunk.contains(end)).count();
            in_last < CHUNK && chunk.len() + fresh <= CHUNK
        });
        if !fits {
            chunks.push(Vec::new());
            in_last = 0;
        }
        let number = chunks.len() - 1;
        let chunk = &mut chunks[number];
        let ends = [v, v + 1].map(|end| {
            chunk.iter().position(|&held| held == end).unwrap_or_else(|| {
                chunk.push(end);
                chunk.len() - 1
            })
        });
        segments.push([number as u32, ends[0] as u32, ends[1] as u32, v]);
        in_last += 1;
    }
    (chunks, segments)
}

#[test]
fn packing_in_parallel_gives_what_packing_in_turn_gives() {
    // Long strands fill chunks with segments, short ones with vertices.
    for (strands, count) in [(40, 150), (2500, 2), (900, 4)] {
        let mut lines = many(strands, count);
        lines.normals = Some(vec![Vec3::Z; lines.positions.len()]);
        let packed = pack_lines(&lines).unwrap();
        packed.check().unwrap();
        let (chunks, segments) = packed_in_turn(&lines, &packed.grid);
        assert!(chunks.len() > 2);
        assert_eq!((chunks.len(), segments.len()), (packed.chunks.len(), packed.len()));
        for (chunk, vertices) in packed.chunks.iter().zip(&chunks) {
            let words = &packed.vertices[chunk.vertices()];
            assert_eq!(words.len(), vertices.len());
            let most = words.iter().map(|words| f32::from_bits(words[4])).fold(0.0, f32::max);
            assert_eq!(chunk.kernel_base, most);
            for (words, &vertex) in words.iter().zip(vertices) {
                assert_eq!(cell_of(words), packed.grid.quantise(lines.positions[vertex as usize]));
                let color = lines.colors.as_ref().unwrap()[vertex as usize];
                assert_eq!(words[3], u32::from_le_bytes(color));
            }
        }
        for (at, &[chunk, begin, end, vertex]) in segments.iter().enumerate() {
            let [word, number] = packed.segments[at];
            assert!(packed.chunks[chunk as usize].elements().contains(&at));
            assert_eq!([word & 0x3ff, word >> 10 & 0x3ff, number], [begin, end, vertex]);
            let (strand, place) = (vertex / count as u32, vertex as usize % count);
            let expected = strand_word(strand, 0, place == 0, place + 2 == count);
            assert_eq!(word >> 20, expected >> 20);
        }
    }
}

#[test]
fn ribbons_share_the_directions_of_their_widths() {
    let mut lines = many(2, 20);
    lines.normals = Some(vec![Vec3::Z; lines.positions.len()]);
    // The last strand turns back by 180° and repeats a point.
    lines.positions[25] = lines.positions[23];
    lines.positions[30] = lines.positions[29];
    let packed = pack_lines(&lines).unwrap();
    for chunk in &packed.chunks {
        for segment in chunk.elements() {
            for end in packed.ends(chunk, segment).unwrap() {
                let side = octahedral_decode(end.side);
                assert!((side.length() - 1.0).abs() < 1e-3 && side.z.abs() < 1e-3, "{side}");
                assert!((octahedral_decode(end.normal) - Vec3::Z).length() < 1e-3);
            }
        }
    }
}

#[test]
fn radii_that_are_none_are_refused_with_the_number_of_the_vertex() {
    for radius in [f32::NAN, -0.5, f32::INFINITY] {
        let mut lines = many(1, 12);
        lines.radii.as_mut().unwrap()[5] = radius;
        let error = pack_lines(&lines).unwrap_err();
        assert_eq!(error, PackError::Radius { index: 5 });
        assert!(error.to_string().contains("vertex 5"));
    }
    let mut lines = many(1, 12);
    lines.positions[3].y = f64::NAN;
    assert_eq!(pack_lines(&lines).unwrap_err(), PackError::NotFinite { index: 3 });
    let mut lines = many(2, 12);
    lines.strands[1] = 30;
    assert_eq!(pack_lines(&lines).unwrap_err(), PackError::Strands);
    let huge = Polylines { radii: Some(vec![f32::MAX; 12]), ..many(1, 12) };
    assert!(matches!(pack_lines(&huge), Err(PackError::TooFar { .. })));
}

#[test]
fn shortness_bounds_the_radii_of_parts() {
    let mut lines = many(40, 90);
    let radii = lines.radii.as_mut().unwrap();
    radii.iter_mut().enumerate().for_each(|(i, r)| *r *= (-(i as f32) * 0.003).exp2());
    let packed = pack_lines(&lines).unwrap();
    for chunk in &packed.chunks {
        for first in chunk.elements().step_by(64) {
            let range = first..chunk.elements().end.min(first + 64);
            let most = range
                .clone()
                .flat_map(|segment| packed.ends(chunk, segment).unwrap())
                .map(|end| end.radius)
                .fold(0.0, f64::max);
            let code = packed.shortness(range);
            let bound = f64::from(chunk.kernel_base) * (-f64::from(code) / 16.0).exp2();
            assert!(most <= bound * packed.grid.step * 1.0001, "{code}");
        }
    }
}

#[test]
fn nothing_and_single_points_are_packed() {
    assert!(pack_lines(&Polylines::default()).unwrap().is_empty());
    let point = Polylines {
        positions: vec![DVec3::splat(5.0); 3],
        strands: vec![0, 3],
        radii: Some(vec![2.0, 0.0, 1.0]),
        ..Polylines::default()
    };
    let packed = pack_lines(&point).unwrap();
    assert_eq!((packed.len(), packed.chunks.len()), (2, 1));
    assert_eq!(packed.chunks[0].extent, IVec3::ZERO);
    assert!(packed.corner_radius() >= 2.0 * (1.0 - 1e-6));
}

#[test]
fn chunks_with_alpha_stand_on_pages_of_their_own() {
    let mut lines = many(100, 101);
    let is_opaque = |packed: &PackedLines| packed.chunks.iter().all(|chunk| !chunk.translucent);
    assert!(is_opaque(&pack_lines(&lines).unwrap()));
    lines.colors.as_mut().unwrap()[50][3] = 100;
    let packed = pack_lines(&lines).unwrap();
    let (with, without): (Vec<&PackedChunk>, Vec<&PackedChunk>) =
        packed.chunks.iter().partition(|chunk| packed.page(chunk).translucent);
    assert!(!with.is_empty() && !without.is_empty());
    let has_alpha = |chunk: &&PackedChunk| {
        packed.vertices[chunk.vertices()].iter().any(|words| words[3] >> 24 < 255)
    };
    assert!(with.iter().all(has_alpha) && !without.iter().any(has_alpha));
}
