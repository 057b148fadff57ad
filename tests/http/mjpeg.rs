//! Films for `<img>`: the frames of a path in real time, or a view that follows changes.

use std::io::{BufRead, BufReader, Read};

use serde_json::{Value, json};

use super::client::Client;
use super::daemon::{Daemon, eventually, wall_ply};

/// A film that is being read.
struct Film {
    body: BufReader<Box<dyn Read + Send>>,
    boundary: String,
    is_over: bool,
}

struct Part {
    number: u64,
    receipt: Value,
    image: Vec<u8>,
}

impl Film {
    fn open(client: &Client, query: &str) -> Film {
        let (kind, body) = client.open(&format!("/v1/scenes/grid/mjpeg?{query}"));
        let boundary = kind.strip_prefix("multipart/x-mixed-replace; boundary=").unwrap();
        let mut film =
            Film { body: BufReader::new(body), boundary: format!("--{boundary}"), is_over: false };
        let mut first = vec![0; film.boundary.len()];
        film.body.read_exact(&mut first).unwrap();
        assert_eq!(String::from_utf8(first).unwrap(), film.boundary);
        film
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.body.read_line(&mut line).unwrap();
        assert!(line.ends_with("\r\n"), "{line:?}");
        line.trim_end().to_owned()
    }

    /// The next part and the delimiter behind it; `None` at the end.
    fn part(&mut self) -> Option<Part> {
        // A delimiter is followed by the end of its line, or by the end of the body.
        if self.line() == "--" {
            let mut rest = Vec::new();
            self.body.read_to_end(&mut rest).unwrap();
            assert_eq!(rest, b"", "nothing comes after the end");
            self.is_over = true;
            return None;
        }
        let mut headers = std::collections::HashMap::new();
        loop {
            let line = self.line();
            let Some((name, value)) = line.split_once(": ") else { break };
            headers.insert(name.to_ascii_lowercase(), value.to_owned());
        }
        assert_eq!(headers["content-type"], "image/jpeg");
        let mut image = vec![0; headers["content-length"].parse().unwrap()];
        self.body.read_exact(&mut image).unwrap();
        assert!(image.starts_with(&[0xff, 0xd8]) && image.ends_with(&[0xff, 0xd9]), "a JPEG");
        let mut delimiter = vec![0; self.boundary.len() + 2];
        self.body.read_exact(&mut delimiter).unwrap();
        assert_eq!(delimiter, format!("\r\n{}", self.boundary).into_bytes());
        Some(Part {
            number: headers["pointillist-pose"].parse().unwrap(),
            receipt: serde_json::from_str(&headers["pointillist-receipt"]).unwrap(),
            image,
        })
    }

    fn rest(mut self) -> Vec<Part> {
        std::iter::from_fn(|| self.part()).collect()
    }
}

fn numbers(parts: &[Part]) -> Vec<u64> {
    parts.iter().map(|part| part.number).collect()
}

#[test]
fn a_path_is_played_to_its_end() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let parts = Film::open(&client, "path=past&w=64&h=48&quality=70").rest();
    let shown = numbers(&parts);
    assert!(shown.is_sorted_by(|a, b| a < b), "{shown:?}");
    assert_eq!((shown.first(), shown.last()), (Some(&0), Some(&10)), "{shown:?}");
    // The image equals that of a plain frame.
    let query = "eye=1,0,3&target=0,0,0&fov=50&w=64&h=48&quality=70&format=jpeg";
    let last = client.get(&format!("/v1/scenes/grid/frame?{query}"));
    assert_eq!(parts[parts.len() - 1].image, last.body);
    assert_eq!(parts[0].receipt["camera"]["eye"], json!([-1.0, 0.0, 3.0]));
    assert_ne!(parts[0].image, last.body);
    // At another rate the frames have other numbers.
    let parts = Film::open(&client, "path=past&w=64&h=48&fps=4").rest();
    assert_eq!(numbers(&parts).last(), Some(&2));
    let metric = |name: &str| client.metric(name);
    assert!(metric("pointillist_stream_frames_total") >= 4.0);
    eventually("its place to be free", || metric("pointillist_streams_open") == 0.0);
}

#[test]
fn frames_that_come_too_late_are_left_out() {
    let daemon =
        Daemon::start_in(|root| std::fs::write(root.join("grid.ply"), wall_ply(500)).unwrap(), &[]);
    // Two million pixels 120 times a second exceed what any test machine can draw and encode.
    let parts = Film::open(&daemon.client(), "path=past&w=1600&h=1200&fps=120&quality=95").rest();
    let shown = numbers(&parts);
    assert!(shown.len() < 61 && shown.is_sorted_by(|a, b| a < b), "{shown:?}");
    assert_eq!(shown.last(), Some(&60), "the last one is not: {shown:?}");
}

#[test]
fn loops_until_the_client_goes() {
    let daemon = Daemon::start(&["--max-streams", "1"]);
    let client = daemon.client();
    let mut film = Film::open(&client, "path=past&loop=true&w=32&h=32");
    let (mut last, mut rounds) = (0, 0);
    while rounds < 3 {
        let number = film.part().unwrap().number;
        assert!(number <= 10, "{number}");
        rounds += usize::from(number < last);
        last = number;
    }
    let refused = client.get("/v1/scenes/grid/mjpeg?path=past");
    assert_eq!(refused.status, 503, "it is one of the streams");
    let problem = refused.problem();
    assert!(problem["detail"].as_str().unwrap().contains("too many streams"), "{problem}");
    assert!(refused.header("retry-after").is_some());
    drop(film);
    eventually("its place to be free", || client.metric("pointillist_streams_open") == 0.0);
    assert_eq!(Film::open(&client, "path=past&fps=2&w=8&h=8").rest().len(), 2);
}

