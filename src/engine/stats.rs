//! Counters and readiness of the engine.

use std::sync::atomic::{AtomicU64, Ordering};

/// Whether frames can be drawn now, and if not, why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    Ready,
    Starting,
    Stalled {
        for_ms: u64,
    },
    DeviceLost,
    Draining,
    /// The render thread ended because of a defect: only a new process can draw again.
    Failed,
}

/// Counters for `/metrics`, cumulative since the start.
#[derive(Clone, Debug, Default)]
pub struct EngineStats {
    pub frames: u64,
    pub batches: u64,
    pub coalesced: u64,
    pub cancelled: u64,
    /// Frames of several exposures that were ended between them, because nobody waited any more.
    pub given_up: u64,
    /// Jobs that a newer one replaced before they were begun.
    pub overtaken: u64,
    pub expired: u64,
    pub refused: u64,
    /// Jobs refused because the queue left no time until their deadline.
    pub hopeless: u64,
    pub failed: u64,
    pub queued: u64,
    pub device_losses: u64,
    pub evictions: u64,
    pub uploads: u64,
    /// Records of instances written to the GPU; an edit writes those that it moved, and their neighbours.
    pub instances_written: u64,
    pub gpu_bytes_resident: u64,
    pub gpu_ns: u64,
    pub encode_ns: u64,
    /// Pipelines that a frame had to build or to wait for, on the device in use.
    pub pipelines_late: u64,
    /// Pipelines that were built before frames needed them.
    pub pipelines_primed: u64,
}

#[derive(Default)]
pub struct Stats {
    pub frames: AtomicU64,
    pub batches: AtomicU64,
    pub coalesced: AtomicU64,
    pub cancelled: AtomicU64,
    pub given_up: AtomicU64,
    pub overtaken: AtomicU64,
    pub expired: AtomicU64,
    pub refused: AtomicU64,
    pub hopeless: AtomicU64,
    pub failed: AtomicU64,
    pub device_losses: AtomicU64,
    pub evictions: AtomicU64,
    pub uploads: AtomicU64,
    pub instances_written: AtomicU64,
    pub gpu_bytes_resident: AtomicU64,
    pub gpu_ns: AtomicU64,
    pub encode_ns: AtomicU64,
    pub pipelines_late: AtomicU64,
    pub pipelines_primed: AtomicU64,
}

impl Stats {
    /// Returns the counters as they are now; `queued` frames wait.
    pub fn snapshot(&self, queued: u64) -> EngineStats {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        EngineStats {
            frames: read(&self.frames),
            batches: read(&self.batches),
            coalesced: read(&self.coalesced),
            cancelled: read(&self.cancelled),
            given_up: read(&self.given_up),
            overtaken: read(&self.overtaken),
            expired: read(&self.expired),
            refused: read(&self.refused),
            hopeless: read(&self.hopeless),
            failed: read(&self.failed),
            queued,
            device_losses: read(&self.device_losses),
            evictions: read(&self.evictions),
            uploads: read(&self.uploads),
            instances_written: read(&self.instances_written),
            gpu_bytes_resident: read(&self.gpu_bytes_resident),
            gpu_ns: read(&self.gpu_ns),
            encode_ns: read(&self.encode_ns),
            pipelines_late: read(&self.pipelines_late),
            pipelines_primed: read(&self.pipelines_primed),
        }
    }
}
