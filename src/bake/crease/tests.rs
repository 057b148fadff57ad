use glam::Vec2;
use proptest::prelude::*;

use super::*;
use crate::assets::MeshPart;

/// A cube with 8 shared vertices.
fn cube() -> Mesh {
    let corner = |i: u32| DVec3::new((i & 1).into(), (i >> 1 & 1).into(), (i >> 2 & 1).into());
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        colors: Some((0..8).map(|i| [i, 0, 0, 255]).collect()),
        uvs: Some((0..8).map(|i| Vec2::splat(i as f32)).collect()),
        parts: vec![MeshPart { triangles: 12, material: None }],
        ..Mesh::default()
    }
}

/// Every triangle with vertices of its own.
fn soup(mesh: &Mesh) -> Mesh {
    let order: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    Mesh {
        positions: order.iter().map(|&v| mesh.positions[v as usize]).collect(),
        triangles: (0..mesh.triangles.len() as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect(),
        ..Mesh::default()
    }
}

fn face_normal(mesh: &Mesh, triangle: &[u32; 3]) -> DVec3 {
    let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
    (b - a).cross(c - a).normalize_or_zero()
}

fn check_lengths(mesh: &Mesh) {
    let count = mesh.positions.len();
    assert_eq!(mesh.normals.as_ref().unwrap().len(), count);
    assert!(mesh.colors.as_ref().is_none_or(|colors| colors.len() == count));
    assert!(mesh.uvs.as_ref().is_none_or(|uvs| uvs.len() == count));
}

#[test]
fn a_cube_splits_at_its_edges_and_keeps_attributes() {
    for crease_deg in [0.0, 30.0, 89.0] {
        let mut mesh = cube();
        smooth_normals(&mut mesh, crease_deg);
        check_lengths(&mesh);
        // Three sides meet at each corner.
        assert_eq!(mesh.positions.len(), 24, "{crease_deg}");
        let normals = mesh.normals.as_ref().unwrap();
        for (triangle, before) in mesh.triangles.iter().zip(&cube().triangles) {
            let expected = face_normal(&mesh, triangle);
            for (&vertex, &old) in triangle.iter().zip(before) {
                let vertex = vertex as usize;
                assert!((normals[vertex].as_dvec3() - expected).length() < 1e-6);
                assert_eq!(mesh.positions[vertex], cube().positions[old as usize]);
                assert_eq!(mesh.colors.as_ref().unwrap()[vertex], [old as u8, 0, 0, 255]);
                assert_eq!(mesh.uvs.as_ref().unwrap()[vertex], Vec2::splat(old as f32));
            }
        }
        assert_eq!(mesh.parts, cube().parts);
    }
}

#[test]
fn above_its_crease_a_cube_is_round() {
    for crease_deg in [91.0, 180.0] {
        for mut mesh in [cube(), soup(&cube())] {
            let count = mesh.positions.len();
            smooth_normals(&mut mesh, crease_deg);
            assert_eq!(mesh.positions.len(), count);
            // Angle weights make the corner's diagonal of it, however quads are cut.
            for (position, normal) in mesh.positions.iter().zip(mesh.normals.unwrap()) {
                let diagonal = (*position - 0.5).normalize_or_zero();
                assert!((normal.as_dvec3() - diagonal).length() < 1e-6, "{position} {normal}");
            }
        }
    }
}

#[test]
fn degenerate_triangles_contribute_nothing() {
    let mut mesh = Mesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ZERO, DVec3::X * 2.0, DVec3::Z],
        // One good, one a line, one a point, one with an index that does not exist.
        triangles: vec![[0, 1, 2], [3, 1, 4], [0, 0, 3], [0, 1, 99]],
        ..Mesh::default()
    };
    smooth_normals(&mut mesh, 60.0);
    let normals = mesh.normals.unwrap();
    assert_eq!(normals[..4], [Vec3::Z; 4]);
    assert_eq!(normals[4..], [Vec3::ZERO; 2]);
    assert_eq!(mesh.triangles[3], [0, 1, 99]);
    let mut empty = Mesh::default();
    smooth_normals(&mut empty, 60.0);
    assert_eq!(empty.normals, Some(Vec::new()));
}

#[test]
fn tiny_and_huge_triangles_have_normals() {
    for scale in [1e-150, 1e150] {
        let mut mesh = cube();
        mesh.positions.iter_mut().for_each(|p| *p *= scale);
        smooth_normals(&mut mesh, 30.0);
        assert_eq!(mesh.positions.len(), 24, "{scale}");
        assert!(mesh.normals.unwrap().iter().all(|n| (n.length() - 1.0).abs() < 1e-6));
    }
}

