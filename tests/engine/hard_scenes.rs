//! Draws every scene of `scenes/hard` in every way of drawing splats, and checks that frames are valid and deterministic. Each
//! scene has two tests, one for its thin images, so that none takes long.

use pointillist::engine::{FrameRequest, Pose, SceneInfo};
use pointillist::plan::Output;

use super::splats_hard::{
    assert_sound, hard_folder, hard_names, request, roomy, together, ways_and_outputs,
};
use super::studio::{Studio, same};

/// Every camera of the scene with every way and output. Cameras of one way are adjacent. Frames have 96 × 64 pixels, or alternate
/// between a single pixel and a single column.
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
        for camera in &info.cameras {
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

/// Draws all frames of a scene together, some of them also alone, and all that are not thin also without 64-bit atomics.
fn draw_all(name: &str, thin: bool) {
    let studio = Studio::below(&hard_folder(), roomy);
    let file = hard_folder().join(format!("{name}.json"));
    let info = studio.engine.load(name, &file).unwrap();
    let requests = all_requests(&info, thin);
    let frames = together(&studio, &requests);
    let largest = frames.iter().map(|frame| frame.receipt.views).max().unwrap();
    assert!(largest as usize >= info.cameras.len().min(3), "{largest} views at once at most");
    let frames: Vec<Vec<u8>> = frames.iter().map(|frame| frame.bytes.to_vec()).collect();
    assert_all_sound(&info, &requests, &frames);
    // Every seventh frame: this varies camera, way and output.
    for (request, bytes) in requests.iter().zip(&frames).step_by(7) {
        same(&studio.bytes(request), bytes, &format!("alone: {request:?}"));
        same(&studio.bytes(request), bytes, &format!("again: {request:?}"));
    }
    let assert_whole = |studio: &Studio| {
        let stats = studio.engine.stats();
        assert_eq!((stats.failed, stats.device_losses), (0, 0));
    };
    assert_whole(&studio);
    drop(studio);
    // Thin images run the same passes.
    if thin {
        return;
    }
    let narrow = Studio::below(&hard_folder(), |config| {
        roomy(config);
        config.force_32_bit = true;
    });
    narrow.engine.load(name, &file).unwrap();
    let others = together(&narrow, &requests);
    for (frame, (request, bytes)) in others.iter().zip(requests.iter().zip(&frames)) {
        same(&frame.bytes, bytes, &format!("without 64-bit atomics: {request:?}"));
    }
    assert_whole(&narrow);
}

macro_rules! hard_scenes {
    ($($test:ident: $name:literal),+ $(,)?) => {
        const TESTED: &[&str] = &[$($name),+];

        $(mod $test {
            #[test]
            fn is_drawn_soundly_and_always_alike() {
                super::draw_all($name, false);
            }

            #[test]
            fn is_drawn_soundly_in_thin_images() {
                super::draw_all($name, true);
            }
        })+
    };
}

hard_scenes! {
    around_the_eye: "around-the-eye",
    axes: "axes",
    behind: "behind",
    clips: "clips",
    edge_on: "edge-on",
    few: "few",
    fields_of_view: "fields-of-view",
    layers: "layers",
    lines: "lines",
    survey: "survey",
    survey_home: "survey-home",
    transforms: "transforms",
    turned_away: "turned-away",
    without_normals: "without-normals",
}

#[test]
fn every_hard_scene_has_its_tests() {
    assert_eq!(hard_names(), TESTED);
}
