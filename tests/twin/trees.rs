//! Compares frames of point trees with the oracle at full detail: their outlines are within the promised error of the outlines of
//! all samples, drawn in f64.

use glam::DVec3;
use pointillist::accuracy::metrics::{covered_by_id, farthest_px, psnr};
use pointillist::bake::tree::SIDEWAYS;
use pointillist::math::{Camera, View};
use pointillist::plan::{ErrorMode, Lod, MaxError, Reconstruct, Settings};
use pointillist::scene::random::SplitMix64;

use super::splats::{ball, case, oracle};
use super::stage::Case;
use serde_json::json;

/// Allowance for the pixel grid and for the filter and outlines of splats, on either side.
const PIXEL_PX: f64 = 1.5;

/// Poses all around `centre`, at distances from `near` to `far`.
fn poses(centre: DVec3, [near, far]: [f64; 2], count: usize) -> Vec<View> {
    let mut random = SplitMix64::new(41);
    (0..count)
        .map(|_| {
            let mut side = |low, high| random.range(low, high);
            let direction = DVec3::new(side(-1.0, 1.0), side(-0.2, 1.0), side(-1.0, 1.0));
            let distance = near * (far / near).powf(side(0.0, 1.0));
            let eye = centre + direction.normalize_or(DVec3::Z) * distance;
            let camera = Camera::perspective(eye, centre, 40.0);
            camera.view(200, 160).unwrap()
        })
        .collect()
}

pub fn check(case: &Case, views: &[View], reconstruct: Reconstruct, least_db: f64) {
    let full = Settings { reconstruct: Reconstruct::Splats, ..Settings::default() };
    for (number, view) in views.iter().enumerate() {
        let twin = oracle(case, view, full);
        let whole = covered_by_id(&twin.id);
        let modes = [ErrorMode::Unified, ErrorMode::Split];
        for (px, error_mode) in
            [0.5, 1.0, 3.0].into_iter().flat_map(|px| modes.map(|mode| (px, mode)))
        {
            let max_error = MaxError::new(px).unwrap();
            let settings = Settings {
                lod: Lod::Spt,
                max_error_px: max_error,
                error_mode,
                reconstruct,
                ..full
            };
            let [frames, ..] = case.each_with(view, settings);
            let found = covered_by_id(&frames.id);
            let distance = |a, b| farthest_px(a, b, view.width, view.height).unwrap();
            let (beyond, short) = (distance(&found, &whole), distance(&whole, &found));
            let db = psnr(&twin.to_rgba8(), &frames.color).unwrap();
            println!(
                "{} {number}, {px} px, {error_mode:?}: {beyond:.2} beyond, {short:.2} short, {db:.1} dB",
                case.id
            );
            // The bound at the end of a surface, which may be seen at an angle.
            let sideways = if error_mode == ErrorMode::Split { 1.0 / SIDEWAYS } else { 1.0 };
            let limit = f64::from(px * sideways) + PIXEL_PX;
            let fits = beyond <= limit && short <= limit;
            assert!(fits, "{} {number}, {px} px: {beyond} beyond, {short} short", case.id);
            // Twice the accepted error may cost 6 dB.
            let least_db = least_db - 6.0 * f64::from(px / 0.5).log2();
            assert!(db >= least_db, "{} {number}, {px} px: {db} dB", case.id);
        }
    }
}

#[test]
fn outlines_are_as_near_to_the_oracles_as_promised() {
    let town = Case::committed("town");
    let centre = DVec3::new(412_000.0, 5_653_000.0, 116.0);
    check(&town, &poses(centre, [40.0, 400.0], 6), Reconstruct::Splats, 32.0);
    let part = Case::committed("part");
    check(&part, &poses(DVec3::ZERO, [2.5, 40.0], 6), Reconstruct::Splats, 42.0);
    let ball = case("trees-ball", &ball(6000, 5), json!({}));
    check(&ball, &poses(DVec3::ZERO, [1.5, 30.0], 6), Reconstruct::Splats, 42.0);
}
