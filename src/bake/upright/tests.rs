use glam::{DAffine3, DVec3, Vec3};

use super::*;
use crate::assets::{Asset, Geometry, Mesh, Placement, PointCloud};

/// A surface of revolution about y, whose radius at each height is given, with closed ends.
fn turned(profile: &[(f64, f64)], is_open: bool) -> Mesh {
    const SIDES: u32 = 32;
    let mut mesh = Mesh::default();
    let place = |radius: f64, height: f64, side: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(side) / f64::from(SIDES)).sin_cos();
        DVec3::new(radius * cos, height, -radius * sin)
    };
    for &(radius, height) in profile {
        mesh.positions.extend((0..SIDES).map(|side| place(radius, height, side)));
    }
    for ring in 0..profile.len() as u32 - 1 {
        for side in 0..SIDES {
            let [a, b] = [ring * SIDES + side, ring * SIDES + (side + 1) % SIDES];
            mesh.triangles.extend([[a, b, b + SIDES], [a, b + SIDES, a + SIDES]]);
        }
    }
    let top = (profile.len() as u32 - 1) * SIDES;
    for side in 1..SIDES - 1 {
        mesh.triangles.push([top, top + side, top + side + 1]);
        if !is_open {
            mesh.triangles.push([0, side + 1, side]);
        }
    }
    mesh
}

/// A box between two corners.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let corner =
        |bits: usize| {
            DVec3::from(std::array::from_fn(|axis| {
                if bits >> axis & 1 == 1 { high[axis] } else { low[axis] }
            }))
        };
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        ..Mesh::default()
    }
}

fn asset(format: &'static str, geometries: Vec<Geometry>, turn: DAffine3) -> Asset {
    let placements = (0..geometries.len())
        .map(|geometry| Placement { name: String::new(), geometry, asset_from_geometry: turn })
        .collect();
    Asset { geometries, placements, format, ..Asset::default() }
}

/// Takes y to another axis.
fn to(up: DVec3) -> DAffine3 {
    DAffine3::from_quat(glam::DQuat::from_rotation_arc(DVec3::Y, up))
}

fn up_of(asset: &Asset) -> Guess {
    guess(asset.format, &asset.bounds(), Shape::of(asset).as_ref())
}

/// A bust: a wide base, a chest, a neck, a head.
fn bust(is_open: bool) -> Mesh {
    let profile =
        [(1.0, 0.0), (0.9, 0.6), (0.4, 1.0), (0.3, 1.3), (0.55, 1.7), (0.5, 2.2), (0.1, 2.5)];
    turned(&profile, is_open)
}

/// A table: four legs and a top, narrower than it is long.
fn table() -> Vec<Geometry> {
    let leg = |x: f64, z: f64| cuboid([x, 0.0, z], [x + 0.15, 1.0, z + 0.15]);
    [
        leg(0.0, 0.0),
        leg(1.85, 0.0),
        leg(0.0, 0.85),
        leg(1.85, 0.85),
        cuboid([0.0, 1.0, 0.0], [2.0, 1.1, 1.0]),
    ]
    .map(Geometry::Mesh)
    .to_vec()
}

#[test]
fn statues_stand_on_their_bases_whatever_their_files_say() {
    for format in ["obj", "stl", "e57"] {
        for up in [DVec3::Y, DVec3::Z] {
            for is_open in [false, true] {
                let statue = asset(format, vec![Geometry::Mesh(bust(is_open))], to(up));
                let found = up_of(&statue);
                assert_eq!(found.up, up, "{format} open {is_open}: {found:?}");
                assert!(found.because.contains("it stands on this end"), "{}", found.because);
            }
        }
    }
    // Also upside down, and on its side.
    for up in [DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X] {
        let statue = asset("ply", vec![Geometry::Mesh(bust(false))], to(up));
        assert_eq!(up_of(&statue).up, up);
    }
}

#[test]
fn legs_are_enough_to_stand_on() {
    for (format, up) in [("obj", DVec3::Y), ("stl", DVec3::Z)] {
        let found = up_of(&asset(format, table(), to(up)));
        assert_eq!(found.up, up, "{found:?}");
    }
}

#[test]
fn points_of_a_statue_stand_as_its_surface_does() {
    let mut points = Vec::new();
    for step in 0..200 {
        let height = f64::from(step) / 80.0;
        let radius = if height < 0.6 { 1.0 } else { 0.5 };
        for side in 0..60 {
            let (sin, cos) = (f64::from(side) * 0.1047).sin_cos();
            points.push(DVec3::new(radius * cos, height, radius * sin));
        }
    }
    let cloud = PointCloud { positions: points, ..PointCloud::default() };
    for (format, up) in [("e57", DVec3::Y), ("xyz", DVec3::Y), ("e57", DVec3::Z)] {
        let found = up_of(&asset(format, vec![Geometry::Points(cloud.clone())], to(up)));
        assert_eq!(found.up, up, "{format}: {found:?}");
    }
}

