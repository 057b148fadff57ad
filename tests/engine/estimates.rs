//! Large clouds are drawn as points before their normals and kernels are estimated. Frames that need these wait, and are equal to
//! frames of a cloud that was estimated while it was loaded.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use pointillist::assets::Progress;
use pointillist::bake::cache::BakeCache;
use pointillist::engine::{
    BakeSource, Engine, EngineError, EstimateState, FrameRequest, Latch, NodePatch, SceneInfo,
};
use pointillist::memory::HostMemory;
use pointillist::plan::{Output, Reconstruct, Settings, Wait};
use serde_json::json;

use super::studio::{Studio, cloud_scene, eventually, front, same, spt, wall};

/// Points along each side of the cloud.
const SIDE: u32 = 60;

/// An unlit scene `cloud` and a lit one `lit`, both of the same cloud of 3600 points without normals. Clouds of more than
/// `at_once` points are estimated later, once `latch` is open.
fn studio(at_once: usize, latch: &Arc<Latch>) -> Studio {
    let studio = Studio::with(|config| {
        config.estimate_at_once = at_once;
        config.bake_latch = Some(latch.clone());
    });
    studio.write("wall.ply", wall(SIDE as usize, |x, y| [(x * 4) as u8, (y * 4) as u8, 90]));
    studio.load_json("cloud", &cloud_scene("wall.ply"));
    let mut lit = cloud_scene("wall.ply");
    lit["lights"] = json!([{ "kind": "headlight" }]);
    studio.load_json("lit", &lit);
    studio
}

fn deferred() -> (Studio, Arc<Latch>) {
    let latch = Arc::new(Latch::default());
    (studio(1000, &latch), latch)
}

fn state(studio: &Studio, scene: &str) -> EstimateState {
    studio.engine.scene(scene).unwrap().estimates.state
}

fn with(scene: &str, reconstruct: Reconstruct, output: Output) -> FrameRequest {
    let settings = Settings { reconstruct, ..Settings::default() };
    FrameRequest { settings, output, ..front(scene, 96, 72) }
}

/// Frames that need normals or kernels.
fn demanding() -> Vec<FrameRequest> {
    let trees = FrameRequest { settings: spt(2.0, Reconstruct::Splats), ..front("cloud", 96, 72) };
    vec![
        with("cloud", Reconstruct::Splats, Output::Color),
        with("cloud", Reconstruct::Fuzzy, Output::Color),
        with("cloud", Reconstruct::Splats, Output::Depth),
        with("cloud", Reconstruct::Points, Output::Normal),
        with("lit", Reconstruct::Points, Output::Color),
        trees,
    ]
}

/// Frames that need neither normals nor kernels.
fn modest() -> Vec<FrameRequest> {
    vec![
        with("cloud", Reconstruct::Points, Output::Color),
        with("cloud", Reconstruct::Points, Output::Depth),
        with("lit", Reconstruct::Points, Output::Id),
    ]
}

#[test]
fn loading_and_patching_say_that_nothing_is_estimated_yet() {
    let (studio, _latch) = deferred();
    assert_eq!(studio.load("again", "wall.ply").estimates.state, EstimateState::Deferred);
    let patch = NodePatch { visible: Some(true), ..NodePatch::default() };
    let patched = studio.engine.patch("cloud", "wall", &patch).unwrap();
    assert_eq!(patched.estimates.state, EstimateState::Deferred);
    let eager = self::studio(usize::MAX, &Arc::new(Latch::default()));
    assert_eq!(eager.load("again", "wall.ply").estimates.state, EstimateState::Complete);
}

#[test]
fn points_are_drawn_before_anything_is_estimated() {
    let (studio, latch) = deferred();
    let eager = self::studio(usize::MAX, &latch);
    assert_eq!(state(&eager, "cloud"), EstimateState::Complete);
    for request in modest() {
        assert!(!studio.engine.must_bake(&request), "{request:?}");
        same(&studio.bytes(&request), &eager.bytes(&request), &format!("{request:?}"));
        let [a, b] =
            [&studio, &eager].map(|studio| super::studio::etag(&studio.engine, &request).unwrap());
        assert_eq!(a, b, "what a frame shows does not depend on when normals are estimated");
    }
    for scene in ["cloud", "lit"] {
        assert_eq!(state(&studio, scene), EstimateState::Deferred, "nobody has asked for more");
    }
}

