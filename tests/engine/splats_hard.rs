//! Splats in cases that renderers often miss: the scenes of `scenes/hard` with every filter, and invariants of all splats.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DQuat, DVec2, DVec3, IVec2};
use pointillist::engine::{EncodedFrame, EngineConfig, FrameRequest, Pose, SceneInfo};
use pointillist::math::{Camera, Lens};
use pointillist::plan::{Output, Reconstruct, Settings};
use pointillist::scene::random::SplitMix64;
use pointillist::scene::{Blend, Filter, Shading};
use serde_json::{Value, json};

use super::studio::{Disk, OUTPUTS, Studio, depths, disk_sphere, disks, front, ids, same};

const FILTERS: [Filter; 3] = [Filter::Affine, Filter::Perspective, Filter::Exact];
/// The cut-off of the scenes.
const CUTOFF: f64 = 2.0;
pub const BACKGROUND: [u8; 3] = [0x10, 0x20, 0x30];
/// A colour whose linear channels are 0 and 1, which weighted sums keep exactly.
const PURE: [u8; 3] = [255, 0, 255];

fn settings(filter: Filter, prefilter: bool, blend: Blend, shading: Shading) -> Settings {
    Settings {
        reconstruct: Reconstruct::Splats,
        filter: Some(filter),
        prefilter: Some(prefilter),
        blend: Some(blend),
        shading: Some(shading),
        ..Settings::default()
    }
}

/// Every filter, with and without low-pass filter, blended and opaque.
fn ways() -> Vec<Settings> {
    let mut list = Vec::new();
    for filter in FILTERS {
        for prefilter in [true, false] {
            for blend in [Blend::Weighted, Blend::Opaque] {
                list.push(settings(filter, prefilter, blend, Shading::Deferred));
            }
        }
    }
    list
}

/// Every way, and pull-push, with every output. The shading of splats only affects colours.
pub fn ways_and_outputs() -> Vec<(Settings, Output)> {
    let mut list = Vec::new();
    for way in ways().into_iter().chain([Settings::drawn_as(Reconstruct::PullPush)]) {
        list.extend(OUTPUTS.map(|output| (way, output)));
        list.push((Settings { shading: Some(Shading::Splat), ..way }, Output::Color));
    }
    list
}

fn weighted(filter: Filter, prefilter: bool) -> Settings {
    settings(filter, prefilter, Blend::Weighted, Shading::Deferred)
}

pub fn request(
    scene: &str,
    pose: Pose,
    settings: Settings,
    output: Output,
    [w, h]: [u32; 2],
) -> FrameRequest {
    FrameRequest { pose, settings, output, ..front(scene, w, h) }
}

fn looking(eye: DVec3, target: DVec3, fov_deg: f64) -> Pose {
    Pose::Camera(Camera::perspective(eye, target, fov_deg))
}

fn one_cloud(file: &str, lights: Value) -> Value {
    json!({
        "assets": { "g": { "file": file } },
        "nodes": [{ "asset": "g" }],
        "lights": lights,
        "background": "#102030",
    })
}

/// Submits all requests together, so that many share a batch, and returns the frames.
pub fn together(studio: &Studio, requests: &[FrameRequest]) -> Vec<std::sync::Arc<EncodedFrame>> {
    let tickets: Vec<_> = requests.iter().map(|request| studio.submit(request)).collect();
    tickets.into_iter().map(|ticket| ticket.wait().unwrap()).collect()
}

pub fn roomy(config: &mut EngineConfig) {
    config.queue_capacity = 1 << 14;
}

