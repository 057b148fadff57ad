//! The queue of waiting frames: bounded, fair, and pure. It holds no lock, channel or clock.
//!
//! Three classes share the device. Streams and plain requests form one side and come first; jobs form the other and get the
//! remaining time, or the share [`Shares::jobs`] where nothing remains. On each side clients share by device time ([`lanes`]): a
//! client of 4K frames and one of thumbnails get equal time, whatever that is in frames. Streams and requests of one caller count
//! as one client.
//!
//! ```text
//!  stream  ─▶ lane ─┐
//!  request ─▶ lane ─┴─ least time first ─▶┐
//!                                         ├─▶ batch: one side's alone
//!  job     ─▶ lane ─── least time first ─▶┘
//!                      when nothing else waits, or as credit allows:
//!                      credit += cost · share / (1 − share)   for each other frame, and for the pauses of others, while jobs wait
//!                      credit −= cost                         for each frame of a job
//! ```
//!
//! While several clients are active (waiting, or served in the last few batches), each gets at most one frame of a batch, or
//! [`SHARE_NS`] of small ones. Otherwise a stream, which has only one frame waiting at a time, would wait for many frames of a
//! client that has a hundred. For the same reason batches are short while there are streams, and batches of jobs are shortest.
//! While others are active, no batch of jobs follows another in flight, so that a frame waits for at most one batch of jobs. A
//! batch of jobs out of its turn does not go in behind the frame of a stream, or of a client that asks for one frame after the
//! other, nor in the pause after it, unless the batch ends before the next request is expected ([`pause_predictor`]): a frame cannot be
//! interrupted, and the next pose would find the device taken.
//!
//! Costs are estimates ([`cost`]), corrected when a frame was measured ([`Queue::settle`]).

pub mod cost;
pub mod encoding;
mod lanes;
mod pause_predictor;
pub mod simulation;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

pub use lanes::Granted;
use lanes::Lanes;
use pause_predictor::PausePredictor;

/// The queue's view of a job.
pub trait Waiting {
    /// Returns whether nobody waits for it any more.
    fn is_abandoned(&self) -> bool;
    fn deadline(&self) -> Option<Instant>;
    /// Pixels to draw and read back.
    fn pixels(&self) -> u64;
}

/// A client, one of those who share the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Client {
    /// All callers without a name together.
    #[default]
    Unnamed,
    /// The caller of plain requests; the number is chosen by the engine's caller.
    Caller(u64),
    /// One stream, with its own number and that of its caller. A caller's streams and requests together get one client's share.
    Stream { of: u64, number: u64 },
    /// The frames of one job; the number is chosen by the engine's caller.
    Job(u64),
}

/// How urgent a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// A frame of a stream, where the view moves.
    Interactive,
    /// A plain request.
    Request,
    /// A frame of a job, where nobody waits for single frames.
    Job,
}

impl Class {
    pub const ALL: [Class; 3] = [Class::Interactive, Class::Request, Class::Job];

    pub fn name(self) -> &'static str {
        match self {
            Class::Interactive => "interactive",
            Class::Request => "request",
            Class::Job => "job",
        }
    }
}

impl Client {
    /// Returns the caller with whom it shares the device.
    pub fn owner(self) -> Option<u64> {
        match self {
            Client::Stream { of, .. } | Client::Caller(of) => Some(of),
            Client::Unnamed | Client::Job(_) => None,
        }
    }

    pub fn class(self) -> Class {
        match self {
            Client::Stream { .. } => Class::Interactive,
            Client::Unnamed | Client::Caller(_) => Class::Request,
            Client::Job(_) => Class::Job,
        }
    }
}

/// Limits of the queue and shares of the device.
#[derive(Clone, Copy, Debug)]
pub struct Shares {
    /// Largest number of waiting jobs of streams and requests together; half as many of [`Class::Job`] may wait besides.
    pub capacity: usize,
    /// Largest estimated device time of waiting jobs, in nanoseconds; likewise half of it besides.
    pub capacity_ns: u64,
    /// Minimum share of the device's time for [`Class::Job`]: above 0, below 1.
    pub jobs: f64,
    /// Largest device time of a batch, in nanoseconds; see [`BATCH_NS`].
    pub batch_ns: u64,
}

