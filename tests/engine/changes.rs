//! Scenes that are changed, removed, and loaded again.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::{DAffine3, DVec3};
use pointillist::engine::{EngineError, NodePatch};
use pointillist::plan::Output;
use serde_json::json;

use super::studio::{OUTPUTS, Studio, cloud_scene, covered, eventually, front, same, sphere, wall};

fn visible(visible: bool) -> NodePatch {
    NodePatch { visible: Some(visible), ..NodePatch::default() }
}

/// Two walls side by side. `hidden` and `right` set visibility and place of the second one.
fn pair(hidden: bool, right: [f64; 3]) -> serde_json::Value {
    json!({
        "assets": { "wall": { "file": "wall.ply" }, "ball": { "file": "ball.ply" } },
        "nodes": [
            { "name": "left", "asset": "wall", "translate": [-0.6, 0, 0], "scale": 0.5 },
            { "name": "right", "asset": "ball", "translate": right, "visible": !hidden },
        ],
        "cameras": { "front": { "eye": [0, 0, 4], "target": [0, 0, 0], "fov": 45 } },
    })
}

#[test]
fn a_patched_scene_looks_like_one_written_so() {
    let studio = Studio::new();
    studio.write("wall.ply", wall(50, |x, _| [x as u8 * 5, 100, 100]));
    studio.write("ball.ply", sphere(12));
    studio.load_json("hidden", &pair(true, [0.6, 0.0, 0.0]));
    studio.load_json("moved", &pair(false, [0.1, 0.5, -1.0]));
    let info = studio.load_json("scene", &pair(false, [0.6, 0.0, 0.0]));
    assert_eq!(info.nodes, ["left", "right"]);
    let look = |id: &str| {
        OUTPUTS.map(|output| {
            let mut request = front(id, 120, 80);
            request.output = output;
            studio.bytes(&request)
        })
    };
    let (first, hidden, moved) = (look("scene"), look("hidden"), look("moved"));
    assert!(first[0] != hidden[0] && first[0] != moved[0]);
    let uploads = studio.engine.stats().uploads;
    assert_eq!(uploads, 2, "two files, whoever draws them");

    let engine = &studio.engine;
    assert_eq!(engine.patch("scene", "right", &visible(false)).unwrap().revision, 2);
    let frame = studio.frame(&front("scene", 120, 80));
    assert_eq!(frame.receipt.revision, 2);
    assert!(look("scene") == hidden, "hidden");
    engine.patch("scene", "right", &visible(true)).unwrap();
    assert!(look("scene") == first, "shown again");
    let place = DAffine3::from_translation(DVec3::new(0.1, 0.5, -1.0));
    let shift = NodePatch { world_from_node: Some(place), ..NodePatch::default() };
    let info = engine.patch("scene", "right", &shift).unwrap();
    assert_eq!(info.revision, 4);
    assert_eq!(info.bounds, engine.scene("moved").unwrap().bounds);
    assert!(look("scene") == moved, "moved");
    for _ in 0..40 {
        engine.patch("scene", "left", &visible(false)).unwrap();
        studio.frame(&front("scene", 16, 16));
        engine.patch("scene", "left", &visible(true)).unwrap();
    }
    assert!(look("scene") == moved, "moved");
    let stats = engine.stats();
    assert_eq!((stats.uploads, stats.evictions), (uploads, 0), "only transforms were written");

    let unknown = engine.patch("scene", "middle", &visible(true));
    assert!(matches!(unknown, Err(EngineError::UnknownNode { node, .. }) if node == "middle"));
    assert!(matches!(
        engine.patch("nowhere", "left", &visible(true)),
        Err(EngineError::UnknownScene { .. })
    ));
}

#[test]
fn a_patch_that_does_not_fit_changes_nothing() {
    let grid = |visible| {
        json!({
            "assets": { "g": { "file": "wall.ply" } },
            "nodes": [
                { "name": "one", "asset": "g" },
                { "name": "many", "asset": "g", "visible": visible,
                  "repeat": { "grid": [40, 40, 1], "step": [3, 3, 0] } },
            ],
            "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } },
        })
    };
    let studio = Studio::with(|config| config.gpu_budget_bytes = Some(60_000));
    studio.write("wall.ply", wall(40, |_, _| [200, 100, 50]));
    studio.load_json("scene", &grid(false));
    let before = studio.bytes(&front("scene", 50, 50));
    let error = studio.engine.patch("scene", "many", &visible(true)).unwrap_err();
    assert!(matches!(error, EngineError::OutOfGpuMemory { .. }), "{error}");
    assert_eq!(studio.engine.scene("scene").unwrap().revision, 1);
    same(&studio.bytes(&front("scene", 50, 50)), &before, "as before");
}

