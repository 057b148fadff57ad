//! The default view: the camera's direction, and the points that must be in the frame.
//!
//! Every geometry has an outline ([`crate::bake::outline`]). A scene's outline joins those of its instances: all points where
//! they are few, otherwise the farthest points in fixed directions, found through boxes around groups of instances, so that a
//! million instances cost milliseconds. [`SceneOutline::look`] chooses the direction by the outline's shape; [`framing::frame`]
//! finds the eye.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::bake::outline::{self, Outline};
use crate::math::framing::{self, Look, Shown};
use crate::math::{Bounds, Camera, Lens, View};
use crate::residency::model::{ModelInstance, SceneModel};
use crate::scene::clipping::{ClipRegion, Side};

/// Largest number of points that an outline keeps as they are.
const FEW_POINTS: usize = 4096;
/// Directions in which larger outlines are reduced to their farthest points.
const DIRECTIONS: usize = 512;
/// Number of instances whose boxes are tested together.
const GROUP: usize = 64;
/// Vertical field of view of the default view, in degrees.
pub const FOV_DEG: f64 = 40.0;
/// Lens of the default view.
pub const LENS: Lens = Lens::Perspective { fov_deg: FOV_DEG };
/// Largest depth of a plate, as a share of its height and width.
const PLATE: f64 = 0.12;
/// Angle from the front, in degrees, at which most content, upright content and plates are shown.
const ASIDE_DEG: [f64; 3] = [27.0, 20.0, 14.0];
/// Elevation of the eye in degrees, by height over width: maps and terrain from above, statues at eye height.
const ELEVATION_DEG: [(f64, f64); 5] =
    [(0.003, 60.0), (0.05, 42.0), (0.3, 33.0), (1.0, 22.0), (2.0, 9.0)];
/// Length over width above which content is long.
const LONG: f64 = 1.5;
/// Height over width below which content counts as land.
const LAND: f64 = 0.3;
/// Height over width above which content counts as upright.
const UPRIGHT: f64 = 1.3;

/// Points that decide which cameras show the whole scene; strays are left out.
#[derive(Debug, Default)]
pub struct SceneOutline {
    points: Vec<DVec3>,
}

impl SceneOutline {
    /// The outline of a box.
    pub fn around(bounds: &Bounds) -> SceneOutline {
        SceneOutline { points: bounds.corners().to_vec() }
    }

    pub fn of(model: &SceneModel) -> SceneOutline {
        let outlines: Vec<&[Outline]> = model.assets.iter().map(|asset| asset.outlines()).collect();
        let outline = |instance: &ModelInstance| &outlines[instance.asset][instance.geometry];
        let points_of = |instance: &ModelInstance| {
            let map = instance.world_from_geometry;
            outline(instance).points.iter().map(move |&point| map.transform_point3(point))
        };
        let mut count = 0;
        let is_small = model.instances.iter().all(|instance| {
            count += outline(instance).points.len();
            count <= FEW_POINTS
        });
        if is_small {
            return SceneOutline { points: model.instances.iter().flat_map(points_of).collect() };
        }
        let boxes: Vec<Vec<Bounds>> = outlines
            .iter()
            .map(|outlines| outlines.iter().map(Outline::bounds).collect())
            .collect();
        let box_of = |instance: &ModelInstance| {
            boxes[instance.asset][instance.geometry].transformed(&instance.world_from_geometry)
        };
        let groups: Vec<&[ModelInstance]> =
            model.instances.runs().iter().flat_map(|run| run.members.chunks(GROUP)).collect();
        let around: Vec<Bounds> = groups
            .par_iter()
            .map(|group| group.iter().map(box_of).fold(Bounds::EMPTY, Bounds::union))
            .collect();
        let all = around.iter().copied().fold(Bounds::EMPTY, Bounds::union);
        let scale = outline::inverse_extent(&all);
        let directions: Vec<DVec3> = outline::directions(DIRECTIONS).map(|d| d * scale).collect();
        let farthest_along = |&direction: &DVec3| {
            let of_instance = |instance: &ModelInstance| {
                points_of(instance)
                    .map(|point| (point.dot(direction), point))
                    .reduce(|best, next| if next.0 > best.0 { next } else { best })
            };
            let of_group = |index: usize| {
                let members = groups[index];
                let reaches = members.iter().map(|i| outline::reach_of(&box_of(i), direction));
                outline::farthest(reaches, |member| of_instance(&members[member]))
            };
            let reaches = around.iter().map(|bounds| outline::reach_of(bounds, direction));
            outline::farthest(reaches, of_group).map(|(_, point)| point)
        };
        SceneOutline { points: directions.par_iter().filter_map(farthest_along).collect() }
    }

