use std::f64::consts::TAU;

use glam::{Vec2, Vec3};

use super::*;
use crate::assets::MeshPart;

fn mesh(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh { positions, triangles, ..Mesh::default() }
}

/// Rings of points, each with as many, joined by quads and closed by fans about the first and last where `capped`.
fn turned(profile: &[[f64; 2]], sides: u32, capped: bool) -> Mesh {
    let mut found = Mesh::default();
    for &[r, z] in profile {
        for i in 0..sides {
            let (s, c) = (TAU * f64::from(i) / f64::from(sides)).sin_cos();
            found.positions.push(DVec3::new(r * c, r * s, z));
        }
    }
    for ring in 0..profile.len() as u32 - 1 {
        for i in 0..sides {
            let (a, b) = (ring * sides + i, ring * sides + (i + 1) % sides);
            found.triangles.extend([[a, b, b + sides], [a, b + sides, a + sides]]);
        }
    }
    if capped {
        let last = (profile.len() as u32 - 1) * sides;
        for i in 1..sides - 1 {
            found.triangles.extend([[0, i + 1, i], [last, last + i, last + i + 1]]);
        }
    }
    found
}

fn cube() -> Mesh {
    let corner =
        |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
    let quads =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    mesh((0..8).map(corner).collect(), triangles)
}

/// An L, extruded: reflex corners at both ends.
fn bracket() -> Mesh {
    let outline = [[0., 0.], [2., 0.], [2., 1.], [1., 1.], [1., 2.], [0., 2.]];
    let positions = [0.0, 0.5].iter().flat_map(|&z| outline.map(|[x, y]| DVec3::new(x, y, z)));
    let mut triangles = Vec::new();
    for [a, b, c] in [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]] {
        triangles.extend([[a, c, b], [a + 6, b + 6, c + 6]]);
    }
    for i in 0..6 {
        let j = (i + 1) % 6;
        triangles.extend([[i, j, j + 6], [i, j + 6, i + 6]]);
    }
    mesh(positions.collect(), triangles)
}

fn sampled(mesh: &Mesh, spacing: f64) -> PointCloud {
    let options = SampleOptions { spacing: Some(spacing), ..SampleOptions::default() };
    sample_mesh(mesh, &[], &[], &options).unwrap()
}

/// Random places on a mesh, as the faces see them.
fn places(mesh: &Mesh, count: usize) -> Vec<(DVec3, DVec3)> {
    let faces = faces_of(mesh);
    let area: f64 = faces.iter().map(|face| face.area).sum();
    let mut random = SplitMix64::new(11);
    let mut found = Vec::new();
    let mut due = 0.0;
    for Face { corners: [a, b, c], normal, area: own, .. } in faces {
        due += own / area * count as f64;
        while due >= 0.0 {
            due -= 1.0;
            let (mut x, mut y) = (random.unit(), random.unit());
            if x + y > 1.0 {
                (x, y) = (1.0 - x, 1.0 - y);
            }
            found.push((a + (b - a) * x + (c - a) * y, normal));
        }
    }
    found
}

/// Kernel coordinates and height of a place, as a renderer of splats computes them.
fn seen(cloud: &PointCloud, index: usize, place: DVec3) -> (Vec2, f32) {
    let Kernel { u, v } = cloud.kernels.as_ref().unwrap()[index];
    let d = (place - cloud.positions[index]).as_vec3();
    let at = Vec2::new(d.dot(u) / u.length_squared(), d.dot(v) / v.length_squared());
    (at, d.dot(cloud.normals.as_ref().unwrap()[index]))
}

