//! Frames of point trees are equal byte for byte, whether the trees were built, read from the cache, or built again because an
//! entry was damaged.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::DVec3;
use pointillist::bake::cache::BakeCache;
use pointillist::engine::{BakeSource, EngineError, FrameRequest, Latch, NodePatch, Resolution};
use pointillist::film::{self, shots::Shots};
use pointillist::plan::Lod;
use pointillist::scene::parse_path;
use serde_json::json;

use super::studio::{Studio, cloud_scene, eventually, front, same, wall};

/// A studio whose bakes wait until the latch is open.
fn latched() -> (Arc<Latch>, Studio) {
    let latch = Arc::new(Latch::default());
    let studio = Studio::with(|config| config.bake_latch = Some(latch.clone()));
    (latch, studio)
}

/// A request for a frame of point trees.
fn of_trees(scene: &str, width: u32, height: u32) -> FrameRequest {
    let mut request = front(scene, width, height);
    request.settings.lod = Lod::Spt;
    request
}

/// Frames of both scenes in a new engine, and the sources of their trees.
fn frames(cache: Option<&Path>) -> (Vec<Vec<u8>>, Vec<BakeSource>) {
    let cache = cache.map(|folder| BakeCache::new(folder, 1 << 30));
    let studio = Studio::with(|config| config.bake_cache = cache);
    studio.load_two();
    let mut frames = Vec::new();
    let mut sources = Vec::new();
    for scene in ["solid", "cloud"] {
        let baked = studio.engine.bake_all(scene, |_| ()).unwrap();
        sources.extend(baked.into_iter().map(|asset| asset.source));
        let request = of_trees(scene, 160, 120);
        frames.push(studio.bytes(&request));
        let again = studio.engine.bake_all(scene, |_| ()).unwrap();
        assert!(again.iter().all(|asset| asset.source == BakeSource::Kept));
    }
    (frames, sources)
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn the_cache_changes_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    // Both scenes share an asset.
    let all = |sources: &[BakeSource], expected: [BakeSource; 2]| {
        assert!(sources.iter().all(|source| expected.contains(source)), "{sources:?}");
    };
    let (expected, sources) = frames(None);
    all(&sources, [BakeSource::Built, BakeSource::Kept]);
    let check = |what: &str| {
        let (found, sources) = frames(Some(folder.path()));
        for (found, expected) in found.iter().zip(&expected) {
            same(found, expected, what);
        }
        sources
    };
    all(&check("built and stored"), [BakeSource::Stored, BakeSource::Kept]);
    all(&check("from the cache"), [BakeSource::Cached, BakeSource::Kept]);
    let files = entries(folder.path());
    let bytes: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    for (file, bytes) in files.iter().zip(&bytes) {
        let mut damaged = bytes.clone();
        damaged[bytes.len() * 2 / 3] ^= 0x10;
        std::fs::write(file, damaged).unwrap();
    }
    all(&check("built again"), [BakeSource::Stored, BakeSource::Kept]);
    assert_eq!(entries(folder.path()), files);
    for (file, bytes) in files.iter().zip(&bytes) {
        same(&std::fs::read(file).unwrap(), bytes, &file.display().to_string());
    }
}

/// A scene of many assets that each take a while to bake.
fn orchard(studio: &Studio) -> FrameRequest {
    let (mut assets, mut nodes) = (json!({}), Vec::new());
    for number in 0..16 {
        let file = format!("wall{number}.ply");
        studio.write(&file, wall(120 + number, |x, y| [x as u8, y as u8, 90]));
        assets[&file] = json!({ "file": file });
        nodes.push(json!({ "asset": file, "translate": [0, 0, number] }));
    }
    let cameras = json!({ "front": { "eye": [0, 0, 40], "target": [0, 0, 0], "fov": 45 } });
    studio.load_json("many", &json!({ "assets": assets, "nodes": nodes, "cameras": cameras }));
    of_trees("many", 64, 48)
}

#[test]
fn who_waits_for_the_same_bake_waits_together_and_nobody_bakes_for_nobody() {
    let studio = Studio::new();
    let request = orchard(&studio);
    let engine = &studio.engine;
    let join = || engine.begin_bake(&request).unwrap().unwrap();
    let (mut first, second) = (join(), join());
    assert_eq!(engine.bakes_running(), 1);
    let mut seen = 0.0;
    let stopped = first.wait_while(|done| {
        assert!((0.0..=1.0).contains(&done) && done >= seen, "{done} after {seen}");
        seen = done;
        done == 0.0
    });
    assert!(stopped.is_none(), "{stopped:?}");
    drop(first);
    assert_eq!(engine.bakes_running(), 1, "the other one waits still");
    assert_eq!(engine.bake_waiters(), 1, "who has left is not counted");
    assert!(engine.must_bake(&request));
    drop(second);
    eventually("the end of the bake", || engine.bakes_running() == 0);
    assert!(engine.must_bake(&request), "it was given up");
    // A bake that was given up begins anew, for tasks and for threads.
    let ticket = join();
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| join().wait());
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(ticket).unwrap();
        waiting.join().unwrap().unwrap();
    });
    assert!(!engine.must_bake(&request) && engine.begin_bake(&request).unwrap().is_none());
    assert!(!studio.bytes(&request).is_empty());
    let unknown = front("none", 8, 8);
    assert!(matches!(engine.begin_bake(&unknown), Err(EngineError::UnknownScene { .. })));
}

