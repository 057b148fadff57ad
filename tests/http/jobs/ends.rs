//! Durability of jobs: what survives signals, kills and a damaged database.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

use super::{body, checksum, create, drawn, ended, files, filmed, job, manifest, post, studio};
use crate::daemon::{Daemon, eventually};

/// The frames that a job's manifest lists, by name. Reads the manifest on disk, where a kill may have cut off the last line.
fn noted(daemon: &Daemon, id: &str) -> BTreeMap<String, (Vec<u8>, u64)> {
    let found = files(daemon, id);
    let text = fs::read_to_string(daemon.state().join("jobs").join(id).join("frames/frames.jsonl"));
    let records = text.unwrap_or_default();
    let records =
        records.lines().skip(1).filter_map(|line| serde_json::from_str::<Value>(line).ok());
    records
        .map(|record| {
            let name = record["file"].as_str().unwrap().to_owned();
            assert_eq!(record["sha256"], checksum(&found[&name].0), "{name} of {id}");
            let file = found[&name].clone();
            (name, file)
        })
        .collect()
}

/// Three concurrent jobs survive ten kills at random moments, some during startup: the results are those of undisturbed jobs.
#[test]
fn jobs_outlive_ten_kills() {
    const FRAMES: u64 = 401;
    let mut daemon = studio(&[]);
    let ids = [(); 3].map(|()| create(&daemon.client(), json!({"fps": 100})));
    let mut random = SplitMix64::new(11);
    let mut kept = [(); 3].map(|()| BTreeMap::<String, (Vec<u8>, u64)>::new());
    for round in 0..10 {
        if round % 4 == 3 {
            // Kill it shortly after the start.
            std::thread::sleep(Duration::from_millis(random.next_u64() % 60));
        } else {
            let client = daemon.client();
            let which = (random.next_u64() % 3) as usize;
            let more = 1 + random.next_u64() % 25;
            let found = job(&client, &ids[which]);
            assert_ne!(found["state"], "failed", "{found}");
            drawn(&client, &ids[which], (kept[which].len() as u64 + more).min(FRAMES));
        }
        daemon.kill();
        // Frames in the manifests exist and keep their files.
        for (id, kept) in ids.iter().zip(&mut kept) {
            let found = files(&daemon, id);
            for (name, file) in &*kept {
                assert!(found[name] == *file, "{name} of {id} was drawn again in round {round}");
            }
            kept.extend(noted(&daemon, id));
        }
        daemon = daemon.kill_and_restart(&[]);
    }
    let sizes = kept.each_ref().map(BTreeMap::len);
    assert!(sizes.iter().all(|&size| size > 10), "{sizes:?} frames in ten runs");
    // Frames and manifests are those of a single run.
    let client = daemon.client();
    let folder = tempfile::tempdir().unwrap();
    let alone = filmed(&daemon, &folder.path().join("frames"), &["--fps", "100"]);
    let sums = |text: &str| -> Vec<Value> {
        let lines = text.lines().skip(1);
        lines.map(|line| serde_json::from_str::<Value>(line).unwrap()["sha256"].clone()).collect()
    };
    let expected = sums(&fs::read_to_string(folder.path().join("frames/frames.jsonl")).unwrap());
    for (id, kept) in ids.iter().zip(&kept) {
        let made = ended(&client, id, "done");
        let found = files(&daemon, id);
        assert!(kept.iter().all(|(name, file)| found[name] == *file), "{id}");
        assert_eq!((noted(&daemon, id).len(), found.len()), (FRAMES as usize, FRAMES as usize));
        assert_eq!(manifest(&client, id).len(), FRAMES as usize);
        assert!(alone.len() == found.len());
        assert!(alone.iter().all(|(name, bytes)| found[name].0 == *bytes), "{id}");
        let text = client.get(&format!("/v1/jobs/{id}/frames")).text();
        assert_eq!(sums(&text), expected);
        assert_eq!(made["manifest_sha256"], checksum(text.as_bytes()));
    }
}

#[test]
fn sigterm_pauses_jobs() {
    let daemon = studio(&["--job-runners", "1"]);
    let client = daemon.client();
    let id = create(&client, json!({"fps": 500}));
    let behind = create(&client, json!({"to": 4}));
    drawn(&client, &id, 10);
    // The daemon stops within its drain time, although the job would take much longer.
    let daemon = daemon.restart(&["--drain-seconds", "5", "--job-runners", "1"]);
    assert!(daemon.state().join("jobs").join(&id).join("frames/frames.jsonl").exists());
    let client = daemon.client();
    let before = files(&daemon, &id);
    // The job that had begun continues before the one behind it.
    ended(&client, &behind, "done");
    assert_eq!(job(&client, &id)["state"], "done");
    let after = files(&daemon, &id);
    assert_eq!(after.len(), 2001);
    assert!(before.iter().all(|(name, file)| after[name] == *file));
    let again = daemon.restart(&[]);
    assert_eq!(job(&again.client(), &id)["frames"]["done"], 2001);
    assert_eq!(again.client().get(&format!("/v1/jobs/{id}/frames/2000")).status, 200);
}

