//! A latch with which tests hold bakes.

use std::time::Duration;

use parking_lot::{Condvar, Mutex};

use crate::engine::watch::{Abandoned, Watch};

/// Keeps bakes from beginning while it is shut. For tests.
#[derive(Debug, Default)]
pub struct Latch {
    is_open: Mutex<bool>,
    opened: Condvar,
}

impl Latch {
    pub fn open(&self) {
        *self.is_open.lock() = true;
        self.opened.notify_all();
    }

    /// Waits until the latch is open.
    pub(super) fn pass(&self, watch: &Watch<'_>) -> Result<(), Abandoned> {
        const LOOK_EVERY: Duration = Duration::from_millis(5);
        let mut is_open = self.is_open.lock();
        while !*is_open {
            watch.check()?;
            self.opened.wait_for(&mut is_open, LOOK_EVERY);
        }
        Ok(())
    }
}
