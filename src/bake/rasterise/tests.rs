use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec2, Vec2, Vec3};

use super::super::kernels::CUTOFF;
use super::*;
use crate::assets::{Encoding, Filter, Kernel, MeshPart, Wrap};
use crate::scene::random::SplitMix64;

fn mesh(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh { positions, triangles, ..Mesh::default() }
}

fn box_of(low: DVec3, high: DVec3) -> Mesh {
    let corner =
        |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
    let quads =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    mesh((0..8).map(|i| low + (high - low) * corner(i)).collect(), triangles)
}

fn cube() -> Mesh {
    box_of(DVec3::ZERO, DVec3::ONE)
}

/// A unit sphere of rings of triangles, without vertex normals.
fn sphere(rings: u32) -> Mesh {
    let sides = 2 * rings;
    let mut found = Mesh::default();
    for ring in 0..=rings {
        let (s, c) = (PI * f64::from(ring) / f64::from(rings)).sin_cos();
        for side in 0..sides {
            let (y, x) = (TAU * f64::from(side) / f64::from(sides)).sin_cos();
            found.positions.push(DVec3::new(s * x, s * y, -c));
        }
    }
    for ring in 0..rings {
        for side in 0..sides {
            let (a, b) = (ring * sides + side, ring * sides + (side + 1) % sides);
            found.triangles.extend([[a, b, b + sides], [a, b + sides, a + sides]]);
        }
    }
    found
}

fn smooth(mut mesh: Mesh) -> Mesh {
    mesh.normals = Some(mesh.positions.iter().map(|p| p.as_vec3()).collect());
    mesh
}

fn joined(meshes: &[Mesh]) -> Mesh {
    let mut found = Mesh::default();
    for mesh in meshes {
        let first = found.positions.len() as u32;
        found.positions.extend(&mesh.positions);
        found.triangles.extend(mesh.triangles.iter().map(|t| t.map(|corner| corner + first)));
    }
    found
}

fn moved(mut mesh: Mesh, turn: DQuat, by: DVec3) -> Mesh {
    mesh.positions.iter_mut().for_each(|p| *p = turn * *p + by);
    mesh
}

/// A unit square of irregular triangles.
fn plane(sides: u32) -> Mesh {
    let mut random = SplitMix64::new(5);
    let mut found = Mesh::default();
    for y in 0..=sides {
        for x in 0..=sides {
            let mut shake = |i: u32| {
                let shaken = 0.4 * (random.unit() - 0.5);
                (f64::from(i) + if i.is_multiple_of(sides) { 0.0 } else { shaken })
                    / f64::from(sides)
            };
            found.positions.push(DVec3::new(shake(x), shake(y), 0.0));
        }
    }
    let row = sides + 1;
    for (y, x) in (0..sides).flat_map(|y| (0..sides).map(move |x| (y, x))) {
        let a = y * row + x;
        found.triangles.extend([[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]);
    }
    found
}

fn rasterised(mesh: &Mesh, spacing: f64) -> RasterisedMesh {
    let options = RasteriseOptions { spacing: Some(spacing), ..RasteriseOptions::default() };
    rasterise_mesh(mesh, &[], &[], &options).unwrap()
}

fn area(mesh: &Mesh) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = facet::corners(mesh, *t).unwrap();
        0.5 * (b - a).cross(c - a).length()
    };
    mesh.triangles.iter().map(of).sum()
}

/// Random places on a mesh and the faces' normals there.
fn places(mesh: &Mesh, count: usize) -> Vec<(DVec3, DVec3)> {
    let total = area(mesh);
    let mut random = SplitMix64::new(11);
    let (mut found, mut due) = (Vec::new(), -0.5);
    for triangle in &mesh.triangles {
        let [a, b, c] = facet::corners(mesh, *triangle).unwrap();
        let cross = (b - a).cross(c - a);
        due += 0.5 * cross.length() / total * count as f64;
        while due >= 0.0 {
            due -= 1.0;
            let (mut x, mut y) = (random.unit(), random.unit());
            if x + y > 1.0 {
                (x, y) = (1.0 - x, 1.0 - y);
            }
            found.push((a + (b - a) * x + (c - a) * y, cross.normalize_or_zero()));
        }
    }
    found
}