#[test]
fn two_daemons_do_not_share_a_state_folder() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let output = Command::new(env!("CARGO_BIN_EXE_pointillist"))
        .args(["serve", "--listen", "127.0.0.1:0", "--root"])
        .arg(daemon.root())
        .arg("--state")
        .arg(daemon.state())
        .arg("--no-uploads")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success()
            && told.contains("--state")
            && told.contains("another running server"),
        "{told}"
    );
    ended(&client, &create(&client, json!({"to": 2})), "done");

    // With the default folder, the second daemon runs without jobs and says so.
    let states = tempfile::tempdir().unwrap();
    let first = Daemon::start_with_user_state(states.path(), &[]);
    let second = Daemon::start_with_user_state(states.path(), &[]);
    assert!(states.path().join("pointillist/jobs.redb").exists());
    assert_eq!(first.client().get("/v1/jobs").status, 200);
    let off = second.client().get("/v1/jobs").problem();
    assert_eq!(
        (&off["status"], &off["type"]),
        (&json!(503), &json!("urn:pointillist:problem:jobs-off"))
    );
    assert!(off["detail"].as_str().unwrap().contains("another running server"), "{off}");
    assert!(!off["detail"].as_str().unwrap().contains(states.path().to_str().unwrap()), "{off}");
    assert!(second.log().contains("jobs are disabled"), "{}", second.log());
    assert_eq!(second.client().post_json("/v1/jobs", &body(json!({}))).status, 503);
    assert_eq!(second.client().get("/v1/limits").json()["jobs"], json!(null));
    assert_eq!(second.client().get("/v1/scenes/grid/frame?w=8&h=8").status, 200);
    let none = Daemon::start(&["--no-jobs"]);
    assert!(
        none.client().get("/v1/jobs").problem()["detail"].as_str().unwrap().contains("--no-jobs")
    );
    assert!(!none.state().exists());
}

/// With any kind of damage the daemon starts, reports it and keeps the damaged file, and no job is lost.
#[test]
fn a_damaged_database_is_set_aside() {
    let mut daemon = studio(&[]);
    let client = daemon.client();
    let done = create(&client, json!({"to": 9}));
    ended(&client, &done, "done");
    let running = create(&client, json!({"fps": 1000}));
    drawn(&client, &running, 20);
    for (round, damage) in ["noise", "flip", "cut"].into_iter().enumerate() {
        daemon.kill();
        let before = files(&daemon, &running);
        let database = daemon.state().join("jobs.redb");
        let mut bytes = fs::read(&database).unwrap();
        match damage {
            "noise" => bytes = b"this is no database".to_vec(),
            "flip" => bytes.iter_mut().skip(64).step_by(7).for_each(|byte| *byte ^= 0x55),
            _ => bytes.truncate(bytes.len() / 3),
        }
        fs::write(&database, &bytes).unwrap();
        daemon = daemon.kill_and_restart(&[]);
        assert!(daemon.log().contains("the job database is damaged"), "{damage}: {}", daemon.log());
        let aside: Vec<_> = fs::read_dir(daemon.state())
            .unwrap()
            .map(|item| item.unwrap().path())
            .filter(|path| path.to_string_lossy().contains("jobs.redb.damaged-"))
            .collect();
        assert_eq!(aside.len(), round + 1, "{damage}");
        assert!(aside.iter().any(|path| fs::read(path).unwrap() == bytes), "{damage}");
        let client = daemon.client();
        for id in [&done, &running] {
            let found = job(&client, id);
            assert_eq!(
                (&found["state"], &found["error"]["type"]),
                (&json!("failed"), &json!("urn:pointillist:problem:job-recovered")),
                "{damage}"
            );
            assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200, "{damage}");
        }
        ended(&client, &done, "done");
        drawn(&client, &running, before.len() as u64 + 5);
        let after = files(&daemon, &running);
        // A frame whose line was not written is drawn again into a new file with the same content.
        for (name, (bytes, _)) in &before {
            assert!(after[name].0 == *bytes, "{damage}: {name}");
        }
    }
    let client = daemon.client();
    post(&client, &format!("/v1/jobs/{running}/cancel"));
    let new = create(&client, json!({"to": 1}));
    assert_eq!(new, "3");
    ended(&client, &new, "done");
}

/// A job does not wait for ever for a scene that never comes back.
#[test]
fn a_scene_that_stays_away_ends_the_wait() {
    let daemon = studio(&["--job-ttl-seconds", "1000"]);
    let client = daemon.client();
    let id = create(&client, json!({"fps": 1000}));
    drawn(&client, &id, 3);
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    eventually("the wait", || job(&client, &id)["waits_for"].is_string());
    let scene = daemon.root().join("grid.json");
    fs::rename(&scene, daemon.root().join("grid.away")).unwrap();
    let ply = daemon.root().join("grid.ply");
    fs::rename(&ply, daemon.root().join("other.ply")).unwrap();
    let daemon = daemon.restart(&["--job-ttl-seconds", "2"]);
    let client = daemon.client();
    assert_eq!(job(&client, &id)["state"], "queued");
    let failed = ended(&client, &id, "failed");
    assert!(
        failed["error"]["detail"].as_str().unwrap().contains("scene `grid` is not loaded"),
        "{failed}"
    );
}
