//! Streams: poses in, frames out, over a WebSocket.

use std::net::{SocketAddr, TcpStream};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use pointillist::load::wire::header_and_image;
use serde_json::{Value, json};
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::{Message, WebSocket};

use super::client::raw;
use super::daemon::{Daemon, eventually, wall_ply};

/// A client of one stream.
pub struct Stream {
    pub socket: WebSocket<TcpStream>,
}

/// A message from the server.
#[derive(Debug)]
pub enum Came {
    Frame {
        header: Value,
        image: Vec<u8>,
    },
    Event(Value),
    /// The code of a close; 0 if the connection ended without a close.
    Close(u16),
}

impl Stream {
    pub fn open(daemon: &Daemon, path: &str) -> Stream {
        Stream::connect(daemon.address, path, &[]).unwrap_or_else(|status| panic!("{status}"))
    }

    /// Opens a stream, or returns the status of the refusal.
    pub fn connect(
        address: SocketAddr,
        path: &str,
        headers: &[(&str, &str)],
    ) -> Result<Stream, u16> {
        let mut request = tungstenite::http::Request::get(format!("ws://{address}{path}"))
            .header("Host", address.to_string())
            .header("Connection", "Upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13")
            .header("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ==");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let socket = raw(address, b"");
        // An acknowledgement must not wait for the TCP acknowledgement of the previous segment (Nagle's algorithm).
        socket.set_nodelay(true).unwrap();
        match tungstenite::client::client(request.body(()).unwrap(), socket) {
            Ok((socket, _)) => Ok(Stream { socket }),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                Err(response.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    pub fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    pub fn patience(&mut self, patience: Duration) {
        self.socket.get_mut().set_read_timeout(Some(patience)).unwrap();
    }

    /// The next message, or `None` if none arrives in time.
    pub fn try_next(&mut self) -> Option<Came> {
        loop {
            return Some(match self.socket.read() {
                Ok(Message::Binary(bytes)) => {
                    let (header, image) = header_and_image(&bytes).unwrap();
                    let header = serde_json::from_slice(header).unwrap();
                    Came::Frame { header, image: image.to_vec() }
                }
                Ok(Message::Text(text)) => Came::Event(serde_json::from_str(&text).unwrap()),
                Ok(Message::Close(frame)) => {
                    Came::Close(frame.map_or(0, |f| CloseCode::into(f.code)))
                }
                Ok(_) => continue,
                Err(tungstenite::Error::Io(error))
                    if matches!(
                        error.kind(),
                        std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                    ) =>
                {
                    return None;
                }
                Err(_) => Came::Close(0),
            });
        }
    }

    pub fn next(&mut self) -> Came {
        self.try_next().expect("nothing came")
    }

    /// Reads the next frame and checks its header, without acknowledging the frame.
    pub fn frame_unacked(&mut self) -> (Value, Vec<u8>) {
        loop {
            match self.next() {
                Came::Frame { header, image } => {
                    assert_eq!(header["bytes"], image.len());
                    assert_eq!(header["revision"], header["receipt"]["revision"]);
                    assert_eq!(header["width"], header["receipt"]["camera"]["width"]);
                    return (header, image);
                }
                Came::Event(event) if event["event"] == "scene" => {}
                other => panic!("{other:?}"),
            }
        }
    }

    pub fn frame(&mut self) -> Value {
        let (header, _) = self.frame_unacked();
        self.send(json!({"ack": header["frame"]}));
        header
    }

    /// Reads frames up to the first that satisfies `is_it`.
    pub fn frames_until(&mut self, is_it: impl Fn(&Value) -> bool) -> Vec<Value> {
        let mut frames = vec![self.frame()];
        while !is_it(&frames[frames.len() - 1]) {
            frames.push(self.frame());
        }
        frames
    }

    pub fn event(&mut self) -> Value {
        loop {
            match self.next() {
                Came::Event(event) => return event,
                Came::Frame { header, .. } => self.send(json!({"ack": header["frame"]})),
                Came::Close(code) => panic!("closed with {code}"),
            }
        }
    }

    /// Waits for the close and returns its code.
    pub fn closed(&mut self) -> u16 {
        loop {
            if let Came::Close(code) = self.next() {
                return code;
            }
        }
    }
}

pub const GRID: &str = "/v1/scenes/grid/stream";

pub fn pose(seq: u64, x: f64) -> Value {
    json!({"seq": seq, "eye": [x, 0, 3], "target": [0, 0, 0], "w": 320, "h": 240})
}

#[test]
fn a_moving_frame_and_then_a_still_one() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, GRID);
    assert_eq!(stream.event(), json!({"event": "scene", "scene": "grid", "revision": 1}));
    let mut first = pose(7, 0.2);
    first["format"] = "png".into();
    stream.send(first);
    let (header, image) = stream.frame_unacked();
    assert_eq!(
        (&header["seq"], &header["frame"], &header["revision"]),
        (&7.into(), &1.into(), &1.into())
    );
    assert_eq!((&header["quality"], &header["format"]), (&"moving".into(), &"jpeg".into()));
    assert!(
        header["scale"].as_f64().unwrap() <= 1.0 && header["jpeg_quality"].is_u64(),
        "{header}"
    );
    assert!(image.starts_with(&[0xff, 0xd8]), "a JPEG");
    stream.send(json!({"ack": 1}));
    let (still, image) = stream.frame_unacked();
    assert_eq!(
        (&still["seq"], &still["quality"], &still["scale"]),
        (&7.into(), &"still".into(), &1.0.into())
    );
    assert_eq!((&still["width"], &still["content_type"]), (&320.into(), &"image/png".into()));
    // The still frame equals a plain frame byte for byte.
    let query = "/v1/scenes/grid/frame?eye=0.2,0,3&target=0,0,0&w=320&h=240&format=png";
    assert_eq!(daemon.client().get(query).body, image);
    stream.send(json!({"ack": 2}));
    stream.patience(Duration::from_millis(500));
    assert!(stream.try_next().is_none(), "nothing better is to be had");
    // Settings persist. A pose that is declared at rest gets its still frame at once.
    stream.patience(Duration::from_secs(60));
    stream.send(json!({"seq": 8, "eye": [0.5, 0, 3], "target": [0, 0, 0], "moving": false}));
    let header = stream.frame();
    assert_eq!(
        (&header["seq"], &header["quality"], &header["width"]),
        (&8.into(), &"still".into(), &320.into())
    );
    let metrics = daemon.client();
    assert_eq!(metrics.metric("pointillist_stream_frames_total"), 3.0);
    assert_eq!(metrics.metric("pointillist_streams_open"), 1.0);
}

#[test]
fn frames_of_point_trees_say_how_coarse_they_are() {
    let daemon = Daemon::start(&[]);
    let asked = "camera=front&w=64&h=48&lod=spt&color_by=levels&max_error_px=2&format=png";
    let mut stream = Stream::open(&daemon, &format!("{GRID}?{asked}"));
    let frames = stream.frames_until(|frame| frame["quality"] == "still");
    assert!(frames.len() > 1, "a moving one comes first");
    for frame in &frames {
        let error_px = frame["max_error_px"].as_f64().unwrap();
        assert!((2.0..=4.0).contains(&error_px), "{frame}");
        assert_eq!(frame["receipt"]["max_error_px"], frame["max_error_px"]);
    }
    assert_eq!(frames[frames.len() - 1]["max_error_px"], 2.0, "at rest as it was asked for");
    stream.send(json!({"seq": 1, "lod": "full", "color_by": "colors", "moving": false}));
    assert_eq!(stream.frame()["max_error_px"], Value::Null);
}

#[test]
fn the_newest_pose_wins_and_none_is_lost_count_of() {
    const POSES: u64 = 60;
    let daemon = Daemon::start_in(
        |root| std::fs::write(root.join("grid.ply"), wall_ply(500)).unwrap(),
        &["--max-batch", "1"],
    );
    let mut stream = Stream::open(&daemon, GRID);
    stream.send(json!({"seq": 0, "w": 1600, "h": 1200, "moving": false}));
    stream.frame();
    for seq in 1..=POSES {
        let x = seq as f64 * 0.01;
        stream.send(json!({"seq": seq, "eye": [x, 0, 3], "target": [0, 0, 0], "moving": false}));
        std::thread::sleep(Duration::from_millis(5));
    }
    let frames = stream.frames_until(|frame| frame["seq"] == POSES);
    let drawn: Vec<u64> = frames.iter().map(|frame| frame["seq"].as_u64().unwrap()).collect();
    assert!(drawn.is_sorted(), "{drawn:?}");
    let overtaken = frames[frames.len() - 1]["overtaken"].as_u64().unwrap();
    assert_eq!(drawn.len() as u64 + overtaken, POSES, "{drawn:?}");
    assert!(overtaken > POSES / 4, "only {overtaken} were overtaken: {drawn:?}");
    // Overtaken poses were never drawn.
    let client = daemon.client();
    assert_eq!(client.metric("pointillist_engine_frames_total"), drawn.len() as f64 + 1.0);
    assert_eq!(client.metric("pointillist_stream_poses_overtaken_total"), overtaken as f64);
    assert_eq!(client.metric("pointillist_engine_queued"), 0.0);
}

#[test]
fn without_acknowledgements_no_more_frames_come() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, GRID);
    let mut seq = 0;
    // Sends this many poses, and counts the frames that arrive meanwhile.
    let mut move_on = |stream: &mut Stream, poses: usize| {
        let mut came_now = 0;
        stream.patience(Duration::from_millis(400));
        for _ in 0..poses {
            seq += 1;
            stream.send(pose(seq, seq as f64 * 0.02));
            while let Some(came) = stream.try_next() {
                came_now += u64::from(matches!(came, Came::Frame { .. }));
            }
        }
        stream.patience(Duration::from_secs(60));
        came_now
    };
    assert_eq!(move_on(&mut stream, 4), 1, "the link is not known");
    stream.send(json!({"ack": 1}));
    assert_eq!(stream.frame()["seq"], 4, "the newest, not those between");
    // This client answers pings late, so that it seems far away.
    let under_way = 1 + move_on(&mut stream, 12);
    assert!((2..=8).contains(&under_way), "{under_way}");
    stream.send(json!({"ack": 1 + under_way}));
    assert_eq!(stream.frame()["seq"], 16);
    stream.send(json!({"ack": 99}));
    let problem = stream.event();
    assert_eq!((&problem["event"], &problem["parameter"]), (&"problem".into(), &"ack".into()));
}

