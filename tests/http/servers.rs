//! HAProxy, nginx and Prometheus for tests, with the configurations in `deploy/`.
//!
//! Tests skip themselves with a message where a program is missing; `POINTILLIST_SERVERS=required` makes that a failure.
//! `scripts/setup-servers.sh` unpacks Debian's.

use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use super::client::Client;
use super::daemon::eventually;

/// Finds a program, if there is one.
pub fn program(name: &str) -> Option<PathBuf> {
    let unpacked = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/servers/bin");
    let works = |program: &PathBuf| {
        let mut version = Command::new(program);
        version.arg(if name == "prometheus" { "--version" } else { "-v" });
        version.stdout(Stdio::null()).stderr(Stdio::null());
        version.status().is_ok_and(|status| status.success())
    };
    let places = [PathBuf::from(name), Path::new("/usr/sbin").join(name), unpacked.join(name)];
    let found = places.into_iter().find(works);
    if found.is_none() {
        let required = std::env::var("POINTILLIST_SERVERS").is_ok_and(|value| value == "required");
        assert!(!required, "POINTILLIST_SERVERS=required, and there is no {name}");
        eprintln!("!! SKIPPED: no {name}; scripts/setup-servers.sh unpacks one");
    }
    found
}

/// An address that was free a moment ago.
pub fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// A program that ends with its test.
pub struct Server {
    child: Child,
    pub address: SocketAddr,
    _folder: tempfile::TempDir,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A kind of balancer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Balancer {
    Haproxy,
    Nginx,
}

/// Replaces all occurrences of a text that must be there.
fn replaced(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "the configuration in deploy/ lacks {from:?}");
    text.replace(from, to)
}

impl Balancer {
    /// Starts the balancer in front of three servers, of which the first is the keeper. It has the shipped configuration with the
    /// test's ports and faster health checks.
    pub fn start(self, servers: [SocketAddr; 3]) -> Option<Server> {
        let program = program(match self {
            Balancer::Haproxy => "haproxy",
            Balancer::Nginx => "nginx",
        })?;
        let folder = tempfile::tempdir().unwrap();
        let address = free_address();
        let mut command = Command::new(program);
        let file = folder.path().join("config");
        match self {
            Balancer::Haproxy => {
                std::fs::write(&file, haproxy_config(address, servers)).unwrap();
                command.args(["-db", "-q", "-f"]).arg(&file);
            }
            Balancer::Nginx => {
                std::fs::write(&file, nginx_config(folder.path(), address, servers)).unwrap();
                command.args(["-e", "stderr", "-p"]).arg(folder.path()).arg("-c").arg(&file);
            }
        }
        let child = command.spawn().unwrap();
        let server = Server { child, address, _folder: folder };
        eventually("a balancer", || {
            std::net::TcpStream::connect(address).is_ok()
                && server.client().get("/v1/limits").status == 200
        });
        Some(server)
    }
}

fn haproxy_config(address: SocketAddr, servers: [SocketAddr; 3]) -> String {
    let text = include_str!("../../deploy/haproxy.cfg");
    let text = replaced(text, "bind :80\n", &format!("bind {address}\n"));
    let text = replaced(&text, "127.0.0.1:8081", &servers[0].to_string());
    let text = replaced(&text, "127.0.0.1:8082", &servers[1].to_string());
    let text = replaced(&text, "127.0.0.1:8083", &servers[2].to_string());
    replaced(&text, "inter 2s fastinter 500ms", "inter 100ms fastinter 100ms")
}

fn nginx_config(folder: &Path, address: SocketAddr, servers: [SocketAddr; 3]) -> String {
    let text = include_str!("../../deploy/nginx.conf");
    let all: String =
        servers.iter().map(|server| format!("server {server} max_fails=0;\n")).collect();
    let one = "server pointillist:8080 max_fails=0;\n    keepalive";
    let text = replaced(text, &format!("{one} 32"), &format!("{all}    keepalive 32"));
    let keeper = format!("server {} max_fails=0;\n    keepalive 8", servers[0]);
    let text = replaced(&text, &format!("{one} 8"), &keeper);
    let text = replaced(&text, "listen 80;", &format!("listen {address};"));
    let text = replaced(&text, "listen [::]:80;", "");
    let folder = folder.display();
    let text = replaced(&text, "/var/cache/nginx/pointillist", &format!("{folder}/cache"));
    let kinds = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let places: String =
        kinds.iter().map(|kind| format!("{kind}_temp_path {folder}/{kind};\n")).collect();
    // One process, which ends when it is killed.
    format!(
        "daemon off;\nmaster_process off;\npid {folder}/pid;\nevents {{}}\nhttp {{\naccess_log off;\n{places}{text}}}\n"
    )
}

/// Starts Prometheus with the shipped rules and a server to scrape.
pub fn prometheus(target: SocketAddr) -> Option<Server> {
    let program = program("prometheus")?;
    let folder = tempfile::tempdir().unwrap();
    let address = free_address();
    let rules = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/prometheus-rules.yaml");
    let config = serde_json::json!({
        "global": { "scrape_interval": "1s", "evaluation_interval": "1s" },
        "rule_files": [rules],
        "scrape_configs": [
            { "job_name": "pointillist", "static_configs": [{ "targets": [target.to_string()] }] },
        ],
    });
    // JSON is YAML.
    let file = folder.path().join("prometheus.yml");
    std::fs::write(&file, config.to_string()).unwrap();
    let child = Command::new(program)
        .arg(format!("--config.file={}", file.display()))
        .arg(format!("--storage.tsdb.path={}", folder.path().join("data").display()))
        .arg(format!("--web.listen-address={address}"))
        .arg("--log.level=warn")
        .spawn()
        .unwrap();
    let server = Server { child, address, _folder: folder };
    eventually("Prometheus", || {
        std::net::TcpStream::connect(address).is_ok()
            && server.client().get("/-/ready").status == 200
    });
    Some(server)
}

impl Server {
    pub fn client(&self) -> Client {
        Client::new(self.address)
    }
}
