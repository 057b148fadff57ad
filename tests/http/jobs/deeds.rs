//! Products of jobs while they run and afterwards, operations on jobs, and refusals.

use std::fs;
use std::io::{BufRead, BufReader};

use serde_json::{Value, json};

use super::{
    FRAMES, body, checksum, create, drawn, ended, files, filmed, fly, job, manifest, parts, post,
    studio, when,
};
use crate::client::raw;
use crate::daemon::{Daemon, grid_ply};

#[test]
fn a_path_becomes_frames_that_can_be_fetched() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let reply = client.post_json("/v1/jobs", &body(json!({})));
    assert_eq!(
        (reply.status, reply.header("location")),
        (201, Some("/v1/jobs/1")),
        "{}",
        reply.text()
    );
    let made = ended(&client, "1", "done");
    assert_eq!(made["frames"], json!({"done": FRAMES, "total": FRAMES, "from": null, "to": null}));
    assert_eq!(
        (&made["fps"], &made["path"], &made["want"]),
        (&json!(30.0), &json!("fly"), &json!(["frames"]))
    );
    assert_eq!(
        (&made["error"], &made["eta_seconds"], &made["video"]),
        (&Value::Null, &Value::Null, &Value::Null)
    );
    assert!(made["expires_ms"].as_u64() > made["since_ms"].as_u64());
    assert!(made["since_ms"].as_u64() >= made["created_ms"].as_u64());

    // The manifest matches the job, and every frame matches its record and a frame of `pointillist path`.
    let text = client.get("/v1/jobs/1/frames");
    assert_eq!(text.header("content-type"), Some("application/jsonl"));
    assert_eq!(made["manifest_sha256"], checksum(&text.body));
    let folder = tempfile::tempdir().unwrap();
    let alone = filmed(&daemon, &folder.path().join("frames"), &[]);
    let records = manifest(&client, "1");
    assert_eq!((records.len(), alone.len()), (FRAMES as usize, FRAMES as usize));
    let mut bytes = 0;
    for (number, record) in records.iter().enumerate() {
        assert_eq!(record["frame"], number);
        let frame = client.get(&format!("/v1/jobs/1/frames/{number}"));
        assert_eq!((frame.status, frame.header("content-type")), (200, Some("image/png")));
        assert_eq!(record["sha256"], checksum(&frame.body));
        assert!(alone[record["file"].as_str().unwrap()] == frame.body, "frame {number}");
        let tag = format!("\"{}\"", record["sha256"].as_str().unwrap());
        assert_eq!(frame.header("etag"), Some(tag.as_str()));
        let known = [("if-none-match", tag.as_str())];
        assert_eq!(
            client.send("GET", &format!("/v1/jobs/1/frames/{number}"), &known, None).status,
            304
        );
        bytes += frame.body.len() as u64;
    }
    assert!(made["bytes"].as_u64().unwrap() > bytes);
    let head = client.send("HEAD", "/v1/jobs/1/frames/0", &[], None);
    assert_eq!((head.status, head.body.len()), (200, 0));

    // All frames in one stream.
    let all = parts(&client.get("/v1/jobs/1/multipart"));
    assert_eq!(all.len(), FRAMES as usize);
    for (number, (head, content)) in all.iter().enumerate() {
        assert!(head.contains(&format!("pointillist-frame: {number}\r\n")), "{head}");
        assert!(head.contains("content-type: image/png"), "{head}");
        assert_eq!(records[number]["sha256"], checksum(content));
    }

    let list = client.get("/v1/jobs").json();
    assert_eq!(list["jobs"], json!([made]));
    let limits = client.get("/v1/limits").json();
    assert_eq!(limits["jobs"]["bytes"], made["bytes"]);
    let metrics = client.get("/metrics").text();
    for line in [
        "pointillist_jobs{state=\"done\"} 1",
        "pointillist_jobs{state=\"queued\"} 0",
        "pointillist_job_frames_total 121",
    ] {
        assert!(metrics.lines().any(|found| found == line), "{line} in {metrics}");
    }
}