    /// Returns the outline of the boxes whose inside is shown, as far as they lie within this outline's bounds; `None` where no such box
    /// meets them.
    pub fn clipped(&self, clip: &ClipRegion) -> Option<SceneOutline> {
        let places = self.points.iter().map(|&point| clip.box_from_world.transform_point3(point));
        let bounds = Bounds::of_all(&places.collect::<Vec<_>>());
        let world_from_box = clip.box_from_world.inverse();
        let insides = clip.boxes.boxes().iter().filter(|clip| clip.side == Side::Inside);
        let points: Vec<DVec3> = insides
            .map(|clip| Bounds { min: bounds.min.max(clip.low), max: bounds.max.min(clip.high) })
            .filter(|part| part.min.cmple(part.max).all())
            .flat_map(|part| part.corners())
            .map(|corner| world_from_box.transform_point3(corner))
            .collect();
        (!points.is_empty()).then_some(SceneOutline { points })
    }

    /// Returns the camera of the default view for a frame of this aspect. `up` must not be zero. Samples may be drawn as far as `reach`
    /// around each point.
    pub fn camera(
        &self,
        up: DVec3,
        front: Option<DVec3>,
        (shown, aspect, reach): (Shown, f64, f64),
    ) -> Camera {
        let look = Look { reach, ..self.look(up, front, shown, aspect) };
        framing::frame(&self.points, &look)
    }

    /// Returns the least and the largest coordinate along a direction; zeros for a scene without points.
    pub fn range(&self, direction: DVec3) -> [f64; 2] {
        let along = self.points.iter().map(|point| point.dot(direction));
        let ends = along.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], coordinate| {
            [least.min(coordinate), most.max(coordinate)]
        });
        if ends[0] <= ends[1] { ends } else { [0.0; 2] }
    }

    /// Chooses the view direction: terrain is seen from above at an angle, upright things from the front at eye height, a plate
    /// from its face.
    fn look(&self, up: DVec3, seen: Option<DVec3>, shown: Shown, aspect: f64) -> Look {
        let up = up / up.length();
        // The front of a y-up scene is +z, of a z-up scene −y, unless a scanner saw another side.
        let usual = if up.z.abs() > up.y.abs() {
            -DVec3::Y * up.z.signum()
        } else {
            DVec3::Z * if up.y < 0.0 { -1.0 } else { 1.0 }
        };
        let front = seen.unwrap_or(usual);
        let front = front - up * up.dot(front);
        let front = front / front.length();
        let right = up.cross(front);
        let along = |axis: DVec3| {
            let reach = |sign: f64| self.points.iter().map(move |point| sign * point.dot(axis));
            let ends = [1.0, -1.0].map(|sign| reach(sign).fold(f64::NEG_INFINITY, f64::max));
            (ends[0] + ends[1]).max(0.0)
        };
        let (width, height, depth) = (along(right), along(up), along(front));
        let (turn_deg, elevation_deg) = angles(width, height, depth, aspect);
        let (turn_sin, turn_cos) = turn_deg.to_radians().sin_cos();
        let (sin, cos) = elevation_deg.to_radians().sin_cos();
        let backward = front * (turn_cos * cos) + right * (turn_sin * cos) + up * sin;
        Look { backward, up, shown, aspect, reach: 0.0 }
    }
}

