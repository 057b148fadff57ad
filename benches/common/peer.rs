//! VTK and Open3D, drawing frames on request (`benches/peers/vtk_draw.py --interactive`, `open3d_draw.py`), and trame, showing them
//! (`trame_view.py`).

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, bail};
use serde_json::Value;

use pointillist::engine::Receipt;

use super::drawing::{Drawing, Orbit, STEP_DEG};
use super::report::Report;

/// The options that `pyvista.Plotter.add_points` sets by itself (PyVista 0.49; the driver makes 4 multisamples of
/// the 8).
pub const PYVISTA: &[&str] = &["--point-size=5", "--lighting", "--multisamples=8"];

/// Frames of ours and of VTK's.
pub struct Turns {
    pub receipts: Vec<Receipt>,
    /// Empty where VTK is not installed.
    pub peer_ms: Vec<f64>,
}

/// Draws `frames` frames with both in turns, or with the engine alone; VTK's own summary goes into the report under `name`.
///
/// # Errors
/// Either fails.
#[allow(clippy::too_many_arguments, reason = "what is drawn, how, and where it is told")]
pub fn take_turns(
    report: &mut Report,
    ours: &Drawing,
    file: &Path,
    orbit: &Orbit,
    size: u32,
    name: &str,
    args: &[&str],
    frames: u32,
) -> anyhow::Result<Turns> {
    let mut vtk = Peer::vtk(file, orbit, size, args)?;
    let mut turns = Turns { receipts: Vec::new(), peer_ms: Vec::new() };
    for frame in 0..frames {
        let degrees = f64::from(frame) * STEP_DEG + 5.0;
        turns.receipts.push(ours.receipt(orbit.at(degrees))?);
        if let Some(vtk) = &mut vtk {
            turns.peer_ms.push(vtk.frame_ms(degrees)?);
        }
    }
    if let Some(vtk) = vtk {
        report.value(name, vtk.finish()?);
    }
    Ok(turns)
}

/// A process that answers each pose with a frame's milliseconds.
pub struct Peer {
    name: &'static str,
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    /// Reading the file and building the scene; the first frame.
    pub load_ms: f64,
    pub first_ms: f64,
}

/// Where `benches/peers/install.sh` puts the peers.
pub const PYTHON: &str = "target/peers/venv/bin/python";
/// Libraries that Open3D links to, where the system has none.
const LIBRARIES: &str = "target/peers/venv/lib/system";

fn python() -> Command {
    let mut command = Command::new(PYTHON);
    command.env("LD_LIBRARY_PATH", LIBRARIES);
    command
}

/// Whether Python is there and has a module; says so where not.
pub fn is_installed(name: &str, module: &str) -> bool {
    let find =
        format!("import importlib.util as u, sys; sys.exit(u.find_spec('{module}') is None)");
    let found = Path::new(PYTHON).exists()
        && python().args(["-c", &find]).status().is_ok_and(|status| status.success());
    if !found {
        println!("!! SKIPPED: {name}; benches/peers/install.sh brings it");
    }
    found
}

impl Peer {
    /// Loads a file and draws until warm; `None` when VTK is not installed.
    ///
    /// # Errors
    /// VTK fails.
    pub fn vtk(
        file: &Path,
        orbit: &Orbit,
        size: u32,
        args: &[&str],
    ) -> anyhow::Result<Option<Peer>> {
        Peer::start(["VTK", "vtkmodules", "vtk_draw.py"], file, orbit, size, args)
    }

    /// As [`Peer::vtk`], with Open3D, which draws the file's vertices as points.
    ///
    /// # Errors
    /// Open3D fails.
    pub fn open3d(
        file: &Path,
        orbit: &Orbit,
        size: u32,
        args: &[&str],
    ) -> anyhow::Result<Option<Peer>> {
        Peer::start(["Open3D", "open3d", "open3d_draw.py"], file, orbit, size, args)
    }

    /// Starts a remote view of trame's; its frames are those that a client of it has got.
    ///
    /// # Errors
    /// trame fails.
    pub fn trame(
        file: &Path,
        orbit: &Orbit,
        size: u32,
        args: &[&str],
    ) -> anyhow::Result<Option<Peer>> {
        Peer::start(["trame", "trame_vtk", "trame_view.py"], file, orbit, size, args)
    }

    fn start(
        [name, module, script]: [&'static str; 3],
        file: &Path,
        orbit: &Orbit,
        size: u32,
        args: &[&str],
    ) -> anyhow::Result<Option<Peer>> {
        if !is_installed(name, module) {
            return Ok(None);
        }
        let vector = |v: glam::DVec3| format!("{},{},{}", v.x, v.y, v.z);
        let mut child = python()
            .arg(Path::new("benches/peers").join(script))
            .arg(file)
            .arg(format!("--eye={}", vector(orbit.eye)))
            .arg(format!("--target={}", vector(orbit.target)))
            .arg(format!("--fov={}", orbit.fov_deg))
            .arg(format!("--size={size}x{size}"))
            .arg("--interactive")
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("starting {name}"))?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            bail!("{name} has no pipes");
        };
        let mut peer = Peer {
            name,
            child,
            input: Some(input),
            output: BufReader::new(output),
            load_ms: 0.0,
            first_ms: 0.0,
        };
        let ready: Value =
            serde_json::from_str(&peer.line()?).with_context(|| format!("{name} did not start"))?;
        peer.load_ms = ready["load_ms"].as_f64().unwrap_or(f64::NAN);
        peer.first_ms = ready["first_ms"].as_f64().unwrap_or(f64::NAN);
        Ok(Some(peer))
    }

    fn line(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        if self.output.read_line(&mut line)? == 0 {
            bail!("{} ended: {}", self.name, self.child.wait()?);
        }
        Ok(line)
    }

    /// Draws with the camera turned; milliseconds.
    ///
    /// # Errors
    /// The peer has ended.
    pub fn frame_ms(&mut self, degrees: f64) -> anyhow::Result<f64> {
        self.ask(&degrees.to_string())
    }

    /// As [`Peer::frame_ms`], from another distance, in units of the pose's own. Only VTK's script knows distances.
    ///
    /// # Errors
    /// The peer has ended.
    pub fn frame_from_ms(&mut self, degrees: f64, distance: f64) -> anyhow::Result<f64> {
        self.ask(&format!("{degrees} {distance}"))
    }

    /// As [`Peer::frame_ms`]; the frame is also written to a PNG, outside of what is timed. trame's script writes none.
    ///
    /// # Errors
    /// The peer has ended.
    pub fn frame_saved_ms(&mut self, degrees: f64, png: &Path) -> anyhow::Result<f64> {
        self.ask(&format!("{degrees} 1 {}", png.display()))
    }

    fn ask(&mut self, pose: &str) -> anyhow::Result<f64> {
        let input = self.input.as_mut().context("the peer is finished")?;
        writeln!(input, "{pose}")?;
        Ok(self.line()?.trim().parse()?)
    }

    /// Summary of the frames and of how they were drawn; needs one frame at least.
    ///
    /// # Errors
    /// The peer fails.
    pub fn finish(mut self) -> anyhow::Result<Value> {
        self.input = None;
        let summary = serde_json::from_str(&self.line()?)?;
        self.child.wait()?;
        Ok(summary)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
