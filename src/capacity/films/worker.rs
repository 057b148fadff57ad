//! A worker: what `farm/worker.rs` does with a run.

use std::collections::{BTreeSet, VecDeque};

use super::machine::{Operation, Task};
use super::{Event, Message, Name, Publisher, World, film_name};
use crate::farm::messages::{Note, Run};
use crate::farm::pacing::{BEAT, PROGRESS, PULL, STORES, UNSTORED, Verdict, judge, may_be_stored};

/// Bytes of a film's order.
const ORDER_BYTES: u64 = 2_000;

/// Operations before drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    ReadOrder,
    ReadTries,
    CountTry,
    LookForFrames,
    LoadScene,
    Draw,
    Split,
}

/// A run in work.
#[derive(Debug)]
struct Work {
    /// Number of the delivery.
    number: u64,
    film: usize,
    run: Run,
    stage: Stage,
    /// Frames that have not been looked for, and lookups under way.
    to_look: usize,
    looking: usize,
    to_draw: VecDeque<u64>,
    drawing: Option<u64>,
    /// Drawn frames that wait, and frames that are being stored.
    unstored: VecDeque<u64>,
    storing: usize,
    drawn: u64,
    began_ns: u64,
    /// Runs of single frames to publish.
    split: VecDeque<Run>,
}

#[derive(Debug)]
pub struct Worker {
    number: usize,
    generation: u64,
    work: Option<Work>,
    since_ns: u64,
    pulls: u64,
    scenes: BTreeSet<usize>,
}

impl Worker {
    pub fn new(number: usize) -> Worker {
        let scenes = BTreeSet::new();
        Worker { number, generation: 0, work: None, since_ns: 0, pulls: 0, scenes }
    }

    pub fn name(&self) -> Name {
        Name { worker: self.number, generation: self.generation }
    }

    /// Returns the run in work by its film's name, and for how long the worker has been idle.
    pub fn state(&self, now_ns: u64) -> (Option<(String, u64)>, u64) {
        match &self.work {
            Some(work) => (Some((film_name(work.film), work.run.id)), 0),
            None => (None, now_ns - self.since_ns),
        }
    }

    pub fn beat(&mut self, world: &mut World) {
        world.tell(Event::BeatCame { worker: self.number });
        world.after(BEAT, Event::Beat(self.name()));
    }

    /// Asks for a run.
    pub fn pull(&mut self, world: &mut World) {
        self.work = None;
        self.since_ns = world.now_ns();
        self.send_pull(world);
    }

    fn send_pull(&mut self, world: &mut World) {
        self.pulls += 1;
        let now_ns = world.now_ns();
        world.broker.forget(self.name());
        world.broker.pull(self.name(), now_ns);
        world.after(PULL, Event::Pulls(self.name(), self.pulls));
        world.deliver();
    }

    /// Asks again when no run came.
    pub fn pull_again(&mut self, world: &mut World, number: u64) {
        if self.work.is_none() && self.pulls == number {
            self.send_pull(world);
        }
    }

    pub fn die(&mut self, world: &mut World) {
        world.broker.forget(self.name());
        world.machine.stop(self.name(), world.events.now_ns());
        self.generation += 1;
        self.work = None;
        world.look_at_cores();
    }

    pub fn take(&mut self, world: &mut World, number: u64) {
        let Some(Message { film, run, .. }) = world.broker.delivered(number).cloned() else {
            return self.pull(world);
        };
        self.pulls += 1;
        self.work = Some(Work {
            number,
            film,
            to_look: run.frames.len(),
            run,
            stage: Stage::ReadOrder,
            looking: 0,
            to_draw: VecDeque::new(),
            drawing: None,
            unstored: VecDeque::new(),
            storing: 0,
            drawn: 0,
            began_ns: 0,
            split: VecDeque::new(),
        });
        self.prepare(world, Operation::Get, ORDER_BYTES);
        world.after(PROGRESS, Event::Progress { of: self.name(), number });
    }

    /// Begins an operation of the store, at whose end [`Worker::prepared`] is called.
    fn prepare(&self, world: &mut World, operation: Operation, bytes: u64) {
        let at_ns = world.store.serve(operation, bytes, world.events.now_ns());
        world.events.add(at_ns, Event::Prepared(self.name()));
    }

    pub fn prepared(&mut self, world: &mut World) {
        let Some(work) = &mut self.work else { return };
        match work.stage {
            Stage::ReadOrder if world.outcome.films[work.film].finished_ns.is_some() => {
                self.acknowledge(world);
            }
            Stage::ReadOrder => {
                work.stage = Stage::ReadTries;
                self.prepare(world, Operation::Get, 0);
            }
            Stage::ReadTries => {
                work.stage = Stage::CountTry;
                self.prepare(world, Operation::Put, 0);
            }
            Stage::CountTry => self.decide(world),
            Stage::LookForFrames => {
                work.looking -= 1;
                self.look_for_frames(world);
            }
            Stage::LoadScene | Stage::Draw | Stage::Split => {}
        }
    }

    fn decide(&mut self, world: &mut World) {
        let Some(work) = &mut self.work else { return };
        let tries = world.tries.entry((work.film, work.run.key())).or_insert(0);
        let begun = *tries;
        *tries += 1;
        match judge(begun, begun, work.run.frames.len()) {
            Verdict::Split => {
                work.stage = Stage::Split;
                work.split = work.run.split().collect();
                self.published(world);
            }
            // Frames that kill workers are no question of capacity: a frame is drawn however often its workers are killed.
            Verdict::Draw | Verdict::SetAside => {
                work.stage = Stage::LookForFrames;
                if !may_be_stored(begun, work.run.frames.len()) {
                    work.to_look = 0;
                }
                self.look_for_frames(world);
            }
        }
    }

