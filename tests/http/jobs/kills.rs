//! Jobs that are killed, cancelled or deleted while their video is coded, and restarts of a killed daemon.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

#[cfg(feature = "video")]
use super::{checksum, files, job, post};
use super::{create, ended, studio};
#[cfg(feature = "video")]
use crate::client::Client;

/// Long enough that coding takes longer than polling, so that a job can be caught while its video is coded.
#[cfg(feature = "video")]
const COUNT: u64 = 401;

#[cfg(feature = "video")]
fn film(want: Value) -> Value {
    json!({"fps": 100, "w": 192, "h": 144, "format": "raw", "want": want})
}

/// Waits until a job's video has this many frames. Returns false if the job has ended before.
#[cfg(feature = "video")]
fn coded(client: &Client, id: &str, frames: u64) -> bool {
    let until = Instant::now() + Duration::from_secs(180);
    loop {
        let found = job(client, id);
        match found["state"].as_str().unwrap() {
            "queued" | "running" => {}
            "done" => return false,
            _ => panic!("{found}"),
        }
        if found["stage"] == "video" && found["frames"]["coded"].as_u64().unwrap() >= frames {
            return true;
        }
        assert!(Instant::now() < until, "no video: {found}");
    }
}

/// A job that is killed, cancelled and resumed during coding draws no frame twice, and its video equals that of an undisturbed
/// job.
#[cfg(feature = "video")]
#[test]
fn videos_outlive_kills() {
    let mut daemon = studio(&[]);
    let calm = create(&daemon.client(), film(json!(["frames", "video"])));
    let expected = ended(&daemon.client(), &calm, "done")["video"].clone();
    for (want, left) in [(json!(["frames", "video"]), COUNT), (json!(["video"]), 0)] {
        let id = create(&daemon.client(), film(want));
        let folder = daemon.state().join("jobs").join(&id);
        let (mut hits, mut kept) = (0, None);
        for share in [0, 5, 50, 95] {
            if !coded(&daemon.client(), &id, COUNT * share / 100) {
                break;
            }
            daemon.kill();
            let before = files(&daemon, &id);
            let is_hit = !folder.join("video.mp4").exists();
            if is_hit {
                hits += 1;
                assert_eq!(before.len() as u64, COUNT);
                let kept = kept.get_or_insert_with(|| before.clone());
                assert!(*kept == before, "frames were drawn again before {share} %");
            }
            daemon = daemon.kill_and_restart(&[]);
        }
        assert!(hits > 1, "{hits} kills hit the coding");
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
#[test]
fn videos_are_given_up() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let id = create(&client, film(json!(["frames", "video"])));
    let folder = daemon.state().join("jobs").join(&id);
    let mut hits = 0;
    for _ in 0..3 {
        if !coded(&client, &id, 20) {
            break;
        }
        let before = files(&daemon, &id);
        let cancelled = post(&client, &format!("/v1/jobs/{id}/cancel"));
        if cancelled.status == 409 {
            // The job was done by then.
            break;
        }
        hits += 1;
        assert_eq!((cancelled.status, &cancelled.json()["state"]), (200, &json!("cancelled")));
        crate::daemon::eventually("the end of coding", || !folder.join("video.mp4.part").exists());
        assert!(!folder.join("video.mp4").exists());
        let none = client.get(&format!("/v1/jobs/{id}/video.mp4")).problem();
        assert!(none["detail"].as_str().unwrap().contains("the job ended before"), "{none}");
        assert_eq!(job(&client, &id)["frames"]["done"], COUNT);
        assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
        assert!(files(&daemon, &id) == before, "frames are what they were");
    }
    assert!(hits > 0, "the coding was never hit");
    ended(&client, &id, "done");
    assert_eq!(client.get(&format!("/v1/jobs/{id}/video.mp4")).status, 200);
    // Deleted while it is coded, the job leaves nothing behind.
    let id = create(&client, film(json!(["video"])));
    coded(&client, &id, 20);
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