#[test]
fn errors_name_the_parameter_and_the_stream_goes_on() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, GRID);
    stream.event();
    for (message, parameter, kind) in [
        (json!({"seq": 1, "eye": [1, 2]}), "eye", "bad-body"),
        (json!({"seq": 2, "eyes": [1, 2, 3]}), "eyes", "unknown-parameter"),
        (json!({"seq": 3, "camera": "back"}), "camera", "bad-parameter"),
        (json!({"seq": 4, "w": 100_000}), "w", "over-limit"),
        (json!({"seq": 5, "deadline_ms": 9}), "deadline_ms", "unavailable-parameter"),
        (json!({"eye": [0, 0, 3]}), "seq", "bad-parameter"),
    ] {
        stream.send(message.clone());
        let problem = stream.event();
        assert_eq!(problem["event"], "problem", "{problem}");
        assert_eq!(problem["parameter"], parameter, "{problem}");
        assert_eq!(problem["type"], format!("urn:pointillist:problem:{kind}"));
        assert_eq!(problem["status"], 422, "{problem}");
    }
    stream.socket.send(Message::text("nonsense")).unwrap();
    assert_eq!(stream.event()["event"], "problem");
    stream.send(json!({"ping": [1, "a"]}));
    assert_eq!(stream.event(), json!({"event": "pong", "ping": [1, "a"]}));
    // Refused messages have no effect on later ones.
    stream.send(json!({"seq": 9, "camera": "front", "w": 64, "h": 64, "moving": false}));
    let header = stream.frame();
    assert_eq!((&header["seq"], &header["width"]), (&9.into(), &64.into()));
}