/// Requests for scenes that are not baked yet share one bake, and fail when the scene is removed.
#[test]
fn deleting_a_scene_ends_its_bakes() {
    let (latch, studio) = latched();
    let engine = &studio.engine;
    studio.load_two();
    let request = of_trees("cloud", 64, 48);
    let Resolution::NeedsBake(unbaked) = engine.resolve(request.clone()).unwrap() else {
        panic!("there are no trees yet")
    };
    assert_eq!(engine.bakes_running(), 0, "resolving begins nothing");
    let unknown = |error| matches!(error, EngineError::UnknownScene { .. });
    std::thread::scope(|scope| {
        let waiting = [
            scope.spawn(|| {
                unknown(engine.begin_bake(&request).unwrap().unwrap().wait().unwrap_err())
            }),
            scope.spawn(|| unknown(super::studio::etag(engine, &request).unwrap_err())),
            scope.spawn(|| unknown(engine.submit(request.clone()).err().unwrap())),
        ];
        eventually("all to wait", || engine.bake_waiters() == waiting.len());
        assert_eq!(engine.bakes_running(), 1);
        engine.remove("cloud").unwrap();
        assert!(waiting.into_iter().all(|waiter| waiter.join().unwrap()));
    });
    // A new scene of the same name does not concern the request.
    studio.load("cloud", "cloud.json");
    assert!(unbaked.begin().is_err_and(unknown));
    eventually("the end of the bake", || engine.bakes_running() == 0);
    latch.open();
    assert!(!studio.bytes(&request).is_empty());
}

/// A film that is told to stop waits for no bake.
#[test]
fn a_stop_ends_a_films_wait_for_its_bake() {
    let (latch, studio) = latched();
    let engine = &studio.engine;
    studio.load_two();
    let request = of_trees("cloud", 64, 48);
    let path = json!({ "fps": 2, "keys": [
        { "t": 0, "eye": [0, 0, 4], "target": [0, 0, 0] },
        { "t": 1, "eye": [1, 0, 4], "target": [0, 0, 0] },
    ] });
    let path = parse_path(&path.to_string(), "path", DVec3::Y).unwrap();
    let shots = Shots::new(&path, None, None, None).unwrap();
    let bake = |stop| film::bake(engine, &request, &shots, &AtomicBool::new(stop)).unwrap();
    assert!(!bake(true), "the latch is shut");
    eventually("the end of the bake", || engine.bakes_running() == 0);
    latch.open();
    assert!(bake(false));
    assert!(!engine.must_bake(&request));
}

/// The number of concurrent bakes is limited, whatever requests them.
#[test]
fn frames_and_tags_bake_within_the_limit() {
    let (latch, studio) = latched();
    let engine = &studio.engine;
    let names: Vec<String> = (0..6).map(|number| format!("cloud{number}")).collect();
    for name in &names {
        studio.write(&format!("{name}.ply"), wall(20, |x, y| [x as u8, y as u8, name.len() as u8]));
        studio.load_json(name, &cloud_scene(&format!("{name}.ply")));
    }
    std::thread::scope(|scope| {
        for (number, name) in names.iter().enumerate() {
            scope.spawn(move || {
                let request = of_trees(name, 32, 24);
                match number % 2 {
                    0 => drop(super::studio::etag(engine, &request).unwrap()),
                    _ => drop(engine.submit(request).unwrap().wait().unwrap()),
                }
            });
        }
        eventually("all to wait", || engine.bake_waiters() == names.len());
        assert_eq!(engine.bakes_running(), 2);
        latch.open();
    });
    assert_eq!((engine.bakes_running(), engine.bake_waiters()), (0, 0));
}

/// The frame of a request that waited for a bake shows the revision that was baked, so patches cannot delay it.
#[test]
fn patches_during_a_bake_delay_no_frame() {
    let (latch, studio) = latched();
    let engine = &studio.engine;
    studio.load_two();
    let request = of_trees("cloud", 32, 24);
    let frame = std::thread::scope(|scope| {
        let frame = scope.spawn(|| engine.submit(request.clone()).unwrap().wait().unwrap());
        eventually("the bake", || engine.bakes_running() == 1);
        engine
            .patch("cloud", "wall", &NodePatch { visible: Some(false), ..NodePatch::default() })
            .unwrap();
        latch.open();
        frame.join().unwrap()
    });
    assert_eq!(frame.receipt.revision, 1);
    assert_eq!(studio.frame(&request).receipt.revision, 2);
}