    /// Publishes the next run of a single frame.
    pub fn published(&mut self, world: &mut World) {
        let name = self.name();
        let Some(work) = &mut self.work else { return };
        match work.split.pop_front() {
            Some(run) => {
                let message = Message::new(work.film, run);
                world.outcome.runs += 1;
                world.publish(message, Publisher::Worker(name));
            }
            None => self.clear_up(world),
        }
    }

    fn look_for_frames(&mut self, world: &mut World) {
        let name = self.name();
        let Some(work) = &mut self.work else { return };
        while work.looking < STORES && work.to_look > 0 {
            work.looking += 1;
            work.to_look -= 1;
            let at_ns = world.store.serve(Operation::Head, 0, world.events.now_ns());
            world.events.add(at_ns, Event::Prepared(name));
        }
        if work.looking > 0 {
            return;
        }
        for frame in work.run.frames.iter().map(|frame| frame.number) {
            if world.frames[work.film][frame as usize].is_stored {
                let note = Note::Drawn { run: work.run.id, frame };
                world.tell(Event::NoteCame { film: work.film, note });
            } else {
                work.to_draw.push_back(frame);
            }
        }
        let scene = world.plan.films[work.film].scene;
        if work.to_draw.is_empty() {
            self.clear_up(world);
        } else if self.scenes.insert(scene) {
            work.stage = Stage::LoadScene;
            let (bytes, now_ns) = (world.plan.scene_bytes, world.now_ns());
            let at_ns = world.store.serve(Operation::Get, bytes, now_ns) + world.plan.scene_ns;
            world.events.add(at_ns, Event::SceneLoaded(name));
        } else {
            self.scene_loaded(world);
        }
    }

    pub fn scene_loaded(&mut self, world: &mut World) {
        let Some(work) = &mut self.work else { return };
        work.stage = Stage::Draw;
        work.began_ns = world.now_ns();
        self.go_on(world);
    }

    pub fn drawn(&mut self, world: &mut World) {
        let Some(work) = &mut self.work else { return };
        let Some(number) = work.drawing.take() else { return };
        let frame = &mut world.frames[work.film][number as usize];
        world.outcome.frames_drawn += 1;
        world.outcome.drawn_again += u64::from(frame.is_drawn);
        frame.is_drawn = true;
        work.drawn += 1;
        work.unstored.push_back(number);
        self.go_on(world);
    }

    pub fn stored(&mut self, world: &mut World, number: u64) {
        let Some(work) = &mut self.work else { return };
        work.storing -= 1;
        world.frames[work.film][number as usize].is_stored = true;
        let note = Note::Drawn { run: work.run.id, frame: number };
        world.tell(Event::NoteCame { film: work.film, note });
        self.go_on(world);
    }

    /// Stores and draws further frames, and ends the run when all are stored.
    fn go_on(&mut self, world: &mut World) {
        let name = self.name();
        let Some(work) = &mut self.work else { return };
        let film = &world.plan.films[work.film];
        let (frame_ns, bytes) = (film.frame_ns, film.image_bytes);
        while work.storing < STORES
            && let Some(number) = work.unstored.pop_front()
        {
            work.storing += 1;
            let at_ns = world.store.serve(Operation::Put, bytes, world.events.now_ns());
            world.events.add(at_ns, Event::Stored(name, number));
        }
        let may_draw = work.drawing.is_none() && work.unstored.len() < UNSTORED;
        if may_draw && let Some(number) = work.to_draw.pop_front() {
            work.drawing = Some(number);
            if !world.on_cores(Task::Draw(name), frame_ns) {
                world.events.add(world.now_ns() + frame_ns, Event::Drawn(name));
            }
        }
        let Some(work) = &mut self.work else { return };
        if work.drawing.is_none() && work.unstored.is_empty() && work.storing == 0 {
            let elapsed_ns = world.now_ns() - work.began_ns;
            let note = Note::Finished { run: work.run.id, drawn: work.drawn, elapsed_ns };
            world.tell(Event::NoteCame { film: work.film, note });
            self.clear_up(world);
        }
    }

    /// Reads the order once more, to see whether the film is over.
    fn clear_up(&mut self, world: &mut World) {
        let at_ns = world.store.serve(Operation::Get, ORDER_BYTES, world.events.now_ns());
        world.events.add(at_ns, Event::Cleared(self.name()));
    }

    pub fn cleared(&mut self, world: &mut World) {
        self.acknowledge(world);
    }

    fn acknowledge(&mut self, world: &mut World) {
        let Some(work) = &self.work else { return };
        let now_ns = world.now_ns();
        let at_ns = world.broker.acknowledge(now_ns);
        let number = work.number;
        world.events.add(at_ns, Event::Acknowledged { of: self.name(), number });
    }

    pub fn progress(&mut self, world: &mut World, number: u64) {
        if self.work.as_ref().is_some_and(|work| work.number == number) {
            let now_ns = world.now_ns();
            let at_ns = world.broker.progress(now_ns);
            world.events.add(at_ns, Event::ProgressCame { number });
            world.after(PROGRESS, Event::Progress { of: self.name(), number });
        }
    }
}
