//! Tests `pointillist load` with the real daemon, and with servers that stall, refuse and fall silent.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

#[path = "http/client.rs"]
#[allow(dead_code, reason = "shared with the tests of HTTP, which use all of it")]
mod client;
#[path = "http/daemon.rs"]
#[allow(dead_code, reason = "shared with the tests of HTTP, which use all of it")]
mod daemon;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Output};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use daemon::Daemon;
use serde_json::Value;

fn load(url: &str, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pointillist"))
        .args(["load", url])
        .args(args)
        .env_remove("POINTILLIST_KEY")
        .output()
        .unwrap()
}

fn report(url: &str, args: &[&str]) -> Value {
    let output = load(url, &[args, &["--json"]].concat());
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {complaint}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn complaint(url: &str, args: &[&str]) -> String {
    let output = load(url, args);
    assert_eq!(output.status.code(), Some(1), "{args:?}: {output:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn ms(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}")) / 1e6
}

const SMALL: [&str; 4] = ["--size", "48x32", "--warmup", "0.3"];

#[test]
fn frames_of_a_daemon_are_measured() {
    let daemon = Daemon::start(&[]);
    let url = format!("http://{}", daemon.address);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new/report");
    let before = daemon.client().metric("pointillist_frames_sent_total");
    let output = load(
        &url,
        &[
            &SMALL[..],
            &[
                "--rates",
                "20,40",
                "--duration",
                "1.5",
                "--format",
                "qoi",
                "-o",
                out.to_str().unwrap(),
            ],
        ]
        .concat(),
    );
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{output:?}");
    assert!(told.contains("requested/s") && told.contains("grid · w=48 h=32 format=qoi"), "{told}");
    let lines = String::from_utf8_lossy(&output.stderr);
    assert_eq!(lines.lines().filter(|line| line.contains("/s requested, ")).count(), 2, "{lines}");

    let json: Value =
        serde_json::from_slice(&std::fs::read(out.join("load.json")).unwrap()).unwrap();
    let points = json["points"].as_array().unwrap();
    assert_eq!(points.len(), 2);
    let mut frames = 0;
    for (point, rate) in points.iter().zip([20.0, 40.0]) {
        assert_eq!(point["rate_per_s"], rate);
        let requests = point["requests"].as_u64().unwrap();
        frames += point["counts"]["frames"].as_u64().unwrap();
        // Within five standard deviations of a Poisson count.
        let expected: f64 = rate * 1.5;
        assert!((requests as f64 - expected).abs() < 5.0 * expected.sqrt(), "{point}");
        assert_eq!(point["counts"]["frames"], requests, "{point}");
        let latency = &point["latency"];
        assert!(ms(&latency["p50_ns"]) > 0.0 && ms(&latency["max_ns"]) >= ms(&latency["p99_ns"]));
        let receipts = &point["receipts"];
        assert_eq!((&receipts["read"], &receipts["coalesced"]), (&requests.into(), &0.into()));
        assert!(receipts["queue_p50_ns"].is_u64() && receipts["batch_size_mean"].is_f64());
        assert!(point["bytes"].as_u64().unwrap() > requests * 14);
    }
    assert!(json["adapter"].as_str().is_some_and(|name| !name.is_empty()), "{json}");
    assert_eq!(json["settings_used"]["asked"], "auto");
    // The warm-up's frames and the first frame are sent as well.
    let sent = daemon.client().metric("pointillist_frames_sent_total") - before;
    assert!(sent > frames as f64, "{sent} {frames}");
    // Connections are kept alive.
    assert!(json["connections_opened"].as_u64().unwrap() < sent as u64 / 2, "{json}");

    let svg = std::fs::read_to_string(out.join("load.svg")).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let adapter = json["adapter"].as_str().unwrap();
    assert!(
        document
            .descendants()
            .any(|node| node.text().is_some_and(|text| text.contains(&adapter[..8])))
    );
}

