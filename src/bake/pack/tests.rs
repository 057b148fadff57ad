use super::*;
use crate::assets::{Clip, ClipLine, Kernel, Mesh, PointCloud};
use crate::bake::kernels::circle;
use crate::bake::tree::build_tree;
use crate::scene::random::SplitMix64;

/// A cloud, of which every third sample has a clip line.
fn cloud(count: usize) -> PointCloud {
    let mut numbers = SplitMix64::new(count as u64);
    let mut next = || (numbers.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let line = ClipLine { normal: glam::Vec2::X, offset: 0.5 };
    let clip =
        |i: usize| Clip { lines: [i.is_multiple_of(3).then_some(line), None], either: false };
    PointCloud {
        positions: (0..count).map(|_| DVec3::new(next(), next(), 0.0)).collect(),
        normals: Some(vec![Vec3::Z; count]),
        kernels: Some((0..count).map(|_| -> Kernel { circle(Vec3::Z, 0.02) }).collect()),
        clips: Some((0..count).map(clip).collect()),
        ..PointCloud::default()
    }
}

/// A geometry of each kind, and a point tree.
fn geometries() -> Vec<PackedGeometry> {
    let corner = |i: u32| DVec3::new(f64::from(i % 60), f64::from(i / 60), 0.0);
    let mesh = Mesh {
        positions: (0..6000).map(corner).collect(),
        triangles: (0..5900).map(|i| [i, i + 1, i + 60]).collect(),
        ..Mesh::default()
    };
    vec![
        PackedGeometry::Samples(pack_samples(&cloud(5000)).unwrap()),
        PackedGeometry::Samples(build_tree(&cloud(5000), None).unwrap()),
        PackedGeometry::Triangles(pack_mesh(&mesh, &[]).unwrap()),
    ]
}

#[test]
fn every_kind_says_how_wide_its_arrays_are() {
    for geometry in geometries() {
        let (arrays, widths) = (geometry.arrays(), geometry.kind().widths());
        assert_eq!(arrays.len(), widths.len());
        let lengths: Vec<u32> =
            arrays.iter().zip(widths).map(|(words, width)| (words.len() / width) as u32).collect();
        let bytes: Vec<u8> = arrays.concat().iter().flat_map(|word| word.to_le_bytes()).collect();
        let mut source = &bytes[..];
        let arrays = Arrays::new(&mut source, &lengths);
        let (grid, chunks) = (*geometry.grid(), geometry.chunks().to_vec());
        let read = geometry.kind().read(grid, chunks, arrays).unwrap();
        assert!(source.is_empty());
        assert_eq!(format!("{read:?}"), format!("{geometry:?}"));
    }
}

#[test]
fn pages_hold_all_words_of_a_geometry() {
    let mut seen = std::collections::BTreeSet::new();
    for geometry in geometries() {
        let mut words = 0;
        for chunk in geometry.chunks() {
            let page = geometry.page(chunk);
            assert_eq!(page.kind, geometry.kind());
            seen.insert(page);
            for stream in page.streams() {
                let range = match stream.of {
                    StreamOf::Elements => chunk.elements(),
                    StreamOf::Vertices => chunk.vertices(),
                };
                let found = geometry.stream(page, stream.name, range.clone());
                assert_eq!(found.len(), range.len() * stream.words, "{}", stream.name);
                words += found.len() as u64;
            }
        }
        assert_eq!(4 * words, geometry.gpu_bytes());
    }
    assert_eq!(seen.len(), 5, "{seen:?}");
}

#[test]
fn counts_add_up_by_kind() {
    let all = geometries();
    let counts: Counts = all.iter().map(PackedGeometry::counts).sum();
    assert_eq!(counts.triangles, 5900);
    assert_eq!(counts.samples, (all[0].len() + all[1].len()) as u64);
    assert_eq!(counts.elements(), counts.samples + counts.triangles);
    let chunks: usize = all.iter().map(|geometry| geometry.chunks().len()).sum();
    assert_eq!((counts.chunks, counts.instances), (chunks as u64, 0));
    for geometry in &all {
        assert_eq!(geometry.counts().of(geometry.kind()), geometry.len() as u64);
        assert_eq!(GeometryKind::from_number(geometry.kind() as u32), Some(geometry.kind()));
    }
    assert_eq!(GeometryKind::from_number(99), None);
}
