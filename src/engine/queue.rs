//! The queue of frames that wait: bounded, fair to clients, and pure. It holds no lock, channel or clock.
//!
//! Every client has a lane of its own, in order of arrival, and clients with a lane take turns: who was served the longest ago is
//! next, also if it had nothing waiting for a while.
//!
//! ```text
//! turns   A ─▶ B ─▶ C ─▶ (A)        lanes   A: a1 a2 a3 …    B: b1    C: c1 c2
//! batch   a1 b1 c1, then a2 c2 … while there is room
//! ```
//!
//! A client is whoever is to have a share of the device: all plain requests of one caller, or one stream. While several are about
//! (waiting, or among those that the last few batches were for), none has more of a batch than one frame, or small frames
//! of [`SHARE_PIXELS`] together: a client that has only one frame waiting at a time, as a stream has, would otherwise get one
//! frame for every fifteen of a client that has a hundred.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::{Duration, Instant};

/// What the queue needs to know of a job.
pub trait Waiting {
    /// Nobody waits for it any more.
    fn is_abandoned(&self) -> bool;
    fn deadline(&self) -> Option<Instant>;
    /// Pixels to draw and read back.
    fn pixels(&self) -> u64;
}

/// Who asks, and so who takes turns with the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Client {
    /// Whoever gave no name, all together.
    #[default]
    Unnamed,
    /// The caller of plain requests, by a number that the caller of the engine chose.
    Caller(u64),
    /// One stream.
    Stream(u64),
}

/// Jobs by client, each client's in order of arrival.
#[derive(Debug)]
pub struct Queue<J> {
    /// Were taken before and given back: their turn is now.
    returned: VecDeque<J>,
    /// None is empty.
    lanes: HashMap<Client, VecDeque<J>>,
    /// Every client that has a lane, by its rank: the least has the next turn.
    turns: BTreeMap<u64, Client>,
    waiting: usize,
    capacity: usize,
    /// Who was served in one of the last [`MEMORY`] batches.
    served: HashMap<Client, Served>,
    batches: u64,
    /// Given out as ranks, never twice.
    next_rank: u64,
}

#[derive(Clone, Copy, Debug)]
struct Served {
    batch: u64,
    /// What the client comes back with.
    rank: u64,
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

/// Pixels that a client's frames of one batch hold together, unless it is one frame or nobody else is about.
pub const SHARE_PIXELS: u64 = 1 << 17;

/// For so many batches a client counts as being about after it was served.
const MEMORY: u64 = 8;

impl<J: Waiting> Queue<J> {
    /// `capacity` jobs may wait; a client that has none waiting is let in up to twice as many, so that one client that fills
    /// the queue does not keep the others out.
    pub fn new(capacity: usize) -> Self {
        Self {
            returned: VecDeque::new(),
            lanes: HashMap::new(),
            turns: BTreeMap::new(),
            waiting: 0,
            capacity: capacity.max(1),
            served: HashMap::new(),
            batches: 0,
            next_rank: 0,
        }
    }

    pub fn len(&self) -> usize {
        self.waiting
    }

    pub fn is_empty(&self) -> bool {
        self.waiting == 0
    }

    /// Admits a job, or gives it back when the queue is full even after jobs that nobody waits for were dropped.
    /// Those are returned beside.
    pub fn admit(&mut self, client: Client, job: J) -> (Result<(), J>, Vec<J>) {
        let dropped = if self.has_room(client) { Vec::new() } else { self.drop_abandoned() };
        if !self.has_room(client) {
            return (Err(job), dropped);
        }
        self.lane(client).push_back(job);
        self.waiting += 1;
        (Ok(()), dropped)
    }

    fn has_room(&self, client: Client) -> bool {
        let newcomer = !self.lanes.contains_key(&client);
        self.waiting < self.capacity || newcomer && self.waiting < self.capacity.saturating_mul(2)
    }

    /// A client's lane, and a turn if it had none.
    fn lane(&mut self, client: Client) -> &mut VecDeque<J> {
        let Self { lanes, turns, served, next_rank, .. } = self;
        lanes.entry(client).or_insert_with(|| {
            let rank = served.get(&client).map_or_else(|| new_rank(next_rank), |last| last.rank);
            turns.insert(rank, client);
            VecDeque::new()
        })
    }

    fn drop_abandoned(&mut self) -> Vec<J> {
        let mut dropped = Vec::new();
        let mut sift = |jobs: &mut VecDeque<J>| {
            let (gone, kept): (VecDeque<J>, VecDeque<J>) =
                std::mem::take(jobs).into_iter().partition(Waiting::is_abandoned);
            *jobs = kept;
            dropped.extend(gone);
        };
        sift(&mut self.returned);
        self.lanes.values_mut().for_each(sift);
        self.tidy();
        self.waiting -= dropped.len();
        dropped
    }

    /// Takes lanes away that have become empty, with their turns.
    fn tidy(&mut self) {
        self.lanes.retain(|_, lane| !lane.is_empty());
        self.turns.retain(|_, client| self.lanes.contains_key(client));
    }

    /// Whether a job of `client` waits in its lane.
    pub fn holds(&self, client: Client, is_it: impl Fn(&J) -> bool) -> bool {
        self.lanes.get(&client).is_some_and(|lane| lane.iter().any(is_it))
    }

