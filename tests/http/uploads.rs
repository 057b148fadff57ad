//! Uploads: single files, forms, limits, names, and files left on disk.

use std::io::Write;
use std::net::Shutdown;
use std::path::Path;

use serde_json::json;

use super::client::{Client, form, raw};
use super::daemon::{Daemon, eventually, fill_disk, grid_ply, grid_scene, on_small_disk, wall_ply};

#[test]
fn an_asset_becomes_a_scene_until_it_is_deleted() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let ply = grid_ply();
    let reply = client.send("POST", "/v1/scenes?name=My%20Wall.ply", &[], Some(ply.as_bytes()));
    assert_eq!(reply.status, 201, "{}", reply.text());
    assert_eq!(reply.header("location"), Some("/v1/scenes/my-wall"));
    let scene = reply.json();
    assert_eq!((&scene["state"], &scene["samples"]), (&json!("ready"), &json!(4096)));
    assert_eq!(daemon.uploads(), ["my-wall"]);
    let frame = client.get("/v1/scenes/my-wall/frame?w=32&h=32");
    assert_eq!((frame.status, &frame.receipt()["scene"]), (200, &json!("my-wall")));
    let list = client.get("/v1/scenes").json();
    let ids: Vec<&str> =
        list["scenes"].as_array().unwrap().iter().filter_map(|s| s["id"].as_str()).collect();
    assert!(ids.contains(&"grid") && ids.contains(&"my-wall"), "{ids:?}");
    assert_eq!(client.metric("pointillist_uploads_bytes_total"), ply.len() as f64);

    // A repeated file name gets another id. A given id can be used only once.
    let disposition = [("content-disposition", "attachment; filename=\"My Wall.ply\"")];
    let again = client.send("POST", "/v1/scenes", &disposition, Some(ply.as_bytes()));
    assert_eq!(again.header("location"), Some("/v1/scenes/my-wall-2"), "{}", again.text());
    let path = "/v1/scenes?id=my-wall&name=a.ply";
    let clash = client.send("POST", path, &[], Some(ply.as_bytes()));
    assert_eq!((clash.status, &clash.problem()["parameter"]), (409, &json!("id")));

    let resident = client.metric("pointillist_engine_resident_bytes");
    assert_eq!(client.send("DELETE", "/v1/scenes/my-wall", &[], None).status, 204);
    assert!(client.metric("pointillist_engine_resident_bytes") <= resident);
    assert_eq!(daemon.uploads(), ["my-wall-2"]);
    assert_eq!(client.get("/v1/scenes/my-wall").status, 404);
    assert_eq!(client.get("/v1/scenes/my-wall/frame").status, 404);
    assert_eq!(client.send("DELETE", "/v1/scenes/my-wall", &[], None).status, 404);
    // A scene of the root is unloaded, but its files stay.
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    assert!(daemon.root().join("grid.json").exists());
}

