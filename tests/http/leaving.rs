//! Signals, the delay before a drain, and the claim on a root.

use std::process::Command;

use sha2::{Digest, Sha256};

use super::daemon::{Daemon, eventually};

fn signal(daemon: &Daemon, name: &str) {
    let id = daemon.id().to_string();
    assert!(Command::new("kill").args([name, &id]).status().unwrap().success());
}

fn key_line(name: &str, key: &str) -> String {
    let hash: String = Sha256::digest(key).iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{name} read {hash}\n")
}

const FRAME: &str = "/v1/scenes/grid/frame?w=32&h=32";

#[test]
fn a_server_that_will_drain_serves_on_but_is_not_ready() {
    let mut daemon = Daemon::start(&["--drain-delay", "600"]);
    let client = daemon.client();
    assert_eq!(client.get("/readyz").status, 200);
    daemon.signal();
    eventually("unreadiness", || client.get("/readyz").status == 503);
    assert!(client.get("/readyz").text().contains("draining"));
    assert_eq!(client.get("/healthz").status, 200);
    // New connections are accepted as well.
    assert_eq!(daemon.client().get(FRAME).status, 200);
    let job = serde_json::json!({"scene": "grid", "path": "past", "w": 16, "h": 16});
    assert_eq!(daemon.client().post_json("/v1/jobs", &job).status, 201);
    // A second signal ends the daemon at once.
    daemon.signal();
    assert_eq!(daemon.wait().code(), Some(0), "{}", daemon.log());
    assert!(std::net::TcpStream::connect(daemon.address).is_err());
}

#[test]
fn the_delay_ends_by_itself_and_is_not_for_an_interrupt() {
    let mut daemon = Daemon::start(&["--drain-delay", "1"]);
    assert!(daemon.terminate().success());
    assert!(daemon.log().contains("drained"), "{}", daemon.log());
    let mut daemon = Daemon::start(&["--drain-delay", "600"]);
    signal(&daemon, "-INT");
    assert!(daemon.wait().success());
}

#[test]
fn sighup_reads_the_keys_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keys");
    std::fs::write(&file, key_line("old", "first")).unwrap();
    let daemon = Daemon::start(&["--api-keys", file.to_str().unwrap()]);
    let client = daemon.client();
    let status = |key: &str| {
        let header = format!("Bearer {key}");
        client.send("GET", "/v1/scenes", &[("Authorization", &header)], None).status
    };
    assert_eq!((status("first"), status("second")), (200, 401));
    std::fs::write(&file, key_line("new", "second")).unwrap();
    signal(&daemon, "-HUP");
    eventually("new keys", || status("second") == 200);
    assert_eq!(status("first"), 401);
    // If the file cannot be read, the keys in force stay.
    std::fs::write(&file, "nonsense\n").unwrap();
    signal(&daemon, "-HUP");
    eventually("a complaint", || daemon.log().contains("line 1"));
    assert_eq!(status("second"), 200);
}

#[test]
fn a_hangup_without_keys_ends_nothing() {
    let daemon = Daemon::start(&[]);
    signal(&daemon, "-HUP");
    eventually("a line", || {
        daemon.log().contains("no API keys, certificates or settings file to read again")
    });
    assert_eq!(daemon.client().get(FRAME).status, 200);
}

#[test]
fn uploads_of_a_root_are_one_daemons() {
    let daemon = Daemon::start(&[]);
    let root = daemon.root();
    std::fs::create_dir_all(root.join("uploads/.partial-9-9")).unwrap();
    let serve = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--root"]).arg(&root).args(args);
        command.env("POINTILLIST_NO_JOBS", "true").env("POINTILLIST_NO_PRIME", "true");
        command.output().unwrap()
    };
    let refused = serve(&[]);
    let told = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(1), "{told}");
    for expected in [&format!("process {} (pointillist)", daemon.id()), "--root", "--no-uploads"] {
        assert!(told.contains(expected), "{expected}: {told}");
    }
    // A daemon without uploads may share the root, and does not clean it up.
    let link = |own: &std::path::Path| {
        std::fs::remove_dir_all(own).unwrap();
        std::os::unix::fs::symlink(&root, own).unwrap();
    };
    let second = Daemon::start_in(link, &["--no-uploads"]);
    let body = std::fs::read(root.join("grid.ply")).unwrap();
    let reply = second.client().send("POST", "/v1/scenes?name=a.ply", &[], Some(&body));
    assert_eq!(reply.status, 503);
    assert_eq!(reply.problem()["type"], "urn:pointillist:problem:uploads-off");
    assert_eq!(second.client().get(FRAME).status, 200);
    assert!(root.join("uploads/.partial-9-9").is_dir(), "another daemon's upload");
    // A killed daemon releases its claim.
    drop(second);
    let daemon = daemon.kill_and_restart(&[]);
    assert!(daemon.uploads().is_empty(), "remains of an earlier run");
}