/// Fails unless every place is covered; returns the mean number of disks over one.
fn check(name: &str, mesh: &Mesh, spacing: f64) -> PointCloud {
    let cloud = sampled(mesh, spacing);
    let (normals, radii) = (cloud.normals.as_ref().unwrap(), cloud.radii.as_ref().unwrap());
    assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5));
    let largest = f64::from(radii.iter().copied().fold(0.0, f32::max));
    let mut cells: std::collections::HashMap<[i64; 3], Vec<usize>> = Default::default();
    let key = |p: DVec3| (p / largest).floor().to_array().map(|x| x as i64);
    for (index, position) in cloud.positions.iter().enumerate() {
        cells.entry(key(*position)).or_default().push(index);
    }
    let places = places(mesh, 60_000);
    let (mut open, mut sum) = (0, 0);
    for &(place, normal) in &places {
        let [x, y, z] = key(place);
        let mut over = 0;
        for i in 0..27 {
            let near = cells.get(&[x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
            for &index in near.into_iter().flatten() {
                let (at, height) = seen(&cloud, index, place);
                let faces = normals[index].as_dvec3().dot(normal) > 0.4;
                let kept = cloud.clips.as_ref().unwrap()[index].keeps(at);
                let is_over = at.length() <= CUTOFF * 1.0001 && height.abs() <= 0.21 * radii[index];
                over += i32::from(faces && kept && is_over);
            }
        }
        open += i32::from(over == 0);
        sum += over;
    }
    let area: f64 = faces_of(mesh).iter().map(|face| face.area).sum();
    let lined = cloud.clips.as_ref().unwrap().iter().filter(|clip| **clip != Clip::NONE).count();
    println!(
        "{name}: {} samples for {:.0} squares of the spacing, {lined} clipped, {:.2} disks over a place, {open} of {} open",
        cloud.positions.len(),
        area / spacing.powi(2),
        f64::from(sum) / places.len() as f64,
        places.len()
    );
    assert_eq!(open, 0, "{name}");
    cloud
}

/// The largest distance by which what is kept of the disks juts out of a solid or sheet, and the mean.
fn jut(cloud: &PointCloud, distance: impl Fn(DVec3) -> f64) -> f64 {
    let mut random = SplitMix64::new(4);
    let mut worst = 0.0f64;
    for (index, kernel) in cloud.kernels.as_ref().unwrap().iter().enumerate() {
        for _ in 0..40 {
            let (r, turn) = (f64::from(CUTOFF) * random.unit().sqrt(), TAU * random.unit());
            let at = Vec2::new((r * turn.cos()) as f32, (r * turn.sin()) as f32);
            if cloud.clips.as_ref().unwrap()[index].keeps(at) {
                let place = cloud.positions[index] + (kernel.u * at.x + kernel.v * at.y).as_dvec3();
                worst = worst.max(distance(place));
            }
        }
    }
    worst
}

#[test]
fn a_cube_is_covered_and_ends_at_its_edges() {
    let cloud = check("cube", &cube(), 0.05);
    let outside = |p: DVec3| (p - 0.5).abs().max_element() - 0.5;
    let worst = jut(&cloud, outside);
    println!("cube: juts out by {worst:.2e} of a spacing of 0.05");
    assert!(worst < 0.05 * 0.01);
    let clips = cloud.clips.unwrap();
    assert!(clips.iter().all(|clip| !clip.either));
    assert!(clips.iter().any(|clip| clip.lines[1].is_some()));
    // Larger than the faces: all that is left of the disks is the cube.
    let coarse = check("cube, coarse", &cube(), 0.8);
    assert!(jut(&coarse, outside) < 0.8 / 16.0);
}

#[test]
fn reflex_corners_keep_what_either_line_keeps() {
    let cloud = check("bracket", &bracket(), 0.05);
    let outside = |p: DVec3| {
        let arm = |x: f64, y: f64| (p.x - x).max(p.y - y);
        arm(2.0, 1.0).min(arm(1.0, 2.0)).max(-p.x).max(-p.y).max(p.z - 0.5).max(-p.z)
    };
    let worst = jut(&cloud, outside);
    println!("bracket: juts out by {worst:.2e} of a spacing of 0.05");
    assert!(worst < 0.05 * 0.05);
    assert!(cloud.clips.unwrap().iter().any(|clip| clip.either));
}

#[test]
fn sheets_keep_their_outline() {
    let quad = mesh(
        [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(),
        vec![[0, 1, 2], [0, 2, 3]],
    );
    let cloud = check("sheet", &quad, 0.03);
    assert!(jut(&cloud, |p| (p - 0.5).truncate().abs().max_element() - 0.5) < 0.03 * 0.01);
    // A needle, and a triangle far smaller than the spacing.
    let needle = vec![DVec3::ZERO, DVec3::new(10.0, 0.0, 0.0), DVec3::new(10.0, 1e-3, 0.0)];
    let cloud = check("needle", &mesh(needle, vec![[0, 1, 2]]), 0.05);
    assert!(jut(&cloud, |p| (-p.y).max(p.y - 1e-4 * p.x)) < 0.05 / 8.0);
    let tiny = vec![DVec3::ZERO, DVec3::new(1e-3, 0.0, 0.0), DVec3::new(0.0, 1e-3, 0.0)];
    let cloud = check("speck", &mesh(tiny, vec![[0, 1, 2]]), 1.0);
    assert!(cloud.positions.len() == 1, "{}", cloud.positions.len());
}

#[test]
fn round_shapes_are_covered() {
    let profile: Vec<[f64; 2]> = (1..64)
        .map(|i| {
            let (s, c) = (0.5 * TAU * f64::from(i) / 64.0).sin_cos();
            [s, -c]
        })
        .collect();
    let ball = check("ball", &turned(&profile, 128, true), 0.05);
    assert!(jut(&ball, |p| (p.length() - 1.0).abs()) < 0.01);
    assert!(ball.clips.unwrap().iter().all(|clip| *clip == Clip::NONE));
    check("coarse ball", &turned(&profile, 128, true), 0.3);
    let can = turned(&[[1.0, 0.0], [1.0, 1.0]], 96, true);
    let cloud = check("can", &can, 0.05);
    let worst = jut(&cloud, |p| (p.z - 1.0).max(-p.z).max(p.truncate().length() - 1.0));
    println!("can: juts out by {worst:.2e} of a spacing of 0.05");
    assert!(worst < 0.05 * 0.15);
}

#[test]
fn input_decides_alone() {
    let mut shuffled = cube();
    assert_eq!(sampled(&shuffled, 0.1).clips, sampled(&cube(), 0.1).clips);
    let far = DVec3::new(5e5, 6e6, 100.0);
    shuffled.positions.iter_mut().for_each(|p| *p += far);
    check("far cube", &shuffled, 0.05);
    let nothing = mesh(vec![DVec3::ZERO; 3], vec![[0, 1, 2], [7, 8, 9]]);
    let options = SampleOptions::default();
    assert!(sample_mesh(&nothing, &[], &[], &options).unwrap().positions.is_empty());
    let few = SampleOptions { spacing: Some(0.001), max_samples: 1000, ..options };
    let error = sample_mesh(&cube(), &[], &[], &few).unwrap_err();
    assert_eq!(error, SampleError::TooMany { count: 6_000_000, limit: 1000 });
    for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let broken = SampleOptions { spacing: Some(spacing), ..options };
        let error = sample_mesh(&cube(), &[], &[], &broken).unwrap_err();
        assert!(matches!(error, SampleError::Spacing { .. }));
    }
    let count = sample_mesh(&cube(), &[], &[], &options).unwrap().positions.len();
    println!("cube, automatic: {count}");
    assert!((15_000..30_000).contains(&count), "{count}");
}

#[test]
fn colours_are_averaged_in_linear_light() {
    let mut quad = mesh(
        [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(),
        vec![[0, 1, 2], [0, 2, 3]],
    );
    quad.uvs = Some(quad.positions.iter().map(|p| p.truncate().as_vec2()).collect());
    quad.parts = vec![MeshPart { triangles: 2, material: Some(0) }];
    let checker = |size: u32| Texture {
        name: String::new(),
        width: 256,
        height: 256,
        rgba: (0..65536u32)
            .map(|i| {
                if (i % 256 / size + i / 256 / size).is_multiple_of(2) {
                    [255; 4]
                } else {
                    [0, 0, 0, 255]
                }
            })
            .collect(),
        wrap: [Wrap::Repeat; 2],
        filter: crate::assets::Filter::Linear,
        encoding: crate::assets::Encoding::Srgb,
    };
    use crate::assets::Wrap;
    let material = Material {
        base_color: [1.0, 0.5, 1.0, 1.0],
        base_texture: Some(0),
        alpha_cutoff: Some(0.5),
        ..Material::default()
    };
    let options = SampleOptions { spacing: Some(0.04), ..SampleOptions::default() };
    // Squares far finer than the disks: half the light, 188 in sRGB; green is half of that again, 137.
    let fine =
        sample_mesh(&quad, std::slice::from_ref(&material), &[checker(1)], &options).unwrap();
    for [r, g, _, a] in fine.colors.unwrap() {
        assert!(r.abs_diff(188) <= 2 && g.abs_diff(137) <= 2 && a == 255, "{r} {g} {a}");
    }
    // Squares far larger: black and white, except at their borders.
    let coarse =
        sample_mesh(&quad, std::slice::from_ref(&material), &[checker(128)], &options).unwrap();
    for (position, [r, ..]) in coarse.positions.iter().zip(coarse.colors.unwrap()) {
        let (x, y) = (position.x, position.y);
        let border = |x: f64| (x - (2.0 * x).round() / 2.0).abs();
        if border(x) > 0.05 && border(y) > 0.05 {
            let white = (x < 0.5) == (y < 0.5);
            assert_eq!(r, if white { 255 } else { 0 }, "{x} {y}");
        }
    }
    // Texels below the alpha cut-off are holes.
    let mut holes = checker(128);
    holes.rgba.iter_mut().for_each(|texel| texel[3] = texel[0]);
    let cut = sample_mesh(&quad, &[material], &[holes], &options).unwrap();
    let count = fine.positions.len();
    assert!((0.4..0.6).contains(&(cut.positions.len() as f64 / count as f64)));
    assert!(cut.normals.unwrap().iter().all(|normal| *normal == Vec3::Z));
}

#[test]
#[ignore = "a measurement"]
fn speed_of_sampling() {
    let start = std::time::Instant::now();
    let count = sampled(&cube(), (6.0f64 / 200_000.0).sqrt()).positions.len();
    println!("{count} samples of a cube in {:?}", start.elapsed());
}
