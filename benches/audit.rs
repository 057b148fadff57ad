//! Measures what frames promise, from poses chosen at random: do surfaces stay closed, do outlines stay within the accepted error, are
//! depths and colours near those of full detail, and do frames flicker while the camera moves?
//!
//! The truth is full detail at four times the width and height, averaged in linear light. Splats and points are compared with the same
//! truth: splats, or triangles where the model is a mesh. Full detail at the frame's own size shows what a setting has to be compared
//! with: a frame of one sample a pixel flickers and has an outline that is half a pixel off, whatever it draws.
//!
//! The quality of `lod=spt` is that of point trees, which draw every such frame here. Times are those of the program, which draws full
//! detail where that is faster. A flight crosses the distance where it begins to.
//!
//! `AUDIT_POSES=n` takes another number of poses a model.

mod common;

use std::path::PathBuf;

use anyhow::Context;
use common::drawing::{Drawing, Orbit, gpu_ms};
use common::files;
use common::report::{Bound, Report, number};
use common::{median, pick, quantile};
use glam::{DQuat, DVec3};
use pointillist::accuracy::metrics;
use pointillist::accuracy::temporal::Change;
use pointillist::encode::ImageFormat;
use pointillist::engine::{EncodedFrame, FrameRequest, Pose};
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::plan::{ColorBy, Lod, MaxError, Output, Reconstruct, Settings};
use pointillist::scene::color::{linear_from_srgb, srgb_from_linear};
use pointillist::scene::random::SplitMix64;

/// Width and height of frames, and how many of the truth's pixels lie along one of theirs.
const SIDE: usize = 192;
const FINE: usize = 4;
/// Frames that the time of a setting is the least of.
const ROUNDS: usize = 4;
/// Distances of the camera, in units of the whole view's.
const NEAREST: f64 = 0.35;
const FARTHEST: f64 = 10.0;
/// Pixels by which the image moves between two frames of a flight.
const STEP_PX: f64 = 0.1;
/// Least flicker energy of full detail that others are compared with: a change of one byte between two frames.
const LEAST_ENERGY: f64 = 1.0 / (3 * SIDE * SIDE) as f64;
/// Distance in pixels that outlines may be off beside the accepted error: each frame has one sample a pixel.
const OUTLINE_SLACK_PX: f64 = 1.5;

const MODELS: [(&str, Kind, u64); 5] = [
    ("statue", Kind::Statue, 300_000),
    ("relief", Kind::Relief, 600_000),
    ("tree", Kind::Tree, 400_000),
    ("town", Kind::Town, 300_000),
    ("checkerboard", Kind::Checkerboard, 250_000),
];

/// How samples are drawn, and the accepted error; `None` for full detail.
#[derive(Clone, Copy)]
struct Setting {
    name: &'static str,
    reconstruct: Reconstruct,
    error_px: Option<f32>,
}

const fn setting(name: &'static str, reconstruct: Reconstruct, error_px: Option<f32>) -> Setting {
    Setting { name, reconstruct, error_px }
}

const SETTINGS: [Setting; 8] = [
    setting("points, full", Reconstruct::Points, None),
    setting("points, 1 px", Reconstruct::Points, Some(1.0)),
    setting("points, 2 px", Reconstruct::Points, Some(2.0)),
    setting("points, 4 px", Reconstruct::Points, Some(4.0)),
    setting("splats, full", Reconstruct::Splats, None),
    setting("splats, 1 px", Reconstruct::Splats, Some(1.0)),
    setting("splats, 2 px", Reconstruct::Splats, Some(2.0)),
    setting("splats, 4 px", Reconstruct::Splats, Some(4.0)),
];

impl Setting {
    fn settings(self) -> Settings {
        Settings {
            reconstruct: self.reconstruct,
            lod: if self.error_px.is_some() { Lod::Spt } else { Lod::Full },
            max_error_px: MaxError::new(self.error_px.unwrap_or(1.0)).unwrap_or_default(),
            ..Settings::default()
        }
    }
}

