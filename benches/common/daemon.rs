//! The real binary as a child process.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use super::client::Connection;

pub struct Daemon {
    child: Child,
    pub address: SocketAddr,
    /// From its start to its listening, scenes loaded.
    pub start: Duration,
}

impl Daemon {
    /// Starts on a free port with `scenes` below `root`.
    ///
    /// # Errors
    /// It does not come to listen.
    pub fn start(root: &Path, scenes: &[&str], args: &[&str]) -> anyhow::Result<Daemon> {
        Daemon::start_with(root, scenes, args, &[])
    }

    /// [`Self::start`] with more in the environment.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with(
        root: &Path,
        scenes: &[&str],
        args: &[&str],
        environment: &[(&str, &OsStr)],
    ) -> anyhow::Result<Daemon> {
        let log = super::folder().join("daemon.log");
        std::fs::create_dir_all(super::folder())?;
        let began = Instant::now();
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--root"]).arg(root);
        for scene in scenes {
            command.args(["--scene", scene]);
        }
        let mut child = command
            .args(args)
            .env_remove("POINTILLIST_CONFIG")
            .env("POINTILLIST_NO_CACHE", "true")
            .env("POINTILLIST_NO_PRIME", "true")
            .envs(environment.iter().copied())
            .env("POINTILLIST_NO_JOBS", if args.contains(&"--state") { "false" } else { "true" })
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(&log)?)
            .spawn()
            .context("starting the daemon")?;
        let output = child.stdout.take().context("the daemon has no output")?;
        let mut address = None;
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            if let Some(text) = line.strip_prefix("listening on http://") {
                address = text.parse().ok();
                break;
            }
        }
        let Some(address) = address else {
            let _ = child.kill();
            let _ = child.wait();
            bail!("the daemon did not start; see {}", log.display());
        };
        let mut daemon = Daemon { child, address, start: Duration::ZERO };
        while daemon.connect()?.get("/readyz", "")?.status != 200 {
            if began.elapsed() > Duration::from_secs(300) {
                bail!("the daemon does not become ready; see {}", log.display());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        daemon.start = began.elapsed();
        Ok(daemon)
    }

    /// A connection of its own.
    ///
    /// # Errors
    /// The daemon has ended.
    pub fn connect(&self) -> anyhow::Result<Connection> {
        Connection::open(self.address)
    }

    /// Memory in MiB: resident now (`VmRSS`), or at most so far (`VmHWM`); `None` where the system does not tell.
    pub fn memory_mib(&self, field: &str) -> Option<f64> {
        super::memory_mib(&self.child.id().to_string(), field)
    }

    /// The value of a counter or gauge without labels.
    ///
    /// # Errors
    /// There is none of that name.
    pub fn metric(&self, name: &str) -> anyhow::Result<f64> {
        self.metric_as(name, "")
    }

    /// Returns that value, asked for with `headers`, which are whole lines.
    ///
    /// # Errors
    /// As [`Self::metric`].
    pub fn metric_as(&self, name: &str, headers: &str) -> anyhow::Result<f64> {
        let mut connection = self.connect()?;
        let answer = connection.get("/metrics", headers)?;
        let text = String::from_utf8_lossy(&answer.body);
        let line = text.lines().find(|line| line.split(' ').next() == Some(name));
        let value = line.and_then(|line| line.rsplit(' ').next()?.parse().ok());
        value.with_context(|| format!("no metric {name}"))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