#[test]
fn saturation_of_a_daemon_is_found() {
    // Frames so large that no CPU adapter draws a few hundred per second, and a short queue.
    let daemon = Daemon::start(&["--queue", "8", "--max-batch", "2"]);
    let url = format!("http://{}", daemon.address);
    let json = report(
        &url,
        &[
            "--saturate",
            "--first-rate",
            "8",
            "--factor",
            "4",
            "--resolution",
            "0.5",
            "--duration",
            "1",
            "--warmup",
            "0.2",
            "--size",
            "1024x1024",
            "--format",
            "png",
            "--max-rate",
            "600",
            "--seed",
            "3",
        ],
    );
    let knee = &json["knee"];
    let points = json["points"].as_array().unwrap();
    let rates: Vec<f64> =
        points.iter().map(|point| point["rate_per_s"].as_f64().unwrap()).collect();
    assert!(rates.is_sorted() && rates.len() >= 3, "{rates:?}");
    let Some(kept) = knee["keeps_up_to_per_s"].as_f64() else { panic!("{json}") };
    if knee["is_bounded"] == true {
        let beyond =
            points.iter().find(|point| point["rate_per_s"].as_f64().unwrap() > kept).unwrap();
        assert_ne!(beyond["verdict"], "keeps_up");
        let last = points.last().unwrap();
        assert!(last["throughput_per_s"].as_f64() < last["offered_per_s"].as_f64());
        // Requests beyond the short queue are refused, with `Retry-After`. A slow machine may be saturated by fewer than the queue
        // and two batches hold; the duration is one second.
        let counts = &last["counts"];
        let [asked, answered] = ["requests", "throughput_per_s"].map(|key| last[key].as_f64());
        let waiting = asked.unwrap() - answered.unwrap();
        assert!(waiting <= 12.0 || counts["refused"].as_u64().unwrap() > 0, "{last}");
        assert_eq!(counts["refused"], counts["refused_with_retry_after"]);
    }
}

#[test]
fn what_the_daemon_refuses_is_said_at_once() {
    let daemon = Daemon::start_in(
        |root| {
            let folder = root.join("other.json");
            std::fs::write(folder, daemon::grid_scene("grid.ply").to_string()).unwrap();
        },
        &[],
    );
    let url = format!("http://{}", daemon.address);
    // Without --scene the first scene is taken and named.
    let said = complaint(&url, &["--lod", "full", "--max-error-px", "2"]);
    assert!(said.contains("--scene ") && said.contains("the first of 2 that are ready"), "{said}");
    assert!(said.contains("422"), "{said}");
    let said = complaint(&url, &["--scene", "gird"]);
    assert!(said.contains("404"), "{said}");
    let line = ["--scene", "grid", "--lod", "full", "--max-error-px", "2"];
    let said = complaint(&url, &line);
    assert!(said.contains("422") && said.contains("max_error_px"), "{said}");
    let said = complaint(&url, &["--scene", "grid", "--poses", "cameras"]);
    assert!(said.contains("needs two"), "{said}");
    let said = complaint("https://127.0.0.1:1", &[]);
    assert!(said.contains("https is not supported"), "{said}");
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let said = complaint(&format!("http://{nobody}"), &[]);
    assert!(said.contains("cannot connect"), "{said}");
}

#[test]
fn keys_are_sent() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    let hash = "2c70e12b7a0646f92279f427c7b38e7334d8e5389cff167a1dc30e73f826b683"; // SHA-256 of `key`
    std::fs::write(&keys, format!("loader read {hash}\n")).unwrap();
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap()]);
    let url = format!("http://{}", daemon.address);
    assert!(complaint(&url, &[]).contains("401"));
    let json = report(
        &url,
        &[&SMALL[..], &["--key", "key", "--rate", "20", "--duration", "0.5"]].concat(),
    );
    assert!(json["points"][0]["counts"]["frames"].as_u64().unwrap() > 0);
    assert!(!json.to_string().contains("\"key\""), "a key is no part of a report");
}

