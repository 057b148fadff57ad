//! Many clients, impatient clients, and clients that disconnect.

use std::io::Write;
use std::net::Shutdown;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use super::client::{raw, read_to_close};
use super::daemon::{Daemon, eventually};

#[test]
fn a_flood_gets_frames_or_honest_refusals() {
    let daemon = Daemon::start(&["--queue", "4", "--max-batch", "2"]);
    let (frames, refusals) = (AtomicUsize::new(0), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for thread in 0..24 {
            let (daemon, frames, refusals) = (&daemon, &frames, &refusals);
            scope.spawn(move || {
                let client = daemon.client();
                for request in 0..8 {
                    let x = f64::from(thread * 8 + request) * 0.01;
                    let reply = client.get(&format!(
                        "/v1/scenes/grid/frame?eye={x},0,3&target=0,0,0&w=128&h=128"
                    ));
                    match reply.status {
                        200 => frames.fetch_add(1, Ordering::Relaxed),
                        503 => {
                            let problem = reply.problem();
                            assert_eq!(problem["type"], "urn:pointillist:problem:busy");
                            let seconds: u64 =
                                reply.header("retry-after").unwrap().parse().unwrap();
                            let ms = problem["retry_after_ms"].as_u64().unwrap();
                            assert_eq!(seconds, ms.div_ceil(1000).max(1));
                            refusals.fetch_add(1, Ordering::Relaxed)
                        }
                        other => panic!("{other}: {}", reply.text()),
                    };
                }
            });
        }
    });
    let (frames, refusals) = (frames.into_inner(), refusals.into_inner());
    assert_eq!(frames + refusals, 24 * 8);
    assert!(frames > 0, "everything was refused");
    let client = daemon.client();
    assert_eq!(client.metric("pointillist_engine_refused_total"), refusals as f64);
    assert_eq!(client.metric("pointillist_frames_sent_total"), frames as f64);
    eventually("an empty queue", || client.metric("pointillist_engine_queued") == 0.0);
}

#[test]
fn clients_that_go_away_free_their_places() {
    let daemon = Daemon::start(&["--queue", "64", "--max-batch", "1"]);
    let client = daemon.client();
    let streams: Vec<_> = (0..40)
        .map(|i| {
            let x = f64::from(i) * 0.01;
            let request = format!(
                "GET /v1/scenes/grid/frame?eye={x},0,3&target=0,0,0&w=2048&h=2048 HTTP/1.1\r\nHost: localhost\r\n\r\n"
            );
            raw(daemon.address, request.as_bytes())
        })
        .collect();
    eventually("a queue", || client.metric("pointillist_engine_queued") > 4.0);
    for stream in streams {
        stream.shutdown(Shutdown::Both).unwrap();
    }
    eventually("an empty queue", || client.metric("pointillist_engine_queued") == 0.0);
    let cancelled = client.metric("pointillist_engine_cancelled_total");
    assert!(cancelled > 0.0, "everything was rendered although nobody waited");
    assert_eq!(client.get("/v1/scenes/grid/frame?w=16&h=16").status, 200);
}

#[test]
fn late_work_is_dropped() {
    let daemon = Daemon::start(&["--max-batch", "1"]);
    let client = daemon.client();
    let busy: Vec<_> = (0..8)
        .map(|i| {
            let request = format!(
                "GET /v1/scenes/grid/frame?eye={i},1,3&target=0,0,0&w=2048&h=2048 HTTP/1.1\r\nHost: localhost\r\n\r\n"
            );
            raw(daemon.address, request.as_bytes())
        })
        .collect();
    eventually("a queue", || client.metric("pointillist_engine_queued") > 2.0);
    let reply = client.get("/v1/scenes/grid/frame?w=32&h=32&deadline_ms=1");
    assert_eq!(reply.status, 503, "{}", reply.text());
    assert_eq!(reply.problem()["type"], "urn:pointillist:problem:deadline-exceeded");
    assert!(reply.header("retry-after").is_some());
    drop(busy);
}

