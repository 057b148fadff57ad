//! Camera-path jobs (floor 6): films that are drawn without anybody waiting, and go on after whatever ended the process.
//!
//! ```text
//!             create, cancel, resume, remove
//!                         │
//!                         ▼
//!   [`book`] pure: states, turns, limits, expiry ──► [`store`]: database and folders
//!                         │
//!                  next ──┴──► [`runner`]: a few at a time, a phase of a job each
//!                                   │        bake ─► path ─► `film` ─► frames ─► video
//!   who watches ◄── [`live`] ◄──────┘ progress, rate, frames that are there
//! ```
//!
//! What is durable is the record of a job (what it is to do, and in which state it is) and the folder of its frames with its manifest. A
//! process that is killed leaves both as they are; the next one queues what was running again, and `film` keeps every finished frame
//! and draws the others. Progress is not kept: the manifest is the progress.
//!
//! The book's lock is never held over work on the disk. Who changes a job changes the book first and has the record written then, as
//! the book has it by that time; meanwhile the job is held, so that no runner begins what is not durable yet.
//!
//! Frames go to the engine as those of [`Client::Job`](crate::engine::Client), after all that somebody waits for.

pub mod book;
mod clock;
mod keeper;
pub mod live;
mod manifests;
mod record;
mod runner;
mod shared;
pub mod spec;
pub mod store;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, RwLock};
use tokio::sync::watch;

pub use book::{
    Failure, FailureKind, JobId, Limits, Made, Origin, Record, Refusal, Repeat, Slots, State,
};
pub use live::Stage;
pub use runner::{find_path, find_shots};
pub use spec::{FrameSpec, PathChoice, Spec, Want};
pub use store::{Place, StateError};

use self::book::{Admitted, Book};
use self::clock::Clock;
use self::live::{Live, Stop};
use self::shared::Shared;
use self::store::Store;
use crate::engine::Engine;
use crate::film::Record as FrameRecord;

/// How jobs are set up.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Where they are kept.
    pub folder: PathBuf,
    pub limits: Limits,
    /// Bytes of all jobs together on the disk.
    pub most_bytes: u64,
}

/// Why something cannot be done for a job.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    #[error("{0:?}")]
    Refused(Refusal),
    /// Over the quota.
    #[error("jobs take {used} bytes on the disk, of {limit} that they may")]
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

/// A job as it is now.
#[derive(Clone, Debug)]
pub struct View {
    pub record: Record,
    pub stage: Stage,
    pub done: u64,
    pub total: Option<u64>,
    /// Frames that are in the video so far, while it is made.
    pub coded: u64,
    /// How much of what the frames need is baked, of 1, while it is.
    pub baked: f64,
    /// Frames a second of late.
    pub rate: Option<f64>,
    pub eta_s: Option<f64>,
    pub bytes: u64,
    pub expires_ms: Option<u64>,
    /// Grows with every change, from 0 when the process begins.
    pub version: u64,
}

/// Where a frame is.
#[derive(Clone, Debug)]
pub enum Found {
    /// It is in this file.
    There { record: Arc<FrameRecord>, file: PathBuf },
    /// It will be, or would be had the job not ended.
    NotDrawn,
    /// The job has no such frame.
    NoSuch { first: u64, last: u64 },
    /// Only the video was asked for, and it is made.
    Dropped,
}

