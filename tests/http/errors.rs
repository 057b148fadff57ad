//! Every refusal: status, stable type, and parameter at fault.

use serde_json::json;

use super::daemon::Daemon;

#[test]
fn refusals_of_frames() {
    let daemon = Daemon::start(&["--max-side", "256", "--max-pixels", "40000"]);
    let client = daemon.client();
    for (query, kind, parameter) in [
        ("w=0", "bad-parameter", "w"),
        ("w=x", "bad-parameter", "w"),
        ("w=10&w=10", "bad-parameter", "w"),
        ("eye=1,2,3", "bad-parameter", "target"),
        ("eye=1,2&target=0,0,0", "bad-parameter", "eye"),
        ("eye=1,2,3&target=1,2,3", "bad-parameter", "target"),
        ("eye=0,0,1&target=0,0,0&up=0,0,0", "bad-parameter", "up"),
        ("up=w", "bad-parameter", "up"),
        ("eye=0,0,1&target=0,0,0&fov=180", "bad-parameter", "fov"),
        ("camera=front&fov=20", "bad-parameter", "fov"),
        ("fov=40&ortho_height=2", "bad-parameter", "ortho_height"),
        ("projection=perspective&ortho_height=2", "bad-parameter", "ortho_height"),
        ("camera=front&ortho_height=2", "bad-parameter", "ortho_height"),
        ("ortho_height=0", "bad-parameter", "ortho_height"),
        ("projection=flat", "bad-parameter", "projection"),
        (
            "view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,-3,1&proj=1,0,0,0,0,1,0,0,0,0,-1,-1,0,0,-0.2,0&projection=orthographic&w=64&h=64",
            "bad-parameter",
            "projection",
        ),
        ("camera=nobody", "bad-parameter", "camera"),
        ("view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1", "bad-parameter", "proj"),
        ("format=gif", "bad-parameter", "format"),
        ("format=jpeg&output=depth", "bad-parameter", "format"),
        ("quality=0", "bad-parameter", "quality"),
        ("output=colour", "bad-parameter", "output"),
        ("lod=coarse", "bad-parameter", "lod"),
        ("reconstruct=disks", "bad-parameter", "reconstruct"),
        ("reconstruct=points&prefilter=true", "bad-parameter", "prefilter"),
        ("reconstruct=points&blend=opaque", "bad-parameter", "blend"),
        ("reconstruct=points&shading=splat", "bad-parameter", "shading"),
        ("reconstruct=points&filter=exact", "bad-parameter", "filter"),
        ("reconstruct=splats&filter=box", "bad-parameter", "filter"),
        ("reconstruct=splats&prefilter=1", "bad-parameter", "prefilter"),
        ("reconstruct=splats&blend=sorted", "bad-parameter", "blend"),
        ("reconstruct=splats&shading=flat", "bad-parameter", "shading"),
        ("reconstruct=splats&shading=splat&shading=splat", "bad-parameter", "shading"),
        ("deadline_ms=-1", "bad-parameter", "deadline_ms"),
        ("lod=full&max_error_px=1", "bad-parameter", "max_error_px"),
        ("lod=spt&max_error_px=99", "bad-parameter", "max_error_px"),
        ("color_by=levels", "bad-parameter", "color_by"),
        ("color_by=intensity", "bad-parameter", "color_by"),
        ("color_by=field", "bad-parameter", "field"),
        ("color_by=field&field=heat", "bad-parameter", "field"),
        ("color_by=height&field=heat", "bad-parameter", "field"),
        ("clip_boxes=0,0,0,1,1", "bad-parameter", "clip_boxes"),
        ("clip_boxes=0,0,0,1,-1,1", "bad-parameter", "clip_boxes"),
        ("clip_node=wall", "bad-parameter", "clip_node"),
        ("clip_boxes=0,0,0,1,1,1&clip_node=roof", "bad-parameter", "clip_node"),
        ("budget_ms=0", "bad-parameter", "budget_ms"),
        ("min_psnr_db=x", "bad-parameter", "min_psnr_db"),
        ("aperture=-1", "bad-parameter", "aperture"),
        ("aperture=0.1&ortho_height=2", "bad-parameter", "aperture"),
        ("aperture=0.1&budget_ms=9", "bad-parameter", "aperture"),
        ("aperture=1e9&focus_distance=1e-6", "bad-parameter", "aperture"),
        ("focus_distance=2", "bad-parameter", "focus_distance"),
        ("aperture=0.1&focus_distance=0", "bad-parameter", "focus_distance"),
        ("eye_offset=1&ortho_height=2", "bad-parameter", "eye_offset"),
        ("eye_offset=1e9&stereo_distance=1e-6", "bad-parameter", "eye_offset"),
        ("stereo_distance=2", "bad-parameter", "stereo_distance"),
        ("shutter=1.5", "bad-parameter", "shutter"),
        ("blur_samples=5", "bad-parameter", "blur_samples"),
        ("blur_samples=64", "bad-parameter", "blur_samples"),
        ("aperture=0.1&blur_samples=256&w=100&h=100", "over-limit", "blur_samples"),
        ("effects=shadows", "unavailable-parameter", "effects"),
        ("width=3", "unknown-parameter", "width"),
        ("recontruct=points", "unknown-parameter", "recontruct"),
        ("reconstruct=splats&lowpass=1", "unknown-parameter", "lowpass"),
    ] {
        let size = if query.contains("w=") { "" } else { "&w=8&h=8" };
        let reply = client.get(&format!("/v1/scenes/grid/frame?{query}{size}"));
        let problem = reply.problem();
        assert_eq!(reply.status, 422, "{query}");
        assert_eq!(
            problem["type"],
            format!("urn:pointillist:problem:{kind}"),
            "{query}: {problem}"
        );
        assert_eq!(problem["parameter"], parameter, "{query}: {problem}");
    }
    for query in ["w=257&h=8", "w=8&h=257", "w=250&h=250"] {
        let reply = client.get(&format!("/v1/scenes/grid/frame?{query}"));
        assert_eq!(reply.status, 422, "{query}: {}", reply.text());
        reply.problem();
    }
    assert_eq!(client.get("/v1/scenes/grid/frame?w=200&h=200").status, 200);
    let reply = client.send("GET", "/v1/scenes/grid/frame", &[("accept", "text/html")], None);
    assert_eq!((reply.status, &reply.problem()["parameter"]), (406, &json!("Accept")));
    // The problem names the limit of a side, however far the side exceeds it.
    for side in [257, 100_000] {
        let problem = client.get(&format!("/v1/scenes/grid/frame?w={side}")).problem();
        let detail = problem["detail"].as_str().unwrap_or_default();
        assert!(problem["parameter"] == "w" && detail.contains("limit of 256"), "{problem}");
        let job = json!({ "scene": "grid", "path": "past", "w": side, "h": 8 }).to_string();
        let json_type = [("content-type", "application/json")];
        let problem = client.send("POST", "/v1/jobs", &json_type, Some(job.as_bytes())).problem();
        let detail = problem["detail"].as_str().unwrap_or_default();
        assert!(problem["parameter"] == "w" && detail.contains("limit of 256"), "{problem}");
    }
    let limits = client.get("/v1/limits").json();
    assert_eq!((&limits["max_side"], &limits["max_pixels"]), (&json!(256), &json!(40000)));
}

