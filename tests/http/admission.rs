//! Uploads that exceed limits, take long, or kill their loader: the daemon survives, and keeps what it has acknowledged.

use std::io::Write;

use serde_json::{Value, json};

use super::client::form;
use super::daemon::{Daemon, eventually, grid_ply, wall_ply};

/// Equal points, gzipped: 6 bytes per point before compression, and almost none after.
pub fn equal_points(count: usize) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let block = "0 0 0\n".repeat(1000);
    for _ in 0..count / 1000 {
        encoder.write_all(block.as_bytes()).unwrap();
    }
    encoder.finish().unwrap()
}

/// A scene of empty nodes with about this many bytes.
pub fn empty_nodes(bytes: usize) -> Vec<u8> {
    let nodes = "{},".repeat(bytes / 3);
    format!(r#"{{"assets": {{}}, "nodes": [{nodes}{{}}]}}"#).into_bytes()
}

/// A chain of nested unions, with a sampled mesh at the innermost.
pub fn nested_unions(depth: usize) -> Vec<u8> {
    let mut assets = serde_json::Map::new();
    assets.insert("u0".into(), json!({"file": "grid.ply", "features": false}));
    for level in 1..=depth {
        let below = format!("u{}", level - 1);
        let moved = json!({"asset": below, "translate": [0.01, 0, 0]});
        assets.insert(format!("u{level}"), json!({"union": [{"asset": below}, moved]}));
    }
    json!({"assets": assets, "nodes": [{"asset": format!("u{depth}")}]}).to_string().into_bytes()
}

/// Resident memory of the daemon in bytes.
pub fn resident_bytes(daemon: &Daemon) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap() * 1024
}

const JSON: [(&str, &str); 1] = [("content-type", "application/json")];
const AT_ONCE: [(&str, &str); 1] = [("prefer", "wait=0")];

#[test]
fn what_cannot_fit_is_refused_with_figures() {
    let daemon = Daemon::start(&["--host-memory-mib", "64"]);
    let client = daemon.client();
    let before = client.metric("pointillist_host_memory_bytes");
    let limits = client.get("/v1/limits").json();
    assert_eq!(limits["host_memory_bytes"], json!(64 << 20));
    // The largest frame and the memory of a CPU adapter follow the flag.
    assert_eq!(limits["max_pixels"], json!(1 << 20));
    let budget = limits["gpu_budget_bytes"].as_u64().unwrap();
    let receipt = client.get("/v1/scenes/grid/frame?w=8&h=8").receipt();
    let is_cpu = receipt["adapter"].as_str().unwrap().contains("llvmpipe");
    assert!(budget == 64 << 20 || !is_cpu, "{limits}");
    let refused = client.get("/v1/scenes/grid/frame?w=1025&h=1024");
    assert_eq!(refused.status, 422);
    assert!(refused.problem()["detail"].as_str().unwrap().contains("1048576"));

    let bomb = equal_points(5_000_000);
    assert!(bomb.len() < 1 << 20);
    let reply = client.send("POST", "/v1/scenes?name=bomb.xyz.gz", &[], Some(&bomb));
    assert_eq!(reply.status, 413, "{}", reply.text());
    let detail = reply.problem()["detail"].as_str().unwrap().to_owned();
    assert!(detail.starts_with("bomb.xyz.gz") && detail.contains("67108864"), "{detail}");

    let reply = client.send("POST", "/v1/scenes?id=nodes", &JSON, Some(&empty_nodes(30 << 20)));
    assert_eq!(reply.status, 413, "{}", reply.text());
    let detail = reply.problem()["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("nodes (100001)") && detail.contains("100000"), "{detail}");

    let reply = client.send("POST", "/v1/scenes?id=deep", &JSON, Some(&nested_unions(40)));
    assert_eq!(reply.status, 422, "{}", reply.text());
    let problem = reply.problem();
    assert!(problem["parameter"].as_str().unwrap().starts_with("assets.u"), "{problem}");
    assert!(problem["detail"].as_str().unwrap().contains("at most 4096"), "{problem}");

    // Empty poses, which are counted before they are parsed.
    let poses = format!("{{\"poses\": [{}{{}}]}}", "{},".repeat(4 << 20));
    let reply = client.send("POST", "/v1/scenes/grid/frames", &JSON, Some(poses.as_bytes()));
    assert_eq!(reply.status, 422, "{}", reply.text());

    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
    assert_eq!(client.metric("pointillist_host_memory_bytes"), before);
    let reply = client.send("POST", "/v1/scenes?name=a.ply", &[], Some(grid_ply().as_bytes()));
    assert_eq!(reply.status, 201, "{}", reply.text());
    assert!(client.metric("pointillist_host_memory_bytes") > before);
    assert_eq!(client.send("DELETE", "/v1/scenes/a", &[], None).status, 204);
    eventually("the memory", || client.metric("pointillist_host_memory_bytes") == before);
}

#[test]
fn delete_cancels_a_load() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let before = client.metric("pointillist_host_memory_bytes");
    let large = wall_ply(600);
    let path = "/v1/scenes?id=slow&name=a.ply";
    let reply = client.send("POST", path, &AT_ONCE, Some(large.as_bytes()));
    assert_eq!(reply.status, 202, "{}", reply.text());
    assert_eq!(client.send("DELETE", "/v1/scenes/slow", &[], None).status, 204);
    assert!(daemon.log().contains("load cancelled"), "{}", daemon.log());
    assert_eq!(client.get("/v1/scenes/slow").status, 404);
    assert!(daemon.uploads().is_empty());
    assert_eq!(client.metric("pointillist_host_memory_bytes"), before);
    assert_eq!(client.get("/v1/limits").json()["uploads"]["scenes"], json!(0));
    // The id is free again.
    let reply = client.send("POST", path, &[], Some(grid_ply().as_bytes()));
    assert_eq!(reply.status, 201, "{}", reply.text());
}