/// Frames of another client between two looks at the number of all frames.
const OWN_FRAMES: u32 = 8;

#[test]
fn nothing_is_drawn_for_who_does_not_read() {
    let daemon =
        Daemon::start_in(|root| std::fs::write(root.join("grid.ply"), wall_ply(500)).unwrap(), &[]);
    let client = daemon.client();
    let mut film = Film::open(&client, "path=past&loop=true&fps=120&w=1600&h=1200&quality=100");
    film.part().unwrap();
    // The buffers between server and client hold some frames, then no more are drawn. Clients get equal shares of the device, so another
    // client's frames of the same size tell how often the film could have been drawn meanwhile.
    let drawn = || client.metric("pointillist_engine_frames_total");
    let mut view = 0;
    eventually("a standstill", || {
        let before = drawn();
        for _ in 0..OWN_FRAMES {
            view += 1;
            let query = format!(
                "eye=0,0,{}&target=0,0,0&w=1600&h=1200&format=jpeg",
                3.0 + 0.01 * f64::from(view)
            );
            assert_eq!(client.get(&format!("/v1/scenes/grid/frame?{query}")).status, 200);
        }
        drawn() - before == f64::from(OWN_FRAMES)
    });
    // A client that reads on sees the path at the current time.
    for _ in 0..3 {
        film.part().unwrap();
    }
}

#[test]
fn a_film_that_nobody_reads_gives_its_place_back() {
    let daemon = Daemon::start(&["--max-streams", "2", "--stream-idle-seconds", "1"]);
    let client = daemon.client();
    // One client reads a view that does not change.
    let mut read = Film::open(&client, "camera=front&w=64&h=64");
    read.part().unwrap();
    let places = || client.metric("pointillist_streams_open");
    // Others read a part and then nothing. Each of them is given the same second, which the first client has waited after two of them.
    for _ in 0..2 {
        let query = "path=past&loop=true&fps=120&w=900&h=900&quality=100";
        let mut stalled = Film::open(&client, query);
        stalled.part().unwrap();
        eventually("the place of who does not read to be free", || places() < 2.0);
        // The connection breaks, so that the client does not take this for the end of the film.
        let mut rest = Vec::new();
        assert!(stalled.body.read_to_end(&mut rest).is_err());
    }
    assert_eq!(places(), 1.0, "who waits for a picture to change reads");
    let body = json!({"translate": [0.5, 0, 0]}).to_string();
    let json = [("content-type", "application/json")];
    let node = "/v1/scenes/grid/nodes/wall";
    assert_eq!(client.send("PATCH", node, &json, Some(body.as_bytes())).status, 200);
    // On a slow machine the picture has been sent again meanwhile, as it is every 15 s.
    let changed = std::iter::from_fn(|| read.part()).find(|part| part.number > 0);
    assert_eq!(changed.unwrap().number, 1, "the picture changes");
}

#[test]
fn a_view_is_shown_again_when_its_scene_changes() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let mut film = Film::open(&client, "camera=front&w=64&h=64&fps=60");
    let first = film.part().unwrap();
    assert_eq!((first.number, &first.receipt["revision"]), (0, &1.into()));
    let body = json!({"translate": [0.5, 0, 0]}).to_string();
    let json = [("content-type", "application/json")];
    let node = "/v1/scenes/grid/nodes/wall";
    assert_eq!(client.send("PATCH", node, &json, Some(body.as_bytes())).status, 200);
    let second = film.part().unwrap();
    assert_eq!((second.number, &second.receipt["revision"]), (1, &2.into()));
    assert_ne!(first.image, second.image);
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    assert!(film.part().is_none() && film.is_over, "a deleted scene ends its film");
}

#[test]
fn a_film_of_a_deleted_scene_ends() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let mut film = Film::open(&client, "path=past&loop=true&w=64&h=64");
    film.part().unwrap();
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    while film.part().is_some() {}
    eventually("its place to be free", || client.metric("pointillist_streams_open") == 0.0);
}

#[test]
fn what_is_wrong_is_said_before_the_first_byte() {
    let mut daemon = Daemon::start(&[]);
    let client = daemon.client();
    let film = |rest: &str| format!("/v1/scenes/grid/mjpeg{rest}");
    for (path, status, parameter) in [
        ("/v1/scenes/none/mjpeg".to_owned(), 404, Value::Null),
        ("/v1/scenes/none/mjpeg?path=past".to_owned(), 404, Value::Null),
        (film("?path=post"), 422, "path".into()),
        (film("?camera=back"), 422, "camera".into()),
        (film("?path=past&fps=1000"), 422, "fps".into()),
        (film("?path=past&w=100000"), 422, "w".into()),
        (film("?path=past&eye=0,0,1"), 422, "eye".into()),
        (film("?output=depth"), 422, "format".into()),
        (film("?format=png"), 422, "format".into()),
        (film("?pth=past"), 422, "pth".into()),
    ] {
        let reply = client.get(&path);
        assert_eq!(reply.status, status, "{path}: {}", reply.text());
        assert_eq!(reply.problem()["parameter"], parameter, "{path}");
    }
    assert_eq!(client.metric("pointillist_streams_open"), 0.0);
    let head = client.send("HEAD", &film("?path=past"), &[], None);
    assert_eq!(head.status, 200);
    assert!(head.header("content-type").unwrap().starts_with("multipart/x-mixed-replace"));
    assert_eq!(client.metric("pointillist_engine_frames_total"), 0.0, "HEAD draws nothing");

    // A server that stops ends its films.
    let mut looping = Film::open(&client, "path=past&loop=true&w=16&h=16");
    looping.part().unwrap();
    daemon.signal();
    while looping.part().is_some() {}
    assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
}