#[test]
fn frames_that_need_estimates_wait_and_are_those_of_a_whole_scene() {
    for (number, request) in demanding().into_iter().enumerate() {
        let (studio, latch) = deferred();
        let scene = request.scene.as_str();
        let changes = studio.engine.changes();
        let points = with(scene, Reconstruct::Points, Output::Id);
        let before = (studio.bytes(&points), studio.engine.scene_mark(scene).unwrap());
        let mut ticket = studio.engine.begin_bake(&request).unwrap().unwrap();
        assert!(ticket.wait_while(|_| state(&studio, scene) != EstimateState::Running).is_none());
        assert!(studio.engine.must_bake(&request), "the latch is shut");
        latch.open();
        ticket.wait().unwrap();
        assert_eq!(state(&studio, scene), EstimateState::Complete);
        let eager = self::studio(usize::MAX, &latch);
        same(&studio.bytes(&request), &eager.bytes(&request), &format!("{number}: {request:?}"));
        // Watchers of the scene are notified, and points are drawn as before.
        assert!(changes.has_changed().unwrap());
        let mark = studio.engine.scene_mark(scene).unwrap();
        assert!(mark != before.1 && mark.revision == before.1.revision);
        same(&studio.bytes(&points), &before.0, "points");
        let etags =
            [&studio, &eager].map(|studio| super::studio::etag(&studio.engine, &request).unwrap());
        assert_eq!(etags[0], etags[1]);
    }
}

#[test]
fn who_submits_without_waiting_for_a_bake_gets_a_whole_frame() {
    let (studio, latch) = deferred();
    latch.open();
    let eager = self::studio(usize::MAX, &latch);
    for request in demanding() {
        same(&studio.bytes(&request), &eager.bytes(&request), &format!("{request:?}"));
    }
}

#[test]
fn nobody_estimates_for_nobody() {
    let (studio, latch) = deferred();
    let request = with("cloud", Reconstruct::Splats, Output::Color);
    let ticket = studio.engine.begin_bake(&request).unwrap().unwrap();
    assert_eq!(studio.engine.bakes_running(), 1);
    drop(ticket);
    eventually("the end of the estimate", || studio.engine.bakes_running() == 0);
    assert_eq!(state(&studio, "cloud"), EstimateState::Deferred);
    latch.open();
    studio.engine.bake(&request).unwrap();
    assert_eq!(state(&studio, "cloud"), EstimateState::Complete);
    // The estimates of another scene of the same file only have to be put in place.
    assert_eq!(state(&studio, "lit"), EstimateState::Complete);
}

#[test]
fn revisions_that_come_meanwhile_are_completed_too() {
    let (studio, latch) = deferred();
    let request = with("cloud", Reconstruct::Splats, Output::Color);
    let ticket = studio.engine.begin_bake(&request).unwrap().unwrap();
    let patch = NodePatch {
        world_from_node: Some(glam::DAffine3::from_translation(glam::DVec3::X * 0.1)),
        visible: None,
    };
    let patched = studio.engine.patch("cloud", "wall", &patch).unwrap();
    assert_eq!(patched.revision, 2);
    latch.open();
    ticket.wait().unwrap();
    let info: SceneInfo = studio.engine.scene("cloud").unwrap();
    assert_eq!((info.revision, info.estimates.state), (2, EstimateState::Complete));
    let eager = self::studio(usize::MAX, &latch);
    eager.engine.patch("cloud", "wall", &patch).unwrap();
    same(&studio.bytes(&request), &eager.bytes(&request), "the second revision");
}

#[test]
fn a_file_that_has_changed_is_not_estimated() {
    let (studio, latch) = deferred();
    latch.open();
    studio.write("wall.ply", wall(SIDE as usize, |_, _| [1, 2, 3]));
    let request = with("cloud", Reconstruct::Splats, Output::Color);
    let error = studio.engine.bake(&request).unwrap_err();
    assert!(matches!(&error, EngineError::Asset(_)), "{error}");
    let text = error.to_string();
    assert!(text.contains("wall.ply") && text.contains("load it again"), "{text}");
    // Frames of points are still drawn.
    assert!(!studio.bytes(&with("cloud", Reconstruct::Points, Output::Color)).is_empty());
}

#[test]
fn scenes_that_come_later_share_what_was_estimated() {
    let (studio, latch) = deferred();
    latch.open();
    studio.engine.bake(&with("cloud", Reconstruct::Splats, Output::Color)).unwrap();
    let info = studio.load_json("third", &cloud_scene("wall.ply"));
    assert_eq!(info.estimates.state, EstimateState::Complete);
}

fn final_etag(engine: &Engine, request: &FrameRequest) -> Option<String> {
    engine.resolve_blocking(request.clone()).unwrap().final_etag().map(str::to_owned)
}

/// A frame in which samples are about two pixels apart.
fn open(scene: &str, wait: Wait) -> FrameRequest {
    let settings = Settings { reconstruct: Reconstruct::Auto, wait, ..Settings::default() };
    FrameRequest { settings, ..front(scene, 192, 144) }
}

