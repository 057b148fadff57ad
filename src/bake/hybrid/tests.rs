use super::*;

#[allow(dead_code, reason = "the tests of the engine use all of it")]
#[path = "../../../tests/engine/sheets.rs"]
mod sheets;

use crate::scene::random::SplitMix64;

/// A flat grid of small triangles beside a large one.
fn mixed() -> Mesh {
    let mut mesh = Mesh::default();
    for y in 0..21 {
        for x in 0..21 {
            mesh.positions.push(DVec3::new(f64::from(x), f64::from(y), 0.0) * 0.05);
        }
    }
    for y in 0..20u32 {
        for x in 0..20 {
            let at = 21 * y + x;
            mesh.triangles.extend([[at, at + 1, at + 22], [at, at + 22, at + 21]]);
        }
    }
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([[2.0, 0.0, 0.0], [5.0, 0.0, 0.0], [2.0, 4.0, 0.0]].map(DVec3::from));
    mesh.triangles.push([first, first + 1, first + 2]);
    mesh
}

#[test]
fn large_triangles_have_one_sample_that_covers_them() {
    let mesh = mixed();
    let hybrid = hybrid_mesh(&mesh, &[], &[], 1 << 20).unwrap();
    let large: Vec<usize> =
        (0..hybrid.stands.len()).filter(|&i| hybrid.stands[i].error > 1.0).collect();
    let [only] = large[..] else { panic!("{large:?}") };
    assert!((hybrid.stands[only].error - 5.0).abs() < 1e-5);
    let kernel = hybrid.samples.kernels.as_ref().unwrap()[only];
    for corner in &mesh.positions[mesh.positions.len() - 3..] {
        let way = *corner - hybrid.samples.positions[only];
        assert!(way.length() <= f64::from(CUTOFF * kernel.u.length()) * 1.001);
    }
    let small = hybrid.samples.positions.len() - 1;
    assert!((400..2000).contains(&small), "{small}");
}

/// Triangles of all kinds about a grid of small ones, most of them needles.
fn with_needles(count: u32, random: &mut impl FnMut() -> f64) -> Mesh {
    let mut mesh = mixed();
    mesh.triangles.pop();
    for _ in 0..count {
        let first = mesh.positions.len() as u32;
        let from = DVec3::new(3.0, random(), random());
        let along = DVec3::new(random(), random(), random()) + 0.5;
        let across = DVec3::new(random(), random(), random()) * random().powi(4);
        mesh.positions.extend([from, from + along, from + along * random() + across]);
        let mut corners = [first, first + 1, first + 2];
        corners.rotate_left((3.0 * random()) as usize);
        mesh.triangles.push(corners);
    }
    mesh
}

#[test]
fn disks_along_needles_cover_them() {
    let mut numbers = SplitMix64::new(8);
    let mut random = || numbers.unit();
    let (mut most, mut fewest) = (0, usize::MAX);
    let mesh = with_needles(200, &mut random);
    for triangle in &mesh.triangles[mesh.triangles.len() - 200..] {
        let corners = triangle.map(|v| mesh.positions[v as usize]);
        let count = needles::wanted(corners, 0.02) as usize;
        let disks: Vec<needles::Disk> = needles::disks(corners, count).collect();
        assert_eq!(disks.len(), count);
        (most, fewest) = (most.max(count), fewest.min(count));
        // Little is covered beside a needle.
        let covered: f64 =
            disks.iter().map(|disk| std::f64::consts::PI * disk.radius.powi(2)).sum();
        let longest = longest_side(corners);
        assert!(count == 16 || covered < 16.0 * longest * (area_of(corners) / longest).max(0.02));
        for _ in 0..50 {
            let weights = [0; 3].map(|_| random().powi(3));
            let sum: f64 = weights.iter().sum();
            let at = corners.iter().zip(weights).map(|(corner, weight)| *corner * (weight / sum));
            let at: DVec3 = at.sum();
            let is_in =
                |disk: &needles::Disk| at.distance(disk.centre) <= disk.radius * (1.0 + 1e-9);
            assert!(disks.iter().any(is_in), "{corners:?} {at}");
        }
    }
    assert!(most == 16 && fewest == 1, "{fewest} to {most}");
}

/// Meshes that consist of needles keep about as many samples as they had.
#[test]
fn needles_share_a_limited_number_of_samples() {
    let mut numbers = SplitMix64::new(9);
    let mut random = || numbers.unit();
    let few = with_needles(40, &mut random);
    let many = with_needles(600, &mut random);
    let samples =
        |mesh: &Mesh, limit| hybrid_mesh(mesh, &[], &[], limit).unwrap().samples.positions.len();
    let small = samples(&Mesh { triangles: few.triangles[..800].to_vec(), ..few.clone() }, 1 << 20);
    let found = samples(&few, 1 << 20);
    assert!(found > small + 80 && found <= small + 40 + few.triangles.len() / 4, "{small} {found}");
    let found = samples(&many, 1 << 20);
    let least = small + 600 + many.triangles.len() / 8;
    assert!((least..=small + 600 + many.triangles.len() / 4).contains(&found), "{small} {found}");
    // The limit of all samples leaves room for one each.
    assert_eq!(samples(&many, (small + 600) as u64), small + 600);
}

