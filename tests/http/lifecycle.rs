//! Start, configuration, health, stop.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use pointillist::http::access::Access;
use pointillist::http::rules::{Bounds, Reread};
use pointillist::http::{Edge, Settings, StreamLimits, UploadLimits, Uploads, WatchLimits};

use super::client::{raw, read_to_close};
use super::daemon::{Daemon, eventually};

#[test]
fn it_says_where_it_is_and_how_to_use_it() {
    let daemon = Daemon::start(&[]);
    assert_eq!(daemon.greeting[0], format!("listening on http://{}", daemon.address));
    let curl = daemon.greeting.iter().find(|line| line.starts_with("curl ")).unwrap();
    let url = curl.split('\'').nth(1).unwrap();
    let path = url.strip_prefix(&format!("http://{}", daemon.address)).unwrap();
    let client = daemon.client();
    assert_eq!(client.get(path).status, 200);
    assert_eq!(client.get("/healthz").text(), "ok\n");
    assert_eq!(client.get("/readyz").text(), "ready\n");
    let viewer = client.get("/");
    assert!(viewer.header("content-type").unwrap().starts_with("text/html"));
    assert_eq!(client.get("/v1/scene-schema.json").json()["type"], "object");
    assert_eq!(client.get("/openapi.yaml").text(), include_str!("../../openapi.yaml"));
    let metrics = client.get("/metrics").text();
    assert!(metrics.contains("route=\"/healthz\",method=\"GET\",status=\"200\"} 1"), "{metrics}");
    assert!(metrics.ends_with("# EOF\n"));
}

#[test]
fn sigterm_finishes_what_is_in_flight() {
    let mut daemon = Daemon::start(&["--max-batch", "1"]);
    let mut busy: Vec<_> = (0..4)
        .map(|i| {
            let request = format!(
                "GET /v1/scenes/grid/frame?eye={i},1,3&target=0,0,0&w=2048&h=2048 HTTP/1.1\r\nHost: localhost\r\n\r\n"
            );
            raw(daemon.address, request.as_bytes())
        })
        .collect();
    let idle = raw(daemon.address, b"");
    // The server need not answer requests that it has not read when the signal arrives. Connections are accepted in order, so if
    // a later one is answered, these have been read. One of the four requests may be between the queue and its end.
    eventually("work", || {
        let client = daemon.client();
        let queued = client.metric("pointillist_engine_queued");
        let frames = client.metric("pointillist_engine_frames_total");
        queued + frames >= 3.0
    });
    let asked = Instant::now();
    daemon.signal();
    for stream in &mut busy {
        let answer = read_to_close(stream);
        assert!(answer.starts_with("HTTP/1.1 200 "), "{:.200}", answer);
    }
    assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
    assert!(asked.elapsed() < Duration::from_secs(30));
    drop(idle);
    assert!(std::net::TcpStream::connect(daemon.address).is_err());
}

#[test]
fn a_scene_that_fails_does_not_stop_the_others() {
    let daemon = Daemon::start_in(
        |root| {
            std::fs::write(root.join("broken.json"), "{\"assets\": 3}").unwrap();
            std::fs::create_dir_all(root.join("uploads/.partial-1-0")).unwrap();
        },
        &[],
    );
    let client = daemon.client();
    assert!(daemon.log().contains("broken.json"), "{}", daemon.log());
    assert_eq!(client.get("/v1/scenes/broken").json()["state"], "failed");
    assert_eq!(client.get("/v1/scenes/grid").json()["state"], "ready");
    assert!(daemon.uploads().is_empty(), "remains of an earlier run");
}

/// Runs `serve` with arguments that it refuses, and returns its message.
fn complaint(folder: &std::path::Path, args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_pointillist"))
        .args(["serve", "--listen", "127.0.0.1:0", "--root"])
        .arg(folder)
        .args(args)
        .env("POINTILLIST_NO_JOBS", "true")
        .env("POINTILLIST_NO_PRIME", "true")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn what_cannot_work_is_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("c.toml");
    std::fs::write(&config, "quue = 3\n").unwrap();
    std::fs::write(folder.path().join("bad.ply"), "ply\nnonsense").unwrap();
    let config = config.to_str().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    for (args, expected) in [
        (&["--config", config][..], "`queue`"),
        (&["--listen", "0.0.0.0:0"], "--api-keys"),
        (&["--listen", "nowhere"], "HOST:PORT"),
        (&["--listen", &taken], "cannot listen"),
        (&["--root", "/nonexistent"], "--root"),
        (&["--queue", "0"], "--queue"),
        (&["--scene", "none.ply"], "none.ply"),
        (&["--scene", "bad.ply"], "none of the scenes"),
    ] {
        let args: Vec<&str> = args.to_vec();
        let text = if args[0] == "--listen" || args[0] == "--root" {
            overriding(folder.path(), &args)
        } else {
            complaint(folder.path(), &args)
        };
        assert!(text.contains(expected), "{args:?}: {text}");
    }
}

