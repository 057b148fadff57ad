//! Films over a NATS server, drawn by worker processes: the same frames as one process draws, whatever is killed.
//!
//! Skipped with a message if there is no nats-server; `POINTILLIST_NATS_SERVER=required` makes that a failure. `scripts/setup-nats.sh`
//! installs one.

mod troubles;

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::client::Client;
use super::daemon::{Daemon, eventually};
use super::jobs::{create, drawn, ended, job, manifest, name_path, post, when};

/// Returns the NATS server program, if there is one.
fn nats_server() -> Option<PathBuf> {
    let works = |program: &PathBuf| {
        let version = Command::new(program).arg("-v").stdout(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    };
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/nats/usr/sbin/nats-server");
    let known = ["nats-server".into(), "/usr/sbin/nats-server".into(), own];
    let found = known.into_iter().find(works);
    if found.is_none() {
        let required =
            std::env::var("POINTILLIST_NATS_SERVER").is_ok_and(|value| value == "required");
        assert!(!required, "POINTILLIST_NATS_SERVER=required, and there is no nats-server");
        eprintln!("!! SKIPPED: no nats-server; scripts/setup-nats.sh installs one");
    }
    found
}

/// How a NATS server knows its clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Entry {
    Open,
    /// By TLS and a password.
    Password,
    /// By tokens that an account has signed.
    Credentials,
}

/// A NATS server, and the store of a cluster.
struct Cluster {
    program: PathBuf,
    server: Child,
    port: u16,
    folder: tempfile::TempDir,
    entry: Entry,
    /// The store, if it is no folder.
    bucket: Option<Bucket>,
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
        if std::thread::panicking() {
            let log = std::fs::read_to_string(self.folder.path().join("nats.log"));
            eprintln!("log of the NATS server:\n{}", log.unwrap_or_default());
        }
    }
}

fn serve_nats(program: &Path, port: u16, folder: &Path) -> Child {
    let log = File::options().create(true).append(true).open(folder.join("nats.log")).unwrap();
    let server = Command::new(program)
        .args(["-a", "127.0.0.1", "-p", &port.to_string(), "-js", "-sd"])
        .arg(folder.join("nats"))
        .arg("-c")
        .arg(folder.join("nats.conf"))
        .stderr(log)
        .spawn();
    server.unwrap()
}

impl Cluster {
    fn start() -> Option<Cluster> {
        Cluster::start_with(Entry::Open)
    }

    fn start_with(entry: Entry) -> Option<Cluster> {
        let program = nats_server()?;
        let folder = tempfile::tempdir().unwrap();
        let config = if entry == Entry::Password {
            let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
            let [cert, key] = ["nats.pem", "nats.key"].map(|name| folder.path().join(name));
            std::fs::write(&cert, made.cert.pem()).unwrap();
            std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
            format!(
                "tls {{ cert_file: {cert:?}, key_file: {key:?} }}\n\
                 authorization {{ users: [ {{ user: pointillist, password: secret }} ] }}\n"
            )
        } else if entry == Entry::Credentials {
            let (config, credentials) = signed_entry();
            std::fs::write(folder.path().join("user.creds"), credentials).unwrap();
            config
        } else {
            String::new()
        };
        std::fs::write(folder.path().join("nats.conf"), config).unwrap();
        // This port was free a moment ago.
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let server = serve_nats(&program, port, folder.path());
        Some(Cluster { program, server, port, folder, entry, bucket: None })
    }

    fn kill_and_restart_broker(&mut self) {
        self.server.kill().unwrap();
        self.server.wait().unwrap();
        self.server = serve_nats(&self.program, self.port, self.folder.path());
    }

    /// Kills the broker and takes its stream's messages away, but not what its consumers know, as a kill before they are written may do.
    fn kill_and_forget_messages(&mut self) {
        self.server.kill().unwrap();
        self.server.wait().unwrap();
        let streams = self.folder.path().join("nats/jetstream/$G/streams");
        for stream in std::fs::read_dir(streams).unwrap() {
            std::fs::remove_dir_all(stream.unwrap().path().join("msgs")).unwrap();
        }
        self.server = serve_nats(&self.program, self.port, self.folder.path());
    }

