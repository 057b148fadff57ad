//! An observer of finished batches and frames, for metrics and quotas.

use std::sync::Arc;
use std::time::Duration;

use super::queue::Class;
use super::{Engine, Receipt};

/// The methods run on the engine's own threads and must be quick.
pub trait Observer: Send + Sync + 'static {
    /// A submission with this many frames has finished.
    fn batch(&self, frames: usize);
    /// The GPU has worked for so long on a frame of a caller, whether or not somebody still waits for it. A frame shared by several
    /// callers is reported for the one in whose place it was drawn.
    fn spent(&self, caller: u64, device: Duration);
    /// A frame was drawn and encoded. A frame shared by several requests is reported once.
    fn frame(&self, class: Class, receipt: &Receipt);
}

impl Engine {
    /// Sets the observer of batches and frames; only the first call succeeds. Returns whether this one did.
    pub fn observe(&self, observer: Arc<dyn Observer>) -> bool {
        self.state().observer.set(observer).is_ok()
    }
}