#[test]
fn parts_of_a_path_keep_their_numbers() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let more = json!({"path": fly(), "fps": 10, "from": 5, "to": 7, "format": "jpeg", "reconstruct": "splats", "lod": "spt"});
    let id = create(&client, more);
    let made = ended(&client, &id, "done");
    assert_eq!(made["frames"], json!({"done": 3, "total": 3, "from": 5, "to": 7}));
    assert_eq!((&made["path"], &made["settings"]["lod"]), (&fly(), &json!("spt")));
    assert_eq!(client.get("/v1/jobs").json()["jobs"][0]["path"], json!({"keys": 3}));
    assert_eq!(manifest(&client, &id).len(), 3);
    let numbers: Vec<String> = parts(&client.get(&format!("/v1/jobs/{id}/multipart")))
        .iter()
        .map(|(head, _)| head.lines().next().unwrap().to_owned())
        .collect();
    assert_eq!(numbers, ["pointillist-frame: 5", "pointillist-frame: 6", "pointillist-frame: 7"]);
    assert_eq!(
        client.get(&format!("/v1/jobs/{id}/frames/5")).header("content-type"),
        Some("image/jpeg")
    );
    for (number, accepted) in
        [("4", "5 to 7"), ("8", "5 to 7"), ("x", "a whole number"), ("-1", "a whole number")]
    {
        let problem = client.get(&format!("/v1/jobs/{id}/frames/{number}")).problem();
        assert_eq!(
            (&problem["status"], &problem["accepted"]),
            (&json!(404), &json!(accepted)),
            "{problem}"
        );
    }
}

