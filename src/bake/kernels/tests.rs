use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::assets::PointCloud;
use crate::bake::attributes::estimate_kernels;

/// Reproducible numbers in [0, 1).
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut random = crate::scene::random::SplitMix64::new(seed);
    move || random.unit()
}

fn cloud(positions: Vec<DVec3>) -> PointCloud {
    let mut cloud = PointCloud { positions, ..PointCloud::default() };
    estimate_kernels(&mut cloud);
    check(&cloud);
    cloud
}

/// Samples that lie one over the other would be drawn one over the other: all together, they cover what one may.
#[test]
fn many_samples_at_few_places_are_small_together() {
    for count in [1, 2, 300, 20_001] {
        let places = (0..count).map(|i| DVec3::X * f64::from(i32::from(i % 2 == 0 && count > 100)));
        let found = cloud(places.collect());
        let area = |kernel: &Kernel| 4.0 * kernel.u.length() * kernel.v.length();
        let sum: f32 = found.kernels.unwrap().iter().map(area).sum();
        assert!((0.01..2.0).contains(&sum), "{count}: {sum}");
        assert!(found.radii.unwrap().iter().map(|radius| radius * radius).sum::<f32>() < 2.0);
    }
}

/// Checks the guarantees of every kernel.
fn check(cloud: &PointCloud) {
    let (kernels, normals) = (cloud.kernels.as_ref().unwrap(), cloud.normals.as_ref().unwrap());
    assert_eq!(kernels.len(), cloud.positions.len());
    for (kernel, normal) in kernels.iter().zip(normals) {
        assert!(is_kernel(kernel), "{kernel:?}");
        let (u, v) = (kernel.u.normalize_or_zero(), kernel.v.normalize_or_zero());
        assert!(u.dot(v).abs() < 1e-4, "{kernel:?}");
        if *normal != Vec3::ZERO {
            assert!(u.cross(v).dot(*normal) > 0.999, "{kernel:?} {normal}");
        }
    }
}

fn covers(cloud: &PointCloud, index: usize, point: DVec3) -> bool {
    let Kernel { u, v } = cloud.kernels.as_ref().unwrap()[index];
    let d = (point - cloud.positions[index]).as_vec3();
    let (s, t) = (d.dot(u) / u.length_squared(), d.dot(v) / v.length_squared());
    s * s + t * t <= CUTOFF * CUTOFF
}

/// The share of random points of a square about the middle of a sampled plane that no disk covers, and how many disks
/// cover one on average.
fn holes(positions: Vec<DVec3>, half: f64) -> (f64, f64) {
    let cloud = cloud(positions);
    let mut random = noise(3);
    let (mut open, mut sum) = (0usize, 0usize);
    for _ in 0..4000 {
        let point = DVec3::new((2.0 * random() - 1.0) * half, (2.0 * random() - 1.0) * half, 0.0);
        let found = (0..cloud.positions.len()).filter(|&i| covers(&cloud, i, point)).count();
        open += usize::from(found == 0);
        sum += found;
    }
    (open as f64 / 4000.0, sum as f64 / 4000.0)
}

fn grid(nx: i32, ny: i32, mut at: impl FnMut(f64, f64) -> [f64; 2]) -> Vec<DVec3> {
    (0..nx * ny)
        .map(|i| {
            let [x, y] = at(f64::from(i % nx - nx / 2), f64::from(i / nx - ny / 2));
            DVec3::new(x, y, 0.0)
        })
        .collect()
}

#[test]
fn flat_samplings_have_no_holes() {
    let mut random = noise(1);
    let (square, overlap) = holes(grid(40, 40, |x, y| [x, y]), 15.0);
    println!("square lattice: {overlap} disks a point");
    assert!(square == 0.0 && overlap < 4.0, "{square} {overlap}");
    let hex = grid(40, 40, |x, y| [x + 0.5 * (y.rem_euclid(2.0)), y * 0.75f64.sqrt()]);
    assert_eq!(holes(hex, 12.0).0, 0.0);
    let jittered = grid(40, 40, |x, y| [x + 0.6 * random(), y + 0.6 * random()]);
    let (open, overlap) = holes(jittered, 15.0);
    println!("jittered: {open}, {overlap} disks a point");
    assert!(open == 0.0, "{open}");
    // White noise has gaps of several spacings.
    let white = (0..10_000).map(|_| DVec3::new(90.0 * random(), 90.0 * random(), 0.0));
    let (open, overlap) = holes(white.map(|p| p - DVec3::new(45.0, 45.0, 0.0)).collect(), 41.0);
    println!("white noise: {open}, {overlap} disks a point");
    assert!(open < 0.0005, "{open}");
}

