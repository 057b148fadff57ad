//! Keys with limits, rates, trusted proxies, TLS, logs, and sockets that are passed on.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use sha2::{Digest, Sha256};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};

use super::client::{Client, Reply, raw, read_to_close};
use super::daemon::{Daemon, eventually, grid_ply};
use super::stream::{Came, Stream};

const FRAME: &str = "/v1/scenes/grid/frame?w=64&h=64";

/// A table of a key file, for the key that is spelt as its id.
pub fn table(id: &str, scope: &str, more: &str) -> String {
    let hex: String =
        Sha256::digest(id.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
    format!("[[key]]\nid = \"{id}\"\nscope = \"{scope}\"\nhash = \"{hex}\"\n{more}\n")
}

/// Writes a key file into a folder.
pub fn key_file(folder: &Path, tables: &[String]) -> PathBuf {
    let path = folder.join("keys.toml");
    std::fs::write(&path, tables.concat()).unwrap();
    path
}

pub fn send(client: &Client, key: &str, method: &str, path: &str, body: Option<&[u8]>) -> Reply {
    let bearer = format!("Bearer {key}");
    let headers = [("authorization", bearer.as_str()), ("content-type", "application/json")];
    client.send(method, path, &headers, body)
}

pub fn hang_up(id: u32) {
    assert!(Command::new("kill").args(["-HUP", &id.to_string()]).status().unwrap().success());
}

#[test]
fn scenes_belong_to_the_key_that_uploaded_them() {
    let folder = tempfile::tempdir().unwrap();
    let tables = [
        table("ann", "write", "scenes = 1"),
        table("bob", "write", ""),
        table("root", "admin", ""),
    ];
    let keys = key_file(folder.path(), &tables);
    let audit = folder.path().join("audit.log");
    let args = ["--api-keys", keys.to_str().unwrap(), "--audit-log", audit.to_str().unwrap()];
    let daemon = Daemon::start(&args);
    let client = daemon.client();
    let ply = grid_ply();
    let upload = |key: &str, id: &str| {
        let path = format!("/v1/scenes?id={id}&name=a.ply");
        send(&client, key, "POST", &path, Some(ply.as_bytes()))
    };
    assert_eq!(upload("ann", "hers").status, 201);
    let refused = upload("ann", "more");
    assert_eq!(refused.status, 429, "{}", refused.text());
    assert_eq!(upload("bob", "his").status, 201);
    let hide = Some(&br#"{"visible": false}"#[..]);
    let status = |key: &str, method: &str, path: &str| {
        send(&client, key, method, path, hide.filter(|_| method == "PATCH")).status
    };
    let node = "/v1/scenes/grid/nodes/wall";
    assert_eq!((status("ann", "PATCH", node), status("root", "PATCH", node)), (403, 200));
    assert_eq!(status("bob", "DELETE", "/v1/scenes/hers"), 403);
    assert_eq!(status("bob", "POST", "/v1/scenes/hers/retry"), 403);
    assert_eq!(status("bob", "DELETE", "/v1/scenes/grid"), 403);
    assert_eq!(status("bob", "DELETE", "/v1/scenes/none"), 404);
    assert_eq!(status("ann", "DELETE", "/v1/scenes/hers"), 204);
    // Who owns a scene is known after a restart.
    let daemon = daemon.restart(&args);
    let client = daemon.client();
    let remove = |key: &str| send(&client, key, "DELETE", "/v1/scenes/his", None).status;
    assert_eq!((remove("ann"), remove("root")), (403, 204));
    let status = |key: &str, path: &str| send(&client, key, "GET", path, None).status;
    assert_eq!((status("guess", "/v1/scenes"), client.get("/v1/scenes").status), (401, 401));
    let of = |method: &str, event: &str, key: &str, target: &str| {
        lines(&audit).iter().any(|line| {
            line["method"] == method
                && line["event"] == event
                && line["key"] == key
                && line["target"] == target
        })
    };
    eventually("the lines of changes", || {
        of("POST", "change", "ann", "hers")
            && of("DELETE", "change", "ann", "hers")
            && of("DELETE", "change", "root", "his")
    });
    assert!(of("DELETE", "refused", "bob", "hers"));
    // A request without a key is no refused key.
    let all = lines(&audit);
    assert_eq!(all.iter().filter(|line| line["status"] == 401).count(), 1, "{all:?}");
}

/// Reads a log.
fn lines(path: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(path).unwrap();
    // The last line may not be whole yet.
    text.split_inclusive('\n').filter_map(|line| serde_json::from_str(line).ok()).collect()
}

#[test]
fn keys_expire_and_have_limits() {
    let folder = tempfile::tempdir().unwrap();
    let tables = [
        table("old", "read", "expires = 2001-01-01"),
        table("slow", "read", "requests-per-second = 0.25"),
        table("poor", "read", "device-ms-per-minute = 1"),
        table("free", "read", ""),
    ];
    let keys = key_file(folder.path(), &tables);
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let get = |key: &str, path: &str| send(&client, key, "GET", path, None);
    let expired = get("old", "/v1/scenes");
    assert!(expired.status == 401 && expired.text().contains("expired"));
    assert_eq!(get("slow", "/v1/scenes").status, 200);
    let refused = get("slow", "/v1/scenes");
    assert_eq!(refused.problem()["type"], "urn:pointillist:problem:too-many-requests");
    let wait: u64 = refused.header("retry-after").unwrap().parse().unwrap();
    assert!((1..=4).contains(&wait), "{wait}");
    // A frame of many pixels costs more than a millisecond; the next one has to wait.
    let big = "/v1/scenes/grid/frame?w=1024&h=1024";
    let first = get("poor", big);
    assert_eq!(first.status, 200);
    assert!(first.receipt()["gpu_ns"].as_u64().unwrap() > 1_000_000, "{}", first.receipt());
    let refused = get("poor", FRAME);
    assert_eq!(refused.problem()["type"], "urn:pointillist:problem:device-quota");
    assert_eq!(refused.status, 429);
    // A frame that the client has costs no time. Any other does.
    let (own, tree) = (first.header("etag").unwrap(), format!("{big}&lod=spt&color_by=levels"));
    for (path, tag, status) in [(big, own, 304), (big, "\"another\"", 429), (&tree, own, 429)] {
        let headers = [("authorization", "Bearer poor"), ("if-none-match", tag)];
        assert_eq!(client.send("GET", path, &headers, None).status, status);
    }
    assert!(!daemon.log().contains("point trees ready"), "work for who owes time");
    assert_eq!(get("poor", "/v1/scenes").status, 200, "requests that draw nothing");
    assert_eq!(get("free", FRAME).status, 200);
    // A file with a fault changes nothing, and the log names line and key.
    std::fs::write(&keys, table("free", "raed", "")).unwrap();
    hang_up(daemon.id());
    eventually("a complaint", || daemon.log().contains("line 3: key `free`"));
    assert_eq!(get("free", "/v1/scenes").status, 200);
    // A limit that is taken away is gone at once.
    std::fs::write(&keys, table("slow", "read", "")).unwrap();
    hang_up(daemon.id());
    eventually("new keys", || get("free", "/v1/scenes").status == 401);
    let told = "API keys read again: slow changed, old removed, poor removed, free removed";
    eventually("what has changed", || daemon.log().lines().any(|line| line.ends_with(told)));
    assert!((0..5).all(|_| get("slow", "/v1/scenes").status == 200));
}

/// Frames that the engine has drawn.
fn drawn(client: &Client, key: &str) -> usize {
    let text = send(client, key, "GET", "/metrics", None).text();
    let line = text.lines().find(|line| line.starts_with("pointillist_engine_frames_total "));
    line.unwrap().split(' ').next_back().unwrap().parse().unwrap()
}

#[test]
fn gpu_time_is_charged_for_what_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let poor = |more: &str| [table("poor", "read", more), table("free", "read", "")];
    let keys = key_file(folder.path(), &poor("device-ms-per-minute = 1"));
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap(), "--max-batch", "1"]);
    let client = daemon.client();
    // Asking for the head of a frame draws nothing, and costs nothing.
    let is_spent = || send(&client, "poor", "HEAD", FRAME, None).status == 429;
    assert!(!is_spent());
    let big = "GET /v1/scenes/grid/frame?w=2048&h=2048 HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer poor\r\n\r\n";
    eventually("the charge for a frame whose client has gone", || {
        let connection = raw(daemon.address, big.as_bytes());
        // The frame is under way once the engine has been asked for something else.
        assert_eq!(send(&client, "free", "GET", FRAME, None).status, 200);
        drop(connection);
        is_spent()
    });
    // A new file of keys gives the key more time, and one request may not use more than that.
    std::fs::write(&keys, poor("device-ms-per-minute = 2").concat()).unwrap();
    hang_up(daemon.id());
    let limit = |key: &str| {
        let limits = send(&client, key, "GET", "/v1/limits", None).json();
        limits["key"]["max_device_ms_per_minute"].as_u64()
    };
    eventually("the new limit", || limit("poor") == Some(2));
    assert_eq!(limit("free"), None);
    std::fs::write(&keys, poor("").concat()).unwrap();
    hang_up(daemon.id());
    eventually("no limit", || !is_spent());
    std::fs::write(&keys, poor("device-ms-per-minute = 3").concat()).unwrap();
    hang_up(daemon.id());
    eventually("a limit again", || limit("poor") == Some(3));
    let poses: Vec<serde_json::Value> =
        (0..60).map(|n| serde_json::json!({"w": 256, "h": 256 + n})).collect();
    let many = serde_json::json!({ "poses": poses }).to_string();
    let before = drawn(&client, "free");
    let reply = std::thread::scope(|scope| {
        let asked =
            || send(&client, "poor", "POST", "/v1/scenes/grid/frames", Some(many.as_bytes()));
        let asked = scope.spawn(asked);
        eventually("the end of its time", is_spent);
        // While others get their frames, the request waits for time.
        for height in 1..=30 {
            let path = format!("/v1/scenes/grid/frame?w=256&h={height}");
            assert_eq!(send(&client, "free", "GET", &path, None).status, 200);
        }
        let others = drawn(&client, "free") - before - 30;
        assert!(others < 20, "{others} frames were drawn without time");
        std::fs::write(&keys, poor("").concat()).unwrap();
        hang_up(daemon.id());
        asked.join().unwrap()
    });
    assert_eq!(reply.status, 200);
    assert_eq!(reply.text().matches("content-type: image/png").count(), 60);
    // A key that is removed gets no more poses.
    std::fs::write(&keys, poor("device-ms-per-minute = 1").concat()).unwrap();
    hang_up(daemon.id());
    eventually("a limit once more", || limit("poor") == Some(1));
    let reply = std::thread::scope(|scope| {
        let asked =
            || send(&client, "poor", "POST", "/v1/scenes/grid/frames", Some(many.as_bytes()));
        let asked = scope.spawn(asked);
        eventually("the end of its time", is_spent);
        std::fs::write(&keys, table("free", "read", "")).unwrap();
        hang_up(daemon.id());
        asked.join().unwrap().text()
    });
    assert!(reply.contains("urn:pointillist:problem:unauthorized"), "{reply}");
    assert!(reply.matches("content-type: image/png").count() < 60);
}

