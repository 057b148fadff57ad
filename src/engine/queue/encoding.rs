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
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const JOB: Client = Client::Job(1);
    const STREAM: Client = Client::Stream { of: 1, number: 1 };

    #[derive(Debug, PartialEq)]
    struct Frame(u32);

    impl Waiting for Frame {
        fn is_abandoned(&self) -> bool {
            false
        }
        fn deadline(&self) -> Option<Instant> {
            None
        }
        fn pixels(&self) -> u64 {
            1
        }
    }

    /// Clients whose frames take so many milliseconds.
    struct Bench {
        queue: EncodeQueue<Frame>,
        now: Instant,
        running: Vec<Granted<Frame>>,
    }

    fn key(client: Client) -> CostKey {
        let kind = match client {
            Client::Unnamed => 0,
            Client::Caller(n) | Client::Job(n) | Client::Stream { number: n, .. } => n,
        };
        CostKey { kind: 4 * kind + client.class() as u64, pixels: 1 }
    }

    impl Bench {
        fn new(encoders: usize) -> Bench {
            let queue = EncodeQueue::new(encoders, 0.1);
            Bench { queue, now: Instant::now(), running: Vec::new() }
        }

        fn push(&mut self, client: Client, count: u32) {
            for number in 0..count {
                self.queue.push(client, Frame(number), key(client), self.now);
            }
        }

        /// All frames that threads may begin.
        fn begin(&mut self) -> Vec<Client> {
            let begun: Vec<_> = std::iter::from_fn(|| self.queue.take()).collect();
            let clients = begun.iter().map(|granted| granted.client).collect();
            self.running.extend(begun);
            clients
        }

        fn end(&mut self, ms: impl Fn(Client) -> u64) {
            let Granted { client, cost_ns, .. } = self.running.remove(0);
            self.queue.done(client, cost_ns, key(client), ms(client) * MS);
        }
    }

    #[test]
    fn jobs_leave_threads_to_more_urgent_frames() {
        for encoders in 1..4 {
            let mut bench = Bench::new(encoders);
            bench.push(JOB, 9);
            assert_eq!(bench.begin(), vec![JOB; encoders], "no more of jobs at once");
            assert!(!bench.queue.has_room(Class::Job) || encoders > 1);
            assert!(bench.queue.has_room(Class::Request));
            bench.push(Client::Caller(2), 3);
            assert_eq!(bench.begin(), [Client::Caller(2)]);
            bench.push(STREAM, 2);
            assert_eq!(bench.begin(), [STREAM], "there is a thread for streams alone");
            assert_eq!(bench.running.len(), bench.queue.threads());
            // Others have waited longer, and may not have the stream's thread when it is free.
            let last = bench.running.len() - 1;
            bench.running.swap(0, last);
            bench.end(|_| 1);
            assert_eq!(bench.begin(), [STREAM]);
        }
    }

    #[test]
    fn requests_come_before_jobs_and_leave_them_a_share() {
        let mut bench = Bench::new(1);
        let mut got = [0; 2];
        for round in 0..4000 {
            let lacks = |side: &Lanes<Frame>| u32::from(side.len() < 3);
            let (jobs, requests) = (lacks(&bench.queue.jobs), lacks(&bench.queue.first));
            bench.push(JOB, jobs);
            bench.push(Client::Caller(2), requests);
            for client in bench.begin() {
                // The first frames are charged what a frame costs of which nothing is known.
                got[usize::from(client == JOB)] += u64::from(round > 200);
            }
            bench.end(|client| if client == JOB { 40 } else { 8 });
        }
        let share = 40.0 * got[1] as f64 / (40.0 * got[1] as f64 + 8.0 * got[0] as f64);
        assert!((0.08..0.12).contains(&share), "{share}: {got:?}");
    }

    #[test]
    fn clients_share_by_time() {
        let mut bench = Bench::new(2);
        let clients = [Client::Caller(1), Client::Caller(2), Client::Caller(3)];
        let ms = |client: Client| if client == clients[0] { 90 } else { 10 };
        let mut got = [0u64; 3];
        for client in clients {
            bench.push(client, 3);
        }
        for _ in 0..4000 {
            for client in bench.begin() {
                bench.push(client, 1);
                let at = clients.iter().position(|other| *other == client).unwrap();
                got[at] += ms(client);
            }
            bench.end(ms);
        }
        let (least, most) = (got.iter().min().unwrap(), got.iter().max().unwrap());
        assert!(most - least < most / 20, "{got:?}");
    }

    #[test]
    fn a_frame_that_somebody_else_asks_for_comes_forward() {
        let mut bench = Bench::new(1);
        bench.push(JOB, 3);
        assert_eq!(bench.begin(), [JOB]);
        let key = key(JOB);
        bench.queue.advance(JOB, Client::Caller(2), |frame| frame.0 == 2, key, bench.now);
        assert_eq!(bench.begin(), [Client::Caller(2)]);
        assert_eq!(bench.running[1].job, Frame(2));
        assert_eq!(bench.queue.jobs.len(), 1);
    }
}
