//! Lanes of clients that share the device by time: start-time fair queueing (P. Goyal, H. M. Vin, H. Cheng, SIGCOMM 1996). The
//! cost of a frame is estimated when the frame is taken and corrected when it was measured.
//!
//! Every client has a virtual time, the device time that it was given. The client with the least is next. A client that had
//! nothing waiting starts at the least time of those that wait, so that it is early but has saved up nothing:
//!
//! ```text
//! time      A ████████            A and B waited all the while; B is next
//!           B █████
//!           C ██░░░               C comes back: it begins where B is, before B if it is a stream
//! ```
//!
//! The streams and requests of one caller are parts of one owner, and share what one client gets: each part is charged its cost
//! times the number of active parts.
//!
//! If new clients arrive without end, all of them start at that place. To keep it moving, it rises with the device's time at
//! least as fast as a quarter of a client's share.

use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

use super::{Client, Waiting};

/// Within its lane a job goes before jobs with later deadlines, but not before jobs that arrived this much earlier.
const PATIENCE: Duration = Duration::from_secs(5);
/// Divisor of a client's share: the slowest rate at which the start of new clients rises.
const FLOOR_SHARE: u64 = 4;
/// Batches after which a client with nothing waiting is forgotten, together with its debt.
const LONGEST_DEBT: u64 = 256;

/// A job that may be drawn, and the amount charged to its client.
#[derive(Clone, Debug, PartialEq)]
pub struct Granted<J> {
    pub client: Client,
    /// Estimated device time.
    pub cost_ns: u64,
    pub job: J,
}

/// A waiting job.
#[derive(Debug)]
struct Entry<J> {
    job: J,
    cost_ns: u64,
    /// Sort key of the lane.
    due: Instant,
}

#[derive(Debug)]
struct Lane<J> {
    entries: VecDeque<Entry<J>>,
    cost_ns: u64,
}

/// Device time that a client was given.
#[derive(Clone, Copy, Debug)]
struct Account {
    time_ns: u64,
    /// Number of its last arrival or service, counted in such events; among equals the longest waiting goes first.
    turn: u64,
    /// Batch in which it was served last.
    batch: Option<u64>,
}

/// The clients of one side of the queue.
#[derive(Debug)]
pub struct Lanes<J> {
    /// Lanes of clients; none is empty.
    lanes: HashMap<Client, Lane<J>>,
    /// Accounts of all clients that have a lane or were served lately.
    accounts: HashMap<Client, Account>,
    /// Virtual time at which a client starts that had nothing waiting.
    now_ns: u64,
    /// Lower bound of `now_ns`.
    floor_ns: u64,
    /// Number of active clients, for owners with more than one.
    parts: HashMap<u64, u64>,
    waiting: usize,
    cost_ns: u64,
    turns: u64,
}

impl<J> Default for Lanes<J> {
    fn default() -> Self {
        Self {
            lanes: HashMap::new(),
            accounts: HashMap::new(),
            now_ns: 0,
            floor_ns: 0,
            parts: HashMap::new(),
            waiting: 0,
            cost_ns: 0,
            turns: 0,
        }
    }
}

impl<J: Waiting> Lanes<J> {
    pub fn len(&self) -> usize {
        self.waiting
    }

    pub fn is_empty(&self) -> bool {
        self.waiting == 0
    }

    /// Returns the cost of all waiting jobs.
    pub fn cost_ns(&self) -> u64 {
        self.cost_ns
    }

    /// Returns whether a client has a job waiting.
    pub fn has_lane(&self, client: Client) -> bool {
        self.lanes.contains_key(&client)
    }

    /// Returns the clients that wait, or were served since the batch `since`.
    pub fn about(&self, since: u64) -> impl Iterator<Item = Client> {
        let served = move |(client, account): (&Client, &Account)| {
            let is_about = account.batch >= Some(since) || self.lanes.contains_key(client);
            is_about.then_some(*client)
        };
        self.accounts.iter().filter_map(served)
    }

    /// Counts the parts of owners that wait, or were served since the batch `since`.
    pub fn count_parts(&mut self, since: u64) {
        let mut parts = std::mem::take(&mut self.parts);
        parts.clear();
        for owner in self.about(since).filter_map(Client::owner) {
            *parts.entry(owner).or_insert(0) += 1;
        }
        self.parts = parts;
    }

    /// Returns the factor by which a client's costs are charged.
    fn parts_of(&self, client: Client) -> u64 {
        client.owner().and_then(|owner| self.parts.get(&owner)).map_or(1, |parts| (*parts).max(1))
    }