    /// Puts `new` where a job of `client` waits, and gives that one; `new` comes back when it waits no more.
    pub fn replace(&mut self, client: Client, is_old: impl Fn(&J) -> bool, new: J) -> Result<J, J> {
        let lane = self.lanes.get_mut(&client);
        match lane.and_then(|lane| lane.iter_mut().find(|job| is_old(job))) {
            Some(place) => Ok(std::mem::replace(place, new)),
            None => Err(new),
        }
    }

    /// Takes a job of `client` out of its lane.
    pub fn remove(&mut self, client: Client, is_it: impl Fn(&J) -> bool) -> Option<J> {
        let lane = self.lanes.get_mut(&client)?;
        let job = lane.remove(lane.iter().position(is_it)?)?;
        self.waiting -= 1;
        self.tidy();
        Some(job)
    }

    /// Puts a job first in a client's lane, whatever the capacity: it had been admitted before, for somebody else.
    pub fn hand_over(&mut self, client: Client, job: J) {
        self.lane(client).push_front(job);
        self.waiting += 1;
    }

    /// Puts jobs back at the front, in their order, whatever the capacity: they had been admitted before.
    pub fn put_back(&mut self, jobs: Vec<J>) {
        self.waiting += jobs.len();
        for job in jobs.into_iter().rev() {
            self.returned.push_front(job);
        }
    }

    /// Takes the next batch of at most `max` jobs.
    pub fn take(&mut self, max: usize, now: Instant) -> Taken<J> {
        let before = self.waiting;
        self.batches += 1;
        let oldest = self.batches.saturating_sub(MEMORY);
        self.served.retain(|_, last| last.batch >= oldest);
        let alone = self.is_one_about();
        let mut shares: HashMap<Client, u64> = HashMap::new();
        let mut taken = Taken { batch: Vec::new(), expired: Vec::new(), abandoned: Vec::new() };
        let mut pixels = 0u64;
        let max = max.max(1);
        while taken.batch.len() < max {
            let Some(job) = next_live(&mut self.returned, now, &mut taken) else { break };
            if !fits(pixels, &job) {
                self.returned.push_front(job);
                break;
            }
            pixels = pixels.saturating_add(job.pixels());
            taken.batch.push(job);
        }
        // Clients that have had their share of this batch; their turns come in the next one.
        let mut sated = Vec::new();
        while taken.batch.len() < max && self.returned.is_empty() {
            let Some((rank, client)) = self.turns.pop_first() else { break };
            let Some(lane) = self.lanes.get_mut(&client) else { continue };
            let Some(job) = next_live(lane, now, &mut taken) else {
                self.lanes.remove(&client);
                continue;
            };
            let share = shares.get(&client).copied();
            let more = share.unwrap_or(0).saturating_add(job.pixels());
            let is_over = !alone && share.is_some() && more > SHARE_PIXELS;
            if is_over || !fits(pixels, &job) {
                lane.push_front(job);
                sated.push((rank, client));
                if is_over {
                    continue;
                }
                break;
            }
            pixels = pixels.saturating_add(job.pixels());
            taken.batch.push(job);
            shares.insert(client, more);
            let rank = new_rank(&mut self.next_rank);
            self.served.insert(client, Served { batch: self.batches, rank });
            if lane.is_empty() {
                self.lanes.remove(&client);
            } else {
                self.turns.insert(rank, client);
            }
        }
        self.turns.extend(sated);
        let out = taken.batch.len() + taken.expired.len() + taken.abandoned.len();
        self.waiting = before - out;
        taken
    }

    /// Whether no two clients wait or were served lately.
    fn is_one_about(&self) -> bool {
        let mut about = self.turns.values().chain(self.served.keys());
        let first = about.next();
        about.all(|client| Some(client) == first)
    }

    /// Empties the queue.
    pub fn drain(&mut self) -> Vec<J> {
        self.waiting = 0;
        let mut jobs: Vec<J> = self.returned.drain(..).collect();
        for client in std::mem::take(&mut self.turns).into_values() {
            jobs.extend(self.lanes.remove(&client).into_iter().flatten());
        }
        jobs
    }
}

fn new_rank(next_rank: &mut u64) -> u64 {
    *next_rank += 1;
    *next_rank
}

/// Whether a batch of `pixels` takes another job.
fn fits<J: Waiting>(pixels: u64, job: &J) -> bool {
    pixels == 0 || pixels.saturating_add(job.pixels()) <= BATCH_PIXELS
}

/// The first job that is to be drawn; those before it go to `taken`.
fn next_live<J: Waiting>(jobs: &mut VecDeque<J>, now: Instant, taken: &mut Taken<J>) -> Option<J> {
    loop {
        let job = jobs.pop_front()?;
        if job.is_abandoned() {
            taken.abandoned.push(job);
        } else if job.deadline().is_some_and(|deadline| deadline <= now) {
            taken.expired.push(job);
        } else {
            return Some(job);
        }
    }
}

/// How long a newcomer would wait: the jobs before it times the measured time of one, at least 50 ms.
pub fn expected_wait(queued: usize, per_frame: Duration) -> Duration {
    (per_frame * queued as u32).max(Duration::from_millis(50))
}

#[cfg(test)]
mod tests;
