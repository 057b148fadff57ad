//! Draws every scene of `scenes/hard` in every way of drawing splats, and checks that frames are valid and deterministic.
//! The scenes share few tests, because each test compiles the pipelines of all these ways.

use pointillist::engine::{FrameRequest, Pose, SceneInfo};
use pointillist::math::Projection;
use pointillist::plan::{Output, Reconstruct, Settings};
use pointillist::scene::Painting;

use super::splats_hard::{
    BACKGROUND, assert_sound, hard_folder, hard_names, request, roomy, together, ways_and_outputs,
};
use super::studio::{Studio, ids, same};

/// Cameras of a scene from which thin frames are drawn.
const THIN_CAMERAS: usize = 3;

/// Every camera of the scene with every way and output. Cameras of one way are adjacent. Frames have 96 × 64 pixels. Thin frames, from the first
/// [`THIN_CAMERAS`], alternate between a single pixel and a single column.
fn all_requests(info: &SceneInfo, thin: bool) -> Vec<FrameRequest> {
    let mut list = Vec::new();
    for (number, (settings, output)) in ways_and_outputs().into_iter().enumerate() {
        // There are five outputs per way, and blended and opaque ways alternate. Both sizes therefore occur with both, with and
        // without low-pass filter.
        let way = number / 5;
        let size = match (thin, (way + way / 2) % 2) {
            (false, _) => [96, 64],
            (true, 0) => [1, 1],
            (true, _) => [1, 257],
        };
        for camera in info.cameras.iter().take(if thin { THIN_CAMERAS } else { usize::MAX }) {
            let pose = Pose::Named(camera.name.clone());
            list.push(request(&info.id, pose, settings, output, size));
        }
    }
    list
}

/// Checks the five outputs of each camera and way together.
fn assert_all_sound(info: &SceneInfo, requests: &[FrameRequest], frames: &[Vec<u8>]) {
    for camera in &info.cameras {
        let mine: Vec<(&FrameRequest, &Vec<u8>)> = requests
            .iter()
            .zip(frames)
            .filter(|(request, _)| request.pose == Pose::Named(camera.name.clone()))
            .collect();
        for group in mine.chunks(5) {
            let way = group[0].0.settings;
            let images: Vec<(Output, &[u8])> =
                group.iter().map(|(request, bytes)| (request.output, bytes.as_slice())).collect();
            let [w, h] = [group[0].0.width, group[0].0.height];
            let what = format!("{} from {}, {w}×{h}, {way:?}", info.id, camera.name);
            assert_sound(&images, &way, info, &what);
        }
    }
}

/// The frames of a scene.
struct Drawn {
    requests: Vec<FrameRequest>,
    frames: Vec<Vec<u8>>,
}

/// Draws all frames of a scene together, and some of them also alone.
fn draw_all(studio: &Studio, info: &SceneInfo, thin: bool) -> Drawn {
    let requests = all_requests(info, thin);
    let frames = together(studio, &requests);
    let largest = frames.iter().map(|frame| frame.receipt.views).max().unwrap();
    assert!(largest as usize >= info.cameras.len().min(3), "{largest} views at once at most");
    let frames: Vec<Vec<u8>> = frames.iter().map(|frame| frame.bytes.to_vec()).collect();
    assert_all_sound(info, &requests, &frames);
    // Every seventh frame: this varies camera, way and output.
    for (request, bytes) in requests.iter().zip(&frames).step_by(7) {
        same(&studio.bytes(request), bytes, &format!("alone: {request:?}"));
        same(&studio.bytes(request), bytes, &format!("again: {request:?}"));
    }
    Drawn { requests, frames }
}

fn load(studio: &Studio, name: &str) -> SceneInfo {
    let file = hard_folder().join(format!("{name}.json"));
    studio.engine.load(name, &file).unwrap()
}

fn assert_whole(studio: &Studio) {
    let stats = studio.engine.stats();
    assert_eq!((stats.failed, stats.device_losses), (0, 0));
}

