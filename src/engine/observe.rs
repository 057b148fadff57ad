//! Who is told of batches and frames as they are finished, to count them.

use super::Receipt;
use super::queue::Class;

/// Is told on the engine's own threads, and so must be quick.
pub trait Observer: Send + Sync + 'static {
    /// A submission has landed with so many frames.
    fn batch(&self, frames: usize);
    /// A frame was drawn and encoded. Whoever shares it is not counted again.
    fn frame(&self, class: Class, receipt: &Receipt);
}
