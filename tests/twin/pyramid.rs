//! Compares the levels of pull-push with the oracle's, one by one.
//!
//! The oracle makes each level from the renderer's own levels before it, so that differences do not add up from level to level. What remains is
//! the rounding of what a level stores, and of 32-bit arithmetic. Where the two lie on different sides of a threshold, such as an outline, a
//! patch is another one; few pixels of a level may be so.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::{DMat2, DVec2, DVec3};
use half::f16;
use pointillist::encode::ImageFormat;
use pointillist::engine::{Engine, EngineConfig, FrameRequest, LevelsHook, Pose};
use pointillist::math::View;
use pointillist::oracle::{self, Level, Patch, Pyramid};
use pointillist::passes::Levels;
use pointillist::plan::{Output, Settings};
use pointillist::scene::PullPushWeights;
use serde_json::json;

use super::orthographic;
use super::pull_push::{oracle_scene, pull_push};
use super::splats::ball;
use super::stage::{Case, folder, look};

/// Largest relative error of a number that is rounded to half precision.
const HALF: f64 = 1.0 / 2048.0;

/// Largest error of a colour's square root, which has 10 bits.
const ROOT: f64 = 0.5 / 1023.0;

/// How far patches of one pixel may be apart beside the rounding of what a level stores.
struct Slack {
    /// Centres, in pixels of the level.
    place: f64,
    /// Radii, variances and slopes, as shares.
    shape: f64,
    /// Values, as shares: 1/z, or z where rays are parallel.
    value: f64,
    /// Channels of linear colours, and normals.
    look: f64,
    /// Share of a level's patches that may be apart farther.
    others: f64,
}

/// Samples themselves are packed: lengths of kernels have steps of 0.5 %, and their angles steps of 0.004.
const PACKED: Slack = Slack { place: 0.02, shape: 0.02, value: 2e-4, look: 2e-3, others: 0.03 };

/// Squared distances in ellipses up to fifty times as long as wide have errors of about a thousandth in 32 bits. So have the weights that follow
/// from them.
const STEP: Slack = Slack { place: 2e-3, shape: 4e-3, value: 2e-4, look: 4e-3, others: 0.01 };

/// The size of a level's pixels, in pixels of the image.
fn pixel_size(number: usize) -> f64 {
    (1u64 << number) as f64
}

fn centre_px(x: isize, y: isize, number: usize) -> DVec2 {
    (DVec2::new(x as f64, y as f64) + 0.5) * pixel_size(number)
}

/// The two numbers of a word in half precision.
fn halves(word: u32) -> DVec2 {
    let half = |bits: u32| f16::from_bits(bits as u16).to_f64();
    DVec2::new(half(word), half(word >> 16))
}

/// The unit vector of a word of `shared/octahedral`; zero for what has no normal.
fn normal(word: u32) -> DVec3 {
    if word == 0x8000_8000 || word == 0x8000_0000 {
        return DVec3::ZERO;
    }
    let number = |bits: u32| (f64::from(bits as u16 as i16) / 32767.0).max(-1.0);
    let [x, y] = [number(word), number(word >> 16)];
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    DVec3::new(x - fold * x.signum(), y - fold * y.signum(), z).normalize_or_zero()
}

