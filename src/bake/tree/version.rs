//! Regression test: the trees of a few assets have the digest recorded for this version.

use glam::{DVec3, Vec2, Vec3};
use sha2::{Digest, Sha256};

use super::*;
use crate::assets::{Clip, ClipLine, Fields, Kernel, Material, Mesh, MeshPart, Polylines};
use crate::bake::hybrid::hybrid_mesh;
use crate::bake::kernels::circle;
use crate::bake::line_levels::line_levels;
use crate::bake::pack::{PackedKind, PackedLines, PackedMesh, pack_hybrid, pack_lines};
use crate::scene::random::SplitMix64;

/// Positions and normals on a wavy sheet, from operations that every machine computes identically.
fn sheet(side: usize) -> (Vec<DVec3>, Vec<Vec3>) {
    let at = |i: usize| {
        let [x, y] = [i % side, i / side].map(|v| 2.0 * v as f64 / (side - 1) as f64 - 1.0);
        let z = 0.4 * x * (1.0 - y * y) + 0.2 * x * x * y;
        let slope = DVec3::new(-0.4 * (1.0 - y * y) - 0.4 * x * y, 0.8 * x * y - 0.2 * x * x, 1.0);
        (DVec3::new(x, y, z), (slope / slope.length()).as_vec3())
    };
    (0..side * side).map(at).unzip()
}

fn colors(count: usize) -> Vec<[u8; 4]> {
    (0..count).map(|i| [(i / 7) as u8, if i % 40 < 20 { 30 } else { 220 }, 90, 255]).collect()
}

/// A scan with oblong kernels, some of them clipped.
fn scan() -> PackedSamples {
    let (positions, normals) = sheet(48);
    let count = positions.len();
    let kernel = |(i, &n): (usize, &Vec3)| {
        let Kernel { u, v } = circle(n, 0.016);
        Kernel { u: u * (1.0 + (i % 5) as f32 * 0.25), v }
    };
    let line = |i: usize| {
        (i.is_multiple_of(11)).then_some(ClipLine { normal: Vec2::new(0.6, -0.8), offset: -0.25 })
    };
    let cloud = PointCloud {
        kernels: Some(normals.iter().enumerate().map(kernel).collect()),
        clips: Some((0..count).map(|i| Clip { lines: [line(i), None], either: false }).collect()),
        colors: Some(colors(count)),
        oriented: true,
        positions,
        normals: Some(normals),
        ..PointCloud::default()
    };
    build_tree(&cloud, None).unwrap()
}

/// Random samples of all sizes; many share a position, some face the eye.
fn scattered() -> PackedSamples {
    let mut numbers = SplitMix64::new(11);
    let mut next = || (numbers.next_u64() >> 40) as f32 / (1 << 24) as f32;
    let mut cloud = PointCloud::default();
    let (mut normals, mut kernels) = (Vec::new(), Vec::new());
    for i in 0..3000 {
        let place = DVec3::new(next().into(), f64::from(next()) * 0.3, f64::from(next()) * 9.0);
        let again = (1..25).contains(&(i % 60));
        cloud.positions.push(if again { cloud.positions[i - i % 60] } else { place });
        let n = Vec3::new(next() - 0.5, next() - 0.5, next() - 0.5).normalize_or_zero();
        normals.push(if i % 9 == 0 { Vec3::ZERO } else { n });
        kernels.push(circle(normals[i], 0.1 * next() * next() * next()));
    }
    cloud.colors = Some(colors(cloud.positions.len()));
    cloud.normals = Some(normals);
    cloud.kernels = Some(kernels);
    build_tree(&cloud, None).unwrap()
}

