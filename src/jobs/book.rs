//! State of all jobs. Pure: times come in, changed records come out; it uses no clock, lock or file.
//!
//! ```text
//!               ┌──────── a pause, a kill, a scene that is gone ───────┐
//!               ▼                                                      │
//! admit ──► queued ──next──────────────────────────────────────────► running ──► done
//!            │  ▲                                                      │  │
//!            │  └────────resume── cancelled ◄──cancel──────────────────┘  │
//!            ├──cancel──────────────►                                     │
//!            │  ▲                                                         │
//!            │  └────────resume── failed ◄────────────────────────────────┘
//!            └──waited too long─────►
//! ```
//!
//! A running job goes through phases, each with a limited number of places ([`Slots`]): its inputs are baked, its frames are
//! drawn, and its video is coded. Between two phases the job waits for a place, and others may take the one that it leaves. The
//! next job belongs to the owner with the fewest jobs at work; among that owner's jobs it is the oldest.
//!
//! A thread that works on a job or its files holds the job until the work is over ([`Book::release`]), even if the job is
//! cancelled or removed meanwhile. No other runner gets the job before, even if it was resumed. The last holder of a removed job
//! deletes its files. Done, failed and cancelled jobs are forgotten after [`Limits::ttl_ms`].

use std::collections::BTreeMap;

pub use super::record::{
    Failure, FailureKind, JobId, LARGEST_COUNT, Made, Record, Repeat, State, Video,
};
use super::spec::Spec;

/// Limits of a book.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest number of running jobs, and of queued ones that do not wait for their scene.
    pub most_unfinished: usize,
    /// Largest number of jobs.
    pub most: usize,
    /// Time for which an ended job is kept, and for which a queued job waits for its scene.
    pub ttl_ms: u64,
    pub slots: Slots,
}

impl Limits {
    /// Returns the largest number of one owner's jobs that are not done, failed or cancelled: half of the queue, so that no owner keeps
    /// the others out of it.
    pub fn most_unfinished_per_owner(&self) -> usize {
        self.most_unfinished.div_ceil(2)
    }
}

/// One phase of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Baking of the data that its frames, and perhaps others, need.
    Baking,
    Drawing,
    /// Coding of the video.
    Coding,
}

/// Largest number of jobs in each phase at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slots {
    pub baking: usize,
    pub drawing: usize,
    pub coding: usize,
}

impl Slots {
    fn of(&self, phase: Phase) -> usize {
        match phase {
            Phase::Baking => self.baking,
            Phase::Drawing => self.drawing,
            Phase::Coding => self.coding,
        }
    }

    /// Returns the largest number of jobs at work at a time.
    pub fn all(&self) -> usize {
        self.baking + self.drawing + self.coding
    }
}

/// Preparations that a job needs before its frames can be drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Need {
    /// Something is missing that may appear later.
    Missing(String),
    Bake,
    Nothing,
}

/// How a run of a job ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Done,
    Failed(Failure),
    /// The server stops; the next process goes on.
    Paused,
    /// Something is missing that may come back.
    Waits(String),
    /// The job goes on in this phase.
    Next(Phase),
}

/// Reason for refusing to create or change a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    Unknown,
    /// The job's state does not allow the change.
    State {
        state: &'static str,
        accepted: &'static str,
    },
    /// The idempotency key was used for another job.
    KeyReused {
        id: JobId,
    },
    TooManyUnfinished {
        limit: usize,
    },
    /// As many jobs of the same owner have not ended.
    TooManyOfOwner {
        limit: usize,
    },
    TooMany {
        limit: usize,
    },
}

/// Result of [`Book::admit`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Admitted {
    New(JobId),
    /// An equal request has created this job before.
    Before(JobId),
}

/// Result of [`Book::expire`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expired {
    /// Removed jobs, held by the caller.
    pub forgotten: Vec<Record>,
    pub failed: Vec<JobId>,
}

/// Work of a runner.
#[derive(Clone, Debug, PartialEq)]
struct Work {
    phase: Phase,
    owner: Option<String>,
}

/// Creator of a job, and the id of the request.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Origin {
    pub owner: Option<String>,
    pub request_id: Option<String>,
}

/// All jobs.
#[derive(Clone, Debug)]
pub struct Book {
    limits: Limits,
    jobs: BTreeMap<JobId, Record>,
    /// Number of holders of each held job, which may no longer be in `jobs`.
    held: BTreeMap<JobId, usize>,
    /// Jobs at work, with the work of their runners.
    at_work: BTreeMap<JobId, Work>,
    /// Next phases of running jobs that no runner has.
    due: BTreeMap<JobId, Phase>,
    next_id: JobId,
    next_turn: u64,
}