/// The levels of one view whose four buffers lie one behind the other, as `shared/patches` stores them.
fn decoded(words: &[u32], view: &View) -> Vec<Level> {
    let levels = Levels::of((view.width, view.height));
    let total = levels.pixels() as usize;
    let level = |number: usize| {
        let (width, height) = levels.size(number);
        let patch = |x: isize, y: isize| {
            let column = (x + 1) as usize;
            let row = (y + 1) as usize;
            let index = levels.first(number) as usize + row * (width as usize + 2) + column;
            let pair = |buffer: usize| {
                let at = 2 * (buffer * total + index);
                [words[at], words[at + 1]]
            };
            let [[word, head], shape, rest, look] = [0, 1, 2, 3].map(pair);
            let lower = halves(shape[1]);
            let last = halves(rest[0]);
            let (xy, yy) = (lower.x * lower.y, lower.y * lower.y + last.x * last.x);
            let root = |bits: u32| f64::from(bits & 1023) / 1023.0;
            (word != 0).then(|| Patch {
                facing: [0, 1, -1, 0][head as usize & 3],
                value: f64::from(f32::from_bits(head & !3)),
                at_px: centre_px(x, y, number) + halves(shape[0]),
                spread: DMat2::from_cols(DVec2::new(lower.x * lower.x, xy), DVec2::new(xy, yy)),
                radius_px: last.y,
                slope: halves(rest[1]) / view.focal_px,
                color: [0, 10, 20].map(|shift| root(look[0] >> shift).powi(2)),
                normal_world: normal(look[1]),
                ..Patch::default()
            })
        };
        Level::of((width as usize, height as usize), patch)
    };
    (0..levels.count()).map(level).collect()
}

/// The first number that is too far from the oracle's, by name.
fn apart(
    [found, expected]: [&Patch; 2],
    centre_px: DVec2,
    size_px: f64,
    focal_px: DVec2,
    slack: &Slack,
) -> Option<&'static str> {
    let most = |v: DVec2| v.abs().max_element();
    let place = HALF * most(expected.at_px - centre_px) + slack.place * size_px;
    let widest = expected.spread.x_axis.x + expected.spread.y_axis.y;
    let spread = found.spread - expected.spread;
    let shape = slack.shape * (widest + size_px * size_px) + 2.0 * HALF * widest;
    let slope = most(expected.slope * focal_px);
    let looks_apart = |channel: usize| {
        let (own, other) = (found.color[channel], expected.color[channel]);
        (own - other).abs() > 2.0 * ROOT * (other.sqrt() + ROOT) + slack.look
    };
    let checks = [
        ("facing", found.facing != expected.facing),
        ("value", (found.value / expected.value - 1.0).abs() > slack.value),
        ("place", most(found.at_px - expected.at_px) > place),
        ("spread", most(spread.x_axis).max(most(spread.y_axis)) > shape),
        ("radius", (found.radius_px / expected.radius_px - 1.0).abs() > HALF + slack.shape),
        (
            "slope",
            most((found.slope - expected.slope) * focal_px) > (HALF + slack.shape) * (1.0 + slope),
        ),
        ("colour", (0..3).any(looks_apart)),
        // The octahedral map has steps of less than 1e-4.
        ("normal", (found.normal_world - expected.normal_world).length() > 1e-4 + slack.look),
    ];
    checks.iter().find(|(_, is_apart)| *is_apart).map(|(name, _)| *name)
}

/// Compares all pixels of a level, its rim included.
fn compare(name: &str, levels: [&Level; 2], number: usize, view: &View, slack: &Slack) {
    let [found, expected] = levels;
    assert_eq!((found.width, found.height), (expected.width, expected.height), "{name}");
    let (mut shown, mut others) = (0u32, Vec::new());
    for (x, y) in
        (-1..=found.height as isize).flat_map(|y| (-1..=found.width as isize).map(move |x| (x, y)))
    {
        let why = match (found.at(x, y), expected.at(x, y)) {
            (None, None) => continue,
            (Some(found), Some(expected)) => {
                let centre = centre_px(x, y, number);
                apart([&found, &expected], centre, pixel_size(number), view.focal_px, slack)
            }
            (Some(_), None) => Some("only found"),
            (None, Some(_)) => Some("only expected"),
        };
        shown += 1;
        others.extend(why.map(|why| (x, y, why)));
    }
    println!("{name}: {} of {shown} patches are others", others.len());
    // The smallest levels may have one.
    let most = (slack.others * f64::from(shown)).max(1.0);
    let few = &others[..others.len().min(20)];
    // The disks of samples are too small for the coarsest levels.
    assert!(shown > 0 || number > 3, "{name}: nothing is drawn");
    assert!(others.len() as f64 <= most, "{name}: of {shown} patches {few:?}");
}