const TRUTH: Setting = setting("truth", Reconstruct::Splats, None);

/// A frame's sRGB bytes and depths.
struct Image {
    color: Vec<[u8; 4]>,
    depth: Vec<f32>,
    receipt: pointillist::engine::Receipt,
}

fn submit(
    drawing: &Drawing,
    camera: Camera,
    side: usize,
    settings: Settings,
    output: Output,
) -> anyhow::Result<std::sync::Arc<EncodedFrame>> {
    let request = FrameRequest {
        scene: drawing.info.id.clone(),
        pose: Pose::Camera(camera),
        width: side as u32,
        height: side as u32,
        settings,
        output,
        format: ImageFormat::Raw,
        quality: 85,
        deadline: None,
    };
    Ok(drawing.engine.submit(request)?.wait()?)
}

fn color(
    drawing: &Drawing,
    camera: Camera,
    side: usize,
    of: Setting,
) -> anyhow::Result<Vec<[u8; 4]>> {
    let frame = submit(drawing, camera, side, of.settings(), Output::Color)?;
    Ok(bytemuck::pod_collect_to_vec(&frame.bytes))
}

fn image(drawing: &Drawing, camera: Camera, side: usize, of: Setting) -> anyhow::Result<Image> {
    let frame = submit(drawing, camera, side, of.settings(), Output::Color)?;
    let depths = submit(drawing, camera, side, of.settings(), Output::Depth)?;
    Ok(Image {
        color: bytemuck::pod_collect_to_vec(&frame.bytes),
        depth: bytemuck::pod_collect_to_vec(&depths.bytes),
        receipt: frame.receipt.clone(),
    })
}

/// The truth as seen through the pixels of a frame.
struct Truth {
    color: Vec<[u8; 4]>,
    /// The truth's pixels that show a surface.
    fine: Vec<bool>,
    /// All of the pixel shows a surface.
    all: Vec<bool>,
    /// Least and largest depth where all of the pixel shows a surface.
    depths: Vec<[f32; 2]>,
}

/// Linear light of each byte.
fn table() -> [f32; 256] {
    std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0) as f32)
}

/// Averages squares of `FINE` pixels in linear light.
fn averaged(fine: &[[u8; 4]]) -> Vec<[u8; 4]> {
    let linear = table();
    let mean = |pixel: usize, channel: usize| {
        let sum: f32 = under(pixel).map(|i| linear[usize::from(fine[i][channel])]).sum();
        let light = f64::from(sum) / (FINE * FINE) as f64;
        (255.0 * srgb_from_linear(light)).round() as u8
    };
    (0..SIDE * SIDE).map(|i| [mean(i, 0), mean(i, 1), mean(i, 2), 255]).collect()
}

/// The truth's pixels under a pixel.
fn under(pixel: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (pixel % SIDE * FINE, pixel / SIDE * FINE);
    (0..FINE * FINE).map(move |i| (y + i / FINE) * SIDE * FINE + x + i % FINE)
}

fn truth(drawing: &Drawing, camera: Camera) -> anyhow::Result<Truth> {
    let fine = image(drawing, camera, SIDE * FINE, TRUTH)?;
    let (mut all, mut depths) = (Vec::new(), Vec::new());
    for pixel in 0..SIDE * SIDE {
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY];
        let mut covered = 0;
        for depth in under(pixel).map(|i| fine.depth[i]).filter(|depth| depth.is_finite()) {
            ends = [ends[0].min(depth), ends[1].max(depth)];
            covered += 1;
        }
        all.push(covered == FINE * FINE);
        depths.push(ends);
    }
    let shown = metrics::covered_by_depth(&fine.depth);
    Ok(Truth { color: averaged(&fine.color), fine: shown, all, depths })
}