/// Random samples of a ball lie about gaps of up to three mean distances. Disks cover every place that is looked at.
#[test]
fn random_samples_of_a_ball_leave_nothing_open() {
    for seed in [21, 22] {
        let mut random = noise(seed);
        let mut place = || {
            let height = 2.0 * random() - 1.0;
            let (sin, cos) = (std::f64::consts::TAU * random()).sin_cos();
            let width = (1.0 - height * height).sqrt();
            DVec3::new(width * cos, width * sin, height)
        };
        let cloud = cloud((0..40_000).map(|_| place()).collect());
        let tree = super::super::neighbors::PointTree::new(
            cloud.positions.iter().map(|p| p.as_vec3().into()),
        );
        let mut near = Vec::new();
        let mut open = 0;
        for _ in 0..40_000 {
            let at = place();
            tree.nearest(at.as_vec3().into(), 24, &mut near);
            open += usize::from(!near.iter().any(|&(_, i)| covers(&cloud, i as usize, at)));
        }
        assert_eq!(open, 0, "seed {seed}");
    }
}

/// A border of random samples grows by about half the mean distance of samples.
#[test]
fn random_borders_do_not_grow() {
    let mut random = noise(23);
    let square = (0..10_000).map(|_| DVec3::new(100.0 * random(), 100.0 * random(), 0.0));
    let cloud = cloud(square.collect());
    let share = |beyond: f64| {
        let places = (0..900).map(|i| DVec3::new(100.0 + beyond, 5.0 + 0.1 * f64::from(i), 0.0));
        let rim: Vec<usize> = (0..10_000).filter(|&i| cloud.positions[i].x > 85.0).collect();
        places.filter(|at| rim.iter().any(|&i| covers(&cloud, i, *at))).count() as f64 / 900.0
    };
    let found = [0.5, 1.0, 2.0].map(share);
    println!("covered half a distance, one, and two beyond the border: {found:?}");
    assert!(found[0] < 0.85 && found[1] < 0.4 && found[2] < 0.1, "{found:?}");
}

#[test]
fn scan_lines_are_covered_by_long_kernels() {
    for (name, stagger, jitter) in
        [("grid", 0.0, 0.0), ("staggered", 0.5, 0.0), ("jittered", 0.3, 0.3)]
    {
        let mut random = noise(2);
        let lines = grid(100, 20, |x, y| {
            [x + stagger * y + jitter * (random() - 0.5), 5.0 * y + jitter * random()]
        });
        let (open, overlap) = holes(lines.clone(), 30.0);
        println!("1:5 {name}: {open}, {overlap} disks a point");
        assert_eq!(open, 0.0, "{name}");
        let cloud = cloud(lines);
        let kernel = cloud.kernels.as_ref().unwrap()[1050];
        let ratio = kernel.v.length() / kernel.u.length();
        assert!((2.5..=MAX_RATIO * 1.01).contains(&ratio), "{name} {ratio}");
        assert!(kernel.v.y.abs() > 0.95 * kernel.v.length(), "{name} {kernel:?}");
        assert!(overlap < 6.0, "{name} {overlap}");
    }
}

#[test]
fn borders_do_not_grow() {
    let cloud = cloud(grid(20, 20, |x, y| [x, y]));
    let kernels = cloud.kernels.unwrap();
    let middle = kernels[210].u.length();
    for kernel in &kernels {
        let longest = kernel.u.length().max(kernel.v.length());
        assert!(longest < 2.0 * middle, "{longest} {middle}");
    }
}

