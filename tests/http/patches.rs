//! Changes of nodes while others change, delete and upload scenes.

use std::fs;
use std::io::{Read, Write};

use serde_json::json;

use super::access::{key_file, send, table};
use super::client::raw;
use super::daemon::{Daemon, eventually, grid_scene};

/// A request of `key` that changes the node `wall` of a scene, and its body.
fn change(key: &str, scene: &str) -> (String, &'static str) {
    let body = r#"{"translate": [1, 0, 0]}"#;
    let head = format!(
        "PATCH /v1/scenes/{scene}/nodes/wall HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {key}\r\n\
         Content-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    (head, body)
}

fn threads(daemon: &Daemon) -> usize {
    fs::read_dir(format!("/proc/{}/task", daemon.id())).unwrap().count()
}

#[test]
fn changes_of_vanished_clients_hold_up_nobody() {
    const REQUESTS: u64 = 300;
    let folder = tempfile::tempdir().unwrap();
    let keys = key_file(folder.path(), &[table("ann", "write", ""), table("bob", "write", "")]);
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    // A change lists 90000 instances anew.
    let mut large = grid_scene("grid.ply");
    large["nodes"][0]["repeat"] = json!({"grid": [300, 1, 300], "step": [3, 0, 3]});
    for (key, id, scene) in [("ann", "large", large), ("bob", "small", grid_scene("grid.ply"))] {
        let body = scene.to_string();
        let path = format!("/v1/scenes?id={id}");
        let made = send(&client, key, "POST", &path, Some(body.as_bytes()));
        assert_eq!(made.status, 201, "{}", made.text());
    }
    let (head, body) = change("ann", "large");
    let request = format!("{head}{body}");
    let before = threads(&daemon);
    for _ in 0..REQUESTS {
        drop(raw(daemon.address, request.as_bytes()));
    }
    // Requests of others that need a thread.
    assert_eq!(send(&client, "bob", "GET", "/v1/jobs", None).status, 200);
    let more = threads(&daemon) - before;
    assert!(more < 32, "{more} threads wait");
    let node = |id: &str| format!("/v1/scenes/{id}/nodes/wall");
    let changed = send(&client, "bob", "PATCH", &node("small"), Some(body.as_bytes()));
    assert_eq!((changed.status, &changed.json()["revision"]), (200, &json!(2)));
    // Most of the changes are never made.
    eventually("a place in the queue", || {
        let changed = send(&client, "ann", "PATCH", &node("large"), Some(body.as_bytes()));
        if changed.status == 429 {
            assert_eq!(changed.header("retry-after"), Some("1"));
            return false;
        }
        let revision = changed.json()["revision"].as_u64().unwrap();
        assert!(revision < REQUESTS / 2, "{revision} revisions");
        true
    });
}

#[test]
fn a_slow_change_reaches_no_scene_of_another_key() {
    let folder = tempfile::tempdir().unwrap();
    let keys = key_file(folder.path(), &[table("ann", "write", ""), table("bob", "write", "")]);
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let (head, body) = change("ann", "his");
    let mut slow = raw(daemon.address, format!("{head}{}", &body[..3]).as_bytes());
    // The request is under way when the next ones have been answered.
    assert_eq!(send(&client, "ann", "GET", "/v1/scenes/his", None).status, 404);
    let scene = grid_scene("grid.ply").to_string();
    let made = send(&client, "bob", "POST", "/v1/scenes?id=his", Some(scene.as_bytes()));
    assert_eq!(made.status, 201, "{}", made.text());
    slow.write_all(&body.as_bytes()[3..]).unwrap();
    let mut answer = [0; 12];
    slow.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 403");
    let scene = send(&client, "bob", "GET", "/v1/scenes/his", None).json();
    assert_eq!(scene["revision"], 1, "{scene}");
}
