//! Views from which shadow maps are drawn (Williams 1978, "Casting curved shadows on curved surfaces").

use glam::{DMat3, DVec2, DVec3};

use crate::math::{Bounds, Projection, View};
use crate::scene::{Casting, Light, MOST_CASTING_LIGHTS};

/// The part of a map's side by which its place is rounded: while a camera moves within it, the map stays the same.
const STEPS: f64 = 8.0;
/// Sizes of maps for each doubling.
const SIZES: f64 = 4.0;
/// How many times as far away the next map begins: each covers a range of depths, so that near shadows are as exact in the image as
/// far ones (Zhang et al. 2006, "Parallel-split shadow maps").
const DEEPER: f64 = 5.0;

/// Maps of a lamp: the sides of a cube around it.
pub const LAMP_MAPS: usize = 6;
/// Side of a lamp's map, as a share of the side of the square that all of a light's maps take.
const LAMP_SIDE: f64 = 0.4;
/// Pixels of a lamp's map beyond each edge of the cube's side, so that a place near the edge finds its surroundings in one map; at most this share of its side.
const LAMP_MARGIN_PX: f64 = 50.0;
const LAMP_MARGIN: f64 = 0.125;

/// Views of the maps of all lights that cast shadows: those of suns, then those of lamps, each in the order of the lights. A sun's maps follow each other, that
/// of the nearest part of the view first, and every sun has as many. What any of `views` may show of a scene within `bounds` is covered, and depths are positive
/// for everything in the scene. A lamp has [`LAMP_MAPS`], whatever the view, along the axes of the world: +x, −x, +y, −y, +z, −z.
///
/// A light's maps have at most `side` × `side` pixels in all. Sizes and places are rounded, so that frames from neighbouring poses share
/// maps, and their pixels do not crawl along the edges of shadows.
pub fn light_views(lights: &[Light], bounds: &Bounds, views: &[View], side: u32) -> Vec<View> {
    let (mut suns, mut lamps) = (vec![], vec![]);
    for casting in lights.iter().filter_map(Light::casting) {
        match casting {
            Casting::Sun { direction, .. } => suns.push(direction),
            Casting::Lamp { position, .. } => lamps.push(position),
        }
    }
    let records = MOST_CASTING_LIGHTS - lamps.len();
    let ranges = depth_ranges(bounds, views, records / suns.len().max(1));
    let sun_side = if ranges.len() == 1 { side } else { side / 2 };
    let sun_maps = |&sun: &DVec3| {
        let parts = ranges.iter().map(|&range| {
            views.iter().flat_map(|view| visible_corners(view, range)).collect::<Vec<_>>()
        });
        parts.map(move |part| sun_view(sun, bounds, &part, sun_side)).collect::<Vec<_>>()
    };
    let lamp_maps = lamps.iter().flat_map(|&lamp| lamp_views(lamp, bounds, side));
    suns.iter().flat_map(sun_maps).chain(lamp_maps).collect()
}

/// The views of a lamp's maps. Of the axes, the one that is looked along is followed by the others in turn: x by y and z, y by z and x, z by x and y.
fn lamp_views(lamp: DVec3, bounds: &Bounds, side: u32) -> [View; LAMP_MAPS] {
    let side = (LAMP_SIDE * f64::from(side)) as u32;
    let margin_px = LAMP_MARGIN_PX.min(LAMP_MARGIN * f64::from(side));
    std::array::from_fn(|number| {
        let axis = |further: usize| DVec3::AXES[(number / 2 + further) % 3];
        let (right, up, backward) = match number % 2 {
            0 => (axis(2), axis(1), -axis(0)),
            _ => (axis(1), axis(2), axis(0)),
        };
        View {
            eye: lamp,
            view_from_world: DMat3::from_cols(right, up, backward).transpose(),
            projection: Projection::Perspective,
            focus: 0.5 * (bounds.max - bounds.min).length(),
            focal_px: DVec2::splat(0.5 * f64::from(side) - margin_px),
            principal_px: DVec2::splat(0.5 * f64::from(side)),
            width: side,
            height: side,
        }
    })
}