#[test]
fn given_normals_are_kept() {
    let mut mesh = cube();
    let mut given = vec![Vec3::X; 8];
    mesh.normals = Some(given.clone());
    smooth_normals(&mut mesh, 30.0);
    assert_eq!(mesh.normals, Some(given.clone()));
    given[5] = Vec3::ZERO;
    mesh.normals = Some(given);
    smooth_normals(&mut mesh, 180.0);
    let normals = mesh.normals.unwrap();
    assert_eq!(normals[4], Vec3::X);
    assert!(
        (normals[5].as_dvec3() - DVec3::new(1.0, -1.0, 1.0).normalize_or_zero()).length() < 1e-6
    );
}

/// A cone with many sides: one vertex in all of them.
#[test]
fn a_fan_of_very_many_triangles_is_fast_and_right() {
    let sides = 200_000u32;
    let rim = |i: u32| {
        let (sin, cos) = (f64::from(i) / f64::from(sides) * std::f64::consts::TAU).sin_cos();
        DVec3::new(cos, sin, -1.0)
    };
    for crease_deg in [0.0, 20.0, 180.0] {
        let mut mesh = Mesh {
            positions: std::iter::once(DVec3::ZERO).chain((0..sides).map(rim)).collect(),
            triangles: (0..sides).map(|i| [0, 1 + i, 1 + (i + 1) % sides]).collect(),
            ..Mesh::default()
        };
        let start = std::time::Instant::now();
        smooth_normals(&mut mesh, crease_deg);
        assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
        let normals = mesh.normals.as_ref().unwrap();
        let steep = std::f64::consts::FRAC_1_SQRT_2;
        for triangle in mesh.triangles.iter().step_by(997) {
            let own = face_normal(&mesh, triangle);
            let tip = normals[triangle[0] as usize].as_dvec3();
            assert!((tip.length() - 1.0).abs() < 1e-6);
            if crease_deg < 180.0 {
                let off = tip.dot(own).clamp(-1.0, 1.0).acos().to_degrees();
                assert!(off <= crease_deg + 2.0, "{crease_deg}: {off}");
            } else {
                assert!((tip - DVec3::Z).length() < 1e-3 && own.z > 0.9 * steep);
            }
        }
    }
}

/// `cargo test --release --lib speed_of_smoothing -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, for optimised builds"]
fn speed_of_smoothing() {
    let side = 708u32;
    let at = |i: u32| {
        let (x, y) = (f64::from(i % side), f64::from(i / side));
        DVec3::new(x, y, 5.0 * (x * 0.3).sin() * (y * 0.2).cos())
    };
    let grid = Mesh {
        positions: (0..side * side).map(at).collect(),
        triangles: (0..side * side)
            .filter(|i| i % side + 1 < side && i / side + 1 < side)
            .flat_map(|i| [[i, i + 1, i + side], [i + 1, i + side + 1, i + side]])
            .collect(),
        ..Mesh::default()
    };
    for (name, mesh) in [("shared", grid.clone()), ("soup", soup(&grid))] {
        for crease_deg in [0.0, 30.0, 180.0] {
            let mut mesh = mesh.clone();
            let start = std::time::Instant::now();
            smooth_normals(&mut mesh, crease_deg);
            let (elapsed, triangles) = (start.elapsed(), mesh.triangles.len());
            println!("{name}, {triangles} triangles, crease {crease_deg}°: {elapsed:?}");
        }
    }
}

proptest! {
    #[test]
    fn any_mesh_is_answered(
        positions in proptest::collection::vec(prop::array::uniform3(any::<f64>()), 0..20),
        triangles in proptest::collection::vec(prop::array::uniform3(0u32..22), 0..40),
        crease_deg in any::<f64>(),
    ) {
        let positions = positions.into_iter().map(DVec3::from).collect();
        let mut mesh = Mesh { positions, triangles, ..Mesh::default() };
        smooth_normals(&mut mesh, crease_deg);
        check_lengths(&mesh);
        for normal in mesh.normals.unwrap() {
            prop_assert!(normal == Vec3::ZERO || (normal.length() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn seams_do_not_show(
        heights in proptest::collection::vec(-1f64..1.0, 36),
        crease_deg in 1f64..179.0,
    ) {
        // A rough patch of 6 × 6 vertices, shared and as a soup: corner for corner the same.
        let mesh = Mesh {
            positions: heights
                .iter()
                .enumerate()
                .map(|(i, &z)| DVec3::new((i % 6) as f64, (i / 6) as f64, z))
                .collect(),
            triangles: (0..30u32)
                .filter(|i| i % 6 < 5)
                .flat_map(|i| [[i, i + 1, i + 6], [i + 1, i + 7, i + 6]])
                .collect(),
            ..Mesh::default()
        };
        let (mut shared, mut apart) = (mesh.clone(), soup(&mesh));
        smooth_normals(&mut shared, crease_deg);
        smooth_normals(&mut apart, crease_deg);
        let (a, b) = (shared.normals.unwrap(), apart.normals.unwrap());
        for (s, t) in shared.triangles.iter().flatten().zip(apart.triangles.iter().flatten()) {
            prop_assert!((a[*s as usize] - b[*t as usize]).length() < 1e-4);
        }
    }
}