fn linear(byte: u8) -> f64 {
    let c = f64::from(byte) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Range of colours in a scene's frames: the smallest and largest channels of its samples.
struct Range {
    low: [u8; 3],
    high: [u8; 3],
}

impl Range {
    fn of(scene: &str) -> Range {
        let (low, high) = match scene {
            "survey" | "survey-home" => ([75, 90, 0], [255, 90, 180]),
            "layers" => ([0, 0, 0], [255, 255, 0]),
            "fields-of-view" | "transforms" => ([60; 3], [240; 3]),
            "turned-away" => ([200, 120, 40], [200, 120, 40]),
            _ => (PURE, PURE),
        };
        Range { low, high }
    }

    /// Sums store a splat's share of a colour to half a unit. Its weight is at least 554 units with low-pass filter (1/8 for the
    /// filter, e⁻² for the cut-off, of 32768), and 4434 without. Channels of 0 or 1 are exact. The result is rounded by half a
    /// byte. Light only darkens.
    fn assert_holds(&self, pixel: &[u8], settings: &Settings, lit: bool, what: &str) {
        let least_weight = if settings.prefilter == Some(true) { 554.0 } else { 4434.0 };
        let exact = settings.blend == Some(Blend::Opaque);
        let slack = if exact { 0.0 } else { 0.5 / least_weight };
        let rounding = u8::from(!exact);
        for channel in 0..3 {
            let found = pixel[channel];
            let (low, high) = (self.low[channel], self.high[channel]);
            let below = linear(found.saturating_add(rounding)) >= linear(low) - slack;
            let above = linear(found.saturating_sub(rounding)) <= linear(high) + slack;
            let whole = found == low || !([0, 255].contains(&low) && low == high);
            assert!(
                above && (lit || below && whole) && (high > 0 || found == 0),
                "{what}: channel {channel} of {pixel:?} lies outside {low}..={high}"
            );
        }
    }
}

fn unit_or_zero(pixel: &[u8], what: &str) -> bool {
    if pixel == [0; 4] {
        return false;
    }
    let n = DVec3::new(f64::from(pixel[0]), f64::from(pixel[1]), f64::from(pixel[2]));
    let length = (n - DVec3::splat(128.0)).length() / 127.0;
    // Half a step of each channel: √3 / 2.
    assert!((length - 1.0).abs() < 0.87 / 127.0, "{what}: a normal of length {length}, {pixel:?}");
    true
}

/// Checks the images of one camera and way: each by itself, and that they agree on which pixels are covered.
pub fn assert_sound(frames: &[(Output, &[u8])], way: &Settings, info: &SceneInfo, what: &str) {
    let lit = info.lights > 0;
    let range = Range::of(&info.id);
    let find = |wanted| frames.iter().find(|(output, _)| *output == wanted).unwrap().1;
    let (ids, depths) = (ids(find(Output::Id)), depths(find(Output::Depth)));
    for (i, (id, depth)) in ids.iter().zip(&depths).enumerate() {
        let what = format!("{what}, pixel {i}");
        assert!(u64::from(*id) <= info.instances, "{what}: an id of {id}");
        assert!(*depth > 0.0, "{what}: a depth of {depth}");
        assert_eq!(*id != 0, depth.is_finite(), "{what}: id {id}, depth {depth}");
    }
    for (output, bytes) in frames {
        for (i, pixel) in bytes.chunks_exact(4).enumerate() {
            let what = format!("{what}, {output:?}, pixel {i}");
            match output {
                Output::Color if ids[i] == 0 => assert_eq!(pixel[..3], BACKGROUND, "{what}"),
                Output::Color => range.assert_holds(pixel, way, lit, &what),
                Output::Normal => {
                    let known = unit_or_zero(pixel, &what);
                    assert!(!known || ids[i] != 0, "{what}: a normal of nothing");
                }
                Output::Depth | Output::Id => {}
            }
        }
    }
}

pub fn hard_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/hard")
}

pub fn hard_names() -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(hard_folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|file| Some(file.strip_suffix(".json")?.to_owned()))
        .collect();
    names.sort();
    assert!(names.len() >= 13, "{names:?}");
    names
}

#[test]
fn what_lies_behind_the_eye_is_not_seen_and_what_is_before_it_is() {
    let studio = Studio::below(&hard_folder(), roomy);
    // Lower bounds on covered pixels, for the way that covers the fewest.
    let expected = [
        ("around-the-eye", "on-a-sample-askew", 6144),
        ("around-the-eye", "down-from-a-hair", 6144),
        ("around-the-eye", "camera-plane", 2200),
        ("around-the-eye", "within", 3200),
        ("axes", "front", 6144),
        ("few", "one", 4200),
        // All samples are at one place. A step of a kernel's stored length, 0.27 %, is two of these pixels; all ways give 372 or 373.
        ("few", "same", 372),
        ("fields-of-view", "narrow", 4600),
        ("fields-of-view", "wide-within", 6144),
        ("transforms", "tiny", 800),
        ("transforms", "huge", 800),
        ("transforms", "within-huge", 6144),
        ("without-normals", "front", 3100),
    ];
    let covered = |scene: &str, camera: &str, way: Settings| {
        let pose = Pose::Named(camera.to_owned());
        let bytes = studio.bytes(&request(scene, pose, way, Output::Id, [96, 64]));
        ids(&bytes).iter().filter(|id| **id != 0).count()
    };
    for name in hard_names() {
        let file = hard_folder().join(format!("{name}.json"));
        let info = studio.engine.load(&name, &file).unwrap();
        for camera in &info.cameras {
            let counts: Vec<usize> =
                ways().into_iter().map(|way| covered(&name, &camera.name, way)).collect();
            println!("{name}, {}: {counts:?}", camera.name);
            let least = *counts.iter().min().unwrap();
            if name == "behind" {
                assert_eq!(counts, [0; 12], "{name}, {}", camera.name);
            }
            for (_, _, pixels) in
                expected.iter().filter(|(scene, from, _)| *scene == name && *from == camera.name)
            {
                assert!(least >= *pixels, "{name}, {}: {counts:?}", camera.name);
            }
        }
    }
}