#[test]
fn wrong_keys_are_throttled_and_logged() {
    let folder = tempfile::tempdir().unwrap();
    let keys = key_file(folder.path(), &[table("eye", "read", "")]);
    let access = folder.path().join("access.log");
    let args = [
        "--api-keys",
        keys.to_str().unwrap(),
        "--access-log",
        access.to_str().unwrap(),
        "--trusted-proxies",
        "127.0.0.0/8",
    ];
    let daemon = Daemon::start(&args);
    let client = daemon.client();
    let from = |address: &str, key: &str| {
        let bearer = format!("Bearer {key}");
        let headers = [("authorization", bearer.as_str()), ("x-forwarded-for", address)];
        client.send("GET", FRAME, &headers, None)
    };
    let statuses: Vec<u16> = (0..25).map(|_| from("192.0.2.1", "a-guess").status).collect();
    assert!(statuses[..20].iter().all(|status| *status == 401), "{statuses:?}");
    let refused = from("192.0.2.1", "a-guess");
    assert_eq!(refused.status, 429);
    assert!(refused.header("retry-after").is_some());
    assert_eq!(from("192.0.2.1", "eye").status, 200, "who shares the address is not locked out");
    assert_eq!(from("192.0.2.2", "eye").status, 200);
    let log = daemon.log();
    assert!(log.contains("wrong API key") && log.contains("192.0.2.1"), "{log}");
    // The line is written when the answer has been sent.
    let logged = || std::fs::read_to_string(&access).unwrap();
    eventually("a line", || logged().contains("\"key\":\"eye\",\"address\":\"192.0.2.2\""));
    let text = logged();
    let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert_eq!((&last["key"], &last["status"]), (&"eye".into(), &200.into()), "{last}");
    assert_eq!((&last["address"], &last["target"]), (&"192.0.2.2".into(), &"grid".into()));
    assert!(last["bytes"].as_u64().unwrap() > 100 && last["device_ms"].is_number(), "{last}");
    assert!(!text.contains("a-guess") && !log.contains("a-guess"), "no secrets in logs");
}