/// Fails unless the disks, seen from straight above, cover 20 000 places of the mesh.
fn check(name: &str, mesh: &Mesh, spacing: f64) -> RasterisedMesh {
    let found = rasterised(mesh, spacing);
    let cloud = &found.cloud;
    let (normals, kernels) = (cloud.normals.as_ref().unwrap(), cloud.kernels.as_ref().unwrap());
    assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5));
    let size = 2.0 * spacing;
    let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    let key = |p: DVec3| (p / size).floor().to_array().map(|x| x as i64);
    for (index, position) in cloud.positions.iter().enumerate() {
        cells.entry(key(*position)).or_default().push(index);
    }
    let is_over = |index: usize, place: DVec3, face: DVec3| {
        let normal = normals[index].as_dvec3();
        let offset = place - cloud.positions[index];
        let rise = -offset.dot(normal) / normal.dot(face);
        let on = offset + face * rise;
        let [u, v] = [kernels[index].u, kernels[index].v].map(|axis| axis.as_dvec3());
        let at = DVec2::new(on.dot(u) / u.length_squared(), on.dot(v) / v.length_squared());
        normal.dot(face) > 0.2
            && rise.abs() <= 0.5001 * spacing
            && at.length() <= f64::from(CUTOFF) * 1.0005
    };
    let places = places(mesh, 20_000);
    let (mut open, mut sum) = (0, 0);
    for &(place, face) in &places {
        let [x, y, z] = key(place);
        let near = (0..27)
            .filter_map(|i| cells.get(&[x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]))
            .flatten();
        let over = near.filter(|index| is_over(**index, place, face)).count();
        open += usize::from(over == 0);
        sum += over;
    }
    let cells = area(mesh) / spacing.powi(2);
    println!(
        "{name}: {} samples, {:.3} a cell, {:.2} disks over a place, {open} of {} open",
        cloud.positions.len(),
        cloud.positions.len() as f64 / cells,
        sum as f64 / places.len() as f64,
        places.len()
    );
    assert_eq!(open, 0, "{name}");
    found
}

/// Samples over cells.
fn ratio(found: &RasterisedMesh, mesh: &Mesh) -> f64 {
    found.triangles.len() as f64 * found.spacing.powi(2) / area(mesh)
}

#[test]
fn cubes_are_covered() {
    for spacing in [0.5, 0.13, 0.03] {
        check("cube", &cube(), spacing);
        let turn = DQuat::from_rotation_y(0.5) * DQuat::from_rotation_x(0.3);
        check("turned cube", &moved(cube(), turn, DVec3::ZERO), spacing);
        let corner = DQuat::from_rotation_arc(DVec3::ONE.normalize_or_zero(), DVec3::Z);
        check("cube on its corner", &moved(cube(), corner, DVec3::ZERO), spacing);
    }
    let far = moved(cube(), DQuat::IDENTITY, DVec3::new(5e5, 6e6, 100.0));
    check("far cube", &far, 0.05);
    // Faces, and all their triangles' corners, lie on multiples of the spacing.
    let boxes: Vec<Mesh> = (0..3)
        .map(|i| box_of(DVec3::splat(2.0 * f64::from(i)), DVec3::splat(2.0 * f64::from(i) + 1.0)))
        .collect();
    for spacing in [0.0625, 0.125, 0.25, 0.5] {
        let boxes = joined(&boxes);
        let found = check("boxes on the grid", &boxes, spacing);
        assert!((0.99..1.02).contains(&ratio(&found, &boxes)), "{}", ratio(&found, &boxes));
    }
}

#[test]
fn spheres_are_covered_by_no_more_than_it_takes() {
    for (rings, spacing) in [(200, 0.02), (200, 0.05), (24, 0.02), (24, 0.1), (8, 0.05)] {
        for (name, ball) in [("ball", sphere(rings)), ("smooth ball", smooth(sphere(rings)))] {
            let found = check(&format!("{name} of {rings}, {spacing}"), &ball, spacing);
            let ratio = ratio(&found, &ball);
            assert!((0.57..1.05).contains(&ratio) || spacing > 0.06, "{ratio}");
        }
    }
    // Coarser than the shape.
    check("ball, coarse", &sphere(24), 0.4);
}