#[test]
fn edits_and_deletion_under_a_stream_are_told() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let mut stream = Stream::open(&daemon, GRID);
    stream.event();
    stream.send(
        json!({"seq": 1, "camera": "front", "w": 64, "h": 64, "format": "png", "moving": false}),
    );
    let (before, first) = stream.frame_unacked();
    stream.send(json!({"ack": before["frame"]}));
    let body = json!({"translate": [0.5, 0, 0]}).to_string();
    let json = [("content-type", "application/json")];
    let node = "/v1/scenes/grid/nodes/wall";
    assert_eq!(client.send("PATCH", node, &json, Some(body.as_bytes())).status, 200);
    assert_eq!(stream.event(), json!({"event": "scene", "scene": "grid", "revision": 2}));
    let (after, second) = stream.frame_unacked();
    assert_eq!((&after["seq"], &after["revision"]), (&1.into(), &2.into()));
    assert_ne!(first, second);
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    assert_eq!(stream.event(), json!({"event": "deleted", "scene": "grid"}));
    assert_eq!(stream.closed(), 4404);
    assert_eq!(Stream::connect(daemon.address, GRID, &[]).err(), Some(404));
    eventually("its place", || client.metric("pointillist_streams_open") == 0.0);
}

#[test]
fn who_comes_back_is_sent_a_frame_at_once() {
    let daemon = Daemon::start(&[]);
    for _ in 0..2 {
        let mut stream = Stream::open(&daemon, "/v1/scenes/grid/stream?camera=front&w=128&h=96");
        assert_eq!(stream.frame()["seq"], 0);
        let still = stream.frames_until(|frame| frame["quality"] == "still");
        assert_eq!(still[still.len() - 1]["width"], 128);
        stream.socket.close(None).unwrap();
        assert_eq!(stream.closed(), 0, "its own close comes back");
    }
    let refused = |path: &str| Stream::connect(daemon.address, path, &[]).err();
    assert_eq!(refused("/v1/scenes/grid/stream?w=x"), Some(422));
    assert_eq!(refused("/v1/scenes/none/stream"), Some(404));
    eventually("free places", || daemon.client().metric("pointillist_streams_open") == 0.0);
}

