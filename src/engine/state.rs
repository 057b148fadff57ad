//! State that the render thread, the encoders and the callers share.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, RwLock};
use tokio::sync::{oneshot, watch};

use super::asset_cache::AssetCache;
use super::background_estimates::Background;
use super::bake_service::BakeService;
use super::encode_backlog::EncodeBacklog;
use super::frame_job::{FrameJob, Reply};
use super::library::Library;
use super::loaded::Loaded;
use super::observe::Observer;
use super::planner::Planners;
use super::queue::cost::Costs;
use super::queue::{Class, Client, Granted, Moment, Queue, Shares, Taken, lateness};
use super::resolved::ResolvedFrame;
use super::stats::Stats;
use super::trace::Origin;
use super::{EngineConfig, EngineError, EngineStats, Readiness};
use crate::residency::model::SceneModel;

/// The adapter in use.
#[derive(Clone, Debug, Default)]
pub struct Adapter {
    pub name: String,
    /// [`crate::passes::shaders::fingerprint`] of the device's shaders.
    pub renderer: String,
    pub atomics_64: bool,
    pub atomic_sums_64: bool,
    pub rasterises: bool,
    pub is_discrete: bool,
    pub max_binding_bytes: u64,
    pub max_side: u32,
    pub budget: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    Starting,
    Ready,
    Lost,
    /// The render thread panicked.
    Failed,
}

pub(super) struct Schedule {
    pub(super) queue: Queue<Arc<FrameJob>>,
    pub(super) costs: Costs,
    /// Every job that has not been answered, by its key.
    by_key: HashMap<String, Arc<FrameJob>>,
    /// A scene was removed and the render thread has not looked yet.
    removed: bool,
    stopping: bool,
    /// Pipelines have been built ahead, as far as they will be.
    primed: bool,
    phase: Phase,
    /// Since when the render thread has been at one batch.
    busy_since: Option<Instant>,
}

/// A job, and where its frame will come.
type Queued = (Arc<FrameJob>, oneshot::Receiver<Reply>);

impl Schedule {
    /// Whether jobs are taken on.
    fn check_open(&self) -> Result<(), EngineError> {
        if self.phase == Phase::Failed {
            return Err(render_thread_ended());
        }
        if self.stopping {
            return Err(EngineError::ShuttingDown);
        }
        if self.phase == Phase::Lost {
            return Err(EngineError::DeviceLost { retry_after: Duration::from_secs(1) });
        }
        Ok(())
    }

    /// How late a frame would be that is admitted now.
    fn lateness(
        &self,
        client: Client,
        deadline: Option<Instant>,
        cost_ns: u64,
        now: Instant,
    ) -> Option<Duration> {
        deadline?;
        let wait_ns = self.queue.ahead_ns(client, deadline, cost_ns, now);
        let (wait, own) = (self.costs.duration(wait_ns), self.costs.duration(cost_ns));
        lateness(deadline, now, wait, own)
    }

    /// How long all takes that waits beside a frame of `class`.
    fn backlog(&self, class: Class) -> Duration {
        at_least(self.costs.duration(self.queue.backlog_ns(class)))
    }

    /// Has a job that waits in no lane wait in that of `client`, before all others.
    fn hand_over(&mut self, client: Client, job: &Arc<FrameJob>) {
        job.set_lane(client);
        self.queue.hand_over(client, job.clone(), job.cost_ns, Instant::now());
    }
}

/// A time to come again that is worth the way.
fn at_least(wait: Duration) -> Duration {
    wait.max(Duration::from_millis(50))
}