#[test]
fn needles_specks_and_sheets_are_covered() {
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.64, 0.48), 0.7);
    let needle = |width: f64, length: f64| {
        let corners = [[0.0, 0.0], [length, 0.0], [length, width]];
        let positions = corners.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        moved(mesh(positions, vec![[0, 1, 2]]), turn, DVec3::ZERO)
    };
    for (width, most) in [(1e-6, 220), (1e-2, 220), (0.06, 330)] {
        let found = check("needle", &needle(width, 10.0), 0.05);
        assert!(found.triangles.len() <= most, "{}", found.triangles.len());
    }
    // A strip, and a fan, of triangles thinner than cells.
    let strip: Vec<Mesh> = (0..400)
        .map(|i| moved(needle(1e-2, 3.0), DQuat::IDENTITY, turn * DVec3::Y * 1e-2 * f64::from(i)))
        .collect();
    check("strip of needles", &joined(&strip), 0.05);
    let mut fan = mesh(vec![DVec3::ZERO], Vec::new());
    for i in 0..=2000u32 {
        let (y, x) = (TAU * f64::from(i) / 2000.0).sin_cos();
        fan.positions.push(turn * DVec3::new(x, y, 0.0));
        fan.triangles.extend((i > 0).then_some([0, i, i + 1]));
    }
    let found = check("fan", &fan, 0.03);
    assert!(ratio(&found, &fan) < 1.06, "{}", ratio(&found, &fan));
    let sheets = [0.0, 0.01].map(|z| moved(plane(7), turn, turn * DVec3::Z * z));
    let found = check("two sheets", &joined(&sheets), 0.04);
    let of_first = found.triangles.iter().filter(|t| **t < 98).count();
    assert!(of_first.abs_diff(found.triangles.len() - of_first) < found.triangles.len() / 10);
    // Parts smaller than a cell do not vanish, nor does each of their triangles get a sample.
    let specks: Vec<Mesh> = (0..50)
        .map(|i| moved(sphere(6), DQuat::IDENTITY, DVec3::new(50.0 * f64::from(i), 3.0, 7.0)))
        .collect();
    let found = check("specks", &joined(&specks), 10.0);
    let per_speck = 2 * 6 * 12;
    for speck in 0..50 {
        let own = found.triangles.iter().filter(|t| **t / per_speck == speck).count();
        assert!((1..=14).contains(&own), "{own}");
    }
}

#[test]
fn a_plane_has_one_sample_for_each_cell() {
    let tilts = [(0.0, 1.0), (0.25 * PI, 0.5f64.sqrt()), (0.4, 0.4f64.cos())];
    for ((turn, steep), sides) in tilts.into_iter().flat_map(|t| [1, 30, 300].map(|n| (t, n))) {
        let plane = moved(plane(sides), DQuat::from_rotation_x(turn), DVec3::ZERO);
        let found = check(&format!("plane of {sides}, turned by {turn:.2}"), &plane, 0.009);
        let ratio = ratio(&found, &plane) / steep;
        assert!((0.97..1.03).contains(&ratio), "{ratio}");
        let positions = &found.cloud.positions;
        let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
        let key = |p: DVec3| (p / 0.009).floor().to_array().map(|x| x as i64);
        for (index, p) in positions.iter().enumerate() {
            let [x, y, z] = key(*p);
            for i in 0..27 {
                let near = cells.get(&[x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
                let mut others = near.into_iter().flatten().map(|other| positions[*other]);
                assert!(others.all(|other| other.distance(*p) >= 0.5 * 0.009));
            }
            cells.entry([x, y, z]).or_default().push(index);
        }
    }
}

#[test]
fn samples_lie_on_their_triangles_with_kernels_across_their_normals() {
    for mesh in [smooth(sphere(24)), cube(), plane(20)] {
        let RasterisedMesh { cloud, triangles, .. } = rasterised(&mesh, 0.03);
        assert!(cloud.oriented && triangles.is_sorted());
        for (index, (p, triangle)) in cloud.positions.iter().zip(triangles).enumerate() {
            let [a, b, c] = facet::corners(&mesh, mesh.triangles[triangle as usize]).unwrap();
            let cross = (b - a).cross(c - a);
            let (normal, double) = (cross.normalize_or_zero(), cross.length());
            assert!((*p - a).dot(normal).abs() < 1e-9);
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let weight = (to - from).cross(*p - from).dot(normal) / double;
                assert!(weight > -1e-9);
            }
            let Kernel { u, v } = cloud.kernels.as_ref().unwrap()[index];
            let own = cloud.normals.as_ref().unwrap()[index];
            assert!(u.dot(v).abs() < 1e-5 * u.length() * v.length());
            assert!(u.cross(v).normalize_or_zero().dot(own) > 1.0 - 1e-5);
            assert!(own.as_dvec3().dot(normal) >= 0.5);
            let disk = f64::from(u.length() * v.length() * CUTOFF * CUTOFF).sqrt();
            assert!((f64::from(cloud.radii.as_ref().unwrap()[index]) / disk - 1.0).abs() < 1e-4);
        }
    }
    // Normals that contradict the faces are not taken.
    let mut odd = cube();
    odd.normals = Some(vec![Vec3::Z; 8]);
    let normals = rasterised(&odd, 0.1).cloud.normals.unwrap();
    assert!(normals.iter().all(|normal| normal.abs().max_element() > 0.999));
    assert!(normals.contains(&Vec3::NEG_Z) && normals.contains(&Vec3::X));
}

#[test]
fn threads_change_nothing() {
    let shapes = joined(&[sphere(60), plane(3), box_of(DVec3::splat(2.0), DVec3::splat(5.0))]);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| rasterised(&shapes, 0.012))
    };
    let (one, three) = (on(1), on(3));
    assert!(one.triangles.len() > 100_000);
    assert_eq!(one.triangles, three.triangles);
    assert_eq!(one.cloud.positions, three.cloud.positions);
    assert_eq!(one.cloud.normals, three.cloud.normals);
    assert_eq!(one.cloud.kernels, three.cloud.kernels);
    assert_eq!(one.cloud.colors, three.cloud.colors);
}

