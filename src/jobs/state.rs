//! State that jobs and their threads share, and the changes on disk that follow a change of the book.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Instant;

use parking_lot::{Condvar, Mutex, RwLock};

use super::book::{Book, JobId, Record, Refusal, State};
use super::clock::Clock;
use super::live::{Frames, Live, Stage, Stop};
use super::manifests::Manifests;
use super::remote::Remote;
use super::store::{StateError, Store};
use super::{Config, JobError, View};
use crate::engine::Engine;

/// State that [`Jobs`](super::Jobs) and its threads share.
pub struct JobsState {
    pub engine: Engine,
    pub config: Config,
    pub store: Store,
    /// Draws frames in place of the engine.
    pub remote: OnceLock<Arc<dyn Remote>>,
    /// Serialises the creation of jobs.
    pub creating: Mutex<()>,
    /// Held briefly, and never during disk access.
    pub book: Mutex<Book>,
    /// Notified, together with `book`, when there may be work.
    pub wake: Condvar,
    pub lives: RwLock<HashMap<JobId, Arc<Live>>>,
    /// Bytes of all jobs on disk.
    pub used: AtomicU64,
    pub drawn: AtomicU64,
    pub stopping: AtomicBool,
    pub manifests: Manifests,
    /// Read only while `book` is locked. Otherwise a time could be recorded that a jump of the clock should have shifted.
    pub clock: Mutex<Clock>,
    pub threads: Mutex<Vec<JoinHandle<()>>>,
    /// Distinguishes versions of this process from those of other processes.
    pub epoch: u64,
}

impl JobsState {
    pub fn live(&self, id: JobId) -> Result<Arc<Live>, JobError> {
        self.lives.read().get(&id).cloned().ok_or(JobError::Refused(Refusal::Unknown))
    }

    /// Milliseconds since 1970 by the jobs' own clock. The caller holds the book's lock.
    pub fn now_ms(&self) -> u64 {
        self.clock.lock().ms(Instant::now())
    }

    pub fn wake_all(&self) {
        // A thread that is about to wait holds the lock until it waits, so it does not miss the notification.
        drop(self.book.lock());
        self.wake.notify_all();
    }

    pub fn view(&self, record: Record, book: &Book) -> Result<View, JobError> {
        let live = self.live(record.id)?;
        let version = *live.watch().borrow();
        let progress = live.progress.lock();
        let is_running = record.state == State::Running;
        let (rate, eta_s) = if is_running { progress.pace(Instant::now()) } else { (None, None) };
        Ok(View {
            stage: if is_running { progress.stage } else { Stage::None },
            done: progress.done,
            total: progress.total,
            coded: progress.coded,
            baked: progress.baked,
            rate,
            eta_s,
            waits_for: progress.waits_for.clone().filter(|_| is_running),
            bytes: live.bytes(),
            expires_ms: record.expires_ms(book.limits().ttl_ms),
            version,
            record,
        })
    }

    pub fn check_quota(&self) -> Result<(), JobError> {
        let (used, limit) = (self.used.load(Ordering::Relaxed), self.config.most_bytes);
        if used >= limit { Err(JobError::Full { used, limit }) } else { Ok(()) }
    }

    /// Writes the current record of a job to disk. Deletes the record of a job that is not in the book.
    pub fn keep(&self, id: JobId) -> Result<(), StateError> {
        self.store.keep(id, || self.book.lock().get(id).ok().cloned())
    }

    /// Forgets a job for good that was taken out of the book. If a runner holds the job, that runner deletes its files.
    pub fn discard(&self, record: Record) -> Result<(), StateError> {
        let id = record.id;
        let buried = self.store.bury(id);
        let mut bytes = 0;
        if buried.is_ok() {
            let live = self.lives.write().remove(&id);
            self.manifests.forget(id);
            if let Some(live) = &live {
                live.stop(Stop::Cancelled);
                bytes = live.bytes();
            }
        } else {
            let turn = record.turn;
            self.book.lock().restore(record, turn);
        }
        self.release(id, bytes);
        buried
    }

    /// Counts the job's bytes on disk again. The caller must hold the job.
    pub fn recount(&self, id: JobId, live: &Live) {
        let bytes = self.store.place(id).bytes();
        let before = live.bytes.swap(bytes, Ordering::Relaxed);
        self.used.fetch_add(bytes, Ordering::Relaxed);
        self.used.fetch_sub(before, Ordering::Relaxed);
    }

    /// Releases a job with `bytes` bytes on disk. The last holder of a removed job deletes its files.
    pub fn release(&self, id: JobId, bytes: u64) {
        let is_mine = self.book.lock().release(id);
        if is_mine {
            self.used.fetch_sub(bytes, Ordering::Relaxed);
            self.clear(id);
        }
    }

    /// Removes the frames of a finished job that only wanted a video, and returns true for such a job. The caller must have
    /// stored its state: if the process died before that, the frames would have to be drawn again.
    pub fn drop_unwanted(&self, id: JobId) -> bool {
        let is_unwanted = |job: &Record| job.state == State::Done && !job.spec.want.frames;
        if !self.book.lock().get(id).is_ok_and(is_unwanted) {
            return false;
        }
        if let Err(error) = self.store.place(id).drop_frames() {
            tracing::warn!(job = id, %error, "cannot remove the frames of a job");
        }
        true
    }

    /// Deletes what remains of a job that is neither in the book nor held.
    pub fn clear(&self, id: JobId) {
        let place = self.store.place(id);
        let mut forgotten = self.keep(id);
        if forgotten.is_err() && place.is_buried() {
            // The job's own files may take the space that the database needs.
            if let Err(error) = place.empty() {
                tracing::warn!(job = id, %error, "cannot remove the files of a deleted job");
            }
            forgotten = self.keep(id);
        }
        // The mark of the removal stays until the record is deleted.
        if forgotten.is_ok()
            && let Err(error) = place.remove()
        {
            tracing::warn!(job = id, %error, "cannot remove the files of a deleted job; the next start tries again");
        }
    }

    /// Returns the frames of a job that is not being drawn, from its manifest.
    pub fn frames(&self, id: JobId, live: &Live) -> Result<Arc<Frames>, JobError> {
        self.manifests.frames(id, live, &self.store.place(id))
    }
}
