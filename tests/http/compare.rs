//! Two settings at one pose: the figures are those of the frames that the daemon draws by themselves.

use base64::Engine as _;
use pointillist::accuracy::metrics;
use serde_json::{Value, json};

use super::client::{Client, Reply};
use super::daemon::Daemon;

const PLACE: &str = "/v1/scenes/grid/compare";
const SIZE: [u32; 2] = [48, 40];

/// The pixels of the image in a `data:` URI.
fn pixels(uri: &Value, kind: &str) -> Vec<[u8; 4]> {
    let uri = uri.as_str().unwrap_or_else(|| panic!("no image: {uri}"));
    let text = uri
        .strip_prefix(&format!("data:{kind};base64,"))
        .unwrap_or_else(|| panic!("{}", &uri[..40]));
    let bytes = base64::engine::general_purpose::STANDARD.decode(text).unwrap();
    let image = image::load_from_memory(&bytes).unwrap().to_rgba8();
    assert_eq!([image.width(), image.height()], SIZE);
    image.pixels().map(|pixel| pixel.0).collect()
}

/// The pixels of a frame, so near that points leave gaps.
fn frame(client: &Client, query: &str) -> Vec<[u8; 4]> {
    let [w, h] = SIZE;
    let reply = client.get(&format!(
        "/v1/scenes/grid/frame?eye=0,0,0.6&target=0,0,0&w={w}&h={h}&format=raw&{query}"
    ));
    assert_eq!(reply.status, 200, "{}", reply.text());
    reply.body.as_chunks().0.to_vec()
}

fn covered(client: &Client, query: &str) -> Vec<bool> {
    let seen = frame(client, &format!("{query}&background=transparent"));
    seen.into_iter().map(|pixel| pixel[3] >= 128).collect()
}

fn ask(client: &Client, more: Value) -> Reply {
    let [w, h] = SIZE;
    let mut body = json!({ "w": w, "h": h });
    if more.get("camera").is_none() {
        body["eye"] = json!([0, 0, 0.6]);
        body["target"] = json!([0, 0, 0]);
    }
    body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    client.post_json(PLACE, &body)
}

#[test]
fn figures_are_those_of_the_frames() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let (a, b) = ("reconstruct=points", "reconstruct=splats&filter=exact");
    let reply = ask(
        &client,
        json!({ "a": { "reconstruct": "points" }, "b": { "reconstruct": "splats", "filter": "exact" } }),
    );
    assert_eq!(reply.status, 200, "{}", reply.text());
    let found = reply.json();
    let (image, expected) = (frame(&client, a), frame(&client, b));
    assert_eq!(pixels(&found["a"]["image"], "image/png"), image);
    assert_eq!(pixels(&found["b"]["image"], "image/png"), expected);
    let [width, height] = SIZE;
    let near = |name: &str, value: f64| {
        assert!((found[name].as_f64().unwrap() - value).abs() < 1e-9, "{name}: {found}");
    };
    near("psnr_db", metrics::psnr(&expected, &image).unwrap());
    near("ssim", metrics::ssim(&expected, &image, width, height).unwrap());
    near("flip", metrics::flip(&expected, &image, width, height).unwrap());
    assert_eq!(found["max_error"], metrics::max_error(&expected, &image).unwrap());
    let coverage =
        metrics::coverage(&covered(&client, b), &covered(&client, a), width, height).unwrap();
    // Points leave gaps that splats close.
    assert!(coverage.holes > 0);
    assert_eq!(found["coverage"], serde_json::to_value(coverage).unwrap());
    let map = pixels(&found["difference"], "image/png");
    let darkest = map.iter().filter(|pixel| **pixel == pointillist::accuracy::report::heat(0.0));
    assert!(darkest.count() < map.len(), "the map shows the differences");
    for (side, name) in [("a", "points"), ("b", "splats")] {
        let receipt = &found[side]["receipt"];
        assert_eq!(
            (&receipt["settings"]["reconstruct"], &receipt["revision"]),
            (&json!(name), &json!(1))
        );
        let ms = receipt["gpu_ns"].as_f64().unwrap() / receipt["views"].as_f64().unwrap() / 1e6;
        assert!((found[side]["gpu_ms"].as_f64().unwrap() - ms).abs() < 1e-5, "{receipt}");
    }
    assert_eq!(
        (&found["scene"], &found["width"], &found["height"]),
        (&json!("grid"), &json!(48), &json!(40))
    );
}

#[test]
fn equal_settings_have_no_errors_and_images_are_optional() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let same = json!({ "reconstruct": "points", "a": {}, "b": { "lod": "full" }, "images": false });
    let found = ask(&client, same).json();
    assert_eq!(
        (&found["psnr_db"], &found["ssim"], &found["flip"], &found["max_error"]),
        (&Value::Null, &json!(1.0), &json!(0.0), &json!(0))
    );
    assert_eq!((&found["a"]["image"], &found["difference"]), (&Value::Null, &Value::Null));
    assert_eq!(found["b"]["receipt"]["settings"]["reconstruct"], "points", "what both share");
    let jpeg = ask(&client, json!({ "a": {}, "b": {}, "format": "jpeg", "quality": 50 })).json();
    pixels(&jpeg["a"]["image"], "image/jpeg");
}