#[test]
fn addresses_have_rates_and_connections() {
    let limits = ["--requests-per-second-per-address", "0.1", "--max-connections-per-address", "2"];
    let daemon = Daemon::start(&limits);
    let status = |daemon: &Daemon, address: &str| {
        let forwarded = [("x-forwarded-for", address)];
        daemon.client().send("GET", "/v1/scenes", &forwarded, None).status
    };
    assert_eq!((status(&daemon, "192.0.2.1"), status(&daemon, "192.0.2.2")), (200, 429));
    let request = b"GET /v1/limits HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    eventually("a refusal", || {
        // They are opened each time: while the connections before are being closed, they may be refused themselves.
        let _held = [raw(daemon.address, b""), raw(daemon.address, b"")];
        read_to_close(&mut raw(daemon.address, request)).starts_with("HTTP/1.1 503 ")
    });
    let behind_proxy = [&limits[..], &["--trusted-proxies", "127.0.0.1,::1"]].concat();
    let daemon = daemon.restart(&behind_proxy);
    assert_eq!((status(&daemon, "192.0.2.1"), status(&daemon, "192.0.2.2")), (200, 200));
    assert_eq!(status(&daemon, "192.0.2.9, 192.0.2.1"), 429, "the rightmost address counts");
    let held: Vec<TcpStream> = (0..4).map(|_| raw(daemon.address, b"")).collect();
    assert_eq!(daemon.client().get("/healthz").status, 200, "proxies have no such limit");
    drop(held);
}

