//! Finds how the sensor that took a cloud saw it.
//!
//! An organised cloud (height above 1) is the image of a depth camera: a point's place in the file is its pixel. The camera's
//! focal lengths follow from a linear fit of pixels to directions, which succeeds only for the right axes and the right pose. So
//! the fit also tells which axes the sensor has (optical: x right, y down, z forward; OpenGL: x right, y up, z backward; robot:
//! x forward, y left, z up) and whether the points are in the sensor's coordinates or in those that `VIEWPOINT` places it in.
//! Images that are no perspective, of spinning lidars for example, fit none and have no such view.
//!
//! The points of an unorganised cloud have no pixels. There `VIEWPOINT` counts if it is not the identity, which all software
//! writes that knows no better, and if nearly all points lie before the sensor.

use glam::{DAffine3, DQuat, DVec3};

use crate::math::{Camera, Lens, SensorView};

/// Points that are looked at, at most.
const SAMPLES: usize = 4096;
/// Share of the points that must lie before the sensor.
const BEFORE: f64 = 0.98;
/// Error of the fit, relative to the image's size, that a perspective image may have.
const MOST_ERROR: f64 = 0.02;
/// Tangent of half the widest field of view that is shown.
const WIDEST: f64 = 2.0;

/// Axes of a sensor: right, down, forward.
const CONVENTIONS: [[DVec3; 3]; 3] = [
    [DVec3::X, DVec3::Y, DVec3::Z],
    [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z],
    [DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X],
];

/// A depth image: its size, and the pixel of each point.
pub(super) struct Raster<'a> {
    pub width: u64,
    pub height: u64,
    pub pixels: &'a [u32],
}

/// The seven numbers of `VIEWPOINT`: translation, then a quaternion that begins with w. `None` for the identity.
pub(super) fn pose(numbers: [f64; 7]) -> Option<DAffine3> {
    let [x, y, z, qw, qx, qy, qz] = numbers;
    let length = DQuat::from_xyzw(qx, qy, qz, qw).length();
    let rotation = if length > 1e-9 {
        DQuat::from_xyzw(qx / length, qy / length, qz / length, qw / length)
    } else {
        DQuat::IDENTITY
    };
    let pose = DAffine3::from_rotation_translation(rotation, DVec3::new(x, y, z));
    (pose.is_finite() && !pose.abs_diff_eq(DAffine3::IDENTITY, 1e-9)).then_some(pose)
}

/// The sensor's view of the points, if it had one.
pub(super) fn view(
    positions: &[DVec3],
    raster: Option<&Raster>,
    pose: Option<DAffine3>,
) -> Option<SensorView> {
    let poses = match raster {
        Some(_) => [pose, Some(DAffine3::IDENTITY)],
        None => [pose, None],
    };
    let step = positions.len().div_ceil(SAMPLES).max(1);
    let mut best: Option<(f64, SensorView)> = None;
    for world_from_sensor in poses.into_iter().flatten() {
        let sensor_from_world = world_from_sensor.inverse();
        for axes in CONVENTIONS {
            let directions: Vec<Direction> = positions
                .iter()
                .enumerate()
                .step_by(step)
                .filter_map(|(index, &at)| {
                    let at = sensor_from_world.transform_point3(at);
                    let [right, down, depth] = axes.map(|axis| at.dot(axis));
                    let before = depth > 0.0;
                    before.then(|| Direction { index, tan: [right / depth, down / depth], depth })
                })
                .collect();
            let looked_at = positions.len().div_ceil(step);
            if (directions.len() as f64) < BEFORE * looked_at as f64 {
                continue;
            }
            let found = match raster {
                Some(raster) => fitted(&directions, raster),
                None => spread(&directions),
            };
            let Some((error, [tan_x, tan_y])) = found else { continue };
            if best.as_ref().is_some_and(|(least, _)| *least <= error) {
                continue;
            }
            let turned = |axis: DVec3| world_from_sensor.transform_vector3(axis);
            let eye = world_from_sensor.translation;
            let camera = Camera {
                eye,
                target: eye + turned(axes[2]) * median_depth(&directions),
                up: turned(-axes[1]),
                lens: Lens::Perspective { fov_deg: 2.0 * tan_y.atan().to_degrees() },
            };
            if camera.view(1, 1).is_ok() {
                best = Some((error, SensorView { camera, aspect: tan_x / tan_y }));
            }
        }
    }
    best.map(|(_, view)| view)
}

