//! All jobs and what may become of them. Pure: times come in, and which records changed comes out; no clock, lock or file.
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
//! A running job goes through phases, each with so many places for all jobs together ([`Slots`]): what it needs is baked, its
//! frames are drawn, and its video is coded. Between two phases it waits for a place, and others have the one that it leaves. Of
//! those that wait the next is of the owner who has the fewest at work, and of those the one that came first.
//!
//! Who works on a job, or on its files, holds it until that is over ([`Book::release`]), also when the job was cancelled or removed
//! meanwhile; no runner gets it before, even if it was resumed. Who is the last to hold a job that was removed clears up after it. Done,
//! failed and cancelled jobs are forgotten when they have been that for as long as [`Limits::ttl_ms`].

use std::collections::BTreeMap;

pub use super::record::{Failure, FailureKind, Made, Record, Repeat, State, Video};
use super::spec::Spec;

/// What a book takes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Jobs that are not done, failed or cancelled.
    pub most_unfinished: usize,
    /// Jobs at all.
    pub most: usize,
    /// How long an ended job is kept, and a queued one waits for its scene.
    pub ttl_ms: u64,
    pub slots: Slots,
}

/// A job's number.
pub type JobId = u64;

/// What is done for a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// What its frames need, and others may need too.
    Baking,
    Drawing,
    /// The video of its frames.
    Coding,
}

/// Jobs that may be in each phase at a time.
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

    /// Jobs that are worked on at a time.
    pub fn all(&self) -> usize {
        self.baking + self.drawing + self.coding
    }
}

/// What a job needs before its frames can be drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Need {
    /// Something that is not there and may come.
    Missing(String),
    Bake,
    Nothing,
}

/// How a run of a job ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Done,
    Failed(Failure),
    /// The daemon stops; the next one goes on.
    Paused,
    /// Something is missing that may come back.
    Waits(String),
    /// It is to go on in this phase.
    Next(Phase),
}

/// Why a job is not taken on, or not changed.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    Unknown,
    /// The state that it is in does not allow it.
    State {
        state: &'static str,
        accepted: &'static str,
    },
    /// The key was used for another job.
    KeyReused {
        id: JobId,
    },
    TooManyUnfinished {
        limit: usize,
    },
    TooMany {
        limit: usize,
    },
}

/// What [`Book::admit`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Admitted {
    New(JobId),
    /// It was asked for before.
    Before(JobId),
}

/// What time has made of jobs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expired {
    /// Removed, and held by who asked.
    pub forgotten: Vec<Record>,
    pub failed: Vec<JobId>,
}

/// What a runner does.
#[derive(Clone, Debug, PartialEq)]
struct Work {
    phase: Phase,
    owner: Option<String>,
}

/// Who makes a job, and under which name.
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
    /// How many hold a job. Some may be in `jobs` no more.
    held: BTreeMap<JobId, usize>,
    /// Jobs that runners have, and what they do for each.
    at_work: BTreeMap<JobId, Work>,
    /// Phases that running jobs wait for, when no runner has them.
    due: BTreeMap<JobId, Phase>,
    next_id: JobId,
    next_turn: u64,
}

impl Book {
    /// A book of what an earlier process has kept. What was running then is queued again, in its old place. No id up to `last_id` is
    /// given out again.
    pub fn new(limits: Limits, kept: impl IntoIterator<Item = Record>, last_id: JobId) -> Book {
        let mut jobs: BTreeMap<JobId, Record> = BTreeMap::new();
        for mut record in kept {
            // What waited may have what it waits for soon, and has its time for that anew.
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

    /// All jobs by their numbers.
    pub fn all(&self) -> impl Iterator<Item = &Record> {
        self.jobs.values()
    }

    pub fn is_held(&self, id: JobId) -> bool {
        self.held.contains_key(&id)
    }

    /// Keeps runners from a job until [`Book::release`].
    pub fn hold(&mut self, id: JobId) {
        *self.held.entry(id).or_insert(0) += 1;
    }

    /// Lets go of a job once. True when it was removed meanwhile and nobody else holds it: what it has left is the caller's to
    /// remove.
    pub fn release(&mut self, id: JobId) -> bool {
        if let Some(holders) = self.held.get_mut(&id) {
            *holders -= 1;
            if *holders == 0 {
                self.held.remove(&id);
            }
        }
        !self.is_held(id) && !self.jobs.contains_key(&id)
    }

    /// Puts a record back that could not be changed on the disk: in the place of that which has its turn since, or where there is none.
    pub fn restore(&mut self, mut record: Record, turn: u64) {
        if record.state == State::Running && !self.at_work.contains_key(&record.id) {
            record.state = State::Queued { waits_for: None };
        }
        let now = self.jobs.get(&record.id);
        if now.is_none_or(|now| now.turn == turn && matches!(now.state, State::Queued { .. })) {
            self.jobs.insert(record.id, record);
        }
    }

    /// The job that the same owner has made with the same key.
    pub fn repeated(&self, asked: &Repeat) -> Option<&Record> {
        let same = |known: &Repeat| known.owner == asked.owner && known.key == asked.key;
        self.jobs.values().find(|job| job.repeat.as_ref().is_some_and(same))
    }

    fn unfinished(&self) -> usize {
        self.jobs.values().filter(|job| !job.has_ended()).count()
    }

    /// Takes on a job, or finds the one that was made by the same request before.
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
        self.check_room()?;
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

    /// Notes what a job that was just made will come to, as far as its path tells now.
    pub fn expect(&mut self, id: JobId, total: u64, fps: f64) {
        if let Some(job) = self.jobs.get_mut(&id) {
            (job.made.total, job.made.fps) = (Some(total), Some(fps));
        }
    }

    fn check_room(&self) -> Result<(), Refusal> {
        let limit = self.limits.most_unfinished;
        if self.unfinished() >= limit { Err(Refusal::TooManyUnfinished { limit }) } else { Ok(()) }
    }

    fn take_turn(&mut self) -> u64 {
        self.next_turn += 1;
        self.next_turn - 1
    }

    /// The job whose turn it is, which runs from now on and is held, and in which phase. `need` says what a job lacks.
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

    /// What is to be done next for a job that waits and has all that it waits for.
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
            // It has its frames.
            (Phase::Coding, _) => Some(Phase::Coding),
            (_, Need::Bake) => Some(Phase::Baking),
            (_, Need::Nothing) => Some(Phase::Drawing),
            (_, Need::Missing(_)) => None,
        }
    }

