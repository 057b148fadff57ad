//! The maintenance thread: expires jobs, and retries writes that failed.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::book::{Book, Expired, JobId};
use super::clock::{Clock, wall_ms};
use super::runner::need;
use super::state::JobsState;

/// Interval between sweeps over the jobs.
const SWEEP_EVERY: Duration = Duration::from_secs(1);
/// Delay before a failed removal is tried again.
const REST: Duration = Duration::from_secs(30);

/// Runs the maintenance thread until the server stops.
pub(super) fn run(shared: &JobsState) {
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

/// Notifies watchers of jobs whose scenes appeared or disappeared.
fn note_missing(shared: &JobsState) {
    let changed = {
        let mut book = shared.book.lock();
        book.note_missing(shared.now_ms(), need(&shared.engine))
    };
    for live in changed.into_iter().filter_map(|id| shared.live(id).ok()) {
        live.changed();
    }
}

/// Expires jobs. Where the system's clock has jumped, jobs keep their age; the first list names those whose records must be
/// written again. Pure.
fn look(book: &mut Book, clock: &mut Clock, at: Instant, wall_ms: u64) -> (Vec<JobId>, Expired) {
    let moved = match clock.follow(at, wall_ms) {
        0 => Vec::new(),
        by_ms => book.shift(by_ms),
    };
    (moved, book.expire(clock.ms(at)))
}

/// Forgets and fails expired jobs. Returns false when one could not be forgotten.
fn expire(shared: &JobsState) -> bool {
    let (moved, expired) = {
        let mut book = shared.book.lock();
        look(&mut book, &mut shared.clock.lock(), Instant::now(), wall_ms())
    };
    if !moved.is_empty() {
        tracing::warn!(
            jobs = moved.len(),
            "the system clock has jumped; expiry times of jobs were adjusted"
        );
    }
    for id in moved {
        // A failure is logged in `keep` and retried later.
        let _ = shared.keep(id);
        if let Ok(live) = shared.live(id) {
            live.changed();
        }
    }
    let mut is_fine = true;
    for record in expired.forgotten {
        let id = record.id;
        match shared.discard(record) {
            Ok(()) => tracing::info!(job = id, "deleted an expired job"),
            Err(error) => {
                tracing::error!(job = id, %error, "cannot delete an expired job");
                is_fine = false;
            }
        }
    }
    for id in expired.failed {
        // A failure is logged in `keep` and retried later.
        let _ = shared.keep(id);
        if let Ok(live) = shared.live(id) {
            live.changed();
        }
    }
    is_fine
}

/// Writes owed records to the database.
fn pay(shared: &JobsState) {
    for id in shared.store.owed() {
        let (is_known, is_held) = {
            let mut book = shared.book.lock();
            let known = (book.get(id).is_ok(), book.is_held(id));
            // The holder of the job writes the record.
            if !known.1 {
                book.hold(id);
            }
            known
        };
        if is_held {
            continue;
        }
        if is_known && shared.keep(id).is_ok() {
            tracing::info!(job = id, "the job's record is stored now");
            shared.drop_unwanted(id);
        }
        let live = shared.live(id).ok();
        if let Some(live) = &live {
            shared.recount(id, live);
        }
        let bytes = live.map_or(0, |live| live.bytes());
        // This deletes the files of a removed job.
        shared.release(id, bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::book::{Admitted, Limits, Need, Origin, Slots};
    use crate::jobs::spec::tests::spec;

    const HOUR_MS: u64 = 3_600_000;

    /// Whatever time the system's clock is set to, an ended job is kept for its time, and a waiting job waits for its time.
    #[test]
    fn a_clock_that_jumps_ends_no_job() {
        let slots = Slots { baking: 1, drawing: 1, coding: 1 };
        let limits = Limits { most_unfinished: 9, most: 9, ttl_ms: HOUR_MS, slots };
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut clock = Clock::new(start, 5 * HOUR_MS);
        let mut book = Book::new(limits, [], 0);
        let mut ids = Vec::new();
        for scene in ["ended", "away"] {
            let admitted = book.admit(spec(scene), Origin::default(), None, clock.ms(at(0)));
            let Ok(Admitted::New(id)) = admitted else { panic!("{admitted:?}") };
            ids.push(id);
        }
        book.cancel(ids[0], clock.ms(at(1000))).unwrap();
        book.note_missing(clock.ms(at(1000)), |_| Need::Missing("no scene".to_owned()));
        // The clock jumps a year ahead, back, and to 1970.
        let mut passed = 2000;
        for wall_ms in [9000 * HOUR_MS, 5 * HOUR_MS, 0] {
            let (moved, expired) = look(&mut book, &mut clock, at(passed), wall_ms);
            assert_eq!((moved, expired), (ids.clone(), Expired::default()), "{wall_ms}");
            passed += 1000;
            assert_eq!(
                look(&mut book, &mut clock, at(passed), wall_ms + 1000),
                (Vec::new(), Expired::default())
            );
            let age_ms = clock.ms(at(passed)) - book.get(ids[0]).unwrap().since_ms;
            // No job is older than 1970.
            assert!(age_ms == passed - 1000 || wall_ms == 0, "{age_ms} of {passed}");
        }
        // The jobs still expire when their time is over.
        let wall_ms = clock.ms(at(HOUR_MS + 10_000));
        let (_, expired) = look(&mut book, &mut clock, at(HOUR_MS + 10_000), wall_ms);
        assert_eq!(expired.failed, [ids[1]]);
        assert_eq!(expired.forgotten.len(), 1);
    }
}
