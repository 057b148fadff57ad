//! A soak test: hostile uploads, deletions and kills under a limited address space, while another client requests frames.
//!
//! It runs for a few seconds with all other tests, and for five minutes with `make soak` (`SOAK_SECONDS`).

use std::net::SocketAddr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use pointillist::scene::random::SplitMix64;

use super::admission::{empty_nodes, equal_points, nested_unions, resident_bytes};
use super::client::{Client, form};
use super::daemon::{Daemon, eventually, grid_ply, wall_ply};

/// Limit of the daemon's address space.
const LIMIT_KIB: u64 = 2 << 20;
const ARGS: [&str; 6] =
    ["--gpu-budget-mib", "256", "--host-memory-mib", "512", "--read-timeout-seconds", "10"];
const FRAME: &str = "/v1/scenes/grid/frame?camera=front&w=96&h=72&format=png";
/// Memory that may remain in use after all uploads are deleted, beyond the initial use.
const MAY_BE_LEFT: u64 = 256 << 20;

/// A hostile upload: its query, content type and body.
struct Attack {
    name: &'static str,
    query: String,
    content_type: String,
    body: Vec<u8>,
}

fn attacks() -> Vec<Attack> {
    let attack = |name, query: &str, content_type: &str, body| Attack {
        name,
        query: query.to_owned(),
        content_type: content_type.to_owned(),
        body,
    };
    let binary = "application/octet-stream";
    let json = "application/json";
    let ply = grid_ply();
    let damaged = |cut: usize| ply.as_bytes()[..ply.len() * cut / 7].to_vec();
    let (form_type, form_body) =
        form(&[("a.ply", ply.as_bytes()), ("b.ply", &damaged(3)), ("c.txt", b"no")]);
    let giant = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let strip = {
        let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty uchar x\nproperty uchar y\nproperty uchar z\nelement face 1\nproperty list uint uchar vertex_indices\nend_header\n".to_vec();
        bytes.extend([0, 0, 0, 9, 0, 0, 0, 9, 0]);
        bytes.extend(40_000_000u32.to_le_bytes());
        bytes.resize(bytes.len() + (40_000_000), 1);
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, &bytes).unwrap();
        encoder.finish().unwrap()
    };
    let gltf = format!(
        "{{\"asset\": {{\"version\": \"2.0\"}}, \"nodes\": [{}{{}}]}}",
        "{},".repeat(5 << 20)
    );
    vec![
        attack("equal points", "name=bomb.xyz.gz", binary, equal_points(20_000_000)),
        attack("empty nodes", "id=nodes", json, empty_nodes(30 << 20)),
        attack("nested unions", "id=unions", json, nested_unions(40)),
        attack("unions that fit", "id=few", json, nested_unions(4)),
        attack("a giant header", "name=giant.ply", binary, giant.into()),
        attack("a giant list", "name=strip.ply.gz", binary, strip),
        attack("a glTF of nodes", "name=nodes.gltf", binary, gltf.into_bytes()),
        attack("a text that ends", "name=cut.ply", binary, damaged(5)),
        attack("a text of nothing", "name=cut.obj", binary, b"f 1 2 3\n".repeat(1000)),
        attack("two files", "name=a.ply", &form_type, form_body),
        attack("a wall", "name=wall.ply", binary, wall_ply(250).into_bytes()),
        attack("a small scene", "name=small.ply", binary, ply.clone().into_bytes()),
    ]
}

/// State shared by the client of frames and the attacker.
struct Arena {
    address: Mutex<SocketAddr>,
    /// The daemon is being restarted, so frames need not be answered.
    restarting: AtomicBool,
    done: AtomicBool,
    frames: AtomicU64,
}