#[test]
fn refusals_of_routes_and_bodies() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for path in
        ["/v1/scenes/none", "/v1/scenes/none/frame", "/v1/scene", "/x", "/v1/scenes/grid/%ff"]
    {
        let reply = client.get(path);
        assert_eq!(reply.status, 404, "{path}");
        reply.problem();
    }
    for (method, path) in [
        ("DELETE", "/v1/scenes"),
        ("POST", "/v1/scenes/grid/frame"),
        ("GET", "/v1/scenes/grid/frames"),
        ("GET", "/v1/scenes/grid/nodes/wall"),
        ("POST", "/healthz"),
    ] {
        let reply = client.send(method, path, &[], None);
        assert_eq!(reply.status, 405, "{method} {path}");
        reply.problem();
        assert!(reply.header("allow").is_some_and(|allow| !allow.is_empty()), "{method} {path}");
    }
    let json = [("content-type", "application/json")];
    let frames = "/v1/scenes/grid/frames";
    let node = "/v1/scenes/grid/nodes/wall";
    for (method, path, body, status) in [
        ("POST", frames, "{\"poses\": [", 422),
        ("POST", frames, "{\"poses\": []}", 422),
        ("POST", frames, "{}", 422),
        ("POST", frames, "[]", 422),
        ("POST", frames, "{\"poses\": [{}], \"width\": 3}", 422),
        ("POST", "/v1/scenes/none/frames", "{\"poses\": [{}]}", 404),
        ("PATCH", node, "{}", 422),
        ("PATCH", node, "{\"scale\": 0}", 422),
        ("PATCH", node, "{\"translated\": 0}", 422),
        ("PATCH", "/v1/scenes/grid/nodes/none", "{\"visible\": true}", 404),
        ("PATCH", "/v1/scenes/none/nodes/wall", "{\"visible\": true}", 404),
        ("POST", "/v1/scenes", "{\"assets\": 3", 422),
        ("POST", "/v1/scenes", "{\"assets\": {}, \"nods\": []}", 422),
        (
            "POST",
            "/v1/scenes",
            "{\"assets\": {\"a\": {\"file\": \"none.ply\"}}, \"nodes\": []}",
            422,
        ),
        (
            "POST",
            "/v1/scenes",
            "{\"assets\": {\"a\": {\"file\": \"/etc/passwd\"}}, \"nodes\": []}",
            422,
        ),
        ("POST", "/v1/scenes", "{\"assets\": {\"a\": {\"file\": \"../log\"}}, \"nodes\": []}", 422),
        ("POST", "/v1/scenes?id=No", "{}", 422),
        ("POST", "/v1/scenes?ids=no", "{}", 422),
        ("POST", "/v1/scenes?id=grid", "{}", 409),
        ("POST", "/v1/scenes?id=one&id=two", "{}", 422),
        ("POST", "/v1/scenes?name=a.ply&name=b.ply", "ply", 422),
    ] {
        let reply = client.send(method, path, &json, Some(body.as_bytes()));
        assert_eq!(reply.status, status, "{method} {path} {body}: {}", reply.text());
        let problem = reply.problem();
        let root = daemon.root().canonicalize().unwrap().display().to_string();
        assert!(!problem.to_string().contains(&root), "{problem} tells where the root is");
    }
    for (path, content_type) in [(frames, "text/plain"), (node, "text/plain"), ("/v1/scenes", "")] {
        let method = if path == node { "PATCH" } else { "POST" };
        let headers = [("content-type", content_type)];
        let headers = if content_type.is_empty() { &[][..] } else { &headers[..] };
        let reply = client.send(method, path, headers, Some(b"{}"));
        assert_eq!(reply.status, 415, "{path}: {}", reply.text());
        reply.problem();
    }
    let large = format!("{{\"visible\": true, \"x\": \"{}\"}}", "x".repeat(100_000));
    let reply = client.send("PATCH", node, &json, Some(large.as_bytes()));
    assert_eq!(reply.status, 413, "{}", reply.text());
    assert_eq!(client.send("DELETE", "/v1/scenes/none", &[], None).status, 404);
    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
}

