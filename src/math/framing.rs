//! Computes the camera that shows given points as large as the frame allows.
//!
//! For a viewing direction and a field of view, an eye sees all points when each lies on the inner side of four planes through the
//! eye. Only the point that lies farthest beyond each plane's direction matters, so the nearest such eye has a closed form: with x to the right, y up
//! and z towards the eye, and `t` the tangent of half the horizontal field of view, the two side planes ask for
//! `eye.z ≥ (max(x + t z) + max(−x + t z)) / 2t`, and the centred eye has `eye.x = (max(x + t z) − max(−x + t z)) / 2`. The same holds
//! for y. The side that needs the larger distance decides it. Along the other one the content is centred, too, by the largest `t`
//! that this distance allows.
//!
//! An orthographic camera sees the extent of the content across the viewing direction at any distance. Its height follows from that
//! extent, and the eye stands apart from the content by its size, so that it may be turned around its target and cuts nothing off.

use glam::DVec3;

use super::{Camera, Lens};

/// Share of the frame's width or height that the content fills, whichever it fills first.
const FILLED: f64 = 0.9;
/// Share that the content may fill together with what is drawn around its points.
const FILLED_AROUND: f64 = 0.98;
/// Smallest distance to the eye, as a share of the content's size.
const NEAREST: f64 = 0.05;
/// Distance of the eye from content without extent.
const FROM_A_POINT: f64 = 1.0;

/// How much the camera shall show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shown {
    /// Vertical field of view in degrees.
    Perspective(f64),
    /// Height of the view; `None`: as the content needs.
    Orthographic(Option<f64>),
}

/// A viewing direction, with the properties of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Unit vector from the content towards the eye.
    pub backward: DVec3,
    pub up: DVec3,
    pub shown: Shown,
    /// Width of the frame over its height.
    pub aspect: f64,
    /// Radius around each point within which something is drawn.
    pub reach: f64,
}

/// Largest values of `p + t z` and `−p + t z`.
fn planes(points: &[DVec3], axis: usize, t: f64) -> (f64, f64) {
    points.iter().fold((f64::NEG_INFINITY, f64::NEG_INFINITY), |(high, low), v| {
        (high.max(v[axis] + t * v.z), low.max(t * v.z - v[axis]))
    })
}

/// The distance along the viewing axis from which everything fits between the planes of slope `t`, with a sphere around each
/// point.
fn needed(points: &[DVec3], axis: usize, t: f64, radius: f64) -> f64 {
    let (high, low) = planes(points, axis, t);
    (0.5 * (high + low) + radius * (1.0 + t * t).sqrt()) / t
}

/// The eye's coordinate at `distance` along the viewing axis that centres the content in the frame.
fn centred(points: &[DVec3], axis: usize, widest: f64, distance: f64) -> f64 {
    // Find the slope at which the content touches both planes. The distance needed decreases with the slope.
    let (mut narrow, mut wide) = (0.0, widest);
    for _ in 0..48 {
        let middle = 0.5 * (narrow + wide);
        if middle > 0.0 && needed(points, axis, middle, 0.0) <= distance {
            wide = middle;
        } else {
            narrow = middle;
        }
    }
    let (high, low) = planes(points, axis, wide);
    0.5 * (high - low)
}