#[test]
fn auto_draws_what_is_there_and_says_that_it_is_provisional() {
    for scene in ["cloud", "lit"] {
        let (studio, latch) = deferred();
        let engine = &studio.engine;
        let request = open(scene, Wait::Ready);
        assert!(!engine.must_bake(&request));
        assert_eq!(final_etag(engine, &request), None, "it will be another frame");
        let frame = studio.frame(&request);
        let settings = &frame.receipt.settings;
        assert_eq!(settings.applied.reconstruct, Some(Reconstruct::Points));
        // Discs close the wall, whose samples are about two pixels apart.
        assert!((3.0..6.0).contains(&settings.applied.point_size_px.unwrap()), "{settings:?}");
        let told = settings.provisional.clone().unwrap();
        assert!(told.starts_with("normals and kernels are being estimated ("), "{told}");
        assert_eq!(state(&studio, scene), EstimateState::Running);
        // A request for the final frame waits.
        assert!(engine.must_bake(&open(scene, Wait::Complete)));
        let film = FrameRequest {
            settings: Settings {
                wait: Wait::Whole,
                ..with(scene, Reconstruct::Points, Output::Id).settings
            },
            ..front(scene, 8, 8)
        };
        assert!(engine.must_bake(&film), "frames of a film never wait one by one");
        // Where samples are denser than pixels, a frame of points is final for a scene without lights.
        let dense = FrameRequest { width: 24, height: 18, ..open("cloud", Wait::Ready) };
        let early = studio.frame(&dense);
        assert_eq!(early.receipt.settings.provisional, None);
        let early = (final_etag(engine, &dense).unwrap(), early.bytes.to_vec());
        latch.open();
        eventually("the estimate", || state(&studio, scene) == EstimateState::Complete);
        let frame = studio.frame(&request);
        assert_eq!(frame.receipt.settings.provisional, None);
        assert_eq!(frame.receipt.settings.applied.reconstruct, Some(Reconstruct::Splats));
        let eager = self::studio(usize::MAX, &latch);
        same(&frame.bytes, &eager.bytes(&request), "the final frame");
        assert_eq!(final_etag(engine, &request), final_etag(&eager.engine, &request));
        let late = (final_etag(engine, &dense).unwrap(), studio.bytes(&dense));
        assert!(late == early, "the same tag, the same bytes");
    }
}

/// An estimate that failed because others held the memory succeeds once they release it.
#[test]
fn estimates_are_made_once_there_is_memory() {
    let memory = HostMemory::new(64 << 20);
    let studio = Studio::with(|config| {
        config.estimate_at_once = 1000;
        config.memory = memory.clone();
    });
    studio.write("wall.ply", wall(SIDE as usize, |_, _| [90; 3]));
    studio.load_json("cloud", &cloud_scene("wall.ply"));
    let others = memory.reserve("others", memory.budget() - memory.in_use()).unwrap();
    let request = open("cloud", Wait::Ready);
    let shown = || studio.frame(&request).receipt.settings.provisional.clone();
    eventually("the refusal", || shown().is_some_and(|told| told.contains("cannot be estimated")));
    assert_eq!(state(&studio, "cloud"), EstimateState::Failed);
    drop(others);
    eventually("the estimate", || shown().is_none());
    assert_eq!(state(&studio, "cloud"), EstimateState::Complete);
}

#[test]
fn deleting_a_scene_stops_its_estimate() {
    let (studio, _shut) = deferred();
    studio.frame(&open("cloud", Wait::Ready));
    assert_eq!(studio.engine.bakes_running(), 1);
    studio.engine.remove("cloud").unwrap();
    eventually("the end of the estimate", || studio.engine.bakes_running() == 0);
    // An engine that ends waits for no estimate.
    studio.frame(&open("lit", Wait::Ready));
    assert_eq!(studio.engine.bakes_running(), 1);
}

#[test]
fn waiting_for_everything_gives_the_final_frame() {
    let (studio, latch) = deferred();
    latch.open();
    let frame = studio.frame(&open("cloud", Wait::Complete));
    assert_eq!(frame.receipt.settings.provisional, None);
    assert_eq!(frame.receipt.settings.applied.reconstruct, Some(Reconstruct::Splats));
    assert_eq!(state(&studio, "cloud"), EstimateState::Complete);
}

/// An engine on an existing folder, with a cache, and the number of progress reports by its reader.
fn again(root: &Path, cache: &Path) -> (Studio, Arc<AtomicU32>) {
    let told = Arc::<AtomicU32>::default();
    let counted = told.clone();
    let studio = Studio::below(root, |config| {
        config.estimate_at_once = 1000;
        config.settled_after = Duration::ZERO;
        config.bake_cache = Some(BakeCache::new(cache, 1 << 30));
        config.read.progress = Progress::new(move |_| {
            counted.fetch_add(1, Ordering::Relaxed);
        });
    });
    studio.engine.load("cloud", &root.join("cloud.json")).unwrap();
    (studio, told)
}

