//! The queue of frames that wait: bounded, fair, and pure. It holds no lock, channel or clock.
//!
//! Three classes share the device. Streams and plain requests come first, on one side; jobs are on the other and take what is left,
//! and [`Shares::jobs`] of the device's time where nothing is. On each side clients share by device time ([`lanes`]): a client
//! of 4K frames and one of thumbnails get as much of it each, whatever that is in frames. Streams and requests of one caller count as one client.
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
//! While several clients are about (waiting, or among those that the last few batches were for), none has more of a batch than
//! one frame, or [`SHARE_NS`] of small ones: a client that has only one frame waiting at a time, as a stream has, would otherwise
//! wait for many of a client that has a hundred. For the same reason batches are short in time while there are streams, those of
//! jobs before all, and no batch of jobs follows another under way while others are about: their frames wait for one batch of jobs at
//! most. Nor does a batch of jobs that is not their turn go in behind the frame of a stream, or of anybody who asks for one after
//! the other, while that is under way, nor in the pause after it, unless it ends before the next is expected ([`habits`]): a
//! frame cannot be interrupted, and the next pose would find the device taken.
//!
//! Costs are estimates ([`cost`]), put right when a frame was measured ([`Queue::settle`]).

pub mod cost;
pub mod encoding;
mod habits;
mod lanes;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use habits::Habits;
pub use lanes::Granted;
use lanes::Lanes;

/// What the queue needs to know of a job.
pub trait Waiting {
    /// Nobody waits for it any more.
    fn is_abandoned(&self) -> bool;
    fn deadline(&self) -> Option<Instant>;
    /// Pixels to draw and read back.
    fn pixels(&self) -> u64;
}

/// Who asks, and so who shares the device with the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Client {
    /// Whoever gave no name, all together.
    #[default]
    Unnamed,
    /// The caller of plain requests, by a number that the caller of the engine chose.
    Caller(u64),
    /// One stream, by a number of its own and that of the caller who has it. What one caller's streams and requests get together is
    /// one client's share.
    Stream { of: u64, number: u64 },
    /// The frames of one job, by a number that the caller of the engine chose.
    Job(u64),
}

/// How urgent a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// Somebody moves and looks: a stream.
    Interactive,
    /// A plain request.
    Request,
    /// Of a job, for which nobody waits frame by frame.
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
    /// The caller whose share of the device it takes a part of.
    fn owner(self) -> Option<u64> {
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

/// How the device is shared, and what may wait for it.
#[derive(Clone, Copy, Debug)]
pub struct Shares {
    /// Jobs that may wait, of streams and requests together; of [`Class::Job`] half as many besides.
    pub capacity: usize,
    /// Device time that may wait, as estimated, in nanoseconds; in halves likewise.
    pub capacity_ns: u64,
    /// Of the device's time, what [`Class::Job`] gets however much else there is: above 0, below 1.
    pub jobs: f64,
}

/// What is going on when a batch is taken.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    pub now: Instant,
    /// Device time under way, as estimated.
    pub flying_ns: u64,
    /// Whether frames of jobs are under way.
    pub are_jobs_flying: bool,
    /// Whether there are streams, even if they have not asked for a frame lately.
    pub are_streams_open: bool,
    /// Whether so many frames of jobs wait to be encoded that no more are drawn.
    pub are_jobs_held: bool,
}

/// What came out of the queue.
#[derive(Debug)]
pub struct Taken<J> {
    /// To be drawn in one submission.
    pub batch: Vec<Granted<J>>,
    /// Their deadline has passed.
    pub expired: Vec<J>,
    /// Nobody waits for them.
    pub abandoned: Vec<J>,
    /// Nothing was taken, because somebody is about to ask or encoders are behind: how long jobs wait for that.
    pub held_for: Option<Duration>,
}

/// Frames of a batch hold this many pixels together at most, unless there is only one: results of a batch come back
/// together, so a large frame must not wait for another.
pub const BATCH_PIXELS: u64 = 1 << 20;
/// For the same reason, and because more gains nothing: what a batch takes of the device at most, unless it is one frame.
pub const BATCH_NS: u64 = 100_000_000;
/// The same while there are streams.
pub const INTERACTIVE_BATCH_NS: u64 = 32_000_000;
/// The same of a batch of jobs, while others are about.
pub const JOB_BATCH_NS: u64 = 16_000_000;
/// What a client's frames of one batch take of the device, unless it is one frame, or as much as another's, or nobody else is
/// about. Also how much more than others somebody may have had who gets into a batch with them.
pub const SHARE_NS: u64 = 2_000_000;
/// What jobs can owe of their share for having had the device while nobody else wanted it.
pub const MOST_DEBT_NS: i64 = 100_000_000;