    fn store(&self) -> PathBuf {
        self.folder.path().join("store")
    }

    /// The flags of daemons and workers.
    fn flags(&self) -> Vec<String> {
        let port = self.port;
        let path = |path: PathBuf| path.to_str().unwrap().to_owned();
        let store = match &self.bucket {
            Some(_) => Bucket::URL.to_owned(),
            None => path(self.store()),
        };
        let mut flags = vec!["--store".to_owned(), store, "--nats".to_owned()];
        let plain = format!("nats://127.0.0.1:{port}");
        match self.entry {
            Entry::Open => flags.push(plain),
            Entry::Password => {
                let ca = path(self.folder.path().join("nats.pem"));
                let url = format!("tls://pointillist:secret@localhost:{port}");
                flags.extend([url, "--nats-ca".to_owned(), ca]);
            }
            Entry::Credentials => {
                let file = path(self.folder.path().join("user.creds"));
                flags.extend([plain, "--nats-credentials".to_owned(), file]);
            }
        }
        flags
    }

    /// Variables with which daemons and workers reach the store.
    fn environment(&self) -> Vec<(&'static str, &str)> {
        self.bucket.as_ref().map_or_else(Vec::new, Bucket::environment)
    }

    fn daemon(&self) -> Daemon {
        let flags = self.flags();
        let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
        Daemon::start_within(&self.environment(), name_path, &flags)
    }

    fn worker(&self, args: &[&str], environment: &[(&str, &str)]) -> Worker {
        let number = std::fs::read_dir(self.folder.path()).unwrap().count();
        let log = self.folder.path().join(format!("worker-{number}.log"));
        let child = Command::new(env!("CARGO_BIN_EXE_pointillist"))
            .arg("worker")
            .args(self.flags())
            .args(args)
            .env("POINTILLIST_NO_CACHE", "true")
            .env("POINTILLIST_NO_PRIME", "true")
            .env("TMPDIR", self.folder.path())
            .envs(self.environment())
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stderr(File::create(&log).unwrap())
            .spawn()
            .unwrap();
        Worker { child, log }
    }

    /// Files in the store below `films`.
    fn films(&self) -> Vec<PathBuf> {
        let mut folders = vec![self.store().join("films")];
        let mut files = Vec::new();
        while let Some(folder) = folders.pop() {
            for item in std::fs::read_dir(folder).into_iter().flatten().map(|item| item.unwrap()) {
                let list = if item.path().is_dir() { &mut folders } else { &mut files };
                list.push(item.path());
            }
        }
        files
    }
}

/// Returns the configuration of a NATS server that trusts one operator, and a user's file of credentials. The tokens are what
/// `nsc` would write.
fn signed_entry() -> (String, String) {
    use base64::Engine;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    use nkeys::KeyPair;

    let token = |issuer: &KeyPair, subject: &KeyPair, nats: Value| {
        let head = json!({ "typ": "JWT", "alg": "ed25519-nkey" });
        let claims = json!({
            "jti": "test", "iat": 1_700_000_000, "name": "test",
            "iss": issuer.public_key(), "sub": subject.public_key(), "nats": nats,
        });
        let [head, claims] = [head, claims].map(|part| URL_SAFE_NO_PAD.encode(part.to_string()));
        let signature = issuer.sign(format!("{head}.{claims}").as_bytes()).unwrap();
        format!("{head}.{claims}.{}", URL_SAFE_NO_PAD.encode(signature))
    };
    let (operator, user) = (KeyPair::new_operator(), KeyPair::new_user());
    let [account, system] = [(); 2].map(|()| KeyPair::new_account());
    let of_operator = token(&operator, &operator, json!({ "type": "operator", "version": 2 }));
    let limits = json!({
        "subs": -1, "data": -1, "payload": -1, "imports": -1, "exports": -1, "wildcards": true,
        "conn": -1, "leaf": -1, "mem_storage": -1, "disk_storage": -1, "streams": -1, "consumer": -1,
    });
    let [of_account, of_system] =
        [(&account, limits), (&system, json!({}))].map(|(key, limits)| {
            token(&operator, key, json!({ "type": "account", "version": 2, "limits": limits }))
        });
    let of_user = token(
        &account,
        &user,
        json!({ "type": "user", "version": 2, "subs": -1, "data": -1, "payload": -1, "pub": {}, "sub": {} }),
    );
    let config = format!(
        "operator: {of_operator}\nresolver: MEMORY\nsystem_account: {}\n\
         resolver_preload: {{ {}: {of_account}, {}: {of_system} }}\n",
        system.public_key(),
        account.public_key(),
        system.public_key()
    );
    let seed = user.seed().unwrap();
    let credentials = format!(
        "-----BEGIN NATS USER JWT-----\n{of_user}\n------END NATS USER JWT------\n\n\
         -----BEGIN USER NKEY SEED-----\n{seed}\n------END USER NKEY SEED------\n"
    );
    (config, credentials)
}