pub struct EngineState {
    pub config: EngineConfig,
    pub library: RwLock<Library>,
    /// Identifiers being loaded.
    pub loading: Mutex<HashSet<String>>,
    /// Held while a scene is patched.
    pub patching: Mutex<()>,
    pub cache: AssetCache,
    pub bake_service: Arc<BakeService>,
    /// Frames that are drawn and not encoded.
    pub encode_backlog: EncodeBacklog,
    /// Estimates that frames do not wait for.
    pub background: Background,
    /// Measurements by which settings are chosen for goals.
    pub planners: Planners,
    pub stats: Stats,
    /// Counts changes of scenes: loaded, patched, removed.
    pub changes: watch::Sender<u64>,
    pub(super) schedule: Mutex<Schedule>,
    wake: Condvar,
    primed: Condvar,
    adapter: RwLock<Adapter>,
    resident: RwLock<HashSet<String>>,
    /// Streams that may ask for frames.
    pub open_streams: AtomicUsize,
    pub observer: OnceLock<Arc<dyn Observer>>,
    lose: AtomicBool,
    spoil: AtomicBool,
    break_thread: AtomicBool,
}

fn render_thread_ended() -> EngineError {
    EngineError::Internal("the render thread ended".to_owned())
}

/// Longer than this at one batch and the loop is said to stall.
const STALL: Duration = Duration::from_secs(20);