/// For so many batches a client counts as being about after it was served.
const MEMORY: u64 = 8;

/// Jobs by side, class and client.
#[derive(Debug)]
pub struct Queue<J> {
    shares: Shares,
    /// Were taken before and given back: their turn is now.
    returned: VecDeque<Granted<J>>,
    returned_ns: u64,
    /// Streams and requests.
    first: Lanes<J>,
    jobs: Lanes<J>,
    /// Device time that jobs may have before others, in nanoseconds.
    credit_ns: i64,
    /// Whether the last batch was of jobs.
    were_jobs_last: bool,
    /// Of streams and requests.
    habits: Habits,
    /// Since when the device is idle because jobs wait for somebody to ask.
    held_since: Option<Instant>,
    batches: u64,
    /// Under way when the last batch had been taken.
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
            habits: Habits::default(),
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

    /// Admits a job that is estimated to cost `cost_ns`, or gives it back when the queue is full even after jobs that nobody
    /// waits for were dropped. Those are returned beside.
    ///
    /// A client that has none waiting is let in up to twice the bounds, so that one client that fills the queue does not keep
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
            self.habits.asked(client, now);
        }
        self.side(client.class()).push(client, job, cost_ns, now);
        (Ok(()), dropped)
    }

    /// A client's frame is drawn, and will be on its way to it.
    pub fn landed(&mut self, client: Client, now: Instant) {
        if client.class() != Class::Job {
            self.habits.landed(client, now);
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
        // What costs more than may wait waits alone.
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

    /// Whether a job of `client` waits in its lane.
    pub fn holds(&self, client: Client, is_it: impl Fn(&J) -> bool) -> bool {
        self.first.holds(client, &is_it) || self.jobs.holds(client, is_it)
    }

    /// Puts `new` where a job of `client` waits, and gives that one; `new` comes back when it waits no more.
    pub fn replace(
        &mut self,
        client: Client,
        is_old: impl Fn(&J) -> bool,
        new: J,
        cost_ns: u64,
    ) -> Result<J, J> {
        self.side(client.class()).replace(client, is_old, new, cost_ns)
    }

    /// Takes a job of `client` out of its lane.
    pub fn remove(&mut self, client: Client, is_it: impl Fn(&J) -> bool) -> Option<J> {
        self.side(client.class()).remove(client, is_it)
    }

    /// Puts a job first in a client's lane, whatever the capacity: it had been admitted before, for somebody else.
    pub fn hand_over(&mut self, client: Client, job: J, cost_ns: u64, now: Instant) {
        self.side(client.class()).push_front(client, job, cost_ns, now);
    }

    /// Puts jobs back at the front, in their order, whatever the capacity: they had been admitted before. Frames of jobs come
    /// first in their lanes alone.
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

    /// Puts right what a client was charged for a frame that cost `measured_ns`.
    pub fn settle(&mut self, client: Client, charged_ns: u64, measured_ns: u64) {
        let more_ns = signed(measured_ns).saturating_sub(signed(charged_ns));
        let class = client.class();
        self.side(class).correct(client, charged_ns, measured_ns);
        if class == Class::Job {
            // No more than for one frame: how dear it is was known to nobody.
            let most = MOST_DEBT_NS.max(signed(measured_ns));
            self.credit_ns = self.credit_ns.saturating_sub(more_ns).max(-most);
        } else if !self.jobs.is_empty() {
            self.earn(more_ns as f64);
        }
    }

    /// Jobs wait while others were given `ns` of the device.
    fn earn(&mut self, ns: f64) {
        let share = self.shares.jobs;
        self.credit_ns = self.credit_ns.saturating_add((ns * share / (1.0 - share)) as i64);
    }

    /// Jobs were given `ns` of the device, which nobody else wanted or not.
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
        // One batch of jobs is what somebody's next frame may have to wait for.
        let is_one_enough = is_watched || are_others_about && self.first.is_empty();
        let may_jobs = !(moment.are_jobs_held || is_one_enough && moment.are_jobs_flying);
        let was_their_turn = is_watched && self.were_jobs_last;
        let expected = self.habits.expected(moment.now);
        if let Some(since) = self.held_since.take() {
            // The device was kept for others.
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
            let limit_ns = if is_watched { INTERACTIVE_BATCH_NS } else { BATCH_NS };
            let is_alone = self.first.about(oldest).nth(1).is_none();
            let frame = Frame { max, limit_ns, is_alone, batch, now: moment.now };
            let ns = compose(&mut self.first, frame, &mut taken);
            if !self.jobs.is_empty() && !moment.are_jobs_held {
                self.earn(ns as f64);
            }
        }
        let follows = |client| is_stream(client) || self.habits.is_quick(client);
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

    /// Whether there were any.
    fn take_jobs(&mut self, room: Room, now: Instant, taken: &mut Taken<J>) -> bool {
        let Room { max, are_others_about, is_left_over, free } = room;
        let free_ns = free.map_or(u64::MAX, |free| free.as_nanos() as u64);
        let next = self.jobs.next(&[]).and_then(|(client, _)| self.jobs.front(client));
        // Those that nobody waits for any more, or are late, are taken out in any case.
        let is_alive = |job: &J| !job.is_abandoned() && !is_late(job, now);
        if next.is_some_and(|(job, cost_ns)| is_alive(job) && cost_ns > free_ns) {
            return false;
        }
        let limit_ns = if are_others_about { JOB_BATCH_NS } else { BATCH_NS };
        // All of them have frames waiting all the while: their times alone make their shares equal.
        let limit_ns = limit_ns.min(free_ns);
        let frame = Frame { max, limit_ns, is_alone: true, batch: self.batches + 1, now };
        let ns = compose(&mut self.jobs, frame, taken);
        self.spend(ns, is_left_over);
        ns > 0
    }

    /// Device time until a job would be begun that `client` adds now, with what it costs itself: estimated, and as others share.
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
            // Others are before all that jobs have beyond their share.
            let most_ns = (own_ns.saturating_add(cost_ns)) as f64 * (1.0 - share) / share;
            let others_ns = self.first.cost_ns().min(most_ns as u64);
            return under_way_ns.saturating_add(own_ns).saturating_add(others_ns);
        }
        let own_ns = self.first.ahead_ns(client, deadline, cost_ns, now);
        let of_jobs = (own_ns as f64 * share / (1.0 - share)) as u64;
        let of_jobs = of_jobs.min(self.jobs.cost_ns());
        under_way_ns.saturating_add(own_ns).saturating_add(of_jobs)
    }

    /// Device time of what waits on the side of `class` and is under way.
    pub fn backlog_ns(&self, class: Class) -> u64 {
        let first_ns = self.first.cost_ns().saturating_add(self.returned_ns);
        let jobs_ns = if class == Class::Job { self.jobs.cost_ns() } else { 0 };
        self.flying_ns.saturating_add(first_ns).saturating_add(jobs_ns)
    }

    /// Device time that is under way, as estimated.
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