    /// Adds a job to its lane in order of deadlines.
    pub fn push(&mut self, client: Client, job: J, cost_ns: u64, now: Instant) {
        let due = job.deadline().map_or(now + PATIENCE, |deadline| deadline.min(now + PATIENCE));
        let lane = self.lane(client, cost_ns);
        let before = lane.entries.iter().rposition(|other| other.due <= due);
        lane.entries.insert(before.map_or(0, |at| at + 1), Entry { job, cost_ns, due });
    }

    /// Adds a job before all others of its client.
    pub fn push_front(&mut self, client: Client, job: J, cost_ns: u64, now: Instant) {
        let lane = self.lane(client, cost_ns);
        let due = lane.entries.front().map_or(now, |front| front.due);
        lane.entries.push_front(Entry { job, cost_ns, due });
    }

    /// Returns a client's lane, to which the caller adds a job.
    fn lane(&mut self, client: Client, cost_ns: u64) -> &mut Lane<J> {
        self.waiting += 1;
        self.cost_ns += cost_ns;
        let Self { lanes, accounts, turns, now_ns, .. } = self;
        let lane = lanes.entry(client).or_insert_with(|| {
            *turns += 1;
            let account = accounts.entry(client);
            let account = account.or_insert(Account { time_ns: 0, turn: 0, batch: None });
            account.time_ns = account.time_ns.max(*now_ns);
            account.turn = *turns;
            Lane { entries: VecDeque::new(), cost_ns: 0 }
        });
        lane.cost_ns += cost_ns;
        lane
    }

    /// Returns whether a job of `client` waits.
    pub fn holds(&self, client: Client, is_it: impl Fn(&J) -> bool) -> bool {
        self.lanes
            .get(&client)
            .is_some_and(|lane| lane.entries.iter().any(|entry| is_it(&entry.job)))
    }

    /// Replaces a waiting job of `client` by `new`.
    pub fn replace(
        &mut self,
        client: Client,
        is_old: impl Fn(&J) -> bool,
        new: J,
        cost_ns: u64,
    ) -> Result<J, J> {
        let lane = self.lanes.get_mut(&client);
        let found = lane.and_then(|lane| {
            let entry = lane.entries.iter_mut().find(|entry| is_old(&entry.job))?;
            Some((&mut lane.cost_ns, entry))
        });
        let Some((lane_ns, entry)) = found else { return Err(new) };
        *lane_ns = *lane_ns + cost_ns - entry.cost_ns;
        self.cost_ns = self.cost_ns + cost_ns - entry.cost_ns;
        entry.cost_ns = cost_ns;
        Ok(std::mem::replace(&mut entry.job, new))
    }

    /// Removes a job of `client`.
    pub fn remove(&mut self, client: Client, is_it: impl Fn(&J) -> bool) -> Option<J> {
        let lane = self.lanes.get_mut(&client)?;
        let at = lane.entries.iter().position(|entry| is_it(&entry.job))?;
        self.take_at(client, at).map(|entry| entry.job)
    }

    fn take_at(&mut self, client: Client, at: usize) -> Option<Entry<J>> {
        let lane = self.lanes.get_mut(&client)?;
        let entry = lane.entries.remove(at)?;
        lane.cost_ns -= entry.cost_ns;
        self.cost_ns -= entry.cost_ns;
        self.waiting -= 1;
        if lane.entries.is_empty() {
            self.lanes.remove(&client);
        }
        Some(entry)
    }

    /// Removes jobs that nobody waits for.
    pub fn drop_abandoned(&mut self) -> Vec<J> {
        self.take_if(Waiting::is_abandoned)
    }

    /// Removes everything.
    pub fn drain(&mut self) -> Vec<J> {
        self.take_if(|_| true)
    }

    fn take_if(&mut self, is_out: impl Fn(&J) -> bool) -> Vec<J> {
        let mut out = Vec::new();
        self.lanes.retain(|_, lane| {
            let (gone, kept): (VecDeque<_>, VecDeque<_>) =
                std::mem::take(&mut lane.entries).into_iter().partition(|entry| is_out(&entry.job));
            lane.entries = kept;
            for entry in gone {
                lane.cost_ns -= entry.cost_ns;
                self.cost_ns -= entry.cost_ns;
                self.waiting -= 1;
                out.push(entry.job);
            }
            !lane.entries.is_empty()
        });
        out
    }

    /// Returns the next client that waits and is not in `sated`, with its time. Among clients with the least time streams come
    /// first, then the client that was served the longest ago.
    pub fn next(&self, sated: &[Client]) -> Option<(Client, u64)> {
        let waiting = self.lanes.keys().filter(|client| !sated.contains(client));
        let order = |client: &Client| {
            let account = self.accounts.get(client);
            account.map(|account| (account.time_ns, client.class(), account.turn))
        };
        let least = waiting.filter_map(|client| Some((order(client)?, *client)));
        least.min_by_key(|(order, _)| *order).map(|((time_ns, ..), client)| (client, time_ns))
    }