#[test]
fn a_scene_whose_files_cannot_be_removed_stays() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let ply = grid_ply();
    let upload = || client.send("POST", "/v1/scenes?id=kept&name=a.ply", &[], Some(ply.as_bytes()));
    assert_eq!(upload().status, 201);
    // The folder is renamed before it is removed, and these names are taken by folders with files.
    let taken =
        |number: u32| daemon.root().join(format!("uploads/.partial-{}-{number}/a", daemon.id()));
    (0..9).for_each(|number| std::fs::create_dir_all(taken(number)).unwrap());
    let refused = client.send("DELETE", "/v1/scenes/kept", &[], None);
    assert_eq!(refused.status, 507, "{}", refused.text());
    assert_eq!(refused.problem()["type"], "urn:pointillist:problem:storage");
    assert_eq!(client.get("/v1/scenes/kept/frame?w=16&h=16").status, 200);
    assert_eq!(upload().status, 409);
    assert_eq!(client.get("/v1/limits").json()["uploads"]["scenes"], json!(1));
    let daemon = daemon.kill_and_restart(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/kept").json()["state"], "ready");
    assert_eq!(client.send("DELETE", "/v1/scenes/kept", &[], None).status, 204);
    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
    assert_eq!(client.get("/v1/limits").json()["uploads"]["scenes"], json!(0));
}

