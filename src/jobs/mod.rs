//! Camera-path jobs (floor 6): films that are drawn in the background and survive the end of the process.
//!
//! ```text
//!             create, cancel, resume, remove
//!                         │
//!                         ▼
//!   [`book`] pure: states, turns, limits, expiry ──► [`store`]: database and folders
//!                         │
//!                  next ──┴──► [`runner`]: a few at a time, a phase of a job each
//!                                   │        bake ─► path ─► `film` ─► frames ─► video
//!   watchers    ◄── [`live`] ◄──────┘ progress, rate, finished frames
//! ```
//!
//! Two things are durable: the record of a job (its specification and state), and the folder of its frames with the manifest. A
//! process that is killed leaves both as they are. The next process queues running jobs again; `film` keeps every finished frame
//! and draws the others. Progress is not stored, because the manifest shows it.
//!
//! The book's lock is never held during disk access. To change a job, a thread changes the book first and then has the record
//! written in the book's current state. Meanwhile it holds the job, so that no runner begins what is not durable yet. The end of a
//! run is written first and shown afterwards, because a client may act on it at once.
//!
//! Frames go to the engine as [`Client::Job`](crate::engine::Client), after all interactive frames.

pub mod book;
mod clock;
mod hold;
pub mod live;
mod maintenance;
mod manifests;
mod record;
mod remote;
mod runner;
pub mod spec;
mod state;
pub mod store;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, RwLock};
use tokio::sync::watch;

pub use book::{
    Failure, FailureKind, JobId, Limits, Made, Origin, Record, Refusal, Repeat, Slots, State,
};
pub use live::Stage;
pub use remote::{Load, Order, Queued, Remote};
pub use runner::{find_path, find_shots};
pub use spec::{FrameSpec, PathChoice, Spec, Want};
pub use store::{Place, StateError};

use self::book::{Admitted, Book};
use self::clock::Clock;
use self::live::{Live, Stop};
use self::state::JobsState;
use self::store::Store;
use crate::engine::Engine;
use crate::film::Record as FrameRecord;

/// Configuration of jobs.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// State folder.
    pub folder: PathBuf,
    pub limits: Limits,
    /// Largest number of bytes of all jobs on disk.
    pub most_bytes: u64,
}

/// Error of an operation on jobs.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    #[error("{0:?}")]
    Refused(Refusal),
    /// The quota is exceeded.
    #[error(
        "job storage is full: {used} of {limit} bytes used; delete finished jobs or raise --job-disk-mib"
    )]
    Full { used: u64, limit: u64 },
    #[error(transparent)]
    State(#[from] StateError),
    #[error("{}: {error}", file.display())]
    Io { file: PathBuf, error: std::io::Error },
}

impl From<Refusal> for JobError {
    fn from(refusal: Refusal) -> JobError {
        JobError::Refused(refusal)
    }
}

/// A snapshot of a job.
#[derive(Clone, Debug)]
pub struct View {
    pub record: Record,
    pub stage: Stage,
    pub done: u64,
    pub total: Option<u64>,
    /// Frames coded into the video so far, while it is made.
    pub coded: u64,
    /// Progress of baking from 0 to 1, while it runs.
    pub baked: f64,
    /// Recent frames per second.
    pub rate: Option<f64>,
    pub eta_s: Option<f64>,
    /// Condition that a running job waits for.
    pub waits_for: Option<String>,
    pub bytes: u64,
    pub expires_ms: Option<u64>,
    /// Increases with every change, from 0 at the start of the process.
    pub version: u64,
}

/// State of one frame.
#[derive(Clone, Debug)]
pub enum Found {
    /// The frame is in this file.
    There { record: Arc<FrameRecord>, file: PathBuf },
    /// The frame is not drawn yet, or was not before the job ended.
    NotDrawn,
    /// The job has no such frame.
    NoSuch { first: u64, last: u64 },
    /// The frame was removed because only the video was requested, which is made.
    Dropped,
}

