//! The daemon's side: for each film what `Collection` of `farm/daemon.rs` does.

use std::collections::VecDeque;

use super::machine::{Operation, Task};
use super::worker::Worker;
use super::{Event, Message, Outcome, Plan, Publisher, World, film_name};
use crate::capacity::station::Station;
use crate::farm::desk::Desk;
use crate::farm::messages::{Beat, Note};
use crate::farm::pacing::{Listings, MOST_NOTES, READS, TICK};
use crate::farm::roster::Roster;
use crate::film::Wanted;

/// Kind of the daemon and of all workers.
pub const KIND: &str = "0123456789abcdef0123456789abcdef";

/// What a film's thread does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// It has no runner yet.
    Queued,
    Listing,
    Publishing,
    Listening,
    Reading,
    Finished,
}

/// A film of the daemon.
struct Collection {
    phase: Phase,
    desk: Desk,
    inbox: VecDeque<Note>,
    /// Number of the latest tick; earlier ones are void.
    tick: u64,
    listings: Listings,
    to_read: VecDeque<u64>,
    reading: usize,
    to_keep: VecDeque<u64>,
    is_keeping: bool,
}

pub struct Daemon {
    films: Vec<Collection>,
    /// Films that wait for a runner.
    waiting: VecDeque<usize>,
    runners: usize,
    running: usize,
    left: usize,
    roster: Roster,
    station: Station,
}

impl Daemon {
    pub fn new(plan: &Plan) -> Daemon {
        let collection = |(number, film): (usize, &super::Film)| {
            let wanted = |number| Wanted { number, tag: format!("{number:032x}") };
            Collection {
                phase: Phase::Queued,
                desk: Desk::new(
                    &film_name(number),
                    String::new(),
                    (0..film.frames).map(wanted).collect(),
                ),
                inbox: VecDeque::new(),
                tick: 0,
                listings: Listings::default(),
                to_read: VecDeque::new(),
                reading: 0,
                to_keep: VecDeque::new(),
                is_keeping: false,
            }
        };
        Daemon {
            films: plan.films.iter().enumerate().map(collection).collect(),
            waiting: VecDeque::new(),
            runners: plan.runners.max(1),
            running: 0,
            left: plan.films.len(),
            roster: Roster::default(),
            station: Station::new(plan.daemon.cores),
        }
    }

    /// Returns whether all films are finished.
    pub fn is_done(&self) -> bool {
        self.left == 0
    }

    pub fn busy_ns(&self, now_ns: u64) -> u64 {
        self.station.busy_ns(now_ns)
    }

    pub fn start(&mut self, world: &mut World, film: usize) {
        if self.running >= self.runners {
            self.waiting.push_back(film);
            return;
        }
        self.running += 1;
        self.turn(world, film);
    }

    /// The head of the film's loop.
    fn turn(&mut self, world: &mut World, film: usize) {
        let now_ns = world.now_ns();
        let it = &mut self.films[film];
        if it.desk.is_clear() {
            it.phase = Phase::Finished;
            world.outcome.films[film].finished_ns = Some(now_ns);
            self.left -= 1;
            self.running -= 1;
            if let Some(next) = self.waiting.pop_front() {
                self.start(world, next);
            }
            return;
        }
        if it.listings.is_due(world.now()) {
            it.phase = Phase::Listing;
            let stored = world.frames[film].iter().filter(|frame| frame.is_stored).count();
            let at_ns = world.store.list(stored as u64, now_ns);
            world.events.add(at_ns, Event::Listed { film });
            return;
        }
        self.queue(world, film);
    }

    /// Takes everything that is in the store.
    pub fn listed(&mut self, world: &mut World, film: usize) {
        let it = &mut self.films[film];
        it.listings.listed(world.now());
        let stored = world.frames[film].iter().enumerate().filter(|(_, frame)| frame.is_stored);
        let numbers = stored.map(|(number, _)| number as u64);
        it.to_read.extend(numbers.filter(|number| it.desk.tag(*number).is_some()));
        it.phase = Phase::Reading;
        self.go_on_reading(world, film);
    }

    /// Queues runs, one after the other.
    fn queue(&mut self, world: &mut World, film: usize) {
        let workers = self.roster.of_kind(KIND, world.now());
        let it = &mut self.films[film];
        let Some(run) = it.desk.next(workers, self.running as u64, world.now()) else {
            self.listen(world, film);
            return;
        };
        it.phase = Phase::Publishing;
        world.outcome.runs += 1;
        world.publish(Message::new(film, run), Publisher::Film(film));
    }

    pub fn published(&mut self, world: &mut World, film: usize) {
        self.queue(world, film);
    }