#[test]
fn a_client_that_goes_away_frees_its_place() {
    let daemon = Daemon::start(&["--max-streams", "2", "--max-streams-per-client", "2"]);
    let client = daemon.client();
    let streams: Vec<Stream> = (0..2)
        .map(|x| {
            let mut stream = Stream::open(&daemon, GRID);
            stream.send(
                json!({"seq": 1, "eye": [x, 0, 3], "target": [0, 0, 0], "w": 1500, "h": 1500}),
            );
            stream
        })
        .collect();
    let mut third = Stream::open(&daemon, GRID);
    assert_eq!(third.closed(), 4429);
    // The connection ends without a close, as reported by the system.
    drop(streams);
    eventually("free places", || client.metric("pointillist_streams_open") == 0.0);
    eventually("an empty queue", || client.metric("pointillist_engine_queued") == 0.0);
    let mut stream = Stream::open(&daemon, GRID);
    stream.send(pose(1, 0.0));
    assert_eq!(stream.frame()["seq"], 1);
}

#[test]
fn who_may_open_a_stream() {
    // SHA-256 of `r-1`.
    let hash = "a5fa777a3dc67268caea6eea038ba14177e360dba84e1db44e738dbae137e7ef";
    let daemon = Daemon::start(&[]);
    let open = |headers: &[(&str, &str)]| Stream::connect(daemon.address, GRID, headers).err();
    assert_eq!(open(&[]), None);
    assert_eq!(open(&[("Origin", "https://evil.example")]), Some(403));
    assert_eq!(open(&[("Origin", &format!("http://{}", daemon.address))]), None);
    let keyed = Daemon::start_in(
        |root| std::fs::write(root.join("keys"), format!("eye read {hash}\n")).unwrap(),
        &[],
    );
    let keys = keyed.root().join("keys").to_str().unwrap().to_owned();
    let keyed = keyed.restart(&["--api-keys", &keys]);
    let open = |protocol: &str| {
        Stream::connect(keyed.address, GRID, &[("Sec-WebSocket-Protocol", protocol)]).err()
    };
    assert_eq!(open("pointillist"), Some(401));
    assert_eq!(open("pointillist, pointillist.key.wrong"), Some(401));
    assert_eq!(open("pointillist, pointillist.key.r-1"), None);
    // A key that is removed keeps no stream.
    let protocol = [("Sec-WebSocket-Protocol", "pointillist, pointillist.key.r-1")];
    let mut stream = Stream::connect(keyed.address, GRID, &protocol).ok().unwrap();
    std::fs::write(&keys, format!("other read {}\n", hash.replace('a', "b"))).unwrap();
    let id = keyed.id().to_string();
    assert!(Command::new("kill").args(["-HUP", &id]).status().unwrap().success());
    eventually("the new keys", || open("pointillist, pointillist.key.r-1") == Some(401));
    stream.send(json!({"ping": 1}));
    assert_eq!(stream.closed(), 4403);
}