/// Numbers of jobs in each state, and of their frames and bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Counts {
    pub by_state: [(&'static str, u64); 5],
    /// Frames drawn since the start of the process.
    pub drawn: u64,
    pub bytes: u64,
}

/// All jobs of a server; clones share them.
#[derive(Clone)]
pub struct Jobs {
    shared: Arc<JobsState>,
}

impl Jobs {
    /// Opens the state folder and loads the jobs of earlier processes. Nothing is drawn before [`Jobs::start`].
    ///
    /// # Errors
    /// The folder belongs to another server or cannot be written.
    pub fn open(engine: Engine, config: Config) -> Result<Jobs, StateError> {
        let now = clock::wall_ms();
        let mut opened = Store::open(&config.folder, now)?;
        for warning in &opened.warnings {
            tracing::warn!("{warning}");
        }
        let store = opened.store;
        let mut lives = HashMap::new();
        let mut used = 0;
        for record in &mut opened.records {
            // No time may lie in the future: the clock has been put back meanwhile.
            record.since_ms = record.since_ms.min(now);
            record.created_ms = record.created_ms.min(now);
            let place = store.place(record.id);
            if record.state == State::Done && !record.spec.want.frames {
                // The process was killed before it removed the frames.
                let _ = place.drop_frames();
            }
            let live = Live::new(place.bytes());
            live.progress.lock().done = record.made.done;
            live.progress.lock().total = record.made.total;
            used += live.bytes();
            lives.insert(record.id, live);
        }
        let book = Book::new(config.limits, opened.records, opened.last_id);
        let unfinished = book.all().filter(|job| !job.has_ended()).count();
        if unfinished > 0 {
            tracing::info!(unfinished, "resuming jobs of an earlier process");
        }
        Ok(Jobs {
            shared: Arc::new(JobsState {
                engine,
                config,
                store,
                remote: OnceLock::new(),
                creating: Mutex::default(),
                book: Mutex::new(book),
                wake: Condvar::new(),
                lives: RwLock::new(lives),
                used: AtomicU64::new(used),
                drawn: AtomicU64::new(0),
                stopping: AtomicBool::new(false),
                manifests: manifests::Manifests::default(),
                clock: Mutex::new(Clock::new(Instant::now(), now)),
                threads: Mutex::default(),
                epoch: now,
            }),
        })
    }

    /// Has frames drawn by other processes from now on; to be called before [`Jobs::start`]. Frames of a scene whose files do not
    /// say how it looks are still drawn here.
    pub fn draw_with(&self, remote: Arc<dyn Remote>) {
        // Only the first one counts.
        let _ = self.shared.remote.set(remote);
    }

    /// Returns how busy the processes are that draw frames for this one; `None` without such.
    pub fn remote_load(&self) -> Option<Load> {
        self.shared.remote.get().map(|remote| remote.load())
    }

    /// Starts drawing queued jobs.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn start(&self) -> std::io::Result<()> {
        let mut threads = self.shared.threads.lock();
        let mut start = |name: String, work: fn(&JobsState)| {
            let shared = self.shared.clone();
            let thread = std::thread::Builder::new().name(name).spawn(move || work(&shared))?;
            threads.push(thread);
            std::io::Result::Ok(())
        };
        start("job-maintenance".into(), maintenance::run)?;
        // One thread for each place in each phase, so that no phase waits for a thread.
        for number in 0..self.shared.config.limits.slots.all() {
            start(format!("jobs-{number}"), runner::run)?;
        }
        Ok(())
    }

    /// Makes runs stop after the current frame; the next process goes on. Does not wait for them.
    pub fn pause(&self) {
        self.shared.stopping.store(true, Ordering::Relaxed);
        for live in self.shared.lives.read().values() {
            live.stop(Stop::Paused);
        }
        self.shared.wake_all();
    }

    pub fn is_paused(&self) -> bool {
        self.shared.stopping.load(Ordering::Relaxed)
    }

    /// Waits until nothing runs any more, after [`Jobs::pause`]. Blocks.
    pub fn wait(&self) {
        for thread in std::mem::take(&mut *self.shared.threads.lock()) {
            // A thread that panicked has logged it.
            let _ = thread.join();
        }
    }

    pub fn config(&self) -> &Config {
        &self.shared.config
    }

    /// Returns the bytes of all jobs on disk.
    pub fn used_bytes(&self) -> u64 {
        self.shared.used.load(Ordering::Relaxed)
    }

    pub fn folder(&self) -> &Path {
        self.shared.store.folder()
    }

    /// Distinguishes versions ([`View::version`]) of this process from those of other processes.
    pub fn epoch(&self) -> u64 {
        self.shared.epoch
    }

    pub fn place(&self, id: JobId) -> Place {
        self.shared.store.place(id)
    }

    /// Creates a job, or finds the one that the same request has created before; returns true for a new job. The job is durable
    /// when this returns. `film` has the number of frames and the frames per second, if they were checked. Like all changes of
    /// jobs, this blocks for a few milliseconds.
    ///
    /// # Errors
    /// Limits, the quota, or a database that cannot be written.
    pub fn create(
        &self,
        spec: Spec,
        origin: Origin,
        repeat: Option<Repeat>,
        film: Option<(u64, f64)>,
    ) -> Result<(JobId, bool), JobError> {
        let shared = &self.shared;
        // Serialise creation, so that a concurrent repeat of the request is not told of a job that may fail.
        let _alone = shared.creating.lock();
        if shared.check_quota().is_ok() {
            let owner = origin.owner.as_deref();
            let forgotten = shared.book.lock().make_room(owner, repeat.as_ref());
            if let Some(record) = forgotten {
                tracing::info!(job = record.id, owner = record.owner, "deleted a job to make room");
                shared.discard(record)?;
            }
        }
        let (id, record) = {
            let mut book = shared.book.lock();
            let id = match book.admit(spec, origin, repeat, shared.now_ms())? {
                Admitted::Before(id) => return Ok((id, false)),
                Admitted::New(id) => id,
            };
            book.hold(id);
            if let Some((total, fps)) = film {
                book.expect(id, total, fps);
            }
            (id, book.get(id)?.clone())
        };
        let place = shared.store.place(id);
        let kept = shared.check_quota().and_then(|()| {
            shared.keep(id)?;
            let file = place.frames();
            place.prepare(&record).map_err(|error| JobError::Io { file, error })
        });
        if kept.is_ok() {
            let live = Live::new(0);
            live.progress.lock().total = film.map(|(total, _)| total);
            shared.lives.write().insert(id, live);
        } else {
            // Remove everything that has been written; otherwise the next process would find it.
            let removed = shared.book.lock().remove(id);
            if removed.is_ok() {
                shared.release(id, 0);
            }
        }
        shared.release(id, 0);
        shared.wake.notify_all();
        kept.map(|()| (id, true))
    }

    /// Returns whether there is a job with this key, whether or not from the same request.
    pub fn is_known(&self, repeat: &Repeat) -> bool {
        self.shared.book.lock().repeated(repeat).is_some()
    }

    /// Returns the owner's key of a job; `None` where there were no keys.
    ///
    /// # Errors
    /// The job does not exist.
    pub fn owner(&self, id: JobId) -> Result<Option<String>, JobError> {
        Ok(self.shared.book.lock().get(id)?.owner.clone())
    }

    /// Returns a snapshot of a job.
    ///
    /// # Errors
    /// The job does not exist.
    pub fn view(&self, id: JobId) -> Result<View, JobError> {
        let book = self.shared.book.lock();
        self.shared.view(book.get(id)?.clone(), &book)
    }

    /// Returns all jobs, the newest first.
    pub fn list(&self) -> Vec<View> {
        let book = self.shared.book.lock();
        let mut views: Vec<View> =
            book.all().filter_map(|record| self.shared.view(record.clone(), &book).ok()).collect();
        views.reverse();
        views
    }

    /// Returns a receiver that is notified of every change of a job.
    ///
    /// # Errors
    /// The job does not exist.
    pub fn watch(&self, id: JobId) -> Result<watch::Receiver<u64>, JobError> {
        Ok(self.shared.live(id)?.watch())
    }

    /// Cancels a job that is queued or running; finished frames stay.
    ///
    /// # Errors
    /// The job does not exist, or has ended otherwise. If the database cannot be written, the job is cancelled nevertheless.
    pub fn cancel(&self, id: JobId) -> Result<(), JobError> {
        let shared = &self.shared;
        {
            let mut book = shared.book.lock();
            book.cancel(id, shared.now_ms())?;
            // Stop it under the lock: otherwise this could stop a run that was resumed since.
            shared.live(id)?.stop(Stop::Cancelled);
        }
        Ok(shared.keep(id)?)
    }

    /// Queues an ended job again. The run makes what is missing or damaged, even if the job was done.
    ///
    /// # Errors
    /// The job does not exist or is running; limits, the quota; a database that cannot be written. The job then stays as it is.
    pub fn resume(&self, id: JobId) -> Result<(), JobError> {
        let shared = &self.shared;
        let live = shared.live(id)?;
        let (before, turn) = {
            let mut book = shared.book.lock();
            let before = book.get(id)?.clone();
            if before.has_ended() {
                shared.check_quota()?;
            }
            book.resume(id, shared.now_ms())?;
            book.hold(id);
            (before, book.get(id)?.turn)
        };
        let kept = shared.keep(id);
        if kept.is_err() {
            shared.book.lock().restore(before, turn);
        }
        shared.release(id, live.bytes());
        live.changed();
        shared.wake.notify_all();
        Ok(kept?)
    }

    /// Forgets a job in any state, and removes its files. This works on a full disk, too.
    ///
    /// # Errors
    /// The job does not exist; a folder that cannot be written.
    pub fn remove(&self, id: JobId) -> Result<(), JobError> {
        // A job that is still being created does not count.
        self.shared.live(id)?;
        let record = self.shared.book.lock().remove(id)?;
        Ok(self.shared.discard(record)?)
    }

    /// Finds a frame of a job. May read the manifest.
    ///
    /// # Errors
    /// The job does not exist; a manifest that cannot be read.
    pub fn frame(&self, id: JobId, number: u64) -> Result<Found, JobError> {
        let record = self.shared.book.lock().get(id)?.clone();
        if let Some(record) = self.frame_record(id, number)? {
            if record.1 {
                return Ok(Found::Dropped);
            }
            let file = self.place(id).frames().join(&record.0.file);
            return Ok(Found::There { record: record.0, file });
        }
        let first = record.spec.from.unwrap_or(0);
        // The end is unknown before the path was looked up.
        let total = self.shared.live(id)?.progress.lock().total;
        let last = total.map(|total| first + total.saturating_sub(1));
        match last {
            Some(last) if !(first..=last).contains(&number) => Ok(Found::NoSuch { first, last }),
            _ => Ok(Found::NotDrawn),
        }
    }

    /// Returns a frame's record in the manifest, and whether its file was removed since.
    fn frame_record(
        &self,
        id: JobId,
        number: u64,
    ) -> Result<Option<(Arc<FrameRecord>, bool)>, JobError> {
        let live = self.shared.live(id)?;
        if let Some(frames) = &*live.drawing.read() {
            return Ok(frames.get(&number).map(|record| (record.clone(), false)));
        }
        let (state, want) = {
            let book = self.shared.book.lock();
            let record = book.get(id)?;
            (record.state.clone(), record.spec.want)
        };
        let dropped = state == State::Done && !want.frames;
        Ok(self.shared.frames(id, &live)?.get(&number).map(|record| (record.clone(), dropped)))
    }

    /// Returns the numbers of jobs by state, and of their frames and bytes.
    pub fn counts(&self) -> Counts {
        let names = ["queued", "running", "done", "failed", "cancelled"];
        let mut by_state = names.map(|name| (name, 0));
        for job in self.shared.book.lock().all() {
            if let Some(count) = by_state.iter_mut().find(|(name, _)| *name == job.state.name()) {
                count.1 += 1;
            }
        }
        let shared = &self.shared;
        Counts {
            by_state,
            drawn: shared.drawn.load(Ordering::Relaxed),
            bytes: shared.used.load(Ordering::Relaxed),
        }
    }

    /// Estimates when a place in the queue may be free: the remaining time of the running job at its rate, or a minute.
    pub fn retry_after(&self) -> Duration {
        const MOST: f64 = 3600.0;
        let now = Instant::now();
        let lives = self.shared.lives.read();
        let left = lives.values().filter_map(|live| live.progress.lock().pace(now).1);
        let least = left.filter(|seconds| *seconds > 0.0).fold(f64::INFINITY, f64::min);
        Duration::from_secs_f64(if least.is_finite() { least.clamp(1.0, MOST) } else { 60.0 })
    }
}