/// Cameras that look at places near a model's middle, from close up to far away.
fn poses(orbit: &Orbit, seed: u64, count: usize) -> Vec<Camera> {
    let mut numbers = SplitMix64::new(seed);
    let reach = (orbit.eye - orbit.target).length();
    (0..count)
        .map(|_| {
            let turn = numbers.range(0.0, std::f64::consts::TAU);
            let rise = numbers.range(-0.3, 0.95);
            let level = (1.0 - rise * rise).sqrt();
            let way = DVec3::new(level * turn.cos(), rise, level * turn.sin());
            let distance = reach * numbers.range(NEAREST.ln(), FARTHEST.ln()).exp();
            let beside = DVec3::from_array(std::array::from_fn(|_| numbers.range(-0.1, 0.1)));
            let target = orbit.target + reach * beside;
            Camera::perspective(target + distance * way, target, orbit.fov_deg)
        })
        .collect()
}

/// Measurements of a setting over all poses.
#[derive(Default)]
struct Found {
    /// See [`beyond_px`]; less the accepted error.
    beyond: Vec<f64>,
    holes: u64,
    inside: u64,
    depth: Vec<f64>,
    psnr: Vec<f64>,
    /// Time over that of full detail at the same pose.
    time: Vec<f64>,
    tested: u64,
    accepted: u64,
    /// Flicker over that of full detail, by flight, and pops.
    flicker: Vec<f64>,
    pops: u64,
    /// Frames that the program draws at full detail.
    full: u64,
    /// Pops of flights across the distance where it begins to, and those of full detail there.
    crossing: [u64; 2],
}

impl Found {
    /// `full`: the frame at full detail.
    fn add(
        &mut self,
        setting: Setting,
        frame: &Image,
        full: &[f32],
        truth: &Truth,
    ) -> anyhow::Result<()> {
        let error = f64::from(setting.error_px.unwrap_or(0.0));
        let covered = metrics::covered_by_depth(&frame.depth);
        let side = SIDE as u32;
        self.beyond.push(beyond_px(&covered, &truth.fine)? - error);
        // An outline may be off by the accepted error to either side.
        let inside = metrics::shrunk(&truth.all, side, side, error.ceil() as u32 + 1)?;
        for pixel in (0..inside.len()).filter(|&pixel| inside[pixel]) {
            self.inside += 1;
            // Between the leaves of a tree there are gaps that the truth's pixels, which lie beside this one's middle, do not meet.
            let is_gap = setting.error_px.is_some() && full[pixel].is_infinite();
            self.holes += u64::from(!covered[pixel] && !is_gap);
        }
        let depths = frame.depth.iter().zip(&truth.depths).zip(&inside);
        let off: Vec<f64> = depths
            .filter(|((depth, _), inside)| **inside && depth.is_finite())
            .map(|((depth, [near, far]), _)| {
                f64::from((near - depth).max(depth - far).max(0.0) / depth)
            })
            .collect();
        if !off.is_empty() {
            self.depth.push(quantile(&off, 0.99));
        }
        let psnr = metrics::psnr(&truth.color, &frame.color)?;
        if psnr.is_finite() {
            self.psnr.push(psnr);
        }
        let samples = &frame.receipt.samples;
        if let (Some(tested), Some(accepted)) = (samples.tested, samples.accepted) {
            self.tested += tested;
            self.accepted += accepted;
        }
        Ok(())
    }
}

/// Largest distance, in pixels, of the middle of a covered pixel from what the truth shows.
fn beyond_px(covered: &[bool], fine: &[bool]) -> anyhow::Result<f64> {
    let side = SIDE * FINE;
    let mut middles = vec![false; side * side];
    for pixel in (0..covered.len()).filter(|&pixel| covered[pixel]) {
        let (x, y) = (pixel % SIDE * FINE + FINE / 2, pixel / SIDE * FINE + FINE / 2);
        middles[y * side + x] = true;
    }
    Ok(metrics::farthest_px(&middles, fine, side as u32, side as u32)? / FINE as f64)
}