    /// Notes what queued jobs wait for, and since when; those that changed.
    pub fn note_missing(&mut self, now_ms: u64, need: impl Fn(&Spec) -> Need) -> Vec<JobId> {
        let mut changed = Vec::new();
        for job in self.jobs.values_mut() {
            let is_due = self.due.get(&job.id).is_some_and(|phase| *phase != Phase::Coding);
            if job.state == State::Running && is_due && !self.held.contains_key(&job.id) {
                // Gone while it waited for a place.
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

    /// Notes how a run ended, whose runner holds the job still. False when the job was removed meanwhile.
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
        job.made = made;
        job.drawn += drawn;
        // Whoever cancelled it, and perhaps resumed it since, has decided already.
        if job.state != State::Running {
            return true;
        }
        job.state = match outcome {
            Outcome::Next(phase) => {
                self.due.insert(id, phase);
                return true;
            }
            Outcome::Done => State::Done,
            Outcome::Failed(failure) => State::Failed(failure),
            Outcome::Paused => State::Queued { waits_for: None },
            Outcome::Waits(what) => State::Queued { waits_for: Some(what) },
        };
        job.since_ms = now_ms;
        true
    }

    /// Ends a job that has not ended. A runner that holds it is to be told.
    pub fn cancel(&mut self, id: JobId, now_ms: u64) -> Result<(), Refusal> {
        let job = self.jobs.get_mut(&id).ok_or(Refusal::Unknown)?;
        match job.state {
            State::Queued { .. } | State::Running => {
                (job.state, job.since_ms) = (State::Cancelled, now_ms);
                self.due.remove(&id);
                Ok(())
            }
            // Asked for twice, it is as it was asked for.
            State::Cancelled => Ok(()),
            _ => Err(Refusal::State {
                state: job.state.name(),
                accepted: "a job that is queued or running",
            }),
        }
    }

    /// Queues an ended job again, behind all others: what is missing of it is made, also where it was done.
    pub fn resume(&mut self, id: JobId, now_ms: u64) -> Result<(), Refusal> {
        let state = &self.get(id)?.state;
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
        self.check_room()?;
        let turn = self.take_turn();
        let job = self.jobs.get_mut(&id).ok_or(Refusal::Unknown)?;
        (job.state, job.since_ms, job.turn) = (State::Queued { waits_for: None }, now_ms, turn);
        Ok(())
    }

    /// Takes a job out and holds it. A runner may hold it as well ([`Book::is_held`]) and is to be told.
    pub fn remove(&mut self, id: JobId) -> Result<Record, Refusal> {
        let record = self.jobs.remove(&id).ok_or(Refusal::Unknown)?;
        self.due.remove(&id);
        self.hold(id);
        Ok(record)
    }

    /// Moves all times by so many milliseconds, because the clock was put there: nothing becomes older or younger by that. Those that
    /// were moved.
    pub fn shift(&mut self, by_ms: i64) -> Vec<JobId> {
        for job in self.jobs.values_mut() {
            job.created_ms = job.created_ms.saturating_add_signed(by_ms);
            job.since_ms = job.since_ms.saturating_add_signed(by_ms);
        }
        self.jobs.keys().copied().collect()
    }

    /// Forgets what ended long ago, and ends what has waited too long.
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
        // What a runner still holds has been cancelled long ago and will be let go.
        forgotten.retain(|id| !self.is_held(*id));
        expired.forgotten = forgotten.into_iter().filter_map(|id| self.remove(id).ok()).collect();
        expired
    }
}

#[cfg(test)]
#[path = "book_tests.rs"]
mod tests;
