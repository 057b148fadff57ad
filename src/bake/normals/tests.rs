use proptest::prelude::*;

use super::*;
use crate::assets::PointCloud;
use crate::bake::attributes::estimate_point_attributes;

fn cloud(positions: Vec<DVec3>) -> PointCloud {
    let mut cloud = PointCloud { positions, ..PointCloud::default() };
    estimate_point_attributes(&mut cloud);
    cloud
}

/// An even sampling of a sphere (Fibonacci lattice).
fn sphere(count: usize, centre: DVec3, radius: f64) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            centre + radius * DVec3::new(r * cos, r * sin, z)
        })
        .collect()
}

#[test]
fn a_sphere_far_from_the_origin_looks_outward() {
    let (count, centre, radius) = (20_000, DVec3::new(5e5, 6e6, 300.0), 4.0);
    let cloud = cloud(sphere(count, centre, radius));
    // Area of a sample on the sphere; a square of it has this half width.
    let half_spacing = 0.5 * radius * (4.0 * std::f64::consts::PI / count as f64).sqrt();
    for ((position, normal), r) in
        cloud.positions.iter().zip(cloud.normals.unwrap()).zip(cloud.radii.unwrap())
    {
        let outward = (*position - centre) / radius;
        assert!(normal.as_dvec3().dot(outward) > 0.999, "{position} {normal}");
        let ratio = f64::from(r) / half_spacing;
        assert!((0.8..1.6).contains(&ratio), "{position} {ratio}");
    }
}

#[test]
fn terrain_looks_up_along_its_flat_axis() {
    for up in [DVec3::Z, DVec3::Y, DVec3::X] {
        let positions = (0..10_000)
            .map(|i| {
                let (u, v) = ((i % 100) as f64, (i / 100) as f64);
                let height = 2.0 * (u * 0.1).sin() * (v * 0.07).cos();
                let (a, b) = (DVec3::new(up.y, up.z, up.x), DVec3::new(up.z, up.x, up.y));
                a * u + b * v + up * height
            })
            .collect();
        let cloud = cloud(positions);
        assert!(cloud.normals.unwrap().iter().all(|n| n.as_dvec3().dot(up) > 0.9));
        assert!(cloud.radii.unwrap().iter().all(|r| (0.4..0.9).contains(r)));
    }
}

#[test]
fn a_stray_point_does_not_blur_the_others() {
    let mut positions = sphere(5000, DVec3::ZERO, 1.0);
    positions.push(DVec3::splat(1e13));
    let cloud = cloud(positions);
    let (normals, radii) = (cloud.normals.unwrap(), cloud.radii.unwrap());
    for (position, normal) in cloud.positions.iter().zip(&normals).take(5000) {
        assert!(normal.as_dvec3().dot(*position) > 0.99);
    }
    assert!(radii[..5000].iter().all(|r| (0.01..0.05).contains(r)));
    assert!(radii[5000] > 1e12);
}

#[test]
fn degenerate_clouds_have_no_normals_and_positive_radii() {
    let line = |count: usize| (0..count).map(|i| DVec3::new(i as f64, 0.0, 0.0)).collect();
    for positions in [
        vec![],
        vec![DVec3::ONE],
        vec![DVec3::ONE; 2],
        vec![DVec3::ONE; 1000],
        line(2),
        line(500),
        vec![DVec3::NAN, DVec3::INFINITY],
        vec![DVec3::splat(f64::MAX), DVec3::splat(f64::MIN), DVec3::ZERO],
    ] {
        let count = positions.len();
        let cloud = cloud(positions);
        let (normals, radii) = (cloud.normals.unwrap(), cloud.radii.unwrap());
        assert_eq!((normals.len(), radii.len()), (count, count));
        assert!(normals.iter().all(|&n| n == Vec3::ZERO), "{normals:?}");
        assert!(radii.iter().all(is_radius), "{radii:?}");
    }
    let three = cloud(vec![DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert!(three.normals.unwrap().iter().all(|n| n.z.abs() > 0.999));
}

#[test]
fn duplicates_get_a_floor() {
    let mut positions = sphere(1000, DVec3::ZERO, 1.0);
    positions.extend([DVec3::X; 20]);
    let radii = cloud(positions).radii.unwrap();
    let (typical, doubled) = (radii[500], radii[1010]);
    assert!(doubled > 0.0 && doubled < typical && doubled > 0.01 * typical);
}

#[test]
fn what_is_there_is_kept() {
    let positions = sphere(100, DVec3::ZERO, 1.0);
    let mut cloud = PointCloud {
        normals: Some(vec![Vec3::X; 100]),
        radii: Some(vec![7.0; 100]),
        positions,
        ..PointCloud::default()
    };
    estimate_point_attributes(&mut cloud);
    assert_eq!(cloud.normals, Some(vec![Vec3::X; 100]));
    assert_eq!(cloud.radii, Some(vec![7.0; 100]));
    cloud.normals.as_mut().unwrap()[3] = Vec3::ZERO;
    cloud.radii.as_mut().unwrap()[4] = 0.0;
    estimate_point_attributes(&mut cloud);
    let (normals, radii) = (cloud.normals.unwrap(), cloud.radii.unwrap());
    assert_eq!((normals[2], radii[3]), (Vec3::X, 7.0));
    assert!(normals[3].as_dvec3().dot(cloud.positions[3]) > 0.9);
    assert!((0.05..0.5).contains(&radii[4]));
}

/// `cargo test --release --lib speed_of_estimation -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, for optimised builds"]
fn speed_of_estimation() {
    let mut cloud = PointCloud {
        positions: sphere(1_000_000, DVec3::new(5e5, 6e6, 0.0), 50.0),
        ..PointCloud::default()
    };
    let start = std::time::Instant::now();
    estimate_point_attributes(&mut cloud);
    println!("{:?} with {} threads", start.elapsed(), rayon::current_num_threads());
}

proptest! {
    #[test]
    fn eigenvectors_are_least(
        offsets in proptest::collection::vec(prop::array::uniform3(-1f32..1.0), 3..20)
    ) {
        let count = offsets.len();
        let normal = least_direction(offsets.iter().copied(), count);
        let points: Vec<DVec3> = offsets
            .iter()
            .map(|o| DVec3::from(o.map(f64::from)))
            .chain([DVec3::ZERO])
            .collect();
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        let variance = |n: DVec3| points.iter().map(|p| (*p - mean).dot(n).powi(2)).sum::<f64>();
        prop_assert!((normal.length() - 1.0).abs() < 1e-9);
        let least = variance(normal);
        for other in sphere(200, DVec3::ZERO, 1.0) {
            prop_assert!(least <= variance(other) + 1e-9);
        }
    }

    #[test]
    fn any_cloud_is_answered(
        positions in proptest::collection::vec(prop::array::uniform3(any::<f64>()), 0..60)
    ) {
        let cloud = cloud(positions.into_iter().map(DVec3::from).collect());
        prop_assert!(cloud.normals.unwrap().iter().all(|n| n.is_finite()));
        prop_assert!(cloud.radii.unwrap().iter().all(is_radius));
    }
}