/// State of the engine when a batch is taken.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    pub now: Instant,
    /// Estimated device time in flight.
    pub flying_ns: u64,
    /// Whether frames of jobs are in flight.
    pub are_jobs_flying: bool,
    /// Whether there are streams, even if they have not asked for a frame lately.
    pub are_streams_open: bool,
    /// Whether so many frames of jobs wait to be encoded that no more are drawn.
    pub are_jobs_held: bool,
}

/// Result of taking a batch.
#[derive(Debug)]
pub struct Taken<J> {
    /// Jobs to draw in one submission.
    pub batch: Vec<Granted<J>>,
    /// Jobs whose deadline has passed.
    pub expired: Vec<J>,
    /// Jobs that nobody waits for.
    pub abandoned: Vec<J>,
    /// Nothing was taken, because somebody is about to ask or encoders are behind: how long jobs wait for that.
    pub held_for: Option<Duration>,
}

/// Largest number of pixels of a batch, unless it has only one frame: results of a batch come back together, so a large frame
/// must not delay another.
pub const BATCH_PIXELS: u64 = 1 << 20;
/// Default of the largest device time of a batch, unless it is one frame, for the same reason and because longer batches gain nothing.
pub const BATCH_NS: u64 = 100_000_000;
/// Largest device time of a batch while there are streams.
pub const INTERACTIVE_BATCH_NS: u64 = 32_000_000;
/// Largest device time of a batch of jobs while others are active.
pub const JOB_BATCH_NS: u64 = 16_000_000;
/// Largest device time of one client's frames in a batch, unless it is one frame, or no more than another's, or no other client
/// is active. Also the largest lead over others with which a client still gets into a batch with them.
pub const SHARE_NS: u64 = 2_000_000;
/// Largest debt of jobs for using the device while nobody else wanted it.
pub const MOST_DEBT_NS: i64 = 100_000_000;

/// Number of batches for which a client counts as active after it was served.
const MEMORY: u64 = 8;

/// Waiting jobs by side, class and client.
#[derive(Debug)]
pub struct Queue<J> {
    shares: Shares,
    /// Jobs that were taken and given back: they are next.
    returned: VecDeque<Granted<J>>,
    returned_ns: u64,
    /// Lanes of streams and requests.
    first: Lanes<J>,
    jobs: Lanes<J>,
    /// Device time that jobs may have before others, in nanoseconds.
    credit_ns: i64,
    /// Whether the last batch was of jobs.
    were_jobs_last: bool,
    /// Pauses of streams and requests.
    pauses: PausePredictor,
    /// Time since which the device is idle because jobs wait for a client to ask.
    held_since: Option<Instant>,
    batches: u64,
    /// Device time in flight when the last batch had been taken.
    flying_ns: u64,
}

impl<J: Waiting> Queue<J> {
    pub fn new(shares: Shares) -> Self {
        let jobs = shares.jobs.clamp(0.001, 0.999);
        Self {
            shares: Shares { capacity: shares.capacity.max(1), jobs, ..shares },
            returned: VecDeque::new(),
            returned_ns: 0,
            first: Lanes::default(),
            jobs: Lanes::default(),
            credit_ns: 0,
            were_jobs_last: false,
            pauses: PausePredictor::default(),
            held_since: None,
            batches: 0,
            flying_ns: 0,
        }
    }