/// The camera that shows all `points`, filling nine tenths of the frame's width or of its height.
pub fn frame(points: &[DVec3], look: &Look) -> Camera {
    let Look { backward, up, shown, aspect, reach } = *look;
    let side = up.cross(backward);
    let right = side / side.length();
    let above = backward.cross(right);
    let low = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
    let high = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
    // Relative to the middle, so that far coordinates keep their digits.
    let centre = low * 0.5 + high * 0.5;
    let points: Vec<DVec3> = points
        .iter()
        .map(|&point| point - centre)
        .map(|v| DVec3::new(v.dot(right), v.dot(above), v.dot(backward)))
        .collect();
    let size = (high - low).length();
    let front = points.iter().map(|v| v.z).fold(0.0, f64::max);
    let back = points.iter().map(|v| v.z).fold(0.0, f64::min);
    let fov_deg = match shown {
        Shown::Perspective(fov_deg) => fov_deg,
        Shown::Orthographic(height) => {
            let [x, y] = [0, 1].map(|axis| Span::of(&points, axis));
            let fits = |filled: f64, reach: f64| {
                ((x.length() + 2.0 * reach) / aspect).max(y.length() + 2.0 * reach) / filled
            };
            let needed = fits(FILLED, 0.0).max(fits(FILLED_AROUND, reach));
            let height =
                height.unwrap_or(if needed > 0.0 { needed } else { FROM_A_POINT.max(size) });
            let distance = front + size.max(height).max(1e-12 * centre.length());
            let eye = centre + right * x.middle() + above * y.middle() + backward * distance;
            let target = eye - backward * (distance - 0.5 * (front + back));
            return Camera { eye, target, up, lens: Lens::Orthographic { height } };
        }
    };
    let tan = (0.5 * fov_deg).to_radians().tan();
    let [tan_x, tan_y] = [aspect, 1.0].map(|sides| FILLED * tan * sides);
    let least = if size > 0.0 { NEAREST * size } else { FROM_A_POINT };
    // A smaller distance would not change the coordinates.
    let mut distance = front + least.max(1e-12 * centre.length());
    let (mut x, mut y) = (0.0, 0.0);
    if size > 0.0 {
        for (axis, sides) in [aspect, 1.0].into_iter().enumerate() {
            for (filled, radius) in [(FILLED, 0.0), (FILLED_AROUND, reach)] {
                distance = distance.max(needed(&points, axis, filled * tan * sides, radius));
            }
        }
        x = centred(&points, 0, tan_x, distance);
        y = centred(&points, 1, tan_y, distance);
    }
    let eye = centre + right * x + above * y + backward * distance;
    let target = eye - backward * (distance - 0.5 * (front + back));
    Camera { eye, target, up, lens: Lens::Perspective { fov_deg } }
}

/// Least and largest coordinate along an axis.
struct Span(f64, f64);

impl Span {
    fn of(points: &[DVec3], axis: usize) -> Span {
        let most =
            |sign: f64| points.iter().map(|v| sign * v[axis]).fold(f64::NEG_INFINITY, f64::max);
        if points.is_empty() { Span(0.0, 0.0) } else { Span(-most(-1.0), most(1.0)) }
    }

    fn length(&self) -> f64 {
        self.1 - self.0
    }

