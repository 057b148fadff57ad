//! A simulated device behind the engine's queue, on a clock of the caller's.
//!
//! The device draws one batch at a time and has one more recorded, as the render thread does. The queue and its estimates are the engine's own;
//! a frame takes the time that it carries, which the queue learns when the frame is drawn. The caller tells the time, and what clients do:
//!
//! ```text
//! admit ──▶ queue ──take──▶ in flight (2 at most) ──land──▶ the caller
//! ```

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::cost::{CostKey, Costs};
use super::{Class, Client, Granted, Moment, Queue, Shares, Taken, Waiting};

/// Submissions in flight, as in the render thread.
const DEPTH: usize = 2;

/// A frame that a simulated client asked for.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// The caller's number of the client.
    pub client: usize,
    /// When the client asked for it first.
    pub asked_ns: u64,
    pub pixels: u64,
    /// Kind of the frame, by which its cost is estimated.
    pub kind: u64,
    /// Device time that the frame takes.
    pub cost_ns: u64,
}

impl Frame {
    fn key(&self) -> CostKey {
        CostKey { kind: self.kind, pixels: self.pixels }
    }
}

impl Waiting for Frame {
    fn is_abandoned(&self) -> bool {
        false
    }
    fn deadline(&self) -> Option<Instant> {
        None
    }
    fn pixels(&self) -> u64 {
        self.pixels
    }
}

#[derive(Debug)]
struct Flight {
    batch: Vec<Granted<Frame>>,
    lands_ns: u64,
}

/// What the render thread waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// The first batch in flight lands at this time. The thread is busy until then.
    Landing(u64),
    /// A request comes, or this time.
    Request(Option<u64>),
}

/// The queue, its estimates and a device.
#[derive(Debug)]
pub struct Device {
    queue: Queue<Frame>,
    costs: Costs,
    start: Instant,
    most_frames: usize,
    /// Device time of a submission beside its frames.
    submit_ns: u64,
    flights: VecDeque<Flight>,
    /// When the device is free.
    free_ns: u64,
    busy_ns: u64,
}

impl Device {
    /// Makes a device whose clock begins at `start`. A batch has `most_frames` frames at most.
    pub fn new(shares: Shares, most_frames: usize, submit_ns: u64, start: Instant) -> Device {
        Device {
            queue: Queue::new(shares),
            costs: Costs::default(),
            start,
            most_frames,
            submit_ns,
            flights: VecDeque::new(),
            free_ns: 0,
            busy_ns: 0,
        }
    }

    fn at(&self, ns: u64) -> Instant {
        self.start + Duration::from_nanos(ns)
    }

    /// Admits a frame at `now_ns`, which is later than its request if the client was refused before.
    ///
    /// # Errors
    /// The queue is full. The value is the time after which the engine would tell the client to come again, in nanoseconds.
    pub fn admit(&mut self, client: Client, frame: Frame, now_ns: u64) -> Result<(), u64> {
        let cost_ns = self.costs.estimate_ns(frame.key());
        let now = self.at(now_ns);
        let (admitted, _) = self.queue.admit(client, frame, cost_ns, now);
        let backlog = self.costs.duration(self.queue.backlog_ns(client.class()));
        admitted.map_err(|_| u64::try_from(backlog.as_nanos()).unwrap_or(u64::MAX))
    }

    /// Returns the number of frames that wait or are drawn.
    pub fn frames(&self) -> usize {
        self.queue.len() + self.flights.iter().map(|flight| flight.batch.len()).sum::<usize>()
    }

    /// Returns the device time of everything that has landed.
    pub fn busy_ns(&self) -> u64 {
        self.busy_ns
    }

    /// Takes everything that waits or is drawn: the process is killed.
    pub fn kill(&mut self) -> Vec<Frame> {
        let flying = self.flights.drain(..).flat_map(|flight| flight.batch);
        let mut frames: Vec<Frame> = flying.map(|granted| granted.job).collect();
        frames.extend(self.queue.drain());
        frames
    }

    /// Takes the next batch, and returns when jobs that are held back may be drawn.
    fn submit(&mut self, now_ns: u64) -> Option<u64> {
        let flying = self.flights.iter().flat_map(|flight| &flight.batch);
        let moment = Moment {
            now: self.at(now_ns),
            flying_ns: flying.clone().map(|granted| granted.cost_ns).sum(),
            are_jobs_flying: flying.clone().any(|granted| granted.client.class() == Class::Job),
            are_streams_open: false,
            are_jobs_held: false,
        };
        let Taken { batch, held_for, .. } = self.queue.take(self.most_frames, moment);
        if !batch.is_empty() {
            let ns: u64 = batch.iter().map(|granted| granted.job.cost_ns).sum();
            // It is drawn when the one before has landed.
            self.free_ns = self.free_ns.max(now_ns) + ns + self.submit_ns;
            self.flights.push_back(Flight { batch, lands_ns: self.free_ns });
        }
        held_for.map(|held| now_ns + held.as_nanos() as u64)
    }

    /// Works as the render thread does, until it waits.
    pub fn work(&mut self, now_ns: u64) -> Until {
        let mut held_ns = self.submit(now_ns);
        let is_deep = |device: &Device| device.flights.len() >= DEPTH || device.queue.is_empty();
        if !self.flights.is_empty() && !is_deep(self) {
            held_ns = self.submit(now_ns);
        }
        match self.flights.front() {
            Some(flight) => Until::Landing(flight.lands_ns),
            None => Until::Request(held_ns),
        }
    }

    /// Lands the first batch in flight, and returns its frames in their order.
    pub fn land(&mut self, now_ns: u64) -> Vec<Frame> {
        let Some(flight) = self.flights.pop_front() else { return Vec::new() };
        let now = self.at(now_ns);
        let mut frames = Vec::with_capacity(flight.batch.len());
        for Granted { client, cost_ns, job } in flight.batch {
            self.queue.settle(client, cost_ns, job.cost_ns);
            self.queue.landed(client, now);
            self.costs.measured(job.key(), job.cost_ns);
            self.busy_ns += job.cost_ns;
            frames.push(job);
        }
        frames
    }
}

#[cfg(test)]
mod tests;