/// Requests the same frame repeatedly, and compares every answer with the first.
fn watch_frames(arena: &Arena) {
    let mut first: Option<Vec<u8>> = None;
    while !arena.done.load(Ordering::SeqCst) {
        if arena.restarting.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(20));
            continue;
        }
        let client = Client::new(*arena.address.lock().unwrap());
        let began = Instant::now();
        let reply = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| client.get(FRAME)));
        if arena.restarting.load(Ordering::SeqCst) {
            continue;
        }
        let reply = reply.expect("the daemon answers");
        assert_eq!(reply.status, 200, "{}", reply.text());
        assert!(began.elapsed() < Duration::from_secs(60), "a frame took too long");
        let known = first.get_or_insert_with(|| reply.body.clone());
        assert!(*known == reply.body, "a frame differs from the first");
        arena.frames.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn attack(client: &Client, attack: &Attack, wait: &str) {
    let headers = [("content-type", attack.content_type.as_str()), ("prefer", wait)];
    let path = format!("/v1/scenes?{}", attack.query);
    let sent = || client.send("POST", &path, &headers, Some(&attack.body));
    let Ok(reply) = std::panic::catch_unwind(std::panic::AssertUnwindSafe(sent)) else {
        // A daemon that refuses an upload by its head closes the connection while the client still sends the body.
        assert_eq!(client.get("/healthz").status, 200, "{}", attack.name);
        return;
    };
    let fine = [201, 202, 409, 413, 415, 422, 429, 507].contains(&reply.status);
    assert!(fine, "{}: {} {}", attack.name, reply.status, reply.text());
}

fn delete_all(client: &Client) {
    let scenes = client.get("/v1/scenes").json();
    for scene in scenes["scenes"].as_array().unwrap() {
        let id = scene["id"].as_str().unwrap();
        if id != "grid" {
            let reply = client.send("DELETE", &format!("/v1/scenes/{id}"), &[], None);
            assert!([204, 404].contains(&reply.status), "{id}: {}", reply.text());
        }
    }
}

#[test]
fn hostile_uploads_never_lose_the_daemon() {
    let seconds = std::env::var("SOAK_SECONDS").ok().and_then(|text| text.parse().ok());
    let until = Instant::now() + Duration::from_secs(seconds.unwrap_or(8));
    let attacks = attacks();
    let mut daemon = Daemon::start_limited(LIMIT_KIB, &ARGS);
    assert_eq!(daemon.client().get(FRAME).status, 200);
    let mut at_first = resident_bytes(&daemon);
    let arena = Arena {
        address: Mutex::new(daemon.address),
        restarting: AtomicBool::new(false),
        done: AtomicBool::new(false),
        frames: AtomicU64::new(0),
    };
    let mut random = SplitMix64::new(15);
    let (mut uploads, mut restarts) = (0u64, 0u64);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // A failure of the client ends the soak at once.
            let ended = Ended(&arena);
            watch_frames(&arena);
            drop(ended);
        });
        let _ended = Ended(&arena);
        let daemon = &mut daemon;
        while (uploads < attacks.len() as u64 || Instant::now() < until)
            && !arena.done.load(Ordering::SeqCst)
        {
            let client = daemon.client();
            // Each attack once, then random ones.
            let chosen = match attacks.get(uploads as usize) {
                Some(attack) => attack,
                None => &attacks[random.next_u64() as usize % attacks.len()],
            };
            let wait = ["wait=0", "wait=30"][random.next_u64() as usize % 2];
            attack(&client, chosen, wait);
            uploads += 1;
            assert!(!daemon.is_lost(), "lost after {}", chosen.name);
            match random.next_u64() % 8 {
                0 | 1 => delete_all(&client),
                2 if restarts * 20 < uploads => {
                    arena.restarting.store(true, Ordering::SeqCst);
                    daemon.kill_and_start(&ARGS);
                    *arena.address.lock().unwrap() = daemon.address;
                    arena.restarting.store(false, Ordering::SeqCst);
                    restarts += 1;
                    at_first = at_first.max(resident_bytes(daemon));
                }
                _ => {}
            }
        }
    });
    let frames = arena.frames.load(Ordering::SeqCst);
    eprintln!("{uploads} uploads, {restarts} kills, {frames} frames");
    assert!(frames > 0, "no frame was answered");
    let client = daemon.client();
    delete_all(&client);
    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
    let left = || resident_bytes(&daemon).saturating_sub(at_first);
    eventually("the memory", || left() < MAY_BE_LEFT);
    assert_eq!(client.get(FRAME).status, 200);
}

/// Ends the other side when this side ends, even by a panic.
struct Ended<'a>(&'a Arena);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.done.store(true, Ordering::SeqCst);
    }
}