#[test]
fn streams_beside_requests_are_measured() {
    let daemon = Daemon::start(&[]);
    let url = format!("http://{}", daemon.address);
    let streams = ["--streams", "3", "--pose-rate", "25", "--rate", "10", "--duration", "2"];
    let folder = tempfile::tempdir().unwrap();
    let out = ["-o", folder.path().to_str().unwrap()];
    let json = report(&url, &[&SMALL[..], &streams, &out].concat());
    assert_eq!((&json["client"], &json["run"]["streams"]), (&"request, stream".into(), &3.into()));
    let point = &json["points"][0];
    assert!(point["counts"]["frames"].as_u64().unwrap() > 0, "{point}");
    let beside = &point["streams"];
    let count = |name: &str| beside[name].as_u64().unwrap_or_else(|| panic!("{name}: {beside}"));
    // Evenly spaced poses: 25 per second for two seconds, on three streams.
    assert_eq!((count("poses"), count("lost"), count("broken"), count("problems")), (150, 0, 0, 0));
    assert_eq!(beside["latency"]["answered"], 150, "{beside}");
    let drawn = beside["drawn"]["answered"].as_u64().unwrap();
    assert_eq!(drawn + count("overtaken"), 150, "every pose was drawn or overtaken: {beside}");
    assert!(count("frames") > 0 && count("least_frames") > 0, "{beside}");
    assert!(ms(&beside["latency"]["p50_ns"]) > 0.0, "{beside}");
    let metrics = daemon.client();
    assert!(metrics.metric("pointillist_stream_frames_total") >= count("frames") as f64);
    daemon::eventually("closed streams", || metrics.metric("pointillist_streams_open") == 0.0);
    let svg = std::fs::read_to_string(folder.path().join("load.svg")).unwrap();
    assert!(svg.contains("stream p99") && svg.contains("3 streams of 25.0 poses/s"), "{svg}");
}

#[test]
fn streams_that_are_refused_count_as_lost() {
    let daemon = Daemon::start(&["--max-streams-per-client", "1"]);
    let url = format!("http://{}", daemon.address);
    let streams = ["--streams", "3", "--pose-rate", "20", "--rate", "5", "--duration", "1"];
    let json = report(&url, &[&SMALL[..], &streams, &["--timeout", "5"]].concat());
    let beside = &json["points"][0]["streams"];
    assert_eq!((&beside["broken"], &beside["poses"]), (&2.into(), &60.into()), "{beside}");
    assert_eq!((&beside["lost"], &beside["latency"]["p90_ns"]), (&40.into(), &Value::Null));
    assert!(json["warnings"].to_string().contains("4429"), "{json}");
    let said = complaint(&url, &["--streams", "1", "--param", "deadline_ms=9"]);
    assert!(said.contains("deadline_ms"), "{said}");
}

/// A server of tiny frames, whose answers `frame` decides.
struct Server {
    address: SocketAddr,
    /// The requested paths.
    paths: Arc<Mutex<Vec<String>>>,
}

impl Server {
    /// Starts a server. `frame` answers the frame of this number on the connection, and returns false to close it.
    fn start(frame: impl Fn(usize, &mut TcpStream) -> bool + Send + Sync + 'static) -> Server {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (paths, frame) = (Arc::new(Mutex::new(Vec::new())), Arc::new(frame));
        let seen = paths.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let (seen, frame) = (seen.clone(), frame.clone());
                std::thread::spawn(move || serve(stream, &seen, frame.as_ref()));
            }
        });
        Server { address, paths }
    }

    fn url(&self) -> String {
        format!("http://{}", self.address)
    }
}

fn answer(stream: &mut TcpStream, head: &str, body: &str) -> bool {
    let length = body.len();
    write!(stream, "HTTP/1.1 {head}\r\nContent-Length: {length}\r\n\r\n{body}").is_ok()
}

