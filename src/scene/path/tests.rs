use proptest::prelude::*;

use super::*;
use crate::math::Lens;

fn key(t: f64, eye: [f64; 3], target: [f64; 3], ease: Ease) -> PathKey {
    let (eye, target) = (DVec3::from_array(eye), DVec3::from_array(target));
    PathKey { t, camera: Camera::perspective(eye, target, 40.0), ease }
}

fn path(interpolation: Interpolation, keys: Vec<PathKey>) -> CameraPath {
    CameraPath { fps: 30.0, interpolation, keys }
}

fn forward(camera: &Camera) -> DVec3 {
    (camera.target - camera.eye) / camera.target.distance(camera.eye)
}

/// Angle between two cameras' orientations, precise for small ones.
fn turn_between(a: &Camera, b: &Camera) -> f64 {
    let [a, b] = [a, b].map(|camera| orientation(camera).unwrap());
    let d = if a.dot(b) < 0.0 { a + b } else { a - b };
    2.0 * d.length()
}

#[test]
fn the_ends_hold() {
    let keys = vec![
        key(-1.0, [0.0, 0.0, 5.0], [0.0; 3], Ease::Smooth),
        key(2.0, [5.0, 0.0, 0.0], [0.0; 3], Ease::Smooth),
    ];
    let path = path(Interpolation::CatmullRom, keys.clone());
    let sampler = path.sampler().unwrap();
    for t in [f64::NEG_INFINITY, -7.0, -1.0, f64::NAN] {
        assert_eq!(sampler.at(t), keys[0].camera);
    }
    for t in [2.0, 2.1, 1e300, f64::INFINITY] {
        assert_eq!(sampler.at(t), keys[1].camera);
    }
    let lone = CameraPath { keys: keys[..1].to_vec(), ..path };
    assert_eq!(lone.sampler().unwrap().at(3.0), keys[0].camera);
    assert_eq!((lone.duration_s(), lone.frame_count(30.0)), (0.0, 1));
}

#[test]
fn paths_that_are_none_are_refused() {
    let good = key(0.0, [0.0, 0.0, 5.0], [0.0; 3], Ease::Smooth);
    let mut nowhere = good;
    nowhere.camera.target = nowhere.camera.eye;
    for (keys, parameter) in [
        (vec![], "keys"),
        (vec![good, good], "t"),
        (vec![PathKey { t: f64::NAN, ..good }], "t"),
        (vec![nowhere], "target"),
    ] {
        let refused = path(Interpolation::Linear, keys).sampler().unwrap_err();
        assert_eq!(refused.parameter, parameter);
    }
}

#[test]
fn frames_and_their_times() {
    let at = |first, last| {
        let [a, b] = [first, last].map(|t| key(t, [0.0, 0.0, t + 5.0], [0.0; 3], Ease::Linear));
        path(Interpolation::Linear, vec![a, b])
    };
    let six = at(10.0, 16.0);
    assert_eq!(six.frame_count(30.0), 181);
    assert_eq!((six.frame_time_s(0, 30.0), six.frame_time_s(180, 30.0)), (10.0, 16.0));
    assert_eq!(six.frame_count(0.1), 1);
    // 0.7 · 30 is a little less than 21.
    assert_eq!(at(0.0, 0.7).frame_count(30.0), 22);
    assert_eq!(at(0.0, 0.69).frame_count(30.0), 21);
}

/// Equal steps in equal times along a line: the speed never changes, whichever way the positions go.
#[test]
fn even_keys_are_flown_at_an_even_speed() {
    for interpolation in [Interpolation::CatmullRom, Interpolation::Linear] {
        let ease = interpolation.default_ease();
        let keys = (0..5).map(|i| {
            let x = 3.0 * f64::from(i);
            key(2.0 * f64::from(i), [x, 1.0, 2.0], [x, 1.0, -8.0], ease)
        });
        let sampler = path(interpolation, keys.collect()).sampler().unwrap();
        for step in 0..=160 {
            let t = f64::from(step) * 0.05;
            let camera = sampler.at(t);
            assert!(
                camera.eye.distance(DVec3::new(1.5 * t, 1.0, 2.0)) < 1e-12,
                "{camera:?} at {t}"
            );
            assert!(camera.target.distance(DVec3::new(1.5 * t, 1.0, -8.0)) < 1e-12);
        }
    }
}