/// Jobs in each state, and what they did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Counts {
    pub by_state: [(&'static str, u64); 5],
    /// Frames drawn since the process began.
    pub drawn: u64,
    pub bytes: u64,
}

/// All jobs of a daemon; clones share them.
#[derive(Clone)]
pub struct Jobs {
    shared: Arc<Shared>,
}

impl Jobs {
    /// Takes the state folder and finds what earlier processes left there. Nothing is drawn before [`Jobs::start`].
    ///
    /// # Errors
    /// A folder that is another daemon's or cannot be written.
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
            // Nothing was before now: the clock has been put back meanwhile.
            record.since_ms = record.since_ms.min(now);
            record.created_ms = record.created_ms.min(now);
            let place = store.place(record.id);
            if record.state == State::Done && !record.spec.want.frames {
                // Was killed when it had come so far.
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
            tracing::info!(unfinished, "jobs of an earlier process go on");
        }
        Ok(Jobs {
            shared: Arc::new(Shared {
                engine,
                config,
                store,
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

    /// Begins to draw what is queued.
    ///
    /// # Errors
    /// No thread could be had.
    pub fn start(&self) -> std::io::Result<()> {
        let mut threads = self.shared.threads.lock();
        let mut start = |name: String, work: fn(&Shared)| {
            let shared = self.shared.clone();
            let thread = std::thread::Builder::new().name(name).spawn(move || work(&shared))?;
            threads.push(thread);
            std::io::Result::Ok(())
        };
        start("job-keeper".into(), keeper::run)?;
        // One for each place in each phase: none waits for a thread.
        for number in 0..self.shared.config.limits.slots.all() {
            start(format!("jobs-{number}"), runner::run)?;
        }
        Ok(())
    }

    /// Has what runs stop after the frame at hand, to go on in the next process. Does not wait for it.
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
            // A thread that panicked has told so.
            let _ = thread.join();
        }
    }

    pub fn config(&self) -> &Config {
        &self.shared.config
    }

    /// What all jobs take on the disk.
    pub fn used_bytes(&self) -> u64 {
        self.shared.used.load(Ordering::Relaxed)
    }

    pub fn folder(&self) -> &Path {
        self.shared.store.folder()
    }

    /// See [`View::version`].
    pub fn epoch(&self) -> u64 {
        self.shared.epoch
    }

    pub fn place(&self, id: JobId) -> Place {
        self.shared.store.place(id)
    }

    /// Takes on a job, or finds the one that the same request has made before; true when it is new. It is durable when this returns.
    /// `film`: how many frames it will have and how many a second, where that was looked at. Blocks for a few milliseconds, as does all
    /// that changes jobs.
    ///
    /// # Errors
    /// Limits, the quota, a database that cannot be written.
    pub fn create(
        &self,
        spec: Spec,
        origin: Origin,
        repeat: Option<Repeat>,
        film: Option<(u64, f64)>,
    ) -> Result<(JobId, bool), JobError> {
        let shared = &self.shared;
        // Who asks for the same meanwhile is not told of a job that may come to nothing.
        let _alone = shared.creating.lock();
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
            // What of it has been written is removed, or else the next process finds it.
            let removed = shared.book.lock().remove(id);
            if removed.is_ok() {
                shared.release(id, 0);
            }
        }
        shared.release(id, 0);
        shared.wake.notify_all();
        kept.map(|()| (id, true))
    }

    /// Whether there is a job of this key, be it of the same request or not.
    pub fn is_known(&self, repeat: &Repeat) -> bool {
        self.shared.book.lock().repeated(repeat).is_some()
    }

    /// Whose key made a job; `None` where there were no keys.
    ///
    /// # Errors
    /// There is none.
    pub fn owner(&self, id: JobId) -> Result<Option<String>, JobError> {
        Ok(self.shared.book.lock().get(id)?.owner.clone())
    }

    /// A job as it is now.
    ///
    /// # Errors
    /// There is none.
    pub fn view(&self, id: JobId) -> Result<View, JobError> {
        let book = self.shared.book.lock();
        self.shared.view(book.get(id)?.clone(), &book)
    }

    /// All jobs, the newest first.
    pub fn list(&self) -> Vec<View> {
        let book = self.shared.book.lock();
        let mut views: Vec<View> =
            book.all().filter_map(|record| self.shared.view(record.clone(), &book).ok()).collect();
        views.reverse();
        views
    }

    /// Hears of every change of a job.
    ///
    /// # Errors
    /// There is none.
    pub fn watch(&self, id: JobId) -> Result<watch::Receiver<u64>, JobError> {
        Ok(self.shared.live(id)?.watch())
    }

    /// Ends a job that is queued or running; what is drawn stays.
    ///
    /// # Errors
    /// There is none, or it has ended otherwise. A database that cannot be written: it is cancelled all the same.
    pub fn cancel(&self, id: JobId) -> Result<(), JobError> {
        let shared = &self.shared;
        {
            let mut book = shared.book.lock();
            book.cancel(id, shared.now_ms())?;
            // Within the lock: or else it stops who has resumed it since.
            shared.live(id)?.stop(Stop::Cancelled);
        }
        Ok(shared.keep(id)?)
    }

    /// Queues a job again that has ended: what of it is missing or damaged is made, also where it was done.
    ///
    /// # Errors
    /// There is none, it is running; limits, the quota; a database that cannot be written. It stays as it is then.
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

    /// Forgets a job, whatever state it is in, and removes its files. A full disk does not keep it from that.
    ///
    /// # Errors
    /// There is none; a folder that cannot be written.
    pub fn remove(&self, id: JobId) -> Result<(), JobError> {
        // One that is being made is none yet.
        self.shared.live(id)?;
        let record = self.shared.book.lock().remove(id)?;
        Ok(self.shared.discard(record)?)
    }

    /// Where a frame of a job is. May read the manifest.
    ///
    /// # Errors
    /// There is no such job; a manifest that cannot be read.
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
        // Before the path was looked at, nobody knows its end.
        let total = self.shared.live(id)?.progress.lock().total;
        let last = total.map(|total| first + total.saturating_sub(1));
        match last {
            Some(last) if !(first..=last).contains(&number) => Ok(Found::NoSuch { first, last }),
            _ => Ok(Found::NotDrawn),
        }
    }

    /// What the manifest says of a frame, and whether its file was removed since.
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

    /// Jobs by state, and what they did.
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

    /// When a place in the queue may be free: what the running job has left to do by its own rate, or a minute.
    pub fn retry_after(&self) -> Duration {
        const MOST: f64 = 3600.0;
        let now = Instant::now();
        let lives = self.shared.lives.read();
        let left = lives.values().filter_map(|live| live.progress.lock().pace(now).1);
        let least = left.filter(|seconds| *seconds > 0.0).fold(f64::INFINITY, f64::min);
        Duration::from_secs_f64(if least.is_finite() { least.clamp(1.0, MOST) } else { 60.0 })
    }
}