fn serve(
    mut stream: TcpStream,
    seen: &Mutex<Vec<String>>,
    frame: &dyn Fn(usize, &mut TcpStream) -> bool,
) {
    const SCENE: &str = r#"{"state":"ready","id":"s","revision":1,"bounds":[[0,0,0],[1,1,1]],"up":[0,1,0],"cameras":[]}"#;
    stream.set_nodelay(true).unwrap();
    let mut lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
    while let Some(first) = lines.next() {
        let path = first.split(' ').nth(1).unwrap_or_default().to_owned();
        while lines.next().is_some_and(|line| !line.is_empty()) {}
        let goes_on = if path == "/v1/scenes" {
            answer(&mut stream, "200 OK", &format!("{{\"scenes\":[{SCENE}]}}"))
        } else if path == "/v1/scenes/s" {
            answer(&mut stream, "200 OK", SCENE)
        } else {
            let number = {
                let mut seen = seen.lock().unwrap();
                seen.push(path);
                seen.len() - 1
            };
            frame(number, &mut stream)
        };
        if !goes_on {
            return;
        }
    }
}

/// A server that stalls twice: it holds the answers to [`HELD`] consecutive requests until all of them have arrived.
struct Stalling {
    arrived: Mutex<usize>,
    changed: Condvar,
}

/// Number of requests that arrive during a stall.
const HELD: usize = 50;

impl Stalling {
    /// Answers a request, unless its stall does not end.
    fn answer(&self, number: usize, stream: &mut TcpStream) -> bool {
        let stall =
            [100, 200].map(|first| first..first + HELD).into_iter().find(|s| s.contains(&number));
        let mut arrived = self.arrived.lock().unwrap();
        *arrived = (*arrived).max(number + 1);
        self.changed.notify_all();
        let stands = |arrived: &mut usize| stall.as_ref().is_some_and(|stall| *arrived < stall.end);
        let waited = self.changed.wait_timeout_while(arrived, Duration::from_secs(60), stands);
        !waited.unwrap().1.timed_out() && answer(stream, "200 OK", "frame")
    }
}

/// Requests are sent when they are due, however slow earlier answers are. A stall that holds 50 requests lasts half a second at
/// 100 per second, and the latency of each of the 50 counts from when it was due. A client that waits for each answer before its
/// next request would see only two slow requests.
#[test]
fn a_stall_is_in_the_percentiles() {
    let stalling = Stalling { arrived: Mutex::new(0), changed: Condvar::new() };
    let server = Server::start(move |number, stream| stalling.answer(number, stream));
    let args = ["--rate", "100", "--duration", "3", "--warmup", "0", "--spacing", "constant"];
    let json = report(&server.url(), &[&args[..], &["--connections", "200"]].concat());
    let point = &json["points"][0];
    assert_eq!(point["counts"]["frames"], 300, "{point}");
    // The first request of a stall waits for at least 490 ms, the next one for 480 ms, and so on. Latencies are rounded by a few
    // per cent.
    let at_least = |percentile: &str, waited_ms: f64| {
        let found = ms(&point["latency"][percentile]);
        assert!(found >= 0.95 * waited_ms, "{percentile}: {found} ms, at least {waited_ms}");
    };
    at_least("max_ns", 490.0);
    at_least("p99_ns", 470.0);
    at_least("p90_ns", 340.0);
}

/// With at most one request in flight, requests that are due during a stall are not sent. They count as lost.
#[test]
fn a_stall_is_not_hidden_by_a_limit() {
    // The first request is made before the load begins. The stall ends when the client gives up.
    const ANSWERED: usize = 60;
    let server = Server::start(|number, stream| match number {
        0..=ANSWERED => answer(stream, "200 OK", "frame"),
        _ => stream.read(&mut [0]).is_ok_and(|read| read > 0),
    });
    let args = ["--rate", "50", "--duration", "2", "--warmup", "0", "--spacing", "constant"];
    let limits = ["--connections", "1", "--timeout", "3"];
    let json = report(&server.url(), &[&args[..], &limits].concat());
    let point = &json["points"][0];
    let counts = ["frames", "timed_out", "not_sent"].map(|name| &point["counts"][name]);
    assert_eq!(counts, [60, 1, 39], "{point}");
    assert!(point["latency"]["p50_ns"].is_u64(), "{point}");
    assert_eq!(point["latency"]["p90_ns"], Value::Null, "{point}");
    assert!(json["warnings"].to_string().contains("--connections"), "{json}");
}