#[test]
fn a_reference_is_drawn_in_detail() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let against = |a: Value| {
        let reply = ask(&client, json!({ "a": a, "against": "reference"}));
        assert_eq!(reply.status, 200, "{}", reply.text());
        reply.json()
    };
    let (points, fine) = (
        against(json!({ "reconstruct": "points" })),
        against(json!({ "reconstruct": "splats", "antialias": "16x" })),
    );
    let receipt = &points["b"]["receipt"];
    assert_eq!(
        (&receipt["camera"]["width"], &receipt["settings"]["reconstruct"]),
        (&json!(4 * SIZE[0]), &json!("splats"))
    );
    assert_eq!(points["b"]["image"], fine["b"]["image"], "the reference does not depend on `a`");
    let psnr = |found: &Value| found["psnr_db"].as_f64().unwrap();
    assert!(psnr(&fine) > psnr(&points) + 3.0, "{} {}", psnr(&fine), psnr(&points));
    // The background is in both.
    let more =
        json!({ "camera": "front", "a": {}, "against": "reference", "background": "#204060" });
    let far = ask(&client, more).json();
    for side in ["a", "b"] {
        assert_eq!(pixels(&far[side]["image"], "image/png")[0], [0x20, 0x40, 0x60, 255]);
    }
    // A pose by matrices is one of the reference's size, too.
    let view = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -3, 1]);
    let proj = json!([2, 0, 0, 0, 0, 2.4, 0, 0, 0, 0, -1, -1, 0, 0, -0.2, 0]);
    let [w, h] = SIZE;
    let body = json!({ "view": view, "proj": proj, "w": w, "h": h, "a": { "reconstruct": "splats" }, "against": "reference" });
    let found = client.post_json(PLACE, &body).json();
    assert!(psnr(&found) > 20.0, "{}", found["psnr_db"]);
}

/// The four frames of a comparison do not fit into the queue together.
#[test]
fn a_comparison_waits_for_its_own_frames() {
    let daemon = Daemon::start(&["--queue", "1"]);
    let client = daemon.client();
    for against in [json!({ "a": {}, "b": {} }), json!({ "a": {}, "against": "reference" })] {
        let reply = ask(&client, against);
        assert_eq!(reply.status, 200, "{}", reply.text());
    }
}

#[test]
fn refusals_name_the_parameter() {
    let daemon = Daemon::start(&["--max-pixels", "1000000"]);
    let client = daemon.client();
    for (more, status, parameter) in [
        (json!({ "a": { "reconstruct": "voxels" }, "b": {} }), 422, "a.reconstruct"),
        (json!({ "a": {}, "b": { "reconstruct": "points", "filter": "exact" } }), 422, "b.filter"),
        (json!({ "a": { "eye": [0, 0, 1] }, "b": {} }), 422, "a.eye"),
        (json!({ "a": { "lodd": "full" }, "b": {} }), 422, "a.lodd"),
        (json!({ "a": {} }), 422, "b"),
        (json!({ "b": {} }), 422, ""),
        (json!({ "a": {}, "b": {}, "against": "reference" }), 422, "against"),
        (json!({ "a": {}, "against": "oracle" }), 422, "against"),
        (json!({ "a": { "aperture": 0.1 }, "against": "reference" }), 422, "a.aperture"),
        (json!({ "a": {}, "b": {}, "camera": "back" }), 422, "camera"),
        (json!({ "a": {}, "b": {}, "output": "depth" }), 422, "output"),
        (json!({ "a": {}, "b": {}, "format": "exr" }), 422, "format"),
        (json!({ "a": {}, "b": {}, "w": 1001, "h": 1000 }), 422, "w"),
        (json!({ "a": {}, "against": "reference", "w": 300, "h": 300 }), 422, "w"),
    ] {
        let reply = ask(&client, more.clone());
        assert_eq!(reply.status, status, "{more}: {}", reply.text());
        let problem = reply.problem();
        assert_eq!(
            problem["parameter"].as_str().unwrap_or_default(),
            parameter,
            "{more}: {problem}"
        );
    }
    let reply = client.post_json("/v1/scenes/none/compare", &json!({ "a": {}, "b": {} }));
    assert_eq!(reply.problem()["type"], "urn:pointillist:problem:unknown-scene");
    // More than any comparison may have, although frames may.
    let daemon = Daemon::start(&[]);
    let limits = daemon.client().get("/v1/limits").json();
    assert!(
        limits["max_compare_pixels"].as_u64().unwrap() < limits["max_pixels"].as_u64().unwrap()
    );
    let large = json!({ "a": {}, "b": {}, "w": 2049, "h": 2048 });
    let problem = daemon.client().post_json(PLACE, &large).problem();
    assert_eq!(
        (&problem["type"], &problem["parameter"]),
        (&json!("urn:pointillist:problem:over-limit"), &json!("w"))
    );
}
