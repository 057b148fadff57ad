//! Scenes, poses and settings whose frames are drawn in turns, and what the receipts of each say.

use std::sync::Arc;
use std::time::{Duration, Instant};

use pointillist::encode::ImageFormat;
use pointillist::engine::{EncodedFrame, Receipt};
use pointillist::plan::Settings;

use super::drawing::{Drawing, Orbit, STEP_DEG, gpu_ms};
use super::{median, ms};

/// Work after which a GPU that was idle runs at its full clock rate.
const AWAKE: Duration = Duration::from_millis(500);

/// A frame that is drawn again and again, the camera turned a little each time.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    pub drawing: &'a Drawing,
    pub orbit: Orbit,
    pub size: [u32; 2],
    pub settings: Settings,
}

/// Receipts of a shot's frames.
#[derive(Default)]
pub struct Taken {
    pub receipts: Vec<Receipt>,
}

/// Draws each shot `frames` times after `warm` frames or more that do not count: a frame of every shot, then the next of every shot.
///
/// # Errors
/// The engine refuses.
pub fn take(shots: &[Shot], (warm, frames): (u32, u32)) -> anyhow::Result<Vec<Taken>> {
    take_images(shots, ImageFormat::Jpeg, (warm, frames), |_| Ok(()))
}

/// As [`take`], and shows `look` each turn's frames that count, one of every shot.
///
/// # Errors
/// The engine refuses, or `look` fails.
pub fn take_images(
    shots: &[Shot],
    format: ImageFormat,
    (warm, frames): (u32, u32),
    mut look: impl FnMut(&[Arc<EncodedFrame>]) -> anyhow::Result<()>,
) -> anyhow::Result<Vec<Taken>> {
    for shot in shots {
        shot.drawing.bake(shot.settings)?;
    }
    let draw = |frame: u32| -> anyhow::Result<Vec<Arc<EncodedFrame>>> {
        let of_shot = |shot: &Shot| {
            let camera = shot.orbit.at(f64::from(frame) * STEP_DEG);
            shot.drawing.image(camera, shot.size, shot.settings, format)
        };
        shots.iter().map(of_shot).collect()
    };
    let begun = Instant::now();
    let mut warmed = 0;
    while warmed < warm || begun.elapsed() < AWAKE {
        draw(warmed)?;
        warmed += 1;
    }
    let mut taken: Vec<Taken> = shots.iter().map(|_| Taken::default()).collect();
    for frame in warm..warm + frames {
        let images = draw(frame)?;
        for (taken, image) in taken.iter_mut().zip(&images) {
            taken.receipts.push(image.receipt.clone());
        }
        look(&images)?;
    }
    Ok(taken)
}

impl Taken {
    /// GPU time of each frame.
    ///
    /// # Errors
    /// An adapter without timestamps.
    pub fn gpu_ms(&self) -> anyhow::Result<Vec<f64>> {
        self.receipts.iter().map(gpu_ms).collect()
    }

    /// Median of a count or a time; `NaN` where the adapter cannot tell.
    pub fn median(&self, of: impl Fn(&Receipt) -> Option<u64>) -> f64 {
        median(&self.receipts.iter().filter_map(|r| Some(of(r)? as f64)).collect::<Vec<_>>())
    }

    pub fn tested(&self) -> f64 {
        self.median(|receipt| receipt.samples.tested)
    }

    /// Nodes that are drawn.
    pub fn accepted(&self) -> f64 {
        self.median(|receipt| receipt.samples.accepted)
    }

    /// Share of the nodes tested that were not drawn.
    pub fn rejected_percent(&self) -> f64 {
        100.0 * (1.0 - self.accepted() / self.tested())
    }

    /// Triangles tested; none where all are drawn as samples.
    pub fn triangles(&self) -> f64 {
        self.median(|receipt| Some(receipt.triangles.tested.unwrap_or(0)))
    }

    /// Bytes that the scene holds on the GPU.
    pub fn gpu_bytes(&self) -> f64 {
        self.median(|receipt| Some(receipt.gpu_bytes))
    }

    pub fn instances_drawn(&self) -> f64 {
        self.median(|receipt| receipt.instances.drawn)
    }

    /// Frames a second where each is asked for when the one before it has come, as a JPEG.
    pub fn frames_per_second(&self) -> f64 {
        1e9 / self.median(|receipt| Some(receipt.total_ns))
    }

    /// CPU time of the render thread a frame.
    pub fn record_ms(&self) -> f64 {
        ms(self.median(|receipt| Some(receipt.record_ns)) as u64)
    }
}
