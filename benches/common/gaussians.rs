//! VTK's discs and Gaussians beside ours: how they are set up, and frames in turns.

use super::drawing::{Drawing, Orbit, STEP_DEG, gpu_ms};
use super::peer::Peer;
use super::pick;
use pointillist::engine::Receipt;
use pointillist::plan::Settings;

/// Turn of a frame: a wall stays before the whole frame.
pub fn degrees(frame: u32) -> f64 {
    f64::from(frame % 9) * STEP_DEG - 2.0
}

/// Share of the frame's pixels that show samples, in percent.
pub fn covered_percent(receipt: &Receipt) -> f64 {
    let pixels = f64::from(receipt.camera.width) * f64::from(receipt.camera.height);
    100.0 * receipt.samples.drawn.unwrap_or(0) as f64 / pixels
}

/// VTK's ways to draw them: opaque discs cut to their outlines and blended Gaussians cut off where ours are, both unlit and
/// without multisamples, which is as fast as it gets, and the same two with its own bounds, lights and multisamples.
const OWN: [&str; 3] = ["--bound-scale=3", "--lighting", "--multisamples=8"];
pub const PEERS: [(&str, &str, &[&str]); 4] = [
    ("VTK's discs, at its fastest", "--mode=splats", &[]),
    ("VTK's Gaussians, at its fastest", "--mode=gaussians", &[]),
    ("VTK's discs, as it sets them up", "--mode=splats", &OWN),
    ("VTK's Gaussians, as it sets them up", "--mode=gaussians", &OWN),
];

/// A process of VTK's, with its name and its times; `None` where VTK is not installed.
pub type TimedPeer = (&'static str, Option<Peer>, Vec<f64>);

/// Draws some frames in each way and with each peer, in turns. Returns our times and the share of the frame that is covered, in percent.
///
/// # Errors
/// The engine or a peer fails.
pub fn in_turns(
    ours: &Drawing,
    side: u32,
    orbit: &Orbit,
    ways: &[(&str, Settings)],
    peers: &mut [TimedPeer],
) -> anyhow::Result<(Vec<Vec<f64>>, f64)> {
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); ways.len()];
    let mut covered = 0.0;
    let (warm, frames) = pick((2, 7), (1, 2));
    for frame in 0..warm + frames {
        let camera = orbit.at(degrees(frame));
        for (times, (_, settings)) in times.iter_mut().zip(ways) {
            let receipt = ours.draw(camera, [side, side], *settings)?;
            covered = covered_percent(&receipt);
            if frame >= warm {
                times.push(gpu_ms(&receipt)?);
            }
        }
        // VTK is warm when it says that it is ready.
        for (_, vtk, times) in peers.iter_mut().filter(|_| frame >= warm) {
            if let Some(vtk) = vtk {
                times.push(vtk.frame_ms(degrees(frame))?);
            }
        }
    }
    Ok((times, covered))
}
