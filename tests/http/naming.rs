//! A request's id in answers, receipts, problems, metrics and the log; and the sum of the stages of a frame.

use serde_json::{Value, json};

use super::client::Reply;
use super::daemon::{Daemon, eventually};
use super::stream::{GRID, Stream, pose};

const FRAME: &str = "/v1/scenes/grid/frame?camera=front&w=64&h=48&format=png";

fn named(daemon: &Daemon, path: &str, name: &str) -> Reply {
    daemon.client().send("GET", path, &[("x-request-id", name)], None)
}

#[test]
fn names_come_back() {
    let daemon = Daemon::start(&[]);
    let reply = named(&daemon, FRAME, "my-frame.7");
    assert_eq!(reply.header("x-request-id"), Some("my-frame.7"));
    assert_eq!(reply.receipt()["request_id"], "my-frame.7");
    let etag = reply.header("etag").unwrap().to_owned();
    let headers = [("x-request-id", "again"), ("if-none-match", etag.as_str())];
    let unchanged = daemon.client().send("GET", FRAME, &headers, None);
    assert_eq!((unchanged.status, unchanged.header("x-request-id")), (304, Some("again")));
    // Refusals by handler, access, missing route and method all carry an id.
    for (path, status) in
        [("/v1/scenes/grid/frame?w=0", 422), ("/v1/scenes/none", 404), ("/none", 404)]
    {
        let reply = named(&daemon, path, "bad/1");
        assert_eq!((reply.status, &reply.problem()["request_id"]), (status, &json!("bad/1")));
        assert_eq!(reply.header("x-request-id"), Some("bad/1"));
    }
    let headers = [("x-request-id", "h"), ("host", "evil.example")];
    let refused = daemon.client().send("GET", "/healthz", &headers, None);
    assert_eq!((refused.status, &refused.problem()["request_id"]), (421, &json!("h")));
}

#[test]
fn who_has_no_usable_name_is_given_one() {
    let daemon = Daemon::start(&[]);
    let long = "x".repeat(129);
    let mut names: Vec<String> = ["two words", "quo\"te", long.as_str()]
        .iter()
        .map(|name| named(&daemon, "/healthz", name))
        .chain([daemon.client().get(FRAME), daemon.client().get("/v1/limits")])
        .map(|reply| reply.header("x-request-id").unwrap().to_owned())
        .collect();
    for name in &names {
        assert!(name.len() == 16 && name.bytes().all(|byte| byte.is_ascii_hexdigit()), "{name}");
    }
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 5, "no two are the same");
}

#[test]
fn parts_and_streams_are_named_after_their_request() {
    let daemon = Daemon::start(&[]);
    let body = json!({"w": 16, "h": 16, "poses": [{}, {"camera": "none"}, {"h": 8}]}).to_string();
    let headers = [("content-type", "application/json"), ("x-request-id", "series")];
    let path = "/v1/scenes/grid/frames";
    let reply = daemon.client().send("POST", path, &headers, Some(body.as_bytes()));
    let text = reply.text();
    for name in ["series/0", "series/1", "series/2"] {
        assert!(text.contains(&format!("\"request_id\":\"{name}\"")), "{name}: {text}");
    }
    let mut stream = Stream::connect(daemon.address, GRID, &[("x-request-id", "viewer")]).unwrap();
    stream.event();
    stream.send(pose(1, 0.0));
    for number in 1..=2 {
        let header = stream.frame();
        assert_eq!(header["receipt"]["request_id"], format!("viewer/{number}"), "{header}");
        assert_eq!(header["frame"], number);
    }
    stream.send(json!({"seq": 2, "w": 0}));
    assert_eq!(stream.event()["request_id"], "viewer");
}

/// The log lines that contain `name`.
fn lines(daemon: &Daemon, name: &str) -> Vec<Value> {
    let log = daemon.log();
    let lines = log.lines().filter(|line| line.contains(name));
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn closes<'a>(lines: &'a [Value], span: &str) -> Option<&'a Value> {
    lines.iter().find(|line| line["fields"]["message"] == "close" && line["span"]["name"] == span)
}

#[test]
fn the_log_tells_a_frames_whole_way_by_its_name() {
    let daemon = Daemon::start_talkative(&[]);
    let receipt = named(&daemon, FRAME, "the-one").receipt();
    daemon.client().get("/v1/scenes/grid/frame?w=32&h=32");
    eventually("the end of its spans", || {
        let lines = lines(&daemon, "the-one");
        ["request", "frame", "batch"].iter().all(|span| closes(&lines, span).is_some())
    });
    let lines = lines(&daemon, "the-one");
    for span in ["queue", "encode", "frame", "request"] {
        let close = closes(&lines, span).unwrap_or_else(|| panic!("no {span}: {lines:#?}"));
        assert_eq!(close["span"]["request_id"], "the-one", "{close}");
        assert!(close["fields"]["time.idle"].is_string(), "{close}");
    }
    let batch = closes(&lines, "batch").unwrap();
    assert_eq!((&batch["span"]["frames"], &batch["span"]["size"]), (&json!("the-one"), &json!(1)));
    // The log has each pass that ran, with the time in the receipt.
    for pass in receipt["passes"].as_array().unwrap().iter().filter(|pass| pass["ran"] == true) {
        let told = lines.iter().find(|line| {
            line["fields"]["message"] == "drawn" && line["fields"]["pass"] == pass["name"]
        });
        let told = told.unwrap_or_else(|| panic!("no {}: {lines:#?}", pass["name"]));
        assert_eq!(told["fields"]["gpu_ns"], pass["gpu_ns"], "{told}");
        assert_eq!(told["span"]["name"], "batch");
    }
    let log = daemon.log();
    assert!(log.lines().any(|line| !line.contains("the-one") && line.contains("\"encode\"")));
}