/// A camera that looks at the middle of the model from a distance, in units of the whole view's, and a side.
fn facing(orbit: &Orbit, turn: f64, distance: f64) -> Camera {
    let reach = (orbit.eye - orbit.target).length();
    let rise = DVec3::new(0.3, 0.25, 0.9).normalize_or(DVec3::Z);
    Camera::perspective(
        orbit.target + DQuat::from_rotation_y(turn) * rise * reach * distance,
        orbit.target,
        orbit.fov_deg,
    )
}

/// A slow flight towards the model, or around it, from a distance: cameras so near each other that the image moves by `STEP_PX`.
fn flight(orbit: &Orbit, around: bool, frames: usize, start: f64) -> Vec<Camera> {
    let focal_px = 0.5 * SIDE as f64 / (0.5 * orbit.fov_deg).to_radians().tan();
    // A surface halfway between the middle and the border of the image moves so many pixels for each radian, or for each doubling.
    let step = STEP_PX / (0.25 * SIDE as f64);
    let turn_step = STEP_PX / (0.5 * focal_px * (0.5 * orbit.fov_deg).to_radians().sin());
    (0..frames)
        .map(|frame| match around {
            true => facing(orbit, turn_step * frame as f64, start),
            false => facing(orbit, 0.0, start * (1.0 - step).powi(frame as i32)),
        })
        .collect()
}

fn is_full(drawing: &Drawing, camera: Camera, setting: Setting) -> anyhow::Result<bool> {
    let frame = submit(drawing, camera, SIDE, setting.settings(), Output::Color)?;
    Ok(frame.receipt.settings.full_because.is_some())
}

/// The distance from which on a setting is drawn from point trees, in units of the whole view's; `None` where all or none are.
fn crossing(drawing: &Drawing, orbit: &Orbit, setting: Setting) -> anyhow::Result<Option<f64>> {
    let full_at = |distance: f64| is_full(drawing, facing(orbit, 0.0, distance), setting);
    let (mut near, mut far) = (NEAREST, FARTHEST);
    if !full_at(near)? || full_at(far)? {
        return Ok(None);
    }
    while far / near > 1.0 + 1e-4 {
        let middle = (near * far).sqrt();
        if full_at(middle)? {
            near = middle;
        } else {
            far = middle;
        }
    }
    Ok(Some(far))
}

/// Flicker energy, summed over the frames, and the number of pops, of each of the settings.
fn fly(
    drawing: &Drawing,
    cameras: &[Camera],
    settings: &[Setting],
) -> anyhow::Result<Vec<(f64, u64)>> {
    let mut found = vec![(0.0, 0); settings.len()];
    let mut before: Option<Vec<Vec<[u8; 4]>>> = None;
    for &camera in cameras {
        let mut now = vec![averaged(&color(drawing, camera, SIDE * FINE, TRUTH)?)];
        for &setting in settings {
            now.push(color(drawing, camera, SIDE, setting)?);
        }
        if let Some(before) = &before {
            for (index, (energy, pops)) in found.iter_mut().enumerate() {
                let frames: [&[[u8; 4]]; 2] = [&before[index + 1], &now[index + 1]];
                let change = Change::between(frames, [&before[0], &now[0]], [SIDE as u32; 2])?;
                *energy += change.energy;
                *pops += change.pops;
            }
        }
        before = Some(now);
    }
    Ok(found)
}

/// Full detail of what a setting draws.
fn full_of(setting: usize) -> usize {
    setting / 4 * 4
}

fn file(name: &str, kind: Kind, count: u64) -> anyhow::Result<PathBuf> {
    let count = pick(count, count / 10);
    let parameters = Parameters { seed: 7, ..Parameters::of_size(kind, count) };
    files::generated(&format!("audit-{name}-{count}.ply"), kind, &parameters)
}

