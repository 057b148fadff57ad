//! Messages and clients for which the server closes a stream, and the codes.

use std::io::Write;
use std::time::{Duration, Instant};

use serde_json::json;
use tungstenite::Message;

use super::daemon::Daemon;
use super::stream::{Came, GRID, Stream, pose};

#[test]
fn streams_are_closed_with_a_reason() {
    let mut daemon = Daemon::start(&["--stream-idle-seconds", "3"]);
    let mut idle = Stream::open(&daemon, "/v1/scenes/grid/stream?w=64&h=64");
    let began = Instant::now();
    assert_eq!(idle.closed(), 4408);
    assert!(began.elapsed() > Duration::from_millis(2900));
    let mut pinging = Stream::open(&daemon, GRID);
    // Longer than the limit in all, and each pause far shorter.
    for ping in 0..9 {
        std::thread::sleep(Duration::from_millis(400));
        pinging.send(json!({"ping": ping}));
    }
    let mut binary = Stream::open(&daemon, GRID);
    binary.socket.send(Message::binary(vec![1, 2, 3])).unwrap();
    assert_eq!(binary.closed(), 1003);
    let mut large = Stream::open(&daemon, GRID);
    large.send(json!({"ping": "x".repeat(70_000)}));
    assert_eq!(large.closed(), 1009);
    pinging.send(json!({"ping": 9}));
    daemon.signal();
    assert_eq!(pinging.closed(), 1001);
    assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
}

#[test]
fn what_is_no_message_is_answered_with_why() {
    let daemon = Daemon::start(&[]);
    // Raw WebSocket frames with a mask of zeros, so that the payload is sent unchanged.
    let bytes = |head: &[u8], rest: &[u8]| [head, &[0; 4], rest].concat();
    let announced = |length: u64| {
        let mut head = vec![0x81, 0xff];
        head.extend(length.to_be_bytes());
        bytes(&head, &[b'x'; 100])
    };
    // A fragmented message without an end.
    let unfinished = bytes(&[0x00, 0xfe, 0xff, 0xff], &[b'x'; 0xffff]);
    let fragments = [bytes(&[0x01, 0x80 | 1], b"x"), unfinished.repeat(5)].concat();
    for (what, sent, code) in [
        ("no UTF-8", bytes(&[0x81, 0x80 | 2], &[0xff, 0xfe]), 1007),
        ("a reserved bit", bytes(&[0xf1, 0x80 | 5], b"abcde"), 1002),
        ("a reserved opcode", bytes(&[0x83, 0x80 | 1], b"x"), 1002),
        ("no mask", vec![0x81, 5, b'a', b'b', b'c', b'd', b'e'], 1002),
        ("a continuation of nothing", bytes(&[0x80, 0x80 | 1], b"x"), 1002),
        ("a message that is announced as 15 MiB", announced(15 << 20), 1009),
        ("one that is announced as 300 KB", announced(300_000), 1009),
        ("fragments without an end", fragments, 1009),
    ] {
        let mut stream = Stream::open(&daemon, GRID);
        stream.event();
        stream.socket.get_mut().write_all(&sent).unwrap();
        assert_eq!(stream.closed(), code, "{what}");
    }
    // When the connections are closed, their places become free.
    let client = daemon.client();
    super::daemon::eventually("no stream", || client.metric("pointillist_streams_open") == 0.0);
}

/// A client that sends poses as fast as the socket accepts them, and reads and acknowledges everything.
#[test]
fn a_flood_is_closed_and_a_busy_client_is_not() {
    let daemon = Daemon::start(&[]);
    let mut busy = Stream::open(&daemon, GRID);
    let (mut seq, mut shown) = (0, 0);
    let began = Instant::now();
    busy.patience(Duration::from_millis(20));
    while began.elapsed() < Duration::from_secs(3) {
        // At most 750 poses per second.
        for _ in 0..15 {
            seq += 1;
            busy.send(pose(seq, seq as f64 * 1e-4));
        }
        let until = Instant::now() + Duration::from_millis(20);
        while Instant::now() < until {
            match busy.try_next() {
                Some(Came::Frame { header, .. }) => {
                    shown += 1;
                    busy.send(json!({"ack": header["frame"]}));
                }
                Some(Came::Close(code)) => panic!("closed with {code} after {seq} poses"),
                Some(Came::Event(_)) | None => {}
            }
        }
    }
    assert!(shown >= 5, "{shown} frames of {seq} poses");
    drop(busy);

    let mut flood = Stream::open(&daemon, GRID);
    let mut sender = flood.socket.get_ref().try_clone().unwrap();
    // One masked text, repeatedly.
    let text = br#"{"seq":1,"eye":[3,2,4],"target":[0,0,0]}"#;
    let one = [&[0x81, 0x80 | text.len() as u8, 0, 0, 0, 0], &text[..]].concat();
    let sending = std::thread::spawn(move || {
        let many = one.repeat(200);
        let until = Instant::now() + Duration::from_secs(60);
        while sender.write_all(&many).is_ok() && Instant::now() < until {}
    });
    let began = Instant::now();
    assert_eq!(flood.closed(), 1008);
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    drop(flood);
    sending.join().unwrap();
}

#[test]
fn who_does_not_acknowledge_is_told_once() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, "/v1/scenes/grid/stream?camera=front&w=320&h=240");
    let began = Instant::now();
    let (first, _) = stream.frame_unacked();
    assert_eq!((&first["frame"], &first["quality"]), (&1.into(), &"moving".into()));
    let Some(Came::Event(problem)) = stream.try_next() else { panic!("nothing is told") };
    assert_eq!((&problem["event"], &problem["parameter"]), (&"problem".into(), &"ack".into()));
    assert!(problem["detail"].as_str().unwrap().contains("frame 1"), "{problem}");
    assert!(began.elapsed() > Duration::from_secs(4), "{:?}", began.elapsed());
    // The reminder comes only once, however many poses follow.
    stream.send(pose(1, 0.1));
    stream.patience(Duration::from_secs(7));
    assert!(stream.try_next().is_none(), "once is enough");
    stream.patience(Duration::from_secs(60));
    stream.send(json!({"ack": 1}));
    assert_eq!(stream.frame()["seq"], 1, "what waited comes");
}
