//! Jobs that are killed, cancelled or deleted while their video is coded, and restarts of a killed daemon.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

#[cfg(feature = "video")]
use super::{checksum, files, job, post, when};
use super::{create, ended, studio};
#[cfg(feature = "video")]
use crate::daemon::Daemon;

#[cfg(feature = "video")]
const COUNT: u64 = 101;

#[cfg(feature = "video")]
fn film(want: Value) -> Value {
    json!({"fps": 25, "w": 64, "h": 48, "format": "raw", "want": want})
}

/// Waits until a job's video has as many frames as the daemon codes before it holds.
#[cfg(feature = "video")]
fn held(daemon: &Daemon, id: &str, frames: u64) {
    when(&daemon.client(), id, "the hold of its coding", |job| {
        job["stage"] == "video" && job["frames"]["coded"].as_u64().unwrap() >= frames
    });
}

/// A job that is killed, cancelled and resumed during coding draws no frame twice, and its video equals that of an undisturbed
/// job.
#[cfg(feature = "video")]
#[cfg_attr(not(debug_assertions), ignore = "release builds hold no coding")]
#[test]
fn videos_outlive_kills() {
    let mut daemon = studio(&[]);
    let calm = create(&daemon.client(), film(json!(["frames", "video"])));
    let expected = ended(&daemon.client(), &calm, "done")["video"].clone();
    for (want, left) in [(json!(["frames", "video"]), COUNT), (json!(["video"]), 0)] {
        daemon.hold_coding(Some(1));
        let id = create(&daemon.client(), film(want));
        let folder = daemon.state().join("jobs").join(&id);
        let mut kept = None;
        for (frames, next) in [(1, Some(5)), (5, Some(50)), (50, Some(96)), (96, None)] {
            held(&daemon, &id, frames);
            daemon.kill();
            assert!(!folder.join("video.mp4").exists(), "the coding was not held");
            let before = files(&daemon, &id);
            assert_eq!(before.len() as u64, COUNT);
            let kept = kept.get_or_insert_with(|| before.clone());
            assert!(*kept == before, "frames were drawn again before frame {frames} was coded");
            daemon.hold_coding(next);
            daemon = daemon.kill_and_restart(&[]);
        }
        let client = daemon.client();
        let made = ended(&client, &id, "done");
        assert_eq!(made["video"], expected, "{made}");
        let sent = client.get(&format!("/v1/jobs/{id}/video.mp4"));
        assert_eq!((sent.status, json!(checksum(&sent.body))), (200, expected["sha256"].clone()));
        assert!(!folder.join("video.mp4.part").exists(), "what was not finished is left behind");
        crate::daemon::eventually("the end of its frames", || {
            let names = std::fs::read_dir(folder.join("frames")).unwrap();
            let names = names.map(|item| item.unwrap().file_name().into_string().unwrap());
            names.filter(|name| name.starts_with("frame-")).count() as u64 == left
        });
    }
}

#[cfg(feature = "video")]
#[cfg_attr(not(debug_assertions), ignore = "release builds hold no coding")]
#[test]
fn videos_are_given_up() {
    let daemon = studio(&[]);
    let client = daemon.client();
    daemon.hold_coding(Some(20));
    let id = create(&client, film(json!(["frames", "video"])));
    let folder = daemon.state().join("jobs").join(&id);
    for _ in 0..3 {
        held(&daemon, &id, 20);
        let before = files(&daemon, &id);
        let cancelled = post(&client, &format!("/v1/jobs/{id}/cancel"));
        assert_eq!((cancelled.status, &cancelled.json()["state"]), (200, &json!("cancelled")));
        crate::daemon::eventually("the end of coding", || !folder.join("video.mp4.part").exists());
        assert!(!folder.join("video.mp4").exists());
        let none = client.get(&format!("/v1/jobs/{id}/video.mp4")).problem();
        assert!(none["detail"].as_str().unwrap().contains("the job ended before"), "{none}");
        assert_eq!(job(&client, &id)["frames"]["done"], COUNT);
        assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
        assert!(files(&daemon, &id) == before, "frames are what they were");
    }
    daemon.hold_coding(None);
    ended(&client, &id, "done");
    assert_eq!(client.get(&format!("/v1/jobs/{id}/video.mp4")).status, 200);
    // Deleted while it is coded, the job leaves nothing behind.
    daemon.hold_coding(Some(20));
    let id = create(&client, film(json!(["video"])));
    held(&daemon, &id, 20);
    assert_eq!(client.send("DELETE", &format!("/v1/jobs/{id}"), &[], None).status, 204);
    let folder = daemon.state().join("jobs").join(&id);
    crate::daemon::eventually("the end of its files", || !folder.exists());
    assert_eq!(client.get(&format!("/v1/jobs/{id}")).status, 404);
}

/// A daemon that starts while another one still holds its address and its state waits for that one to end. When it gives up, it
/// names what it could not get.
#[test]
fn a_restart_waits_for_the_process_before() {
    let mut daemon = studio(&[]);
    let client = daemon.client();
    ended(&client, &create(&client, json!({"to": 2})), "done");
    let start = |patience_seconds: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(["serve", "--listen", &daemon.address.to_string(), "--root"]);
        command.arg(daemon.root()).arg("--state").arg(daemon.state());
        command.env("POINTILLIST_NO_CACHE", "true").stdin(Stdio::null());
        command.env("POINTILLIST_TAKEOVER_SECONDS", patience_seconds);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let refused = start("1").wait_with_output().unwrap();
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && told.contains("cannot listen on"), "{told}");
    assert_eq!(told.matches("retrying for").count(), 1, "{told}");

    let mut next = start("600");
    let mut told = BufReader::new(next.stderr.take().unwrap()).lines().map(Result::unwrap);
    let waits = told.by_ref().find(|line| line.contains("retrying for"));
    assert!(waits.is_some(), "it has not waited");
    // Drain the rest of its messages, so that the pipe does not fill up.
    let rest = std::thread::spawn(move || told.collect::<Vec<_>>());
    let address = daemon.address;
    daemon.kill();
    let mut lines = BufReader::new(next.stdout.take().unwrap()).lines();
    let first = lines.next().map(Result::unwrap);
    let client = crate::client::Client::new(address);
    let found = first.is_some().then(|| client.get("/v1/jobs/1").json());
    next.kill().unwrap();
    next.wait().unwrap();
    let told = rest.join().unwrap();
    assert_eq!(first, Some(format!("listening on http://{address}")), "{told:?}");
    assert_eq!(found.unwrap_or(Value::Null)["state"], "done");
}