impl EngineState {
    pub fn new(config: EngineConfig) -> Self {
        let [capacity_ns, batch_ns] = [config.queue_time, config.batch_time]
            .map(|time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
        let (capacity, jobs) = (config.queue_capacity, config.job_share);
        let queue = Queue::new(Shares { capacity, capacity_ns, jobs, batch_ns });
        Self {
            bake_service: BakeService::new(&config),
            encode_backlog: EncodeBacklog::new(config.encoder_threads, config.job_share),
            planners: Planners::new(config.bake_cache.clone()),
            config,
            library: RwLock::default(),
            loading: Mutex::default(),
            patching: Mutex::default(),
            cache: AssetCache::default(),
            background: Background::default(),
            stats: Stats::default(),
            changes: watch::Sender::new(0),
            schedule: Mutex::new(Schedule {
                queue,
                costs: Costs::default(),
                by_key: HashMap::new(),
                removed: false,
                stopping: false,
                primed: false,
                phase: Phase::Starting,
                busy_since: None,
            }),
            wake: Condvar::new(),
            primed: Condvar::new(),
            adapter: RwLock::default(),
            resident: RwLock::default(),
            open_streams: AtomicUsize::new(0),
            observer: OnceLock::new(),
            lose: AtomicBool::new(false),
            spoil: AtomicBool::new(false),
            break_thread: AtomicBool::new(false),
        }
    }

    /// Returns the latest revision of a scene.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`].
    pub fn loaded(&self, id: &str) -> Result<Arc<Loaded>, EngineError> {
        let loaded = self.library.read().get(id);
        loaded.ok_or_else(|| EngineError::UnknownScene { id: id.to_owned() })
    }

    /// Queues a resolved frame, or joins it to an equal one that has not been answered. Gives the job beside.
    pub fn enqueue(
        &self,
        origin: Origin,
        frame: Arc<ResolvedFrame>,
    ) -> Result<Queued, EngineError> {
        let now = Instant::now();
        let mut schedule = self.schedule.lock();
        schedule.check_open()?;
        if let Some(joined) = self.join(&mut schedule, &origin, &frame) {
            return Ok(joined);
        }
        let client = origin.client;
        let cost_ns = schedule.costs.estimate_ns(frame.cost_key);
        if let Some(late) = schedule.lateness(client, frame.request.deadline, cost_ns, now) {
            self.stats.hopeless.fetch_add(1, Ordering::Relaxed);
            return Err(EngineError::DeadlineExceeded { retry_after: at_least(late) });
        }
        let key = frame.key.clone();
        let (job, receiver) = FrameJob::new(origin, frame, cost_ns);
        let (admitted, dropped) = schedule.queue.admit(client, job.clone(), cost_ns, now);
        for gone in dropped {
            self.forget(&mut schedule, &gone);
            self.stats.cancelled.fetch_add(1, Ordering::Relaxed);
        }
        if admitted.is_err() {
            self.stats.refused.fetch_add(1, Ordering::Relaxed);
            return Err(EngineError::Busy { retry_after: schedule.backlog(client.class()) });
        }
        schedule.by_key.insert(key, job.clone());
        drop(schedule);
        self.wake.notify_one();
        Ok((job, receiver))
    }

    /// Whether `job` waits in the lane of `client`.
    pub fn is_waiting(&self, client: Client, job: &Arc<FrameJob>) -> bool {
        self.schedule.lock().queue.holds(client, |other| Arc::ptr_eq(job, other))
    }

    /// Has a request take the place of `old`, which its client waits for; `None` when that waits in the queue no more. Whoever else
    /// waits for `old` still gets it.
    pub fn replace(
        &self,
        origin: Origin,
        old: &Arc<FrameJob>,
        frame: Arc<ResolvedFrame>,
    ) -> Result<Option<Queued>, EngineError> {
        let is_old = |job: &Arc<FrameJob>| Arc::ptr_eq(job, old);
        let client = origin.client;
        let mut schedule = self.schedule.lock();
        schedule.check_open()?;
        if !schedule.queue.holds(client, is_old) {
            return Ok(None);
        }
        let joined = self.join(&mut schedule, &origin, &frame);
        if joined.as_ref().is_some_and(|(job, _)| is_old(job)) {
            return Ok(joined);
        }
        let new = match joined {
            Some(joined) => {
                schedule.queue.remove(client, is_old);
                joined
            }
            None => {
                let key = frame.key.clone();
                let cost_ns = schedule.costs.estimate_ns(frame.cost_key);
                let (job, receiver) = FrameJob::new(origin, frame, cost_ns);
                if schedule.queue.replace(client, is_old, job.clone(), cost_ns).is_err() {
                    return Ok(None);
                }
                schedule.by_key.insert(key, job.clone());
                (job, receiver)
            }
        };
        if let Some(other) = old.waiter_beside(client) {
            schedule.hand_over(other, old);
        } else {
            self.forget(&mut schedule, old);
            self.stats.overtaken.fetch_add(1, Ordering::Relaxed);
            drop(schedule);
            old.answer(Err(EngineError::Overtaken));
        }
        Ok(Some(new))
    }

    /// Joins a request to an equal one that has not been answered. One that waits as a job's comes forward for whoever is more
    /// urgent.
    fn join(
        &self,
        schedule: &mut Schedule,
        origin: &Origin,
        frame: &ResolvedFrame,
    ) -> Option<Queued> {
        let job = schedule.by_key.get(&frame.key)?.clone();
        let receiver = job.join(origin.clone(), frame.request.deadline)?;
        self.stats.coalesced.fetch_add(1, Ordering::Relaxed);
        let lane = job.lane();
        if lane.class() == Class::Job && origin.client.class() != Class::Job {
            let is_it = |other: &Arc<FrameJob>| Arc::ptr_eq(other, &job);
            if schedule.queue.remove(lane, is_it).is_some() {
                schedule.hand_over(origin.client, &job);
            } else {
                self.encode_backlog.advance(&job, origin.client);
            }
        }
        Some((job, receiver))
    }

    /// Takes `job` out of the register, unless a later one of the same key is there.
    fn forget(&self, schedule: &mut Schedule, job: &Arc<FrameJob>) {
        if schedule.by_key.get(&job.frame.key).is_some_and(|found| Arc::ptr_eq(found, job)) {
            schedule.by_key.remove(&job.frame.key);
        }
    }

    /// Answers a job for good.
    pub fn answer(&self, job: &Arc<FrameJob>, reply: Reply) {
        if let Err(error) = &reply {
            self.stats.failed.fetch_add(1, Ordering::Relaxed);
            if let EngineError::Internal(text) = error {
                tracing::debug!(scene = job.frame.model.id, error = text, "a frame failed");
            }
        }
        self.forget(&mut self.schedule.lock(), job);
        job.answer(reply);
    }

    /// The next jobs to draw. Waits up to `patience` for some when nothing is `flying`.
    pub fn next_batch(&self, flying: Flying, patience: Duration) -> Batch {
        let mut schedule = self.schedule.lock();
        schedule.queue.set_flying_ns(flying.cost_ns);
        let may_wait = flying.flights == 0;
        if may_wait && schedule.queue.is_empty() && !schedule.stopping && !schedule.removed {
            schedule.busy_since = None;
            self.wake.wait_for(&mut schedule, patience);
        }
        schedule.removed = false;
        let moment = Moment {
            now: Instant::now(),
            flying_ns: flying.cost_ns,
            are_jobs_flying: flying.has_jobs,
            are_streams_open: self.open_streams.load(Ordering::Relaxed) > 0,
            are_jobs_held: !self.encode_backlog.has_room_for_jobs(),
        };
        let max = self.config.max_batch;
        let mut found = schedule.queue.take(max, moment);
        // Frames that encoders have no room for are drawn before the end nevertheless.
        let may_hold = may_wait && (moment.are_jobs_held || !schedule.stopping);
        if let Some(held_for) = found.held_for.filter(|_| may_hold) {
            schedule.busy_since = None;
            self.wake.wait_for(&mut schedule, held_for.min(patience));
            let are_jobs_held = !self.encode_backlog.has_room_for_jobs();
            let moment = Moment { now: Instant::now(), are_jobs_held, ..moment };
            let Taken { batch, expired, abandoned, .. } = schedule.queue.take(max, moment);
            found.batch = batch;
            found.expired.extend(expired);
            found.abandoned.extend(abandoned);
        }
        let Taken { batch, expired, abandoned, .. } = found;
        for job in expired.iter().chain(&abandoned) {
            self.forget(&mut schedule, job);
        }
        let stopping = schedule.stopping && schedule.queue.is_empty() && batch.is_empty();
        let retry_after = expired.first().map(|job| schedule.backlog(job.lane().class()));
        drop(schedule);
        self.stats.cancelled.fetch_add(abandoned.len() as u64, Ordering::Relaxed);
        self.stats.expired.fetch_add(expired.len() as u64, Ordering::Relaxed);
        for job in expired {
            let retry_after = retry_after.unwrap_or_default();
            job.answer(Err(EngineError::DeadlineExceeded { retry_after }));
        }
        let taken = |Granted { client, cost_ns, job }: Granted<Arc<FrameJob>>| {
            job.taken(client, cost_ns);
            job
        };
        Batch { batch: batch.into_iter().map(taken).collect(), stopping }
    }

    pub fn put_back(&self, jobs: Vec<Arc<FrameJob>>) {
        if !jobs.is_empty() {
            let granted = jobs.into_iter().map(FrameJob::granted).collect();
            self.schedule.lock().queue.put_back(granted, Instant::now());
        }
    }

    pub fn take_all(&self) -> Vec<Arc<FrameJob>> {
        self.schedule.lock().queue.drain()
    }

    pub fn is_queue_empty(&self) -> bool {
        self.schedule.lock().queue.is_empty()
    }

    /// Whether no frame waits or is being drawn.
    pub fn is_idle(&self) -> bool {
        let schedule = self.schedule.lock();
        schedule.queue.is_empty() && schedule.busy_since.is_none()
    }

    /// Tells whoever waits in [`EngineState::await_primed`].
    pub fn set_primed(&self) {
        self.schedule.lock().primed = true;
        self.primed.notify_all();
    }

    /// Waits until pipelines are primed or `patience` is over; whether they are.
    pub fn await_primed(&self, patience: Duration) -> bool {
        let mut schedule = self.schedule.lock();
        self.primed.wait_while_for(&mut schedule, |schedule| !schedule.primed, patience);
        schedule.primed
    }

    pub fn is_stopping(&self) -> bool {
        self.schedule.lock().stopping
    }

    /// No new jobs from now on.
    pub fn stop(&self) {
        self.schedule.lock().stopping = true;
        self.wake.notify_all();
    }

    /// Whether jobs that were accepted are still unanswered.
    pub fn has_unanswered(&self) -> bool {
        !self.schedule.lock().by_key.is_empty()
    }

    /// Has the render thread look whether encoders have room for frames of jobs again.
    pub fn wake_for_jobs(&self) {
        // Between its look and its wait it holds the lock.
        drop(self.schedule.lock());
        self.wake.notify_one();
    }

    /// Has the render thread free the scenes that the library no longer holds.
    pub fn wake_for_removal(&self) {
        self.schedule.lock().removed = true;
        self.wake.notify_one();
    }

    /// Fails whatever is unanswered and takes nothing more: the render thread is gone.
    pub fn abandon(&self) {
        let jobs: Vec<Arc<FrameJob>> = {
            let mut schedule = self.schedule.lock();
            schedule.stopping = true;
            schedule.phase = Phase::Failed;
            schedule.queue.drain();
            schedule.by_key.drain().map(|(_, job)| job).collect()
        };
        self.stats.failed.fetch_add(jobs.len() as u64, Ordering::Relaxed);
        for job in jobs {
            job.answer(Err(render_thread_ended()));
        }
    }

    /// Tells whoever watches that a scene is not what it was.
    pub fn scenes_changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }

