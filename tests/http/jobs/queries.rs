//! Queries of jobs: unknown parameters, what is known before a job begins, and slow readers.

use std::io::Read;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::{create, drawn, ended, job, post, studio, when};
use crate::client::raw;
use crate::daemon::eventually;

#[test]
fn parameters_that_mean_nothing_are_refused() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let done = create(&client, json!({"want": ["frames"], "to": 5}));
    ended(&client, &done, "done");
    let one = format!("/v1/jobs/{done}");
    for (method, path) in [
        ("GET", "/v1/jobs?stat=done".to_owned()),
        ("POST", "/v1/jobs?x=1".to_owned()),
        ("GET", format!("{one}?x=1")),
        ("DELETE", format!("{one}?force=1")),
        ("POST", format!("{one}/cancel?x=1")),
        ("POST", format!("{one}/resume?x=1")),
        ("GET", format!("{one}/events?x=1")),
        ("GET", format!("{one}/frames?x=1")),
        ("GET", format!("{one}/frames/1?format=png")),
        ("GET", format!("{one}/multipart?form=1")),
        ("GET", format!("{one}/video.mp4?x=1")),
    ] {
        let body = (method == "POST").then_some(&b"{}"[..]);
        let json_type = [("content-type", "application/json")];
        let problem = client.send(method, &path, &json_type, body).problem();
        let found = (&problem["status"], &problem["type"]);
        let kind = json!("urn:pointillist:problem:unknown-parameter");
        assert_eq!(found, (&json!(422), &kind), "{method} {path}: {problem}");
        assert!(!problem["accepted"].as_str().unwrap().is_empty(), "{path}: {problem}");
    }
    assert_eq!(job(&client, &done)["state"], "done", "nothing was done");

    let running = create(&client, json!({"fps": 1000}));
    drawn(&client, &running, 1);
    let listed = |query: &str| {
        let jobs = client.get(&format!("/v1/jobs{query}")).json()["jobs"].clone();
        let ids = jobs.as_array().unwrap().iter().map(|job| job["id"].clone());
        json!(ids.collect::<Vec<Value>>())
    };
    assert_eq!(listed(""), json!([running, done]));
    assert_eq!(listed("?state=done"), json!([done]));
    assert_eq!(listed("?state=running"), json!([running]));
    assert_eq!(listed("?state=failed"), json!([]));
    let problem = client.get("/v1/jobs?state=finished").problem();
    assert_eq!((&problem["status"], &problem["parameter"]), (&json!(422), &json!("state")));
    assert!(problem["accepted"].as_str().unwrap().contains("cancelled"), "{problem}");

    // A range without frames is refused.
    for (id, from, accepted) in [(&done, 6, "0 to 5"), (&running, 4001, "0 to 4000")] {
        let problem = client.get(&format!("/v1/jobs/{id}/multipart?from={from}")).problem();
        let found = (&problem["status"], &problem["parameter"], &problem["accepted"]);
        assert_eq!(found, (&json!(422), &json!("from"), &json!(accepted)), "{problem}");
    }
    let part = create(&client, json!({"from": 5, "to": 7}));
    let problem = client.get(&format!("/v1/jobs/{part}/multipart?from=4")).problem();
    assert_eq!((&problem["status"], &problem["accepted"]), (&json!(422), &json!("5 to 7")));
}

#[test]
fn what_is_known_of_a_job_is_told_at_once() {
    let daemon = studio(&["--job-runners", "1"]);
    let client = daemon.client();
    let long = create(&client, json!({"fps": 1000}));
    // This job waits for its turn.
    let made = client.post_json("/v1/jobs", &super::body(json!({"fps": 10, "from": 5}))).json();
    assert_eq!((&made["state"], &made["fps"]), (&json!("queued"), &json!(10.0)), "{made}");
    let frames = json!({"done": 0, "total": 36, "from": 5, "to": null});
    assert_eq!(made["frames"], frames);
    let id = made["id"].as_str().unwrap();
    let beyond = client.get(&format!("/v1/jobs/{id}/frames/41")).problem();
    assert_eq!(beyond["accepted"], "5 to 40", "{beyond}");
    // It holds in a later process, and when the job is cancelled before it has begun.
    let daemon = daemon.kill_and_restart(&["--job-runners", "1"]);
    let client = daemon.client();
    assert_eq!(job(&client, id)["frames"], frames);
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/cancel")).json()["frames"], frames);

    // A job that waits for its scene has an expiry time.
    drawn(&client, &long, 3);
    assert_eq!(job(&client, &long)["expires_ms"], json!(null));
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    let waiting = when(&client, &long, "the wait", |job| job["waits_for"].is_string());
    let ttl_ms = client.get("/v1/limits").json()["jobs"]["ttl_ms"].as_u64().unwrap();
    let since_ms = waiting["since_ms"].as_u64().unwrap();
    assert_eq!(waiting["expires_ms"], since_ms + ttl_ms, "{waiting}");
}

/// A client that reads a few kilobytes at a time loses its place when its time is over, however much is left to send.
#[test]
fn who_reads_slowly_has_no_place_for_ever() {
    let watch = ["--max-watchers-per-client", "1", "--watch-seconds", "2"];
    let daemon = studio(&watch);
    let client = daemon.client();
    // More data than the sockets hold, in parts of 192 KiB.
    let id = create(&client, json!({"format": "raw", "w": 256, "h": 192, "fps": 30}));
    ended(&client, &id, "done");
    let request = format!("GET /v1/jobs/{id}/multipart HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let mut slow = raw(daemon.address, request.as_bytes());
    let began = Instant::now();
    let mut buffer = vec![0; 256 << 10];
    let mut tail = Vec::new();
    let mut all = 0;
    while began.elapsed() < Duration::from_secs(30) {
        let count = slow.read(&mut buffer).unwrap();
        all += count;
        tail.extend_from_slice(&buffer[..count]);
        tail.drain(..tail.len().saturating_sub(4096));
        if count == 0 || tail.ends_with(b"0\r\n\r\n") {
            break;
        }
        // Too slow to read everything in the allowed time.
        std::thread::sleep(Duration::from_millis(60));
    }
    let text = String::from_utf8_lossy(&tail);
    assert!(text.contains("its limit of 2 seconds"), "{all} bytes: {text}");
    assert!(text.contains("multipart?from="), "{text}");
    assert!(all < 121 * 256 * 192 * 4, "{all} bytes are all of it");
    eventually("a place", || {
        client.get(&format!("/v1/jobs/{id}/multipart?from=120")).status == 200
    });
}
