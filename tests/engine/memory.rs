//! The GPU budget: scenes come and go, and resident bytes never exceed it.

use std::sync::atomic::{AtomicBool, Ordering};

use pointillist::engine::EngineError;

use super::studio::{Studio, cloud_scene, eventually, front, same, wall};

const SIDE: usize = 110;
const SCENES: [&str; 3] = ["red", "green", "blue"];

fn write_scenes(studio: &Studio) {
    for (number, id) in SCENES.iter().enumerate() {
        let file = format!("{id}.ply");
        studio.write(
            &file,
            wall(SIDE, |x, y| {
                let mut color = [x as u8, y as u8, 40];
                color[number] = 250;
                color
            }),
        );
        studio.write(&format!("{id}.json"), cloud_scene(&file).to_string());
    }
}

#[test]
fn three_scenes_in_the_room_of_two() {
    let roomy = Studio::new();
    write_scenes(&roomy);
    let bytes_each = SCENES.map(|id| roomy.load(id, &format!("{id}.json")).gpu_bytes);
    let expected = SCENES.map(|id| roomy.bytes(&front(id, 200, 150)));
    assert!(expected[0] != expected[1] && expected[1] != expected[2]);
    assert_eq!(roomy.engine.stats().evictions, 0);

    let budget = bytes_each[0] * 5 / 2;
    let tight = Studio::with(|config| config.gpu_budget_bytes = Some(budget));
    write_scenes(&tight);
    for id in SCENES {
        tight.load(id, &format!("{id}.json"));
    }
    assert_eq!(tight.engine.limits().gpu_budget_bytes, budget);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                let used = tight.engine.stats().gpu_bytes_resident;
                assert!(used <= budget, "{used} of {budget}");
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
        });
        for _ in 0..3 {
            for (id, expected) in SCENES.iter().zip(&expected) {
                same(&tight.bytes(&front(id, 200, 150)), expected, id);
            }
        }
        // All at once. No submission may draw a scene that another of its frames has evicted.
        let tickets: Vec<_> = (0..24)
            .map(|number| {
                let mut request = front(SCENES[number % 3], 200, 150);
                request.quality = 1 + number as u8;
                (number % 3, tight.submit(&request))
            })
            .collect();
        for (number, ticket) in tickets {
            same(&ticket.wait().unwrap().bytes, &expected[number], SCENES[number]);
        }
        done.store(true, Ordering::Relaxed);
    });
    let stats = tight.engine.stats();
    // Used in rotation, the third scene is never resident.
    assert!(stats.evictions >= 7, "{} evictions", stats.evictions);
    assert_eq!(stats.uploads, stats.evictions + 2, "what was uploaded left or is one of two");
    assert!(stats.gpu_bytes_resident > 0 && stats.gpu_bytes_resident <= budget);
    let resident = tight.engine.scenes().iter().filter(|scene| scene.resident).count();
    assert_eq!(resident, 2);
}

/// Scenes that share their only asset have their own lists, and these are evicted.
#[test]
fn scenes_of_one_asset_keep_to_the_budget() {
    let scene = serde_json::json!({
        "assets": { "g": { "file": "wall.ply" } },
        "nodes": [{ "asset": "g", "repeat": { "grid": [60, 50, 1], "step": [3, 3, 0] } }],
        "lights": [],
        "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } },
    });
    let budget = 1_200_000;
    let studio = Studio::with(|config| config.gpu_budget_bytes = Some(budget));
    studio.write("wall.ply", wall(20, |x, y| [x as u8, y as u8, 40]));
    let ids: Vec<String> = (0..6).map(|number| format!("s{number}")).collect();
    for id in &ids {
        let info = studio.load_json(id, &scene);
        assert!(info.gpu_bytes > budget / 3 && info.gpu_bytes < budget, "{}", info.gpu_bytes);
    }
    let first = studio.bytes(&front("s0", 60, 40));
    for id in ids.iter().chain(&ids) {
        same(&studio.bytes(&front(id, 60, 40)), &first, id);
        let used = studio.engine.stats().gpu_bytes_resident;
        assert!(used > 0 && used <= budget, "{used} of {budget}");
        assert!(studio.engine.scene(id).unwrap().resident, "{id}");
    }
    let stats = studio.engine.stats();
    assert_eq!(stats.uploads, 1, "the asset was drawn all along");
    assert!(stats.evictions >= 8, "{} evictions", stats.evictions);
}