    pub fn len(&self) -> usize {
        self.returned.len() + self.first.len() + self.jobs.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn side(&mut self, class: Class) -> &mut Lanes<J> {
        match class {
            Class::Interactive | Class::Request => &mut self.first,
            Class::Job => &mut self.jobs,
        }
    }

    /// Admits a job with estimated cost `cost_ns`, or returns it if the queue is full even after dropping abandoned jobs. Also
    /// returns the dropped jobs.
    ///
    /// A client with nothing waiting is admitted up to twice the limits, so that one client that fills the queue does not keep
    /// the others out.
    pub fn admit(
        &mut self,
        client: Client,
        job: J,
        cost_ns: u64,
        now: Instant,
    ) -> (Result<(), J>, Vec<J>) {
        let dropped =
            if self.has_room(client, cost_ns) { Vec::new() } else { self.drop_abandoned() };
        if !self.has_room(client, cost_ns) {
            return (Err(job), dropped);
        }
        if client.class() != Class::Job {
            self.pauses.asked(client, now);
        }
        self.side(client.class()).push(client, job, cost_ns, now);
        (Ok(()), dropped)
    }

    /// Records that a client's frame is drawn and about to be sent.
    pub fn landed(&mut self, client: Client, now: Instant) {
        if client.class() != Class::Job {
            self.pauses.landed(client, now);
        }
    }

    fn has_room(&self, client: Client, cost_ns: u64) -> bool {
        let Shares { capacity, capacity_ns, .. } = self.shares;
        let (side, mut most, mut most_ns) = match client.class() {
            Class::Job => (&self.jobs, capacity.div_ceil(2), capacity_ns / 2),
            _ => (&self.first, capacity, capacity_ns),
        };
        if !side.has_lane(client) {
            most = most.saturating_mul(2);
            most_ns = most_ns.saturating_mul(2);
        }
        // A job that costs more than the limit waits alone.
        let fits_time = side.is_empty() || side.cost_ns().saturating_add(cost_ns) <= most_ns;
        side.len() < most && fits_time
    }

    fn drop_abandoned(&mut self) -> Vec<J> {
        let mut dropped = self.first.drop_abandoned();
        dropped.extend(self.jobs.drop_abandoned());
        let returned = std::mem::take(&mut self.returned);
        for granted in returned {
            if granted.job.is_abandoned() {
                self.returned_ns -= granted.cost_ns;
                dropped.push(granted.job);
            } else {
                self.returned.push_back(granted);
            }
        }
        dropped
    }

    /// Returns whether a job of `client` waits in its lane.
    pub fn holds(&self, client: Client, is_it: impl Fn(&J) -> bool) -> bool {
        self.first.holds(client, &is_it) || self.jobs.holds(client, is_it)
    }

    /// Replaces a waiting job of `client` by `new` and returns the old job; returns `new` if the old job no longer waits.
    pub fn replace(
        &mut self,
        client: Client,
        is_old: impl Fn(&J) -> bool,
        new: J,
        cost_ns: u64,
    ) -> Result<J, J> {
        self.side(client.class()).replace(client, is_old, new, cost_ns)
    }

    /// Removes a job of `client` from its lane.
    pub fn remove(&mut self, client: Client, is_it: impl Fn(&J) -> bool) -> Option<J> {
        self.side(client.class()).remove(client, is_it)
    }

    /// Puts a job first in a client's lane, beyond the limits: it had been admitted before, for another client.
    pub fn hand_over(&mut self, client: Client, job: J, cost_ns: u64, now: Instant) {
        self.side(client.class()).push_front(client, job, cost_ns, now);
    }

    /// Puts jobs back at the front in their order, beyond the limits: they had been admitted before. Frames of jobs come first
    /// only in their own lanes.
    pub fn put_back(&mut self, granted: Vec<Granted<J>>, now: Instant) {
        for granted in granted.into_iter().rev() {
            self.settle(granted.client, granted.cost_ns, 0);
            if granted.client.class() == Class::Job {
                self.jobs.push_front(granted.client, granted.job, granted.cost_ns, now);
            } else {
                self.returned_ns += granted.cost_ns;
                self.returned.push_front(granted);
            }
        }
    }

    /// Corrects a client's charge for a frame that cost `measured_ns`.
    pub fn settle(&mut self, client: Client, charged_ns: u64, measured_ns: u64) {
        let more_ns = signed(measured_ns).saturating_sub(signed(charged_ns));
        let class = client.class();
        self.side(class).correct(client, charged_ns, measured_ns);
        if class == Class::Job {
            // The debt is limited to that of one frame, because nobody knew its cost.
            let most = MOST_DEBT_NS.max(signed(measured_ns));
            self.credit_ns = self.credit_ns.saturating_sub(more_ns).max(-most);
        } else if !self.jobs.is_empty() {
            self.earn(more_ns as f64);
        }
    }

    /// Adds credit for jobs that wait while others get `ns` of the device.
    fn earn(&mut self, ns: f64) {
        let share = self.shares.jobs;
        self.credit_ns = self.credit_ns.saturating_add((ns * share / (1.0 - share)) as i64);
    }

    /// Charges jobs for `ns` of the device; `is_left_over` if nobody else wanted it.
    fn spend(&mut self, ns: u64, is_left_over: bool) {
        let left = self.credit_ns.saturating_sub(signed(ns));
        let least = if is_left_over { self.credit_ns.min(-MOST_DEBT_NS) } else { i64::MIN };
        self.credit_ns = left.max(least);
    }

    /// Takes the next batch of at most `max` jobs.
    pub fn take(&mut self, max: usize, moment: Moment) -> Taken<J> {
        let batch = self.batches + 1;
        let oldest = batch.saturating_sub(MEMORY);
        let is_idle = moment.flying_ns == 0;
        for side in [&mut self.first, &mut self.jobs] {
            side.forget(oldest, batch, is_idle);
            side.count_parts(oldest);
        }
        let mut taken =
            Taken { batch: Vec::new(), expired: Vec::new(), abandoned: Vec::new(), held_for: None };
        let max = max.max(1);
        self.take_returned(max, moment.now, &mut taken);
        let is_stream = |client: Client| client.class() == Class::Interactive;
        let is_watched = moment.are_streams_open || self.first.about(oldest).any(is_stream);
        let are_others_about = is_watched || self.first.about(oldest).next().is_some();
        // A client's next frame may have to wait for one batch of jobs, and no more.
        let is_one_enough = is_watched || are_others_about && self.first.is_empty();
        let may_jobs = !(moment.are_jobs_held || is_one_enough && moment.are_jobs_flying);
        let was_their_turn = is_watched && self.were_jobs_last;
        let expected = self.pauses.expected(moment.now);
        if let Some(since) = self.held_since.take() {
            // The device was kept idle for others.
            self.earn(moment.now.saturating_duration_since(since).as_nanos() as f64);
        }
        let is_jobs_turn = may_jobs && !was_their_turn && self.credit_ns > 0;
        let mut of_jobs = false;
        if taken.batch.is_empty() && is_jobs_turn {
            let is_left_over =
                self.first.is_empty() && self.returned.is_empty() && expected.is_none();
            let room = Room { max, are_others_about, is_left_over, free: None };
            of_jobs = self.take_jobs(room, moment.now, &mut taken);
        }
        if !of_jobs && self.returned.is_empty() {
            let limit_ns = if is_watched { INTERACTIVE_BATCH_NS } else { self.shares.batch_ns };
            let is_alone = self.first.about(oldest).nth(1).is_none();
            let frame = Frame { max, limit_ns, is_alone, batch, now: moment.now };
            let ns = compose(&mut self.first, frame, &mut taken);
            if !self.jobs.is_empty() && !moment.are_jobs_held {
                self.earn(ns as f64);
            }
        }
        let follows = |client| is_stream(client) || self.pauses.is_quick(client);
        let is_followed = moment.flying_ns > 0 && self.first.about(oldest).any(follows);
        if taken.batch.is_empty() && may_jobs && !is_followed {
            let free = expected.map(|expected| expected.free);
            let room = Room { max, are_others_about, is_left_over: true, free };
            of_jobs = self.take_jobs(room, moment.now, &mut taken);
            let is_held = taken.batch.is_empty() && !self.jobs.is_empty();
            if let Some(expected) = expected.filter(|_| is_held && is_idle) {
                taken.held_for = Some(expected.until);
                self.held_since = Some(moment.now);
            }
        }
        if moment.are_jobs_held && is_idle && taken.batch.is_empty() && !self.jobs.is_empty() {
            taken.held_for = Some(Duration::MAX);
        }
        if !taken.batch.is_empty() {
            self.batches = batch;
            self.were_jobs_last = of_jobs;
        }
        if self.jobs.is_empty() {
            self.credit_ns = self.credit_ns.min(0);
        }
        let batch_ns: u64 = taken.batch.iter().map(|granted| granted.cost_ns).sum();
        self.flying_ns = moment.flying_ns.saturating_add(batch_ns);
        taken
    }

    fn take_returned(&mut self, max: usize, now: Instant, taken: &mut Taken<J>) {
        let mut pixels = 0u64;
        while taken.batch.len() < max {
            let Some(granted) = self.returned.pop_front() else { break };
            let Granted { client, cost_ns, .. } = granted;
            let job = granted.job;
            if job.is_abandoned() {
                taken.abandoned.push(job);
            } else if is_late(&job, now) {
                taken.expired.push(job);
            } else if !fits(pixels, &job) {
                self.returned.push_front(Granted { client, cost_ns, job });
                break;
            } else {
                pixels = pixels.saturating_add(job.pixels());
                self.first.charge(client, cost_ns, self.batches + 1);
                if !self.jobs.is_empty() {
                    self.earn(cost_ns as f64);
                }
                taken.batch.push(Granted { client, cost_ns, job });
            }
            self.returned_ns -= cost_ns;
        }
    }

    /// Takes a batch of jobs; returns whether there were any.
    fn take_jobs(&mut self, room: Room, now: Instant, taken: &mut Taken<J>) -> bool {
        let Room { max, are_others_about, is_left_over, free } = room;
        let free_ns = free.map_or(u64::MAX, |free| free.as_nanos() as u64);
        let next = self.jobs.next(&[]).and_then(|(client, _)| self.jobs.front(client));
        // Jobs that are abandoned or late are taken out in any case.
        let is_alive = |job: &J| !job.is_abandoned() && !is_late(job, now);
        if next.is_some_and(|(job, cost_ns)| is_alive(job) && cost_ns > free_ns) {
            return false;
        }
        let limit_ns = if are_others_about { JOB_BATCH_NS } else { self.shares.batch_ns };
        // Their times alone make the shares equal, because all of them always have frames waiting.
        let limit_ns = limit_ns.min(free_ns);
        let frame = Frame { max, limit_ns, is_alone: true, batch: self.batches + 1, now };
        let ns = compose(&mut self.jobs, frame, taken);
        self.spend(ns, is_left_over);
        ns > 0
    }

    /// Returns the estimated device time until a job of `client`, added now, would begin, plus the job's own cost.
    pub fn ahead_ns(
        &self,
        client: Client,
        deadline: Option<Instant>,
        cost_ns: u64,
        now: Instant,
    ) -> u64 {
        let share = self.shares.jobs;
        let under_way_ns = self.flying_ns.saturating_add(self.returned_ns);
        if client.class() == Class::Job {
            let own_ns = self.jobs.ahead_ns(client, deadline, cost_ns, now);
            // Others go before everything that exceeds the share of jobs.
            let most_ns = (own_ns.saturating_add(cost_ns)) as f64 * (1.0 - share) / share;
            let others_ns = self.first.cost_ns().min(most_ns as u64);
            return under_way_ns.saturating_add(own_ns).saturating_add(others_ns);
        }
        let own_ns = self.first.ahead_ns(client, deadline, cost_ns, now);
        let of_jobs = (own_ns as f64 * share / (1.0 - share)) as u64;
        let of_jobs = of_jobs.min(self.jobs.cost_ns());
        under_way_ns.saturating_add(own_ns).saturating_add(of_jobs)
    }

    /// Returns the device time of work in flight and of jobs that wait on the side of `class`.
    pub fn backlog_ns(&self, class: Class) -> u64 {
        let first_ns = self.first.cost_ns().saturating_add(self.returned_ns);
        let jobs_ns = if class == Class::Job { self.jobs.cost_ns() } else { 0 };
        self.flying_ns.saturating_add(first_ns).saturating_add(jobs_ns)
    }

    /// Sets the estimated device time in flight.
    pub fn set_flying_ns(&mut self, flying_ns: u64) {
        self.flying_ns = flying_ns;
    }

    /// Empties the queue.
    pub fn drain(&mut self) -> Vec<J> {
        self.returned_ns = 0;
        let mut jobs: Vec<J> = self.returned.drain(..).map(|granted| granted.job).collect();
        jobs.extend(self.first.drain());
        jobs.extend(self.jobs.drain());
        jobs
    }
}

/// Limits of a batch of jobs.
#[derive(Clone, Copy)]
struct Room {
    max: usize,
    are_others_about: bool,
    /// Whether no other client wants the time.
    is_left_over: bool,
    /// Time until another client may ask.
    free: Option<Duration>,
}

/// Limits of a batch.
#[derive(Clone, Copy)]
struct Frame {
    max: usize,
    limit_ns: u64,
    /// Whether one client may fill the batch.
    is_alone: bool,
    /// Number of the batch.
    batch: u64,
    now: Instant,
}

/// Adds jobs of one side to a batch, and returns their cost.
fn compose<J: Waiting>(side: &mut Lanes<J>, frame: Frame, taken: &mut Taken<J>) -> u64 {
    let mut batch_ns: u64 = taken.batch.iter().map(|granted| granted.cost_ns).sum();
    let mut pixels: u64 = taken.batch.iter().map(|granted| granted.job.pixels()).sum();
    let before_ns = batch_ns;
    let (mut sated, mut served) = (Vec::new(), Vec::new());
    // Time of each of `served` in this batch.
    let mut parts_ns: Vec<u64> = Vec::new();
    while taken.batch.len() < frame.max {
        let Some((client, time_ns)) = side.next(&sated) else { break };
        let Some((job, cost_ns)) = side.front(client) else { break };
        if job.is_abandoned() {
            taken.abandoned.extend(side.discard(client));
            continue;
        }
        if is_late(job, frame.now) {
            taken.expired.extend(side.discard(client));
            continue;
        }
        let is_empty = taken.batch.is_empty();
        let has_had_more = time_ns > side.least_time_ns(&served).saturating_add(SHARE_NS);
        let is_long = batch_ns.saturating_add(cost_ns) > frame.limit_ns;
        if !is_empty && (has_had_more || is_long) || !fits(pixels, job) {
            break;
        }
        let at = served.iter().position(|other| *other == client).unwrap_or(served.len());
        if at == served.len() {
            served.push(client);
            parts_ns.push(0);
        }
        let others = parts_ns.iter().enumerate().filter(|(other, _)| *other != at);
        let most_ns = others.map(|(_, ns)| *ns).max().unwrap_or(0).max(SHARE_NS);
        let Some(part_ns) = parts_ns.get_mut(at) else { break };
        if !frame.is_alone && *part_ns > 0 && *part_ns + cost_ns > most_ns {
            sated.push(client);
            continue;
        }
        *part_ns += cost_ns;
        pixels = pixels.saturating_add(job.pixels());
        batch_ns = batch_ns.saturating_add(cost_ns);
        taken.batch.extend(side.grant(client, frame.batch));
    }
    batch_ns - before_ns
}

fn is_late<J: Waiting>(job: &J, now: Instant) -> bool {
    job.deadline().is_some_and(|deadline| deadline <= now)
}

/// Returns whether a batch of `pixels` has room for another job.
fn fits<J: Waiting>(pixels: u64, job: &J) -> bool {
    pixels == 0 || pixels.saturating_add(job.pixels()) <= BATCH_PIXELS
}

fn signed(ns: u64) -> i64 {
    i64::try_from(ns).unwrap_or(i64::MAX)
}

/// Returns how late a frame would be that waits for `wait` and then takes `own`; `None` if it is in time, or if it is next, when
/// trying costs nobody anything.
pub fn lateness(
    deadline: Option<Instant>,
    now: Instant,
    wait: Duration,
    own: Duration,
) -> Option<Duration> {
    let left = deadline?.saturating_duration_since(now);
    (wait > Duration::ZERO && wait + own > left).then(|| wait + own - left)
}

#[cfg(test)]
mod tests;