/// An engine that keeps the words of the levels of its last frame.
struct Keeper {
    engine: Engine,
    words: Arc<Mutex<Vec<u32>>>,
}

impl Keeper {
    fn new() -> Keeper {
        let words = Arc::new(Mutex::new(Vec::new()));
        let sink = words.clone();
        let hook: LevelsHook = Arc::new(move |found: &[u32]| {
            *sink.lock().unwrap() = found.to_vec();
        });
        let config = EngineConfig {
            levels_hook: Some(hook),
            queue_time: Duration::from_secs(3600),
            ..EngineConfig::new(folder())
        };
        Keeper { engine: Engine::start(config).unwrap(), words }
    }

    fn pyramid(&self, case: &Case, view: &View, settings: Settings) -> Pyramid {
        let request = FrameRequest {
            scene: case.id.clone(),
            pose: Pose::View(*view),
            width: view.width,
            height: view.height,
            settings,
            output: Output::Color,
            format: ImageFormat::Raw,
            quality: 85,
            deadline: None,
        };
        self.engine.submit(request).unwrap().wait().unwrap();
        let words = std::mem::take(&mut *self.words.lock().unwrap());
        assert!(!words.is_empty(), "the frame was drawn in another way");
        let (pulled, pushed) = words.split_at(words.len() / 2);
        let mut pushed = decoded(pushed, view);
        // The image is completed where it is lit.
        pushed.remove(0);
        Pyramid { pulled: decoded(pulled, view), pushed }
    }
}

/// A ball before a larger one: outlines, backs that gaps let through, and samples beyond all borders.
#[test]
fn every_level_is_the_oracles() {
    let scene = json!({
        "assets": { "c": { "file": "c.ply" } },
        "nodes": [
            { "asset": "c", "scale": 3, "translate": [0, 0, -4.5] },
            { "asset": "c", "scale": 0.4, "translate": [0.2, 0.1, -0.6] }
        ],
        "lights": [{ "kind": "headlight" }]
    });
    let case = Case::new("pulled-levels", &[("c.ply", ball(2500, 41).ply())], &scene);
    let keeper = Keeper::new();
    keeper.engine.load(&case.id, &folder().join("pulled-levels/scene.json")).unwrap();
    let even = look([0.1, 0.0, 1.0], [0.0; 3], 60.0);
    let odd = View { width: 131, height: 97, ..even };
    let parallel = orthographic::look([0.1, 0.0, 1.0], [0.0; 3], 2.4);
    for (name, view, pull_push_weights) in [
        ("even", even, PullPushWeights::Gaussian),
        ("odd", odd, PullPushWeights::Gaussian),
        ("box", even, PullPushWeights::Box),
        ("parallel", parallel, PullPushWeights::Gaussian),
    ] {
        let settings = Settings { pull_push_weights, ..pull_push() };
        let found = keeper.pyramid(&case, &view, settings);
        let expected = oracle::pyramid(&oracle_scene(&case, &settings), &view, Some(&found));
        let expected = expected.unwrap();
        assert_eq!(found.pulled.len(), expected.pulled.len(), "{name}");
        for (number, levels) in found.pulled.iter().zip(&expected.pulled).enumerate() {
            let slack = if number == 0 { &PACKED } else { &STEP };
            let name = format!("{name}, pulled {number}");
            compare(&name, [levels.0, levels.1], number, &view, slack);
        }
        for (number, levels) in (1..).zip(found.pushed.iter().zip(&expected.pushed)) {
            let name = format!("{name}, pushed {number}");
            compare(&name, [levels.0, levels.1], number, &view, &STEP);
        }
    }
}
