//! Holds the coding of a video at a frame, so that tests can kill, cancel or delete its job there.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const LOOK_EVERY: Duration = Duration::from_millis(2);

/// Waits while the file that `POINTILLIST_HOLD_CODING` names holds a number of frames that are coded, until the run is told to stop. Release
/// builds do not ask for the variable.
pub(super) fn hold(coded: u64, stop: &AtomicBool) {
    if !cfg!(debug_assertions) {
        return;
    }
    let Some(file) = std::env::var_os("POINTILLIST_HOLD_CODING") else { return };
    let limit = || std::fs::read_to_string(&file).ok()?.trim().parse::<u64>().ok();
    while limit().is_some_and(|limit| coded >= limit) && !stop.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK_EVERY);
    }
}