/// Returns the angle from the front towards the right, and the elevation, for a box of this shape in a frame of this aspect; in
/// degrees.
fn angles(width: f64, height: f64, depth: f64, aspect: f64) -> (f64, f64) {
    let [most, upright, plate] = ASIDE_DEG;
    let (thin, wide) = (width.min(depth), width.max(depth));
    if wide > 0.0 && thin <= PLATE * wide && thin <= PLATE * height {
        let turn = if depth <= width { plate } else { 90.0 - plate };
        return (turn, elevation(f64::INFINITY));
    }
    let flatness = height / (width * depth).sqrt();
    let flatness = if flatness.is_nan() { 1.0 } else { flatness };
    let narrow = (1.0 - aspect).max(0.0);
    // Long content lies across the frame; land in a portrait frame leads away from the eye.
    let turned =
        if narrow > 0.0 && flatness < LAND { width > LONG * depth } else { depth > LONG * width };
    let aside = if flatness > UPRIGHT { upright } else { most };
    // Things seen from above are higher in the image, which fills a portrait frame.
    let from_above = ELEVATION_DEG[0].1 - elevation(flatness);
    let raised = from_above.max(0.0) * narrow * (1.0 - flatness / UPRIGHT).max(0.0);
    (if turned { 90.0 - aside } else { aside }, elevation(flatness) + raised)
}

fn elevation(flatness: f64) -> f64 {
    let [(lowest, from_above), ..] = ELEVATION_DEG;
    if flatness <= lowest {
        return from_above;
    }
    for pair in ELEVATION_DEG.windows(2) {
        let [(a, at_a), (b, at_b)] = [pair[0], pair[1]];
        if flatness <= b {
            let share = (flatness / a).ln() / (b / a).ln();
            return at_a + (at_b - at_a) * share;
        }
    }
    ELEVATION_DEG[ELEVATION_DEG.len() - 1].1
}

/// Explains why a view shows nothing of a box, and how to see it.
pub fn why_nothing(bounds: &Bounds, view: &View, is_clipped: bool) -> String {
    if bounds.is_empty() {
        return "the scene has nothing to draw: no node with points, lines or triangles is visible"
            .to_owned();
    }
    let corners = bounds.corners().map(|corner| view.to_view(corner));
    let all = |test: &dyn Fn(&DVec3) -> bool| corners.iter().all(test);
    let size_px = DVec2::new(f64::from(view.width), f64::from(view.height));
    // The frame's edges at divisor 1.
    let (low, high) = (view.ray(DVec2::new(0.0, size_px.y)), view.ray(DVec2::new(size_px.x, 0.0)));
    let divisor = |v: &DVec3| view.divisor(-v.z);
    let distance = bounds.centre().distance(view.eye);
    let focal_px = view.focal_px.max_element();
    let place = if all(&|v| v.z >= 0.0) {
        "lies behind the camera"
    } else if all(&|v| v.x < divisor(v) * low.x) {
        "lies to the left of the frame"
    } else if all(&|v| v.x > divisor(v) * high.x) {
        "lies to the right of the frame"
    } else if all(&|v| v.y > divisor(v) * high.y) {
        "lies above the frame"
    } else if all(&|v| v.y < divisor(v) * low.y) {
        "lies below the frame"
    } else if bounds.extent().length() / view.divisor(distance) * focal_px < 1.0 {
        "is smaller than a pixel"
    } else if is_clipped {
        "is hidden by clip boxes where the camera looks"
    } else {
        "has gaps where the camera looks"
    };
    let [x, y, z] = bounds.centre().to_array().map(digits);
    format!(
        "the scene {place}: its middle is at {x},{y},{z}, {} units away from the eye; without eye and camera the whole scene is shown",
        digits(distance)
    )
}

