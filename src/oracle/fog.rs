//! Fog between the eye and what it sees (Beer–Lambert).

use glam::DVec3;

use crate::math::View;
use crate::scene::{Fog, FogLayer};

/// The colour of a place in view space, linear, as it is seen through fog.
pub fn seen_through(fog: &Fog, view: &View, color: [f64; 3], place: DVec3) -> [f64; 3] {
    let start = if view.is_orthographic() { place.with_z(0.0) } else { DVec3::ZERO };
    let world_from_view = view.view_from_world.transpose();
    let [from, way] = [view.eye + world_from_view * start, world_from_view * (place - start)];
    mixed(fog, color, (-optical_depth(fog, from, way)).exp())
}

/// The background, which is infinitely far away along the ray of a pixel; its alpha stays.
pub fn background(fog: &Fog, view: &View, color: [f64; 4], ray: DVec3) -> [f64; 4] {
    let [r, g, b, alpha] = color;
    let way = (view.view_from_world.transpose() * view.towards(ray)).normalize_or_zero();
    let start = if view.is_orthographic() { ray.with_z(0.0) } else { DVec3::ZERO };
    let from = view.eye + view.view_from_world.transpose() * start;
    let depth = match fog.layer {
        Some(FogLayer { up, base, scale }) if up.dot(way) > 0.0 => {
            let density = fog.density * (-(up.dot(from) - base) / scale).exp();
            density * scale / up.dot(way)
        }
        _ => f64::INFINITY,
    };
    if alpha == 0.0 {
        return color;
    }
    let [r, g, b] = mixed(fog, [r, g, b], (-depth).exp());
    [r, g, b, alpha]
}

fn mixed(fog: &Fog, color: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|i| color[i] * share + f64::from(fog.color[i]) * (1.0 - share))
}

/// The integral of the density along a straight way in world space.
fn optical_depth(fog: &Fog, from: DVec3, way: DVec3) -> f64 {
    let Some(FogLayer { up, base, scale }) = fog.layer else { return fog.density * way.length() };
    let height = (up.dot(from) - base) / scale;
    let rise = up.dot(way) / scale;
    // ∫ exp(-(height + s·rise)) ds for s from 0 to 1, counted from the denser end so that nothing overflows.
    let densest = (-(height + rise.min(0.0))).exp();
    let mean = if rise == 0.0 { 1.0 } else { -(-rise.abs()).exp_m1() / rise.abs() };
    fog.density * way.length() * densest * mean
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn optical_depths_are_the_integrals_of_the_density() {
        let up = DVec3::new(0.6, 0.0, 0.8);
        let layer = FogLayer { up, base: 3.0, scale: 2.5 };
        let fog = Fog { color: [0.0; 3], density: 0.7, layer: Some(layer) };
        let from = DVec3::new(1.0, -4.0, 7.0);
        for way in [
            DVec3::new(5.0, 1.0, 2.0),
            DVec3::new(0.8, 3.0, -0.6),
            DVec3::new(0.8, 3.0, -0.6) + up * 1e-9,
            DVec3::new(-3.0, 2.0, -9.0),
            DVec3::ZERO,
        ] {
            let density = |place: DVec3| 0.7 * (-(up.dot(place) - 3.0) / 2.5).exp();
            let steps = 20_000;
            let middle = |i: i32| from + way * ((f64::from(i) + 0.5) / f64::from(steps));
            let sum: f64 = (0..steps).map(|i| density(middle(i))).sum();
            let expected = sum / f64::from(steps) * way.length();
            let found = optical_depth(&fog, from, way);
            assert!((found - expected).abs() <= 1e-7 * expected, "{way}: {found}, {expected}");
        }
        let even = Fog { layer: None, ..fog };
        assert_eq!(optical_depth(&even, from, DVec3::new(3.0, 0.0, 4.0)), 3.5);
        // Far above the fog, and far below its base.
        let far = optical_depth(&fog, from + up * 1e6, -up * 1e6);
        let near = 0.7 * 2.5 * (-(up.dot(from) - 3.0) / 2.5).exp();
        assert!((far - near).abs() < 1e-6 * near, "{far}, {near}");
    }
}
