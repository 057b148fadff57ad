//! The queue of frames that wait: bounded, in order of arrival, and pure. It holds no lock, channel or clock.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// What the queue needs to know of a job.
pub trait Waiting {
    /// Nobody waits for it any more.
    fn is_abandoned(&self) -> bool;
    fn deadline(&self) -> Option<Instant>;
    /// Pixels to draw and read back.
    fn pixels(&self) -> u64;
}

/// Jobs in order of arrival.
#[derive(Debug)]
pub struct Queue<J> {
    jobs: VecDeque<J>,
    capacity: usize,
}

/// What came out of the queue.
#[derive(Debug)]
pub struct Taken<J> {
    /// To be drawn in one submission.
    pub batch: Vec<J>,
    /// Their deadline has passed.
    pub expired: Vec<J>,
    /// Nobody waits for them.
    pub abandoned: Vec<J>,
}

/// Frames of a batch hold this many pixels together at most, unless there is only one: results of a batch come back
/// together, so a large frame must not wait for another.
pub const BATCH_PIXELS: u64 = 1 << 20;

impl<J: Waiting> Queue<J> {
    pub fn new(capacity: usize) -> Self {
        Self { jobs: VecDeque::new(), capacity: capacity.max(1) }
    }

    pub fn len(&self) -> usize {
        self.jobs.len()
    }

    pub fn is_empty(&self) -> bool {
        self.jobs.is_empty()
    }

    /// Admits a job, or gives it back when the queue is full even after jobs that nobody waits for were dropped.
    /// Those are returned beside.
    pub fn admit(&mut self, job: J) -> (Result<(), J>, Vec<J>) {
        let mut dropped = Vec::new();
        if self.jobs.len() >= self.capacity {
            let (gone, kept): (VecDeque<J>, VecDeque<J>) =
                std::mem::take(&mut self.jobs).into_iter().partition(Waiting::is_abandoned);
            self.jobs = kept;
            dropped.extend(gone);
        }
        if self.jobs.len() >= self.capacity {
            return (Err(job), dropped);
        }
        self.jobs.push_back(job);
        (Ok(()), dropped)
    }

    /// Puts jobs back at the front, in their order, whatever the capacity: they had been admitted before.
    pub fn put_back(&mut self, jobs: Vec<J>) {
        for job in jobs.into_iter().rev() {
            self.jobs.push_front(job);
        }
    }

    /// Takes the next batch of at most `max` jobs.
    pub fn take(&mut self, max: usize, now: Instant) -> Taken<J> {
        let mut taken = Taken { batch: Vec::new(), expired: Vec::new(), abandoned: Vec::new() };
        let mut pixels = 0u64;
        while taken.batch.len() < max.max(1) {
            let Some(job) = self.jobs.pop_front() else { break };
            if job.is_abandoned() {
                taken.abandoned.push(job);
                continue;
            }
            if job.deadline().is_some_and(|deadline| deadline <= now) {
                taken.expired.push(job);
                continue;
            }
            let more = pixels.saturating_add(job.pixels());
            if !taken.batch.is_empty() && more > BATCH_PIXELS {
                self.jobs.push_front(job);
                break;
            }
            pixels = more;
            taken.batch.push(job);
        }
        taken
    }

    /// Empties the queue.
    pub fn drain(&mut self) -> Vec<J> {
        self.jobs.drain(..).collect()
    }
}

/// How long a newcomer would wait: the jobs before it times the measured time of one, at least 50 ms.
pub fn expected_wait(queued: usize, per_frame: Duration) -> Duration {
    (per_frame * queued as u32).max(Duration::from_millis(50))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug, PartialEq)]
    struct Job {
        number: usize,
        abandoned: bool,
        deadline: Option<Instant>,
        pixels: u64,
    }

    impl Waiting for Job {
        fn is_abandoned(&self) -> bool {
            self.abandoned
        }
        fn deadline(&self) -> Option<Instant> {
            self.deadline
        }
        fn pixels(&self) -> u64 {
            self.pixels
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]
        #[test]
        fn no_job_is_lost_doubled_or_overtaken(
            capacity in 1usize..20,
            max in 1usize..9,
            steps in prop::collection::vec((any::<bool>(), any::<bool>(), 0u8..3, 1u64..2_000_000), 1..120),
        ) {
            let start = Instant::now();
            let now = start + Duration::from_secs(10);
            let mut queue = Queue::new(capacity);
            let mut admitted = Vec::new();
            let mut out = Vec::new();
            for (number, (admit, abandoned, deadline, pixels)) in steps.into_iter().enumerate() {
                if admit {
                    let deadline = match deadline { 0 => None, 1 => Some(start), _ => Some(now + Duration::from_secs(1)) };
                    let job = Job { number, abandoned, deadline, pixels };
                    let (result, dropped) = queue.admit(job.clone());
                    prop_assert!(dropped.iter().all(|job| job.abandoned));
                    out.extend(dropped.into_iter().map(|job| job.number));
                    match result {
                        Ok(()) => admitted.push(number),
                        Err(back) => { prop_assert_eq!(back, job); prop_assert_eq!(queue.len(), capacity); }
                    }
                    prop_assert!(queue.len() <= capacity);
                } else {
                    let taken = queue.take(max, now);
                    prop_assert!(taken.batch.len() <= max);
                    let pixels: u64 = taken.batch.iter().map(|job| job.pixels).sum();
                    prop_assert!(taken.batch.len() <= 1 || pixels <= BATCH_PIXELS);
                    prop_assert!(taken.batch.iter().all(|job| !job.abandoned && job.deadline.is_none_or(|d| d > now)));
                    prop_assert!(taken.batch.windows(2).all(|pair| pair[0].number < pair[1].number));
                    for job in taken.batch.into_iter().chain(taken.expired).chain(taken.abandoned) {
                        out.push(job.number);
                    }
                }
            }
            out.extend(queue.drain().into_iter().map(|job| job.number));
            out.sort_unstable();
            prop_assert_eq!(out, admitted);
        }
    }

    #[test]
    fn what_is_put_back_comes_first_and_in_order() {
        let job = |number| Job { number, abandoned: false, deadline: None, pixels: 1 };
        let mut queue = Queue::new(2);
        assert!(queue.admit(job(3)).0.is_ok());
        queue.put_back(vec![job(1), job(2)]);
        let taken = queue.take(8, Instant::now());
        assert_eq!(taken.batch.iter().map(|job| job.number).collect::<Vec<_>>(), [1, 2, 3]);
    }
}
