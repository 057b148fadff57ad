//! Measurements of accuracy: in the background, one at a time, kept, and stale once the scene changes.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::client::Client;
use super::daemon::{Daemon, eventually};
use super::schema::Contract;
use super::stream::Stream;

const PLACE: &str = "/v1/scenes/grid/accuracy";
const STATE: &str = "urn:pointillist:problem:";

/// The smallest measurement.
fn small() -> Value {
    json!({ "w": 32, "h": 24, "repeats": 1, "cameras": ["front"] })
}

/// One that lasts until it is cancelled.
fn endless() -> Value {
    json!({ "w": 64, "h": 48, "repeats": 100, "quick": false })
}

fn state(client: &Client) -> Value {
    let reply = client.get(PLACE);
    assert_eq!(reply.status, 200, "{}", reply.text());
    reply.json()
}

fn begin(client: &Client, body: &Value) -> Value {
    let reply = client.post_json(PLACE, body);
    assert_eq!(reply.status, 202, "{}", reply.text());
    assert_eq!(reply.header("location"), Some(PLACE));
    let begun = reply.json();
    assert_eq!(begun["state"], "running", "{begun}");
    begun
}

/// Waits for the end of a measurement.
fn ended(client: &Client, expected: &str) -> Value {
    let until = Instant::now() + Duration::from_secs(300);
    loop {
        let found = state(client);
        if found["state"] != "running" {
            assert_eq!(found["state"], expected, "{found}");
            return found;
        }
        assert!(Instant::now() < until, "{found}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Waits until a measurement draws frames.
fn drawing(client: &Client) {
    eventually("the measurement's frames", || {
        state(client)["progress"]["done"].as_u64().is_some_and(|done| done > 1)
    });
}

fn cancel(client: &Client) -> Value {
    let reply = client.send("POST", &format!("{PLACE}/cancel"), &[], None);
    assert_eq!(reply.status, 200, "{}", reply.text());
    reply.json()
}

/// Begins a measurement once the cancelled one has ended.
fn begin_after(client: &Client, body: &Value) {
    eventually("the end of the cancelled one", || {
        let reply = client.post_json(PLACE, body);
        assert!([202, 409].contains(&reply.status), "{}", reply.text());
        reply.status == 202
    });
}

#[test]
fn a_measurement_is_kept_and_becomes_stale() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    assert_eq!(client.get(PLACE).json()["state"], "not_measured");
    let begun = begin(&client, &small());
    assert_eq!((&begun["results"], &begun["stale"]), (&Value::Null, &Value::Null));
    let second = client.post_json(PLACE, &small());
    assert_eq!(
        (second.status, second.problem()["type"].as_str()),
        (409, Some(&*format!("{STATE}measuring")))
    );
    assert!(second.header("retry-after").is_some());

    let found = ended(&client, "done");
    assert_eq!(
        (&found["stale"], &found["revision"], &found["progress"]),
        (&json!(false), &json!(1), &Value::Null)
    );
    let results = &found["results"];
    let identity = &results["identity"];
    assert_eq!(
        (&identity["width"], &identity["repeats"], &identity["scene"]),
        (&json!(32), &json!(1), &json!("grid"))
    );
    let adapter = client.get("/v1/scenes/grid/frame?w=8&h=8").receipt()["adapter"].clone();
    assert_eq!(identity["adapter"], adapter);
    let scope = &results["scopes"][0];
    assert_eq!(scope["name"], "front");
    let entries = scope["entries"].as_array().unwrap();
    let of = |row: &str| entries.iter().find(|entry| entry["row"] == row).unwrap();
    assert!(
        scope["default"].is_string() && !scope["fronts"]["psnr"].as_array().unwrap().is_empty()
    );
    // The answer is as the contract has it, with results, too.
    let contract = Contract::new();
    let faults = contract.faults(contract.component("AccuracyState"), &found);
    assert!(faults.is_empty(), "{faults:?}");
    // The errors are those of a comparison with the reference at the same pose and size.
    for row in ["points full", "splats full"] {
        let entry = of(row);
        assert!(entry["gpu_ms"]["median"].as_f64().unwrap() > 0.0, "{entry}");
        let body = json!({ "camera": "front", "w": 32, "h": 24, "a": entry["settings"], "edl": "off", "against": "reference", "images": false });
        let compared = client.post_json("/v1/scenes/grid/compare", &body).json();
        for name in ["psnr_db", "ssim", "flip", "max_error"] {
            let of = |found: &Value| found[name].as_f64().unwrap();
            assert!((of(entry) - of(&compared)).abs() < 1e-9, "{row}, {name}: {compared}");
        }
        let of = |found: &Value| {
            (found["coverage"]["holes"].clone(), found["coverage"]["leaks"].clone())
        };
        assert_eq!(of(entry), of(&compared), "{row}");
    }

    let tag = client.get(PLACE).header("etag").unwrap().to_owned();
    let again = client.send("GET", PLACE, &[("if-none-match", &tag)], None);
    assert_eq!((again.status, again.header("etag")), (304, Some(&*tag)));
    // Results outlive the process, and belong to the scene as it was.
    let daemon = daemon.restart(&[]);
    let client = daemon.client();
    let kept = state(&client);
    assert_eq!(
        (&kept["results"], &kept["stale"], &kept["state"]),
        (results, &json!(false), &json!("done"))
    );
    let moved = client.send(
        "PATCH",
        "/v1/scenes/grid/nodes/wall",
        &[("content-type", "application/json")],
        Some(br#"{"translate": [0.1, 0, 0]}"#),
    );
    assert_eq!(moved.status, 200);
    let stale = state(&client);
    assert_eq!(
        (&stale["stale"], &stale["results"], &stale["revision"]),
        (&json!(true), results, &json!(1))
    );
    assert_ne!(client.get(PLACE).header("etag"), Some(&*tag));

    // Results go with their scene.
    let file = daemon.state().join("accuracy/grid.json");
    assert!(file.exists());
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    assert_eq!(client.get(PLACE).problem()["type"], format!("{STATE}unknown-scene"));
    assert!(!file.exists());
}

#[test]
fn a_measurement_starves_nobody_and_can_be_cancelled() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    begin(&client, &endless());
    drawing(&client);
    // Frames of requests come first: fifty of them take no longer than a few frames of the measurement.
    let before = state(&client)["progress"]["done"].as_u64().unwrap();
    let began = Instant::now();
    for number in 0..50 {
        let reply = client.get(&format!("/v1/scenes/grid/frame?w=32&h=32&fov={}", 30 + number));
        assert_eq!(reply.status, 200, "{}", reply.text());
    }
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    // The measurement goes on meanwhile and afterwards.
    eventually("more of the measurement", || {
        state(&client)["progress"]["done"].as_u64().unwrap() > before
    });

    let cancelled = cancel(&client);
    assert_eq!((&cancelled["state"], &cancelled["results"]), (&json!("cancelled"), &Value::Null));
    assert_eq!(cancel(&client)["state"], "cancelled");
    begin_after(&client, &endless());
    drawing(&client);
    // A scene that changes ends its measurement.
    let hidden = client.send(
        "PATCH",
        "/v1/scenes/grid/nodes/wall",
        &[("content-type", "application/json")],
        Some(br#"{"scale": 0.9}"#),
    );
    assert_eq!(hidden.status, 200);
    let failed = ended(&client, "failed");
    assert_eq!(failed["error"]["type"], format!("{STATE}scene-changed"), "{failed}");

    // Deleting cancels, too, and leaves nothing.
    begin_after(&client, &endless());
    assert_eq!(client.send("DELETE", PLACE, &[], None).status, 204);
    assert_eq!(client.get(PLACE).json()["state"], "not_measured");
    let gone = client.send("DELETE", PLACE, &[], None);
    assert_eq!(
        (gone.status, &gone.problem()["type"]),
        (404, &json!(format!("{STATE}not-measured")))
    );
    let idle = client.send("POST", &format!("{PLACE}/cancel"), &[], None);
    assert_eq!((idle.status, &idle.json()["state"]), (200, &json!("not_measured")));
    // A daemon that stops does not wait for a measurement.
    begin_after(&client, &endless());
    let mut daemon = daemon;
    assert!(daemon.terminate().success());
}

/// Lines of the journal of the running measurement.
fn journal(daemon: &Daemon) -> Vec<String> {
    let file = daemon.state().join("accuracy/unfinished/report/measurements.jsonl");
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.split_inclusive('\n').filter(|line| line.ends_with('\n')).map(str::to_owned).collect()
}

#[test]
fn a_measurement_goes_on_after_the_process_has_ended() {
    let mut daemon = Daemon::start(&[]);
    let long = json!({ "w": 32, "h": 24, "repeats": 20, "quick": false, "cameras": ["front"] });
    begin(&daemon.client(), &long);
    // Killed, and told to stop: the next process goes on by itself with what was measured.
    let mut before = Vec::new();
    for is_killed in [true, false] {
        eventually("more measurements", || journal(&daemon).len() > before.len() + 10);
        daemon = match is_killed {
            true => daemon.kill_and_restart(&[]),
            false => daemon.restart(&[]),
        };
        before = journal(&daemon);
        let client = daemon.client();
        eventually("the measurement to go on", || {
            let found = state(&client);
            let done = found["progress"]["done"].as_u64().unwrap_or(0);
            found["state"] == "running" && done > 5
        });
        eventually("more measurements", || journal(&daemon).len() > before.len());
        assert_eq!(journal(&daemon)[..before.len()], before);
    }
    let client = daemon.client();
    cancel(&client);
    let folder = daemon.state().join("accuracy/unfinished");
    eventually("its journal to be removed", || !folder.exists());
    // One that goes on ends with results of all that was measured.
    begin_after(&client, &json!({ "w": 32, "h": 24, "repeats": 4, "cameras": ["front"] }));
    eventually("measurements", || journal(&daemon).len() > 8);
    let daemon = daemon.kill_and_restart(&[]);
    let done = ended_after_restart(&daemon.client());
    let scope = &done["results"]["scopes"][0];
    let timed =
        scope["entries"].as_array().unwrap().iter().filter(|entry| entry["same_as"].is_null());
    let counts: Vec<u64> = timed.map(|entry| entry["gpu_ms"]["count"].as_u64().unwrap()).collect();
    assert!(counts.len() > 5 && counts.iter().all(|&count| count == 4), "{counts:?}");
    eventually("its journal to be removed", || !folder.exists());
}

/// Waits until a measurement that goes on by itself has begun and ended.
fn ended_after_restart(client: &Client) -> Value {
    eventually("the measurement to go on", || {
        ["running", "done"].map(Value::from).contains(&state(client)["state"])
    });
    ended(client, "done")
}

#[test]
fn what_cannot_be_measured_is_refused_at_once() {
    let empty = r#"{"assets": {}, "nodes": []}"#;
    let daemon = Daemon::start_in(
        |root| std::fs::write(root.join("empty.json"), empty).unwrap(),
        &["--max-pixels", "1000000"],
    );
    let client = daemon.client();
    for (body, parameter) in [
        (json!({ "cameras": ["frnt"] }), "cameras"),
        (json!({ "cameras": [] }), "cameras"),
        (json!({ "w": 300, "h": 300 }), "w"),
        (json!({ "repeats": 0 }), "repeats"),
        (json!({ "oracle": true }), "oracle"),
    ] {
        let reply = client.post_json(PLACE, &body);
        assert_eq!(reply.status, 422, "{body}: {}", reply.text());
        assert_eq!(reply.problem()["parameter"], parameter, "{body}");
    }
    let near = client.post_json(PLACE, &json!({ "cameras": ["frnt"] })).problem();
    assert!(near["detail"].as_str().unwrap().contains("front"), "{near}");
    let reply = client.post_json("/v1/scenes/empty/accuracy", &json!({}));
    assert_eq!(
        (reply.status, reply.problem()["type"].as_str()),
        (422, Some(&*format!("{STATE}scene-refused")))
    );
    assert_eq!(client.post_json("/v1/scenes/none/accuracy", &json!({})).status, 404);
    assert_eq!(client.get("/v1/scenes/none/accuracy").status, 404);
    assert_eq!(client.get(PLACE).json()["state"], "not_measured", "nothing was begun");
}

#[test]
fn a_measurement_for_the_planner_serves_goals() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let plan = || {
        let reply = client.get("/v1/scenes/grid/frame?camera=front&w=64&h=48&min_psnr_db=10");
        assert_eq!(reply.status, 200, "{}", reply.text());
        let warning = reply.header("pointillist-warning").unwrap_or_default().to_owned();
        (reply.receipt()["planned"].clone(), warning)
    };
    let (unknown, warning) = plan();
    assert_eq!((&unknown["keeps"], &unknown["chosen"]), (&Value::Null, &Value::Null), "{unknown}");
    let reason = "the goal of 10 dB is not promised: the scene was not measured";
    assert!(warning.contains(reason), "{warning}");
    assert_eq!(state(&client)["planner"], Value::Null);
    begin(&client, &json!({ "planner": true, "w": 16, "h": 12 }));
    let done = ended(&client, "done");
    assert_eq!(done["planner"]["poses"], 24, "{done}");
    assert!(done["planner"]["settings"].as_u64().is_some_and(|count| count > 5), "{done}");
    assert_eq!(done["results"], Value::Null);
    let (known, warning) = plan();
    assert_eq!((&known["keeps"], &known["poses"]), (&json!(true), &json!(24)), "{known}");
    assert!(!warning.contains("promised"), "{warning}");
    assert!(known["actual_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{known}");
    // Moving frames of a stream are chosen as well, and the still one that follows is not.
    let mut stream =
        Stream::open(&daemon, "/v1/scenes/grid/stream?camera=front&w=256&h=192&format=raw");
    let frames = stream.frames_until(|frame| frame["quality"] == "still");
    assert!(frames.len() > 1, "a moving one comes first");
    for frame in &frames {
        let plan = &frame["receipt"]["planned"];
        if frame["quality"] == "still" {
            assert_eq!((plan, &frame["width"]), (&Value::Null, &json!(256)));
            continue;
        }
        assert!(plan["budget_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{plan}");
        assert!(plan["because"].as_str().is_some_and(|why| why.starts_with("the pose moves")));
        let setting = plan["chosen"]["setting"].as_str().unwrap();
        let scale = frame["scale"].as_f64().unwrap();
        assert_eq!(setting.contains("size="), scale < 1.0, "{setting} at {scale}");
        assert_eq!(frame["width"].as_f64(), Some((256.0 * scale).round()), "{setting}");
        // The link is not known yet.
        assert!(scale <= 0.5, "{scale}");
    }
    drop(stream);
    let removed = |status: u16| {
        let reply = client.send("DELETE", PLACE, &[], None);
        assert_eq!(reply.status, status, "{}", reply.text());
    };
    removed(204);
    removed(404);
    assert_eq!(state(&client)["planner"], Value::Null);
    let mut stream = Stream::open(&daemon, "/v1/scenes/grid/stream?camera=front&w=256&h=192");
    assert_eq!(stream.frame()["receipt"]["planned"], Value::Null);
}

#[test]
fn a_measurement_for_the_planner_has_its_own_views() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for (name, value) in
        [("quick", json!(true)), ("cameras", json!(["front"])), ("repeats", json!(2))]
    {
        let reply = client.post_json(PLACE, &json!({ "planner": true, name: value }));
        assert_eq!(
            (reply.status, &reply.json()["parameter"]),
            (422, &json!(name)),
            "{}",
            reply.text()
        );
    }
    let reply = client.post_json(PLACE, &json!({ "planner": true, "w": 1024, "h": 1024 }));
    assert_eq!(reply.status, 422, "{}", reply.text());
    // The largest frames have three times the size, and their references four times that: sides of 8192 pixels.
    let problem = reply.problem();
    let accepted = problem["accepted"].as_str().unwrap();
    assert!(accepted.ends_with("and 682 a side"), "{problem}");
}