#[test]
fn a_key_that_comes_twice_is_refused_where_it_is() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let json = [("content-type", "application/json")];
    for (method, path, body, place) in [
        ("PATCH", "/v1/scenes/grid/nodes/wall", r#"{"scale": 1, "scale": 2}"#, "scale"),
        (
            "POST",
            "/v1/scenes/grid/frames",
            r#"{"poses": [{"camera": "front"}, {"camera": "front", "camera": "back"}]}"#,
            "poses[1].camera",
        ),
        ("POST", "/v1/jobs", r#"{"scene": "grid", "path": "past", "w": 8, "w": 9}"#, "w"),
        (
            "POST",
            "/v1/jobs",
            r#"{"scene": "grid", "path": {"keys": [{"t": 0, "eye": [0, 0, 3], "t": 1}]}}"#,
            "path.keys[0].t",
        ),
    ] {
        let reply = client.send(method, path, &json, Some(body.as_bytes()));
        let problem = reply.problem();
        let told = problem["detail"].as_str().unwrap();
        assert_eq!((reply.status, &problem["parameter"]), (422, &place.into()), "{problem}");
        assert!(told.contains("duplicate key"), "{told}");
    }
}

#[test]
fn keys_open_what_their_scope_says() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keys");
    // SHA-256 of `reader` and of `writer`.
    let keys = "eye read 3d0941964aa3ebdcb00ccef58b1bb399f9f898465e9886d5aec7f31090a0fb30\n\
                hand write b93006774cbdd4b299389a03ac3d88c3a76b460d538795bc12718011a909fba5\n";
    std::fs::write(&file, keys).unwrap();
    let daemon = Daemon::start(&["--api-keys", file.to_str().unwrap()]);
    assert!(daemon.greeting.iter().any(|line| line.contains("Authorization: Bearer")));
    let client = daemon.client();
    let status = |method: &str, path: &str, key: &str| {
        let bearer = format!("Bearer {key}");
        let headers = [("authorization", bearer.as_str())];
        let headers = if key.is_empty() { &[][..] } else { &headers[..] };
        client.send(method, path, headers, None).status
    };
    let frame = "/v1/scenes/grid/frame?w=8&h=8";
    assert_eq!(status("GET", frame, ""), 401);
    assert_eq!(status("GET", frame, "wrong"), 401);
    assert_eq!(status("GET", frame, "reader"), 200);
    assert_eq!(status("DELETE", "/v1/scenes/grid", "reader"), 403);
    // Measuring changes what others see, and takes their time; comparing is drawing. Requests without a body are refused later.
    let accuracy = "/v1/scenes/grid/accuracy";
    assert_eq!(status("GET", accuracy, ""), 401);
    assert_eq!(status("GET", accuracy, "reader"), 200);
    assert_eq!(status("POST", accuracy, "reader"), 403);
    assert_eq!(status("POST", &format!("{accuracy}/cancel"), "reader"), 403);
    assert_eq!(status("DELETE", accuracy, "reader"), 403);
    assert_eq!(status("POST", accuracy, "writer"), 415);
    assert_eq!(status("POST", "/v1/scenes/grid/compare", ""), 401);
    assert_eq!(status("POST", "/v1/scenes/grid/compare", "reader"), 415);
    assert_eq!(status("GET", "/metrics", ""), 401);
    assert_eq!(status("GET", "/healthz", ""), 200);
    assert_eq!(status("GET", "/readyz", ""), 200);
    let refused = client.get(frame);
    assert_eq!(refused.header("www-authenticate"), Some("Bearer"));
    refused.problem();
    // A scene of the root is the admin's.
    assert_eq!(status("DELETE", "/v1/scenes/grid", "writer"), 403);
}