    pub fn lose_device(&self) {
        self.lose.store(true, Ordering::SeqCst);
    }

    pub fn break_render_thread(&self) {
        self.break_thread.store(true, Ordering::SeqCst);
        self.wake.notify_one();
    }

    pub fn is_to_break(&self) -> bool {
        self.break_thread.load(Ordering::SeqCst)
    }

    pub fn spoil_next_submission(&self) {
        self.spoil.store(true, Ordering::SeqCst);
    }

    pub fn take_spoil_request(&self) -> bool {
        self.spoil.swap(false, Ordering::SeqCst)
    }

    pub fn take_lose_request(&self) -> bool {
        self.lose.swap(false, Ordering::SeqCst)
    }

    pub fn set_phase(&self, phase: Phase) {
        self.schedule.lock().phase = phase;
    }

    pub fn beat(&self, busy: bool) {
        self.schedule.lock().busy_since = busy.then(Instant::now);
    }

    pub fn readiness(&self) -> Readiness {
        let schedule = self.schedule.lock();
        // Before all: who drains, ends; who failed, waits to be ended.
        if schedule.phase == Phase::Failed {
            return Readiness::Failed;
        }
        if schedule.stopping {
            return Readiness::Draining;
        }
        match schedule.phase {
            Phase::Starting => Readiness::Starting,
            Phase::Lost => Readiness::DeviceLost,
            Phase::Failed => Readiness::Failed,
            Phase::Ready => match schedule.busy_since.map(|since| since.elapsed()) {
                Some(busy) if busy > STALL => {
                    Readiness::Stalled { for_ms: busy.as_millis() as u64 }
                }
                _ => Readiness::Ready,
            },
        }
    }

