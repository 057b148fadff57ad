//! The encoder threads: each takes the next drawn frame from the [`EncodeQueue`], encodes it and answers.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

use parking_lot::{Condvar, Mutex};

use super::EngineError;
use super::frame_job::FrameJob;
use super::queue::cost::CostKey;
use super::queue::encoding::EncodeQueue;
use super::queue::{Class, Client, Granted, Waiting};
use super::render_thread::finish;
use super::renderer::Drawn;
use super::state::EngineState;

/// Is told the class of each frame before it is encoded, on the encoder's thread.
pub type EncodeHook = Arc<dyn Fn(Class) + Send + Sync>;

/// Drawn frames that wait for an encoder.
pub struct EncodeBacklog {
    state: Mutex<State>,
    /// A frame may be taken, or the engine ends.
    work: Condvar,
    /// A frame has been taken.
    room: Condvar,
}

struct State {
    queue: EncodeQueue<Drawn>,
    closed: bool,
}

impl Waiting for Drawn {
    fn is_abandoned(&self) -> bool {
        self.job.is_abandoned()
    }

    fn deadline(&self) -> Option<Instant> {
        self.job.deadline()
    }

    fn pixels(&self) -> u64 {
        self.job.pixels()
    }
}

/// Frames of equal format, output and size take about equally long.
fn cost_key(job: &Arc<FrameJob>) -> CostKey {
    let mut hasher = DefaultHasher::new();
    (job.frame.request.format as u8, job.frame.request.output as u8).hash(&mut hasher);
    CostKey { kind: hasher.finish(), pixels: job.pixels() }
}

impl EncodeBacklog {
    pub fn new(encoders: usize, job_share: f64) -> EncodeBacklog {
        let queue = EncodeQueue::new(encoders, job_share);
        let state = Mutex::new(State { queue, closed: false });
        EncodeBacklog { state, work: Condvar::new(), room: Condvar::new() }
    }

    /// Whether encoders keep up with the frames of jobs.
    pub fn has_room_for_jobs(&self) -> bool {
        self.state.lock().queue.has_room(Class::Job)
    }

    /// Adds a frame. Waits while encoders do not keep up with streams and requests; frames of jobs are not drawn then
    /// ([`EncodeBacklog::has_room_for_jobs`]), so that nobody waits for their encoding here.
    fn push(&self, drawn: Drawn) {
        let lane = drawn.job.lane();
        let is_urgent = |other: &Client| lane.class() == Class::Job && other.class() != Class::Job;
        let client = drawn.job.waiter_beside(lane).filter(is_urgent).unwrap_or(lane);
        let key = cost_key(&drawn.job);
        let mut state = self.state.lock();
        while client.class() != Class::Job && !state.queue.has_room(client.class()) {
            self.room.wait(&mut state);
        }
        state.queue.push(client, drawn, key, Instant::now());
        drop(state);
        // Not any thread may begin any frame.
        self.work.notify_all();
    }

    /// Has the frame of a job come forward, for `client`, if it waits here.
    pub fn advance(&self, job: &Arc<FrameJob>, client: Client) {
        let is_it = |drawn: &Drawn| Arc::ptr_eq(&drawn.job, job);
        let key = cost_key(job);
        self.state.lock().queue.advance(job.lane(), client, is_it, key, Instant::now());
        self.work.notify_all();
    }

    /// Waits for the next frame to encode; `None` at the end.
    fn next(&self) -> Option<Granted<Drawn>> {
        let mut state = self.state.lock();
        loop {
            if let Some(granted) = state.queue.take() {
                self.room.notify_all();
                return Some(granted);
            }
            if state.closed && state.queue.is_empty() {
                return None;
            }
            self.work.wait(&mut state);
        }
    }

    fn done(&self, client: Client, charged_ns: u64, key: CostKey, began: Instant) {
        let ns = began.elapsed().as_nanos() as u64;
        self.state.lock().queue.done(client, charged_ns, key, ns);
        self.work.notify_all();
    }

    fn close(&self) {
        self.state.lock().closed = true;
        self.work.notify_all();
    }
}

/// The running threads. Dropping them waits for the frames that were drawn.
pub struct Encoders {
    state: Arc<EngineState>,
    threads: Vec<JoinHandle<()>>,
}

impl Encoders {
    pub fn start(state: &Arc<EngineState>) -> Encoders {
        let count = state.encode_backlog.state.lock().queue.threads();
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
