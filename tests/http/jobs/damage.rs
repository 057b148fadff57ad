//! Files that were damaged from outside, and a full disk.

use std::fs;

use serde_json::json;

use super::{body, checksum, create, ended, files, job, manifest, parts_and_problem, post, studio};
use crate::daemon::{eventually, fill_disk, on_small_disk};

#[test]
fn damaged_frames_are_not_sent_and_made_again() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let id = create(&client, json!({"to": 9}));
    let made = ended(&client, &id, "done");
    let before = files(&daemon, &id);
    let file = |number: usize| {
        daemon.state().join("jobs").join(&id).join(format!("frames/frame-{number:05}.png"))
    };
    let mut flipped = before["frame-00003.png"].0.clone();
    *flipped.last_mut().unwrap() ^= 1;
    fs::write(file(3), flipped).unwrap();
    fs::write(file(5), &before["frame-00005.png"].0[..50]).unwrap();
    fs::remove_file(file(7)).unwrap();
    for number in [3, 5, 7] {
        let problem = client.get(&format!("/v1/jobs/{id}/frames/{number}")).problem();
        assert_eq!(
            (&problem["status"], &problem["type"]),
            (&json!(410), &json!("urn:pointillist:problem:job-file-damaged")),
            "{number}: {problem}"
        );
        assert!(problem["detail"].as_str().unwrap().contains(&format!("frame {number} of job")));
        assert!(problem["accepted"].as_str().unwrap().contains("/resume"), "{problem}");
    }
    let ranged = [("range", "bytes=0-3")];
    let part = client.send("GET", &format!("/v1/jobs/{id}/frames/4"), &ranged, None);
    assert_eq!((part.status, &part.body[..]), (206, &before["frame-00004.png"].0[..4]));
    // The stream ends at the first damaged frame.
    let (sent, problem) = parts_and_problem(&client.get(&format!("/v1/jobs/{id}/multipart")));
    assert_eq!((sent, &problem["status"]), (3, &json!(410)));

    // Intact frames keep their files, and the manifest stays the same.
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    let again = ended(&client, &id, "done");
    assert_eq!(again["manifest_sha256"], made["manifest_sha256"]);
    let after = files(&daemon, &id);
    assert_eq!(after.len(), before.len());
    for (number, record) in manifest(&client, &id).iter().enumerate() {
        let name = record["file"].as_str().unwrap();
        assert!(after[name].0 == before[name].0, "{name}");
        assert_eq!(after[name].1 == before[name].1, ![3, 5, 7].contains(&number), "{name}");
        let sent = client.get(&format!("/v1/jobs/{id}/frames/{number}"));
        assert_eq!(record["sha256"], checksum(&sent.body));
    }
    // A job with intact files is done again at once.
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    ended(&client, &id, "done");
    assert_eq!(files(&daemon, &id), after);
}

#[cfg(feature = "video")]
#[test]
fn damaged_videos_are_not_sent_and_made_again() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let both = create(&client, json!({"want": ["frames", "video"], "to": 9}));
    let alone = create(&client, json!({"want": ["video"], "to": 9}));
    for id in [both, alone] {
        let made = ended(&client, &id, "done");
        let file = daemon.state().join("jobs").join(&id).join("video.mp4");
        let bytes = fs::read(&file).unwrap();
        // After checking its files, the job is done again without drawing.
        let drawn = client.metric("pointillist_job_frames_total");
        assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
        assert_eq!(ended(&client, &id, "done")["video"], made["video"]);
        assert_eq!(client.metric("pointillist_job_frames_total"), drawn);
        fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
        let video = || client.get(&format!("/v1/jobs/{id}/video.mp4"));
        assert_eq!(video().problem()["type"], "urn:pointillist:problem:job-file-damaged");
        assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
        assert_eq!(ended(&client, &id, "done")["frames"]["done"], 10);
        assert_eq!(video().status, 200);
    }
}

#[test]
fn a_full_disk_is_told_and_gone_with_its_cause() {
    let Some((daemon, disk)) = on_small_disk(super::name_path) else { return };
    let client = daemon.client();
    let small = || json!({"to": 3});
    let first = create(&client, small());
    ended(&client, &first, "done");
    // Another process fills the disk.
    let filler = disk.join("filler");
    fill_disk(&filler);
    for _ in 0..2 {
        let refused = client.post_json("/v1/jobs", &body(small()));
        let problem = refused.problem();
        assert_eq!(
            (&problem["status"], &problem["type"]),
            (&json!(507), &json!("urn:pointillist:problem:storage")),
            "{problem}"
        );
        assert!(problem["detail"].as_str().unwrap().contains("is full"), "{problem}");
    }
    assert_eq!(post(&client, &format!("/v1/jobs/{first}/resume")).status, 507);
    assert_eq!(job(&client, &first)["state"], "done", "it is as it was");
    assert_eq!(client.get("/v1/jobs").json()["jobs"].as_array().unwrap().len(), 1);
    // Deleting a job makes room, and works on a full disk.
    let gone = client.send("DELETE", &format!("/v1/jobs/{first}"), &[], None);
    assert_eq!(gone.status, 204, "{}", gone.text());
    assert_eq!(client.get("/v1/jobs").json(), json!({"jobs": []}));
    eventually("room", || client.get("/v1/limits").json()["jobs"]["bytes"] == 0);
    // Removing the file that fills the disk also makes room, without a restart.
    fs::remove_file(&filler).unwrap();
    let second = create(&client, small());
    ended(&client, &second, "done");
    eventually("the rest of the removal", || !disk.join("jobs").join(&first).exists());
    // A job that fills the disk itself fails, and deleting it makes room.
    let third = create(&client, json!({"fps": 1000, "format": "raw", "w": 256, "h": 256}));
    let failed = ended(&client, &third, "failed");
    assert_eq!(failed["error"]["type"], "urn:pointillist:problem:storage", "{failed}");
    assert_eq!(client.send("DELETE", &format!("/v1/jobs/{third}"), &[], None).status, 204);
    let last = create(&client, small());
    ended(&client, &last, "done");
    assert_eq!(client.get("/readyz").status, 200);
}