/// Where a point is seen.
struct Direction {
    /// Index of the point.
    index: usize,
    /// To the right and down, over depth.
    tan: [f64; 2],
    depth: f64,
}

fn median_depth(directions: &[Direction]) -> f64 {
    let mut depths: Vec<f64> = directions.iter().map(|direction| direction.depth).collect();
    let middle = depths.len() / 2;
    *depths.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Error of the best fit of pixels to directions, and the tangents of half the fields of view.
fn fitted(directions: &[Direction], raster: &Raster) -> Option<(f64, [f64; 2])> {
    let pixel = |direction: &Direction| {
        let pixel = u64::from(*raster.pixels.get(direction.index)?);
        Some([(pixel % raster.width) as f64, (pixel / raster.width) as f64])
    };
    let mut worst = 0.0f64;
    let mut tans = [0.0; 2];
    for (axis, size) in [raster.width, raster.height].into_iter().enumerate() {
        let pairs = || directions.iter().filter_map(|d| Some((d.tan[axis], pixel(d)?[axis])));
        let count = pairs().count() as f64;
        let (sum_t, sum_p) = pairs().fold((0.0, 0.0), |(t, p), (a, b)| (t + a, p + b));
        let (mean_t, mean_p) = (sum_t / count, sum_p / count);
        let (mut tt, mut tp, mut pp) = (0.0, 0.0, 0.0);
        for (t, p) in pairs() {
            let (t, p) = (t - mean_t, p - mean_p);
            (tt, tp, pp) = (tt + t * t, tp + t * p, pp + p * p);
        }
        let focal_px = tp / tt;
        let variance = (pp - tp * focal_px).max(0.0) / count;
        let size = size as f64;
        worst = worst.max(variance.sqrt() / size);
        tans[axis] = 0.5 * size / focal_px;
        let is_seen = focal_px > 0.0 && focal_px.is_finite() && tans[axis] < WIDEST;
        let fits = variance.sqrt() < MOST_ERROR * size;
        if !(is_seen && fits) {
            return None;
        }
    }
    Some((worst, tans))
}

/// Tangents of half the fields of view that nearly all directions lie in. The narrower they are, the likelier it is that the
/// sensor looked that way.
fn spread(directions: &[Direction]) -> Option<(f64, [f64; 2])> {
    let tans = [0, 1].map(|axis| {
        let mut tans: Vec<f64> = directions.iter().map(|d| d.tan[axis].abs()).collect();
        let most = (tans.len() - 1) * 99 / 100;
        (*tans.select_nth_unstable_by(most, f64::total_cmp).1 * 1.05).max(0.02)
    });
    let widest = tans[0].max(tans[1]);
    (widest < WIDEST).then_some((widest, tans))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The depth image of a bumpy wall, in coordinates with these axes.
    fn image(axes: [DVec3; 3]) -> (Vec<DVec3>, Vec<u32>) {
        let pixels: Vec<u32> = (0..64 * 48).filter(|pixel| pixel % 7 != 3).collect();
        let point = |pixel: &u32| {
            let (x, y) = (f64::from(pixel % 64) - 31.5, f64::from(pixel / 64) - 23.5);
            let depth = 2.0 + (x * 0.2).sin() + (y * 0.3).cos();
            let [right, down, forward] = axes;
            (right * x / 52.5 + down * y / 52.5 + forward) * depth
        };
        (pixels.iter().map(point).collect(), pixels)
    }

    fn assert_near(a: DVec3, b: DVec3) {
        assert!(a.distance(b) < 1e-6, "{a} {b}");
    }

    fn direction(view: &SensorView) -> DVec3 {
        (view.camera.target - view.camera.eye).normalize_or_zero()
    }

    #[test]
    fn depth_images_are_seen_as_the_camera_saw_them() {
        for axes in CONVENTIONS {
            let (positions, pixels) = image(axes);
            let raster = Raster { width: 64, height: 48, pixels: &pixels };
            let view = view(&positions, Some(&raster), None).unwrap();
            assert_near(direction(&view), axes[2]);
            assert_near(view.camera.up, -axes[1]);
            assert_near(view.camera.eye, DVec3::ZERO);
            let fov_deg = 2.0 * (24.0f64 / 52.5).atan().to_degrees();
            assert!(
                (view.camera.lens.fov_deg().unwrap() - fov_deg).abs() < 0.01,
                "{:?}",
                view.camera.lens
            );
            assert!((view.aspect - 4.0 / 3.0).abs() < 1e-3, "{}", view.aspect);
        }
    }

    #[test]
    fn the_raster_tells_whose_coordinates_the_points_have() {
        let placed = pose([1.0, -2.0, 3.0, 0.5, 0.5, -0.5, 0.5]).unwrap();
        let axes = CONVENTIONS[0];
        let (own, pixels) = image(axes);
        let raster = Raster { width: 64, height: 48, pixels: &pixels };
        let seen = view(&own, Some(&raster), Some(placed)).unwrap();
        assert_near(seen.camera.eye, DVec3::ZERO);
        let world: Vec<DVec3> = own.iter().map(|&at| placed.transform_point3(at)).collect();
        let seen = view(&world, Some(&raster), Some(placed)).unwrap();
        assert_near(seen.camera.eye, DVec3::new(1.0, -2.0, 3.0));
        assert_near(seen.camera.up, placed.transform_vector3(-axes[1]));
    }

    #[test]
    fn panoramas_and_unordered_points_have_no_view() {
        let (positions, mut pixels) = image(CONVENTIONS[0]);
        assert!(view(&positions, None, None).is_none(), "the identity says nothing");
        pixels.reverse();
        let raster = Raster { width: 64, height: 48, pixels: &pixels };
        assert!(
            view(&positions, Some(&raster), None).is_none(),
            "an image upside down and mirrored"
        );
        let around: Vec<DVec3> = (0..3072)
            .map(|i| {
                let (azimuth, elevation) = (f64::from(i % 64) * 0.098, f64::from(i / 64) * 0.01);
                DVec3::new(azimuth.cos(), azimuth.sin(), elevation) * 9.0
            })
            .collect();
        let pixels: Vec<u32> = (0..3072).collect();
        let raster = Raster { width: 64, height: 48, pixels: &pixels };
        let placed = pose([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        assert!(view(&around, Some(&raster), placed).is_none());
        assert!(view(&around, None, placed).is_none());
    }

    #[test]
    fn unordered_points_are_seen_from_the_viewpoint() {
        let placed = pose([0.0, 0.0, 1.0, 0.5, 0.5, -0.5, 0.5]).unwrap();
        let (own, _) = image(CONVENTIONS[0]);
        let world: Vec<DVec3> = own.iter().map(|&at| placed.transform_point3(at)).collect();
        let seen = view(&world, None, Some(placed)).unwrap();
        assert_near(seen.camera.eye, DVec3::Z);
        assert_near(direction(&seen), placed.transform_vector3(DVec3::Z));
        assert_near(seen.camera.up, placed.transform_vector3(DVec3::NEG_Y));
        assert!((seen.camera.lens.fov_deg().unwrap() - 49.0).abs() < 3.0, "{:?}", seen.camera.lens);
    }

    #[test]
    fn poses_are_rigid() {
        assert!(pose([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).is_none());
        assert!(pose([0.0; 7]).is_none(), "never written");
        assert!(pose([0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0]).is_none());
        let turned = pose([0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 3.0]).unwrap();
        assert_near(turned.transform_point3(DVec3::X), DVec3::Y);
    }
}