/// Random samples with odd values.
fn odd_disks(count: u32, powers: &[i32], random: &mut SplitMix64) -> Vec<Disk> {
    let directions = [DVec3::ZERO, DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::new(1.0, 1e-12, 0.0)];
    (0..count)
        .map(|_| {
            let p = DVec3::new(random.bell(), random.bell(), random.bell());
            let at = match random.index(5) {
                0 => DVec3::ZERO,
                1 => p * 1e-6,
                2 => DVec3::new(p.x, 0.0, 0.0),
                _ => p,
            };
            let normal = match random.index(8) {
                k @ 0..=4 => directions[k],
                5 => p * 1e-30,
                _ => p,
            };
            let radius = random.range(1.0, 9.0) * 10f64.powi(powers[random.index(powers.len())]);
            Disk { at, normal, color: PURE, radius }
        })
        .collect()
}

#[test]
fn a_million_odd_splats_give_no_odd_numbers() {
    let studio = Studio::with(roomy);
    let mut random = SplitMix64::new(20_040);
    let mut infos = Vec::new();
    // Large disks hide all others, so they are in a scene of their own.
    for (id, powers) in
        [("odd", &[-12, -6, -3, -2, -2, -1][..]), ("odd-large", &[-12, -6, -1, 0, 3, 6, 12])]
    {
        let file = format!("{id}.ply");
        studio.write(&file, disks(&odd_disks(1000, powers, &mut random)));
        let mut scene = one_cloud(&file, json!([]));
        scene["nodes"] = json!([
            { "asset": "g" },
            { "asset": "g", "scale": [-1, 2, 1e-6], "rotate": [10, 20, 30] },
            { "asset": "g", "matrix": [1, 1, 0, 0, 1, 1.0001, 0, 0, 0, 1, 1e-3, 0, 0, 0.5, 0, 1] },
            { "asset": "g", "scale": [1e3, 1e-3, 1], "translate": [0, 0, -1] },
        ]);
        infos.push(studio.load_json(id, &scene));
    }
    let (mut tested, mut drawn) = (0, 0);
    let mut rounds = 0;
    while tested < 1_000_000 || rounds < 2 {
        let info = &infos[rounds % 2];
        for way in ways() {
            let mut requests = Vec::new();
            for _ in 0..6 {
                let p = DVec3::new(random.bell(), random.bell(), random.bell());
                let eye = match random.index(5) {
                    0 => DVec3::ZERO,
                    1 => p * 1e-6,
                    2 => DVec3::new(p.x, 0.0, 0.0),
                    _ => p * 2.0,
                };
                let d = DVec3::new(random.bell(), random.bell(), random.bell());
                let towards = [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z, d, d, -eye][random.index(6)];
                let target =
                    eye + if towards.length() > 1e-9 { towards } else { DVec3::new(0.3, 0.2, 1.0) };
                let fov = [0.01, 45.0, 45.0, 90.0, 179.0][random.index(5)];
                for output in OUTPUTS {
                    let pose = looking(eye, target, fov);
                    requests.push(request(&info.id, pose, way, output, [20, 14]));
                }
            }
            requests.sort_by_key(|request| request.output as u8);
            let frames = together(&studio, &requests);
            let each = requests.len() / OUTPUTS.len();
            for view in 0..each {
                let images: Vec<(Output, &[u8])> = (0..OUTPUTS.len())
                    .map(|k| (requests[k * each + view].output, &frames[k * each + view].bytes[..]))
                    .collect();
                let what = format!("{:?}, {way:?}", requests[view].pose);
                assert_sound(&images, &way, info, &what);
            }
            tested += frames.iter().map(|frame| frame.receipt.samples.tested.unwrap()).sum::<u64>();
            drawn += frames.iter().map(|frame| frame.receipt.samples.drawn.unwrap()).sum::<u64>();
        }
        rounds += 1;
        assert!(rounds < 50, "{tested} splats only");
    }
    println!("{tested} splats, {drawn} pixels, {rounds} rounds");
    assert!(drawn > 10_000, "{drawn} pixels of splats");
}

#[test]
fn two_million_splats_on_one_pixel_neither_wrap_nor_darken() {
    let studio = Studio::with(roomy);
    for (id, color, repeats) in [
        // Just below the limit of unchecked sums, and twice that.
        ("pure", PURE, 1000),
        ("pure-crowd", PURE, 2000),
        ("mixed-crowd", [200, 120, 40], 2000),
    ] {
        let disk = Disk { at: DVec3::ZERO, normal: DVec3::Z, color, radius: 8.0 };
        studio.write("pile.ply", disks(&vec![disk; 1000]));
        let mut scene = one_cloud("pile.ply", json!([]));
        scene["nodes"][0]["repeat"] = json!({ "grid": [repeats, 1, 1], "step": [0, 0, 0] });
        let info = studio.load_json(id, &scene);
        assert_eq!(info.samples, 1000 * repeats);
        let pose = || looking(DVec3::new(0.0, 0.0, 2.0), DVec3::ZERO, 45.0);
        let bytes = |output| {
            let way = weighted(Filter::Perspective, true);
            studio.bytes(&request(id, pose(), way, output, [3, 2]))
        };
        for pixel in bytes(Output::Color).chunks_exact(4) {
            assert_eq!(pixel[..3], color, "{id}");
        }
        for depth in depths(&bytes(Output::Depth)) {
            assert!((depth - 2.0).abs() < 4e-6, "{id}: a depth of {depth}");
        }
        for pixel in bytes(Output::Normal).chunks_exact(4) {
            assert_eq!(pixel, [128, 128, 255, 255], "{id}");
        }
    }
}