/// Four streams that always have a newer pose, each with its own key, and another client that keeps six plain requests waiting:
/// five clients get equal shares.
#[test]
fn clients_share_the_device_and_the_plain_api_still_answers() {
    const STREAMS: usize = 4;
    const TIME: Duration = Duration::from_secs(5);
    let (daemon, keys) = keyed_daemon(&["--max-batch", "4"]);
    let until = Instant::now() + TIME;
    let plain = AtomicUsize::new(0);
    let counts: Vec<usize> = std::thread::scope(|scope| {
        let streams: Vec<_> = (0..STREAMS)
            .map(|number| {
                let (daemon, key) = (&daemon, keys[number]);
                scope.spawn(move || count_frames(daemon, number, key, until))
            })
            .collect();
        for thread in 0..6 {
            let (daemon, plain) = (&daemon, &plain);
            let bearer = format!("Bearer {}", keys[STREAMS]);
            scope.spawn(move || {
                let client = daemon.client();
                let headers = [("authorization", bearer.as_str())];
                while Instant::now() < until {
                    let x = plain.fetch_add(1, Ordering::Relaxed) as f64 * 0.001;
                    let query = format!("eye={x},{thread},3&target=0,0,0&w=400&h=400&format=jpeg");
                    let path = format!("/v1/scenes/grid/frame?{query}");
                    assert_eq!(client.send("GET", &path, &headers, None).status, 200);
                }
            });
        }
        streams.into_iter().map(|stream| stream.join().unwrap()).collect()
    });
    let plain = plain.into_inner();
    let fair = (counts.iter().sum::<usize>() + plain) as f64 / (STREAMS + 1) as f64;
    println!("frames of each stream {counts:?}, plain {plain}");
    for count in counts.into_iter().chain([plain]) {
        let share = count as f64 / fair;
        assert!((0.5..2.0).contains(&share), "{share:.2} of a fair share");
    }
}

