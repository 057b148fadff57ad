//! Drawn frames that wait for an encoder.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Instant;

use parking_lot::{Condvar, Mutex};

use super::frame_job::FrameJob;
use super::landing::Drawn;
use super::queue::cost::CostKey;
use super::queue::encoding::EncodeQueue;
use super::queue::{Class, Client, Granted, Waiting};

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
pub fn cost_key(job: &Arc<FrameJob>) -> CostKey {
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
    pub fn push(&self, drawn: Drawn) {
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

    /// Returns the number of threads that the backlog is for.
    pub fn threads(&self) -> usize {
        self.state.lock().queue.threads()
    }

    /// Waits for the next frame to encode; `None` at the end.
    pub fn next(&self) -> Option<Granted<Drawn>> {
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

    pub fn done(&self, client: Client, charged_ns: u64, key: CostKey, began: Instant) {
        let ns = began.elapsed().as_nanos() as u64;
        self.state.lock().queue.done(client, charged_ns, key, ns);
        self.work.notify_all();
    }

    pub fn close(&self) {
        self.state.lock().closed = true;
        self.work.notify_all();
    }
}