/// Half of two million splats on one pixel are black and half are white. The sums overflow at first, and whether they do must not
/// depend on the order.
#[test]
fn crowds_of_two_colors_are_their_mean_in_every_run() {
    let studio = Studio::with(roomy);
    let disk = |k: usize| Disk {
        at: DVec3::ZERO,
        normal: DVec3::Z,
        color: if k.is_multiple_of(2) { [0; 3] } else { [255; 3] },
        radius: 8.0,
    };
    studio.write("crowd.ply", disks(&(0..1000).map(disk).collect::<Vec<_>>()));
    let mut scene = one_cloud("crowd.ply", json!([]));
    scene["nodes"][0]["repeat"] = json!({ "grid": [2000, 1, 1], "step": [0, 0, 0] });
    studio.load_json("crowd", &scene);
    for prefilter in [false, true] {
        for _ in 0..3 {
            let pose = looking(DVec3::new(0.0, 0.0, 2.0), DVec3::ZERO, 45.0);
            let way = weighted(Filter::Perspective, prefilter);
            let bytes = studio.bytes(&request("crowd", pose, way, Output::Color, [3, 2]));
            for pixel in bytes.chunks_exact(4) {
                // Half of linear light.
                assert_eq!(pixel[..3], [188; 3]);
            }
        }
    }
}

/// Disks whose reach equals their depth up to rounding. Beyond this the outline becomes infinite.
#[test]
fn disks_that_all_but_touch_the_camera_plane_are_drawn() {
    const COUNT: usize = 1500;
    let studio = Studio::with(roomy);
    let mut random = SplitMix64::new(5);
    let list: Vec<Disk> = (0..COUNT)
        .map(|_| {
            let normal = DVec3::new(random.bell(), random.bell(), 0.2 * random.bell())
                .normalize_or(DVec3::X);
            let reach = (1.0 - normal.z * normal.z).sqrt();
            let at = DVec3::new(0.0, 0.0, -reach * (1.0 + random.range(0.0, 1e-6)));
            Disk { at, normal, color: PURE, radius: 1.0 }
        })
        .collect();
    studio.write("near.ply", disks(&list));
    studio.load_json("near", &one_cloud("near.ply", json!([])));
    for filter in [Filter::Affine, Filter::Perspective, Filter::Exact] {
        for prefilter in [false, true] {
            let pose = looking(DVec3::ZERO, DVec3::NEG_Z, 60.0);
            let way = weighted(filter, prefilter);
            let frame = studio.frame(&request("near", pose, way, Output::Depth, [64, 64]));
            let found = frame.receipt.splats;
            let drawn = found.rasterised.unwrap() + found.scattered.unwrap();
            assert_eq!(drawn, COUNT as u64, "{filter:?}, prefilter {prefilter}: {found:?}");
            assert!(depths(&frame.bytes).iter().all(|&depth| depth > 0.0));
        }
    }
}

#[test]
fn one_color_stays_that_color() {
    // This holds for any slant of kernels and any number of them on a pixel. At the ball's rim a pixel may have a single splat
    // that the low-pass filter spreads thin. The bound is for such a splat; the average error is far below a byte.
    let studio = Studio::with(roomy);
    let mut worst = 0;
    for (number, color) in [[200, 120, 40], [128; 3], [255; 3], [64, 90, 250]].iter().enumerate() {
        let id = format!("c{number}");
        let list = disk_sphere(700, 0.14, |_| *color);
        studio.write(&format!("{id}.ply"), disks(&list));
        studio.load_json(&id, &one_cloud(&format!("{id}.ply"), json!([])));
        for way in ways() {
            let pose = looking(DVec3::new(0.4, 0.8, 3.0), DVec3::ZERO, 45.0);
            let bytes = studio.bytes(&request(&id, pose, way, Output::Color, [96, 64]));
            let (mut sum, mut count) = (0u64, 0u64);
            for pixel in bytes.chunks_exact(4).filter(|pixel| pixel[..3] != BACKGROUND) {
                Range { low: *color, high: *color }.assert_holds(pixel, &way, false, &id);
                let off = (0..3).map(|k| pixel[k].abs_diff(color[k])).max().unwrap();
                worst = worst.max(off);
                sum += u64::from(off);
                count += 1;
            }
            let mean = sum as f64 / count as f64;
            assert!(mean < 0.2, "{color:?}: {mean} bytes off on average, {way:?}");
        }
    }
    println!("{worst} bytes off at most");
}

