//! The video of a job.

use serde_json::json;

use super::{body, checksum, create, ended, studio};
#[cfg(feature = "video")]
use super::{files, parts, when};

#[cfg(feature = "video")]
#[test]
fn a_job_makes_a_video() {
    use pointillist::film::video::mp4::Summary;

    let daemon = studio(&[]);
    let client = daemon.client();
    let id = create(&client, json!({"want": ["frames", "video"], "to": 59}));
    let address = format!("/v1/jobs/{id}/video.mp4");
    let early = client.get(&address);
    // On a fast machine the video may exist already.
    assert!(early.status == 200 || early.problem()["type"] == "urn:pointillist:problem:no-video");
    let made = ended(&client, &id, "done");
    let video = client.get(&address);
    assert_eq!((video.status, video.header("content-type")), (200, Some("video/mp4")));
    assert_eq!(
        (&made["video"]["bytes"], &made["video"]["sha256"]),
        (&json!(video.body.len()), &json!(checksum(&video.body)))
    );
    assert_eq!(made["links"]["video"], address);
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), &video.body).unwrap();
    let summary = Summary::read(file.path()).unwrap().unwrap();
    assert_eq!((summary.frames, summary.width, summary.height), (60, 64, 48));
    assert!((summary.duration_s() - 2.0).abs() < 1e-6, "{}", summary.duration_s());
    assert_eq!(files(&daemon, &id).len(), 60);

    // Players seek with range requests.
    let range = |value: &str| client.send("GET", &address, &[("range", value)], None);
    let part = range("bytes=100-199");
    assert_eq!((part.status, &part.body[..]), (206, &video.body[100..200]));
    let whole = format!("bytes 100-199/{}", video.body.len());
    assert_eq!(part.header("content-range"), Some(whole.as_str()));
    assert_eq!(range("bytes=-50").body, video.body[video.body.len() - 50..]);
    let beyond = range("bytes=99999999-");
    assert_eq!((beyond.status, &beyond.problem()["parameter"]), (416, &json!("Range")));
    let tag = video.header("etag").unwrap();
    let of_this = [("range", "bytes=0-9"), ("if-range", tag)];
    assert_eq!(client.send("GET", &address, &of_this, None).status, 206);
    let of_other = [("range", "bytes=0-9"), ("if-range", "\"other\"")];
    assert_eq!(client.send("GET", &address, &of_other, None).body.len(), video.body.len());
    assert_eq!(client.send("GET", &address, &[("if-none-match", tag)], None).status, 304);

    // A job that only wants a video keeps no frames, even after a restart.
    daemon.hold_coding(Some(1));
    let alone = create(&client, json!({"want": ["video"], "to": 59, "bitrate_kbps": 200}));
    when(&client, &alone, "coding", |job| job["stage"] == "video");
    // Until the video is finished, the frames are there.
    assert_eq!(parts(&client.get(&format!("/v1/jobs/{alone}/multipart"))).len(), 60);
    daemon.hold_coding(None);
    ended(&client, &alone, "done");
    let daemon = daemon.restart(&[]);
    let client = daemon.client();
    assert!(files(&daemon, &alone).is_empty());
    assert_eq!(client.get(&format!("/v1/jobs/{alone}/video.mp4")).status, 200);
    let frame = client.get(&format!("/v1/jobs/{alone}/frames/0")).problem();
    assert!(frame["detail"].as_str().unwrap().contains("only its video"), "{frame}");
    assert_eq!(client.get(&format!("/v1/jobs/{alone}/multipart")).problem()["status"], 404);
    assert_eq!(client.get(&format!("/v1/jobs/{alone}/frames")).text().lines().count(), 61);
}

#[test]
fn what_no_video_can_show_is_refused() {
    let daemon = studio(&[]);
    let client = daemon.client();
    for (more, parameter) in [
        (json!({"w": 65}), "w"),
        (json!({"h": 47}), "h"),
        (json!({"w": 8}), "w"),
        (json!({"output": "depth"}), "output"),
        (json!({"format": "exr"}), "format"),
        (json!({"to": 0}), "to"),
    ] {
        let mut asked = body(more);
        asked["want"] = json!(["video"]);
        let problem = client.post_json("/v1/jobs", &asked).problem();
        if problem["type"] == "urn:pointillist:problem:unavailable-parameter" {
            assert!(problem["detail"].as_str().unwrap().contains("ffmpeg"), "{problem}");
            continue;
        }
        assert_eq!(
            (&problem["status"], &problem["parameter"]),
            (&json!(422), &json!(parameter)),
            "{problem}"
        );
    }
    let id = create(&client, json!({"to": 1}));
    ended(&client, &id, "done");
    let none = client.get(&format!("/v1/jobs/{id}/video.mp4")).problem();
    assert!(none["detail"].as_str().unwrap().contains("`video` is not in"), "{none}");
    assert_eq!(checksum(b"").len(), 64);
}