fn files(cache: &Path, extension: &str) -> Vec<PathBuf> {
    let files = std::fs::read_dir(cache).unwrap().map(|file| file.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|found| found == extension)).collect()
}

#[test]
fn large_clouds_are_kept_from_one_process_to_the_next() {
    let (root, cache) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let [root, cache] = [&root, &cache].map(|folder| folder.path());
    let wall_file = root.join("wall.ply");
    std::fs::write(&wall_file, wall(SIDE as usize, |x, _| [x as u8, 3, 90])).unwrap();
    std::fs::write(root.join("cloud.json"), cloud_scene("wall.ply").to_string()).unwrap();
    let points = with("cloud", Reconstruct::Points, Output::Color);
    let splats = with("cloud", Reconstruct::Splats, Output::Color);
    // Frames as points and as splats, whether the file was read, and the state of the estimates.
    let run = |what: &str, needs_splats: bool| {
        let (studio, told) = again(root, cache);
        let was_read = told.load(Ordering::Relaxed) > 0;
        let found = (was_read, state(&studio, "cloud"));
        let etag = super::studio::etag(&studio.engine, &points).unwrap();
        let mut frames = vec![studio.bytes(&points), etag.into_bytes()];
        if needs_splats {
            frames.push(studio.bytes(&splats));
        }
        println!("{what}: {found:?}");
        (frames, found)
    };
    let (first, found) = run("first", false);
    assert_eq!(found, (true, EstimateState::Deferred));
    assert_eq!((files(cache, "note").len(), files(cache, "bake").len()), (1, 1));
    let (second, found) = run("second", true);
    assert_eq!(found, (false, EstimateState::Deferred));
    assert_eq!(second[..2], first[..]);
    assert_eq!(files(cache, "bake").len(), 1, "the whole cloud is there in place of its points");
    let (third, found) = run("third", true);
    assert_eq!(found, (false, EstimateState::Complete));
    assert_eq!(third, second);
    // Damaged entries are not used.
    for extension in ["bake", "note"] {
        for file in files(cache, extension) {
            let mut bytes = std::fs::read(&file).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            std::fs::write(&file, bytes).unwrap();
        }
        let (frames, found) = run(extension, true);
        assert_eq!(found, (true, EstimateState::Deferred));
        assert_eq!(frames, second);
    }
    // A changed file counts as another one.
    std::fs::write(&wall_file, wall(SIDE as usize, |_, y| [9, y as u8, 9])).unwrap();
    let (changed, found) = run("changed", true);
    assert_eq!(found, (true, EstimateState::Deferred));
    assert!(changed[0] != second[0] && changed[1] != second[1]);
}

#[test]
fn clouds_that_were_just_written_are_kept_once_they_have_settled() {
    let folder = tempfile::tempdir().unwrap();
    let studio = Studio::with(|config| {
        config.estimate_at_once = 1000;
        config.settled_after = Duration::from_secs(1);
        config.bake_cache = Some(BakeCache::new(folder.path(), 1 << 30));
    });
    studio.write("wall.ply", wall(SIDE as usize, |x, _| [x as u8, 3, 90]));
    studio.load_json("cloud", &cloud_scene("wall.ply"));
    eventually("a note", || files(folder.path(), "note").len() == 1);
    assert_eq!(files(folder.path(), "bake").len(), 1);
}

#[test]
fn estimates_leave_the_order_of_scenes_as_it_is() {
    let (studio, latch) = deferred();
    latch.open();
    let names =
        || -> Vec<String> { studio.engine.scenes().into_iter().map(|scene| scene.id).collect() };
    let before = names();
    studio.bytes(&with("cloud", Reconstruct::Splats, Output::Color));
    assert_eq!(state(&studio, "cloud"), EstimateState::Complete);
    assert_eq!(names(), before);
}

#[test]
fn trees_of_a_large_cloud_are_cached_under_the_same_key() {
    let folder = tempfile::tempdir().unwrap();
    let sources = [1000, usize::MAX].map(|at_once| {
        let studio = Studio::with(|config| {
            config.estimate_at_once = at_once;
            config.bake_cache = Some(BakeCache::new(folder.path(), 1 << 30));
        });
        studio.write("wall.ply", wall(SIDE as usize, |x, _| [x as u8, 3, 90]));
        studio.load_json("cloud", &cloud_scene("wall.ply"));
        let baked = studio.engine.bake_all("cloud", |_| ()).unwrap();
        baked[0].source.clone()
    });
    assert_eq!(sources, [BakeSource::Stored, BakeSource::Cached]);
}