#[test]
fn a_millimetre_at_ten_million_is_a_millimetre_at_the_origin() {
    let studio = Studio::below(&hard_folder(), roomy);
    for name in ["survey", "survey-home"] {
        studio.engine.load(name, &hard_folder().join(format!("{name}.json"))).unwrap();
    }
    for (settings, output) in ways_and_outputs() {
        for camera in ["above", "above-panned", "grazing", "grazing-panned"] {
            let [there, home] = ["survey", "survey-home"].map(|name| {
                let pose = Pose::Named(camera.to_owned());
                studio.bytes(&request(name, pose, settings, output, [96, 64]))
            });
            same(&there, &home, &format!("{camera}, {output:?}, {settings:?}"));
            if camera.ends_with("panned") && output == Output::Depth {
                let pose = Pose::Named(camera.trim_end_matches("-panned").to_owned());
                let before = studio.bytes(&request("survey", pose, settings, output, [96, 64]));
                assert!(before != there, "{camera}: a pan moves the image");
            }
        }
    }
}

#[test]
fn the_nearer_of_two_sheets_wins_at_a_millionth_of_the_distance() {
    let studio = Studio::below(&hard_folder(), roomy);
    studio.engine.load("layers", &hard_folder().join("layers.json")).unwrap();
    for filter in FILTERS {
        for prefilter in [true, false] {
            let way = settings(filter, prefilter, Blend::Opaque, Shading::Deferred);
            for camera in ["front", "slant"] {
                let pose = Pose::Named(camera.to_owned());
                let bytes = studio.bytes(&request("layers", pose, way, Output::Color, [96, 64]));
                let shown: Vec<_> =
                    bytes.chunks_exact(4).filter(|pixel| pixel[..3] != BACKGROUND).collect();
                let red = shown.iter().filter(|pixel| pixel[..3] == [255, 0, 0]).count();
                // At the rim the farther sheet, which is as wide, may extend a pixel further.
                assert!(red > 1000 && shown.len() - red <= 20, "{red} of {}: {way:?}", shown.len());
            }
        }
    }
}

/// A sheet that fills the frame, with slowly varying colours.
fn gradient() -> Vec<Disk> {
    const SIDE: i32 = 80;
    let mut list = Vec::new();
    for i in 0..SIDE * SIDE {
        let [x, y] = [i % SIDE, i / SIDE].map(|k| f64::from(k - SIDE / 2) * 0.1);
        let byte = |v: f64| (140.0 + 15.0 * v) as u8;
        let color = [byte(x), byte(y), byte(0.5 * (x - y))];
        list.push(Disk { at: DVec3::new(x, y, 0.0), normal: DVec3::Z, color, radius: 0.2 });
    }
    list
}

#[test]
fn a_small_step_of_the_pose_is_a_small_step_of_the_image() {
    // A pixel's colour is a mean of splats within their reach (0.2 units, at 15 bytes per unit: 3 bytes either way). A step of
    // 1e-4 moves the mean by its gradient, far less than a byte. The largest effect is a splat that enters or leaves at its
    // cut-off, with a weight of e⁻² beside the total of 5 of all others: 6 bytes · 0.14 / 5 = 0.16 each, for at most four at
    // once. With rounding before and after, the limit is 2 bytes. The depth moves with the eye, and the normal does not change.
    let studio = Studio::with(roomy);
    studio.write("sheet.ply", disks(&gradient()));
    studio.load_json("sheet", &one_cloud("sheet.ply", json!([])));
    for filter in FILTERS {
        for prefilter in [true, false] {
            let way = weighted(filter, prefilter);
            let mut before: Vec<Option<Vec<u8>>> = vec![None; 3];
            for step in 0..24 {
                let direction = [DVec3::X, DVec3::Y, DVec3::Z][step / 8];
                let moved = direction * (1e-4 * (step % 8) as f64);
                if step % 8 == 0 {
                    before = vec![None; 3];
                }
                let eye = DVec3::new(0.31, -0.7, 2.3) + moved;
                let pose = looking(eye, DVec3::new(0.0, 0.0, 0.0) + moved, 45.0);
                for (k, output) in
                    [Output::Color, Output::Depth, Output::Normal].into_iter().enumerate()
                {
                    let bytes =
                        studio.bytes(&request("sheet", pose.clone(), way, output, [96, 64]));
                    if let Some(before) = &before[k] {
                        let what = format!("{output:?}, step {step}, {way:?}");
                        assert_small_step(before, &bytes, output, &what);
                    }
                    before[k] = Some(bytes);
                }
            }
        }
    }
}