fn checker(size: u32) -> Texture {
    let is_white = |i: u32| (i % 256 / size + i / 256 / size).is_multiple_of(2);
    let texel = |i: u32| if is_white(i) { [255; 4] } else { [0, 0, 0, 255] };
    Texture {
        name: String::new(),
        width: 256,
        height: 256,
        rgba: (0..65536u32).map(texel).collect(),
        wrap: [Wrap::Repeat; 2],
        filter: Filter::Linear,
        encoding: Encoding::Srgb,
    }
}

#[test]
fn textures_are_averaged_and_cut_out() {
    let mut quad = plane(4);
    quad.uvs = Some(quad.positions.iter().map(|p| p.truncate().as_vec2()).collect::<Vec<Vec2>>());
    quad.parts = vec![MeshPart { triangles: 32, material: Some(0) }];
    let material = Material {
        base_color: [1.0, 0.5, 1.0, 1.0],
        base_texture: Some(0),
        alpha_cutoff: Some(0.5),
        ..Material::default()
    };
    let options = RasteriseOptions { spacing: Some(0.06), ..RasteriseOptions::default() };
    let with = |texture: Texture| {
        rasterise_mesh(&quad, std::slice::from_ref(&material), &[texture], &options).unwrap()
    };
    // Squares far finer than the disks: half the light, 188 in sRGB; green is half of that again, 137.
    let fine = with(checker(1));
    for [r, g, _, a] in fine.cloud.colors.unwrap() {
        assert!(r.abs_diff(188) <= 2 && g.abs_diff(137) <= 2 && a == 255, "{r} {g} {a}");
    }
    // Two squares as large as half the plane are cut out.
    let mut holes = checker(128);
    holes.rgba.iter_mut().for_each(|texel| texel[3] = texel[0]);
    let RasterisedMesh { cloud, triangles, .. } = with(holes);
    let part = cloud.positions.len() as f64 / fine.triangles.len() as f64;
    assert!((0.4..0.6).contains(&part), "{part}");
    let kept = |p: &DVec3| ((p.x - 0.5) * (p.y - 0.5)) > -0.03;
    assert!(cloud.positions.iter().all(kept));
    for length in [cloud.colors.unwrap().len(), cloud.kernels.unwrap().len(), triangles.len()] {
        assert_eq!(length, cloud.positions.len());
    }
}

#[test]
fn colours_of_vertices_and_parts_are_taken() {
    let mut quad = plane(1);
    let materials = [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]]
        .map(|base_color| Material { base_color, ..Material::default() });
    quad.parts = vec![
        MeshPart { triangles: 1, material: Some(0) },
        MeshPart { triangles: 1, material: Some(1) },
    ];
    let options = RasteriseOptions { spacing: Some(0.05), ..RasteriseOptions::default() };
    let found = rasterise_mesh(&quad, &materials, &[], &options).unwrap();
    for (color, triangle) in found.cloud.colors.unwrap().into_iter().zip(found.triangles) {
        assert_eq!(color, [[255, 0, 0, 255], [0, 0, 255, 255]][triangle as usize]);
    }
    quad.parts.clear();
    let white = |p: &DVec3| if p.x < 0.5 { [0, 0, 0, 255] } else { [255; 4] };
    quad.colors = Some(quad.positions.iter().map(white).collect());
    let found = rasterise_mesh(&quad, &[], &[], &options).unwrap();
    for (p, [r, ..]) in found.cloud.positions.iter().zip(found.cloud.colors.unwrap()) {
        let linear = crate::scene::color::linear_from_srgb(f64::from(r) / 255.0);
        assert!((linear - p.x).abs() < 0.01, "{linear} {}", p.x);
    }
}

