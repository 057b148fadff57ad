//! Films while a worker is early or sick, the NATS server hangs, or the daemon ends at a bad moment.

use async_nats::jetstream::consumer::{AckPolicy, pull};
use pointillist::farm::Address;
use pointillist::farm::broker::{self, Broker};
use pointillist::farm::messages::{Run, STREAM};
use pointillist::film::Wanted;

use super::*;

/// Logged by a daemon whose runs have vanished from the queue.
const LOST: &str = "no worker has these runs";

/// A film that takes a while.
fn long() -> Value {
    json!({ "w": 960, "h": 720, "fps": 60 })
}

impl Cluster {
    fn signal_broker(&self, signal: &str) {
        let id = self.server.id().to_string();
        assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
    }

    /// Starts a worker that can load no scene: its temporary folder is a file.
    fn sick_worker(&self) -> Worker {
        let parent = self.folder.path().join("sick");
        std::fs::create_dir(&parent).unwrap();
        let worker = self.worker(&[], &[("TMPDIR", parent.to_str().unwrap())]);
        eventually("a worker that listens", || worker.log().contains("connected to the NATS"));
        let folder = std::fs::read_dir(&parent).unwrap().next().unwrap().unwrap().path();
        std::fs::remove_dir_all(&folder).unwrap();
        File::create(folder).unwrap();
        worker
    }
}

#[test]
fn workers_wait_until_the_server_has_made_the_store() {
    let Some(cluster) = Cluster::start() else { return };
    let mut early = [(); 2].map(|()| cluster.worker(&[], &[]));
    for worker in &early {
        eventually("a worker that waits", || worker.log().contains("the worker waits: --store"));
    }
    assert!(early[0].terminate(), "{}", early[0].log());
    let daemon = cluster.daemon();
    let id = create(&daemon.client(), json!({ "to": 9 }));
    ended(&daemon.client(), &id, "done");
}

#[test]
fn a_sick_worker_fails_no_film_and_pauses() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let sick = cluster.sick_worker();
    let _healthy = cluster.worker(&[], &[]);
    eventually("two workers", || client.metric("pointillist_workers{kind=\"this\"}") == 2.0);
    let id = create(&client, long());
    eventually("a pause", || client.metric("pointillist_workers_paused") == 1.0);
    let log = sick.log();
    assert!(log.contains("failed at 3 runs in a row and pulls no run for 5 seconds"), "{log}");
    ended(&client, &id, "done");
    assert_eq!(client.metric("pointillist_frames_set_aside_total"), 0.0);
    assert!(client.metric("pointillist_frames_retried_total") > 0.0);
    assert!(!sick.log().contains("set aside"), "{}", sick.log());
}

#[test]
fn runs_stay_queued_while_the_broker_hangs() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let _worker = cluster.worker(&[], &[]);
    let id = create(&client, long());
    drawn(&client, &id, 6);
    cluster.signal_broker("-STOP");
    // The worker stores the rest of its run, so the daemon has to queue another one.
    when(&client, &id, "a failure of the broker", |job| job["waits_for"].is_string());
    let has_counts = || client.get("/metrics").text().contains("pointillist_worker_runs{");
    eventually("counts that are unknown", || !has_counts());
    cluster.signal_broker("-CONT");
    eventually("counts that are known again", has_counts);
    ended(&client, &id, "done");
    let log = daemon.log();
    assert!(log.contains("a film waits") && !log.contains(LOST), "{log}");
}