/// Draws scenes on an adapter with 64-bit atomics, and every third frame that is not thin also on one without. Every output of every way is among these
/// for some camera. Pipelines, whose compilation takes most of the time, are shared by the scenes.
fn draw_scenes(names: &[&'static str]) {
    let studio = Studio::below(&hard_folder(), roomy);
    let drawn: Vec<Drawn> = names
        .iter()
        .map(|name| {
            let info = load(&studio, name);
            draw_all(&studio, &info, true);
            draw_all(&studio, &info, false)
        })
        .collect();
    assert_whole(&studio);
    drop(studio);
    let narrow = Studio::below(&hard_folder(), |config| {
        roomy(config);
        config.force_32_bit = true;
    });
    for (name, Drawn { requests, frames }) in names.iter().zip(&drawn) {
        load(&narrow, name);
        let third: Vec<FrameRequest> = requests.iter().step_by(3).cloned().collect();
        let others = together(&narrow, &third);
        for (frame, (request, bytes)) in
            others.iter().zip(third.iter().zip(frames.iter().step_by(3)))
        {
            same(&frame.bytes, bytes, &format!("without 64-bit atomics: {request:?}"));
        }
    }
    assert_whole(&narrow);
}

macro_rules! hard_scenes {
    ($($test:ident: $($name:literal),+;)+) => {
        const TESTED: &[&str] = &[$($($name),+),+];

        mod scenes_are_drawn_soundly_and_always_alike {
            $(#[test]
            fn $test() {
                super::draw_scenes(&[$($name),+]);
            })+
        }
    };
}

hard_scenes! {
    around_the_eye_to_edge_on: "around-the-eye", "axes", "behind", "clips", "edge-on";
    few_to_lines: "few", "fields-of-view", "layers", "lines";
    survey_to_without_normals: "survey", "survey-home", "transforms", "turned-away", "without-normals";
}

/// Number of pixels with an id from which on a painted frame must show something.
const SURELY_SHOWN: usize = 64;

/// Painted splats have colours alone, and soft outlines, which no id can be compared with. Where many pixels have an id, some have a colour.
#[test]
fn painted_scenes_are_shown_and_always_alike() {
    let [studio, narrow] = [false, true].map(|force_32_bit| {
        Studio::below(&hard_folder(), |config| {
            roomy(config);
            config.force_32_bit = force_32_bit;
        })
    });
    for name in TESTED {
        let info = load(&studio, name);
        load(&narrow, name);
        let orthographic = Some(Projection::Orthographic);
        let mut views: Vec<(_, Option<Projection>)> =
            info.cameras.iter().map(|camera| (camera, None)).collect();
        views.extend(info.cameras.first().map(|camera| (camera, orthographic)));
        for (camera, projection) in views {
            let drawn = |settings: Settings, output| {
                let pose = Pose::Named(camera.name.clone());
                let settings = Settings { projection, ..settings };
                request(&info.id, pose, settings, output, [96, 64])
            };
            let splats = drawn(Settings::drawn_as(Reconstruct::Splats), Output::Id);
            let with_ids = ids(&studio.bytes(&splats)).iter().filter(|&&id| id != 0).count();
            for painted_as in [Painting::Surfaces, Painting::Splats] {
                let settings = Settings { painted_as, ..Settings::drawn_as(Reconstruct::Painted) };
                let request = drawn(settings, Output::Color);
                let bytes = studio.bytes(&request);
                let shows = bytes.chunks_exact(4).any(|pixel| pixel[..3] != BACKGROUND);
                assert!(shows || with_ids < SURELY_SHOWN, "{with_ids} ids: {request:?}");
                same(&studio.bytes(&request), &bytes, &format!("again: {request:?}"));
                let what = format!("without 64-bit atomics: {request:?}");
                same(&narrow.bytes(&request), &bytes, &what);
            }
        }
    }
    assert_whole(&studio);
    assert_whole(&narrow);
}

#[test]
fn every_hard_scene_has_its_test() {
    assert_eq!(hard_names(), TESTED);
}
