//! Starts the daemon on a free port with a small scene, and stops it.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use super::client::Client;

/// File in a daemon's folder that says how many frames of a video it codes before it holds.
const HOLD: &str = "hold-coding";

pub struct Daemon {
    child: Child,
    pub address: SocketAddr,
    folder: tempfile::TempDir,
    /// Lines that the daemon printed before it listened.
    pub greeting: Vec<String>,
    /// Limit of the daemon's address space, if any.
    limit_kib: Option<u64>,
}

/// A wall of 64 × 64 coloured points.
pub fn grid_ply() -> String {
    wall_ply(64)
}

/// A wall of `side` × `side` coloured points in the plane z = 0, two units wide.
pub fn wall_ply(side: usize) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        side * side
    );
    for row in 0..side {
        for column in 0..side {
            let at = |i: usize| i as f64 / (side - 1) as f64 * 2.0 - 1.0;
            let (x, y) = (at(column), at(row));
            text += &format!("{x} {y} 0 {} {} 90\n", 255 * column / side, 255 * row / side);
        }
    }
    text
}

/// A scene of `file` with a node `wall`, a camera `front` and a path `past` of half a second.
pub fn grid_scene(file: &str) -> serde_json::Value {
    serde_json::json!({
        "pointillist": 1,
        "name": "grid",
        "assets": { "g": { "file": file } },
        "nodes": [{ "name": "wall", "asset": "g" }],
        "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } },
        "paths": { "past": { "fps": 20, "keys": [
            { "t": 1, "eye": [-1, 0, 3], "target": [0, 0, 0] }, { "t": 1.5, "eye": [1, 0, 3], "target": [0, 0, 0], "fov": 50 } ] } },
    })
}

/// A folder whose subfolder `root` has the scene of [`grid_scene`].
fn grid_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("root");
    std::fs::create_dir(&root).unwrap();
    std::fs::write(root.join("grid.ply"), grid_ply()).unwrap();
    std::fs::write(root.join("grid.json"), grid_scene("grid.ply").to_string()).unwrap();
    folder
}

/// A daemon with its own file system of 8 MiB for its state (see [`Daemon::start_on_small_disk`]), and the path of that file system from outside.
/// `None`, with a line that says so, where the system does not allow such a mount.
pub fn on_small_disk(prepare: impl FnOnce(&Path)) -> Option<(Daemon, PathBuf)> {
    let can = Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"])
        .output();
    if !can.is_ok_and(|output| output.status.success()) {
        eprintln!("SKIPPED: no disk of its own can be mounted here (unshare --user --mount)");
        return None;
    }
    let daemon = Daemon::start_on_small_disk(prepare, "8m");
    let disk = PathBuf::from(format!("/proc/{}/root", daemon.id()))
        .join(daemon.state().strip_prefix("/").unwrap());
    Some((daemon, disk))
}

/// Takes all space that is left on a file's disk.
pub fn fill_disk(filler: &Path) {
    let mut file = std::fs::File::options().create(true).append(true).open(filler).unwrap();
    while file.write_all(&[0; 4096]).is_ok() {}
}

impl Daemon {
    /// Starts a daemon with the scene `grid`.
    pub fn start(args: &[&str]) -> Daemon {
        Daemon::start_in(|_| {}, args)
    }

    /// As [`Daemon::start`], after `prepare` has changed the root.
    pub fn start_in(prepare: impl FnOnce(&Path), args: &[&str]) -> Daemon {
        let folder = grid_folder();
        prepare(&folder.path().join("root"));
        Daemon::spawn(folder, args, &[])
    }

    /// As [`Daemon::start_in`], with more variables of the environment.
    pub fn start_within(
        environment: &[(&str, &str)],
        prepare: impl FnOnce(&Path),
        args: &[&str],
    ) -> Daemon {
        let folder = grid_folder();
        prepare(&folder.path().join("root"));
        Daemon::spawn(folder, args, environment)
    }

    /// Starts a daemon with the scene `grid` and a JSON log of all our modules.
    pub fn start_talkative(args: &[&str]) -> Daemon {
        Daemon::start_talkative_in(|_| {}, args)
    }

