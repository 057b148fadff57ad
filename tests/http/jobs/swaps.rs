//! Jobs whose scene is replaced while they are drawn, and reads of a job while it is drawn again.

use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::{Value, json};

use super::{create, drawn, ended, fly, job, manifest, post, studio};
use crate::client::Client;
use crate::daemon::wall_ply;

fn upload(client: &Client, side: usize) {
    let headers = [("content-type", "application/octet-stream")];
    let path = "/v1/scenes?id=mine&name=mine.ply";
    let reply = client.send("POST", path, &headers, Some(wall_ply(side).as_bytes()));
    assert_eq!(reply.status, 201, "{}", reply.text());
}

fn sums(client: &Client, id: &str) -> Vec<Value> {
    manifest(client, id).iter().map(|record| record["sha256"].clone()).collect()
}

/// A scene that is deleted and uploaded again has the id and revision of the first one. No film shows both scenes.
#[test]
fn no_film_mixes_two_scenes() {
    let daemon = studio(&[]);
    let client = daemon.client();
    // A frame takes longer than the replacement, so that the scene is rarely seen as missing.
    let film = || json!({"scene": "mine", "path": fly(), "fps": 3, "w": 1536, "h": 1536});
    let sides = [8, 5];
    let alone = sides.map(|side| {
        upload(&client, side);
        let id = create(&client, film());
        ended(&client, &id, "done");
        assert_eq!(client.send("DELETE", "/v1/scenes/mine", &[], None).status, 204);
        sums(&client, &id)
    });
    assert!(alone[0].iter().zip(&alone[1]).all(|(one, other)| one != other));

    upload(&client, sides[0]);
    let mut failed = 0;
    for round in 0..4 {
        let new = (round + 1) % 2;
        let id = create(&client, film());
        drawn(&client, &id, 2 + round as u64);
        assert_eq!(client.send("DELETE", "/v1/scenes/mine", &[], None).status, 204);
        upload(&client, sides[new]);
        let found = super::when(&client, &id, "an end", |job| {
            ["done", "failed"].contains(&job["state"].as_str().unwrap())
        });
        // The job may have found no scene for a moment, and begun again with the new one.
        if found["state"] == "failed" {
            failed += 1;
            let kind = "urn:pointillist:problem:scene-changed";
            assert_eq!(found["error"]["type"], kind, "{found}");
            assert!(sums(&client, &id).iter().all(|sum| alone[1 - new].contains(sum)), "{round}");
            assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
            ended(&client, &id, "done");
        }
        assert!(sums(&client, &id) == alone[new], "round {round} mixes two scenes: {found}");
    }
    assert!(failed > 0, "no exchange was seen as one");
}

/// While a done job is drawn again, a frame shows the old or the new state of the scene, or is not drawn yet. In the end it shows
/// the new state.
#[test]
fn frames_are_read_while_they_are_drawn_anew() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let video = cfg!(feature = "video");
    let want = if video { json!(["frames", "video"]) } else { json!(["frames"]) };
    // The raw format gives every manifest the same length.
    let id = create(&client, json!({"format": "raw", "want": want}));
    ended(&client, &id, "done");
    let json_type = [("content-type", "application/json")];
    let path = format!("/v1/jobs/{id}/frames/5");
    let mut before = client.get(&path).body;
    for round in 1..=6 {
        let patch = json!({"translate": [f64::from(round) * 0.05, 0, 0]}).to_string();
        let node = "/v1/scenes/grid/nodes/wall";
        let patched = client.send("PATCH", node, &json_type, Some(patch.as_bytes()));
        assert_eq!(patched.status, 200, "{}", patched.text());
        let stop = AtomicBool::new(false);
        let made = std::thread::scope(|scope| {
            let readers = [(); 3].map(|()| {
                scope.spawn(|| {
                    let client = daemon.client();
                    let mut refused = None;
                    while !stop.load(Ordering::Relaxed) {
                        let reply = client.get(&path);
                        if ![200, 404].contains(&reply.status) {
                            refused = Some(reply.text());
                        }
                    }
                    refused
                })
            });
            assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
            let made = super::when(&client, &id, "an end", |job| {
                ["done", "failed"].contains(&job["state"].as_str().unwrap())
            });
            stop.store(true, Ordering::Relaxed);
            for reader in readers {
                assert_eq!(reader.join().unwrap(), None, "in round {round}");
            }
            made
        });
        assert_eq!(made["state"], "done", "{round}: {made}");
        let frame = client.get(&path);
        assert_eq!(frame.status, 200, "{round}: {}", frame.text());
        assert!(frame.body != before, "{round}: the frame is the old one");
        before = frame.body;
    }
    assert_eq!(job(&client, &id)["frames"]["done"], super::FRAMES);
}