#[test]
fn the_up_of_an_upload_is_kept_with_it() {
    let daemon = Daemon::start(&["--up", "x"]);
    let ply = grid_ply();
    let upload = |query: &str| {
        let path = format!("/v1/scenes?name=a.ply&{query}");
        daemon.client().send("POST", &path, &[], Some(ply.as_bytes()))
    };
    let made = upload("id=turned&up=-z");
    assert_eq!(made.status, 201, "{}", made.text());
    assert_eq!(made.json()["up"], json!([0.0, 0.0, -1.0]));
    assert_eq!(upload("id=vector&up=0,2,0").json()["up"], json!([0.0, 1.0, 0.0]));
    assert_eq!(upload("id=other").json()["up"], json!([1.0, 0.0, 0.0]));
    for up in ["up=w", "up=0,0,0", "up=0,0,1e-300", "up=z&up=z"] {
        let refused = upload(&format!("id=none&{up}"));
        assert_eq!((refused.status, &refused.problem()["parameter"]), (422, &json!("up")), "{up}");
    }
    // A scene file has its own `up`, alone or among other files.
    let scene = grid_scene("grid.ply");
    let refused = daemon.client().post_json("/v1/scenes?up=z", &scene);
    assert_eq!((refused.status, &refused.problem()["parameter"]), (422, &json!("up")));
    let (content_type, body) = form(&[("a.json", scene.to_string().as_bytes())]);
    let headers = [("content-type", content_type.as_str())];
    let refused = daemon.client().send("POST", "/v1/scenes?up=z", &headers, Some(&body));
    assert_eq!((refused.status, &refused.problem()["parameter"]), (422, &json!("up")));
    assert_eq!(daemon.uploads().len(), 3);

    let daemon = daemon.kill_and_restart(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/turned").json()["up"], json!([0.0, 0.0, -1.0]));
    let frame = client.get("/v1/scenes/turned/frame?w=16&h=16");
    assert_eq!(frame.receipt()["camera"]["up"], json!([0.0, 0.0, -1.0]));
}

#[test]
fn nobody_takes_the_id_of_a_kept_upload_while_the_daemon_starts() {
    let mut daemon = Daemon::start(&[]);
    let path = "/v1/scenes?id=kept&name=a.ply";
    let ply = grid_ply();
    let upload = |client: &Client| client.send("POST", path, &[], Some(ply.as_bytes())).status;
    assert_eq!(upload(&daemon.client()), 201);
    for _ in 0..3 {
        daemon = daemon.kill_and_restart_asking(|address| {
            assert_eq!(upload(&Client::new(address)), 409);
        });
        assert_eq!(daemon.client().get("/v1/scenes/kept/frame?w=16&h=16").status, 200);
    }
}

#[test]
fn scenes_with_their_files() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    // A bare scene refers to files of the root.
    let reply = client.post_json("/v1/scenes?id=bare", &grid_scene("grid.ply"));
    assert_eq!(reply.status, 201, "{}", reply.text());
    assert_eq!(client.get("/v1/scenes/bare/frame?camera=front&w=16&h=16").status, 200);
    // A scene in a form refers to files of the form.
    let scene = grid_scene("mine.ply").to_string();
    let ply = grid_ply();
    let (content_type, body) =
        form(&[("town.json", scene.as_bytes()), ("mine.ply", ply.as_bytes())]);
    let headers = [("content-type", content_type.as_str())];
    let reply = client.send("POST", "/v1/scenes", &headers, Some(&body));
    assert_eq!(reply.status, 201, "{}", reply.text());
    assert_eq!(reply.header("location"), Some("/v1/scenes/town"));
    let obj = "mtllib m.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let (content_type, body) =
        form(&[("t.obj", obj.as_bytes()), ("m.mtl", b"newmtl red\nKd 1 0 0\n")]);
    let headers = [("content-type", content_type.as_str())];
    let reply = client.send("POST", "/v1/scenes?id=tri", &headers, Some(&body));
    assert_eq!((reply.status, &reply.json()["triangles"]), (201, &json!(1)), "{}", reply.text());

    // Uploads survive a restart, including the bare scene, whose files are in the root.
    let daemon = daemon.restart(&[]);
    let client = daemon.client();
    for id in ["bare", "town", "tri", "grid"] {
        let reply = client.get(&format!("/v1/scenes/{id}/frame?w=16&h=16"));
        assert_eq!(reply.status, 200, "{id}: {}", reply.text());
    }

    // Deleted uploads are gone for good. Scenes of the root are loaded again at every start.
    for id in ["town", "grid"] {
        let path = format!("/v1/scenes/{id}");
        assert_eq!(client.send("DELETE", &path, &[], None).status, 204);
        assert_eq!(client.get(&path).status, 404);
    }
    let daemon = daemon.restart(&[]);
    let client = daemon.client();
    let status = |id: &str| client.get(&format!("/v1/scenes/{id}")).status;
    assert_eq!((status("town"), status("grid")), (404, 200));
}

#[test]
fn what_shows_nothing_says_so() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let obj = b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 3 2 1\n";
    let reply = client.send("POST", "/v1/scenes?name=nothing.obj", &[], Some(obj));
    assert_eq!(reply.status, 201, "{}", reply.text());
    let warnings = reply.json()["warnings"].to_string();
    assert!(warnings.contains("no triangle has an area"), "{warnings}");
}

#[test]
fn refused_uploads_leave_nothing() {
    let daemon = Daemon::start(&["--max-upload-mib", "1"]);
    let client = daemon.client();
    let ply = grid_ply();
    for name in ["..%2Fx.ply", "%2Fetc%2Fx.ply", ".x.ply", "a%5Cb.ply", "a%00.ply", "..", ""] {
        let path = format!("/v1/scenes?name={name}");
        let reply = client.send("POST", &path, &[], Some(ply.as_bytes()));
        assert_eq!((reply.status, &reply.problem()["parameter"]), (422, &json!("name")), "{name}");
    }
    for name in ["../x.ply", "/x.ply", ".x.ply", "a\\b.ply"] {
        let (content_type, body) = form(&[(name, ply.as_bytes())]);
        let headers = [("content-type", content_type.as_str())];
        let reply = client.send("POST", "/v1/scenes", &headers, Some(&body));
        assert_eq!(reply.status, 422, "{name}: {}", reply.text());
    }
    let twice = form(&[("a.ply", ply.as_bytes()), ("a.ply", ply.as_bytes())]);
    let two = form(&[("a.ply", ply.as_bytes()), ("b.ply", ply.as_bytes())]);
    for (content_type, body) in [twice, two, form(&[]), form(&[("x.mtl", b""), ("y.png", b"")])] {
        let headers = [("content-type", content_type.as_str())];
        let reply = client.send("POST", "/v1/scenes", &headers, Some(&body));
        assert_eq!(reply.status, 422, "{}", reply.text());
        reply.problem();
    }
    let headers = [("content-type", "application/octet-stream")];
    assert_eq!(client.send("POST", "/v1/scenes", &headers, Some(b"x")).status, 422);

    // Contents that no reader accepts.
    let broken = ply.replace("0 0 0 90", "zero 0 0 90");
    assert_ne!(broken, ply);
    for (name, body) in
        [("cut.ply", &ply[..ply.len() / 2]), ("word.ply", &broken), ("none.xyzzy", "what is this")]
    {
        let path = format!("/v1/scenes?name={name}");
        let reply = client.send("POST", &path, &[], Some(body.as_bytes()));
        assert!([415, 422].contains(&reply.status), "{name}: {} {}", reply.status, reply.text());
        let detail = reply.problem()["detail"].as_str().unwrap().to_owned();
        assert!(detail.starts_with(name), "{detail}");
    }

    // Too large, by the announced length, or by chunks without an announced length.
    let large = vec![b'x'; 3 << 20];
    let reply = client.send("POST", "/v1/scenes?name=a.ply", &[], Some(&large));
    assert_eq!(reply.status, 413, "{}", reply.text());
    let mut stream = raw(
        daemon.address,
        b"POST /v1/scenes?name=a.ply HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n",
    );
    for _ in 0..30 {
        stream.write_all(b"10000\r\n").unwrap();
        stream.write_all(&large[..0x10000]).unwrap();
        stream.write_all(b"\r\n").unwrap();
    }
    stream.write_all(b"0\r\n\r\n").unwrap();
    let answer = super::client::read_to_close(&mut stream);
    assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
    assert!(daemon.uploads().is_empty(), "{:?}", daemon.uploads());
    assert_eq!(client.get("/v1/scenes").json()["scenes"].as_array().unwrap().len(), 1);
}