    /// As [`Daemon::start_talkative`], after `prepare` has changed the root.
    pub fn start_talkative_in(prepare: impl FnOnce(&Path), args: &[&str]) -> Daemon {
        let folder = grid_folder();
        prepare(&folder.path().join("root"));
        let args = [&["--log-format", "json"], args].concat();
        Daemon::spawn(folder, &args, &[("POINTILLIST_LOG", "warn,pointillist=debug")])
    }

    /// Starts a daemon whose state folder is its own file system of this size, which disappears with the daemon. Uploads lie there, too, where
    /// `prepare` makes a folder for them.
    pub fn start_on_small_disk(prepare: impl FnOnce(&Path), size: &str) -> Daemon {
        let folder = grid_folder();
        prepare(&folder.path().join("root"));
        std::fs::create_dir(folder.path().join("state")).unwrap();
        let script = format!(
            "uploads=\"${{POINTILLIST_STATE%/*}}/root/uploads\"
            mount -t tmpfs -o size={size} tmpfs \"$POINTILLIST_STATE\" || exit
            if [ -d \"$uploads\" ]; then
                mkdir \"$POINTILLIST_STATE/uploads\" && mount --bind \"$POINTILLIST_STATE/uploads\" \"$uploads\" || exit
            fi
            exec \"$0\" \"$@\""
        );
        let mut command = Command::new("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c", &script]);
        command.arg(env!("CARGO_BIN_EXE_pointillist"));
        Daemon::spawn_as(command, folder, &[], &[])
    }

    /// Starts a daemon whose address space is limited to this many KiB, even after restarts.
    pub fn start_limited(kib: u64, args: &[&str]) -> Daemon {
        let folder = grid_folder();
        Daemon::spawn_limited(folder, kib, args)
    }

