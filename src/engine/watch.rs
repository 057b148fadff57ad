//! How running bakes are watched: their progress, and whether they are to stop.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Number of steps in which progress is reported.
pub const STEPS: f64 = 1000.0;

/// Handle of a running bake: asks whether to stop, and reports progress.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    stop: Option<&'a AtomicBool>,
    done: Option<&'a AtomicU32>,
    /// Start and length of the part of the whole that is being done.
    part: [f64; 2],
}

/// Nobody waits for the bake any more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Abandoned;

impl<'a> Watch<'a> {
    /// A handle that belongs to no bake and is never stopped.
    pub const NONE: Watch<'static> = Watch { stop: None, done: None, part: [0.0, 1.0] };

    pub fn new(stop: &'a AtomicBool, done: &'a AtomicU32) -> Watch<'a> {
        Watch { stop: Some(stop), done: Some(done), part: [0.0, 1.0] }
    }

    /// Returns a handle for a part of the work: from `first` to `first + size`, of 1.
    pub fn part(&self, first: f64, size: f64) -> Watch<'a> {
        let [begin, whole] = self.part;
        Watch { part: [begin + first * whole, size * whole], ..*self }
    }

    /// # Errors
    /// The work must stop here.
    pub fn check(&self) -> Result<(), Abandoned> {
        match self.stop {
            Some(stop) if stop.load(Ordering::Relaxed) => Err(Abandoned),
            _ => Ok(()),
        }
    }

    /// Reports progress within this part, from 0 to 1.
    pub fn tell(&self, done: f64) {
        if let Some(told) = self.done {
            let [begin, size] = self.part;
            let steps = (begin + done.clamp(0.0, 1.0) * size) * STEPS;
            told.fetch_max(steps as u32, Ordering::Relaxed);
        }
    }

    /// Returns the stop flag, for code that cannot call [`Watch::check`].
    pub fn stop_flag(&self) -> Option<&'a AtomicBool> {
        self.stop
    }
}