/// Ranges of depths of at most `most` maps, the nearest first.
fn depth_ranges(bounds: &Bounds, views: &[View], most: usize) -> Vec<[f64; 2]> {
    let depths = || {
        let of = |view: &View| bounds.corners().map(|corner| -view.to_view(corner).z);
        views.iter().flat_map(of)
    };
    let far = depths().fold(0.0, f64::max);
    let near = depths().fold(far, f64::min).max(0.0);
    if views.iter().any(View::is_orthographic) || near == far {
        return vec![[near, far]];
    }
    let times = (far / near).log(DEEPER).round().min(most.max(1) as f64 - 1.0) as i32;
    let end = |map: i32| far / DEEPER.powi(times - map);
    (0..=times).map(|map| [if map == 0 { near } else { end(map - 1) }, end(map)]).collect()
}

fn sun_view(direction: DVec3, bounds: &Bounds, part: &[DVec3], side: u32) -> View {
    let right = direction.any_orthonormal_vector();
    let view_from_world = DMat3::from_cols(right, right.cross(direction), -direction).transpose();
    let in_light =
        |places: &[DVec3]| Bounds::of(places.iter().map(|&place| view_from_world * place));
    let (scene, seen) = (in_light(&bounds.corners()), in_light(part));
    let (mut low, mut high) = (scene.min.truncate(), scene.max.truncate());
    let (near, far) = (seen.min.truncate().max(low), seen.max.truncate().min(high));
    // Nothing of the scene may be in view.
    if near.is_finite() && far.is_finite() && near.cmple(far).all() {
        (low, high) = (near, far);
    }
    let largest = low.abs().max(high.abs()).max_element();
    let needed = (high - low).max_element().max(1e-12 * largest).max(1e-30);
    let wanted = needed * STEPS / (STEPS - 1.0);
    let size = ((wanted.log2() * SIZES).ceil() / SIZES).exp2();
    let step = size / STEPS;
    let centre = ((0.5 * (low + high)) / step).round() * step;
    let depth = scene.max.z - scene.min.z;
    // The eye stands before everything in the scene.
    let margin = 0.01 * depth + size;
    let eye = view_from_world.transpose() * centre.extend(scene.max.z + margin);
    View {
        eye,
        view_from_world,
        projection: Projection::Orthographic,
        focus: margin + 0.5 * depth,
        focal_px: DVec2::splat(f64::from(side) / size),
        principal_px: DVec2::splat(0.5 * f64::from(side)),
        width: side,
        height: side,
    }
}

