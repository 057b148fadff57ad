//! The viewer's files, and the camera paths that it requests. `tests/browser` tests the viewer in a browser.

use super::daemon::Daemon;

#[test]
fn the_page_and_its_files_are_revalidated_and_let_nothing_else_in() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for (path, kind) in [
        ("/", "text/html; charset=utf-8"),
        ("/viewer/app.js", "text/javascript; charset=utf-8"),
        ("/viewer/style.css", "text/css; charset=utf-8"),
    ] {
        let reply = client.get(path);
        assert_eq!((reply.status, reply.header("content-type")), (200, Some(kind)), "{path}");
        assert_eq!(reply.header("cache-control"), Some("no-cache"));
        assert_eq!(reply.header("x-content-type-options"), Some("nosniff"));
        let policy = reply.header("content-security-policy").unwrap();
        assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        let tag = reply.header("etag").unwrap();
        let again = client.send("GET", path, &[("if-none-match", tag)], None);
        assert_eq!((again.status, again.body.len()), (304, 0), "{path}");
        assert_eq!(again.header("etag"), Some(tag));
    }
    let reply = client.get("/viewer/ap.js");
    assert_eq!(reply.status, 404);
    assert_eq!(reply.problem()["accepted"], "/viewer/app.js");
    assert_eq!(client.get("/viewer/..%2f..%2fetc%2fpasswd").status, 404);
}

#[test]
fn paths_come_as_their_files_have_them() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let path = client.get("/v1/scenes/grid/paths/past").json();
    assert_eq!((&path["fps"], &path["interpolation"]), (&20.0.into(), &"catmull_rom".into()));
    let keys = path["keys"].as_array().unwrap();
    assert_eq!((keys.len(), &keys[1]["fov"], &keys[1]["t"]), (2, &50.0.into(), &1.5.into()));
    assert_eq!(keys[0]["up"], serde_json::json!([0.0, 1.0, 0.0]), "what was left out is filled in");
    let unknown = client.get("/v1/scenes/grid/paths/post");
    assert_eq!(unknown.status, 404);
    let problem = unknown.problem();
    assert_eq!(problem["type"], "urn:pointillist:problem:unknown-path");
    assert_eq!(problem["accepted"], "past");
    assert_eq!(
        client.get("/v1/scenes/none/paths/past").problem()["type"],
        "urn:pointillist:problem:unknown-scene"
    );
}