    fn spawn_limited(folder: tempfile::TempDir, kib: u64, args: &[&str]) -> Daemon {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("ulimit -v {kib} && exec \"$0\" \"$@\"")]);
        command.arg(env!("CARGO_BIN_EXE_pointillist"));
        let mut daemon = Daemon::spawn_as(command, folder, args, &[]);
        daemon.limit_kib = Some(kib);
        daemon
    }

    /// Whether the process has ended by itself.
    pub fn is_lost(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Id of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Starts a daemon that keeps its state in the user's default place, below `states`.
    pub fn start_with_user_state(states: &Path, args: &[&str]) -> Daemon {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("root");
        std::fs::create_dir(&root).unwrap();
        std::fs::write(root.join("grid.ply"), grid_ply()).unwrap();
        let states = states.to_str().unwrap();
        Daemon::spawn(folder, args, &[("XDG_STATE_HOME", states)])
    }

    /// Terminates the daemon and starts it again on the same root.
    pub fn restart(mut self, args: &[&str]) -> Daemon {
        assert!(self.terminate().success());
        self.start_again(args)
    }

    /// Kills the daemon and starts it again on the same root.
    pub fn kill_and_restart(mut self, args: &[&str]) -> Daemon {
        self.kill();
        self.start_again(args)
    }

    fn start_again(mut self, args: &[&str]) -> Daemon {
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap());
        match self.limit_kib {
            Some(kib) => Daemon::spawn_limited(folder, kib, args),
            None => Daemon::spawn(folder, args, &[]),
        }
    }

    /// As [`Daemon::kill_and_restart`], in place.
    pub fn kill_and_start(&mut self, args: &[&str]) {
        self.kill();
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap());
        *self = match self.limit_kib {
            Some(kib) => Daemon::spawn_limited(folder, kib, args),
            None => Daemon::spawn(folder, args, &[]),
        };
    }

    /// Sends SIGKILL and waits for the end.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// The folder of its jobs.
    pub fn state(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    fn spawn(folder: tempfile::TempDir, args: &[&str], environment: &[(&str, &str)]) -> Daemon {
        Daemon::spawn_as(Command::new(env!("CARGO_BIN_EXE_pointillist")), folder, args, environment)
    }

    /// Kills the daemon and starts it again on the same root. Calls `ask` as soon as the address is known, before scenes are
    /// loaded.
    pub fn kill_and_restart_asking(mut self, ask: impl FnMut(SocketAddr)) -> Daemon {
        self.kill();
        self.start_again_asking(&[], ask)
    }

    /// Starts a daemon that was killed again on the same root. Calls `ask` as [`Daemon::kill_and_restart_asking`] does.
    pub fn start_again_asking(mut self, args: &[&str], ask: impl FnMut(SocketAddr)) -> Daemon {
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap());
        let command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        Daemon::spawn_asking(command, folder, args, &[], ask)
    }

    fn spawn_as(
        command: Command,
        folder: tempfile::TempDir,
        args: &[&str],
        environment: &[(&str, &str)],
    ) -> Daemon {
        Daemon::spawn_asking(command, folder, args, environment, |_| ())
    }

    fn spawn_asking(
        mut command: Command,
        folder: tempfile::TempDir,
        args: &[&str],
        environment: &[(&str, &str)],
        mut ask: impl FnMut(SocketAddr),
    ) -> Daemon {
        let log = std::fs::File::create(folder.path().join("log")).unwrap();
        if environment.iter().any(|(name, _)| *name == "XDG_STATE_HOME") {
            command.env_remove("POINTILLIST_STATE");
        } else {
            command.env("POINTILLIST_STATE", folder.path().join("state"));
        }
        let mut child = command
            .args(["serve", "--listen", "127.0.0.1:0", "--root"])
            .arg(folder.path().join("root"))
            .args(args)
            .env_remove("POINTILLIST_CONFIG")
            .env("POINTILLIST_NO_CACHE", "true")
            .env("POINTILLIST_NO_PRIME", "true")
            .env("POINTILLIST_HOLD_CODING", folder.path().join(HOLD))
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let stdout = child.stdout.take().unwrap();
        let (sender, receiver) = sync_channel(64);
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                let _ = sender.try_send(line);
            }
        });
        let mut greeting = Vec::new();
        let mut address = None;
        while let Ok(line) = receiver.recv_timeout(Duration::from_secs(120)) {
            greeting.push(line);
            let last = &greeting[greeting.len() - 1];
            let found = last.strip_prefix("listening on http");
            if let Some((_, found)) = found.and_then(|rest| rest.split_once("://")) {
                let found = found.parse().unwrap();
                address = Some(found);
                ask(found);
            }
            if last.starts_with("curl ") {
                break;
            }
        }
        let Some(address) = address else {
            let _ = child.kill();
            let log = std::fs::read_to_string(folder.path().join("log")).unwrap_or_default();
            panic!("the daemon did not start: {greeting:?}\n{log}");
        };
        Daemon { child, address, folder, greeting, limit_kib: None }
    }

    /// Holds the coding of videos after so many frames, or lets it go on.
    #[cfg(feature = "video")]
    pub fn hold_coding(&self, frames: Option<u64>) {
        let file = self.folder.path().join(HOLD);
        match frames {
            Some(frames) => {
                // Renamed into its place, so that nobody reads half of it.
                let whole = file.with_extension("new");
                std::fs::write(&whole, frames.to_string()).unwrap();
                std::fs::rename(whole, file).unwrap();
            }
            None => std::fs::remove_file(file).unwrap_or_default(),
        }
    }

    pub fn client(&self) -> Client {
        Client::new(self.address)
    }

    pub fn root(&self) -> PathBuf {
        self.folder.path().join("root")
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Names of entries in the uploads folder.
    pub fn uploads(&self) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.root().join("uploads")) else {
            return Vec::new();
        };
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
    }

    /// Sends SIGTERM without waiting.
    pub fn signal(&self) {
        let status =
            Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(status.success());
    }

    /// Waits for the process to end.
    pub fn wait(&mut self) -> ExitStatus {
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < until, "the daemon does not end:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub fn terminate(&mut self) -> ExitStatus {
        self.signal();
        self.wait()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        if std::thread::panicking() {
            eprintln!("log of the daemon:\n{}", self.log());
        }
    }
}

/// Waits until `done` returns true, for work that the server does asynchronously.
pub fn eventually(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(30);
    while !done() {
        assert!(Instant::now() < until, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(20));
    }
}