fn mesh() -> (PackedSamples, PackedMesh) {
    const SIDE: u32 = 20;
    let (positions, normals) = sheet(SIDE as usize);
    let quad = |i: u32| {
        let at = i / (SIDE - 1) * SIDE + i % (SIDE - 1);
        [[at, at + 1, at + SIDE + 1], [at, at + SIDE + 1, at + SIDE]]
    };
    // The last row is translucent.
    let glass = [Material { translucent: true, ..Material::default() }];
    let part = |rows: u32, material| MeshPart { triangles: 2 * rows * (SIDE - 1), material };
    let mesh = Mesh {
        triangles: (0..(SIDE - 1) * (SIDE - 1)).flat_map(quad).collect(),
        parts: vec![part(SIDE - 2, None), part(1, Some(0))],
        colors: Some(colors(positions.len())),
        normals: Some(normals),
        positions,
        ..Mesh::default()
    };
    let hybrid = hybrid_mesh(&mesh, &glass, &[], 1 << 20).unwrap();
    let bounds = Bounds::of(mesh.positions.iter().copied());
    let tree = build_tree_within(&hybrid.samples, Some(&hybrid.stands), bounds, false).unwrap();
    let triangles = pack_hybrid(&mesh, &glass, tree.grid, &hybrid.sides).unwrap();
    (tree, triangles)
}

/// Strands over the sheet: crowded in one corner, and one of a ribbon's normals.
fn lines() -> PackedLines {
    let mut lines = Polylines { strands: vec![0], ..Polylines::default() };
    for strand in 0..300 {
        let (a, b) = (0.001 * f64::from(strand * 37 % 300), 0.001 * f64::from(strand * 91 % 300));
        lines.positions.extend((0..20).map(|vertex| {
            let t = 0.05 * f64::from(vertex);
            DVec3::new(a + 0.1 * t * t, b * (1.0 + t), 2.0 * t)
        }));
        lines.strands.push(lines.positions.len() as u32);
    }
    let count = lines.positions.len();
    lines.radii = Some((0..count).map(|v| 0.0005 + 0.0001 * (v % 3) as f32).collect());
    lines.normals = Some(vec![Vec3::Y; count]);
    lines.colors = Some(colors(count));
    let numbers = (0..count).map(|v| (v % 900) as u16).collect();
    lines.fields = Fields::of_numbers(vec![("number", numbers)]);
    line_levels(&pack_lines(&lines).unwrap()).unwrap()
}

fn add_chunks(hash: &mut Sha256, grid: &Grid, chunks: &[PackedChunk]) {
    hash.update(format!("{grid:?}"));
    for chunk in chunks {
        hash.update(format!("{chunk:?}"));
    }
}

fn add_samples(hash: &mut Sha256, samples: &PackedSamples) {
    add_chunks(hash, &samples.grid, &samples.chunks);
    for pairs in [&samples.positions, &samples.attributes, &samples.clips, &samples.nodes] {
        hash.update(bytemuck::cast_slice(pairs));
    }
    hash.update(bytemuck::cast_slice(&samples.kernels));
}

/// On other systems, functions such as the logarithm may round differently.
#[test]
#[cfg_attr(
    not(all(target_arch = "x86_64", target_os = "linux", target_env = "gnu")),
    ignore = "digests are of x86-64 with glibc"
)]
fn trees_change_with_their_version() {
    let mut hash = Sha256::new();
    hash.update(BAKING_VERSION.to_le_bytes());
    add_samples(&mut hash, &scan());
    add_samples(&mut hash, &scattered());
    let (tree, triangles) = mesh();
    add_samples(&mut hash, &tree);
    add_chunks(&mut hash, &triangles.grid, &triangles.chunks);
    hash.update(bytemuck::cast_slice(&triangles.vertices));
    hash.update(bytemuck::cast_slice(&triangles.triangles));
    let lines = lines();
    add_chunks(&mut hash, &lines.grid, &lines.chunks);
    let page = lines.page(&lines.chunks[0]);
    let vertices = lines.stream(page, "line_vertices", 0..lines.vertices.len());
    hash.update(bytemuck::cast_slice(&vertices));
    hash.update(bytemuck::cast_slice(&lines.segments));
    hash.update(bytemuck::cast_slice(&lines.values));
    let found: String = hash.finalize()[..8].iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(
        found, BAKING_DIGEST,
        "point trees are not those of BAKING_VERSION {BAKING_VERSION}, which users have in their caches. If they were \
         meant to change: raise BAKING_VERSION, run the tests of pictures (twin, golden), run this test again and make \
         BAKING_DIGEST what it then finds. If not, something changed that should not have"
    );
}