#[test]
fn what_cannot_be_sampled_is_skipped_or_refused() {
    let far = DVec3::new(f64::NAN, 0.0, 0.0);
    let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 2.0, far];
    let mut odd = mesh(positions, vec![[0, 1, 3], [0, 1, 4], [0, 1, 9], [2, 2, 2]]);
    let options = RasteriseOptions::default();
    let nothing = rasterise_mesh(&odd, &[], &[], &options).unwrap();
    assert!(nothing.triangles.is_empty() && nothing.spacing == 0.0);
    assert!(rasterised(&odd, 0.1).triangles.is_empty());
    odd.triangles.push([0, 1, 2]);
    let found = rasterised(&odd, 0.1).triangles;
    assert!(!found.is_empty() && found.iter().all(|triangle| *triangle == 4));
    for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let broken = RasteriseOptions { spacing: Some(spacing), ..options };
        let error = rasterise_mesh(&cube(), &[], &[], &broken).unwrap_err();
        assert!(matches!(error, SampleError::Spacing { .. }));
    }
    let few = |spacing| RasteriseOptions { spacing, max_samples: 1000 };
    let error = rasterise_mesh(&cube(), &[], &[], &few(Some(0.001))).unwrap_err();
    let SampleError::TooMany { count, limit: 1000 } = error else { unreachable!() };
    assert!(count.abs_diff(6_000_000) < 2);
    // A triangle with hardly any area takes many samples along its length; so do many such triangles.
    let needle = |length: f64| vec![DVec3::ZERO, DVec3::X * length, DVec3::new(length, 1e-6, 0.0)];
    let needle = |length: f64| mesh(needle(length), vec![[0, 1, 2]]);
    for length in [1e9, 300.0] {
        let error = rasterise_mesh(&needle(length), &[], &[], &few(Some(0.1))).unwrap_err();
        assert!(matches!(error, SampleError::TooMany { limit: 1000, .. }));
    }
    // Farther off than there are numbers for cells.
    let odd = joined(&[needle(1e-9), moved(needle(1e4), DQuat::IDENTITY, DVec3::X * 1e19)]);
    assert!(!rasterised(&odd, 1e-2).triangles.is_empty());
    let hairs: Vec<Mesh> = (0..40)
        .map(|i| moved(needle(50.0), DQuat::IDENTITY, DVec3::Y * 20.0 * f64::from(i)))
        .collect();
    let count = rasterise_mesh(&joined(&hairs), &[], &[], &few(None)).unwrap().triangles.len();
    println!("hairs, automatic: {count}");
    assert!((250..=1000).contains(&count), "{count}");
}

#[test]
fn spacing_follows_from_what_there_is() {
    let options = RasteriseOptions::default();
    let count = |mesh: &Mesh, options: &RasteriseOptions| {
        rasterise_mesh(mesh, &[], &[], options).unwrap().triangles.len()
    };
    let of_cube = count(&cube(), &options);
    let of_ball = count(&sphere(120), &options);
    let limited = count(&sphere(120), &RasteriseOptions { max_samples: 30_000, ..options });
    println!("automatic: a cube {of_cube}, a ball {of_ball}, a limited one {limited}");
    assert!((20_000..22_000).contains(&of_cube));
    assert!((110_000..130_000).contains(&of_ball));
    assert!((14_000..17_000).contains(&limited));
}

#[test]
#[ignore = "a measurement"]
fn speed_of_rasterising() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for (name, mesh) in [("cube", cube()), ("ball of 2 M triangles", smooth(sphere(700)))] {
        let options = RasteriseOptions::default();
        let options = if mesh.triangles.len() < 100 {
            RasteriseOptions { spacing: Some(0.0015), ..options }
        } else {
            options
        };
        let start = std::time::Instant::now();
        let found = pool.install(|| rasterise_mesh(&mesh, &[], &[], &options)).unwrap();
        let count = found.triangles.len();
        let rate = count as f64 / start.elapsed().as_secs_f64() / 1e6;
        println!("{name}: {count} samples, {rate:.2} M a second on one core");
    }
}