#[test]
fn a_broken_off_upload_is_removed() {
    let daemon = Daemon::start(&["--read-timeout-seconds", "1"]);
    let head = "POST /v1/scenes?id=half&name=a.ply HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\nply\n";
    let stream = raw(daemon.address, head.as_bytes());
    eventually("the upload", || !daemon.uploads().is_empty());
    stream.shutdown(Shutdown::Both).unwrap();
    eventually("the removal", || daemon.uploads().is_empty());
    // A silent upload is given up as well, and its id is free again.
    let mut stream = raw(daemon.address, head.as_bytes());
    let answer = super::client::read_to_close(&mut stream);
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    eventually("the removal", || daemon.uploads().is_empty());
    let client = daemon.client();
    let path = "/v1/scenes?id=half&name=a.ply";
    assert_eq!(client.send("POST", path, &[], Some(grid_ply().as_bytes())).status, 201);
}

#[test]
fn a_slow_load_is_answered_before_it_ends() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let wait = [("prefer", "wait=0")];
    let large = wall_ply(400);
    let path = "/v1/scenes?id=slow&name=a.ply";
    let reply = client.send("POST", path, &wait, Some(large.as_bytes()));
    assert_eq!((reply.status, reply.header("location")), (202, Some("/v1/scenes/slow")));
    assert_eq!(reply.json()["state"], "loading");
    assert_eq!(reply.header("preference-applied"), Some("wait=0"));
    eventually("the load", || client.get("/v1/scenes/slow").json()["state"] == "ready");
    // The failure of a load that nobody waited for is reported until the scene is deleted.
    let path = "/v1/scenes?id=bad&name=a.ply";
    assert_eq!(
        client.send("POST", path, &wait, Some(&large.as_bytes()[..large.len() - 9])).status,
        202
    );
    eventually("the failure", || client.get("/v1/scenes/bad").json()["state"] == "failed");
    let problem = &client.get("/v1/scenes/bad").json()["problem"];
    assert!(problem["detail"].as_str().unwrap().contains("a.ply"), "{problem}");
    let frame = client.get("/v1/scenes/bad/frame");
    assert_eq!(frame.status, problem["status"].as_u64().unwrap() as u16);
    assert_eq!(client.send("DELETE", "/v1/scenes/bad", &[], None).status, 204);
    assert_eq!(client.get("/v1/scenes/bad").status, 404);
    assert_eq!(daemon.uploads(), ["slow"]);
}

#[test]
fn an_upload_that_a_full_disk_cuts_is_refused() {
    let with_uploads = |root: &Path| std::fs::create_dir(root.join("uploads")).unwrap();
    let Some((daemon, disk)) = on_small_disk(with_uploads) else { return };
    let client = daemon.client();
    // A page of the disk holds whole lines, so that a file that is cut would be a scene of its own.
    let points = b"1 0 000\n".repeat(1024);
    let upload = || client.send("POST", "/v1/scenes?id=cut&name=cut.xyz", &[], Some(&points));
    let filler = disk.join("filler");
    fill_disk(&filler);
    let file = std::fs::File::options().write(true).open(&filler).unwrap();
    file.set_len(file.metadata().unwrap().len() - 4096).unwrap();
    let refused = upload();
    assert_eq!(refused.status, 507, "{}", refused.text());
    assert_eq!(refused.problem()["type"], "urn:pointillist:problem:storage");
    assert_eq!(client.get("/v1/scenes/cut").status, 404);
    // The space is free when nobody has the file open.
    drop(file);
    std::fs::remove_file(&filler).unwrap();
    let made = upload();
    assert_eq!((made.status, &made.json()["samples"]), (201, &json!(1024)), "{}", made.text());
}