/// From any viewpoint, a triangle is drawn where one of its samples is not.
#[test]
fn a_sample_or_its_triangle_is_drawn() {
    let mesh = mixed();
    let hybrid = hybrid_mesh(&mesh, &[], &[], 1 << 20).unwrap();
    let mut numbers = SplitMix64::new(1);
    for (index, stands) in hybrid.stands.iter().enumerate() {
        let at = hybrid.samples.positions[index];
        let accepted = (numbers.next_u64() % 1000) as f32 * 1e-3 * 2.0 * stands.error;
        let drawn = stands.error <= accepted;
        let triangle = mesh.triangles.iter().enumerate().find(|(_, triangle)| {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            let side = |a: DVec3, b: DVec3| (b - a).cross(at - a).z >= -1e-9;
            side(a, b) && side(b, c) && side(c, a)
        });
        let Some((number, _)) = triangle else { continue };
        assert!(drawn || hybrid.sides[number] > accepted);
    }
}

/// At an error from which on a triangle is not drawn, the samples over each of its places are.
#[test]
fn samples_replace_every_triangle_that_they_cover() {
    let mut numbers = SplitMix64::new(3);
    let mut random = || numbers.unit();
    let even = sheets::sheet(40, 0.45, 1.0, &mut random);
    let graded = sheets::sheet(40, 0.3, 2.0, &mut random);
    let divided = sheets::split(sheets::sheet(30, 0.4, 1.0, &mut random), 0.5, &mut random);
    for (positions, triangles) in [even, graded, divided] {
        let mesh = Mesh { positions, triangles, ..Mesh::default() };
        let hybrid = hybrid_mesh(&mesh, &[], &[], 1 << 20).unwrap();
        let kernels = hybrid.samples.kernels.as_ref().unwrap();
        for (triangle, side) in mesh.triangles.iter().zip(&hybrid.sides) {
            let corners = triangle.map(|v| mesh.positions[v as usize]);
            for _ in 0..4 {
                let [p, q, r] = [0; 3].map(|_| random());
                let sum = p + q + r;
                let at = (corners[0] * p + corners[1] * q + corners[2] * r) / sum;
                let covers = |&number: &usize| {
                    let way = (at - hybrid.samples.positions[number]).as_vec3();
                    let along = |axis: Vec3| way.dot(axis) / axis.length_squared();
                    let place = along(kernels[number].u).hypot(along(kernels[number].v));
                    place <= CUTOFF * 1.0001 && hybrid.stands[number].error <= *side
                };
                assert!((0..kernels.len()).any(|number| covers(&number)), "{at} {side}");
            }
        }
    }
}

#[test]
fn solids_are_watertight_and_sheets_are_not() {
    let corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
    let positions = corners.map(|p| DVec3::from(p.map(f64::from))).to_vec();
    let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let solid = Mesh { positions, triangles, ..Mesh::default() };
    assert!(is_watertight(&solid));
    let mut open = solid.clone();
    open.triangles.pop();
    assert!(!is_watertight(&open) && !is_watertight(&mixed()));
    let mut inside_out = solid.clone();
    inside_out.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    assert!(!is_watertight(&inside_out));
    // Each triangle gets vertices of its own.
    let mut split = Mesh::default();
    for triangle in &solid.triangles {
        let first = split.positions.len() as u32;
        split.positions.extend(triangle.map(|v| solid.positions[v as usize]));
        split.triangles.push([first, first + 1, first + 2]);
    }
    assert!(is_watertight(&split));
    let mut numbers = SplitMix64::new(5);
    let mut random = || numbers.unit();
    let (positions, triangles) =
        sheets::crumpled(sheets::ball(60, 0.4, &mut random), 0.1, &mut random);
    assert!(is_watertight(&Mesh { positions, triangles, ..Mesh::default() }));
}

#[test]
fn nothing_to_draw_has_no_samples() {
    let flat = Mesh {
        positions: vec![DVec3::ZERO; 3],
        triangles: vec![[0, 1, 2], [0, 1, 9]],
        ..Mesh::default()
    };
    let hybrid = hybrid_mesh(&flat, &[], &[], 10).unwrap();
    assert!(hybrid.samples.positions.is_empty() && hybrid.sides == [0.0, 0.0]);
}

#[test]
fn too_many_samples_are_refused() {
    assert!(matches!(
        hybrid_mesh(&mixed(), &[], &[], 100),
        Err(SampleError::TooMany { limit: 100, .. })
    ));
}

#[test]
fn translucent_triangles_are_never_replaced() {
    let mesh = mixed();
    let (all, half) = (mesh.triangles.len(), mesh.triangles.len() / 2);
    let parts = [(half, 0), (all - half, 1)].map(|(triangles, number)| MeshPart {
        triangles: triangles as u32,
        material: Some(number),
    });
    let mesh = Mesh { parts: parts.to_vec(), ..mesh };
    let solid = Material::default();
    let glass = Material { translucent: true, ..Material::default() };
    let baked = hybrid_mesh(&mesh, &[solid, glass.clone()], &[], 1 << 20).unwrap();
    assert!(baked.sides[half..].iter().all(|&side| side == ALWAYS));
    assert!(
        baked.sides[..half].iter().all(|&side| side < 1e3) && !baked.samples.positions.is_empty()
    );
    let nothing = hybrid_mesh(&mesh, &[glass.clone(), glass], &[], 1 << 20).unwrap();
    assert!(
        nothing.samples.positions.is_empty() && nothing.sides.iter().all(|&side| side == ALWAYS)
    );
}
