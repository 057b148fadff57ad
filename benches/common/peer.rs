//! VTK, drawing frames on request (`benches/peers/vtk_draw.py --interactive`).

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, bail};
use serde_json::Value;

use pointillist::engine::Receipt;

use super::drawing::{Drawing, Orbit, STEP_DEG};
use super::report::Report;

/// What who calls `pyvista.Plotter.add_points` without options gets (PyVista 0.49; the driver makes 4 multisamples of
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
    let mut vtk = Vtk::start(file, orbit, size, args)?;
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

pub struct Vtk {
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    /// Reading the file and building the scene; the first frame.
    pub load_ms: f64,
    pub first_ms: f64,
}

/// Python with VTK, where `benches/peers/install.sh` put it.
fn python() -> Option<PathBuf> {
    let python = PathBuf::from("target/peers/venv/bin/python");
    if !python.exists() {
        println!("!! SKIPPED: VTK; benches/peers/install.sh brings it");
        return None;
    }
    Some(python)
}

impl Vtk {
    /// Loads a file and draws until warm; `None` when VTK is not installed.
    ///
    /// # Errors
    /// VTK fails.
    pub fn start(
        file: &Path,
        orbit: &Orbit,
        size: u32,
        args: &[&str],
    ) -> anyhow::Result<Option<Vtk>> {
        let Some(python) = python() else { return Ok(None) };
        let vector = |v: glam::DVec3| format!("{},{},{}", v.x, v.y, v.z);
        let mut child = Command::new(python)
            .arg("benches/peers/vtk_draw.py")
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
            .context("starting VTK")?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            bail!("VTK has no pipes");
        };
        let mut vtk = Vtk {
            child,
            input: Some(input),
            output: BufReader::new(output),
            load_ms: 0.0,
            first_ms: 0.0,
        };
        let ready: Value = serde_json::from_str(&vtk.line()?).context("VTK did not start")?;
        vtk.load_ms = ready["load_ms"].as_f64().unwrap_or(f64::NAN);
        vtk.first_ms = ready["first_ms"].as_f64().unwrap_or(f64::NAN);
        Ok(Some(vtk))
    }

    fn line(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        if self.output.read_line(&mut line)? == 0 {
            bail!("VTK ended: {}", self.child.wait()?);
        }
        Ok(line)
    }

    /// Draws with the camera turned; milliseconds.
    ///
    /// # Errors
    /// VTK has ended.
    pub fn frame_ms(&mut self, degrees: f64) -> anyhow::Result<f64> {
        let input = self.input.as_mut().context("VTK is finished")?;
        writeln!(input, "{degrees}")?;
        Ok(self.line()?.trim().parse()?)
    }

    /// What was drawn and how; needs one frame at least.
    ///
    /// # Errors
    /// VTK fails.
    pub fn finish(mut self) -> anyhow::Result<Value> {
        self.input = None;
        let summary = serde_json::from_str(&self.line()?)?;
        self.child.wait()?;
        Ok(summary)
    }
}

impl Drop for Vtk {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