/// A right angle in one second on the spot: half of it after half the time, and about the axis between them.
#[test]
fn orientations_turn_evenly_about_one_axis() {
    let keys = vec![
        key(0.0, [0.0; 3], [0.0, 0.0, -2.0], Ease::Linear),
        key(1.0, [0.0; 3], [4.0, 0.0, 0.0], Ease::Linear),
    ];
    let sampler = path(Interpolation::CatmullRom, keys).sampler().unwrap();
    for step in 0..=20 {
        let t = f64::from(step) / 20.0;
        let (sin, cos) = (t * std::f64::consts::FRAC_PI_2).sin_cos();
        let camera = sampler.at(t);
        assert!(forward(&camera).distance(DVec3::new(sin, 0.0, -cos)) < 1e-12, "{camera:?}");
        assert!((camera.target.distance(camera.eye) - (2.0 + 2.0 * t)).abs() < 1e-12);
        assert!(camera.up.distance(DVec3::Y) < 1e-12);
    }
}

#[test]
fn cameras_while_a_shutter_is_open_are_in_the_middle_of_equal_times() {
    let keys = vec![
        key(0.0, [0.0, 0.0, 5.0], [0.0; 3], Ease::Linear),
        key(1.0, [4.0, 0.0, 5.0], [4.0, 0.0, 0.0], Ease::Linear),
    ];
    let sampler = path(Interpolation::Linear, keys.clone()).sampler().unwrap();
    let places = |t: f64, open_s: f64| {
        let cameras = sampler.while_open(t, open_s, 4);
        cameras.into_iter().map(|camera| camera.eye.x).collect::<Vec<f64>>()
    };
    let near = |found: Vec<f64>, expected: [f64; 4]| {
        let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(close && found.len() == 4, "{found:?} and {expected:?}");
    };
    near(places(0.5, 0.2), [1.7, 1.9, 2.1, 2.3]);
    near(places(0.5, 0.0), [2.0; 4]);
    // Before the first key the camera rests.
    near(places(0.0, 0.2), [0.0, 0.0, 0.1, 0.3]);
    near(places(1.0, 0.2), [3.7, 3.9, 4.0, 4.0]);
}

#[test]
fn no_exposure_reaches_across_a_cut() {
    let mut keys = vec![
        key(0.0, [0.0, 0.0, 5.0], [0.0; 3], Ease::Linear),
        key(1.0, [4.0, 0.0, 5.0], [4.0, 0.0, 0.0], Ease::Hold),
        key(2.0, [40.0, 0.0, 5.0], [40.0, 0.0, 0.0], Ease::Linear),
        key(3.0, [44.0, 0.0, 5.0], [44.0, 0.0, 0.0], Ease::Linear),
        key(4.0, [48.0, 0.0, 5.0], [48.0, 0.0, 0.0], Ease::Linear),
    ];
    keys[3].camera.lens = Lens::Orthographic { height: 4.0 };
    keys[4].camera.lens = Lens::Orthographic { height: 4.0 };
    let sampler = path(Interpolation::Linear, keys).sampler().unwrap();
    for (t, cut, is_behind) in [
        (1.99, 2.0, false),
        (2.0, 2.0, true),
        (2.01, 2.0, true),
        (2.95, 3.0, false),
        (3.0, 3.0, true),
    ] {
        let cameras = sampler.while_open(t, 0.4, 16);
        let first = if is_behind { cut } else { t - 0.2 };
        let last = if is_behind { t + 0.2 } else { cut };
        for (number, camera) in cameras.iter().enumerate() {
            let at = first + (last - first) * (number as f64 + 0.5) / 16.0;
            assert!(at < cut || is_behind);
            assert!((camera.eye - sampler.at(at).eye).length() < 1e-6, "{t} {number}");
            assert_eq!(camera.lens.projection(), sampler.at(t).lens.projection(), "{t} {number}");
        }
    }
}

#[test]
fn field_of_view_and_distance_change_with_the_rest() {
    let mut keys = vec![
        key(0.0, [0.0, 0.0, 10.0], [0.0; 3], Ease::InOut),
        key(4.0, [0.0, 0.0, 30.0], [0.0; 3], Ease::Smooth),
    ];
    keys[1].camera.lens = Lens::Perspective { fov_deg: 60.0 };
    let camera = path(Interpolation::Linear, keys).sampler().unwrap().at(1.0);
    let made = 0.15625;
    assert!((camera.lens.fov_deg().unwrap() - (40.0 + 20.0 * made)).abs() < 1e-12);
    assert!((camera.eye.z - (10.0 + 20.0 * made)).abs() < 1e-12);
    assert!(camera.target.length() < 1e-12);
}

