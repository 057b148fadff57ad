use super::*;
use crate::assets::{Mesh, PointCloud};
use crate::bake::pack::{pack_mesh, pack_samples};
use crate::scene::random::SplitMix64;

fn cloud(positions: Vec<DVec3>) -> PackedGeometry {
    let cloud = PointCloud { positions, ..PointCloud::default() };
    PackedGeometry::Samples(pack_samples(&cloud).unwrap())
}

fn mesh(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> PackedGeometry {
    PackedGeometry::Triangles(
        pack_mesh(&Mesh { positions, triangles, ..Mesh::default() }, &[]).unwrap(),
    )
}

fn outline(geometry: &PackedGeometry) -> Outline {
    Outline::of_all(std::slice::from_ref(geometry)).remove(0)
}

/// Points in a ball, its middle at `middle`.
fn ball(count: usize, radius: f64, middle: DVec3) -> Vec<DVec3> {
    let mut numbers = SplitMix64::new(5);
    let place = || DVec3::from_array(std::array::from_fn(|_| 2.0 * numbers.unit() - 1.0));
    std::iter::repeat_with(place)
        .filter(|p| p.length() < 1.0)
        .take(count)
        .map(|p| middle + p * radius)
        .collect()
}

#[test]
fn outline_reaches_as_far_as_its_points() {
    for stretch in [DVec3::ONE, DVec3::new(1000.0, 400.0, 3.0), DVec3::new(1.0, 1.0, 0.0)] {
        let points: Vec<DVec3> =
            ball(40_000, 1.0, DVec3::ZERO).into_iter().map(|p| p * stretch).collect();
        let found = outline(&cloud(points.clone()));
        assert!(found.points.len() <= 512 && found.strays == 0);
        for direction in directions(100) {
            let direction = direction / stretch.max(DVec3::splat(1e-3));
            let reach = |points: &[DVec3]| {
                points.iter().map(|p| p.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
            };
            let (all, some) = (reach(&points), reach(&found.points));
            assert!(some > 0.985 * all - 1e-9, "{stretch} {direction}: {some} of {all}");
        }
    }
}

#[test]
fn a_few_points_far_away_are_strays() {
    for (count, strays) in [(100, 1), (3000, 3), (200_000, 20)] {
        let mut points = ball(count, 1.0, DVec3::new(1e5, 5e6, 100.0));
        points.extend((0..strays).map(|i| DVec3::new(1e5, 5e6 + 5e3 * f64::from(i + 1), -2e4)));
        let found = outline(&cloud(points));
        assert_eq!(found.strays, strays as u64, "{count}");
        assert!(found.bounds().extent().max_element() < 2.1, "{count}: {:?}", found.bounds());
        assert!(found.farthest_stray > 2e4);
    }
}

#[test]
fn a_part_of_its_own_is_no_stray() {
    // A hundredth of the points, far away.
    let mut points = ball(20_000, 1.0, DVec3::ZERO);
    points.extend(ball(200, 1.0, DVec3::X * 1e3));
    // Two points, or ten, of which none is more of an exception than another.
    let pair = vec![DVec3::ZERO, DVec3::X * 1e6];
    let decades = (0..10).map(|i| DVec3::X * 10f64.powi(i)).collect();
    // A spire: few points, but near.
    let mut spire = ball(20_000, 1.0, DVec3::ZERO);
    spire.extend((0..8).map(|i| DVec3::Y * (1.0 + 0.2 * f64::from(i))));
    for points in [points, pair, decades, spire] {
        let whole = Bounds::of(points.iter().copied());
        let found = outline(&cloud(points));
        assert_eq!(found.strays, 0);
        assert!((found.bounds().max - whole.max).length() < 0.02 * whole.extent().length());
    }
}

#[test]
fn triangles_count_by_their_area() {
    // A house of many small triangles on a ground of two.
    let mut positions = ball(6000, 1.0, DVec3::ZERO);
    let mut triangles: Vec<[u32; 3]> = (0..2000).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let ground = [[-90.0, -90.0], [90.0, -90.0], [90.0, 90.0], [-90.0, 90.0]];
    positions.extend(ground.map(|[x, z]| DVec3::new(x, -1.0, z)));
    triangles.extend([[6000, 6001, 6002], [6000, 6002, 6003]]);
    let found = outline(&mesh(positions.clone(), triangles.clone()));
    assert_eq!(found.strays, 0);
    assert!(found.bounds().extent().max_element() > 179.0, "the ground is shown");
    // A speck far beyond the ground.
    positions.extend([DVec3::splat(1e5), DVec3::splat(1e5 + 0.1), DVec3::new(1e5, 1e5, 1e5 + 0.1)]);
    triangles.push([6004, 6005, 6006]);
    let found = outline(&mesh(positions, triangles));
    assert_eq!(found.strays, 1);
    assert!(found.bounds().extent().max_element() < 181.0);
}

#[test]
fn odd_geometries_have_an_outline() {
    let reach = |positions: Vec<DVec3>| outline(&cloud(positions)).bounds().extent().max_element();
    assert_eq!(outline(&cloud(Vec::new())).points.len(), 0);
    assert_eq!(reach(vec![DVec3::ONE]), 0.0);
    assert_eq!(reach(vec![DVec3::ONE; 5000]), 0.0);
    let line = (0..5000).map(|i| DVec3::Y * f64::from(i)).collect();
    assert!((reach(line) - 4999.0).abs() < 1e-3);
}

#[test]
fn a_lone_disc_is_framed_with_its_radius() {
    let positions = vec![DVec3::ZERO];
    let disc = crate::assets::Kernel { u: glam::Vec3::X, v: glam::Vec3::Y };
    let lone = PointCloud {
        positions,
        kernels: Some(vec![disc]),
        normals: Some(vec![glam::Vec3::Z]),
        ..PointCloud::default()
    };
    let packed = PackedGeometry::Samples(pack_samples(&lone).unwrap());
    assert!((outline(&packed).bounds().extent().x - 4.0).abs() < 0.1);
}
