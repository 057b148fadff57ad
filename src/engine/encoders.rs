//! The encoder threads: each takes the next drawn frame from the [`EncodeQueue`](super::queue::encoding::EncodeQueue), encodes it and answers.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

use super::EngineError;
use super::encode_backlog::cost_key;
use super::finish::finish;
use super::landing::Drawn;
use super::queue::{Class, Granted};
use super::state::EngineState;

/// Is told the class of each frame before it is encoded, on the encoder's thread.
pub type EncodeHook = Arc<dyn Fn(Class) + Send + Sync>;

/// The running threads. Dropping them waits for the frames that were drawn.
pub struct Encoders {
    state: Arc<EngineState>,
    threads: Vec<JoinHandle<()>>,
}

impl Encoders {
    pub fn start(state: &Arc<EngineState>) -> Encoders {
        let count = state.encode_backlog.threads();
        let start = |number: usize| {
            let state = state.clone();
            let name = format!("encode-{number}");
            std::thread::Builder::new().name(name).spawn(move || encode(&state)).ok()
        };
        Encoders { state: state.clone(), threads: (0..count).filter_map(start).collect() }
    }

    /// Has a frame encoded and answered.
    pub fn push(&self, drawn: Drawn) {
        if self.threads.is_empty() {
            let failed = EngineError::Internal("no encoder thread could be started".to_owned());
            return self.state.answer(&drawn.job, Err(failed));
        }
        self.state.encode_backlog.push(drawn);
    }
}

impl Drop for Encoders {
    fn drop(&mut self) {
        self.state.encode_backlog.close();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn encode(state: &EngineState) {
    while let Some(Granted { client, cost_ns, job: drawn }) = state.encode_backlog.next() {
        let (job, began) = (drawn.job.clone(), Instant::now());
        // A caller is answered even if an encoder is defective.
        let finished = catch_unwind(AssertUnwindSafe(|| {
            if let Some(hook) = &state.config.encode_hook {
                hook(client.class());
            }
            finish(state, drawn);
        }));
        if finished.is_err() {
            let failed = EngineError::Internal("the encoder failed".to_owned());
            state.answer(&job, Err(failed));
        }
        state.encode_backlog.done(client, cost_ns, cost_key(&job), began);
        if client.class() == Class::Job {
            state.wake_for_jobs();
        }
    }
}
