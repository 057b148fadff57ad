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

/// Declares the counters, each of which is an atomic number while the engine counts, and a plain one in a snapshot.
macro_rules! counters {
    ($($(#[doc = $doc:literal])* $name:ident,)+) => {
        /// Counters for `/metrics`, cumulative since the start.
        #[derive(Clone, Debug, Default)]
        pub struct EngineStats {
            pub queued: u64,
            $($(#[doc = $doc])* pub $name: u64,)+
        }

        #[derive(Default)]
        pub struct Stats {
            $(pub $name: AtomicU64,)+
        }

        impl Stats {
            /// Returns the counters as they are now; `queued` frames wait.
            pub fn snapshot(&self, queued: u64) -> EngineStats {
                EngineStats { queued, $($name: self.$name.load(Ordering::Relaxed),)+ }
            }
        }
    };
}

counters! {
    frames,
    batches,
    coalesced,
    cancelled,
    /// Frames of several exposures that were ended between them, because nobody waited any more.
    given_up,
    /// Jobs that a newer one replaced before they were begun.
    overtaken,
    expired,
    refused,
    /// Jobs refused because the queue left no time until their deadline.
    hopeless,
    failed,
    device_losses,
    evictions,
    uploads,
    /// Records of instances written to the GPU; an edit writes those that it moved, and their neighbours.
    instances_written,
    gpu_bytes_resident,
    gpu_ns,
    encode_ns,
    /// Pipelines that a frame had to build or to wait for, on the device in use.
    pipelines_late,
    /// Pipelines that were built before frames needed them.
    pipelines_primed,
}
