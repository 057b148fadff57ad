//! Clients that stall, vanish, send incomplete requests, or flood: other clients are served, and nothing is left behind.

use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use serde_json::json;

use super::client::{Client, raw, read_to_close};
use super::daemon::{Daemon, eventually};
use super::stream::{GRID, Stream, pose};

const SMALL: &str = "/v1/scenes/grid/frame?eye=0,0,3&target=0,0,0&w=32&h=32";

/// Head and body of a request for many poses, as raw images of a megabyte each.
fn many_poses(seed: u32, count: u32) -> String {
    let eye = |number: u32| json!([f64::from(seed) + f64::from(number) * 0.01, 0.0, 3.0]);
    let poses: Vec<_> =
        (0..count).map(|number| json!({"eye": eye(number), "target": [0, 0, 0]})).collect();
    let body = json!({"w": 512, "h": 512, "format": "raw", "poses": poses}).to_string();
    format!(
        "POST /v1/scenes/grid/frames HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    )
}

/// Asserts that the daemon answers, has an empty queue, and draws.
fn assert_healthy(daemon: &Daemon) {
    let client = daemon.client();
    eventually("an empty queue", || client.metric("pointillist_engine_queued") == 0.0);
    eventually("closed streams", || client.metric("pointillist_streams_open") == 0.0);
    assert_eq!(client.get("/readyz").status, 200);
    assert_eq!(client.get(&format!("{SMALL}&fov=33")).status, 200);
}

#[test]
fn answers_that_nobody_reads_hold_nobody_up() {
    const POSES: u32 = 300;
    let daemon = Daemon::start(&["--queue", "16"]);
    let client = daemon.client();
    let stalled: Vec<_> =
        (0..6).map(|seed| raw(daemon.address, many_poses(seed, POSES).as_bytes())).collect();
    let frames = || client.metric("pointillist_engine_frames_total");
    // Wait until the sockets are full and the daemon draws nothing more for them. A busy machine may pause for one interval.
    let (mut before, mut still) = (-1.0, 0);
    eventually("a standstill", || {
        std::thread::sleep(Duration::from_millis(300));
        let now = frames();
        still = if now > 0.0 && now == before { still + 1 } else { 0 };
        before = now;
        still == 5
    });
    assert!(frames() < f64::from(6 * POSES), "everything was drawn although nobody reads");
    for number in 0..10 {
        let path = format!("/v1/scenes/grid/frame?eye=0,{number},3&target=0,0,0&w=32&h=32");
        assert_eq!(client.get(&path).status, 200);
    }
    drop(stalled);
    assert_healthy(&daemon);
}

#[test]
fn who_vanishes_in_the_middle_of_an_answer_costs_no_more_frames() {
    const POSES: u32 = 400;
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for seed in 0..3 {
        let mut stream = raw(daemon.address, many_poses(seed, POSES).as_bytes());
        let mut some = [0; 4096];
        stream.read_exact(&mut some).unwrap();
    }
    assert_healthy(&daemon);
    let drawn = client.metric("pointillist_engine_frames_total");
    assert!(drawn < f64::from(3 * POSES), "{drawn} frames were drawn for nobody");
}

#[test]
fn half_of_a_request_is_not_waited_for() {
    let daemon = Daemon::start(&["--read-timeout-seconds", "1", "--stream-idle-seconds", "1"]);
    let whole = many_poses(0, 3);
    for share in [1, 2, 3] {
        let half = &whole.as_bytes()[..whole.len() * share / 4];
        let mut stream = raw(daemon.address, half);
        let answer = read_to_close(&mut stream);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 408 "), "{share}: {answer}");
    }
    // Half of a WebSocket handshake, and half of a message.
    let handshake = format!(
        "GET {GRID} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    let mut stream = raw(daemon.address, &handshake.as_bytes()[..handshake.len() - 3]);
    assert!(!read_to_close(&mut stream).starts_with("HTTP/1.1 101"));
    let mut stream = raw(daemon.address, handshake.as_bytes());
    // A masked text of 100 bytes, of which only ten are sent.
    stream.write_all(&[0x81, 0x80 | 100, 1, 2, 3, 4]).unwrap();
    stream.write_all(&[b'x'; 10]).unwrap();
    let answer = read_to_close(&mut stream);
    assert!(answer.starts_with("HTTP/1.1 101 "), "{answer}");
    assert_healthy(&daemon);
}

#[test]
fn streams_that_send_and_never_read_are_held_still() {
    let daemon = Daemon::start(&[]);
    let mut silent: Vec<Stream> = (0..4).map(|_| Stream::open(&daemon, GRID)).collect();
    for stream in &mut silent {
        let socket = stream.socket.get_mut();
        socket.set_write_timeout(Some(Duration::from_millis(200))).unwrap();
        // Every message has an answer, so answers pile up, and after a while the server reads nothing more.
        for seq in 0..20_000u64 {
            let mut message = pose(seq, seq as f64 * 1e-4);
            message["ping"] = "x".repeat(200).into();
            message["ack"] = 1_000_000.into();
            if stream.socket.send(tungstenite::Message::text(message.to_string())).is_err() {
                break;
            }
        }
    }
    let client = daemon.client();
    let drawn = client.metric("pointillist_engine_frames_total");
    assert!(drawn <= 4.0 * 8.0, "{drawn} frames were drawn for streams that acknowledge none");
    assert_eq!(client.get(SMALL).status, 200);
    let mut lively = Stream::open(&daemon, GRID);
    lively.send(pose(1, 0.5));
    assert_eq!(lively.frame()["seq"], 1);
    drop((silent, lively));
    assert_healthy(&daemon);
}

/// One client sends as many requests as it can from 16 threads. Another client with its own key sends one request at a time. It
/// gets all of its frames, and few of the other's frames come before each.
#[test]
fn a_flood_of_one_client_is_not_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keys");
    // SHA-256 of `reader` and of `writer`.
    let keys = "eye read 3d0941964aa3ebdcb00ccef58b1bb399f9f898465e9886d5aec7f31090a0fb30\n\
                hand write b93006774cbdd4b299389a03ac3d88c3a76b460d538795bc12718011a909fba5\n";
    std::fs::write(&file, keys).unwrap();
    let args = ["--api-keys", file.to_str().unwrap(), "--queue", "6", "--max-batch", "2"];
    let daemon = Daemon::start(&args);
    let get = |client: &Client, key: &str, x: f64, side: u32| {
        let bearer = format!("Bearer {key}");
        let path =
            format!("/v1/scenes/grid/frame?eye={x},0,3&target=0,0,0&w={side}&h={side}&format=jpeg");
        client.send("GET", &path, &[("authorization", &bearer)], None).status
    };
    let (stop, refused) = (AtomicBool::new(false), AtomicUsize::new(0));
    let drawn = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for thread in 0..16u32 {
            let (daemon, stop, refused, drawn, get) = (&daemon, &stop, &refused, &drawn, &get);
            scope.spawn(move || {
                let client = daemon.client();
                let mut number = 0;
                while !stop.load(Ordering::Relaxed) {
                    number += 1;
                    let x = f64::from(thread) + f64::from(number) * 1e-3;
                    match get(&client, "writer", x, 300) {
                        200 => drop(drawn.fetch_add(1, Ordering::Relaxed)),
                        503 => drop(refused.fetch_add(1, Ordering::Relaxed)),
                        other => panic!("{other}"),
                    }
                }
            });
        }
        let client = daemon.client();
        eventually("a full queue", || refused.load(Ordering::Relaxed) > 10);
        let before = drawn.load(Ordering::Relaxed);
        let answers: Vec<u16> =
            (0..20).map(|number| get(&client, "reader", f64::from(number) * 0.01, 64)).collect();
        let meanwhile = drawn.load(Ordering::Relaxed) - before;
        stop.store(true, Ordering::Relaxed);
        assert_eq!(answers, [200; 20]);
        // A batch in progress and at most one more precede each frame. In order of arrival it would be six frames or more.
        println!("{meanwhile} frames of the flood during 20 of the other");
        assert!(meanwhile <= 20 * 5, "{meanwhile} frames of the flood during 20 of the other");
    });
}
