//! An observer of finished batches and frames, for metrics.

use super::Receipt;
use super::queue::Class;

/// The methods run on the engine's own threads and must be quick.
pub trait Observer: Send + Sync + 'static {
    /// A submission with this many frames has finished.
    fn batch(&self, frames: usize);
    /// A frame was drawn and encoded. A frame shared by several requests is reported once.
    fn frame(&self, class: Class, receipt: &Receipt);
}