fn main() -> anyhow::Result<()> {
    let given = std::env::var("AUDIT_POSES").ok().and_then(|n| n.parse().ok());
    let (poses_each, frames): (usize, _) = (given.unwrap_or(pick(30, 3)), pick(48, 4));
    let mut report: Option<Report> = None;
    let mut rows = Vec::new();
    let mut totals: Vec<Found> = SETTINGS.iter().map(|_| Found::default()).collect();
    for (number_of_model, (name, kind, count)) in MODELS.into_iter().enumerate() {
        let file = file(name, kind, count)?;
        let program = Drawing::open(&file, SIDE as u32, |_| ())?;
        let drawing = Drawing::open(&file, SIDE as u32, |config| config.may_draw_in_full = false)?;
        let _ = report.get_or_insert_with(|| Report::new("audit", &drawing.engine.adapter()));
        let orbit = Orbit::around(&drawing.info)?;
        for setting in SETTINGS {
            drawing.bake(setting.settings())?;
            program.bake(Settings { color_by: ColorBy::Levels, ..setting.settings() })?;
        }
        let mut found: Vec<Found> = SETTINGS.iter().map(|_| Found::default()).collect();
        for camera in poses(&orbit, number_of_model as u64, poses_each) {
            let truth = truth(&drawing, camera)?;
            let mut frames = Vec::new();
            for (index, setting) in SETTINGS.into_iter().enumerate() {
                frames.push(image(&drawing, camera, SIDE, setting)?);
                let full = &frames[full_of(index)].depth;
                found[index].add(setting, &frames[index], full, &truth)?;
            }
            // The least of some rounds, in each of which all settings take turns.
            let mut times = [f64::INFINITY; SETTINGS.len()];
            for _ in 0..ROUNDS {
                for (least, setting) in times.iter_mut().zip(SETTINGS) {
                    let frame = submit(&program, camera, SIDE, setting.settings(), Output::Color)?;
                    *least = least.min(gpu_ms(&frame.receipt)?);
                }
            }
            for (index, found) in found.iter_mut().enumerate() {
                found.time.push(times[index] / times[full_of(index)]);
                found.full += u64::from(is_full(&program, camera, SETTINGS[index])?);
            }
        }
        for around in [false, true] {
            let flown = fly(&drawing, &flight(&orbit, around, frames, 2.0), &SETTINGS)?;
            for (index, (energy, pops)) in flown.iter().enumerate() {
                found[index].flicker.push(energy / flown[full_of(index)].0.max(LEAST_ENERGY));
                found[index].pops += pops;
            }
        }
        for (index, setting) in SETTINGS.into_iter().enumerate() {
            if let Some(distance) = crossing(&program, &orbit, setting)? {
                let cameras = flight(&orbit, false, frames / 4, distance * 1.005);
                let flown = fly(&program, &cameras, &[setting, SETTINGS[full_of(index)]])?;
                found[index].crossing = [flown[0].1, flown[1].1];
            }
        }
        for ((setting, found), total) in SETTINGS.iter().zip(found).zip(&mut totals) {
            rows.push(row(name, setting.name, &found));
            total.merge(found);
        }
    }
    let mut report = report.context("no models")?;
    let header = [
        "model",
        "setting",
        "outline, px",
        "holes",
        "of pixels",
        "depth, p99",
        "PSNR",
        "worst",
        "time",
        "worst",
        "nodes",
        "rejected, %",
        "flicker",
        "worst",
        "pops",
        "full, %",
        "crossing",
    ];
    for (setting, total) in SETTINGS.iter().zip(&totals) {
        rows.push(row("all", setting.name, total));
    }
    report.table(
        &format!(
            "{poses_each} poses of each model at {SIDE}², and flights of {frames} frames; outlines less the accepted error, times and flicker over \
             full detail's"
        ),
        &header,
        &rows,
    );
    let mut kept = true;
    for (setting, total) in SETTINGS.iter().zip(&totals).filter(|(s, _)| s.error_px.is_some()) {
        let outline = total.beyond.iter().copied().fold(0.0, f64::max);
        let (frames, flights) = (total.beyond.len(), total.flicker.len());
        let what =
            format!("outline of {} beyond the accepted error, of {frames} frames", setting.name);
        report.target(&what, Some(outline), Bound::AtMost(OUTLINE_SLACK_PX), "px");
        kept &= outline <= OUTLINE_SLACK_PX;
        let flicker = quantile(&total.flicker, 1.0);
        let bound = if setting.error_px == Some(1.0) { 1.2 } else { 1.5 };
        report.target(
            &format!("flicker of {}, of {flights} flights", setting.name),
            Some(flicker),
            Bound::AtMost(bound),
            "×",
        );
        let rejected = rejected(total);
        report.target(
            &format!("nodes that {} tests and does not draw, of {frames} frames", setting.name),
            rejected,
            Bound::AtMost(40.0),
            "%",
        );
        let time =
            format!("slowest frame of {}, over full detail, of {frames} frames", setting.name);
        report.target(&time, Some(quantile(&total.time, 1.0)), Bound::AtMost(1.05), "×");
        if setting.reconstruct == Reconstruct::Splats {
            let holes = total.holes as f64;
            report.target(
                &format!("holes of {}, of {frames} frames", setting.name),
                Some(holes),
                Bound::AtMost(0.0),
                "pixels",
            );
            kept &= total.holes == 0;
        }
    }
    let beyond = || {
        let trees = SETTINGS.iter().zip(&totals).filter(|(setting, _)| setting.error_px.is_some());
        trees.flat_map(|(_, total)| &total.beyond)
    };
    let within = beyond().filter(|beyond| **beyond <= OUTLINE_SLACK_PX).count();
    let what = format!(
        "frames whose outline keeps the accepted error (and {OUTLINE_SLACK_PX} px of sampling), of {}",
        beyond().count()
    );
    let share = (beyond().count() > 0).then(|| 100.0 * within as f64 / beyond().count() as f64);
    report.target(&what, share, Bound::AtLeast(99.9), "%");
    report.finish()?;
    anyhow::ensure!(kept, "a promise about outlines or holes is broken: see the lines above");
    Ok(())
}

