use glam::Vec2;

use super::*;
use crate::assets::{Encoding, Filter, Geometry, MeshPart, Progress, ReadOptions, Wrap};
use crate::generate::trees::{TreeParameters, lines, triangles};

const BOTH: AsLines = AsLines { leaves: true, branches: true, max_radius: None };

fn converted(mesh: &Mesh, options: &AsLines) -> MeshLines {
    lines_of_mesh(mesh, &[], &[], options)
}

fn strands(lines: Option<&Polylines>) -> usize {
    lines.map_or(0, |lines| lines.strands.len() - 1)
}

/// Vertices of every strand, from whichever end is the smaller one.
fn ordered(lines: &Polylines) -> Vec<Vec<(DVec3, f32, [u8; 4])>> {
    let radii = lines.radii.as_ref().unwrap();
    let colors = lines.colors.as_ref().unwrap();
    let mut all: Vec<Vec<_>> = lines
        .strands
        .windows(2)
        .map(|ends| {
            let vertices = ends[0] as usize..ends[1] as usize;
            let mut strand: Vec<_> =
                vertices.map(|at| (lines.positions[at], radii[at], colors[at])).collect();
            if key(strand[0].0) > key(strand[strand.len() - 1].0) {
                strand.reverse();
            }
            strand
        })
        .collect();
    all.sort_by_key(|strand| key(strand[0].0));
    all
}

/// Orders positions, rounded to micrometres.
fn key(position: DVec3) -> [i64; 3] {
    position.to_array().map(|c| (c * 1e6).round() as i64)
}

fn assert_alike(found: &Polylines, expected: &Polylines, tolerance: f64) {
    let (found, expected) = (ordered(found), ordered(expected));
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        assert_eq!(found.len(), expected.len(), "{found:?} {expected:?}");
        for ((a, r, color), (b, s, other)) in found.iter().zip(expected) {
            assert!(a.distance(*b) < tolerance, "{a} {b}");
            assert!(f64::from((r - s).abs()) < tolerance, "{r} {s}");
            assert_eq!(color, other);
        }
    }
}

