//! The queue of drawn frames that wait for an encoder. It is pure, like the [parent module](super), and shares the same way: streams and
//! requests come before jobs, jobs get [`super::Shares::jobs`] of the time where others want all of it, and clients of one side get equal
//! times ([`Lanes`]).
//!
//! An encoder cannot be interrupted: 8192² pixels of PNG take it a quarter of a second. So there are two threads more than encoders, and
//! less urgent frames leave them to more urgent ones:
//!
//! | frames | are encoded at once at most |
//! |---|---|
//! | of jobs | `encoders` |
//! | of jobs and requests | `encoders + 1` |
//! | all | `encoders + 2`, the number of threads |

use std::time::Instant;

use super::cost::{CostKey, Costs};
use super::lanes::{Granted, Lanes};
use super::{Class, Client, MEMORY, Waiting};

/// Threads beyond the number of encoders.
const SPARE: usize = Class::ALL.len() - 1;
/// Frames that wait on one side for each encoder, before no more are drawn for that side.
const WAITING: usize = 2;

/// Drawn frames by side and client.
#[derive(Debug)]
pub struct EncodeQueue<J> {
    encoders: usize,
    job_share: f64,
    /// Streams and requests.
    first: Lanes<J>,
    jobs: Lanes<J>,
    costs: Costs,
    /// Time that jobs may have before others, in nanoseconds.
    credit_ns: f64,
    /// Frames that are being encoded, by class.
    running: [usize; Class::ALL.len()],
    granted: u64,
}

impl<J: Waiting> EncodeQueue<J> {
    pub fn new(encoders: usize, job_share: f64) -> Self {
        Self {
            encoders: encoders.max(1),
            job_share: job_share.clamp(0.001, 0.999),
            first: Lanes::default(),
            jobs: Lanes::default(),
            costs: Costs::default(),
            credit_ns: 0.0,
            running: [0; Class::ALL.len()],
            granted: 0,
        }
    }

    /// Number of frames that may be encoded at once.
    pub fn threads(&self) -> usize {
        self.encoders + SPARE
    }

    pub fn is_empty(&self) -> bool {
        self.first.is_empty() && self.jobs.is_empty()
    }

    /// Whether another frame of `class` may be drawn: few wait to be encoded.
    pub fn has_room(&self, class: Class) -> bool {
        let side = if class == Class::Job { &self.jobs } else { &self.first };
        side.len() < WAITING * self.encoders
    }

    pub fn push(&mut self, client: Client, frame: J, key: CostKey, now: Instant) {
        let cost_ns = self.costs.estimate_ns(key);
        self.side(client.class()).push(client, frame, cost_ns, now);
    }

    /// Moves a frame that waits as one of `job` to the lane of `client`, who is more urgent.
    pub fn advance(
        &mut self,
        job: Client,
        client: Client,
        is_it: impl Fn(&J) -> bool,
        key: CostKey,
        now: Instant,
    ) {
        if let Some(frame) = self.jobs.remove(job, is_it) {
            self.push(client, frame, key, now);
        }
    }

    /// Takes the next frame to encode, if a thread may begin one. [`EncodeQueue::done`] follows.
    pub fn take(&mut self) -> Option<Granted<J>> {
        let (turn, is_idle) = (self.granted + 1, self.running.iter().all(|&count| count == 0));
        let oldest = turn.saturating_sub(MEMORY);
        for side in [&mut self.first, &mut self.jobs] {
            side.forget(oldest, turn, is_idle);
            side.count_parts(oldest);
        }
        let is_jobs_turn = self.credit_ns > 0.0;
        let early = if is_jobs_turn { self.take_from(Class::Job) } else { None };
        if let Some(granted) = &early {
            self.credit_ns -= granted.cost_ns as f64;
        }
        let first = early.or_else(|| {
            let granted = self.take_from(Class::Request)?;
            if !self.jobs.is_empty() {
                let share = self.job_share;
                self.credit_ns += granted.cost_ns as f64 * share / (1.0 - share);
            }
            Some(granted)
        });
        let granted = first.or_else(|| self.take_from(Class::Job))?;
        if self.jobs.is_empty() {
            self.credit_ns = self.credit_ns.min(0.0);
        }
        self.running[granted.client.class() as usize] += 1;
        self.granted = turn;
        Some(granted)
    }

    /// Takes the next frame of the side of `class` that a thread may begin.
    fn take_from(&mut self, class: Class) -> Option<Granted<J>> {
        let may_begin = Class::ALL.map(|class| self.may_begin(class));
        let turn = self.granted + 1;
        let side = self.side(class);
        let mut held = Vec::new();
        loop {
            let (client, _) = side.next(&held)?;
            if may_begin[client.class() as usize] {
                return side.grant(client, turn);
            }
            held.push(client);
        }
    }

    /// Whether there is a thread for a frame of `class`.
    fn may_begin(&self, class: Class) -> bool {
        (0..=class as usize).all(|class| {
            let no_more_urgent: usize = self.running[class..].iter().sum();
            no_more_urgent < self.encoders + SPARE - class
        })
    }

    /// A frame that was taken is encoded, in `measured_ns`.
    pub fn done(&mut self, client: Client, charged_ns: u64, key: CostKey, measured_ns: u64) {
        let running = &mut self.running[client.class() as usize];
        *running = running.saturating_sub(1);
        self.costs.measured(key, measured_ns);
        self.side(client.class()).correct(client, charged_ns, measured_ns);
    }

    fn side(&mut self, class: Class) -> &mut Lanes<J> {
        if class == Class::Job { &mut self.jobs } else { &mut self.first }
    }
}

#[cfg(test)]
mod tests;