#[test]
fn frames_are_there_while_the_job_runs() {
    let daemon = studio(&[]);
    let client = daemon.client();
    // A job of 4001 frames.
    let id = create(&client, json!({"fps": 1000}));
    let found = drawn(&client, &id, 20);
    assert_eq!((&found["state"], &found["frames"]["total"]), (&json!("running"), &json!(4001)));
    let found = when(&client, &id, "a rate", |job| job["frames_per_second"].is_number());
    assert!(
        found["frames_per_second"].as_f64().unwrap() > 0.0
            && found["eta_seconds"].as_f64().unwrap() > 0.0
    );
    assert_eq!(found["stage"], "frames");
    let first = client.get(&format!("/v1/jobs/{id}/frames/0"));
    assert_eq!(first.status, 200);
    let last = client.get(&format!("/v1/jobs/{id}/frames/4000")).problem();
    assert_eq!(
        (&last["type"], &last["status"]),
        (&json!("urn:pointillist:problem:frame-not-drawn"), &json!(404))
    );
    assert_eq!(
        client.get(&format!("/v1/jobs/{id}/frames/4001")).problem()["accepted"],
        "0 to 4000"
    );
    let records = manifest(&client, &id);
    assert!((20..4001).contains(&records.len()), "{}", records.len());
    assert!(records.iter().any(|record| record["sha256"] == checksum(&first.body)));

    // A reader of the stream gets frames as they are finished, and a problem when no more will come.
    let request = format!("GET /v1/jobs/{id}/multipart HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let mut stream = BufReader::new(raw(daemon.address, request.as_bytes()));
    let seen = |stream: &mut BufReader<std::net::TcpStream>, words: &str| {
        let mut line = Vec::new();
        while !String::from_utf8_lossy(&line).contains(words) {
            line.clear();
            assert!(stream.read_until(b'\n', &mut line).unwrap() > 0, "no {words}");
        }
    };
    seen(&mut stream, "Pointillist-Frame: 30\r\n");
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/cancel")).json()["state"], "cancelled");
    seen(&mut stream, "content-type: application/problem+json");
    seen(&mut stream, "the job ended before frame");
    // Frames that were drawn remain.
    assert_eq!(client.get(&format!("/v1/jobs/{id}/frames/0")).body, first.body);
}

#[test]
fn a_cancelled_job_goes_on_where_it_was() {
    let daemon = studio(&["--job-runners", "1"]);
    let client = daemon.client();
    let id = create(&client, json!({"fps": 300}));
    drawn(&client, &id, 100);
    let cancelled = post(&client, &format!("/v1/jobs/{id}/cancel"));
    assert_eq!((cancelled.status, &cancelled.json()["state"]), (200, &json!("cancelled")));
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/cancel")).status, 200, "asked for twice");
    assert_eq!(client.get(&format!("/v1/jobs/{id}/video.mp4")).problem()["status"], 404);
    // The runner releases the job once it has written the finished frames.
    let other = create(&client, json!({"to": 1}));
    ended(&client, &other, "done");
    let before = files(&daemon, &id);
    assert!((100..1201).contains(&before.len()), "{}", before.len());
    assert_eq!(manifest(&client, &id).len(), before.len());

    let resumed = post(&client, &format!("/v1/jobs/{id}/resume"));
    assert_eq!(resumed.status, 200, "{}", resumed.text());
    let made = ended(&client, &id, "done");
    let after = files(&daemon, &id);
    assert_eq!(after.len(), 1201);
    for (name, file) in &before {
        assert!(after[name] == *file, "{name} was drawn again");
    }
    let text = client.get(&format!("/v1/jobs/{id}/frames"));
    assert_eq!(made["manifest_sha256"], checksum(&text.body));
    let problem = post(&client, &format!("/v1/jobs/{id}/cancel")).problem();
    assert_eq!(problem["type"], "urn:pointillist:problem:job-state");
    assert!(problem["detail"].as_str().unwrap().contains("done"), "{problem}");
}

#[test]
fn jobs_are_deleted_in_any_state() {
    let daemon = studio(&["--job-runners", "1"]);
    let client = daemon.client();
    let running = create(&client, json!({"fps": 1000}));
    let queued = create(&client, json!({}));
    drawn(&client, &running, 5);
    assert_eq!(job(&client, &queued)["state"], "queued");
    for id in [&queued, &running] {
        assert_eq!(client.send("DELETE", &format!("/v1/jobs/{id}"), &[], None).status, 204);
        let gone = client.get(&format!("/v1/jobs/{id}")).problem();
        assert_eq!(gone["type"], "urn:pointillist:problem:unknown-job");
        assert_eq!(client.send("DELETE", &format!("/v1/jobs/{id}"), &[], None).status, 404);
    }
    let last = create(&client, json!({"to": 3}));
    assert_eq!(last, "3", "numbers are not given out again");
    let made = ended(&client, &last, "done");
    assert_eq!(client.send("DELETE", "/v1/jobs/3", &[], None).status, 204);
    assert!(made["bytes"].as_u64().unwrap() > 0);
    // The runner may still hold the job for a moment.
    crate::daemon::eventually("room", || client.get("/v1/limits").json()["jobs"]["bytes"] == 0);
    crate::daemon::eventually("the end of its files", || {
        fs::read_dir(daemon.state().join("jobs")).unwrap().count() == 0
    });
    // A later process does not reuse numbers either.
    let daemon = daemon.restart(&[]);
    assert_eq!(create(&daemon.client(), json!({"to": 3})), "4");
}

/// The events of a job until the server ends the answer: name, id, data.
fn events(daemon: &Daemon, id: &str, last: Option<&str>) -> Vec<(String, String, Value)> {
    let last = last.map_or(String::new(), |last| format!("Last-Event-ID: {last}\r\n"));
    let request = format!(
        "GET /v1/jobs/{id}/events HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{last}\r\n"
    );
    let text = crate::client::read_to_close(&mut raw(daemon.address, request.as_bytes()));
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    assert!(head.contains("200 OK") && head.to_lowercase().contains("text/event-stream"), "{head}");
    let field = |event: &str, name: &str| {
        event.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().trim().to_owned()
    };
    // Chunks begin and end at events.
    body.split("\n\n")
        .filter(|event| event.contains("event:"))
        .map(|event| {
            let data = field(event, "data:");
            (field(event, "event:"), field(event, "id:"), serde_json::from_str(&data).unwrap())
        })
        .collect()
}

#[test]
fn events_tell_of_progress() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let id = create(&client, json!({"fps": 300}));
    let heard = events(&daemon, &id, None);
    let (name, last_id, data) = heard.last().unwrap();
    assert_eq!((name.as_str(), &data["state"]), ("done", &json!("done")));
    assert_eq!(data, &job(&client, &id));
    assert_eq!(heard[0].0, "job", "the job as it is comes first");
    assert!(heard.len() > 2, "{}", heard.len());
    let done: Vec<u64> =
        heard.iter().map(|event| event.2["frames"]["done"].as_u64().unwrap()).collect();
    assert!(done.is_sorted() && done[done.len() - 1] == 1201, "{done:?}");
    let mut ids: Vec<&String> = heard.iter().map(|event| &event.1).collect();
    ids.dedup();
    assert_eq!(ids.len(), heard.len());

    // A client that knows the final state gets 204; a client with any other id gets the whole state.
    let known = [("last-event-id", last_id.as_str())];
    assert_eq!(client.send("GET", &format!("/v1/jobs/{id}/events"), &known, None).status, 204);
    for other in [&heard[0].1, "7", ""] {
        let heard = events(&daemon, &id, Some(other));
        assert_eq!((heard.len(), heard[0].0.as_str()), (1, "done"), "{other}");
    }
    let running = create(&client, json!({"fps": 1000}));
    drawn(&client, &running, 3);
    let listener = std::thread::scope(|scope| {
        let listener = scope.spawn(|| events(&daemon, &running, None));
        drawn(&client, &running, 60);
        client.send("DELETE", &format!("/v1/jobs/{running}"), &[], None);
        listener.join().unwrap()
    });
    assert_eq!(listener.last().unwrap().0, "deleted");
    assert_eq!(client.get("/v1/jobs/99/events").problem()["status"], 404);
}

