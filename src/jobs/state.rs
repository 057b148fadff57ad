//! State that jobs and their threads share, and the changes on disk that follow a change of the book.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Instant;

use parking_lot::{Condvar, Mutex, RwLock};

use super::book::{Book, JobId, Made, Outcome, Record, Refusal, State};
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

/// How a run of a job ended, and what it made.
pub struct End {
    pub outcome: Outcome,
    pub made: Made,
    pub drawn: u64,
}

/// Stores how a run ended, and then shows it in the book: a job that a client saw done is not queued again after a kill. A record
/// that cannot be stored is owed, and the end is shown nevertheless. `now_ms` and `show` are called under the book's lock. Returns
/// whether the record of a known job is stored.
pub fn end_run(
    store: &Store,
    book: &Mutex<Book>,
    id: JobId,
    end: End,
    now_ms: impl Fn() -> u64,
    show: impl FnOnce(),
) -> bool {
    let End { outcome, made, drawn } = end;
    let mut planned = None;
    let mut is_stored = false;
    let is_known = book.lock().get(id).is_ok();
    if is_known {
        let kept = store.keep(id, || {
            let book = book.lock();
            let (before, at_ms) = (book.get(id).ok()?.clone(), now_ms());
            let after = book.after_run(id, outcome.clone(), made.clone(), drawn, at_ms).ok()?;
            planned = Some((before, after.clone(), at_ms));
            Some(after)
        });
        is_stored = kept.is_ok();
    }
    {
        let mut book = book.lock();
        let at_ms = match &planned {
            Some((before, _, at_ms)) if book.get(id).is_ok_and(|job| job == before) => *at_ms,
            _ => now_ms(),
        };
        let is_known = book.left(id, outcome, made, drawn, at_ms);
        show();
        if !is_known {
            return false;
        }
        let is_shown = |after: &Record| book.get(id).is_ok_and(|job| job == after);
        if planned.as_ref().is_some_and(|(_, after, _)| is_shown(after)) {
            return is_stored;
        }
    }
    // The job was changed while its record was written, by a client for example.
    store.keep(id, || book.lock().get(id).ok().cloned()).is_ok()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::jobs::book::{Admitted, Limits, Need, Origin, Slots};
    use crate::jobs::spec::tests::spec;

    /// Returns the records that a server finds which starts after a kill at this moment.
    fn after_a_kill(folder: &Path) -> Vec<Record> {
        let copy = tempfile::tempdir().unwrap();
        std::fs::copy(folder.join("jobs.redb"), copy.path().join("jobs.redb")).unwrap();
        Store::open(copy.path(), 100).unwrap().records
    }

    /// A book with one running job, whose record is stored.
    fn running(store: &Store) -> (Mutex<Book>, JobId) {
        let slots = Slots { baking: 1, drawing: 1, coding: 1 };
        let limits = Limits { most_unfinished: 9, most: 9, ttl_ms: 1000, slots };
        let mut book = Book::new(limits, [], 0);
        let admitted = book.admit(spec("s"), Origin::default(), None, 1);
        let Ok(Admitted::New(id)) = admitted else { panic!("{admitted:?}") };
        assert!(book.next(2, |_| Need::Nothing).is_some());
        let record = book.get(id).unwrap().clone();
        store.keep(id, || Some(record)).unwrap();
        (Mutex::new(book), id)
    }

    #[test]
    fn a_job_that_was_seen_done_is_done_after_a_kill() {
        let at = tempfile::tempdir().unwrap();
        let store = Store::open(at.path(), 100).unwrap().store;
        let (book, id) = running(&store);
        let made = Made { done: 3, ..Made::default() };
        let end = End { outcome: Outcome::Done, made, drawn: 3 };
        let mut found = Vec::new();
        assert!(end_run(&store, &book, id, end, || 50, || found = after_a_kill(at.path())));
        let shown = book.lock().get(id).unwrap().clone();
        assert_eq!((&shown.state, shown.since_ms, shown.drawn), (&State::Done, 50, 3));
        assert_eq!(found, [shown]);
    }

    #[test]
    fn a_cancelled_job_stays_cancelled_when_its_run_ends() {
        let at = tempfile::tempdir().unwrap();
        let store = Store::open(at.path(), 100).unwrap().store;
        let (book, id) = running(&store);
        book.lock().cancel(id, 7).unwrap();
        let made = Made { done: 2, ..Made::default() };
        let end = End { outcome: Outcome::Paused, made: made.clone(), drawn: 2 };
        assert!(end_run(&store, &book, id, end, || 50, || ()));
        let found = after_a_kill(at.path());
        assert_eq!((&found[0].state, found[0].since_ms), (&State::Cancelled, 7));
        assert_eq!(found[0].made, made);
        // A removed job is stored no more.
        book.lock().remove(id).unwrap();
        let end = End { outcome: Outcome::Done, made, drawn: 0 };
        assert!(!end_run(&store, &book, id, end, || 60, || ()));
    }
}