/// A bucket of an S3-compatible service: that of moto, from Python's package index.
struct Bucket {
    server: Child,
    client: Client,
    endpoint: String,
}

impl Bucket {
    const URL: &str = "s3://films/below/this";

    /// Starts the service and makes the bucket; `None` if the service is not installed.
    fn start() -> Option<Bucket> {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/python/bin/moto_server");
        if !program.exists() {
            let is_required =
                std::env::var("POINTILLIST_PYTHON").is_ok_and(|path| !path.is_empty());
            assert!(!is_required, "there is no {}", program.display());
            eprintln!("!! SKIPPED: no moto_server; scripts/setup-python.sh installs one");
            return None;
        }
        // This port was free a moment ago.
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let port = address.port().to_string();
        let server = Command::new(program)
            .args(["-H", "127.0.0.1", "-p", &port])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let bucket =
            Bucket { server, client: Client::new(address), endpoint: format!("http://{address}") };
        eventually("the service", || std::net::TcpStream::connect(address).is_ok());
        let made = bucket.client.send("PUT", "/films", &[], None);
        assert_eq!(made.status, 200, "{}", made.text());
        Some(bucket)
    }

    fn environment(&self) -> Vec<(&'static str, &str)> {
        vec![
            ("AWS_ENDPOINT", &self.endpoint),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ACCESS_KEY_ID", "id"),
            ("AWS_SECRET_ACCESS_KEY", "secret"),
        ]
    }

    /// Names of the objects.
    fn names(&self) -> Vec<String> {
        let listing = self.client.get("/films?list-type=2").text();
        let keys = listing.split("<Key>").skip(1);
        keys.map(|rest| rest.split_once("</Key>").unwrap().0.to_owned()).collect()
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A worker process.
struct Worker {
    child: Child,
    log: PathBuf,
}

impl Worker {
    fn kill(&mut self) {
        let _ = self.child.kill();
        self.child.wait().unwrap();
    }

    fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Sends SIGTERM and waits for the end.
    fn terminate(&mut self) -> bool {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.success();
            }
            assert!(Instant::now() < until, "the worker does not end:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            eprintln!("log of a worker:\n{}", self.log());
        }
    }
}

/// The manifest of a job that one process has drawn.
fn alone(more: Value) -> Vec<Value> {
    let daemon = Daemon::start_in(name_path, &[]);
    let client = daemon.client();
    let id = create(&client, more);
    ended(&client, &id, "done");
    manifest(&client, &id)
}

/// Frames that take a while.
fn slow() -> Value {
    json!({ "w": 960, "h": 720, "fps": 20 })
}

/// Checks every frame of a finished job against its manifest.
fn check_frames(client: &Client, id: &str, manifest: &[Value]) {
    for record in manifest {
        let frame = client.get(&format!("/v1/jobs/{id}/frames/{}", record["frame"]));
        assert_eq!(frame.status, 200, "{record}");
        assert_eq!(super::jobs::checksum(&frame.body), record["sha256"].as_str().unwrap());
    }
}

#[test]
fn workers_draw_what_one_process_draws() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let mut workers = [(); 3].map(|()| cluster.worker(&[], &[]));
    let id = create(&client, json!({}));
    let done = ended(&client, &id, "done");
    assert_eq!(done["frames"]["done"], super::jobs::FRAMES, "{done}");
    assert_eq!(done["waits_for"], Value::Null);
    let together = manifest(&client, &id);
    assert_eq!(together, alone(json!({})));
    check_frames(&client, &id, &together);
    assert_eq!(client.metric("pointillist_engine_frames_total"), 0.0, "the daemon draws no frame");
    // Nothing of the film is left.
    assert_eq!(cluster.films(), Vec::<PathBuf>::new());
    for worker in &mut workers {
        // A worker bakes what its frames need before it begins the first one.
        assert!(!worker.log().contains("a run failed"), "{}", worker.log());
        assert!(worker.terminate(), "{}", worker.log());
    }
}