/// A daemon that requires keys, and five keys.
fn keyed_daemon(args: &[&str]) -> (Daemon, [&'static str; 5]) {
    const KEYS: [(&str, &str); 5] = [
        ("s-0", "74d7151be70fb7deb7900896e81edef265f8cf2293ab40f9561704e781016903"),
        ("s-1", "6a840baf5d8c3ff241688aeb14546e653774cd5387faf1cb982b0fbbf1fbb810"),
        ("s-2", "450222bcc3475b01aa69d5b0150a75a08a3bc3a87bb87ce4290ea7e0d4e51877"),
        ("s-3", "8252abfa5aa47b78d6b8a3a85d0f0a0129b2a825b83e15f22beb85dcf05abdf6"),
        ("plain", "a116c9ed46d6207734a43317d30fd88f52ac8634c37d904bbf4e41d865f90475"),
    ];
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keys");
    let lines: String = KEYS.iter().map(|(key, hash)| format!("{key} read {hash}\n")).collect();
    std::fs::write(&file, lines).unwrap();
    let daemon = Daemon::start(&[args, &["--api-keys", file.to_str().unwrap()]].concat());
    (daemon, KEYS.map(|(key, _)| key))
}

/// Sends a new pose every few milliseconds, and counts the frames until `until`.
fn count_frames(daemon: &Daemon, number: usize, key: &str, until: Instant) -> usize {
    let bearer = format!("Bearer {key}");
    let headers = [("Authorization", bearer.as_str())];
    let mut stream = Stream::connect(daemon.address, GRID, &headers).ok().unwrap();
    stream.patience(Duration::from_millis(4));
    stream.send(json!({"seq": 0, "camera": "front", "w": 400, "h": 400, "moving": false}));
    let (mut seq, mut count) = (0, 0);
    while Instant::now() < until {
        seq += 1;
        let eye = json!([seq as f64 * 0.001 + number as f64, 0.1, 3]);
        stream.send(json!({"seq": seq, "eye": eye, "target": [0, 0, 0], "moving": false}));
        while let Some(came) = stream.try_next() {
            if let Came::Frame { header, .. } = came {
                stream.send(json!({"ack": header["frame"]}));
                count += 1;
            }
        }
    }
    count
}

#[test]
fn a_moving_frame_is_drawn_as_the_still_one_will_be() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, GRID);
    // By itself, the smaller frame would be drawn as points.
    stream.send(json!({"seq": 1, "camera": "front", "w": 160, "h": 90}));
    let mut seen: Vec<(Value, Value, Value)> = Vec::new();
    while seen.last().is_none_or(|(quality, ..)| quality != "still") {
        let header = stream.frame();
        let receipt = &header["receipt"];
        let drawn = receipt["settings"]["reconstruct"].clone();
        seen.push((header["quality"].clone(), receipt["camera"]["height"].clone(), drawn));
    }
    assert!(seen.len() > 1 && seen[0].1.as_u64() < Some(90), "a smaller one comes first: {seen:?}");
    assert!(seen.iter().all(|(.., drawn)| drawn == "splats"), "{seen:?}");
}

#[test]
fn a_pose_may_begin_from_nothing() {
    let daemon = Daemon::start(&[]);
    let mut stream = Stream::open(&daemon, GRID);
    stream.send(json!({"seq": 1, "camera": "front", "w": 64, "h": 48, "reconstruct": "splats",
        "filter": "affine", "moving": false}));
    assert_eq!(stream.frame()["receipt"]["settings"]["filter"], "affine");
    stream.send(json!({"seq": 2, "camera": "front", "moving": false}));
    assert_eq!(stream.frame()["receipt"]["settings"]["filter"], "affine", "as before");
    stream.send(
        json!({"seq": 3, "w": 64, "h": 48, "reconstruct": "splats", "moving": false, "reset": true}),
    );
    let receipt = &stream.frame()["receipt"];
    assert_eq!(receipt["settings"]["filter"], "perspective", "as the scene has it");
    assert_ne!(receipt["camera"]["eye"], json!([0.0, 0.0, 3.0]), "the whole scene");
}