/// Formats a number with six significant digits, or with all of its integer digits.
fn digits(value: f64) -> String {
    let whole = value.abs().log10().floor();
    if !(-5.0..15.0).contains(&whole) {
        return if value == 0.0 { "0".to_owned() } else { format!("{value:.5e}") };
    }
    let text = format!("{value:.*}", (5.0 - whole).max(0.0) as usize);
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    text.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_seen_is_said_to_be_where_it_is() {
        let bounds = Bounds { min: DVec3::splat(-1.0), max: DVec3::ONE };
        let why = |eye: [f64; 3], target: [f64; 3]| {
            let (eye, target) = (DVec3::from_array(eye), DVec3::from_array(target));
            let camera = Camera { eye, target, up: DVec3::Y, lens: LENS };
            why_nothing(&bounds, &camera.view(64, 48).unwrap(), false)
        };
        for (eye, target, place) in [
            ([0.0, 0.0, 5.0], [0.0, 0.0, 9.0], "behind the camera"),
            ([0.0, 0.0, 9.0], [9.0, 0.0, 0.0], "to the left"),
            ([0.0, 0.0, 9.0], [-9.0, 0.0, 0.0], "to the right"),
            ([0.0, 0.0, 9.0], [0.0, -9.0, 0.0], "above"),
            ([0.0, 0.0, 9.0], [0.0, 9.0, 0.0], "below"),
            ([0.0, 0.0, 9e4], [0.0, 0.0, 0.0], "smaller than a pixel"),
            ([0.0, 0.0, 9.0], [0.0, 0.0, 0.0], "gaps"),
        ] {
            let text = why(eye, target);
            assert!(text.contains(place), "{eye:?} → {target:?}: {text}");
        }
        assert!(why([0.0, 0.0, 5.0], [0.0, 0.0, 9.0]).contains("middle is at 0,0,0, 5 units away"));
        assert!(
            why_nothing(
                &Bounds::EMPTY,
                &Camera { eye: DVec3::ONE, target: DVec3::ZERO, up: DVec3::Y, lens: LENS }
                    .view(8, 8)
                    .unwrap(),
                true
            )
            .contains("nothing to draw")
        );
        let shown = [412_000.123_456, 0.001_234_567, -5.0, 1e20, 5_653_000.0].map(digits);
        assert_eq!(shown, ["412000", "0.00123457", "-5", "1.00000e20", "5653000"]);
    }

    #[test]
    fn shapes_are_seen_from_where_they_show() {
        // Terrain is seen from above, a statue at eye height, and a cube from between.
        let elevation = |w, h, d| angles(w, h, d, 1.5).1;
        assert!((38.0..48.0).contains(&elevation(1000.0, 40.0, 800.0)));
        assert!((18.0..26.0).contains(&elevation(1.0, 1.0, 1.0)));
        assert!((5.0..12.0).contains(&elevation(1.0, 2.5, 1.0)));
        assert!(elevation(1.0, 0.0, 1.0) > 55.0, "a sheet that lies is seen from above");
        // A wall is seen from its face, whichever way it stands.
        let facing = |w, h, d| {
            let (turn, elevation) = angles(w, h, d, 1.5);
            let (sin, cos) = turn.to_radians().sin_cos();
            (sin * elevation.to_radians().cos(), cos * elevation.to_radians().cos())
        };
        assert!(facing(10.0, 6.0, 0.2).1 > 0.9);
        assert!(facing(0.0, 6.0, 10.0).0 > 0.9);
        // A train is seen from its side, and so is an animal.
        assert!(facing(3.0, 4.0, 60.0).0 > 0.7);
        assert!(facing(0.94, 1.69, 1.72).0 > 0.7);
        // Land leads into a portrait frame and is seen from higher up. A statue stands as in other frames.
        let portrait = |w, h, d| angles(w, h, d, 0.46);
        assert!(portrait(1000.0, 40.0, 400.0).0 > 45.0 && portrait(400.0, 40.0, 1000.0).0 < 45.0);
        assert!(portrait(1000.0, 40.0, 800.0).1 > elevation(1000.0, 40.0, 800.0) + 5.0);
        assert_eq!(portrait(1.0, 2.5, 1.0), angles(1.0, 2.5, 1.0, 1.5));
        for shape in [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let [w, h, d] = shape;
            let (turn, elevation) = angles(w, h, d, 1.5);
            assert!(turn.is_finite() && elevation.is_finite(), "{shape:?}");
        }
    }
}