#[test]
fn a_repeated_request_makes_one_job() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let send = |client: &crate::client::Client, key: &str, more: Value| {
        let headers = [("content-type", "application/json"), ("idempotency-key", key)];
        client.send("POST", "/v1/jobs", &headers, Some(body(more).to_string().as_bytes()))
    };
    let first = send(&client, "film-1", json!({"to": 5}));
    let again = send(&client, "film-1", json!({"to": 5}));
    assert_eq!((first.status, again.status), (201, 201));
    assert_eq!(first.header("location"), again.header("location"));
    assert_ne!(
        send(&client, "film-2", json!({"to": 5})).header("location"),
        first.header("location")
    );
    let other = send(&client, "film-1", json!({"to": 6})).problem();
    assert_eq!(
        (&other["type"], &other["parameter"]),
        (&json!("urn:pointillist:problem:key-reused"), &json!("Idempotency-Key"))
    );
    assert_eq!(
        send(&client, &"x".repeat(256), json!({})).problem()["parameter"],
        "Idempotency-Key"
    );
    ended(&client, "1", "done");
    // A restart and the removal of the scene change nothing.
    let daemon = daemon.kill_and_restart(&[]);
    let client = daemon.client();
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    let again = send(&client, "film-1", json!({"to": 5}));
    assert_eq!((again.status, &again.json()["state"]), (201, &json!("done")));
    assert_eq!(client.get("/v1/jobs").json()["jobs"].as_array().unwrap().len(), 2);
}