#[test]
fn other_origins_cannot_change_scenes() {
    let daemon = Daemon::start(&["--cors-origin", "https://app.example"]);
    let client = daemon.client();
    let from =
        |origin: &str| client.send("DELETE", "/v1/scenes/none", &[("origin", origin)], None).status;
    assert_eq!(from("https://evil.example"), 403);
    assert_eq!(from("https://app.example"), 404);
    let reply = client.send("GET", "/v1/limits", &[("origin", "https://app.example")], None);
    assert_eq!(reply.header("access-control-allow-origin"), Some("https://app.example"));
    let reply = client.send("GET", "/v1/limits", &[("origin", "https://evil.example")], None);
    assert_eq!(reply.header("access-control-allow-origin"), None);
}

/// A page whose host name resolves to 127.0.0.1 sends that name.
#[test]
fn on_loopback_other_names_are_refused() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let called = |path: &str, host: &str| client.send("GET", path, &[("host", host)], None);
    for path in ["/", "/healthz", "/v1/scenes", "/v1/scenes/grid/frame?w=8&h=8", "/nothing"] {
        let reply = called(path, "evil.example");
        assert_eq!(reply.status, 421, "{path}");
        assert_eq!(reply.problem()["type"], "urn:pointillist:problem:wrong-host");
    }
    assert_eq!(called("/v1/scenes", "localhost:1234").status, 200);
    let daemon = daemon.restart(&["--insecure"]);
    let called = daemon.client().send("GET", "/v1/scenes", &[("host", "render.example")], None);
    assert_eq!(called.status, 200, "behind a proxy");
}

#[test]
fn bodies_that_trickle_are_given_up() {
    use std::io::Write;
    let daemon = Daemon::start(&["--read-timeout-seconds", "1"]);
    let head = "POST /v1/scenes?id=slow&name=a.ply HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n";
    let mut stream = super::client::raw(daemon.address, head.as_bytes());
    let mut writer = stream.try_clone().unwrap();
    let sender = std::thread::spawn(move || {
        // Ten bytes a second without long pauses, as long as they are accepted.
        for _ in 0..300 {
            if writer.write_all(b"x").is_err() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
    });
    let began = std::time::Instant::now();
    let answer = super::client::read_to_close(&mut stream);
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("request-timeout"), "{answer}");
    assert!(began.elapsed().as_secs() < 15, "{:?}", began.elapsed());
    drop(stream);
    sender.join().unwrap();
    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
}

#[test]
fn addresses_without_parameters_take_none() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for path in ["/v1/scenes", "/v1/scenes/grid", "/v1/limits", "/v1/scenes/grid/paths/past"] {
        assert_eq!(client.get(path).status, 200, "{path}");
        assert_eq!(client.get(&format!("{path}?")).status, 200, "{path}, an empty query");
        let problem = client.get(&format!("{path}?limit=3")).problem();
        assert_eq!(problem["type"], "urn:pointillist:problem:unknown-parameter", "{path}");
        assert_eq!((&problem["parameter"], &problem["status"]), (&"limit".into(), &422.into()));
    }
    let gone = client.send("DELETE", "/v1/scenes/grid?force=true", &[], None);
    assert_eq!(gone.status, 422, "{}", gone.text());
    assert_eq!(client.get("/v1/scenes/grid").status, 200, "nothing was deleted");
}