#[test]
fn metrics_move_to_a_listener_of_their_own() {
    // This port was free a moment ago.
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let daemon = Daemon::start(&["--metrics-listen", &address.to_string()]);
    let moved = daemon.client().get("/metrics");
    assert_eq!(moved.status, 404);
    let accepted = moved.problem()["accepted"].to_string();
    assert!(!accepted.contains("/metrics"), "what is not there is not suggested: {accepted}");
    let client = Client::new(address);
    assert!(client.get("/metrics").text().contains("pointillist_http_requests_total"));
    assert_eq!((client.get("/healthz").status, client.get("/readyz").status), (200, 200));
    let missing = client.get("/v1/scenes").problem();
    assert_eq!(missing["status"], 404);
    assert_eq!(missing["accepted"], "/metrics, /healthz or /readyz");
    assert_eq!(client.send("POST", "/metrics", &[], None).problem()["status"], 405);
    let foreign = client.send("GET", "/metrics", &[("host", "evil.example")], None).problem();
    assert_eq!(foreign["status"], 421, "a page whose name resolves to loopback reads nothing");
    assert!(foreign["detail"].to_string().contains("that asks for no key"), "{foreign}");
}

/// Writes a new certificate for `localhost` and its key.
fn certify(folder: &Path) -> CertificateDer<'static> {
    let pair = rcgen::KeyPair::generate().unwrap();
    let params = rcgen::CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    let pem = params.self_signed(&pair).unwrap().pem();
    std::fs::write(folder.join("tls.crt"), &pem).unwrap();
    std::fs::write(folder.join("tls.key"), pair.serialize_pem()).unwrap();
    CertificateDer::from_pem_slice(pem.as_bytes()).unwrap()
}

