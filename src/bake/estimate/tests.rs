use super::*;
use crate::assets::Geometry;
use crate::bake::prepare::{AssetTraits, prepare_geometry};
use crate::memory::Admission;
use crate::scene::random::SplitMix64;

/// Random points with coordinates from 0 to 1.
fn random(count: usize, seed: u64) -> Vec<DVec3> {
    let mut numbers = SplitMix64::new(seed);
    let mut next = || (numbers.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    (0..count).map(|_| DVec3::new(next(), next(), next())).collect()
}

fn all_at_once(cloud: &PointCloud) -> PackedSamples {
    let mut geometry = Geometry::Points(cloud.clone());
    prepare_geometry(&mut geometry, &mut AssetTraits::default(), &Admission::default()).unwrap();
    let Geometry::Points(cloud) = geometry else { unreachable!("a cloud stays one") };
    pack_samples(&cloud).unwrap()
}

fn check(name: &str, cloud: PointCloud) {
    let count = cloud.positions.len();
    let colors = (0..count).map(|i| [i as u8, (i >> 8) as u8, 7, 255]).collect();
    let oriented = cloud.normals.is_some();
    let cloud = PointCloud { colors: Some(colors), oriented, ..cloud };
    let expected = format!("{:?}", all_at_once(&cloud));
    for piece in [1, 5, 1000] {
        let found = pack_in_pieces(cloud.clone(), piece, None, &|_| ()).unwrap();
        assert!(format!("{found:?}") == expected, "{name}, pieces of {piece} chunks");
    }
}

fn of(positions: Vec<DVec3>) -> PointCloud {
    PointCloud { positions, ..PointCloud::default() }
}

#[test]
fn pieces_are_packed_as_all_at_once() {
    let flat = |p: DVec3| DVec3::new(p.x * 100.0, p.y * 100.0, (p.x * 9.0).sin());
    let surface: Vec<DVec3> = random(7_000, 1).into_iter().map(flat).collect();
    check("surface", of(surface.clone()));
    check("volume", of(random(6_000, 2)));
    // Rounding the coordinates makes many distances equal and puts many points at one position.
    let coarse = |p: &DVec3| (p * 5.0).round() / 5.0;
    check("lattice", of(surface.iter().map(coarse).collect()));
    // A dense cluster, distant strays, and two thousand points at one position.
    let cluster = random(3_000, 3).into_iter().map(|p| p * 0.01);
    let strays = random(30, 4).into_iter().map(|p| (p - 0.5) * 1e5);
    let same = (0..2000).map(|_| DVec3::splat(0.5));
    check(
        "mixture",
        of(random(3_000, 5).into_iter().chain(cluster).chain(strays).chain(same).collect()),
    );
    check("far away", of(surface.iter().map(|p| p + DVec3::new(6e6, -4e6, 300.0)).collect()));
    check("few", of(random(9, 6)));
    check("one place", of(vec![DVec3::ONE; 2500]));
    check("nothing", of(Vec::new()));
}

#[test]
fn what_a_file_gives_stays() {
    let positions = random(6_000, 7);
    let count = positions.len();
    let normals = |some: usize| -> Vec<Vec3> {
        (0..count).map(|i| if i % some == 0 { Vec3::ZERO } else { Vec3::Y }).collect()
    };
    let radii = |some: usize| -> Vec<f32> {
        (0..count).map(|i| if i % some == 0 { 0.0 } else { 0.01 + i as f32 * 1e-6 }).collect()
    };
    let with = |normals, radii| PointCloud { normals, radii, ..of(positions.clone()) };
    check("some normals", with(Some(normals(3)), None));
    check("all normals", with(Some(normals(count + 1)[1..].to_vec()), None));
    check("some radii", with(None, Some(radii(5))));
    let all_radii: Vec<f32> = radii(count).into_iter().map(|r| r.max(0.02)).collect();
    check("all radii", with(None, Some(all_radii.clone())));
    let whole = with(Some(vec![Vec3::X; count]), Some(all_radii));
    assert!(!lacks_estimates(&whole));
    assert!(lacks_estimates(&with(Some(vec![Vec3::X; count]), None)));
    assert!(!lacks_normals(&with(Some(vec![Vec3::X; count]), None)));
    assert!(lacks_normals(&with(Some(normals(count - 1)), None)));
}

#[test]
fn estimating_tells_its_progress_and_stops() {
    let cloud = of(random(12_000, 8));
    let told = parking_lot::Mutex::new(Vec::new());
    let stop = AtomicBool::new(false);
    let tell = |done: f64| {
        told.lock().push(done);
        stop.store(done > 0.4, Ordering::Relaxed);
    };
    let found = pack_in_pieces(cloud, 2, Some(&stop), &tell);
    assert_eq!(found.unwrap_err(), EstimateError::Stopped);
    let told = told.into_inner();
    assert!(told.is_sorted() && told.len() == 3, "{told:?}");
}