#[test]
fn a_generated_tree_gives_the_lines_that_it_was_made_of() {
    let parameters = TreeParameters { height: 10.0, leaves: 4000, seed: 3 };
    let mesh = triangles(&parameters, &Progress::none()).mesh;
    let plant = lines(&parameters, &Progress::none());
    let found = converted(&mesh, &BOTH);
    assert_eq!(strands(found.leaves.as_ref()), 4000);
    assert_alike(found.leaves.as_ref().unwrap(), &plant.leaves, 1e-5);
    assert_alike(found.branches.as_ref().unwrap(), &plant.branches, 1e-5);
    // Normals may look to either side.
    let leaves = found.leaves.unwrap();
    assert_eq!(leaves.normals.as_ref().unwrap().len(), leaves.positions.len());
    assert!(leaves.normals.unwrap().iter().all(|normal| normal.is_normalized()));
    let trunk = found.rest.unwrap();
    assert_eq!(trunk.triangles.len(), plant.trunk.mesh.triangles.len());
    assert_eq!(trunk.positions.len(), plant.trunk.mesh.positions.len());
    // Triangles that share no vertices give the same.
    let loose: Vec<usize> = mesh.triangles.iter().flatten().map(|&at| at as usize).collect();
    let loose = Mesh {
        positions: loose.iter().map(|&at| mesh.positions[at]).collect(),
        colors: Some(loose.iter().map(|&at| mesh.colors.as_ref().unwrap()[at]).collect()),
        triangles: (0..mesh.triangles.len() as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect(),
        ..Mesh::default()
    };
    let found = converted(&loose, &BOTH);
    assert_alike(found.leaves.as_ref().unwrap(), &plant.leaves, 1e-5);
    assert_alike(found.branches.as_ref().unwrap(), &plant.branches, 1e-5);
}

#[test]
fn options_choose_what_becomes_lines() {
    let parameters = TreeParameters { height: 10.0, leaves: 400, seed: 5 };
    let mesh = triangles(&parameters, &Progress::none()).mesh;
    let wide = AsLines { max_radius: Some(1.0), ..BOTH };
    let found = converted(&mesh, &wide);
    assert!(found.rest.is_none(), "the trunk is a tube as well");
    let leaves = converted(&mesh, &AsLines { branches: false, ..wide });
    assert!(leaves.branches.is_none() && strands(leaves.leaves.as_ref()) == 400);
    let branches = converted(&mesh, &AsLines { leaves: false, ..wide });
    assert!(branches.leaves.is_none() && branches.branches.is_some());
    let count = |found: &MeshLines| found.rest.as_ref().unwrap().triangles.len();
    assert_eq!(count(&leaves) + count(&branches), mesh.triangles.len());
    let none = converted(&mesh, &AsLines { max_radius: Some(1e-9), ..BOTH });
    assert_eq!(count(&none), mesh.triangles.len());
    assert!(none.leaves.is_none() && none.branches.is_none());
}

/// A mesh of these vertices and triangles, and far away a triangle that makes it large.
fn mesh(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Mesh {
    let last = positions.len() as u32;
    let far = [[1e4, 0.0, 0.0], [1e4, 1.0, 0.0], [1e4, 0.0, 1.0]];
    Mesh {
        positions: positions.iter().chain(&far).map(|&place| place.into()).collect(),
        triangles: triangles.iter().copied().chain([[last, last + 1, last + 2]]).collect(),
        ..Mesh::default()
    }
}

#[test]
fn a_quad_is_a_ribbon_along_its_longer_sides() {
    let square = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [3.0, 1.0, 0.0], [3.0, 0.0, 0.0]];
    for triangles in [[[0, 1, 2], [0, 2, 3]], [[3, 1, 0], [1, 3, 2]], [[2, 3, 1], [0, 1, 3]]] {
        let found = converted(&mesh(&square, &triangles), &BOTH).leaves.unwrap();
        let ends = ordered(&found);
        assert_eq!(ends.len(), 1);
        assert_eq!((ends[0][0].0, ends[0][0].1), (DVec3::new(0.0, 0.5, 0.0), 0.5));
        assert_eq!((ends[0][1].0, ends[0][1].1), (DVec3::new(3.0, 0.5, 0.0), 0.5));
        assert!(found.normals.unwrap().iter().all(|normal| normal.z.abs() == 1.0));
    }
}

#[test]
fn the_leaf_of_the_paper_has_two_tips() {
    // Marroquim 2008, figure 12a: six vertices and four triangles make four vertices.
    let leaf = [
        [0.0, 0.0, 0.0],
        [1.0, -0.4, 0.0],
        [1.0, 0.4, 0.0],
        [2.0, -0.3, 0.2],
        [2.0, 0.3, 0.2],
        [3.0, 0.0, 0.0],
    ];
    let found = converted(&mesh(&leaf, &[[0, 1, 2], [1, 3, 4], [1, 4, 2], [3, 5, 4]]), &BOTH);
    let ribbon = &ordered(found.leaves.as_ref().unwrap())[0];
    let radii: Vec<f32> = ribbon.iter().map(|vertex| vertex.1).collect();
    assert_eq!(radii, [0.0, 0.4, 0.3, 0.0]);
    assert!(ribbon[1].0.distance(DVec3::new(1.0, 0.0, 0.0)) < 1e-12);
}

#[test]
fn balls_boxes_and_forks_stay_triangles() {
    let corner = |at: u32| [at & 1, at >> 1 & 1, at >> 2].map(f64::from);
    let cube: Vec<[f64; 3]> = (0..8).map(corner).collect();
    let quads =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let box_ = mesh(&cube, &faces.collect::<Vec<_>>());
    // A ball of three rings of eight between two tips.
    let mut ball = vec![[0.0, 0.0, 1.0]];
    let mut faces = Vec::new();
    for (ring, z) in [0.7, 0.0, -0.7f64].into_iter().enumerate() {
        let first = 1 + 8 * ring as u32;
        for side in 0..8u32 {
            let (s, c) = (std::f64::consts::TAU * f64::from(side) / 8.0).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            ball.push([radius * c, radius * s, z]);
            let next = first + (side + 1) % 8;
            if ring == 0 {
                faces.push([0, first + side, next]);
            } else {
                faces.extend([
                    [first + side - 8, first + side, next],
                    [first + side - 8, next, next - 8],
                ]);
            }
        }
    }
    faces.extend((0..8).map(|side| [17 + side, 25, 17 + (side + 1) % 8]));
    ball.push([0.0, 0.0, -1.0]);
    let ball = mesh(&ball, &faces);
    // Three triangles about one edge.
    let fin =
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
    let fin = mesh(&fin, &[[0, 1, 2], [0, 1, 3], [0, 1, 4]]);
    for (name, mesh) in [("box", box_), ("ball", ball), ("fin", fin)] {
        let found = converted(&mesh, &BOTH);
        assert!(found.leaves.is_none() && found.branches.is_none(), "{name}");
        assert_eq!(found.rest.unwrap().triangles.len(), mesh.triangles.len(), "{name}");
    }
}

#[test]
fn textures_give_ribbons_their_widths_and_colors() {
    // A leaf that is opaque in the middle half of its width, red, then green, and gone in the last quarter.
    let (width, height) = (64u32, 16u32);
    let texel = |x: u32, y: u32| {
        let color = if x < 24 { [200, 0, 0] } else { [0, 160, 0] };
        let is_there = x < 48 && (4..12).contains(&y);
        [color[0], color[1], color[2], if is_there { 255 } else { 0 }]
    };
    let rgba = (0..height).flat_map(|y| (0..width).map(move |x| texel(x, y))).collect();
    let texture = Texture {
        name: String::new(),
        width,
        height,
        rgba,
        wrap: [Wrap::Repeat; 2],
        filter: Filter::Linear,
        encoding: Encoding::Srgb,
    };
    let material =
        Material { base_texture: Some(0), alpha_cutoff: Some(0.5), ..Material::default() };
    let square = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [4.0, 1.0, 0.0], [4.0, 0.0, 0.0]];
    let mut leaf = mesh(&square, &[[0, 1, 2], [0, 2, 3]]);
    let uvs = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0; 2], [0.0; 2], [0.0; 2]];
    leaf.uvs = Some(uvs.map(Vec2::from).to_vec());
    leaf.parts = vec![MeshPart { triangles: 3, material: Some(0) }];
    let found = lines_of_mesh(&leaf, &[material], &[texture], &BOTH);
    let ribbon = &ordered(found.leaves.as_ref().unwrap())[0];
    let radii: Vec<f32> = ribbon.iter().map(|vertex| vertex.1).collect();
    assert_eq!(radii[..3], [0.25; 3], "{ribbon:?}");
    assert!(ribbon[0].2[0] > 190 && ribbon[0].2[1] == 0, "{ribbon:?}");
    assert!(ribbon[2].2[1] > 150 && ribbon[2].2[0] == 0, "{ribbon:?}");
    let last = ribbon[ribbon.len() - 1];
    assert!(last.1 == 0.0 && last.0.x < 4.0 + 1e-9, "{ribbon:?}");
    assert!(ribbon.iter().all(|vertex| vertex.2[3] == 255));
}