#[test]
fn trees_stand_on_their_stems() {
    let crown = [(0.06, 0.0), (0.05, 0.8), (0.9, 1.0), (1.1, 1.8), (0.9, 2.6), (0.6, 2.9)];
    for up in [DVec3::Y, DVec3::Z] {
        let found = up_of(&asset("obj", vec![Geometry::Mesh(turned(&crown, false))], to(up)));
        assert_eq!(found.up, up, "{found:?}");
    }
}

#[test]
fn land_lies_flat_and_surveys_have_z_up() {
    let at = |i: u32| {
        let (x, y) = (f64::from(i % 100), f64::from(i / 100));
        DVec3::new(x, y, 3.0 * (x * 0.1).sin() * (y * 0.13).cos())
    };
    let cloud = |offset: DVec3| PointCloud {
        positions: (0..10_000).map(|i| at(i) + offset).collect(),
        ..PointCloud::default()
    };
    for format in ["las", "ply", "xyz"] {
        let land = asset(format, vec![Geometry::Points(cloud(DVec3::ZERO))], DAffine3::IDENTITY);
        assert_eq!(up_of(&land).up, DVec3::Z, "{format}");
    }
    let grid = DVec3::new(630_000.0, 850_000.0, 400.0);
    let land = asset("ply", vec![Geometry::Points(cloud(grid))], DAffine3::IDENTITY);
    assert!(up_of(&land).because.contains("survey grid"));
    let statue = asset("las", vec![Geometry::Mesh(bust(false))], to(DVec3::Z));
    assert_eq!(up_of(&statue).up, DVec3::Z);
}

#[test]
fn formats_decide_what_shapes_do_not() {
    let sphere: Vec<(f64, f64)> =
        (1..32).map(|i| (f64::from(i) * 0.098).sin_cos()).map(|(s, c)| (s, -c)).collect();
    let ball = turned(&sphere, false);
    for (format, up) in [("ply", DVec3::Y), ("glb", DVec3::Y), ("laz", DVec3::Z), ("stl", DVec3::Z)]
    {
        let found = up_of(&asset(format, vec![Geometry::Mesh(ball.clone())], DAffine3::IDENTITY));
        assert_eq!(found.up, up, "{format}: {found:?}");
        assert!(found.because.contains(&format!("{} files", format.to_uppercase())), "{found:?}");
    }
    // glTF says so, even where a statue lies.
    let lying = asset("glb", vec![Geometry::Mesh(bust(false))], to(DVec3::Z));
    assert_eq!(up_of(&lying).up, DVec3::Y);
}

#[test]
fn what_has_no_shape_is_guessed_by_its_format() {
    let few = PointCloud { positions: vec![DVec3::ZERO; 5], ..PointCloud::default() };
    let one_place = PointCloud { positions: vec![DVec3::ONE; 5000], ..PointCloud::default() };
    let line = PointCloud {
        positions: (0..5000).map(|i| DVec3::X * f64::from(i)).collect(),
        normals: Some(vec![Vec3::ZERO; 5000]),
        ..PointCloud::default()
    };
    let huge = PointCloud {
        positions: (0..5000).map(|i| DVec3::splat(f64::from(i) * 1e305)).collect(),
        ..PointCloud::default()
    };
    for cloud in [few, one_place, line, huge] {
        let found = up_of(&asset("laz", vec![Geometry::Points(cloud)], DAffine3::IDENTITY));
        assert_eq!(found.up, DVec3::Z, "{found:?}");
    }
    assert_eq!(up_of(&asset("ply", Vec::new(), DAffine3::IDENTITY)).up, DVec3::Y);
}

#[test]
fn shapes_measure_footprint_balance_and_symmetry() {
    let statue = asset("ply", vec![Geometry::Mesh(bust(false))], DAffine3::IDENTITY);
    let shape = Shape::of(&statue).unwrap();
    let [bottom, top] = shape.ends[1];
    assert!((bottom.footprint - 1.0).abs() < 0.1 && bottom.balance > 0.4, "{bottom:?}");
    assert!(top.footprint < 0.1 && bottom.centroid_height < 0.5, "{top:?}");
    assert!((bottom.centroid_height + top.centroid_height - 1.0).abs() < 1e-9);
    assert!(shape.symmetry[0] > 0.8 && shape.symmetry[2] > 0.8 && shape.symmetry[1] < 0.5);
    let open =
        Shape::of(&asset("ply", vec![Geometry::Mesh(bust(true))], DAffine3::IDENTITY)).unwrap();
    assert!(open.ends[1][0].opening > 0.1 && open.ends[1][1].opening < -0.1);
    assert!(shape.ends[1][0].opening.abs() < 0.02);
}
