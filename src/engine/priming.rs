//! The thread that builds pipelines before frames need them, and saves the list of used pipelines for the next process.
//!
//! The thread shares only the device with the render thread: it builds pipelines into [`Pipelines`] and, where the driver
//! compiles late, submits empty dispatches. It takes a step only while no frame waits or is drawn, so that a frame is delayed by
//! one pipeline at most.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::renderer::Renderer;
use super::state::EngineState;
use crate::gpu::Gpu;
use crate::gpu::pipeline_store::Kept;
use crate::passes::{Pipelines, Prime, Variant, common, read_variants, write_variants};

/// Interval of checks whether the render thread is busy and whether the driver has compiled.
const GLANCE: Duration = Duration::from_millis(5);
/// Interval at which the list of used pipelines is saved, if it has grown.
const SAVE_EVERY: Duration = Duration::from_secs(2);

/// Selects the pipelines that are built before frames need them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PrimeConfig {
    /// Folder that keeps pipelines between processes.
    pub folder: Option<PathBuf>,
    /// Whether to build the pipelines of common first frames, beside those that earlier processes used.
    pub common: bool,
}

/// Handle of the thread; dropping it stops the thread and waits for its end.
pub struct Primer {
    stop: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Primer {
    /// Starts the thread, if the engine is configured to have one.
    pub fn start(state: &Arc<EngineState>, renderer: &Renderer) -> Option<Primer> {
        let config = state.config.prime.clone()?;
        let (stop, stopped) = sync_channel(1);
        let task = Task {
            state: state.clone(),
            gpu: renderer.gpu.clone(),
            pipelines: renderer.pipelines.clone(),
            stopped,
        };
        let run = move || task.run(&config);
        match std::thread::Builder::new().name("prime".into()).spawn(run) {
            Ok(thread) => Some(Primer { stop: Some(stop), thread: Some(thread) }),
            Err(error) => {
                tracing::warn!(%error, "no thread to build pipelines ahead");
                None
            }
        }
    }
}

impl Drop for Primer {
    fn drop(&mut self) {
        self.stop.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Task {
    state: Arc<EngineState>,
    gpu: Arc<Gpu>,
    pipelines: Arc<Pipelines>,
    stopped: Receiver<()>,
}

impl Task {
    fn run(&self, config: &PrimeConfig) {
        let earlier = read_variants(&self.gpu.kept_pipelines.variants);
        let mut variants = earlier.clone();
        if config.common {
            let others = common(&self.gpu).into_iter().filter(|v| !earlier.contains(v));
            variants.extend(others);
        }
        self.prime(&variants);
        self.state.set_primed();
        let mut saved = 0;
        while !self.waits(SAVE_EVERY) {
            self.save(&earlier, &mut saved);
        }
        self.save(&earlier, &mut saved);
    }

    fn prime(&self, variants: &[Variant]) {
        let prime = Prime::new(&self.gpu);
        for variant in variants {
            while !self.state.is_idle() {
                if self.waits(GLANCE) {
                    return;
                }
            }
            if self.is_over() {
                return;
            }
            match prime.build(&self.pipelines, variant) {
                Ok(is_submitted) => {
                    self.state.stats.pipelines_primed.fetch_add(1, Ordering::Relaxed);
                    if is_submitted && self.await_driver() {
                        return;
                    }
                }
                Err(error) => tracing::debug!(%error, "a pipeline is not built ahead"),
            }
        }
    }

    /// Waits until the driver has done what was submitted; returns whether the thread must end. It never polls with blocking,
    /// which would delay the render thread's next submission.
    fn await_driver(&self) -> bool {
        let done = Arc::new(AtomicBool::new(false));
        let told = done.clone();
        self.gpu.queue.on_submitted_work_done(move || told.store(true, Ordering::Release));
        loop {
            if self.gpu.device.poll(wgpu::PollType::Poll).is_err() || self.gpu.is_lost() {
                return true;
            }
            if done.load(Ordering::Acquire) {
                return false;
            }
            if self.waits(GLANCE) {
                return true;
            }
        }
    }

    /// Saves the list of used pipelines, if it is longer than `saved`.
    fn save(&self, earlier: &[Variant], saved: &mut usize) {
        let used = self.pipelines.used();
        let Some(store) = self.gpu.pipeline_store.as_ref().filter(|_| used > *saved) else {
            return;
        };
        let kept = Kept {
            variants: write_variants(&self.pipelines.remember(earlier)).into_bytes(),
            driver: self.gpu.pipeline_cache.as_ref().and_then(|c| c.get_data()).unwrap_or_default(),
        };
        if let Err(error) = store.save(&kept) {
            tracing::warn!(%error, "pipelines cannot be kept for the next start");
        }
        *saved = used;
    }

    fn is_over(&self) -> bool {
        self.waits(Duration::ZERO)
    }

    /// Waits; returns whether the thread must end.
    fn waits(&self, time: Duration) -> bool {
        self.gpu.is_lost()
            || !matches!(self.stopped.recv_timeout(time), Err(RecvTimeoutError::Timeout))
    }
}