#[test]
fn strays_and_duplicates_stay_near_the_median() {
    let mut positions = grid(30, 30, |x, y| [x, y]);
    positions.extend([DVec3::new(0.0, 0.0, 900.0), DVec3::new(5e5, 0.0, 0.0)]);
    positions.extend([DVec3::new(3.5, 3.5, 0.0); 40]);
    let kernels = cloud(positions).kernels.unwrap();
    let middle = kernels[465].u.length();
    for kernel in &kernels {
        for axis in [kernel.u, kernel.v] {
            assert!((0.04 * middle..11.0 * middle).contains(&axis.length()), "{kernel:?}");
        }
    }
    // Strays in the air are no larger than the others.
    for stray in &kernels[900..902] {
        assert!(stray.u.length() < 1.5 * middle && stray.v.length() < 1.5 * middle, "{stray:?}");
    }
    // Each point twice is the same surface.
    let twice: Vec<DVec3> = grid(40, 40, |x, y| [x, y]).into_iter().flat_map(|p| [p, p]).collect();
    assert_eq!(holes(twice, 15.0).0, 0.0);
}

/// Ground with two walls on it, sampled a tenth apart.
fn street() -> Vec<DVec3> {
    let ground = grid(40, 40, |x, y| [0.1 * x, 0.1 * y]);
    let wall = |x: f64| {
        (0..1600).map(move |i| DVec3::new(x, f64::from(i % 40 - 20) * 0.1, f64::from(i / 40) * 0.1))
    };
    ground.into_iter().chain(wall(-2.0)).chain(wall(2.0)).collect()
}

/// Longest axes of the kernels of samples that are added to the street, in medians of its own.
fn in_the_street(more: Vec<DVec3>) -> Vec<f32> {
    let street = street();
    let solid = street.len();
    let kernels = cloud(street.into_iter().chain(more).collect()).kernels.unwrap();
    let median = longest_axis(&kernels[820]);
    kernels[solid..].iter().map(|kernel| longest_axis(kernel) / median).collect()
}

/// An echo between two walls and above the ground has neighbours on several sides.
#[test]
fn echoes_in_the_air_are_no_larger_than_samples_of_surfaces() {
    let mut random = noise(4);
    let echoes = (0..12)
        .map(|_| DVec3::new(3.0 * random() - 1.5, 3.0 * random() - 1.5, 0.5 + 3.0 * random()));
    for axis in in_the_street(echoes.collect()) {
        assert!(axis < 4.0, "{axis}");
    }
}

/// Pairs and triples of echoes near each other, with the corner of a wall below them, look like a sparse surface.
#[test]
fn pairs_and_triples_of_echoes_are_no_larger_than_samples_of_surfaces() {
    let mut random = noise(3);
    let mut within = |size: f64| size * DVec3::new(random(), random(), random());
    for (groups, each) in [(4, 1), (2, 2), (3, 2), (2, 3)] {
        for round in 0..6 {
            let corner = DVec3::new(3.0, 3.0, 10.0) + within(4.0);
            let mut echoes = Vec::new();
            for _ in 0..groups {
                let at = corner + within(5.0);
                echoes.extend((0..each).map(|_| at + within(0.3)));
            }
            for axis in in_the_street(echoes) {
                assert!(axis < 1.01, "{axis}: {groups} groups of {each}, round {round}");
            }
        }
    }
}

/// Any three places lie on a plane.
#[test]
fn small_groups_far_from_each_other_are_no_surface() {
    let mut random = noise(5);
    let mut echoes = Vec::new();
    for at in [[0.0, 0.0, 40.0], [5.0, 1.0, 41.0], [1.0, 5.0, 42.0]] {
        let mut within = || 0.15 * DVec3::new(random(), random(), random());
        echoes.extend((0..5).map(|_| DVec3::from(at) + within()));
    }
    for axis in in_the_street(echoes) {
        assert!(axis < 4.01, "{axis}");
    }
    // Where many samples are in such groups, these are how a surface was sampled: here beside one that is sampled densely.
    let quads = grid(30, 30, |x, y| [x, y]).into_iter().flat_map(|at| {
        let near = |x: f64, y: f64| at + DVec3::new(x, y, 0.0);
        [near(0.02, 0.0), near(-0.02, 0.0), near(0.0, 0.02), near(0.0, -0.02)]
    });
    let dense = grid(80, 80, |x, y| [100.0 + 0.15 * x, 0.15 * y]);
    assert_eq!(holes(quads.chain(dense).collect(), 12.0).0, 0.0);
}