/// Looking back the way it came, upside down, and along its own up.
#[test]
fn opposite_orientations_have_a_way_between_them() {
    let mut keys = vec![
        key(0.0, [0.0; 3], [0.0, 0.0, -1.0], Ease::Linear),
        key(1.0, [0.0; 3], [0.0, 0.0, 1.0], Ease::Linear),
        key(2.0, [0.0; 3], [0.0, 0.0, 1.0], Ease::Linear),
        key(3.0, [0.0; 3], [0.0, 1.0, 0.0], Ease::Linear),
    ];
    keys[2].camera.up = -DVec3::Y;
    let sampler = path(Interpolation::CatmullRom, keys).sampler().unwrap();
    for leg in 0..2 {
        let start = f64::from(leg);
        let first = sampler.at(start);
        for step in 0..=10 {
            let camera = sampler.at(start + f64::from(step) / 10.0);
            assert!(camera.view(64, 48).is_ok(), "{camera:?}");
            let expected = 2.0 * 2.0 * (std::f64::consts::FRAC_PI_4 * f64::from(step) / 10.0).sin();
            assert!((turn_between(&first, &camera) - expected).abs() < 1e-6);
        }
    }
    assert!(sampler.at(2.5).view(64, 48).is_ok());
}

/// The curve goes through keys in one place as through one point, and the camera waits there.
#[test]
fn keys_in_one_place_are_a_pause() {
    let ease = Ease::Smooth;
    let at = |t, x: f64, z: f64| key(t, [x, 0.0, z], [x, 0.0, z - 1.0], ease);
    let without = path(
        Interpolation::CatmullRom,
        vec![at(0.0, 0.0, 0.0), at(1.0, 4.0, 1.0), at(2.0, 5.0, 7.0)],
    );
    let mut keys = without.keys.clone();
    keys.insert(2, at(3.0, 4.0, 1.0));
    keys[3].t = 4.0;
    let with = CameraPath { keys, ..without.clone() };
    let (without, with) = (without.sampler().unwrap(), with.sampler().unwrap());
    assert_eq!(without.legs[0].slopes, with.legs[0].slopes);
    assert_eq!(without.legs[1].slopes, with.legs[2].slopes);
    for t in [1.0, 1.3, 2.0, 2.99, 3.0] {
        assert_eq!(with.at(t).eye, DVec3::new(4.0, 0.0, 1.0));
    }
}

#[test]
fn hold_is_a_cut() {
    let keys = vec![
        key(0.0, [0.0, 0.0, 5.0], [0.0; 3], Ease::Hold),
        key(1.0, [5.0, 0.0, 0.0], [0.0; 3], Ease::Smooth),
        key(2.0, [9.0, 0.0, 0.0], [0.0; 3], Ease::Smooth),
    ];
    let sampler = path(Interpolation::CatmullRom, keys.clone()).sampler().unwrap();
    assert_eq!(sampler.at(0.999_999_999), keys[0].camera);
    assert_eq!(sampler.at(1.0), keys[1].camera);
    assert!(sampler.at(1.5).eye.x > 5.5);
}

/// As precise at coordinates of a survey as at the origin.
#[test]
fn large_coordinates_cost_nothing() {
    let offset = DVec3::new(412_000.0, 5_653_000.0, 113.0);
    let keys: Vec<PathKey> = [[0.0, 0.0, 5.0], [4.0, 1.0, 1.0], [5.0, 2.0, -6.0], [0.0, 2.0, -9.0]]
        .into_iter()
        .enumerate()
        .map(|(i, eye)| key(i as f64, eye, [0.0; 3], Ease::Smooth))
        .collect();
    let near = path(Interpolation::CatmullRom, keys);
    let mut far = near.clone();
    for key in &mut far.keys {
        key.camera.eye += offset;
        key.camera.target += offset;
    }
    let (near, far) = (near.sampler().unwrap(), far.sampler().unwrap());
    for step in 0..60 {
        let t = f64::from(step) / 20.0;
        let (a, b) = (near.at(t), far.at(t));
        assert!(
            a.eye.distance(b.eye - offset) < 1e-8 && a.target.distance(b.target - offset) < 1e-8
        );
    }
}

const EASES: [Ease; 5] = [Ease::Smooth, Ease::Linear, Ease::In, Ease::Out, Ease::InOut];