#[test]
fn a_scene_that_replaces_another_leaves_none_of_its_assets() {
    let studio = Studio::new();
    write_scenes(&studio);
    studio.load("keep", "green.json");
    studio.frame(&front("keep", 40, 40));
    let kept = studio.engine.stats().gpu_bytes_resident;
    let mut largest = 0;
    for round in 0..6 {
        studio.load("x", ["red.json", "blue.json"][round % 2]);
        studio.frame(&front("x", 40, 40));
        largest = largest.max(studio.engine.stats().gpu_bytes_resident);
        // The thread is busy, so that the name is in use again when it looks for removed scenes.
        let busy = studio.keep_busy("keep");
        studio.engine.remove("x").unwrap();
        studio.load("x", ["blue.json", "red.json"][round % 2]);
        let last = studio.submit(&front("x", 50, 40));
        drop(busy);
        last.wait().unwrap();
        largest = largest.max(studio.engine.stats().gpu_bytes_resident);
        studio.engine.remove("x").unwrap();
    }
    assert!(largest <= 2 * kept + kept / 10, "{largest} bytes for two scenes of {kept}");
    eventually("x being freed", || studio.engine.stats().gpu_bytes_resident == kept);
}

#[test]
fn what_can_never_fit_is_refused_at_once() {
    let studio = Studio::with(|config| config.gpu_budget_bytes = Some(100_000));
    write_scenes(&studio);
    let error = studio.try_load("red", "red.json").unwrap_err();
    let EngineError::OutOfGpuMemory { what, needed, budget } = error else {
        panic!("{error:?}");
    };
    assert!(what.contains("red"), "{what}");
    assert_eq!(budget, 100_000);
    assert!(needed >= (SIDE * SIDE * 16) as u64);
    assert!(studio.engine.scenes().is_empty());
    // The name is free, and smaller scenes can be loaded.
    studio.write("small.ply", wall(20, |_, _| [9, 9, 9]));
    studio.write("red.json", cloud_scene("small.ply").to_string());
    studio.load("red", "red.json");
    studio.frame(&front("red", 32, 32));
}

#[test]
fn failed_loads_leave_nothing_behind() {
    let studio = Studio::with_two();
    let request = front("solid", 90, 70);
    let expected = studio.bytes(&request);
    let before = studio.engine.stats();
    let good = std::fs::read_to_string(studio.folder().join("wall.ply")).unwrap();
    studio.write("broken.ply", &good[..good.len() / 2]);
    studio.write(
        "mixed.json",
        serde_json::json!({
            "assets": { "good": { "file": "wall.ply" }, "bad": { "file": "broken.ply" } },
            "nodes": [{ "asset": "good" }, { "asset": "bad" }],
        })
        .to_string(),
    );
    studio.write("wrong.json", r#"{ "assets": {}, "nodes": [{ "asset": "nothing" }] }"#);
    std::fs::create_dir(studio.folder().join("folder.ply")).unwrap();
    for (file, words) in [
        ("broken.ply", "broken.ply"),
        ("mixed.json", "broken.ply"),
        ("wrong.json", "nothing"),
        ("missing.ply", "missing.ply"),
        ("folder.ply", "folder.ply"),
        ("../wall.ply", "wall.ply"),
    ] {
        for _ in 0..2 {
            let error = studio.try_load("x", file).unwrap_err().to_string();
            assert!(error.contains(words), "{file}: {error}");
        }
    }
    assert_eq!(studio.engine.scenes().len(), 2);
    assert!(matches!(studio.engine.scene("x"), Err(EngineError::UnknownScene { .. })));
    same(&studio.bytes(&request), &expected, "as before");
    let after = studio.engine.stats();
    assert_eq!(after.uploads, before.uploads);
    assert_eq!(after.gpu_bytes_resident, before.gpu_bytes_resident);
    studio.load("x", "wall.ply");
    let twice = studio.try_load("x", "wall.ply");
    assert!(matches!(twice, Err(EngineError::SceneExists { .. })));
}

#[test]
fn loading_one_identifier_from_many_threads_works_once() {
    let studio = Studio::new();
    studio.write("wall.ply", wall(60, |_, _| [9, 9, 9]));
    for _ in 0..5 {
        let loaded = std::thread::scope(|scope| {
            let threads: Vec<_> =
                (0..8).map(|_| scope.spawn(|| studio.try_load("x", "wall.ply"))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).filter(Result::is_ok).count()
        });
        assert_eq!(loaded, 1);
        studio.engine.remove("x").unwrap();
    }
}