impl Book {
    /// Builds a book of the records that an earlier process has kept. Jobs that were running are queued again in their old
    /// places. Ids up to `last_id` are not given out again.
    pub fn new(limits: Limits, kept: impl IntoIterator<Item = Record>, last_id: JobId) -> Book {
        let mut jobs: BTreeMap<JobId, Record> = BTreeMap::new();
        for mut record in kept {
            // A missing input may appear soon, and the time to wait for it starts again.
            if !record.has_ended() {
                record.state = State::Queued { waits_for: None };
            }
            jobs.insert(record.id, record);
        }
        let last = jobs.keys().next_back().copied().unwrap_or(0).max(last_id);
        let next_turn = jobs.values().map(|job| job.turn + 1).max().unwrap_or(0);
        Book {
            limits,
            jobs,
            held: BTreeMap::new(),
            at_work: BTreeMap::new(),
            due: BTreeMap::new(),
            next_id: last + 1,
            next_turn,
        }
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    pub fn get(&self, id: JobId) -> Result<&Record, Refusal> {
        self.jobs.get(&id).ok_or(Refusal::Unknown)
    }

    /// Returns all jobs in order of their numbers.
    pub fn all(&self) -> impl Iterator<Item = &Record> {
        self.jobs.values()
    }

    pub fn is_held(&self, id: JobId) -> bool {
        self.held.contains_key(&id)
    }

    /// Keeps other runners from a job until [`Book::release`].
    pub fn hold(&mut self, id: JobId) {
        *self.held.entry(id).or_insert(0) += 1;
    }

    /// Releases one hold on a job. Returns true when the job was removed meanwhile and nobody else holds it: the caller then
    /// deletes its files.
    pub fn release(&mut self, id: JobId) -> bool {
        if let Some(holders) = self.held.get_mut(&id) {
            *holders -= 1;
            if *holders == 0 {
                self.held.remove(&id);
            }
        }
        !self.is_held(id) && !self.jobs.contains_key(&id)
    }

    /// Restores a record whose change could not be written to disk: in place of the one with this turn, or where there is none.
    pub fn restore(&mut self, mut record: Record, turn: u64) {
        if record.state == State::Running && !self.at_work.contains_key(&record.id) {
            record.state = State::Queued { waits_for: None };
        }
        let now = self.jobs.get(&record.id);
        if now.is_none_or(|now| now.turn == turn && matches!(now.state, State::Queued { .. })) {
            self.jobs.insert(record.id, record);
        }
    }

    /// Returns the job that the same owner has created with the same key.
    pub fn repeated(&self, asked: &Repeat) -> Option<&Record> {
        let same = |known: &Repeat| known.owner == asked.owner && known.key == asked.key;
        self.jobs.values().find(|job| job.repeat.as_ref().is_some_and(same))
    }

    /// Removes an ended job if its place is needed for a new one: the oldest job of the owner that has most of them. The caller holds
    /// the removed job.
    pub fn make_room(&mut self, owner: Option<&str>, repeat: Option<&Repeat>) -> Option<Record> {
        let is_known = repeat.is_some_and(|asked| self.repeated(asked).is_some());
        if is_known || self.jobs.len() < self.limits.most || self.check_room(owner).is_err() {
            return None;
        }
        let ended = || self.jobs.values().filter(|job| job.has_ended() && !self.is_held(job.id));
        let mut numbers: BTreeMap<&Option<String>, usize> = BTreeMap::new();
        for job in ended() {
            *numbers.entry(&job.owner).or_default() += 1;
        }
        let (richest, _) = numbers.into_iter().max_by_key(|(_, number)| *number)?;
        let theirs = ended().filter(|job| job.owner == *richest);
        let oldest = theirs.min_by_key(|job| (job.since_ms, job.id))?.id;
        self.remove(oldest).ok()
    }

    /// Creates a job, or finds the one that the same request has created before.
    pub fn admit(
        &mut self,
        spec: Spec,
        origin: Origin,
        repeat: Option<Repeat>,
        now_ms: u64,
    ) -> Result<Admitted, Refusal> {
        if let Some(asked) = &repeat
            && let Some(job) = self.repeated(asked)
        {
            let is_same =
                job.repeat.as_ref().is_some_and(|known| known.fingerprint == asked.fingerprint);
            return if is_same {
                Ok(Admitted::Before(job.id))
            } else {
                Err(Refusal::KeyReused { id: job.id })
            };
        }
        self.check_room(origin.owner.as_deref())?;
        if self.jobs.len() >= self.limits.most {
            return Err(Refusal::TooMany { limit: self.limits.most });
        }
        let id = self.next_id;
        self.next_id += 1;
        let turn = self.take_turn();
        let state = State::Queued { waits_for: None };
        let made = Made::default();
        let Origin { owner, request_id } = origin;
        let record = Record {
            id,
            spec,
            owner,
            request_id,
            repeat,
            state,
            made,
            created_ms: now_ms,
            since_ms: now_ms,
            turn,
            drawn: 0,
        };
        self.jobs.insert(id, record);
        Ok(Admitted::New(id))
    }

    /// Records the length of a new job's film, as far as its path tells.
    pub fn expect(&mut self, id: JobId, total: u64, fps: f64) {
        if let Some(job) = self.jobs.get_mut(&id) {
            (job.made.total, job.made.fps) = (Some(total), Some(fps));
        }
    }

    /// Checks the places for jobs that have not ended. A job that waits for its scene takes a place of its owner only, since it keeps
    /// nobody waiting.
    fn check_room(&self, owner: Option<&str>) -> Result<(), Refusal> {
        let unfinished = || self.jobs.values().filter(|job| !job.has_ended());
        let own = unfinished().filter(|job| job.owner.as_deref() == owner).count();
        let limit = self.limits.most_unfinished_per_owner();
        if owner.is_some() && own >= limit {
            return Err(Refusal::TooManyOfOwner { limit });
        }
        let waits = |job: &&Record| matches!(job.state, State::Queued { waits_for: Some(_) });
        let limit = self.limits.most_unfinished;
        let busy = unfinished().filter(|job| !waits(job)).count();
        if busy >= limit { Err(Refusal::TooManyUnfinished { limit }) } else { Ok(()) }
    }

    fn take_turn(&mut self) -> u64 {
        self.next_turn += 1;
        self.next_turn - 1
    }

    /// Takes the next job to run and its phase; the job is then running and held. `need` returns what a job lacks.
    pub fn next(&mut self, now_ms: u64, need: impl Fn(&Spec) -> Need) -> Option<(JobId, Phase)> {
        let ready = self.jobs.values().filter_map(|job| {
            let phase = self.phase_of(job, &need)?;
            let busy = self.at_work.values().filter(|work| work.phase == phase).count();
            let is_free = busy < self.limits.slots.of(phase);
            is_free.then_some((job, phase))
        });
        let at_work =
            |owner: &Option<String>| self.at_work.values().filter(|w| w.owner == *owner).count();
        let (job, phase) = ready.min_by_key(|(job, _)| (at_work(&job.owner), job.turn))?;
        let (id, owner) = (job.id, job.owner.clone());
        let job = self.jobs.get_mut(&id)?;
        if job.state != State::Running {
            (job.state, job.since_ms) = (State::Running, now_ms);
        }
        self.due.remove(&id);
        self.at_work.insert(id, Work { phase, owner });
        self.hold(id);
        Some((id, phase))
    }

    /// Returns the next phase of a job that waits and has everything that it needs.
    fn phase_of(&self, job: &Record, need: impl Fn(&Spec) -> Need) -> Option<Phase> {
        let is_due = match job.state {
            State::Queued { .. } => Phase::Drawing,
            State::Running => *self.due.get(&job.id)?,
            _ => return None,
        };
        if self.is_held(job.id) {
            return None;
        }
        match (is_due, need(&job.spec)) {
            // The frames are there.
            (Phase::Coding, _) => Some(Phase::Coding),
            (_, Need::Bake) => Some(Phase::Baking),
            (_, Need::Nothing) => Some(Phase::Drawing),
            (_, Need::Missing(_)) => None,
        }
    }

    /// Updates what queued jobs wait for, and since when; returns the changed jobs.
    pub fn note_missing(&mut self, now_ms: u64, need: impl Fn(&Spec) -> Need) -> Vec<JobId> {
        let mut changed = Vec::new();
        for job in self.jobs.values_mut() {
            let is_due = self.due.get(&job.id).is_some_and(|phase| *phase != Phase::Coding);
            if job.state == State::Running && is_due && !self.held.contains_key(&job.id) {
                // The input disappeared while the job waited for a place.
                if let Need::Missing(what) = need(&job.spec) {
                    self.due.remove(&job.id);
                    (job.state, job.since_ms) = (State::Queued { waits_for: Some(what) }, now_ms);
                    changed.push(job.id);
                }
            } else if let State::Queued { waits_for } = &mut job.state {
                let found = match need(&job.spec) {
                    Need::Missing(what) => Some(what),
                    Need::Bake | Need::Nothing => None,
                };
                if *waits_for != found {
                    *waits_for = found;
                    job.since_ms = now_ms;
                    changed.push(job.id);
                }
            }
        }
        changed
    }

    /// Records the end of a run; its runner still holds the job. Returns false when the job was removed meanwhile.
    pub fn left(
        &mut self,
        id: JobId,
        outcome: Outcome,
        made: Made,
        drawn: u64,
        now_ms: u64,
    ) -> bool {
        self.at_work.remove(&id);
        let Some(job) = self.jobs.get_mut(&id) else { return false };
        if let Some(phase) = apply_outcome(job, outcome, made, drawn, now_ms) {
            self.due.insert(id, phase);
        }
        true
    }

    /// Returns a job's record as [`Book::left`] would leave it.
    pub fn after_run(
        &self,
        id: JobId,
        outcome: Outcome,
        made: Made,
        drawn: u64,
        now_ms: u64,
    ) -> Result<Record, Refusal> {
        let mut job = self.get(id)?.clone();
        apply_outcome(&mut job, outcome, made, drawn, now_ms);
        Ok(job)
    }

    /// Cancels a job that has not ended. The caller must stop a runner that holds it.
    pub fn cancel(&mut self, id: JobId, now_ms: u64) -> Result<(), Refusal> {
        let job = self.jobs.get_mut(&id).ok_or(Refusal::Unknown)?;
        match job.state {
            State::Queued { .. } | State::Running => {
                (job.state, job.since_ms) = (State::Cancelled, now_ms);
                self.due.remove(&id);
                Ok(())
            }
            // Cancelling twice changes nothing.
            State::Cancelled => Ok(()),
            _ => Err(Refusal::State {
                state: job.state.name(),
                accepted: "a job that is queued or running",
            }),
        }
    }

    /// Queues an ended job again, behind all others. The run makes what is missing, even if the job was done.
    pub fn resume(&mut self, id: JobId, now_ms: u64) -> Result<(), Refusal> {
        let Record { state, owner, .. } = self.get(id)?;
        match state {
            State::Failed(_) | State::Cancelled | State::Done => {}
            State::Queued { .. } => return Ok(()),
            State::Running => {
                return Err(Refusal::State {
                    state: state.name(),
                    accepted: "a job that has ended",
                });
            }
        }
        self.check_room(owner.as_deref())?;
        let turn = self.take_turn();
        let job = self.jobs.get_mut(&id).ok_or(Refusal::Unknown)?;
        (job.state, job.since_ms, job.turn) = (State::Queued { waits_for: None }, now_ms, turn);
        Ok(())
    }

    /// Removes a job and holds it. A runner may hold it as well ([`Book::is_held`]); the caller must stop that.
    pub fn remove(&mut self, id: JobId) -> Result<Record, Refusal> {
        let record = self.jobs.remove(&id).ok_or(Refusal::Unknown)?;
        self.due.remove(&id);
        self.hold(id);
        Ok(record)
    }

    /// Shifts all times after the system's clock jumped, so that no job becomes older or younger. Returns the changed jobs.
    pub fn shift(&mut self, by_ms: i64) -> Vec<JobId> {
        for job in self.jobs.values_mut() {
            job.created_ms = job.created_ms.saturating_add_signed(by_ms);
            job.since_ms = job.since_ms.saturating_add_signed(by_ms);
        }
        self.jobs.keys().copied().collect()
    }

    /// Forgets jobs that ended long ago, and fails those that waited too long.
    pub fn expire(&mut self, now_ms: u64) -> Expired {
        let ttl_ms = self.limits.ttl_ms;
        let (mut expired, mut forgotten) = (Expired::default(), Vec::new());
        let is_old = |job: &Record| now_ms.saturating_sub(job.since_ms) >= ttl_ms;
        for job in self.jobs.values_mut().filter(|job| is_old(job)) {
            match &job.state {
                State::Queued { waits_for: Some(what) } => {
                    let seconds = ttl_ms / 1000;
                    let detail =
                        format!("{what}, for {seconds} seconds; load it and resume the job");
                    job.state = State::Failed(Failure { kind: FailureKind::SceneGone, detail });
                    job.since_ms = now_ms;
                    expired.failed.push(job.id);
                }
                State::Queued { .. } | State::Running => {}
                _ => forgotten.push(job.id),
            }
        }
        // A job that a runner still holds was cancelled long ago and will be released.
        forgotten.retain(|id| !self.is_held(*id));
        expired.forgotten = forgotten.into_iter().filter_map(|id| self.remove(id).ok()).collect();
        expired
    }
}

/// Changes the record of a job whose run has ended. Returns the phase in which the job goes on, if it does.
fn apply_outcome(
    job: &mut Record,
    outcome: Outcome,
    made: Made,
    drawn: u64,
    now_ms: u64,
) -> Option<Phase> {
    job.made = made;
    job.drawn += drawn;
    // A client has cancelled the job, and perhaps resumed it since; that decision stands.
    if job.state != State::Running {
        return None;
    }
    job.state = match outcome {
        Outcome::Next(phase) => return Some(phase),
        Outcome::Done => State::Done,
        Outcome::Failed(failure) => State::Failed(failure),
        Outcome::Paused => State::Queued { waits_for: None },
        Outcome::Waits(what) => State::Queued { waits_for: Some(what) },
    };
    job.since_ms = now_ms;
    None
}

#[cfg(test)]
mod tests;