type Secured = StreamOwned<ClientConnection, TcpStream>;

/// Connects with trust in one certificate.
fn secured(address: SocketAddr, trusted: &CertificateDer<'static>) -> Secured {
    let mut roots = RootCertStore::empty();
    roots.add(trusted.clone()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").unwrap();
    let connection = ClientConnection::new(Arc::new(config), name).unwrap();
    StreamOwned::new(connection, raw(address, b""))
}

/// Sends a request and reads the beginning of the answer.
fn healthy(stream: &mut Secured) -> std::io::Result<bool> {
    stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")?;
    let mut answer = Vec::new();
    while !answer.ends_with(b"ok\n") {
        let mut buffer = [0; 1024];
        match stream.read(&mut buffer)? {
            0 => return Ok(false),
            count => answer.extend_from_slice(&buffer[..count]),
        }
    }
    Ok(answer.starts_with(b"HTTP/1.1 200 "))
}

#[test]
fn tls_certificates_are_exchanged_without_dropping_connections() {
    let folder = tempfile::tempdir().unwrap();
    let first = certify(folder.path());
    let [cert, key] = ["tls.crt", "tls.key"].map(|name| folder.path().join(name));
    let audit = folder.path().join("audit.log");
    let daemon = Daemon::start(&[
        "--tls-cert",
        cert.to_str().unwrap(),
        "--tls-key",
        key.to_str().unwrap(),
        "--audit-log",
        audit.to_str().unwrap(),
    ]);
    let mut open = secured(daemon.address, &first);
    assert!(healthy(&mut open).unwrap());
    let second = certify(folder.path());
    assert!(healthy(&mut secured(daemon.address, &second)).is_err(), "not in force yet");
    hang_up(daemon.id());
    eventually("the new certificate", || {
        healthy(&mut secured(daemon.address, &second)).unwrap_or(false)
    });
    assert!(healthy(&mut secured(daemon.address, &first)).is_err());
    assert!(healthy(&mut open).unwrap(), "an open connection stays");
    // A pair that does not fit is refused, and the one in force stays.
    std::fs::write(&key, rcgen::KeyPair::generate().unwrap().serialize_pem()).unwrap();
    hang_up(daemon.id());
    eventually("a complaint", || daemon.log().contains("cannot be used with"));
    assert!(healthy(&mut secured(daemon.address, &second)).unwrap());
    let has = |event: &str| lines(&audit).iter().any(|line| line["event"] == event);
    eventually("lines of both reloads", || has("reload") && has("reload-refused"));
    // Plain HTTP is not understood, and takes nothing down.
    let plain = read_to_close(&mut raw(daemon.address, b"GET / HTTP/1.1\r\n\r\n"));
    assert!(!plain.starts_with("HTTP/1.1 200"), "{plain}");
    assert!(healthy(&mut open).unwrap());
}

/// Starts a daemon on a socket that it inherits, as systemd starts it.
fn inherit(listener: &TcpListener, folder: &Path) -> Child {
    let script = "export LISTEN_FDS=1 LISTEN_PID=$$; exec 3<&0 </dev/null; exec \"$0\" \"$@\"";
    Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_pointillist"), "serve", "--root"])
        .arg(folder)
        .env("POINTILLIST_STATE", folder.join("state"))
        .env("POINTILLIST_NO_CACHE", "true")
        .env("POINTILLIST_NO_PRIME", "true")
        .env_remove("POINTILLIST_CONFIG")
        .env("POINTILLIST_TAKEOVER_SECONDS", "60")
        .stdin(Stdio::from(std::os::fd::OwnedFd::from(listener.try_clone().unwrap())))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn a_passed_socket_outlives_the_server() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.ply"), grid_ply()).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let ask = || {
        let request = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        raw(address, request)
    };
    let answered = |mut stream: TcpStream| read_to_close(&mut stream).ends_with("ok\n");
    let mut first = inherit(&listener, folder.path());
    assert!(answered(ask()), "the first server");
    // The second server starts while the first one still runs and drains.
    let mut second = inherit(&listener, folder.path());
    let stopped = Command::new("kill").args(["-TERM", &first.id().to_string()]).status().unwrap();
    assert!(stopped.success() && first.wait().unwrap().success());
    let waiting = [ask(), ask(), ask()];
    assert!(waiting.into_iter().all(answered), "connections wait for the second server");
    second.kill().unwrap();
    second.wait().unwrap();
}