#[test]
fn volumes_and_wires_get_small_round_kernels() {
    let mut random = noise(6);
    // A lawn around a tree: without something flat, the median would be that of the tree.
    let mut positions = grid(60, 60, |x, y| [x, y]);
    let lawn = positions.len();
    positions.extend((0..600).map(|_| DVec3::new(random(), random(), random() + 1.5) * 12.0));
    let tree = positions.len();
    // Slack, with noise across.
    positions.extend((0..200).map(|i| {
        let x = f64::from(i) * 0.5 - 50.0;
        DVec3::new(x, 90.0 + 0.02 * random(), 0.01 * x * x + 0.02 * random())
    }));
    let cloud = cloud(positions);
    let kernels = cloud.kernels.as_ref().unwrap();
    let disk = |kernel: &Kernel| f64::from(CUTOFF * longest_axis(kernel));
    let middle = |part: &[Kernel]| {
        let mut disks: Vec<f64> = part.iter().map(disk).collect();
        disks.sort_by(f64::total_cmp);
        (disks[part.len() / 2], disks[part.len() - 1])
    };
    // Samples of the tree lie some 0.8 apart, those of the wire half a unit.
    let (median, most) = middle(&kernels[lawn..tree]);
    assert!(median < 1.1 && most < 3.0, "{median} {most}");
    let (median, most) = middle(&kernels[tree..]);
    assert!((0.25..0.75).contains(&median) && most < 1.5, "{median} {most}");
    for kernel in &kernels[tree..] {
        let (u, v) = (kernel.u.length(), kernel.v.length());
        assert!(u.max(v) < 1.01 * u.min(v), "{kernel:?}");
    }
}

/// A crown: clumps of leaves in a ball, dense within and sparse around.
#[test]
fn leaves_that_lie_flat_by_chance_get_no_large_kernels() {
    let mut random = noise(9);
    let mut ball = move |radius: f64| loop {
        let p = DVec3::from_array(std::array::from_fn(|_| 2.0 * random() - 1.0));
        if p.length_squared() < 1.0 {
            break p * radius;
        }
    };
    let mut positions = Vec::new();
    for clump in 0..300 {
        let centre = ball(10.0);
        positions
            .extend((0..14).map(|leaf| centre + ball(0.1 * f64::from(1 << ((clump + leaf) % 5)))));
    }
    let cloud = cloud(positions);
    let mut lengths: Vec<f32> = cloud.kernels.unwrap().iter().map(longest_axis).collect();
    lengths.sort_by(f32::total_cmp);
    let (median, longest) = (lengths[lengths.len() / 2], lengths[lengths.len() - 1]);
    assert!(longest < 2.5 * median, "{longest} {median}");
}

/// Edges are thick as neighbourhoods go, and stay closed; so does a noisy surface.
#[test]
fn edges_and_noise_leave_no_holes() {
    let mut positions = grid(40, 40, |x, y| [x, y]);
    positions.retain(|p| p.x >= 0.0);
    let flat = positions.len();
    positions.extend(
        (1..20).flat_map(|z| (-20..20).map(move |y| DVec3::new(0.0, f64::from(y), -f64::from(z)))),
    );
    let edge = cloud(positions);
    let mut random = noise(8);
    for _ in 0..2000 {
        let y = 30.0 * random() - 15.0;
        let along = 6.0 * random();
        for point in [DVec3::new(along, y, 0.0), DVec3::new(0.0, y, -along)] {
            // Disks at an edge are tilted: what they cover is seen from the side that they face.
            let covered = (0..edge.positions.len()).any(|i| {
                let d = (point - edge.positions[i]).as_vec3();
                let normal = edge.normals.as_ref().unwrap()[i];
                d.dot(normal).abs() < 0.75 && covers(&edge, i, point)
            });
            assert!(covered, "{point} of {flat}");
        }
    }
    let noisy = grid(40, 40, |x, y| [x, y]).into_iter().map(|p| p + DVec3::Z * 0.5 * random());
    let (open, _) = holes(noisy.collect(), 15.0);
    assert!(open < 0.002, "{open}");
}