#[test]
fn an_upload_whose_loader_died_is_set_aside() {
    // The file is large enough that the load is still running when the daemon is killed, at any speed of the machine.
    let killed = [400, 800, 1600, 3200].into_iter().find_map(|side| {
        let mut daemon = Daemon::start(&[]);
        let path = "/v1/scenes?id=fatal&name=a.ply";
        let reply = daemon.client().send("POST", path, &AT_ONCE, Some(wall_ply(side).as_bytes()));
        assert_eq!(reply.status, 202, "{}", reply.text());
        let record = daemon.root().join("uploads/fatal/.upload.json");
        let stage = || {
            let record: Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
            record["stage"].as_str().unwrap().to_owned()
        };
        eventually("the load", || stage() != "received");
        daemon.kill();
        (stage() == "loading").then_some(daemon)
    });
    let daemon = killed.unwrap().kill_and_restart(&[]);
    let client = daemon.client();
    let scene = client.get("/v1/scenes/fatal").json();
    assert_eq!(scene["state"], "failed");
    assert_eq!(scene["problem"]["type"], "urn:pointillist:problem:load-lost");
    assert_eq!(client.get("/v1/scenes/grid").json()["state"], "ready");
    assert_eq!(client.send("POST", "/v1/scenes/grid/retry", &[], None).status, 409);
    assert_eq!(client.send("POST", "/v1/scenes/none/retry", &[], None).status, 404);
    // No start of the daemon loads the upload again; an explicit request does.
    let daemon = daemon.restart(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/fatal").json()["state"], "failed");
    let wait = [("prefer", "wait=60")];
    let reply = client.send("POST", "/v1/scenes/fatal/retry", &wait, None);
    assert_eq!(reply.status, 201, "{}", reply.text());
    assert_eq!(client.get("/v1/scenes/fatal/frame?w=16&h=16").status, 200);
    let daemon = daemon.kill_and_restart(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/fatal").json()["state"], "ready");
    assert_eq!(client.send("DELETE", "/v1/scenes/fatal", &[], None).status, 204);
    assert!(daemon.uploads().is_empty());
}

#[test]
fn a_failed_upload_of_an_earlier_run_is_deleted_for_good() {
    let daemon = Daemon::start_in(
        |root| {
            let folder = root.join("uploads/broken");
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("a.ply"), "ply\nnonsense").unwrap();
        },
        &[],
    );
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/broken").json()["state"], "failed");
    assert_eq!(daemon.uploads(), ["broken"]);
    assert_eq!(client.send("DELETE", "/v1/scenes/broken", &[], None).status, 204);
    assert!(daemon.uploads().is_empty());
}

#[test]
fn a_form_whose_main_file_was_named_outlives_a_kill() {
    let daemon = Daemon::start(&[]);
    let ply = grid_ply();
    let (content_type, body) = form(&[("a.ply", ply.as_bytes()), ("b.ply", ply.as_bytes())]);
    let headers = [("content-type", content_type.as_str())];
    let client = daemon.client();
    let reply = client.send("POST", "/v1/scenes?id=two&name=a.ply", &headers, Some(&body));
    assert_eq!(reply.status, 201, "{}", reply.text());
    let frame = "/v1/scenes/two/frame?w=16&h=16";
    let first = client.get(frame);
    let daemon = daemon.kill_and_restart(&[]);
    let again = daemon.client().get(frame);
    assert_eq!((again.status, again.body), (200, first.body));
}

#[test]
fn uploads_are_limited_in_number_and_in_bytes() {
    let args = ["--max-uploads", "2", "--upload-disk-mib", "1"];
    let daemon = Daemon::start(&args);
    let client = daemon.client();
    let ply = grid_ply();
    let upload = |client: &super::client::Client, id: &str, body: &[u8]| {
        client.send("POST", &format!("/v1/scenes?id={id}&name=a.ply"), &[], Some(body))
    };
    assert_eq!(upload(&client, "a", ply.as_bytes()).status, 201);
    let full = upload(&client, "b", &vec![b' '; 1 << 20]);
    assert_eq!(full.status, 507, "{}", full.text());
    let detail = full.problem()["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("1048576") && detail.contains(&ply.len().to_string()), "{detail}");
    assert_eq!(upload(&client, "b", ply.as_bytes()).status, 201);
    let many = upload(&client, "c", ply.as_bytes());
    assert_eq!(many.status, 429, "{}", many.text());
    let held = client.get("/v1/limits").json()["uploads"].clone();
    assert_eq!((&held["scenes"], &held["max_scenes"]), (&json!(2), &json!(2)), "{held}");
    assert_eq!(held["bytes"], json!(2 * ply.len()));
    // Uploads count after a restart, and no longer after they are deleted.
    let daemon = daemon.restart(&args);
    let client = daemon.client();
    assert_eq!(upload(&client, "c", ply.as_bytes()).status, 429);
    assert_eq!(client.send("DELETE", "/v1/scenes/a", &[], None).status, 204);
    assert_eq!(upload(&client, "c", ply.as_bytes()).status, 201);
}
