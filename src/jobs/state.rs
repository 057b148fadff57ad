//! What jobs and those who work on them share, and what is done to the disk when the book has changed.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Instant;

use parking_lot::{Condvar, Mutex, RwLock};

use super::book::{Book, JobId, Record, Refusal, State};
use super::clock::Clock;
use super::live::{Frames, Live, Stage, Stop};
use super::manifests::Manifests;
use super::store::{StateError, Store};
use super::{Config, JobError, View};
use crate::engine::Engine;

/// What [`Jobs`](super::Jobs) and their threads share.
pub struct JobsState {
    pub engine: Engine,
    pub config: Config,
    pub store: Store,
    /// Jobs are made one after the other.
    pub creating: Mutex<()>,
    /// Held for as long as it takes to look, and no lock is taken within but those of `lives` and the engine's.
    pub book: Mutex<Book>,
    /// With `book`: there may be something to do.
    pub wake: Condvar,
    pub lives: RwLock<HashMap<JobId, Arc<Live>>>,
    /// Bytes of all jobs on the disk.
    pub used: AtomicU64,
    pub drawn: AtomicU64,
    pub stopping: AtomicBool,
    pub manifests: Manifests,
    /// Looked at with the book's lock: or else a time may be noted that a jump of the clock should have moved.
    pub clock: Mutex<Clock>,
    pub threads: Mutex<Vec<JoinHandle<()>>>,
    /// Tells versions of this process from those of others.
    pub epoch: u64,
}

impl JobsState {
    pub fn live(&self, id: JobId) -> Result<Arc<Live>, JobError> {
        self.lives.read().get(&id).cloned().ok_or(JobError::Refused(Refusal::Unknown))
    }

    /// Milliseconds since 1970, by the jobs' own clock. With the book's lock.
    pub fn now_ms(&self) -> u64 {
        self.clock.lock().ms(Instant::now())
    }

    pub fn wake_all(&self) {
        // Whoever is about to wait has the lock until it does.
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
            bytes: live.bytes(),
            expires_ms: record.expires_ms(book.limits()),
            version,
            record,
        })
    }

    pub fn check_quota(&self) -> Result<(), JobError> {
        let (used, limit) = (self.used.load(Ordering::Relaxed), self.config.most_bytes);
        if used >= limit { Err(JobError::Full { used, limit }) } else { Ok(()) }
    }

    /// Writes a job's record as it is by now; of one that is not in the book, that it is gone.
    pub fn keep(&self, id: JobId) -> Result<(), StateError> {
        self.store.keep(id, || self.book.lock().get(id).ok().cloned())
    }

    /// Forgets a job that was taken out of the book, for good. Where a runner has it, that one removes its files.
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

    /// Looks how many bytes a job has on the disk. Only for who holds it.
    pub fn recount(&self, id: JobId, live: &Live) {
        let bytes = self.store.place(id).bytes();
        let before = live.bytes.swap(bytes, Ordering::Relaxed);
        self.used.fetch_add(bytes, Ordering::Relaxed);
        self.used.fetch_sub(before, Ordering::Relaxed);
    }

    /// Lets go of a job, which has so many bytes on the disk, and clears up after it where it is gone and nobody else does.
    pub fn release(&self, id: JobId, bytes: u64) {
        let is_mine = self.book.lock().release(id);
        if is_mine {
            self.used.fetch_sub(bytes, Ordering::Relaxed);
            self.clear(id);
        }
    }

    /// Removes the frames of a job of which only the video was wanted. Only when it is done for good: a kill before costs drawing them
    /// again. True when it is such a job.
    pub fn drop_unwanted(&self, id: JobId) -> bool {
        let is_unwanted = |job: &Record| job.state == State::Done && !job.spec.want.frames;
        if !self.book.lock().get(id).is_ok_and(is_unwanted) {
            return false;
        }
        if let Err(error) = self.store.place(id).drop_frames() {
            tracing::warn!(job = id, %error, "frames cannot be removed");
        }
        true
    }

    /// Removes all that a job has left behind that is neither in the book nor held.
    pub fn clear(&self, id: JobId) {
        let place = self.store.place(id);
        let mut forgotten = self.keep(id);
        if forgotten.is_err() && place.is_buried() {
            // Its files may be what takes the room that the database wants.
            if let Err(error) = place.empty() {
                tracing::warn!(job = id, %error, "what a job has left cannot be removed now");
            }
            forgotten = self.keep(id);
        }
        // The mark of its removal stays for as long as there is a record of it.
        if forgotten.is_ok()
            && let Err(error) = place.remove()
        {
            tracing::warn!(job = id, %error, "what a job has left cannot be removed now; the next start tries again");
        }
    }

    /// Frames of a job that is not drawn, by its manifest.
    pub fn frames(&self, id: JobId, live: &Live) -> Result<Arc<Frames>, JobError> {
        self.manifests.frames(id, live, &self.store.place(id))
    }
}