#[test]
fn what_cannot_be_drawn_is_no_job() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let key = |t: f64| json!({"t": t, "eye": [0, 0, 3], "target": [0, 0, 0]});
    for (more, status, kind, parameter) in [
        (json!({"scene": "none"}), 404, "unknown-scene", "scene"),
        (json!({"path": "flie"}), 422, "bad-parameter", "path"),
        (json!({"path": {"keys": []}}), 422, "bad-parameter", "path.keys"),
        (json!({"path": {"keys": [key(0.0), key(0.0)]}}), 422, "bad-parameter", "path.keys[1].t"),
        (json!({"path": {"kyes": []}}), 422, "bad-parameter", "path.kyes"),
        (json!({"from": 121}), 422, "bad-parameter", "from"),
        (json!({"to": 121}), 422, "bad-parameter", "to"),
        (json!({"fps": 0}), 422, "bad-parameter", "fps"),
        (json!({"fps": 1e9}), 422, "bad-parameter", "fps"),
        (json!({"w": 9000}), 422, "over-limit", "w"),
        (json!({"format": "pfm"}), 422, "bad-parameter", "format"),
        (json!({"lod": "full", "max_error_px": 2}), 422, "bad-parameter", "max_error_px"),
        (json!({"camera": "front"}), 422, "bad-parameter", "camera"),
        (json!({"wnat": ["video"]}), 422, "unknown-parameter", "wnat"),
        (json!({"want": ["video"], "bitrate_kbps": 1}), 422, "bad-parameter", "bitrate_kbps"),
    ] {
        let reply = client.post_json("/v1/jobs", &body(more.clone()));
        let problem = reply.problem();
        if more.get("want").is_some()
            && problem["type"] == "urn:pointillist:problem:unavailable-parameter"
        {
            // This build has no coder, and the machine has no ffmpeg.
            continue;
        }
        let urn = format!("urn:pointillist:problem:{kind}");
        assert_eq!(
            (&problem["status"], &problem["type"]),
            (&json!(status), &json!(urn)),
            "{more}: {problem}"
        );
        assert_eq!(problem["parameter"], parameter, "{more}: {problem}");
    }
    let json = [("content-type", "application/json")];
    for (content, status) in [(&b"{"[..], 422), (b"[]", 422), (b"", 422)] {
        assert_eq!(
            client.send("POST", "/v1/jobs", &json, Some(content)).problem()["status"],
            status
        );
    }
    let large = format!("{{\"scene\": \"{}\"}}", "x".repeat(300 << 10));
    assert_eq!(
        client.send("POST", "/v1/jobs", &json, Some(large.as_bytes())).problem()["status"],
        413
    );
    let text = [("content-type", "text/plain")];
    assert_eq!(client.send("POST", "/v1/jobs", &text, Some(b"{}")).problem()["status"], 415);
    assert_eq!(client.get("/v1/jobs").json(), json!({"jobs": []}));
    for path in [
        "/v1/jobs/1",
        "/v1/jobs/x",
        "/v1/jobs/1/frames",
        "/v1/jobs/1/frames/0",
        "/v1/jobs/1/multipart",
        "/v1/jobs/1/video.mp4",
    ] {
        assert_eq!(
            client.get(path).problem()["type"],
            "urn:pointillist:problem:unknown-job",
            "{path}"
        );
    }
    assert_eq!(post(&client, "/v1/jobs/1/cancel").problem()["status"], 404);
    assert_eq!(post(&client, "/v1/jobs/1/resume").problem()["status"], 404);
}