/// The exit code reports broken thresholds, as with k6, oha and vegeta in CI.
#[test]
fn broken_thresholds_end_with_their_exit_code() {
    // Every fifth request is refused. Request 0 is made before the load begins.
    let server = Server::start(|number, stream| match number % 5 {
        1 => answer(stream, "503 Service Unavailable\r\nRetry-After: 1", "{}"),
        _ => answer(stream, "200 OK", "frame"),
    });
    let steady = ["--rate", "50", "--duration", "1", "--warmup", "0", "--spacing", "constant"];
    for (thresholds, code, words) in [
        (&["--fail-refused", "20%", "--fail-lost", "0", "--fail-p99-ms", "60000"][..], 0, ""),
        (
            &["--fail-refused", "0.19"],
            3,
            "10 of 50 requests are refused (20.00 %), and --fail-refused is 19 %",
        ),
        (&["--fail-errors", "0"], 3, "10 of 50 requests are without a frame"),
        (&["--fail-p99-ms", "0.0001"], 3, "and --fail-p99-ms is 0.0001"),
        (&["--fail-achieved", "1"], 3, "--fail-achieved is 100 %"),
        (&["--fail-lost", "2"], 2, "expected a share"),
        (&["--fail-knee", "5"], 2, "cannot be used with '--fail-knee"),
    ] {
        let output = load(&server.url(), &[&steady, thresholds].concat());
        let told = [output.stdout.clone(), output.stderr.clone()].concat();
        let told = String::from_utf8_lossy(&told);
        assert_eq!(output.status.code(), Some(code), "{thresholds:?}: {told}");
        assert!(told.contains(words), "{thresholds:?}: {told}");
        assert!(code == 2 || told.contains("50.0/s requested, 50.0/s sent, "), "{told}");
    }
    let output = load(&server.url(), &[&steady[..], &["--json", "--fail-errors", "0"]].concat());
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["thresholds"]["fail_errors"], 0.0);
    assert_eq!(json["broken_thresholds"].as_array().unwrap().len(), 1, "{json}");
}

#[test]
fn every_answer_is_counted_as_what_it_is() {
    let server = Server::start(|number, stream| match number % 8 {
        1 => answer(stream, "503 Service Unavailable\r\nRetry-After: 1", "{}"),
        2 => answer(stream, "429 Too Many Requests", "{}"),
        3 => answer(stream, "500 Internal Server Error", r#"{"detail":"it broke"}"#),
        4 => stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\nhalf").is_err(),
        // Do not answer until the client gives up.
        5 => stream.flush().is_ok(),
        _ => answer(stream, "200 OK", "frame"),
    });
    let json = report(
        &server.url(),
        &[
            "--rate",
            "80",
            "--duration",
            "1",
            "--warmup",
            "0",
            "--spacing",
            "constant",
            "--timeout",
            "0.4",
        ],
    );
    let point = &json["points"][0];
    let count = |name: &str| point["counts"][name].as_u64().unwrap();
    assert_eq!(point["requests"], 80, "{point}");
    assert_eq!((count("refused"), count("refused_with_retry_after")), (20, 10), "{point}");
    assert_eq!((count("failed"), count("broken_off"), count("timed_out")), (10, 10, 10), "{point}");
    assert_eq!(count("frames"), 30, "{point}");
    assert_eq!(point["statuses"]["503"], 10);
    assert_eq!(point["verdict"], "unanswered");
    let warnings = json["warnings"].to_string();
    assert!(warnings.contains("it broke") || warnings.contains("connection closed"), "{warnings}");
    // Every request has another pose.
    let mut paths = server.paths.lock().unwrap().clone();
    paths.sort();
    paths.dedup();
    assert_eq!(paths.len(), 81);
}
