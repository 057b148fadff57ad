//! Estimates that no frame waits for.

use std::collections::HashMap;
use std::thread::JoinHandle;

use parking_lot::Mutex;

use super::EngineError;
use super::bake_service::BakeTicket;

/// Estimates that frames do not wait for, by scene.
#[derive(Default)]
pub struct Background {
    pub running: Mutex<HashMap<String, Running>>,
    /// The cloud that is being written to the cache.
    pub writers: Mutex<Vec<JoinHandle<()>>>,
}

pub struct Running {
    /// [`Loaded::load`](super::loaded::Loaded::load) of the scene.
    pub load: u64,
    pub ticket: BakeTicket,
    pub failed: Option<EngineError>,
}

impl Running {
    pub fn look(&mut self) {
        if let Some(Err(error)) = self.ticket.outcome() {
            tracing::warn!(%error, "normals and kernels cannot be estimated");
            self.failed = Some(error);
        }
    }
}

impl Background {
    /// Ends what runs for a scene that is gone or whole.
    pub fn end(&self, scene: &str) {
        let ended = self.running.lock().remove(scene);
        // Its ticket takes a lock of its own.
        drop(ended);
    }

    pub fn end_all(&self) {
        let ended = std::mem::take(&mut *self.running.lock());
        drop(ended);
    }
}
