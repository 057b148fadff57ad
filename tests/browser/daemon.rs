//! The daemon under test, with its own small scene.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A running daemon, killed when dropped.
pub struct Daemon {
    child: Child,
    pub url: String,
    root: tempfile::TempDir,
    /// The folder of its jobs, if it draws jobs.
    state: Option<tempfile::TempDir>,
}

fn folder_with_scene() -> tempfile::TempDir {
    let root = tempfile::tempdir().expect("a folder for the scene");
    write_scene(root.path());
    root
}

impl Daemon {
    /// Starts `pointillist serve` on a free port with the scene of [`write_scene`].
    pub fn start() -> Daemon {
        Daemon::first(None)
    }

    /// As [`Daemon::start`], with jobs.
    pub fn with_jobs() -> Daemon {
        Daemon::first(Some(tempfile::tempdir().expect("a folder for jobs")))
    }

    /// As [`Daemon::start`], open to pages of another origin.
    pub fn for_pages_of(origin: &str) -> Daemon {
        Daemon::spawn(folder_with_scene(), None, "127.0.0.1:0", &["--cors-origin", origin])
    }

    fn first(state: Option<tempfile::TempDir>) -> Daemon {
        Daemon::spawn(folder_with_scene(), state, "127.0.0.1:0", &[])
    }

    /// Kills the daemon, as in a crash.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Starts the daemon again on the same root and address, after [`Daemon::kill`].
    pub fn start_again(&mut self) {
        let root = std::mem::replace(&mut self.root, tempfile::tempdir().expect("a folder"));
        let address = self.url.trim_start_matches("http://").to_owned();
        let state = self.state.take();
        *self = Daemon::spawn(root, state, &address, &[]);
    }

    fn spawn(
        root: tempfile::TempDir,
        state: Option<tempfile::TempDir>,
        address: &str,
        args: &[&str],
    ) -> Daemon {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointillist"));
        command.args(["serve", "--listen", address, "--root"]).arg(root.path()).args(args);
        match &state {
            Some(folder) => command.arg("--state").arg(folder.path()),
            None => command.env("POINTILLIST_NO_JOBS", "true"),
        };
        let mut child = command
            .env("POINTILLIST_NO_CACHE", "true")
            .env("POINTILLIST_NO_PRIME", "true")
            .stdout(Stdio::piped())
            .spawn()
            .expect("the daemon starts");
        let stdout = child.stdout.take().expect("the daemon's output");
        let mut lines = BufReader::new(stdout).lines().map_while(Result::ok);
        let url = lines.by_ref().find_map(|line| {
            line.split_once("listening on ").map(|(_, url)| url.trim().to_owned())
        });
        // This line is printed when the scene is loaded.
        assert!(lines.by_ref().any(|line| line.starts_with("curl ")), "the scene is loaded");
        std::thread::spawn(move || lines.for_each(drop));
        Daemon { child, url: url.expect("the daemon says where it listens"), root, state }
    }

    /// Removes the scene without the viewer.
    pub fn remove_scene(&self) {
        let answer = ureq::delete(format!("{}/v1/scenes/ball", self.url)).call();
        assert!(answer.is_ok(), "{answer:?}");
    }

    /// Moves the ball without the viewer.
    pub fn move_ball(&self, x: f64) {
        let answer = ureq::patch(format!("{}/v1/scenes/ball/nodes/ball", self.url))
            .send_json(serde_json::json!({ "translate": [x, 0, 0] }));
        assert!(answer.is_ok(), "{answer:?}");
    }

    /// Whether files of an uploaded scene are on the daemon's disk.
    pub fn has_upload(&self, id: &str) -> bool {
        self.root.path().join("uploads").join(id).exists()
    }

    /// Writes a file beside the scene's, for uploads, and returns its path.
    pub fn file(&self, name: &str, text: &str) -> String {
        let path = self.root.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("it can be made");
        std::fs::write(&path, text).expect("the file can be written");
        path.to_str().expect("a name in UTF-8").to_owned()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Writes a scene: a ball of points, coloured by direction, above a square of two triangles.
fn write_scene(root: &std::path::Path) {
    const POINTS: u32 = 20_000;
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {POINTS}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    );
    for index in 0..POINTS {
        // A Fibonacci spiral covers the sphere evenly.
        let z = 1.0 - (2.0 * f64::from(index) + 1.0) / f64::from(POINTS);
        let turn = f64::from(index) * 2.399_963_229_728_653;
        let (x, y) = ((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin());
        let [r, g, b] = [x, y, z].map(|v| (127.5 + 127.5 * v).round());
        let _ = writeln!(ply, "{x:.5} {y:.5} {z:.5} {x:.5} {y:.5} {z:.5} {r} {g} {b}");
    }
    let floor = "v -2 -1.2 -2\nv 2 -1.2 -2\nv 2 -1.2 2\nv -2 -1.2 2\nf 1 3 2\nf 1 4 3\n";
    let scene = r#"{ "pointillist": 1, "name": "Ball",
        "assets": { "ball": { "file": "ball.ply" }, "floor": { "file": "floor.obj" } },
        "nodes": [ { "name": "ball", "asset": "ball" }, { "name": "floor", "asset": "floor" } ],
        "cameras": { "front": { "eye": [0, 0.8, 5], "target": [0, -0.1, 0], "fov": 40 } },
        "paths": { "round": { "fps": 10, "keys": [ { "t": 0, "eye": [0, 1, 5], "target": [0, 0, 0] },
            { "t": 0.6, "eye": [5, 1, 0], "target": [0, 0, 0] }, { "t": 1, "eye": [0, 1, -5], "target": [0, 0, 0] } ] } } }"#;
    for (name, text) in [("ball.ply", ply.as_str()), ("floor.obj", floor), ("ball.json", scene)] {
        std::fs::write(root.join(name), text).expect("the scene can be written");
    }
}