/// No request waits for a patch in progress, and no patch is lost.
#[test]
fn patches_keep_nobody_waiting() {
    const LONG: Duration = Duration::from_secs(60);
    let (begin, begun) = sync_channel(16);
    let (go, may_go) = sync_channel(16);
    let may_go = Mutex::new(may_go);
    let studio = Studio::with(|config| {
        config.patch_hook = Some(Arc::new(move || {
            begin.send(()).unwrap();
            may_go.lock().unwrap().recv().unwrap();
        }));
    });
    studio.load_two();
    let engine = &studio.engine;
    std::thread::scope(|scope| {
        let patching = scope.spawn(|| engine.patch("cloud", "wall", &visible(false)));
        begun.recv_timeout(LONG).unwrap();
        let (sender, looked) = sync_channel(1);
        let other = engine.clone();
        std::thread::spawn(move || {
            let looks = (other.scenes().len(), other.scene("cloud").unwrap().revision);
            let frame = other.submit(front("cloud", 40, 40)).unwrap().wait();
            sender.send((looks, frame.is_ok())).unwrap();
        });
        let looked = looked.recv_timeout(LONG).expect("somebody waits for the patch");
        assert_eq!(looked, ((2, 1), true), "the scene is as it was");
        go.send(()).unwrap();
        assert_eq!(patching.join().unwrap().unwrap().revision, 2);
    });
    std::thread::scope(|scope| {
        for _ in 0..8 {
            go.send(()).unwrap();
        }
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..2 {
                    engine.patch("cloud", "wall", &visible(false)).unwrap();
                }
            });
        }
    });
    assert_eq!(begun.try_iter().count(), 8);
    assert_eq!(engine.scene("cloud").unwrap().revision, 10, "each patch is a revision");
    // A scene that is removed during a patch does not come back.
    std::thread::scope(|scope| {
        let patching = scope.spawn(|| engine.patch("cloud", "wall", &visible(true)));
        begun.recv_timeout(LONG).unwrap();
        engine.remove("cloud").unwrap();
        // Another scene with its id is not patched in its place.
        let again = studio.load("cloud", "cloud.json");
        assert_eq!(again.revision, 1);
        go.send(()).unwrap();
        let patched = patching.join().unwrap();
        assert!(matches!(patched, Err(EngineError::UnknownScene { .. })), "{patched:?}");
    });
    assert_eq!(engine.scene("cloud").unwrap().revision, 1);
}

#[test]
fn removing_a_scene_frees_its_memory() {
    let studio = Studio::with_two();
    studio.frame(&front("solid", 40, 40));
    let resident = || studio.engine.stats().gpu_bytes_resident;
    assert!(studio.engine.scene("solid").unwrap().resident, "known as soon as a frame is there");
    let one = resident();
    studio.write("own.ply", wall(70, |_, _| [1, 2, 3]));
    studio.load_json("own", &cloud_scene("own.ply"));
    studio.frame(&front("own", 40, 40));
    eventually("both being resident", || resident() > one);
    studio.engine.remove("own").unwrap();
    eventually("own being freed", || resident() == one);
    // Frames that were requested before are drawn, and leave nothing behind.
    let busy = studio.keep_busy("solid");
    let last = studio.submit(&front("cloud", 30, 30));
    studio.engine.remove("solid").unwrap();
    studio.engine.remove("cloud").unwrap();
    assert!(last.wait().is_ok());
    assert!(busy.into_iter().all(|ticket| ticket.wait().is_ok()));
    eventually("everything being freed", || resident() == 0);
    assert!(matches!(studio.engine.remove("own"), Err(EngineError::UnknownScene { .. })));
    assert!(matches!(
        studio.engine.submit(front("own", 40, 40)),
        Err(EngineError::UnknownScene { .. })
    ));
}

#[test]
fn a_name_used_again_never_shows_the_scene_before() {
    let studio = Studio::new();
    studio.write("red.ply", wall(30, |_, _| [250, 0, 0]));
    studio.write("blue.ply", wall(30, |_, _| [0, 0, 250]));
    let (red, blue) = (cloud_scene("red.ply"), cloud_scene("blue.ply"));
    studio.load_json("red", &red);
    studio.load_json("blue", &blue);
    let request = front("x", 40, 40);
    let expected = [studio.bytes(&front("red", 40, 40)), studio.bytes(&front("blue", 40, 40))];
    assert!(expected[0] != expected[1]);
    for round in 0..30 {
        let file = ["red.json", "blue.json"][round % 2];
        studio.load("x", file);
        same(&studio.bytes(&request), &expected[round % 2], &format!("round {round}"));
        studio.engine.remove("x").unwrap();
    }
}

#[test]
fn nothing_to_see_is_all_background() {
    let studio = Studio::with_two();
    studio.load_json(
        "empty",
        &json!({
            "assets": {}, "nodes": [],
            "background": "#10305080",
            "cameras": { "front": { "eye": [0, 0, 4], "target": [0, 0, 0], "fov": 45 } },
        }),
    );
    for node in ["back", "balls"] {
        studio.load("hide", "solid.json");
        studio.engine.patch("hide", node, &visible(false)).unwrap();
        studio.engine.remove("hide").unwrap();
    }
    studio.load("hide", "solid.json");
    studio.engine.patch("hide", "back", &visible(false)).unwrap();
    studio.engine.patch("hide", "balls", &visible(false)).unwrap();
    for (id, color) in [("hide", [0x20, 0x24, 0x28, 0xff]), ("empty", [0x10, 0x30, 0x50, 0x80])] {
        for output in OUTPUTS {
            let busy = pointillist::engine::FrameRequest { output, ..front("solid", 150, 90) };
            let empty = pointillist::engine::FrameRequest { output, ..front(id, 150, 90) };
            // Submitted in succession, so that they may share a batch.
            let tickets = [studio.submit(&busy), studio.submit(&empty)];
            let [_, bytes] = tickets.map(|ticket| ticket.wait().unwrap().bytes.clone());
            let all = |word: [u8; 4]| bytes.chunks_exact(4).all(|pixel| pixel == word);
            assert_eq!(bytes.len(), 150 * 90 * 4);
            match output {
                Output::Color => assert!(all(color), "{id}: {:?}", &bytes[..4]),
                Output::Depth => assert_eq!(covered(&bytes), 0, "{id}"),
                Output::Normal | Output::Id => assert!(all([0; 4]), "{id} {output:?}"),
            }
        }
    }
}