/// Corners of the part of the view's frustum within a range of depths.
fn visible_corners(view: &View, [near, far]: [f64; 2]) -> [DVec3; 8] {
    let (width, height) = (f64::from(view.width), f64::from(view.height));
    std::array::from_fn(|corner| {
        let pixel = DVec2::new(
            if corner & 1 == 0 { 0.0 } else { width },
            if corner & 2 == 0 { 0.0 } else { height },
        );
        let depth = if corner & 4 == 0 { near } else { far };
        view.view_from_world.transpose() * view.at_depth(view.ray(pixel), depth) + view.eye
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::math::Camera;

    fn sun(direction: DVec3) -> Light {
        Light::Sun {
            direction: direction.normalize_or(DVec3::NEG_Y),
            color: [1.0; 3],
            shadows: Some(0.5),
        }
    }

    fn camera(eye: DVec3, target: DVec3, fov_deg: f64) -> View {
        Camera::perspective(eye, target, fov_deg).view(640, 480).unwrap()
    }

    fn place() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0f64..1.0).prop_map(DVec3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]
        #[test]
        fn a_map_covers_all_that_is_visible(
            way in place(), eye in place(), target in place(), fov in 1.0f64..120.0,
            offset in prop::sample::select(vec![0.0, 5e6]), inside in place(),
        ) {
            prop_assume!(way.length() > 0.1 && eye.distance(target) > 0.1);
            let offset = DVec3::splat(offset);
            let bounds = Bounds { min: offset - 1.0, max: offset + 1.0 };
            let view = camera(3.0 * eye + offset, target + offset, fov);
            let maps = light_views(&[sun(way)], &bounds, &[view], 512);
            prop_assert!((1..=4).contains(&maps.len()));
            let pixels: u32 = maps.iter().map(|map| map.width * map.height).sum();
            prop_assert!(pixels <= 512 * 512);
            let world = inside + offset;
            let seen = view.project(view.to_view(world)).is_some_and(|pixel| {
                pixel.cmpge(DVec2::ZERO).all() && pixel.cmple(DVec2::new(640.0, 480.0)).all()
            });
            // The shaders take the map with the largest inset, up to their margin; of several, the finest.
            let mut most = f64::NEG_INFINITY;
            for map in &maps {
                let in_map = map.to_view(world);
                prop_assert!(-in_map.z > 0.0);
                let pixel = map.project(in_map).unwrap();
                let inset = pixel.min(DVec2::splat(f64::from(map.width)) - pixel).min_element();
                most = most.max(inset);
            }
            prop_assert!(!seen || most > -1e-3, "{world}");
        }
    }

    #[test]
    fn a_map_is_as_small_as_what_is_visible_and_stays_while_the_camera_moves_a_little() {
        let bounds = Bounds { min: DVec3::splat(-100.0), max: DVec3::splat(100.0) };
        let near = |x: f64| camera(DVec3::new(x, 0.0, 101.0), DVec3::new(x, 0.0, 0.0), 1.0);
        let lights = [sun(DVec3::NEG_Z), Light::Ambient { color: [1.0; 3] }];
        let wide =
            light_views(&lights, &bounds, &[camera(DVec3::Z * 500.0, DVec3::ZERO, 60.0)], 1024);
        let [first, second] =
            [0.3, 0.300_1].map(|x| light_views(&lights, &bounds, &[near(x)], 1024));
        assert_eq!(wide.len(), 1);
        assert!(first[0].focal_px.x > 20.0 * wide[0].focal_px.x);
        assert_eq!(first, second);
    }

    #[test]
    fn near_parts_of_a_deep_view_have_maps_of_their_own() {
        let bounds =
            Bounds { min: DVec3::new(-150.0, 0.0, -150.0), max: DVec3::new(150.0, 9.0, 150.0) };
        let within = camera(DVec3::new(0.0, 1.7, 0.0), DVec3::new(0.0, 1.6, -9.0), 50.0);
        let maps = light_views(&[sun(DVec3::new(-0.5, -1.0, -0.7))], &bounds, &[within], 2048);
        assert_eq!(maps.iter().map(|map| map.width).collect::<Vec<_>>(), [1024; 4]);
        assert!(maps.windows(2).all(|pair| pair[0].focal_px.x > 3.0 * pair[1].focal_px.x));
        // A step forward.
        let ahead = camera(DVec3::new(0.0, 1.7, -0.8), DVec3::new(0.0, 1.6, -9.8), 50.0);
        let next = light_views(&[sun(DVec3::new(-0.5, -1.0, -0.7))], &bounds, &[ahead], 2048);
        let stays: Vec<bool> = maps.iter().zip(&next).map(|(a, b)| a == b).collect();
        assert!(!stays[0] && stays[3], "{stays:?}");
        let suns = [sun(DVec3::NEG_Y), sun(DVec3::new(1.0, -1.0, 0.0)), sun(DVec3::NEG_X)];
        assert_eq!(light_views(&suns, &bounds, &[within], 2048).len(), 3);
        assert_eq!(light_views(&suns[..2], &bounds, &[within], 2048).len(), 4);
        let outside = camera(DVec3::new(0.0, 600.0, 0.1), DVec3::ZERO, 50.0);
        assert_eq!(light_views(&suns[..1], &bounds, &[outside], 2048).len(), 1);
    }

    /// Exposures from several places are drawn with the same maps.
    #[test]
    fn maps_cover_what_each_of_several_views_shows() {
        let bounds = Bounds { min: DVec3::splat(-100.0), max: DVec3::splat(100.0) };
        let view = |x: f64| camera(DVec3::new(x, 0.0, 30.0), DVec3::new(x, 0.0, 0.0), 20.0);
        let sun = [sun(DVec3::new(0.0, -1.0, -1.0))];
        let views = [view(0.0), view(40.0), view(-30.0)];
        let maps = light_views(&sun, &bounds, &views, 1024);
        let covers = |world: DVec3| {
            maps.iter().any(|map| {
                let pixel = map.project(map.to_view(world)).unwrap();
                let last = f64::from(map.width);
                pixel.cmpge(DVec2::ZERO).all() && pixel.cmple(DVec2::splat(last)).all()
            })
        };
        for view in views {
            for pixel in [[0.0, 0.0], [640.0, 0.0], [320.0, 240.0], [640.0, 480.0]] {
                for depth in [1.0, 30.0, 120.0] {
                    let place = view.at_depth(view.ray(pixel.into()), depth);
                    let world = view.view_from_world.transpose() * place + view.eye;
                    assert!(covers(world), "{world}");
                }
            }
        }
    }

    /// Every direction from a lamp lies in the map of the axis that it is nearest to, away from its border.
    #[test]
    fn maps_of_a_lamp_show_all_directions() {
        let bounds = Bounds { min: DVec3::splat(-9.0), max: DVec3::splat(9.0) };
        let position = DVec3::new(1.0, 2.0, -3.0);
        let lamp = Light::Point { position, color: [1.0; 3], range: 1.0, shadows: Some(0.0) };
        let eye = camera(DVec3::splat(9.0), DVec3::ZERO, 40.0);
        let lights = [lamp, sun(DVec3::NEG_Y), lamp];
        for side in [512, 2048] {
            let views = light_views(&lights, &bounds, &[eye], side);
            let maps = &views[views.len() - LAMP_MAPS..];
            assert!(views[0].is_orthographic() && maps[0].eye == position);
            let pixels: u32 = maps.iter().map(|map| map.width * map.height).sum();
            assert!(pixels <= side * side);
            for way in (0..2000).map(|i| {
                let z = 1.0 - (f64::from(i) + 0.5) / 1000.0;
                let (sine, cosine) = (2.4 * f64::from(i)).sin_cos();
                (DVec2::new(cosine, sine) * (1.0 - z * z).sqrt()).extend(z)
            }) {
                let axis = way.abs().max_position();
                let map = &maps[2 * axis + usize::from(way[axis] < 0.0)];
                assert!((map.view_from_world.determinant() - 1.0).abs() < 1e-12);
                let place = map.to_view(position + 5.0 * way);
                assert!((-place.z - 5.0 * way[axis].abs()).abs() < 1e-12);
                let pixel = map.project(place).unwrap();
                let margin = if side == 2048 { LAMP_MARGIN_PX } else { 25.5 };
                let last = f64::from(map.width) - margin + 1e-9;
                assert!(pixel.min_element() > margin - 1e-9 && pixel.max_element() < last);
            }
        }
    }

    /// Lamps leave suns fewer maps.
    #[test]
    fn suns_and_lamps_share_records() {
        let bounds =
            Bounds { min: DVec3::new(-150.0, 0.0, -150.0), max: DVec3::new(150.0, 9.0, 150.0) };
        let within = camera(DVec3::new(0.0, 1.7, 0.0), DVec3::new(0.0, 1.6, -9.0), 50.0);
        let lamp =
            Light::Point { position: DVec3::Y, color: [1.0; 3], range: 1.0, shadows: Some(0.0) };
        let count = |lights: &[Light]| light_views(lights, &bounds, &[within], 2048).len();
        assert_eq!(count(&[sun(DVec3::NEG_Y), lamp]), 3 + LAMP_MAPS);
        assert_eq!(count(&[sun(DVec3::NEG_Y), lamp, lamp, lamp]), 1 + 3 * LAMP_MAPS);
        assert_eq!(count(&[lamp; 4]), 4 * LAMP_MAPS);
    }

    #[test]
    fn a_scene_behind_the_eye_or_of_one_place_has_a_map() {
        let point = Bounds { min: DVec3::ONE, max: DVec3::ONE };
        let away = camera(DVec3::splat(9.0), DVec3::splat(10.0), 40.0);
        let views = light_views(&[sun(DVec3::new(0.0, -1.0, 0.2))], &point, &[away], 512);
        assert!(!views.is_empty());
        for view in views {
            assert!(view.focal_px.is_finite() && view.focal_px.x > 0.0 && view.eye.is_finite());
        }
    }
}