#[test]
fn connections_have_limits() {
    let daemon = Daemon::start(&["--max-connections", "3", "--read-timeout-seconds", "1"]);
    let held: Vec<_> = (0..3).map(|_| raw(daemon.address, b"")).collect();
    std::thread::sleep(Duration::from_millis(100));
    let mut turned_away = raw(daemon.address, b"");
    let answer = read_to_close(&mut turned_away);
    assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("retry-after: 1"), "{answer}");
    assert!(answer.contains("too many connections"), "{answer}");
    // Health probes are answered even beyond the limit.
    for (path, word) in [("/healthz", "ok"), ("/readyz", "ready")] {
        let mut probe =
            raw(daemon.address, format!("GET {path} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes());
        let answer = read_to_close(&mut probe);
        assert!(
            answer.starts_with("HTTP/1.1 200 ") && answer.trim_end().ends_with(word),
            "{answer}"
        );
    }
    // Connections that send nothing, or too little, lose their places.
    for mut stream in held {
        assert_eq!(read_to_close(&mut stream), "");
    }
    for start in ["P", "PRI * HTTP/2.0\r\n", "GET /healthz HTTP/1.1\r\nHost: averylongname\r\n"] {
        let mut stream = raw(daemon.address, start.as_bytes());
        let answer = read_to_close(&mut stream);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 408"), "{start:?}: {answer}");
    }
    assert_eq!(daemon.client().get("/healthz").status, 200);
}

/// Pipelines many revalidations on one connection. The required rate is far below that of an optimised build (the test prints the
/// rate). It catches a 304 that has become as expensive as a frame.
#[test]
fn revalidation_is_cheap() {
    const REQUESTS: usize = 4000;
    let daemon = Daemon::start(&[]);
    let path = "/v1/scenes/grid/frame?camera=front&w=96&h=64&format=png";
    let etag = daemon.client().get(path).header("etag").unwrap().to_owned();
    let request =
        format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: {etag}\r\n\r\n");
    let last = request.replace("Host: localhost", "Host: localhost\r\nConnection: close");
    let mut stream = raw(daemon.address, b"");
    let mut writer = stream.try_clone().unwrap();
    let began = Instant::now();
    let sender = std::thread::spawn(move || {
        for _ in 0..REQUESTS / 100 - 1 {
            writer.write_all(request.repeat(100).as_bytes()).unwrap();
        }
        writer.write_all(request.repeat(99).as_bytes()).unwrap();
        writer.write_all(last.as_bytes()).unwrap();
    });
    let answers = read_to_close(&mut stream);
    let rate = REQUESTS as f64 / began.elapsed().as_secs_f64();
    sender.join().unwrap();
    assert_eq!(answers.matches("HTTP/1.1 304 ").count(), REQUESTS);
    println!("{rate:.0} answers 304 a second on one connection");
    assert!(rate > 500.0, "{rate:.0} a second");
    assert_eq!(daemon.client().metric("pointillist_engine_frames_total"), 1.0);
}

/// No request waits beyond its deadline, neither for a frame nor for point trees. A later request finds the trees built.
#[test]
fn deadlines_hold_while_frames_are_drawn_and_trees_are_built() {
    let daemon = Daemon::start(&["--no-cache"]);
    let client = daemon.client();
    let slow = "/v1/scenes/grid/frame?eye=3,1,3&target=0,0,0&w=4096&h=4096&format=png";
    let tree = "/v1/scenes/grid/frame?w=32&h=32&lod=spt&color_by=levels";
    let late = |path: &str| {
        let reply = client.get(&format!("{path}&deadline_ms=1"));
        assert_eq!(reply.status, 503, "{}", reply.text());
        assert_eq!(reply.problem()["type"], "urn:pointillist:problem:deadline-exceeded");
        assert!(reply.header("retry-after").is_some());
    };
    late(slow);
    late(tree);
    eventually("the trees are there", || {
        client.get(&format!("{tree}&deadline_ms=2000")).status == 200
    });
}