#[test]
fn radii_of_the_file_are_the_disks() {
    let positions = grid(20, 20, |x, y| [x, y]);
    let mut cloud = PointCloud { positions, radii: Some(vec![3.0; 400]), ..Default::default() };
    cloud.radii.as_mut().unwrap()[7] = 0.0;
    estimate_kernels(&mut cloud);
    check(&cloud);
    for (index, kernel) in cloud.kernels.as_ref().unwrap().iter().enumerate() {
        for axis in [kernel.u, kernel.v] {
            assert!((axis.length() - 1.5).abs() < 1e-5 || index == 7, "{kernel:?}");
        }
    }
    assert!(cloud.kernels.as_ref().unwrap()[7].u.length() < 1.0);
    // Existing kernels stay; broken ones are replaced.
    let own = Kernel { u: Vec3::X * 9.0, v: Vec3::Y };
    let kernels = cloud.kernels.as_mut().unwrap();
    (kernels[0], kernels[1]) = (own, Kernel { u: Vec3::NAN, v: Vec3::X });
    estimate_kernels(&mut cloud);
    let kernels = cloud.kernels.unwrap();
    assert_eq!(kernels[0], own);
    assert!(is_kernel(&kernels[1]));
}

#[test]
fn lines_and_nothing_at_all_are_answered() {
    let line = |count: usize| (0..count).map(|i| DVec3::new(i as f64, 0.0, 0.0)).collect();
    for positions in [vec![], vec![DVec3::ONE], vec![DVec3::ONE; 100], line(2), line(50)] {
        cloud(positions);
    }
    // Units in which f32 has no squares, or no numbers at all.
    for unit in [1e-310, 1e-300, 1e-42, 1e-30, 1e-20, 1e18, 1e25, 1e37, 1e300] {
        cloud(grid(6, 6, |x, y| [x * unit, y * unit]));
        cloud(grid(6, 6, |x, y| [x * unit, y]));
    }
    let kernels = cloud(line(50)).kernels.unwrap();
    let [u, v] = [kernels[25].u.length(), kernels[25].v.length()];
    assert!((u - v).abs() < 1e-6 && (0.25..2.0).contains(&u), "{u} {v}");
}

/// Prints what kernels add to normals and radii.
#[test]
#[ignore = "a measurement"]
fn speed_of_kernels() {
    let mut random = noise(5);
    let positions: Vec<DVec3> = (0..300_000)
        .map(|_| {
            let (x, y) = (100.0 * random(), 100.0 * random());
            DVec3::new(x, y, (0.3 * x).sin() * (0.2 * y).cos())
        })
        .collect();
    let time = |job: fn(&mut PointCloud)| {
        let mut cloud = PointCloud { positions: positions.clone(), ..PointCloud::default() };
        let start = std::time::Instant::now();
        job(&mut cloud);
        start.elapsed().as_secs_f64()
    };
    let (mut before, mut now) = (Vec::new(), Vec::new());
    for _ in 0..7 {
        before.push(time(crate::bake::estimate_point_attributes));
        now.push(time(estimate_kernels));
    }
    let least = |times: &[f64]| times.iter().copied().fold(f64::INFINITY, f64::min);
    let (before, now) = (least(&before), least(&now));
    println!("normals and radii {before:.3} s, with kernels {now:.3} s: {:.2} times", now / before);
}

proptest! {
    #[test]
    fn any_cloud_is_answered(
        positions in proptest::collection::vec(prop::array::uniform3(any::<f64>()), 0..60),
        cells in proptest::collection::vec((0u8..6, 0u8..6, 0u8..3), 0..100),
    ) {
        cloud(positions.into_iter().map(DVec3::from).collect());
        let cells = cells.into_iter();
        cloud(cells.map(|(x, y, z)| DVec3::new(x.into(), y.into(), z.into())).collect());
    }
}