/// Sums of a single pass are rounded by sample and pixel, not by where the camera is.
#[test]
fn a_tiny_step_changes_hardly_any_pixel_of_a_single_pass() {
    let studio = Studio::with(roomy);
    studio.write("sheet.ply", disks(&gradient()));
    studio.load_json("sheet", &one_cloud("sheet.ply", json!([])));
    let way = Settings::drawn_as(Reconstruct::Fuzzy);
    let frame = |step: f64| {
        let moved = DVec3::new(1e-6, 7e-7, 0.0) * step;
        let pose = looking(DVec3::new(0.31, -0.7, 2.3) + moved, moved, 45.0);
        studio.bytes(&request("sheet", pose, way, Output::Color, [96, 64]))
    };
    let before = frame(0.0);
    for step in 1..4 {
        let after = frame(f64::from(step));
        let pairs = before.chunks_exact(4).zip(after.chunks_exact(4));
        let changed = pairs.filter(|(a, b)| a != b).count();
        assert!(changed <= 60, "step {step}: {changed} of 6144 pixels");
    }
}

fn assert_small_step(before: &[u8], after: &[u8], output: Output, what: &str) {
    match output {
        Output::Depth => {
            for (a, b) in depths(before).iter().zip(depths(after)) {
                // A step along the viewing axis counts fully. A sideways step is multiplied by the sheet's slant, which is below
                // 1.
                assert!((a - b).abs() < 2e-4, "{what}: {a} {b}");
            }
        }
        Output::Normal => same(after, before, what),
        _ => {
            let most = before.iter().zip(after).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(most <= 2, "{what}: {most} bytes");
        }
    }
}

/// Number of pixels that differ by more than rounding: in coverage, in depth by more than `slack` relative, or in colour by more
/// than two bytes.
fn differing(a: &[u8], b: &[u8], output: Output, slack: f32) -> usize {
    match output {
        Output::Depth => {
            let pairs = depths(a).into_iter().zip(depths(b));
            pairs.filter(|(a, b)| a != b && ((a - b).abs() > slack * a || (a - b).is_nan())).count()
        }
        _ => {
            let pairs = a.chunks_exact(4).zip(b.chunks_exact(4));
            pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 2)).count()
        }
    }
}

fn coloured(p: DVec3) -> [u8; 3] {
    p.to_array().map(|v| (130.0 + 60.0 * v) as u8)
}

#[test]
fn turning_scene_and_camera_together_changes_nothing() {
    let studio = Studio::with(roomy);
    studio.write("ball.ply", disks(&disk_sphere(500, 0.16, coloured)));
    // The light turns with the camera.
    let lights = json!([{ "kind": "headlight" }]);
    let mut random = SplitMix64::new(5);
    for turn in 0..4 {
        let axis = DVec3::new(random.bell(), random.bell(), random.bell()).normalize_or(DVec3::Y);
        let turn_angle = if turn == 0 { 0.0 } else { random.range(0.5, 3.0) };
        let world_from_ball = DAffine3::from_quat(DQuat::from_axis_angle(axis, turn_angle));
        let mut scene = one_cloud("ball.ply", lights.clone());
        let m = world_from_ball.matrix3;
        let columns = [m.x_axis, m.y_axis, m.z_axis].map(|c| [c.x, c.y, c.z, 0.0]);
        let mut numbers = columns.concat();
        numbers.extend([0.0, 0.0, 0.0, 1.0]);
        scene["nodes"][0]["matrix"] = json!(numbers);
        studio.load_json(&format!("ball{turn}"), &scene);
        for way in ways() {
            for output in [Output::Color, Output::Depth] {
                let [turned, straight] = [turn, 0].map(|number| {
                    let map = if number == 0 { DAffine3::IDENTITY } else { world_from_ball };
                    let pose = Pose::Camera(Camera {
                        eye: map.transform_point3(DVec3::new(0.5, 0.4, 2.5)),
                        target: DVec3::ZERO,
                        up: map.transform_vector3(DVec3::Y),
                        lens: Lens::Perspective { fov_deg: 45.0 },
                    });
                    studio.bytes(&request(&format!("ball{number}"), pose, way, output, [96, 64]))
                });
                let found = differing(&turned, &straight, output, 1e-4);
                // A pixel centre on an outline may fall to either side. With a weight of e⁻², a splat more or less is visible at
                // the ball's rim, where there are few. Rounding affects a few pixels of 250 outlines, each some 40 pixels long.
                assert!(found <= 16, "{found} pixels, {output:?}, turn {turn}, {way:?}");
            }
        }
    }
}