    pub fn set_adapter(&self, adapter: Adapter) {
        *self.adapter.write() = adapter;
    }

    pub fn adapter(&self) -> Adapter {
        self.adapter.read().clone()
    }

    /// Whether the adapter in use is a GPU with memory of its own.
    pub fn is_on_discrete_gpu(&self) -> bool {
        self.adapter.read().is_discrete
    }

    /// Publishes which scenes are on the GPU, and returns those of them that have been removed from the library.
    pub fn set_resident<'a>(&self, ids: impl Iterator<Item = &'a str>) -> Vec<String> {
        let (now, removed): (HashSet<String>, HashSet<String>) = {
            let library = self.library.read();
            ids.map(str::to_owned).partition(|id| library.holds(SceneModel::scene_of(id)))
        };
        if *self.resident.read() != now {
            *self.resident.write() = now;
        }
        removed.into_iter().collect()
    }

    pub fn is_resident(&self, id: &str) -> bool {
        let resident = self.resident.read();
        resident.contains(id) || resident.contains(&SceneModel::tree_id(id))
    }

    pub fn snapshot(&self) -> EngineStats {
        let queued = self.schedule.lock().queue.len() as u64;
        self.stats.snapshot(queued)
    }
}

/// Submissions that have not landed when a batch is taken.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flying {
    /// Submissions.
    pub flights: usize,
    /// Device time of their frames, as estimated.
    pub cost_ns: u64,
    /// Whether frames of jobs are among them.
    pub has_jobs: bool,
}

/// Result of [`EngineState::next_batch`].
pub struct Batch {
    pub batch: Vec<Arc<FrameJob>>,
    /// Told to stop, and nothing is left to do.
    pub stopping: bool,
}
