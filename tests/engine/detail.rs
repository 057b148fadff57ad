//! `lod=spt` where point trees have little to leave out: full detail is drawn, and the receipt says so.

use pointillist::engine::FrameRequest;
use pointillist::plan::{ColorBy, Lod, MaxError, Reconstruct};
use serde_json::json;

use super::studio::{Studio, cloud_scene, front, same, sphere, wall};

fn studio() -> Studio {
    let studio = Studio::with(|config| config.may_draw_in_full = true);
    // 160,000 samples, half a pixel apart in a frame of 256 pixels.
    studio.write("wall.ply", wall(400, |x, y| [x as u8, y as u8, 90]));
    studio.load_json("cloud", &cloud_scene("wall.ply"));
    studio.write("sphere.ply", sphere(24));
    studio.load_json("ball", &cloud_scene("sphere.ply"));
    studio
}

fn tree(scene: &str, side: u32, error_px: f32) -> FrameRequest {
    let mut request = front(scene, side, side);
    request.settings.lod = Lod::Spt;
    request.settings.reconstruct = Reconstruct::Splats;
    request.settings.max_error_px = MaxError::new(error_px).unwrap();
    request
}

#[test]
fn what_a_tree_cannot_save_is_drawn_in_full() {
    let studio = studio();
    for request in [tree("ball", 64, 1.0), tree("ball", 64, 8.0), tree("cloud", 512, 1.0)] {
        assert!(!studio.engine.must_bake(&request), "no tree is needed");
        let frame = studio.frame(&request);
        let used = serde_json::to_value(&frame.receipt.settings).unwrap();
        assert_eq!(used["lod"], json!("full"));
        assert!(used["full_because"].as_str().is_some_and(|why| !why.is_empty()), "{used}");
        assert_eq!((frame.receipt.accepted_px, frame.receipt.samples.accepted), (None, None));
        let mut full = request.clone();
        full.settings.lod = Lod::Full;
        same(&frame.bytes, &studio.bytes(&full), "full detail");
        let tags =
            [&request, &full].map(|request| super::studio::etag(&studio.engine, request).unwrap());
        assert_eq!(tags[0], tags[1], "one frame has one tag");
    }
    let full = studio.frame(&FrameRequest { ..front("ball", 64, 64) });
    let used = serde_json::to_value(&full.receipt.settings).unwrap();
    assert_eq!(used.get("full_because"), None, "it was asked for");
}

#[test]
fn dense_samples_and_levels_are_drawn_from_trees() {
    let studio = studio();
    let mut levels = tree("ball", 64, 1.0);
    levels.settings.color_by = ColorBy::Levels;
    let coarse = tree("cloud", 512, 8.0);
    assert!(studio.engine.must_bake(&levels) && studio.engine.must_bake(&coarse));
    for request in [levels, tree("cloud", 64, 1.0), coarse] {
        studio.engine.bake(&request).unwrap();
        let frame = studio.frame(&request);
        let used = serde_json::to_value(&frame.receipt.settings).unwrap();
        assert_eq!((&used["lod"], used.get("full_because")), (&json!("spt"), None));
        assert!(frame.receipt.samples.accepted.is_some());
    }
}

#[test]
fn full_detail_has_to_be_allowed() {
    let studio = Studio::new();
    studio.write("sphere.ply", sphere(24));
    studio.load_json("ball", &cloud_scene("sphere.ply"));
    assert!(studio.engine.must_bake(&tree("ball", 64, 1.0)));
}