/// Copies a folder with everything in it.
fn copy(from: &Path, to: &Path) {
    assert!(Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap().success());
}

#[test]
fn a_backup_of_root_and_state_is_restored_elsewhere() {
    let mut daemon = Daemon::start(&[]);
    let client = daemon.client();
    let reply =
        client.send("POST", "/v1/scenes?id=kept&name=a.ply", &[], Some(grid_ply().as_bytes()));
    assert_eq!(reply.status, 201);
    let job = serde_json::json!({
        "scene": "grid", "path": "past", "w": 32, "h": 32, "format": "png", "to": 2
    });
    let reply = client.post_json("/v1/jobs", &job);
    assert_eq!(reply.status, 201, "{}", reply.text());
    eventually("the job's end", || client.get("/v1/jobs/1").json()["state"] == "done");
    let frame = client.get("/v1/jobs/1/frames/0").body;
    assert!(daemon.terminate().success());
    let restored = Daemon::start_in(
        |root| {
            copy(&daemon.root().join("uploads"), root);
            copy(&daemon.state(), root.parent().unwrap());
        },
        &[],
    );
    let client = restored.client();
    assert_eq!(client.get("/v1/scenes/kept").json()["state"], "ready");
    assert_eq!(client.get("/v1/jobs/1").json()["state"], "done");
    assert_eq!(client.get("/v1/jobs/1/frames/0").body, frame);
}