#[test]
fn jobs_are_their_keys_own() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    let line = |name: &str, scope: &str, key: &str| {
        format!("{name} {scope} {}\n", checksum(key.as_bytes()))
    };
    let lines = [
        line("eye", "read", "r"),
        line("hand", "write", "w"),
        line("other", "write", "o"),
        line("root", "admin", "a"),
    ];
    fs::write(&keys, lines.concat()).unwrap();
    let daemon = studio(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let send = |key: &str, method: &str, path: &str, more: Option<Value>| {
        let bearer = format!("Bearer {key}");
        let mut headers = vec![("content-type", "application/json"), ("idempotency-key", "same")];
        if !key.is_empty() {
            headers.push(("authorization", &bearer));
        }
        let body = more.map(|more| body(more).to_string());
        client.send(method, path, &headers, body.as_ref().map(|body| body.as_bytes()))
    };
    let few = || Some(json!({"to": 3}));
    assert_eq!(send("", "POST", "/v1/jobs", few()).status, 401);
    assert_eq!(send("r", "POST", "/v1/jobs", few()).status, 403);
    assert_eq!(send("w", "POST", "/v1/jobs", few()).json()["id"], "1");
    assert_eq!(
        send("o", "POST", "/v1/jobs", few()).json()["id"],
        "2",
        "another's key names another job"
    );
    let owned = send("w", "GET", "/v1/jobs/1", None).json();
    assert_eq!(owned["owner"], "hand");
    let ended = |id: &str| {
        let path = format!("/v1/jobs/{id}");
        crate::daemon::eventually("its end", || {
            send("a", "GET", &path, None).json()["state"] == "done"
        });
    };
    ended("1");
    ended("2");
    for (method, path) in [
        ("GET", "/v1/jobs/1"),
        ("GET", "/v1/jobs/1/frames"),
        ("GET", "/v1/jobs/1/frames/0"),
        ("GET", "/v1/jobs/1/multipart"),
        ("GET", "/v1/jobs/1/events"),
        ("POST", "/v1/jobs/1/resume"),
    ] {
        let status = |key: &str| send(key, method, path, None).status;
        // The key of scope read may not resume any job.
        let reader = if method == "GET" { 404 } else { 403 };
        assert_eq!((status(""), status("r"), status("o")), (401, reader, 404), "{method} {path}");
        assert_eq!(status("w"), 200, "{method} {path}");
        ended("1");
        assert_eq!(status("a"), 200, "{method} {path}");
        ended("1");
    }
    for (method, path) in
        [("GET", "/v1/jobs/1/video.mp4"), ("POST", "/v1/jobs/1/cancel"), ("DELETE", "/v1/jobs/1")]
    {
        // A job of another key and one that does not exist have the same answer, but for their ids.
        let answer = |path: &str| {
            let refused = send("o", method, path, None);
            (refused.status, refused.problem()["detail"].clone())
        };
        let missing = answer(&path.replace("/1", "/9"));
        assert_eq!(missing, (404, json!("there is no job `9`")), "{method} {path}");
        assert_eq!(answer(path), (404, json!("there is no job `1`")), "{method} {path}");
    }
    let listed = |key: &str| {
        let jobs = send(key, "GET", "/v1/jobs", None).json()["jobs"].clone();
        let ids: Vec<Value> =
            jobs.as_array().unwrap().iter().map(|job| job["id"].clone()).collect();
        json!(ids)
    };
    assert_eq!((listed("w"), listed("o"), listed("r")), (json!(["1"]), json!(["2"]), json!([])));
    assert_eq!(listed("a"), json!(["2", "1"]));
    // The rules also hold after a restart, and an admin may change jobs of others.
    let daemon = daemon.restart(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let delete = |key: &str, path: &str| {
        let bearer = format!("Bearer {key}");
        client.send("DELETE", path, &[("authorization", &bearer)], None).status
    };
    assert_eq!((delete("o", "/v1/jobs/1"), delete("w", "/v1/jobs/1")), (404, 204));
    assert_eq!(delete("a", "/v1/jobs/2"), 204);
}

#[test]
fn a_removed_key_follows_no_job() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    let line = |name: &str, scope: &str, key: &str| {
        format!("{name} {scope} {}\n", checksum(key.as_bytes()))
    };
    fs::write(&keys, line("hand", "write", "w") + &line("root", "admin", "a")).unwrap();
    let daemon = studio(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let send = |key: &str, method: &str, path: &str, sent: Option<&[u8]>| {
        let bearer = format!("Bearer {key}");
        let headers = [("content-type", "application/json"), ("authorization", bearer.as_str())];
        client.send(method, path, &headers, sent)
    };
    // A job that waits for its scene has no events.
    let long = body(json!({"fps": 1000})).to_string();
    assert_eq!(send("w", "POST", "/v1/jobs", Some(long.as_bytes())).status, 201);
    assert_eq!(send("a", "DELETE", "/v1/scenes/grid", None).status, 204);
    crate::daemon::eventually("the wait", || {
        send("a", "GET", "/v1/jobs/1", None).json()["waits_for"].is_string()
    });
    let open = |what: &str| {
        let request = format!(
            "GET /v1/jobs/1/{what} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer w\r\nConnection: close\r\n\r\n"
        );
        let mut answer = BufReader::new(raw(daemon.address, request.as_bytes()));
        let mut status = String::new();
        answer.read_line(&mut status).unwrap();
        assert!(status.contains("200 OK"), "{status}");
        answer
    };
    let answers = [open("events"), open("multipart")];
    fs::write(&keys, line("root", "admin", "a")).unwrap();
    let id = daemon.id().to_string();
    assert!(std::process::Command::new("kill").args(["-HUP", &id]).status().unwrap().success());
    for mut answer in answers {
        let mut rest = Vec::new();
        std::io::Read::read_to_end(&mut answer, &mut rest).unwrap();
        let rest = String::from_utf8_lossy(&rest);
        assert!(rest.contains("the key was removed or has expired"), "{} bytes", rest.len());
    }
}

#[test]
fn edited_and_missing_scenes() {
    let daemon = studio(&[]);
    let client = daemon.client();
    // After an edit in the middle the job fails, and resuming it draws all frames anew.
    let id = create(&client, json!({"fps": 300}));
    drawn(&client, &id, 30);
    let json_type = [("content-type", "application/json")];
    let patched = client.send(
        "PATCH",
        "/v1/scenes/grid/nodes/wall",
        &json_type,
        Some(br#"{"visible": false}"#),
    );
    assert_eq!(patched.status, 200);
    let failed = ended(&client, &id, "failed");
    assert_eq!(failed["error"]["type"], "urn:pointillist:problem:scene-changed");
    assert!(failed["error"]["accepted"].as_str().unwrap().contains("/resume"), "{failed}");
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    ended(&client, &id, "done");
    let empty: Vec<Value> =
        manifest(&client, &id).iter().map(|record| record["sha256"].clone()).collect();
    assert!(empty.iter().all(|sum| *sum == empty[0]), "every frame shows the empty scene");

    // The scene is removed and comes back.
    let headers = [("content-type", "application/octet-stream")];
    let upload = || {
        client.send(
            "POST",
            "/v1/scenes?id=mine&name=mine.ply",
            &headers,
            Some(grid_ply().as_bytes()),
        )
    };
    assert_eq!(upload().status, 201);
    let more = json!({"scene": "mine", "path": fly(), "fps": 500});
    let id = create(&client, more);
    drawn(&client, &id, 10);
    assert_eq!(client.send("DELETE", "/v1/scenes/mine", &[], None).status, 204);
    let waiting = when(&client, &id, "the wait", |job| job["waits_for"].is_string());
    assert_eq!(
        (&waiting["state"], &waiting["waits_for"]),
        (&json!("queued"), &json!("scene `mine` is not loaded"))
    );
    let before = files(&daemon, &id);
    // Other jobs do not wait behind it.
    let other = create(&client, json!({"to": 2}));
    ended(&client, &other, "done");
    assert_eq!(upload().status, 201);
    ended(&client, &id, "done");
    let after = files(&daemon, &id);
    assert_eq!(after.len(), 2001);
    // It is the same scene, so frames drawn before are kept.
    assert!(before.iter().all(|(name, file)| after[name] == *file));
}

#[test]
fn limits_are_told() {
    let daemon = studio(&["--job-queue", "2", "--job-disk-mib", "1", "--job-ttl-seconds", "10"]);
    let client = daemon.client();
    let limits = client.get("/v1/limits").json()["jobs"].clone();
    assert_eq!(
        (&limits["max_unfinished"], &limits["max_bytes"], &limits["ttl_ms"]),
        (&json!(2), &json!(1 << 20), &json!(10_000))
    );
    // More jobs than the limit of two.
    let ids = [create(&client, json!({"fps": 1000})), create(&client, json!({"fps": 1000}))];
    let refused = client.post_json("/v1/jobs", &body(json!({})));
    assert_eq!(
        (refused.status, &refused.problem()["type"]),
        (429, &json!("urn:pointillist:problem:too-many-jobs"))
    );
    assert!(refused.header("retry-after").unwrap().parse::<u64>().unwrap() > 0);
    for id in &ids {
        client.send("DELETE", &format!("/v1/jobs/{id}"), &[], None);
    }
    // The frames exceed a mebibyte: those that fit are drawn.
    let large = json!({"fps": 300, "format": "raw"});
    let id = create(&client, large);
    let failed = ended(&client, &id, "failed");
    assert_eq!(failed["error"]["type"], "urn:pointillist:problem:job-quota");
    let detail = failed["error"]["detail"].as_str().unwrap();
    assert!(detail.contains("of 1048576 bytes used; delete finished jobs"), "{detail}");
    let frame_bytes = 64 * 48 * 4;
    let most = (1 << 20) / frame_bytes + 12;
    let done = failed["frames"]["done"].as_u64().unwrap();
    assert!((1..=most).contains(&done), "{done} frames of {frame_bytes} bytes");
    for reply in [
        client.post_json("/v1/jobs", &body(json!({}))),
        post(&client, &format!("/v1/jobs/{id}/resume")),
    ] {
        let problem = reply.problem();
        assert_eq!(
            (reply.status, &problem["type"]),
            (507, &json!("urn:pointillist:problem:job-quota")),
            "{problem}"
        );
        assert!(problem["detail"].as_str().unwrap().contains("1048576"), "{problem}");
    }
    // Ended jobs expire, and their files with them.
    let gone = || client.get(&format!("/v1/jobs/{id}")).status == 404;
    crate::daemon::eventually("the end of the job's time", gone);
    crate::daemon::eventually("room", || client.get("/v1/limits").json()["jobs"]["bytes"] == 0);
    assert_eq!(client.post_json("/v1/jobs", &body(json!({"to": 2}))).status, 201);
}