#[test]
fn without_debug_nothing_is_told_of_frames() {
    let daemon = Daemon::start(&["--log-format", "json"]);
    named(&daemon, FRAME, "quiet");
    assert!(!daemon.log().contains("quiet") && !daemon.log().contains("\"batch\""));
}

/// Parses name and milliseconds of each metric as a browser does (W3C Server Timing).
fn server_timing(line: &str) -> Vec<(String, f64)> {
    let is_token = |text: &str| {
        !text.is_empty()
            && text.bytes().all(|b| b.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&b))
    };
    let entry = |entry: &str| {
        let mut parts = entry.split(';');
        let name = parts.next().unwrap().trim().to_owned();
        assert!(is_token(&name), "{entry}");
        let duration = parts.next().unwrap().strip_prefix("dur=").unwrap().parse().unwrap();
        let words = parts.next().unwrap().strip_prefix("desc=\"").unwrap();
        assert!(words.strip_suffix('"').is_some_and(|words| !words.contains('"')), "{entry}");
        assert_eq!(parts.next(), None, "{entry}");
        (name, duration)
    };
    // Quoted strings may contain commas.
    let mut entries = vec![String::new()];
    let mut is_quoted = false;
    for character in line.chars() {
        is_quoted ^= character == '"';
        match character {
            ',' if !is_quoted => entries.push(String::new()),
            other => entries.last_mut().unwrap().push(other),
        }
    }
    entries.iter().map(|text| entry(text)).collect()
}

#[test]
fn stages_add_up_to_the_total() {
    let daemon = Daemon::start(&["--cors-origin", "https://app.example"]);
    for number in 0..5 {
        let path = format!("/v1/scenes/grid/frame?eye=0,{number},3&target=0,0,0&w=640&h=480");
        let reply = daemon.client().get(&path);
        assert_eq!(reply.header("timing-allow-origin"), Some("https://app.example"));
        let (receipt, timing) = (reply.receipt(), reply.header("server-timing").unwrap());
        let stages = server_timing(timing);
        let (last, parts) = stages.split_last().unwrap();
        assert_eq!(last.0, "total");
        let sum: f64 = parts.iter().map(|(_, ms)| ms).sum();
        assert!(sum <= last.1 + 0.05, "{sum} of {}: {timing}", last.1);
        let ns = |name: &str| receipt[name].as_u64().unwrap();
        let named = [
            "queue_ns",
            "record_ns",
            "device_wait_ns",
            "readback_ns",
            "encode_wait_ns",
            "encode_ns",
        ];
        let sum_ns = named.iter().map(|name| ns(name)).sum::<u64>()
            + receipt["gpu_ns"].as_u64().unwrap_or(0);
        let total_ns = ns("total_ns");
        assert!(sum_ns <= total_ns && sum_ns > total_ns / 2, "{sum_ns} of {total_ns}: {receipt}");
    }
}

#[test]
fn histograms_tell_every_stage_by_class() {
    let daemon = Daemon::start(&[]);
    let passes = named(&daemon, FRAME, "a").receipt()["passes"].clone();
    let mut stream = Stream::open(&daemon, "/v1/scenes/grid/stream?camera=front&w=96&h=96");
    assert_eq!(stream.frame()["seq"], 0);
    let text = daemon.client().get("/metrics").text();
    let has = |start: &str| text.lines().any(|line| line.starts_with(start));
    for stage in ["queue", "gpu", "total"] {
        for class in ["request", "interactive"] {
            let line = format!("pointillist_frame_{stage}_seconds_count{{class=\"{class}\"}} ");
            assert!(
                has(&line) || stage == "gpu" && passes[0]["gpu_ns"].is_null(),
                "{line}\n{text}"
            );
        }
    }
    for line in [
        "frame_device_wait_seconds_count ",
        "frame_readback_seconds_count ",
        "frame_encode_seconds_count ",
        "batch_frames_count ",
    ] {
        assert!(has(&format!("pointillist_{line}")), "{line}\n{text}");
    }
    for pass in passes.as_array().unwrap().iter().filter(|pass| pass["gpu_ns"].is_u64()) {
        let name = pass["name"].as_str().unwrap();
        assert!(
            has(&format!("pointillist_frame_pass_seconds_count{{pass=\"{name}\"}} ")),
            "{name}"
        );
    }
}