#[test]
fn copies_of_a_cloud_are_as_one_cloud() {
    let studio = Studio::with(roomy);
    let one = disk_sphere(400, 0.18, coloured);
    let offset = DVec3::new(1.25, 0.25, -0.5);
    let moved = one.iter().map(|disk| Disk { at: disk.at + offset, ..*disk });
    let both: Vec<Disk> = one.iter().copied().chain(moved).collect();
    studio.write("one.ply", disks(&one));
    studio.write("both.ply", disks(&both));
    let lights = json!([{ "kind": "headlight" }]);
    let mut copies = one_cloud("one.ply", lights.clone());
    copies["nodes"] = json!([{ "asset": "g" }, { "asset": "g", "translate": offset.to_array() }]);
    studio.load_json("copies", &copies);
    studio.load_json("flat", &one_cloud("both.ply", lights));
    for way in ways() {
        for shading in [Shading::Deferred, Shading::Splat] {
            let way = Settings { shading: Some(shading), ..way };
            for output in [Output::Color, Output::Depth, Output::Normal] {
                let [copies, flat] = ["copies", "flat"].map(|scene| {
                    let pose = looking(DVec3::new(0.9, 0.6, 3.5), DVec3::new(0.6, 0.1, 0.0), 45.0);
                    studio.bytes(&request(scene, pose, way, output, [96, 64]))
                });
                let found = differing(&copies, &flat, output, 1e-4);
                assert!(found <= 6, "{found} pixels, {output:?}, {way:?}");
            }
        }
    }
}

/// Numbers of splats that are certainly and possibly drawn: in front of the camera plane, and across it.
#[derive(Debug, Default)]
struct Counts {
    regular: [u64; 2],
    crossing: [u64; 2],
}

/// Counts splats for the affine filter without low-pass filter: by the box of the linear approximation's ellipse and the pixel of
/// its centre.
fn count(list: &[Disk], camera: &Camera, [width, height]: [u32; 2]) -> Counts {
    let view = camera.view(width, height).unwrap();
    let size = DVec2::new(f64::from(width), f64::from(height));
    let to_camera = |v: DVec3| view.view_from_world * v * DVec3::new(1.0, -1.0, -1.0);
    let mut counts = Counts::default();
    for disk in list {
        let p = to_camera(disk.at - camera.eye);
        let (u, v) = disk.normal.normalize_or(DVec3::Z).any_orthonormal_pair();
        let [u, v] = [u, v].map(|axis| to_camera(axis) * (disk.radius / CUTOFF));
        let reach = CUTOFF * u.z.hypot(v.z);
        // Normals are stored in 16 bits.
        let doubtful = (p.z.abs() - reach).abs() < 1e-3 * (reach + p.z.abs());
        if p.z > reach {
            let image =
                |t: DVec3| (t.truncate() * p.z - p.truncate() * t.z) / (p.z * p.z) * view.focal_px;
            let (ju, jv) = (image(u), image(v));
            let extent = CUTOFF * (ju * ju + jv * jv).map(f64::sqrt);
            let centre = p.truncate() / p.z * view.focal_px + view.principal_px;
            let meets = |slack: f64| {
                let low = (centre - extent - slack - 0.5).ceil().max(DVec2::ZERO);
                let high = (centre + extent + slack - 0.5).floor().min(size - 1.0);
                low.cmple(high).all()
            };
            // However small, a splat fills the pixel of its centre.
            let centred = |slack: f64| {
                centre.cmpge(DVec2::splat(-slack)).all() && centre.cmple(size + slack).all()
            };
            let slack = 2e-3 * (1.0 + extent.max_element());
            counts.regular[0] += u64::from(!doubtful && (meets(-slack) || centred(-slack)));
            counts.regular[1] += u64::from(meets(slack) || centred(slack) || doubtful);
            counts.crossing[1] += u64::from(doubtful);
        } else if p.z > -reach {
            let n = u.cross(v);
            let covered = (0..height as i32 * width as i32).any(|i| {
                let pixel = IVec2::new(i % width as i32, i / width as i32).as_dvec2() + 0.5;
                let ray = ((pixel - view.principal_px) / view.focal_px).extend(1.0);
                let depth = p.dot(n) / ray.dot(n);
                let off = ray * depth - p;
                depth > 1e-3 && off.length() < 0.98 * disk.radius
            });
            counts.crossing[0] += u64::from(!doubtful && covered);
            counts.crossing[1] += 1;
            counts.regular[1] += u64::from(doubtful);
        } else if doubtful {
            counts.crossing[1] += 1;
        }
    }
    counts
}

#[test]
fn no_splat_is_dropped_without_being_counted() {
    const SIZE: [u32; 2] = [48, 32];
    let studio = Studio::with(roomy);
    let mut random = SplitMix64::new(77);
    let mut crossing = 0;
    for scene in 0..3 {
        let list: Vec<Disk> = (0..700)
            .map(|_| {
                let mut vector = || DVec3::new(random.bell(), random.bell(), random.bell());
                let (at, normal) = (vector() * 2.0, vector());
                let radius = 10f64.powf(random.range(-2.5, 0.3));
                Disk { at, normal, color: PURE, radius }
            })
            .collect();
        let id = format!("s{scene}");
        studio.write(&format!("{id}.ply"), disks(&list));
        studio.load_json(&id, &one_cloud(&format!("{id}.ply"), json!([])));
        for _ in 0..6 {
            let camera = Camera::perspective(
                DVec3::new(random.bell(), random.bell(), random.bell()) * 1.5,
                DVec3::new(0.1, 0.2, 0.3),
                random.range(20.0, 100.0),
            );
            let way = weighted(Filter::Affine, false);
            let frame = studio.frame(&request(&id, Pose::Camera(camera), way, Output::Depth, SIZE));
            let found = frame.receipt.splats;
            let clipped = found.clipped.unwrap();
            let regular = found.rasterised.unwrap() + found.scattered.unwrap() - clipped;
            let expected = count(&list, &camera, SIZE);
            let what = format!("{found:?}, {expected:?}, {camera:?}");
            assert!((expected.regular[0]..=expected.regular[1]).contains(&regular), "{what}");
            assert!((expected.crossing[0]..=expected.crossing[1]).contains(&clipped), "{what}");
            assert!(expected.regular[1] - expected.regular[0] <= 5, "{what}");
            crossing += expected.crossing[0];
        }
    }
    assert!(crossing > 100, "{crossing} splats cross the camera plane");
}

