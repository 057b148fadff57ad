//! Two daemons behind HAProxy with the configuration in `deploy/`.
//!
//! Skipped with a message if there is no HAProxy; `POINTILLIST_HAPROXY=required` makes that a failure. `scripts/setup-haproxy.sh`
//! installs one.

use std::net::{SocketAddr, TcpListener};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use super::client::Client;
use super::daemon::{Daemon, eventually};

struct Balancer {
    child: Child,
    address: SocketAddr,
    _folder: tempfile::TempDir,
}

impl Drop for Balancer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The HAProxy program, if there is one.
fn haproxy() -> Option<&'static str> {
    let works = |program: &&str| {
        let version = Command::new(program).arg("-v").stdout(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    };
    let found = ["haproxy", "/usr/sbin/haproxy"].into_iter().find(works);
    if found.is_none() {
        let required = std::env::var("POINTILLIST_HAPROXY").is_ok_and(|value| value == "required");
        assert!(!required, "POINTILLIST_HAPROXY=required, and there is no haproxy");
        eprintln!("!! SKIPPED: no haproxy; scripts/setup-haproxy.sh installs one");
    }
    found
}

impl Balancer {
    /// Starts HAProxy with the shipped configuration, this test's ports and faster health checks.
    fn start(program: &str, servers: [SocketAddr; 2]) -> Balancer {
        let folder = tempfile::tempdir().unwrap();
        // This port was free a moment ago.
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let text = include_str!("../../deploy/haproxy.cfg");
        let mut changed = text.to_owned();
        for (from, to) in [
            ("bind :80".to_owned(), format!("bind {address}")),
            ("127.0.0.1:8081".to_owned(), servers[0].to_string()),
            ("127.0.0.1:8082".to_owned(), servers[1].to_string()),
            ("inter 2s fastinter 500ms".to_owned(), "inter 100ms fastinter 100ms".to_owned()),
        ] {
            assert!(changed.contains(&from), "haproxy.cfg: {from}");
            changed = changed.replace(&from, &to);
        }
        let file = folder.path().join("haproxy.cfg");
        std::fs::write(&file, changed).unwrap();
        let child = Command::new(program).args(["-db", "-q", "-f"]).arg(&file).spawn().unwrap();
        Balancer { child, address, _folder: folder }
    }

    fn client(&self) -> Client {
        Client::new(self.address)
    }
}

const FRAME: &str = "/v1/scenes/grid/frame?w=32&h=32&format=raw";

#[test]
fn no_request_is_lost_while_one_of_two_drains() {
    let Some(program) = haproxy() else { return };
    let mut daemons = [(); 2].map(|()| Daemon::start(&["--drain-delay", "2"]));
    let balancer = Balancer::start(program, [daemons[0].address, daemons[1].address]);
    let client = balancer.client();
    eventually("servers that are up", || {
        std::net::TcpStream::connect(balancer.address).is_ok()
            && client.get("/readyz").status == 200
    });
    assert_eq!(client.get(FRAME).status, 200);
    // All requests for a scene go to one of the servers.
    let frames = |daemon: &Daemon| daemon.client().metric("pointillist_engine_frames_total");
    let serving = usize::from(frames(&daemons[0]) == 0.0);
    assert!(frames(&daemons[serving]) > 0.0);

    let (stop, answered) = (AtomicBool::new(false), AtomicU32::new(0));
    let statuses: Vec<u16> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..4)
            .map(|number| {
                let (balancer, stop, answered) = (&balancer, &stop, &answered);
                scope.spawn(move || {
                    let mut statuses = Vec::new();
                    while !stop.load(Ordering::Relaxed) {
                        // Half of the clients use one connection per request, which a server about to end would refuse.
                        let client = balancer.client();
                        for turn in 0..1 + number % 2 * 20 {
                            let eye = f64::from(turn) / 10.0;
                            let path = format!("{FRAME}&eye={eye},1,3&target=0,0,0");
                            statuses.push(client.get(&path).status);
                            answered.fetch_add(1, Ordering::Relaxed);
                        }
                    }
                    statuses
                })
            })
            .collect();
        let more = |count: u32| {
            let until = answered.load(Ordering::Relaxed) + count;
            eventually("answers", || answered.load(Ordering::Relaxed) >= until);
        };
        more(50);
        daemons[serving].signal();
        assert!(daemons[serving].wait().success(), "{}", daemons[serving].log());
        more(50);
        stop.store(true, Ordering::Relaxed);
        clients.into_iter().flat_map(|client| client.join().unwrap()).collect()
    });
    let lost = statuses.iter().filter(|status| **status != 200).count();
    assert_eq!(lost, 0, "of {}", statuses.len());
    assert!(frames(&daemons[1 - serving]) > 0.0, "the other server took over");
}

/// If a default daemon refused the health check, no server would be up.
#[test]
fn all_servers_gone_is_said() {
    let Some(program) = haproxy() else { return };
    let mut daemon = Daemon::start(&[]);
    let balancer = Balancer::start(program, [daemon.address; 2]);
    let client = balancer.client();
    eventually("a server", || {
        std::net::TcpStream::connect(balancer.address).is_ok() && client.get(FRAME).status == 200
    });
    assert!(daemon.terminate().success());
    eventually("none", || client.get(FRAME).status == 503);
}