#[test]
fn the_store_may_be_a_bucket() {
    let (Some(bucket), Some(mut cluster)) = (Bucket::start(), Cluster::start()) else { return };
    cluster.bucket = Some(bucket);
    let daemon = cluster.daemon();
    let client = daemon.client();
    let mut workers = [(); 2].map(|()| cluster.worker(&[], &[]));
    let id = create(&client, json!({}));
    drawn(&client, &id, 3);
    workers[0].kill();
    ended(&client, &id, "done");
    assert_eq!(manifest(&client, &id), alone(json!({})));
    let names = cluster.bucket.as_ref().unwrap().names();
    let (marks, assets): (Vec<_>, Vec<_>) =
        names.iter().partition(|name| *name == "below/this/pointillist-store");
    let are_assets = assets.iter().all(|name| name.starts_with("below/this/assets/"));
    assert!(are_assets && assets.len() == 2 && marks.len() == 1, "{names:?}");
}

#[test]
fn a_film_survives_kills_of_workers_daemon_and_broker() {
    let Some(mut cluster) = Cluster::start() else { return };
    let expected = alone(slow());
    let mut daemon = cluster.daemon();
    let flags = cluster.flags();
    let mut workers = [(); 2].map(|()| cluster.worker(&[], &[]));
    let id = create(&daemon.client(), slow());
    drawn(&daemon.client(), &id, 3);
    workers[0].kill();
    workers[0] = cluster.worker(&[], &[]);
    drawn(&daemon.client(), &id, 15);
    daemon = daemon.kill_and_restart(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    drawn(&daemon.client(), &id, 25);
    cluster.kill_and_restart_broker();
    drawn(&daemon.client(), &id, 40);
    workers.iter_mut().for_each(Worker::kill);
    workers[1] = cluster.worker(&[], &[]);
    ended(&daemon.client(), &id, "done");
    let together = manifest(&daemon.client(), &id);
    assert_eq!(together, expected);
    check_frames(&daemon.client(), &id, &together);
}

#[test]
fn a_broker_that_skips_runs_is_mended() {
    let Some(mut cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let _worker = cluster.worker(&[], &[]);
    // Runs of this film give the consumer a number up to which all is done.
    let first = create(&client, slow());
    ended(&client, &first, "done");
    cluster.kill_and_forget_messages();
    let id = create(&client, json!({}));
    ended(&client, &id, "done");
    assert_eq!(manifest(&client, &id), alone(json!({})));
    // Newer servers find the wrong number by themselves, and no run is lost. `a_consumer_that_skips_runs_is_recreated` checks the mending on
    // every server.
    let log = daemon.log();
    assert!(log.contains("recreated") || !log.contains("no worker has these runs"), "{log}");
}

#[test]
fn a_frame_that_kills_workers_is_set_aside() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let deadly = [("POINTILLIST_WORKER_DIES_AT", "7")];
    let mut worker = cluster.worker(&[], &deadly);
    let mut deaths = 0;
    let id = create(&client, json!({ "to": 19 }));
    let until = Instant::now() + Duration::from_secs(240);
    let failed = loop {
        let found = job(&client, &id);
        if !["queued", "running"].contains(&found["state"].as_str().unwrap()) {
            break found;
        }
        if worker.has_ended() {
            deaths += 1;
            worker = cluster.worker(&[], &deadly);
        }
        assert!(Instant::now() < until, "{found}\n{}", worker.log());
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!((failed["state"].as_str(), deaths), (Some("failed"), 4), "{failed}");
    let detail = failed["error"]["detail"].as_str().unwrap();
    assert!(detail.starts_with("frame 7 is set aside: it was begun 3 times"), "{detail}");
    // All other frames are there.
    assert_eq!(failed["frames"]["done"], 19, "{failed}");
    // A worker that survives the frame finishes the job.
    worker.kill();
    let _worker = cluster.worker(&[], &[]);
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    ended(&client, &id, "done");
    assert_eq!(manifest(&client, &id), alone(json!({ "to": 19 })));
}

#[test]
fn workers_of_another_kind_draw_nothing() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let id = create(&client, json!({}));
    let says =
        |job: &Value, what: &str| job["waits_for"].as_str().is_some_and(|text| text.contains(what));
    when(&client, &id, "a word about workers", |job| says(job, "there are no workers"));
    let _other = cluster.worker(&["--force-32-bit"], &[]);
    let waiting = when(&client, &id, "a word about others", |job| says(job, "only others: 1 with"));
    assert_eq!((&waiting["state"], &waiting["frames"]["done"]), (&json!("running"), &json!(0)));
    let _right = cluster.worker(&[], &[]);
    let done = ended(&client, &id, "done");
    assert_eq!(done["waits_for"], Value::Null);
}

#[test]
fn a_cancelled_film_leaves_queue_and_store() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let _worker = cluster.worker(&[], &[]);
    let id = create(&client, slow());
    drawn(&client, &id, 2);
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/cancel")).status, 200);
    // The queue is free for another film, and the first one leaves nothing but what was being drawn.
    let other = create(&client, json!({ "to": 9 }));
    ended(&client, &other, "done");
    ended(&client, &id, "cancelled");
    eventually("an empty store", || cluster.films().is_empty());
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    ended(&client, &id, "done");
    assert_eq!(manifest(&client, &id), alone(slow()));
}

