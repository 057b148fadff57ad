//! Tests of jobs on a real daemon: their products, operations on them, and their durability.

mod damage;
mod deeds;
mod ends;
mod kills;
mod queries;
mod sharing;
mod swaps;
mod video;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::client::{Client, Reply};
use super::daemon::{Daemon, grid_scene};

/// A path of four seconds.
pub fn fly() -> Value {
    json!({ "fps": 30, "keys": [
        { "t": 0, "eye": [0, 0, 3], "target": [0, 0, 0] },
        { "t": 2, "eye": [2, 1, 2], "target": [0, 0, 0], "fov": 50 },
        { "t": 4, "eye": [-1, 0, 3], "target": [0, 0, 0] },
    ] })
}

/// Number of frames of [`fly`] at its own rate.
pub const FRAMES: u64 = 121;

/// Starts a daemon whose scene has the path `fly`.
pub fn studio(args: &[&str]) -> Daemon {
    Daemon::start_in(name_path, args)
}

pub fn name_path(root: &Path) {
    let mut scene = grid_scene("grid.ply");
    scene["paths"] = json!({ "fly": fly() });
    fs::write(root.join("grid.json"), scene.to_string()).unwrap();
}

/// The body of a small job, with the fields of `more`.
pub fn body(more: Value) -> Value {
    let mut body = json!({ "scene": "grid", "path": "fly", "w": 64, "h": 48 });
    for (key, value) in more.as_object().unwrap() {
        body[key] = value.clone();
    }
    body
}

/// Creates a job and returns its id.
pub fn create(client: &Client, more: Value) -> String {
    let reply = client.post_json("/v1/jobs", &body(more));
    assert_eq!(reply.status, 201, "{}", reply.text());
    reply.json()["id"].as_str().unwrap().to_owned()
}

pub fn job(client: &Client, id: &str) -> Value {
    let reply = client.get(&format!("/v1/jobs/{id}"));
    assert_eq!(reply.status, 200, "{}", reply.text());
    reply.json()
}

pub fn post(client: &Client, path: &str) -> Reply {
    client.send("POST", path, &[], Some(b""))
}

/// Waits until a job satisfies `is_so`.
pub fn when(client: &Client, id: &str, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
    let until = Instant::now() + Duration::from_secs(180);
    loop {
        let found = job(client, id);
        if is_so(&found) {
            return found;
        }
        assert!(Instant::now() < until, "{what} does not come: {found}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Waits until a job has ended in `state`.
pub fn ended(client: &Client, id: &str, state: &str) -> Value {
    let has_ended = |job: &Value| !["queued", "running"].contains(&job["state"].as_str().unwrap());
    let found = when(client, id, state, has_ended);
    assert_eq!(found["state"], state, "{found}");
    found
}

/// Waits until a job has drawn this many frames.
pub fn drawn(client: &Client, id: &str, frames: u64) -> Value {
    when(client, id, "frames", |job| job["frames"]["done"].as_u64().unwrap() >= frames)
}

/// The records of a job's manifest.
pub fn manifest(client: &Client, id: &str) -> Vec<Value> {
    let reply = client.get(&format!("/v1/jobs/{id}/frames"));
    assert_eq!(reply.status, 200, "{}", reply.text());
    reply.text().lines().skip(1).map(|line| serde_json::from_str(line).unwrap()).collect()
}

pub fn checksum(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The frames of a job on the daemon's disk, by name: content, and identity of the file.
pub fn files(daemon: &Daemon, id: &str) -> BTreeMap<String, (Vec<u8>, u64)> {
    let folder = daemon.state().join("jobs").join(id).join("frames");
    let Ok(items) = fs::read_dir(folder) else { return BTreeMap::new() };
    let items = items.map(|item| item.unwrap());
    let frames = items.filter(|item| item.file_name().to_string_lossy().starts_with("frame-"));
    frames
        .map(|item| {
            let name = item.file_name().into_string().unwrap();
            (name, (fs::read(item.path()).unwrap(), item.metadata().unwrap().ino()))
        })
        .collect()
}

/// The frames of the same film by name, drawn by `pointillist path` in one run.
pub fn filmed(daemon: &Daemon, folder: &Path, more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let output = Command::new(env!("CARGO_BIN_EXE_pointillist"))
        .args(["path", "grid.json", "--path", "fly", "--size", "64x48", "--no-cache", "-o"])
        .arg(folder)
        .args(more)
        .current_dir(daemon.root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let items = fs::read_dir(folder).unwrap().map(|item| item.unwrap());
    let frames = items.filter(|item| item.file_name().to_string_lossy().starts_with("frame-"));
    frames
        .map(|item| (item.file_name().into_string().unwrap(), fs::read(item.path()).unwrap()))
        .collect()
}

/// The number of frames in a multipart answer, and the problem at its end.
pub fn parts_and_problem(reply: &Reply) -> (usize, Value) {
    let mut all = parts(reply);
    let (head, content) = all.pop().unwrap();
    assert!(head.contains("application/problem+json"), "{head}");
    (all.len(), serde_json::from_slice(&content).unwrap())
}

/// Splits a multipart answer into heads and contents of its parts.
pub fn parts(reply: &Reply) -> Vec<(String, Vec<u8>)> {
    let content_type = reply.header("content-type").unwrap();
    let boundary = content_type.split_once("boundary=").unwrap().1;
    let (mut rest, mut parts) = (&reply.body[..], Vec::new());
    let delimiter = format!("\r\n--{boundary}\r\n");
    while let Some(body) = rest.strip_prefix(delimiter.as_bytes()) {
        let end = body.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(body[..end].to_vec()).unwrap().to_lowercase();
        let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")).unwrap();
        let length: usize = length.parse().unwrap();
        let content = &body[end + 4..end + 4 + length];
        parts.push((head, content.to_vec()));
        rest = &body[end + 4 + length..];
    }
    assert_eq!(rest, format!("\r\n--{boundary}--\r\n").as_bytes());
    parts
}
