//! HTTP/2 clients that keep a connection alive and take nothing of an answer.

use pointillist::engine::{Engine, EngineConfig};
use pointillist::http::App;
use pointillist::http::server::serve_monitoring;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{Duration, Instant};

use super::lifecycle::settings;

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const SETTINGS: u8 = 4;
const PING: u8 = 6;
const GOAWAY: u8 = 7;
/// Flag of an answer to settings and pings.
const ACK: u8 = 1;

fn frame(kind: u8, flags: u8, stream: u8, payload: &[u8]) -> Vec<u8> {
    let head = [0, 0, payload.len() as u8, kind, flags, 0, 0, 0, stream];
    [&head, payload].concat()
}

/// A field of a head, without an index.
fn field(name: &str, value: &str) -> Vec<u8> {
    let [name, value] = [name, value].map(|text| [&[text.len() as u8], text.as_bytes()].concat());
    [vec![0], name, value].concat()
}

/// The connection is closed after a minute, although the client answers every ping.
#[tokio::test]
async fn an_answer_of_which_nothing_is_taken_ends_its_connection() {
    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(EngineConfig::new(folder.path())).unwrap();
    let app = App::new(engine, settings(folder.path()), Err("no jobs here".to_owned()));
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve_monitoring(app, listener));
    let mut client = TcpStream::connect(address).await.unwrap();
    // A window of no bytes.
    let window = frame(SETTINGS, 0, 0, &[0, 4, 0, 0, 0, 0]);
    let fields = [(":method", "GET"), (":scheme", "http"), (":authority", "localhost")];
    let fields = fields.into_iter().chain([(":path", "/metrics")]);
    let head: Vec<u8> = fields.flat_map(|(name, value)| field(name, value)).collect();
    // The flags say that the head and the request end here.
    let asked = frame(HEADERS, 4 | 1, 1, &head);
    let hello = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
    client.write_all(&[&hello[..], &window, &asked].concat()).await.unwrap();
    let (mut answered, mut pings) = (None::<Instant>, 0);
    let ended = loop {
        let mut head = [0; 9];
        if client.read_exact(&mut head).await.is_err() {
            break Instant::now();
        }
        let [a, b, c, kind, flags, ..] = head;
        let mut payload = vec![0; u32::from_be_bytes([0, a, b, c]) as usize];
        client.read_exact(&mut payload).await.unwrap();
        match kind {
            // From here on, time passes as soon as nothing else is to be done.
            HEADERS => {
                answered = Some(Instant::now());
                tokio::time::pause();
            }
            PING if flags & ACK == 0 => {
                pings += 1;
                client.write_all(&frame(PING, ACK, 0, &payload)).await.unwrap();
            }
            SETTINGS if flags & ACK == 0 => {
                client.write_all(&frame(SETTINGS, ACK, 0, &[])).await.unwrap();
            }
            GOAWAY => break Instant::now(),
            kind => assert_ne!(kind, DATA),
        }
        let passed = answered.map_or(Duration::ZERO, |at| at.elapsed());
        assert!(passed < Duration::from_secs(300), "still open, after {pings} pings");
    };
    let passed = ended - answered.expect("no answer");
    assert!((59..=62).contains(&passed.as_secs()), "{passed:?}, {pings} pings");
    assert!(pings > 0);
}
