use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use proptest::prelude::*;

use super::*;

/// Reproducible numbers in [0, 1).
fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Points on a sphere, with a dense cluster: density varies a hundred thousand times.
fn sphere(count: usize) -> Vec<[f32; 3]> {
    let mut random = noise(7);
    (0..count)
        .map(|i| {
            let z = 2.0 * random() - 1.0;
            let (sin, cos) = (random() * std::f32::consts::TAU).sin_cos();
            let r = (1.0 - z * z).max(0.0).sqrt();
            let scale = if i % 8 == 0 { 0.003 } else { 1.0 };
            [r * cos * scale, r * sin * scale, z * scale]
        })
        .collect()
}

/// The indices of each point's neighbours, by point.
fn neighbors(points: &[[f32; 3]], k: usize) -> Vec<Vec<u32>> {
    let tree = PointTree::new(points.iter().copied());
    let found = tree.map_neighbors(k, |neighbors| neighbors.indices().collect::<Vec<u32>>());
    let mut sorted = vec![Vec::new(); points.len()];
    for (&index, found) in tree.order().iter().zip(found) {
        sorted[index as usize] = found;
    }
    sorted
}

fn distance_squared(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

/// Checks the search against all pairs; at equal distance the smaller index comes first.
fn check_against_all_pairs(points: &[[f32; 3]], k: usize) {
    for (index, found) in neighbors(points, k).into_iter().enumerate() {
        let distance = |&other: &u32| distance_squared(points[index], points[other as usize]);
        let mut expected: Vec<u32> =
            (0..points.len() as u32).filter(|&other| other as usize != index).collect();
        expected.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        expected.truncate(k);
        assert_eq!(found, expected, "point {index} of {}", points.len());
        assert!(!found.contains(&(index as u32)));
        let mut distinct = found.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), found.len());
    }
}

#[test]
fn small_clouds_match_all_pairs() {
    for count in [0, 1, 2, 3, 12, 13, 31, 32, 33, 64, 65, 100, 777] {
        check_against_all_pairs(&sphere(count), 12);
    }
    check_against_all_pairs(&vec![[1.0, 2.0, 3.0]; 500], 12);
    let line: Vec<[f32; 3]> = (0..300).map(|i| [i as f32, 0.0, 0.0]).collect();
    check_against_all_pairs(&line, 6);
    let grid: Vec<[f32; 3]> =
        (0..1000).map(|i| [(i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32]).collect();
    check_against_all_pairs(&grid, 15);
}

/// Places that many points share, some of them with others about.
#[test]
fn crowded_places_match_all_pairs() {
    let mut random = noise(11);
    let mut points: Vec<[f32; 3]> = (0..300).map(|_| [random(), random(), random()]).collect();
    for place in 0..6 {
        let at = points[place * 7];
        points.extend(vec![at; 10 + 9 * place]);
    }
    points.extend(vec![[0.0, -0.0, 0.0]; 40]);
    points.extend(vec![[-0.0, 0.0, 0.0]; 40]);
    for k in [1, 12, 15] {
        check_against_all_pairs(&points, k);
    }
}

/// The nearest places are those of all points, however many points are at one place.
#[test]
fn places_around_match_all_pairs() {
    let mut random = noise(14);
    let mut points: Vec<[f32; 3]> = (0..200).map(|_| [random(), random(), 0.0]).collect();
    points.extend((0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 0.0]));
    for place in 0..8 {
        points.extend(vec![points[place * 31]; 5 + 9 * place]);
    }
    let tree = PointTree::new(points.iter().copied());
    let found = tree.map_neighbors(12, |neighbors| {
        let mut offsets = Vec::new();
        let last = neighbors.around(&mut offsets);
        (neighbors.position(), offsets, last)
    });
    for (own, offsets, last) in found {
        let mut expected: Vec<(f32, u32, [f32; 3])> = (0..)
            .zip(&points)
            .filter(|(_, at)| **at != own)
            .map(|(index, at)| (distance_squared(*at, own), index, *at))
            .collect();
        expected.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut places: Vec<(f32, [f32; 3])> = Vec::new();
        for (distance, _, at) in expected {
            if places.len() < AROUND && !places.iter().any(|(_, other)| *other == at) {
                places.push((distance, at));
            }
        }
        assert_eq!(last, places[AROUND - 1].0);
        let expected = places.iter().map(|(_, at)| [0, 1, 2].map(|axis| at[axis] - own[axis]));
        assert!(offsets.iter().copied().eq(expected), "{own:?}");
    }
}

/// Work of a search for all neighbours, relative to that for as many random points.
fn effort(points: Vec<[f32; 3]>) -> f64 {
    let visited = |points: &[[f32; 3]]| {
        let tree = PointTree::new(points.iter().copied());
        let found = tree.map_neighbors(12, |neighbors| neighbors.len() as u32);
        assert!(points.len() < 13 || found.iter().all(|&len| len == 12));
        let mut order = tree.order().to_vec();
        order.sort_unstable();
        assert!(order.into_iter().eq(0..points.len() as u32), "each point is answered once");
        tree.visited() as f64
    };
    let mut random = noise(12);
    let plain: Vec<[f32; 3]> = points.iter().map(|_| [random(), random(), random()]).collect();
    visited(&points) / visited(&plain)
}