    fn listen(&mut self, world: &mut World, film: usize) {
        let it = &mut self.films[film];
        if !it.inbox.is_empty() {
            self.take_notes(world, film);
            return;
        }
        it.phase = Phase::Listening;
        it.tick += 1;
        let number = it.tick;
        world.after(TICK, Event::Tick { film, number });
    }

    pub fn tick(&mut self, world: &mut World, film: usize, number: u64) {
        let it = &self.films[film];
        if it.phase == Phase::Listening && it.tick == number {
            self.look_for_lost(world, film);
            self.turn(world, film);
        }
    }

    pub fn hear(&mut self, world: &mut World, film: usize, note: Note) {
        let it = &mut self.films[film];
        if it.phase == Phase::Finished {
            return;
        }
        it.inbox.push_back(note);
        if it.phase == Phase::Listening {
            self.take_notes(world, film);
        }
    }

    fn take_notes(&mut self, world: &mut World, film: usize) {
        let now = world.now();
        let it = &mut self.films[film];
        it.listings.hear(now);
        for note in it.inbox.drain(..MOST_NOTES.min(it.inbox.len())) {
            match note {
                Note::Drawn { run, frame } | Note::SetAside { run, frame } => {
                    it.desk.seen(&[run], now);
                    it.to_read.push_back(frame);
                }
                Note::Finished { run, drawn, elapsed_ns } => {
                    it.desk.seen(&[run], now);
                    it.desk.measured(drawn, std::time::Duration::from_nanos(elapsed_ns));
                }
                Note::Failed { run, .. } => it.desk.seen(&[run], now),
            }
        }
        it.phase = Phase::Reading;
        self.go_on_reading(world, film);
    }

    /// Reads frames, a few at a time, and keeps those that were read. Goes on with the loop when all are kept.
    fn go_on_reading(&mut self, world: &mut World, film: usize) {
        let it = &mut self.films[film];
        while it.reading + it.to_keep.len() + usize::from(it.is_keeping) < READS
            && let Some(frame) = it.to_read.pop_front()
        {
            if it.desk.tag(frame).is_some() {
                it.reading += 1;
                let bytes = world.plan.films[film].image_bytes;
                let at_ns = world.store.serve(Operation::Get, bytes, world.events.now_ns());
                world.events.add(at_ns, Event::Read { film, frame });
            }
        }
        if !it.is_keeping
            && let Some(frame) = it.to_keep.pop_front()
        {
            it.is_keeping = true;
            let work_ns = world.plan.daemon.frame_ns;
            if !world.on_cores(Task::Keep { film, frame }, work_ns) {
                let at_ns = self.station.serve(world.now_ns(), work_ns);
                world.events.add(at_ns, Event::Kept { film, frame });
            }
        } else if it.reading == 0 && !it.is_keeping {
            self.look_for_lost(world, film);
            self.turn(world, film);
        }
    }

    pub fn read(&mut self, world: &mut World, film: usize, frame: u64) {
        let it = &mut self.films[film];
        it.reading -= 1;
        it.to_keep.push_back(frame);
        self.go_on_reading(world, film);
    }

    pub fn kept(&mut self, world: &mut World, film: usize, frame: u64) {
        let now_ns = world.now_ns();
        let it = &mut self.films[film];
        it.is_keeping = false;
        if it.desk.close(frame) {
            let result = &mut world.outcome.films[film];
            result.arrived += 1;
            result.measured += u64::from(now_ns >= world.plan.measure_from_ns);
            result.first_frame_ns.get_or_insert(now_ns);
        }
        self.go_on_reading(world, film);
    }

    fn look_for_lost(&mut self, world: &World, film: usize) {
        let now = world.now();
        let runs = self.roster.runs_of(&film_name(film), now);
        let has_idle = self.roster.has_idle(KIND, now);
        let it = &mut self.films[film];
        it.desk.seen(&runs, now);
        it.listings.see(&runs);
        it.desk.take_back(has_idle, now);
    }

    pub fn beat(&mut self, world: &mut World, number: usize, worker: &Worker) {
        self.station.serve(world.now_ns(), world.plan.daemon.beat_ns);
        let (busy, idle_ns) = worker.state(world.now_ns());
        let beat = Beat {
            identity: String::new(),
            worker: format!("{number:040}"),
            kind: KIND.to_owned(),
            adapter: String::new(),
            version: String::new(),
            busy,
            idle_ms: idle_ns / 1_000_000,
            is_paused: false,
        };
        self.roster.hear(beat, world.now());
    }

    /// Adds the load of the busiest film's thread.
    pub fn report(&self, outcome: &mut Outcome, measured_ns: f64, frame_ns: u64) {
        let most = outcome.films.iter().map(|film| film.measured).max().unwrap_or(0);
        outcome.film_load = (most * frame_ns) as f64 / measured_ns;
    }
}
