//! The daemon under test, with a small scene of its own.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A running daemon; ended on drop.
pub struct Daemon {
    child: Child,
    pub url: String,
    _root: tempfile::TempDir,
}

impl Daemon {
    /// Starts `pointillist serve` on a free port with the scene of [`write_scene`].
    pub fn start() -> Daemon {
        let root = tempfile::tempdir().expect("a folder for the scene");
        write_scene(root.path());
        let mut child = Command::new(env!("CARGO_BIN_EXE_pointillist"))
            .args(["serve", "--listen", "127.0.0.1:0", "--root"])
            .arg(root.path())
            .env("POINTILLIST_NO_CACHE", "true")
            .stdout(Stdio::piped())
            .spawn()
            .expect("the daemon starts");
        let stdout = child.stdout.take().expect("the daemon's output");
        let mut lines = BufReader::new(stdout).lines().map_while(Result::ok);
        let url = lines.by_ref().find_map(|line| {
            line.split_once("listening on ").map(|(_, url)| url.trim().to_owned())
        });
        std::thread::spawn(move || lines.for_each(drop));
        Daemon { child, url: url.expect("the daemon says where it listens"), _root: root }
    }

    /// Removes the scene behind the viewer's back.
    pub fn remove_scene(&self) {
        let answer = ureq::delete(format!("{}/v1/scenes/ball", self.url)).call();
        assert!(answer.is_ok(), "{answer:?}");
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A ball of points whose colours tell directions apart, hovering over a square of two triangles.
fn write_scene(root: &std::path::Path) {
    const POINTS: u32 = 20_000;
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {POINTS}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    );
    for index in 0..POINTS {
        // Fibonacci's spiral covers a sphere evenly.
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
        "cameras": { "front": { "eye": [0, 0.8, 5], "target": [0, -0.1, 0], "fov": 40 } } }"#;
    for (name, text) in [("ball.ply", ply.as_str()), ("floor.obj", floor), ("ball.json", scene)] {
        std::fs::write(root.join(name), text).expect("the scene can be written");
    }
}
