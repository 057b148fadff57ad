//! What becomes of jobs by time alone, and what of them could not be written yet.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::now_ms;
use super::runner::need;
use super::shared::Shared;

/// How often jobs are looked through.
const SWEEP_EVERY: Duration = Duration::from_secs(1);
/// How long after something could not be removed it is tried again.
const REST: Duration = Duration::from_secs(30);

/// The keeper's thread: until the daemon stops.
pub(super) fn run(shared: &Shared) {
    let mut rest_until = Instant::now();
    while !shared.stopping.load(Ordering::Relaxed) {
        note_missing(shared);
        if Instant::now() >= rest_until && !expire(shared) {
            rest_until = Instant::now() + REST;
        }
        pay(shared);
        let until = Instant::now() + SWEEP_EVERY;
        let mut book = shared.book.lock();
        while Instant::now() < until && !shared.stopping.load(Ordering::Relaxed) {
            shared.wake.wait_until(&mut book, until);
        }
    }
}

/// Tells of jobs whose scenes came or went.
fn note_missing(shared: &Shared) {
    let changed = shared.book.lock().note_missing(now_ms(), need(&shared.engine));
    for live in changed.into_iter().filter_map(|id| shared.live(id).ok()) {
        live.changed();
    }
}

/// Forgets and fails jobs whose time is over. False when one could not be forgotten.
fn expire(shared: &Shared) -> bool {
    let expired = shared.book.lock().expire(now_ms());
    let mut is_fine = true;
    for record in expired.forgotten {
        let id = record.id;
        match shared.discard(record) {
            Ok(()) => tracing::info!(job = id, "job is forgotten: its time is over"),
            Err(error) => {
                tracing::error!(job = id, %error, "a job whose time is over cannot be forgotten");
                is_fine = false;
            }
        }
    }
    for id in expired.failed {
        // Told where it fails, and tried again.
        let _ = shared.keep(id);
        if let Ok(live) = shared.live(id) {
            live.changed();
        }
    }
    is_fine
}

/// Writes what is owed to the database.
fn pay(shared: &Shared) {
    for id in shared.store.owed() {
        let (is_known, is_held) = {
            let mut book = shared.book.lock();
            let known = (book.get(id).is_ok(), book.is_held(id));
            // Whoever holds it writes it.
            if !known.1 {
                book.hold(id);
            }
            known
        };
        if is_held {
            continue;
        }
        if is_known && shared.keep(id).is_ok() {
            tracing::info!(job = id, "the job's record is kept now");
            shared.drop_unwanted(id);
        }
        let live = shared.live(id).ok();
        if let Some(live) = &live {
            shared.recount(id, live);
        }
        let bytes = live.map_or(0, |live| live.bytes());
        // Clears up after it where it is gone.
        shared.release(id, bytes);
    }
}