#[test]
fn a_patched_scene_is_drawn_by_the_daemon() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let patch = json!({ "translate": [0.5, 0, 0] });
    let patched = client.send(
        "PATCH",
        "/v1/scenes/grid/nodes/wall",
        &[("content-type", "application/json")],
        Some(patch.to_string().as_bytes()),
    );
    assert_eq!(patched.status, 200, "{}", patched.text());
    // There are no workers.
    let id = create(&client, json!({ "to": 3 }));
    ended(&client, &id, "done");
}

#[test]
fn a_broker_may_ask_for_credentials() {
    let Some(cluster) = Cluster::start_with(Entry::Credentials) else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let _worker = cluster.worker(&[], &[]);
    let id = create(&client, json!({ "to": 19 }));
    ended(&client, &id, "done");
    // The server lets nobody else in.
    let without = Command::new(env!("CARGO_BIN_EXE_pointillist"))
        .args(["worker", "--nats", &format!("nats://127.0.0.1:{}", cluster.port)])
        .args(["--store", cluster.store().to_str().unwrap(), "--no-prime", "--no-cache"])
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut without = Worker { child: without, log: PathBuf::new() };
    let lines = std::io::BufReader::new(without.child.stderr.take().unwrap());
    let refused = std::io::BufRead::lines(lines).map_while(Result::ok);
    assert!(refused.map(|line| line.to_lowercase()).any(|line| line.contains("authorization")));
}

#[test]
fn a_broker_may_ask_for_tls_and_a_password() {
    let Some(cluster) = Cluster::start_with(Entry::Password) else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let _worker = cluster.worker(&[], &[]);
    let id = create(&client, json!({ "to": 19 }));
    ended(&client, &id, "done");
    // The counts are absent until the daemon has an answer.
    let is_zero = |metrics: &str, state: &str| {
        metrics.contains(&format!("pointillist_worker_runs{{state=\"{state}\"}} 0"))
    };
    eventually("an empty queue", || {
        let metrics = client.get("/metrics").text();
        is_zero(&metrics, "pending") && is_zero(&metrics, "drawing")
    });
    eventually("a worker", || client.metric("pointillist_workers{kind=\"this\"}") == 1.0);
    assert_eq!(client.metric("pointillist_workers{kind=\"another\"}"), 0.0);
    assert_eq!(client.metric("pointillist_frames_set_aside_total"), 0.0);
}