#[test]
fn what_a_shear_stretches_is_not_culled() {
    // A shear makes a kernel longer than the longest column of its matrix, so the disk extends into the image although its chunk
    // does not.
    let studio = Studio::with(roomy);
    let disk = Disk { at: DVec3::ZERO, normal: DVec3::Z, color: PURE, radius: 1.0 };
    studio.write("disk.ply", disks(&[disk]));
    let mut scene = one_cloud("disk.ply", json!([]));
    // Both columns have length 1. Their sum has length 2 and is the image of a vector of length √2.
    scene["nodes"][0]["matrix"] = json!([1, 0.1, 0, 0, 1, -0.1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    studio.load_json("sheared", &scene);
    // The disk ends at x = √2.
    let pose = looking(DVec3::new(1.25, 0.0, 10.0), DVec3::X * 1.25, 0.5);
    for way in ways() {
        let bytes = studio.bytes(&request("sheared", pose.clone(), way, Output::Id, [64, 64]));
        let covered = ids(&bytes).iter().filter(|id| **id != 0).count();
        assert!(covered > 4000, "{covered} pixels, {way:?}");
    }
}

#[test]
fn scale_changes_nothing() {
    let studio = Studio::with(roomy);
    studio.write("ball.ply", disks(&disk_sphere(300, 0.2, coloured)));
    let mut usual: Vec<Vec<u8>> = Vec::new();
    // Powers of two, which factor out of every f32 product without overflow or underflow.
    for power in [0, -29, -50, 29, 50] {
        let scale = 2f64.powi(power);
        let outer = 2f64.powi(power / 2);
        let id = format!("s{power}");
        let mut scene = one_cloud("ball.ply", json!([{ "kind": "headlight" }]));
        let inner = json!({ "asset": "g", "scale": scale / outer });
        scene["nodes"] = json!([{ "scale": outer, "children": [inner] }]);
        studio.load_json(&id, &scene);
        let mut found = Vec::new();
        for (settings, output) in ways_and_outputs() {
            let pose = looking(DVec3::new(0.5, 0.75, 2.5) * scale, DVec3::ZERO, 45.0);
            let mut bytes = studio.bytes(&request(&id, pose, settings, output, [96, 64]));
            if output == Output::Depth {
                let depths = depths(&bytes).into_iter().map(|z| z / scale as f32);
                bytes = depths.flat_map(f32::to_le_bytes).collect();
            }
            if let Some(usual) = usual.get(found.len()) {
                same(&bytes, usual, &format!("2^{power}, {output:?}, {settings:?}"));
            }
            found.push(bytes);
        }
        usual = found;
    }
}

#[test]
fn a_lone_sample_is_as_large_as_it_says() {
    // All coordinates of a lone sample are in one cell of its grid. Only its kernel determines the size of the cell.
    let studio = Studio::with(roomy);
    for power in [-12, -6, -3, 0, 3, 6, 12] {
        let radius = 10f64.powi(power);
        for (kind, normal) in [DVec3::Z, DVec3::new(0.0, 0.4, 0.9)].into_iter().enumerate() {
            let id = format!("{power}-{kind}");
            let list = [Disk { at: DVec3::ZERO, normal, color: PURE, radius }];
            studio.write("lone.ply", disks(&list));
            studio.load_json(&id, &one_cloud("lone.ply", json!([])));
            let slant = normal.z / normal.length();
            for way in ways() {
                let eye = DVec3::Z * radius * 4.0;
                let pose = looking(eye, DVec3::ZERO, 45.0);
                let bytes = studio.bytes(&request(&id, pose, way, Output::Id, [64, 64]));
                let covered = ids(&bytes).iter().filter(|id| **id == 1).count() as f64;
                // Share of the frame, whose height is 8 radii · tan 22.5°.
                let share =
                    std::f64::consts::PI * slant / (8.0 * 22.5f64.to_radians().tan()).powi(2);
                let expected = share * 64.0 * 64.0;
                let off = covered / expected;
                assert!((0.9..1.25).contains(&off), "{power}: {covered} of {expected}, {way:?}");
            }
        }
    }
}