    /// Returns the least time of clients that wait or are in `served`.
    pub fn least_time_ns(&self, served: &[Client]) -> u64 {
        let about = self.lanes.keys().chain(served);
        let times = about.filter_map(|client| self.accounts.get(client));
        times.map(|account| account.time_ns).min().unwrap_or(self.now_ns)
    }

    /// Returns a client's first job with its cost.
    pub fn front(&self, client: Client) -> Option<(&J, u64)> {
        let entry = self.lanes.get(&client)?.entries.front()?;
        Some((&entry.job, entry.cost_ns))
    }

    /// Removes a client's first job without a charge: it will not be drawn.
    pub fn discard(&mut self, client: Client) -> Option<J> {
        self.take_at(client, 0).map(|entry| entry.job)
    }

    /// Removes a client's first job and charges for it.
    pub fn grant(&mut self, client: Client, batch: u64) -> Option<Granted<J>> {
        let waiting = self.lanes.len() as u64;
        self.now_ns = self.now_ns.max(self.least_time_ns(&[]));
        let Entry { job, cost_ns, .. } = self.take_at(client, 0)?;
        self.floor_ns += cost_ns / (FLOOR_SHARE * waiting.max(1));
        self.now_ns = self.now_ns.max(self.floor_ns);
        self.charge(client, cost_ns, batch);
        Some(Granted { client, cost_ns, job })
    }

    /// Charges a client for a job that was put back and is granted again.
    pub fn charge(&mut self, client: Client, cost_ns: u64, batch: u64) {
        self.turns += 1;
        let parts = self.parts_of(client);
        let account = Account { time_ns: self.now_ns, turn: 0, batch: None };
        let account = self.accounts.entry(client).or_insert(account);
        let time_ns = account.time_ns + cost_ns * parts;
        *account = Account { time_ns, turn: self.turns, batch: Some(batch) };
    }

    /// Corrects the charge of a client.
    pub fn correct(&mut self, client: Client, charged_ns: u64, measured_ns: u64) {
        let parts = self.parts_of(client);
        if let Some(account) = self.accounts.get_mut(&client) {
            let measured_ns = measured_ns.saturating_mul(parts);
            account.time_ns =
                account.time_ns.saturating_add(measured_ns).saturating_sub(charged_ns * parts);
        }
    }

    /// Forgets clients that have nothing waiting, were not served since the batch `since`, and have had no more than others. When
    /// the device `is_idle` and nobody waits, no client has had more than others.
    pub fn forget(&mut self, since: u64, batch: u64, is_idle: bool) {
        let (now_ns, lanes) = (self.now_ns, &self.lanes);
        let settled = is_idle && self.waiting == 0;
        self.accounts.retain(|client, account| {
            let is_recent = account.batch.is_some_and(|at| at + LONGEST_DEBT > batch);
            let owes = !settled && account.time_ns > now_ns && is_recent;
            lanes.contains_key(client) || account.batch >= Some(since) || owes
        });
        if settled {
            let most = self.accounts.values().map(|account| account.time_ns).max();
            self.now_ns = self.now_ns.max(most.unwrap_or(0));
        }
    }

    /// Returns the device time for others and for `client` before a job of `cost_ns`, due at `due`, if it were added now.
    pub fn ahead_ns(
        &self,
        client: Client,
        deadline: Option<Instant>,
        cost_ns: u64,
        now: Instant,
    ) -> u64 {
        let due = deadline.map_or(now + PATIENCE, |deadline| deadline.min(now + PATIENCE));
        let lane = self.lanes.get(&client);
        let own_ns: u64 = lane.map_or(0, |lane| {
            lane.entries.iter().take_while(|entry| entry.due <= due).map(|e| e.cost_ns).sum()
        });
        let time_ns = self.accounts.get(&client).map_or(0, |account| account.time_ns);
        let until_ns = time_ns.max(self.now_ns) + (own_ns + cost_ns) * self.parts_of(client);
        let others = self.lanes.iter().filter(|(other, _)| **other != client);
        let others_ns: u64 = others
            .map(|(other, lane)| {
                let time_ns = self.accounts.get(other).map_or(0, |account| account.time_ns);
                lane.cost_ns.min(until_ns.saturating_sub(time_ns) / self.parts_of(*other))
            })
            .sum();
        own_ns + others_ns
    }

    #[cfg(test)]
    pub fn accounts(&self) -> usize {
        self.accounts.len()
    }
}