#[test]
fn no_cloud_costs_more_than_four_times_a_random_one() {
    const COUNT: usize = 5_000;
    let mut random = noise(13);
    let mut clouds: Vec<(&str, Vec<[f32; 3]>)> = vec![
        ("one place", vec![[1.0, 2.0, 3.0]; COUNT]),
        ("a line", (0..COUNT).map(|i| [i as f32 / COUNT as f32, 0.0, 0.0]).collect()),
        ("a line of crowds", (0..COUNT).map(|i| [(i / 200) as f32, 0.0, 0.0]).collect()),
    ];
    let places: Vec<[f32; 3]> = (0..100).map(|_| [random(), random(), random()]).collect();
    clouds.push(("a hundred places", (0..COUNT).map(|i| places[i % 100]).collect()));
    for copies in [2, 12, 15, 16, 17, 31, 40] {
        let plane = (0..COUNT).map(|i| [(i / copies % 30) as f32, (i / copies / 30) as f32, 0.0]);
        clouds.push(("a plane of copies", plane.collect()));
    }
    // `share` of every ten points lie in a cluster and the others anywhere.
    let mut cloud = |share: usize, at: f32, size: f32| {
        let mut point = |i: usize| {
            let [x, y, z] = [random(), random(), random()];
            let within = |v: f32| at + size * v;
            if i % 10 < share { [x, y, z].map(within) } else { [x - 0.5, y - 0.5, z - 0.5] }
        };
        (0..COUNT).map(&mut point).collect::<Vec<_>>()
    };
    clouds.push(("no depth", cloud(2, 0.0, 0.0)));
    clouds.push(("mostly no depth", cloud(9, 0.1, 0.0)));
    // Squares of such distances are zero in f32.
    for size in [1e-9, 1e-24, 1e-30, 1e-40] {
        clouds.push(("a cluster", cloud(9, 0.0, size)));
        clouds.push(("half a cluster", cloud(5, 0.0, size)));
    }
    let mut far = cloud(10, 0.0, 1e-9);
    far[77] = [1.0; 3];
    clouds.push(("a cluster and one far away", far));
    for (name, points) in clouds {
        let effort = effort(points);
        println!("{name}: {effort:.2}");
        assert!(effort < 4.0, "{name}: {effort} times");
    }
}

#[test]
fn large_clouds_match_kiddo() {
    let points = sphere(20_000);
    let reference = ImmutableKdTree::<f32, 3>::new_from_slice(&points).unwrap();
    let k = NonZeroUsize::new(13).unwrap();
    for (index, found) in neighbors(&points, 12).into_iter().enumerate() {
        let point = points[index];
        let mut expected: Vec<(f32, u32)> = reference
            .query(&point)
            .nearest_n::<SquaredEuclidean<f32>>(k)
            .execute()
            .into_iter()
            .map(|neighbor| (neighbor.distance, neighbor.item))
            .filter(|&(_, other)| other as usize != index)
            .collect();
        expected.truncate(12);
        let (mut found, last) = (found, expected[11].0);
        let mut expected: Vec<u32> = expected.into_iter().map(|(_, other)| other).collect();
        found.sort_unstable();
        expected.sort_unstable();
        if found != expected {
            // Only neighbours at the same, last distance may differ.
            let differ = found.iter().filter(|other| !expected.contains(other));
            for &other in differ {
                assert_eq!(distance_squared(point, points[other as usize]), last, "point {index}");
            }
        }
    }
}

/// Prints what the tree and kiddo take; run it optimised:
/// `cargo test --release --lib speed_against_kiddo -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, for optimised builds"]
fn speed_against_kiddo() {
    let points = sphere(1_000_000);
    let threads = rayon::current_num_threads();
    let start = std::time::Instant::now();
    let tree = PointTree::new(points.iter().copied());
    let built = start.elapsed();
    let sum: f32 = tree
        .map_neighbors(12, |neighbors| neighbors.distances_squared().last().unwrap_or(0.0))
        .into_iter()
        .sum();
    println!("own: build {built:?}, with queries {:?}, {threads} threads, {sum}", start.elapsed());
    let start = std::time::Instant::now();
    let reference = ImmutableKdTree::<f32, 3>::new_from_slice_parallel(&points).unwrap();
    let built = start.elapsed();
    let k = NonZeroUsize::new(13).unwrap();
    let sum: f32 = points
        .par_iter()
        .map(|point| {
            let found = reference.query(point).nearest_n::<SquaredEuclidean<f32>>(k).execute();
            found.into_iter().map(|neighbor| neighbor.distance).fold(0.0, f32::max)
        })
        .sum();
    println!("kiddo: build {built:?}, with queries {:?}, {sum}", start.elapsed());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_cloud_matches_all_pairs(
        // Few distinct coordinates: many ties.
        cells in proptest::collection::vec((0u8..6, 0u8..6, 0u8..3), 0..200),
        k in 1usize..=15,
    ) {
        let points: Vec<[f32; 3]> =
            cells.into_iter().map(|(x, y, z)| [f32::from(x), f32::from(y), f32::from(z)]).collect();
        check_against_all_pairs(&points, k);
    }
}