#[test]
fn counts_end_with_the_connection() {
    let Some(mut cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    let client = daemon.client();
    let metrics = || client.get("/metrics").text();
    eventually("counts", || metrics().contains("pointillist_worker_runs{"));
    cluster.server.kill().unwrap();
    let mut last = String::new();
    eventually("a lost connection", || {
        last = metrics();
        last.contains("pointillist_farm_nats_connected 0")
    });
    assert!(!last.contains("pointillist_worker_runs{"), "{last}");
}

#[test]
fn a_split_run_is_split_again_for_the_next_daemon() {
    let Some(cluster) = Cluster::start() else { return };
    let mut daemon = cluster.daemon();
    let id = create(&daemon.client(), long());
    let mut dying = cluster.worker(&[], &[("POINTILLIST_WORKER_DIES_AT", "0")]);
    eventually("a dead worker", || dying.has_ended());
    let worker = cluster.worker(&[], &[]);
    eventually("a split run", || worker.log().contains("it is split"));
    // The single frames are at the end of the queue, which the next process removes. That process queues the first frames as one run again.
    let flags = cluster.flags();
    daemon = daemon.kill_and_restart(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    ended(&daemon.client(), &id, "done");
    assert!(worker.log().matches("it is split").count() > 1, "{}", worker.log());
    assert!(!daemon.log().contains(LOST), "{}", daemon.log());
}

#[test]
fn a_daemon_that_drains_keeps_what_workers_stored() {
    let Some(cluster) = Cluster::start() else { return };
    let mut daemon = cluster.daemon();
    let _worker = cluster.worker(&[], &[]);
    let id = create(&daemon.client(), slow());
    drawn(&daemon.client(), &id, 4);
    assert!(daemon.terminate().success());
    let has = |name: &str| cluster.films().iter().any(|file| file.to_string_lossy().contains(name));
    assert!(has("order.json") && has("/frames/"), "{:?}", cluster.films());
    let flags = cluster.flags();
    daemon = daemon.kill_and_restart(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    ended(&daemon.client(), &id, "done");
    assert_eq!(manifest(&daemon.client(), &id), alone(slow()));
    eventually("an empty store", || cluster.films().is_empty());
}

#[test]
fn a_worker_that_reads_a_scene_can_be_stopped() {
    let Some(cluster) = Cluster::start() else { return };
    let daemon = cluster.daemon();
    create(&daemon.client(), long());
    let has = |name: &str| cluster.films().iter().any(|file| file.to_string_lossy().contains(name));
    eventually("an order", || has("order.json"));
    // Nobody writes into these pipes, so that a reader waits for ever.
    for asset in std::fs::read_dir(cluster.store().join("assets")).unwrap() {
        let asset = asset.unwrap().path();
        std::fs::remove_file(&asset).unwrap();
        assert!(Command::new("mkfifo").arg(&asset).status().unwrap().success());
    }
    let mut worker = cluster.worker(&[], &[]);
    eventually("a run that is begun", || has("/tries/"));
    assert!(worker.terminate());
}

#[test]
fn a_consumer_that_skips_runs_is_recreated() {
    let Some(cluster) = Cluster::start() else { return };
    let url = format!("nats://127.0.0.1:{}", cluster.port);
    let run = Run {
        film: "0af9".repeat(8),
        generation: "g".to_owned(),
        id: 0,
        frames: vec![Wanted { number: 3, tag: "t".to_owned() }],
    };
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let address = Address { url: url.clone(), credentials: None, ca: None };
        let broker = Broker::connect(&address, "test").await.unwrap();
        let until = Instant::now() + Duration::from_secs(60);
        while let Err(error) = broker.prepare("k").await {
            assert!(Instant::now() < until, "{error}");
        }
        broker.queue("k", &run).await.unwrap();
        assert!(!broker.mend("k").await.unwrap(), "this consumer skips nothing");
        // This one knows of no run, as one does whose server has lost the number of the latest message.
        let client = async_nats::connect(&url).await.unwrap();
        let stream = async_nats::jetstream::new(client).get_stream(STREAM).await.unwrap();
        stream.delete_consumer("k").await.unwrap();
        let blind = pull::Config {
            durable_name: Some("k".to_owned()),
            filter_subject: "pointillist.runs.k.other".to_owned(),
            ack_policy: AckPolicy::Explicit,
            ..pull::Config::default()
        };
        stream.create_consumer(blind).await.unwrap();
        assert_eq!(broker.queued("k").await.unwrap().pending, 0);
        assert!(broker.mend("k").await.unwrap(), "the consumer is recreated");
        let pulled = broker::pull(&broker.consumer("k").await.unwrap()).await.unwrap().unwrap();
        assert_eq!(serde_json::from_slice::<Run>(&pulled.payload).unwrap(), run);
        assert!(!broker.mend("k").await.unwrap(), "a run that is drawn is not lost");
    });
}