#[test]
fn odd_meshes_are_taken_as_they_are() {
    let nan = f64::NAN;
    let odd = Mesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(nan, nan, nan)],
        triangles: vec![[0, 1, 2], [0, 0, 1], [1, 2, 9], [1, 2, 3], [3, 3, 3]],
        parts: vec![MeshPart { triangles: 9, material: None }],
        ..Mesh::default()
    };
    let found = converted(&odd, &AsLines { max_radius: Some(1e3), ..BOTH });
    let lines = found.leaves.iter().chain(&found.branches);
    assert!(lines.flat_map(|lines| &lines.positions).all(|place| place.is_finite()));
    assert!(converted(&Mesh::default(), &BOTH).rest.is_none());
}

/// The almond tree of the shared data, where it is there: 24,150 leaves of a quad each, 1,636 branches and a trunk.
#[test]
fn a_tree_from_elsewhere_becomes_lines() {
    let file = std::path::Path::new("../shared/data/trees/AlmondWP.obj.gz");
    if !file.is_file() {
        return;
    }
    let asset = crate::assets::read(file, &ReadOptions::default()).unwrap();
    let (mut leaves, mut branches, mut rest) = (0, 0, 0);
    for geometry in &asset.geometries {
        let Geometry::Mesh(mesh) = geometry else { panic!("a mesh") };
        let found = lines_of_mesh(mesh, &asset.materials, &asset.textures, &BOTH);
        leaves += strands(found.leaves.as_ref());
        branches += strands(found.branches.as_ref());
        rest += found.rest.map_or(0, |mesh| mesh.triangles.len());
    }
    println!("{leaves} {branches} {rest}");
    assert!(leaves >= 24_150 && branches > 1_600 && rest < 3_000, "{leaves} {branches} {rest}");
}