/// As [`complaint`], for flags that `complaint` sets itself.
fn overriding(folder: &std::path::Path, args: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
    command.arg("serve").args(args).env("POINTILLIST_NO_JOBS", "true").stdin(Stdio::null());
    if args[0] != "--root" {
        command.arg("--root").arg(folder);
    }
    let output = command.output().unwrap();
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Settings of a server within this process.
pub fn settings(root: &Path) -> Settings {
    Settings {
        root: root.to_owned(),
        access: Access::Open { cors_origins: Vec::new(), only_loopback: true },
        cors_origins: Vec::new(),
        max_connections: 4,
        frame_timeout: Duration::from_secs(60),
        read_timeout: Duration::from_secs(10),
        drain: Duration::from_secs(1),
        drain_delay: Duration::ZERO,
        uploads: Uploads::Kept,
        bounds: Bounds {
            trusted_proxies: Vec::new(),
            requests_per_second_per_address: None,
            max_connections_per_address: None,
            max_upload_bytes: 1 << 20,
            uploads: UploadLimits {
                scenes: 1,
                scenes_per_key: 1,
                bytes: 1 << 20,
                bytes_per_key: 1 << 20,
            },
            streams: StreamLimits { most: 4, most_per_client: 4, idle: Duration::from_secs(10) },
            watches: WatchLimits { most: 4, most_per_client: 4, longest: Duration::from_secs(10) },
        },
        reread: Reread::default(),
        edge: Edge::default(),
    }
}

#[test]
fn a_server_that_can_never_draw_again_says_so() {
    use pointillist::engine::{Engine, EngineConfig, Readiness};
    use pointillist::http::{App, Phase, router};
    use tower::ServiceExt;

    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(EngineConfig::new(folder.path())).unwrap();
    let app =
        App::new(engine.clone(), settings(folder.path()), Err("no jobs in this test".to_owned()));
    app.set_phase(Phase::Serving);
    let router = router(app);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let status = |path: &str| {
        let request = axum::http::Request::get(path)
            .header("host", "localhost")
            .body(axum::body::Body::empty())
            .unwrap();
        runtime.block_on(router.clone().oneshot(request)).unwrap().status().as_u16()
    };
    assert_eq!((status("/healthz"), status("/readyz")), (200, 200));
    engine.break_render_thread();
    super::daemon::eventually("the failure", || engine.readiness() == Readiness::Failed);
    assert_eq!((status("/healthz"), status("/readyz")), (503, 503));
    assert_eq!(status("/v1/scenes"), 200, "what needs no rendering");
}

/// A handler is dropped when its client goes away.
#[test]
fn changes_without_an_answer_are_in_the_audit_log() {
    use pointillist::engine::{Engine, EngineConfig};
    use pointillist::http::journal::Journal;
    use pointillist::http::{App, Phase, router};
    use tower::ServiceExt;

    let folder = tempfile::tempdir().unwrap();
    let audit = folder.path().join("audit.log");
    let journal = std::sync::Arc::new(Journal::open(&audit).unwrap());
    let edge = Edge { audit_log: Some(journal.clone()), ..Edge::default() };
    let settings = Settings { edge, ..settings(folder.path()) };
    let engine = Engine::start(EngineConfig::new(folder.path())).unwrap();
    let app = App::new(engine, settings, Err("no jobs in this test".to_owned()));
    app.set_phase(Phase::Serving);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let wait = |origin: &str| {
        // More of the body never comes.
        let body = futures::stream::pending::<Result<bytes::Bytes, std::io::Error>>();
        let request = axum::http::Request::post("/v1/scenes?id=half&name=a.ply")
            .header("host", "localhost")
            .header("origin", origin)
            .body(axum::body::Body::from_stream(body))
            .unwrap();
        let answer = router(app.clone()).oneshot(request);
        let patience = Duration::from_millis(200);
        let ended = runtime.block_on(async { tokio::time::timeout(patience, answer).await });
        assert!(ended.is_err(), "{origin}");
    };
    wait("http://localhost");
    // This one is refused, and then waits for the rest of its body.
    wait("https://evil.example");
    assert!(journal.flush(Duration::from_secs(60)));
    let text = std::fs::read_to_string(&audit).unwrap();
    let lines: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 1, "{text}");
    assert_eq!((&lines[0]["event"], &lines[0]["method"]), (&"client-gone".into(), &"POST".into()));
    assert!(lines[0]["status"].is_null(), "{text}");
}