/// Keys among which some coincide, look along up, or face each other.
fn keys() -> impl Strategy<Value = Vec<PathKey>> {
    let place = prop_oneof![
        prop::array::uniform3(-100.0..100.0f64),
        prop::array::uniform3((-1i8..=1).prop_map(f64::from)),
        Just([1e12, -1e12, 1e12]),
        Just([1e-12, 0.0, 0.0]),
    ];
    let direction = prop_oneof![
        prop::array::uniform3(-2.0..2.0f64),
        prop::sample::select(vec![
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0]
        ]),
    ];
    let one = (0.1..3.0f64, place, direction, prop::sample::select(&EASES[..]), 1.0..179.0f64);
    prop::collection::vec(one, 1..8).prop_map(|list| {
        let mut t = -2.0;
        let made = list.into_iter().map(|(pause, eye, way, ease, fov)| {
            t += pause;
            let way = DVec3::from_array(way);
            let way = if way.length() < 1e-3 { DVec3::X } else { way };
            let target = DVec3::from_array(eye) + way;
            let mut made = key(t, eye, target.to_array(), ease);
            made.camera.lens = Lens::Perspective { fov_deg: fov };
            made
        });
        made.collect()
    })
}

fn interpolation() -> impl Strategy<Value = Interpolation> {
    prop_oneof![Just(Interpolation::CatmullRom), Just(Interpolation::Linear)]
}

proptest! {
    #[test]
    fn keys_are_met_to_the_last_bit(keys in keys(), interpolation in interpolation()) {
        let sampler = path(interpolation, keys.clone()).sampler().unwrap();
        for key in keys {
            prop_assert_eq!(sampler.at(key.t), key.camera);
        }
    }

    #[test]
    fn every_camera_can_be_drawn(keys in keys(), interpolation in interpolation(), at in 0.0..=1.0f64) {
        let path = path(interpolation, keys);
        let t = path.keys[0].t + at * path.duration_s();
        let camera = path.sampler().unwrap().at(t);
        prop_assert!(camera.view(64, 48).is_ok(), "{:?}", camera);
        let fovs = path.keys.iter().map(|key| key.camera.lens.fov_deg().unwrap());
        let (least, most) = fovs.fold((180.0f64, 0.0f64), |(a, b), fov| (a.min(fov), b.max(fov)));
        let fov_deg = camera.lens.fov_deg().unwrap();
        prop_assert!(fov_deg >= least - 1e-9 && fov_deg <= most + 1e-9);
    }

    /// Nothing jumps: neither at keys nor between them.
    #[test]
    fn cameras_move_continuously(keys in keys(), interpolation in interpolation(), at in 0.0..=1.0f64) {
        const STEP_S: f64 = 1e-9;
        let path = path(interpolation, keys);
        let sampler = path.sampler().unwrap();
        let reach = path.keys.iter().map(|key| key.camera.eye.length()).fold(1.0, f64::max);
        let random = path.keys[0].t + at * path.duration_s();
        for t in path.keys.iter().map(|key| key.t).chain([random]) {
            let (a, b) = (sampler.at(t - STEP_S), sampler.at(t + STEP_S));
            prop_assert!(a.eye.distance(b.eye) < 1e-6 * reach, "{} {}", a.eye, b.eye);
            // Where coordinates are large, the direction from eye to target is rounded.
            let rounded = 8.0 * f64::EPSILON * reach / a.eye.distance(a.target);
            prop_assert!(turn_between(&a, &b) < 1e-6 + rounded.min(4.0), "{a:?} {b:?}");
            prop_assert!((a.lens.fov_deg().unwrap() - b.lens.fov_deg().unwrap()).abs() < 1e-5);
        }
    }

    /// On a smooth path not even the velocity jumps, wherever keys are and whenever.
    #[test]
    fn velocity_does_not_jump_on_smooth_paths(
        list in prop::collection::vec((0.1..3.0f64, prop::array::uniform3(-50.0..50.0f64)), 3..7),
    ) {
        const STEP_S: f64 = 1e-6;
        let mut t = 0.0;
        let keys = list.into_iter().map(|(pause, eye)| {
            t += pause;
            key(t, eye, [1000.0, 0.0, 0.0], Ease::Smooth)
        });
        let path = path(Interpolation::CatmullRom, keys.collect());
        let sampler = path.sampler().unwrap();
        for key in &path.keys[1..path.keys.len() - 1] {
            let [before, here, after] = [-STEP_S, 0.0, STEP_S].map(|dt| sampler.at(key.t + dt).eye);
            let (arrives, leaves) = ((here - before) / STEP_S, (after - here) / STEP_S);
            let speed = arrives.length().max(leaves.length()).max(1.0);
            prop_assert!(arrives.distance(leaves) < 1e-2 * speed, "{arrives} {leaves}");
        }
    }
}
