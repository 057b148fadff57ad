//! Picks over HTTP.

use serde_json::{Value, json};

use super::daemon::Daemon;

const PICK: &str = "/v1/scenes/grid/pick?camera=front&w=96&h=64";

#[test]
fn a_pick_says_what_a_pixel_shows() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let depths = client.get("/v1/scenes/grid/frame?camera=front&w=96&h=64&output=depth&format=raw");
    let depths: Vec<f32> =
        depths.body.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let seen = (0..96 * 64).find(|&pixel: &usize| depths[pixel].is_finite()).unwrap();
    let (x, y) = (seen % 96, seen / 96);
    let reply = client.get(&format!("{PICK}&x={x}&y={y}"));
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert_eq!(reply.header("content-type"), Some("application/json"));
    assert_eq!(reply.header("cache-control"), Some("no-store"));
    let receipt = reply.receipt();
    let passes = receipt["passes"].as_array().unwrap();
    assert!(passes.iter().any(|pass| pass["name"] == "identify" && pass["ran"] == true));
    let answer = reply.json();
    assert_eq!((&answer["scene"], &answer["revision"]), (&json!("grid"), &json!(1)));
    assert_eq!(answer["camera"]["eye"], json!([0.0, 0.0, 3.0]));
    let hit = &answer["picks"][0]["hit"];
    let depth = hit["depth"].as_f64().unwrap();
    assert!((depth - f64::from(depths[seen])).abs() < 1e-5, "{depth}");
    assert!(hit["position"][2].as_f64().unwrap().abs() < 1e-6, "the wall lies at z = 0: {hit}");
    assert_eq!(hit["instance"]["id"], 1);
    assert_eq!(hit["kind"], "point");

    // Several pixels at once, with the frame as JSON.
    let body = json!({ "camera": "front", "w": 96, "h": 64, "pixels": [[x, y], [0, 0]] });
    let many = client.post_json("/v1/scenes/grid/pick", &body);
    assert_eq!(many.status, 200, "{}", many.text());
    assert_eq!(many.json()["picks"][0], answer["picks"][0]);
    assert_eq!(many.json()["picks"][1], json!({ "x": 0, "y": 0, "hit": Value::Null }));
    let one = json!({ "camera": "front", "w": 96, "h": 64, "x": x, "y": y });
    assert_eq!(client.post_json("/v1/scenes/grid/pick", &one).json()["picks"], answer["picks"]);
}

#[test]
fn picks_that_cannot_be_are_refused() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let refused = |query: &str| {
        let reply = client.get(&format!("{PICK}{query}"));
        let problem = reply.problem();
        (reply.status, problem["parameter"].clone(), problem["accepted"].clone())
    };
    assert_eq!(refused("&x=96&y=0"), (422, json!("x"), json!("0 to 95")));
    assert_eq!(refused("&x=0&y=64"), (422, json!("y"), json!("0 to 63")));
    for (query, parameter) in [
        ("&x=3", "y"),
        ("&x=-1&y=0", "x"),
        ("&x=1.5&y=0", "x"),
        ("&x=1&x=2&y=0", "x"),
        ("&x=0&y=0&format=png", "format"),
        ("&x=0&y=0&output=depth", "output"),
        ("&x=0&y=0&z=1", "z"),
    ] {
        let (status, at, accepted) = refused(query);
        assert_eq!((status, at), (422, json!(parameter)), "{query}");
        assert!(accepted.is_string(), "{query}");
    }
    assert_eq!(client.get("/v1/scenes/none/pick?x=0&y=0").status, 404);
    for body in [
        json!({ "pixels": [] }),
        json!({ "pixels": [[0, 0]], "x": 1 }),
        json!({ "pixels": [[0, 0, 0]] }),
        json!({ "x": 1 }),
        json!({ "x": 1, "y": 1, "quality": 3 }),
        json!({ "pixels": vec![[0, 0]; 4097] }),
    ] {
        let reply = client.post_json("/v1/scenes/grid/pick", &body);
        assert_eq!(reply.status, 422, "{}", reply.text());
    }
}
