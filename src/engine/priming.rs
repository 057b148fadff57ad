//! The thread that builds pipelines before frames need them, and keeps a list of those that frames used for the next process.
//!
//! It shares the device with the render thread, and nothing else of it: it builds pipelines into [`Pipelines`] and, where the
//! driver compiles late, submits dispatches over nothing. It takes a step only while no frame waits or is drawn, so that a
//! frame is delayed by one pipeline at most.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::renderer::Renderer;
use super::shared::Shared;
use crate::gpu::Gpu;
use crate::gpu::pipeline_store::Kept;
use crate::passes::{Pipelines, Prime, Variant, common, read_variants, write_variants};

/// How often a busy render thread is looked at, and the driver asked whether it has compiled.
const GLANCE: Duration = Duration::from_millis(5);
/// How often what frames have used is written down, if it has grown.
const SAVE_EVERY: Duration = Duration::from_secs(2);

/// Which pipelines are built ahead of the frames that need them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PrimeConfig {
    /// Folder that pipelines are kept in from one process to the next.
    pub folder: Option<PathBuf>,
    /// Whether those are built that the first frames of most scenes use, beside what earlier processes used.
    pub common: bool,
}

/// The thread; dropping it has it end and waits for that.
pub struct Primer {
    stop: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Primer {
    /// Starts the thread, where the engine was configured to have one.
    pub fn start(shared: &Arc<Shared>, renderer: &Renderer) -> Option<Primer> {
        let config = shared.config.prime.clone()?;
        let (stop, stopped) = sync_channel(1);
        let task = Task {
            shared: shared.clone(),
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
    shared: Arc<Shared>,
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
        self.shared.set_primed();
        let mut saved = 0;
        while !self.waits(SAVE_EVERY) {
            self.save(&earlier, &mut saved);
        }
        self.save(&earlier, &mut saved);
    }

    fn prime(&self, variants: &[Variant]) {
        let prime = Prime::new(&self.gpu);
        for variant in variants {
            while !self.shared.is_idle() {
                if self.waits(GLANCE) {
                    return;
                }
            }
            if self.is_over() {
                return;
            }
            match prime.build(&self.pipelines, variant) {
                Ok(is_submitted) => {
                    self.shared.stats.pipelines_primed.fetch_add(1, Ordering::Relaxed);
                    if is_submitted && self.await_driver() {
                        return;
                    }
                }
                Err(error) => tracing::debug!(%error, "a pipeline is not built ahead"),
            }
        }
    }

    /// Waits until the driver has done what was submitted; whether the thread is to end. Never by a blocking poll: it would hold
    /// up the render thread's next submission.
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

    /// Writes down what frames used, if that is more than was `saved`.
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

    /// Waits; whether the thread is to end.
    fn waits(&self, time: Duration) -> bool {
        self.gpu.is_lost()
            || !matches!(self.stopped.recv_timeout(time), Err(RecvTimeoutError::Timeout))
    }
}