impl Found {
    fn merge(&mut self, other: Found) {
        self.beyond.extend(other.beyond);
        self.holes += other.holes;
        self.inside += other.inside;
        self.depth.extend(other.depth);
        self.psnr.extend(other.psnr);
        self.time.extend(other.time);
        self.tested += other.tested;
        self.accepted += other.accepted;
        self.flicker.extend(other.flicker);
        self.pops += other.pops;
        self.full += other.full;
        self.crossing = std::array::from_fn(|i| self.crossing[i] + other.crossing[i]);
    }
}

/// Share of the tested nodes that are not drawn, in percent; `None` where no node was tested.
fn rejected(found: &Found) -> Option<f64> {
    let (tested, accepted) = (found.tested as f64, found.accepted as f64);
    (tested > 0.0).then(|| 100.0 * (tested - accepted) / tested)
}

fn row(model: &str, setting: &str, found: &Found) -> Vec<String> {
    vec![
        model.to_owned(),
        setting.to_owned(),
        number(quantile(&found.beyond, 1.0)),
        found.holes.to_string(),
        found.inside.to_string(),
        format!("{:.1e}", median(&found.depth)),
        number(median(&found.psnr)),
        number(quantile(&found.psnr, 0.0)),
        number(median(&found.time)),
        number(quantile(&found.time, 1.0)),
        (found.accepted / found.beyond.len().max(1) as u64).to_string(),
        rejected(found).map_or("—".to_owned(), number),
        number(median(&found.flicker)),
        number(quantile(&found.flicker, 1.0)),
        found.pops.to_string(),
        number(100.0 * found.full as f64 / found.time.len().max(1) as f64),
        format!("{} / {}", found.crossing[0], found.crossing[1]),
    ]
}