/// What a batch of jobs may hold.
#[derive(Clone, Copy)]
struct Room {
    max: usize,
    are_others_about: bool,
    /// Whether nobody else wants the time.
    is_left_over: bool,
    /// Until somebody else may ask.
    free: Option<Duration>,
}

/// What a batch may hold.
#[derive(Clone, Copy)]
struct Frame {
    max: usize,
    limit_ns: u64,
    /// Whether a client may have all of it.
    is_alone: bool,
    /// This batch's number.
    batch: u64,
    now: Instant,
}

/// Adds jobs of one side to a batch that may hold some, and gives what they cost.
fn compose<J: Waiting>(side: &mut Lanes<J>, frame: Frame, taken: &mut Taken<J>) -> u64 {
    let mut batch_ns: u64 = taken.batch.iter().map(|granted| granted.cost_ns).sum();
    let mut pixels: u64 = taken.batch.iter().map(|granted| granted.job.pixels()).sum();
    let before_ns = batch_ns;
    let (mut sated, mut served) = (Vec::new(), Vec::new());
    // What each of `served` has of this batch.
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

/// Whether a batch of `pixels` takes another job.
fn fits<J: Waiting>(pixels: u64, job: &J) -> bool {
    pixels == 0 || pixels.saturating_add(job.pixels()) <= BATCH_PIXELS
}

fn signed(ns: u64) -> i64 {
    i64::try_from(ns).unwrap_or(i64::MAX)
}

/// How late a frame would be that waits for `wait` and then takes `own`; `None` when it would be in time, or is the next, which
/// it costs nobody anything to try.
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
mod simulation;
#[cfg(test)]
mod tests;