    fn middle(&self) -> f64 {
        0.5 * (self.0 + self.1)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use proptest::prelude::*;

    use super::*;

    fn look(backward: DVec3, aspect: f64) -> Look {
        Look {
            backward: backward.normalize_or(DVec3::Z),
            up: DVec3::Y,
            shown: Shown::Perspective(40.0),
            aspect,
            reach: 0.0,
        }
    }

    /// Smallest and largest image coordinates of `points`, as shares of the frame from 0 to 1.
    fn shown(points: &[DVec3], camera: &Camera, aspect: f64) -> [DVec2; 2] {
        let (width, height) = ((1000.0 * aspect) as u32, 1000);
        let view = camera.view(width, height).unwrap();
        let size = DVec2::new(f64::from(width), f64::from(height));
        let places: Vec<DVec2> = points
            .iter()
            .map(|&point| view.project(view.to_view(point)).expect("in front of the eye") / size)
            .collect();
        let low = places.iter().copied().reduce(DVec2::min).unwrap();
        [low, places.iter().copied().reduce(DVec2::max).unwrap()]
    }

    proptest! {
        #[test]
        fn content_fills_nine_tenths_and_is_centred(
            places in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 2..40),
            flat in prop::array::uniform3(prop::sample::select(vec![1.0, 1.0, 0.01, 0.0])),
            away in prop::array::uniform3(-1.0..1.0f64),
            aspect in prop::sample::select(vec![1.0, 4.0 / 3.0, 16.0 / 9.0, 9.0 / 19.0]),
            scale in prop::sample::select(vec![1e-6, 1.0, 1e7]),
            origin in prop::sample::select(vec![DVec3::ZERO, DVec3::new(412_000.0, 5_653_000.0, 110.0)]),
        ) {
            prop_assume!(scale >= 1.0 || origin == DVec3::ZERO);
            let away = DVec3::from_array(away);
            prop_assume!(away.length() > 0.1 && away.cross(DVec3::Y).length() > 0.1);
            let place = |p: [f64; 3]| origin + DVec3::from_array(p) * DVec3::from_array(flat) * scale;
            let points: Vec<DVec3> = places.into_iter().map(place).collect();
            let size = points.iter().map(|p| p.distance(points[0])).fold(0.0, f64::max);
            prop_assume!(size > 0.0);
            let camera = frame(&points, &look(away, aspect));
            let [low, high] = shown(&points, &camera, aspect);
            prop_assert!(low.min_element() > 0.049 && high.max_element() < 0.951, "{low} {high}");
            let seen = high - low;
            // A line along the viewing direction is a dot from anywhere in front of it. Its near end keeps a distance to the eye.
            let backward = (camera.eye - camera.target).normalize_or(DVec3::Z);
            let depth = |p: &DVec3| (camera.eye - *p).dot(backward);
            let nearest = points.iter().map(depth).fold(f64::MAX, f64::min);
            let low_corner = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
            let high_corner = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
            if nearest > 1.001 * NEAREST * (high_corner - low_corner).length() {
                prop_assert!((seen.max_element() - 0.9).abs() < 2e-3, "{seen}");
            }
            prop_assert!((0.5 * (low + high) - 0.5).abs().max_element() < 2e-3, "{low} {high}");
            let flat = frame(&points, &Look { shown: Shown::Orthographic(None), ..look(away, aspect) });
            let [low, high] = shown(&points, &flat, aspect);
            let across = points.iter().map(|p| (*p - points[0]).cross(backward).length()).fold(0.0, f64::max);
            if across > 1e-6 * size {
                prop_assert!(((high - low).max_element() - 0.9).abs() < 2e-3, "{low} {high}");
            }
            prop_assert!((0.5 * (low + high) - 0.5).abs().max_element() < 2e-3, "{low} {high}");
        }
    }

    #[test]
    fn there_is_room_for_what_is_drawn_around_points() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
        let shown_with = |reach| {
            let camera = frame(&square, &Look { reach, ..look(DVec3::Z, 1.0) });
            let places = square.map(|p| [p - DVec3::Y * reach, p + DVec3::Y * reach]);
            (camera, shown(&places.concat(), &camera, 1.0))
        };
        // Splats within the margin do not change the camera.
        assert_eq!(shown_with(0.02).0, shown_with(0.0).0);
        let (_, [low, high]) = shown_with(0.5);
        assert!((0.005..0.03).contains(&low.y) && (0.97..0.995).contains(&high.y), "{low} {high}");
    }

    #[test]
    fn odd_frames_and_odd_content_have_a_camera() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
        for aspect in [1.0 / 257.0, 257.0] {
            let camera = frame(&square, &look(DVec3::Z, aspect));
            let [low, high] = shown(&square, &camera, aspect.max(0.001));
            assert!(((high - low).max_element() - 0.9).abs() < 0.5, "{low} {high}");
        }
        let point = DVec3::new(500_000.0, 5_000_000.0, 0.0);
        let camera = frame(&[point], &look(DVec3::Z, 1.0));
        assert_eq!(camera.target, point);
        assert!((camera.eye.distance(point) - FROM_A_POINT).abs() < 1e-6);
        // A line along the viewing direction: the eye is in front of its near end, not inside it.
        let line = [DVec3::ZERO, DVec3::Z, DVec3::Z * 4.0];
        assert!(frame(&line, &look(DVec3::Z, 1.0)).eye.z > 4.1);
        assert!(frame(&[], &look(DVec3::Z, 1.0)).view(8, 8).is_ok());
    }
}