/// Signs an address with the program.
fn sign(secret: &Path, address: &str, more: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
    command.args(["sign", address, "--key", "ann", "--secret"]).arg(secret).args(more);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn signed_addresses_work_without_a_key() {
    let folder = tempfile::tempdir().unwrap();
    let secret = folder.path().join("secret");
    let hex = "0123456789abcdef".repeat(4);
    std::fs::write(&secret, format!("{hex}\n")).unwrap();
    let quota = "requests-per-second = 100";
    let tables = |secret: &str| [table("ann", "write", &format!("{secret}{quota}"))];
    let with_secret = format!("url-secret = \"{hex}\"\n");
    let keys = key_file(folder.path(), &tables(&with_secret));
    let daemon = Daemon::start(&["--api-keys", keys.to_str().unwrap()]);
    let client = daemon.client();
    let hour = ["--expires", "1h"];
    let closed = sign(&secret, FRAME, &hour);
    let by_key = send(&client, "ann", "GET", FRAME, None);
    let by_address = client.get(&closed);
    assert_eq!((by_address.status, &by_address.body), (200, &by_key.body));
    assert_eq!(by_address.header("etag"), by_key.header("etag"));
    for (changed, status) in [
        (closed.replace("w=64", "w=65"), 401),
        (closed.replace("grid", "grie"), 401),
        (format!("{closed}&fov=30"), 401),
        (closed.replace("/frame", "/pick"), 401),
    ] {
        assert_eq!(client.get(&changed).status, status, "{changed}");
    }
    let scene = sign(&secret, "/v1/scenes/grid", &hour);
    assert_eq!(client.get(&scene).status, 200);
    assert_eq!(client.send("DELETE", &scene, &[], None).status, 403);
    // Limits of a frame hold whatever is added.
    let open = [&hour[..], &["--open", "--max-pixels", "4096"]].concat();
    let open = sign(&secret, "/v1/scenes/grid/frame", &open);
    let status = |size: &str| client.get(&format!("{open}&{size}")).status;
    assert_eq!((status("w=64&h=64"), status("w=64&h=65")), (200, 422));
    let dear = ["--max-device-ms", "1"];
    let dear = sign(&secret, "/v1/scenes/grid/frame?w=2048&h=2048", &[&hour[..], &dear].concat());
    // The estimate follows what such frames took.
    eventually("a frame that is too dear", || client.get(&dear).status == 422);
    // Streams take poses, so that their address must be open.
    let stream = |more: &[&str]| {
        let address = sign(&secret, "/v1/scenes/grid/stream", &[&hour[..], more].concat());
        Stream::connect(daemon.address, &address, &[])
    };
    assert_eq!(stream(&[]).err(), Some(403));
    let mut stream = stream(&["--open", "--max-pixels", "4096"]).ok().unwrap();
    stream.patience(std::time::Duration::from_secs(60));
    let pose = |seq: u32, side: u32| serde_json::json!({"seq": seq, "camera": "front", "w": side, "h": side});
    stream.send(pose(1, 65));
    let problem = loop {
        match stream.next() {
            Came::Event(event) if event["event"] == "problem" => break event,
            Came::Event(_) => {}
            // Frames are smaller while the pose moves.
            Came::Frame { header, .. } => stream.send(serde_json::json!({"ack": header["frame"]})),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(problem["type"], "urn:pointillist:problem:over-limit", "{problem}");
    stream.send(pose(2, 64));
    while !matches!(stream.next(), Came::Frame { .. }) {}
    // An address ends with its secret.
    std::fs::write(&keys, tables("").concat()).unwrap();
    hang_up(daemon.id());
    eventually("the end of the secret", || client.get(&closed).status == 401);
}

#[test]
fn a_hangup_puts_new_limits_in_force() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pointillist.toml");
    let write = |text: &str| std::fs::write(&file, text).unwrap();
    write("max-streams = 7\nmax-uploads = 1\nmax-batch = 3\n");
    // A flag wins over the file, before and after.
    let args = ["--config", file.to_str().unwrap(), "--max-watchers", "9"];
    let daemon = Daemon::start(&args);
    let client = daemon.client();
    let limits = || {
        let limits = client.get("/v1/limits").json();
        let of = |name: &str| limits[name].as_u64().unwrap();
        (of("max_streams"), limits["uploads"]["max_scenes"].as_u64().unwrap())
    };
    assert_eq!(limits(), (7, 1));
    let ply = grid_ply();
    let upload = |id: &str| {
        let path = format!("/v1/scenes?id={id}&name=a.ply");
        client.send("POST", &path, &[], Some(ply.as_bytes())).status
    };
    assert_eq!((upload("one"), upload("two")), (201, 429));
    write(
        "max-streams = 2\nmax-uploads = 2\nmax-watchers = 1\nmax-batch = 4\nmax-connections-per-address = 100\n",
    );
    hang_up(daemon.id());
    eventually("new limits", || limits() == (2, 2));
    // The flag wins over the file's watchers, so these have not changed.
    let told = "limits read again: max-connections-per-address its default to 100, \
        max-streams 7 to 2, max-uploads 1 to 2";
    eventually("what has changed", || daemon.log().lines().any(|line| line.ends_with(told)));
    assert_eq!((upload("two"), upload("three")), (201, 429));
    let watchers = client.get("/v1/limits").json()["jobs"]["max_watchers"].clone();
    assert!(watchers.is_null() || watchers == 9, "{watchers}");
    // What a reload cannot change is named.
    eventually("a word about the batches", || {
        daemon.log().lines().any(|line| line.contains("max-batch has changed"))
    });
    // A file that cannot be used changes nothing.
    write("max-streams = -1\n");
    hang_up(daemon.id());
    eventually("a complaint", || daemon.log().contains("the limits in force stay"));
    assert_eq!(limits(), (2, 2));
    // A rate holds from the next request on.
    write("requests-per-second-per-address = 0.5\n");
    hang_up(daemon.id());
    eventually("a refusal", || client.get("/v1/limits").status == 429);
    assert_eq!(client.get("/healthz").status, 200);
}
