//! Films drawn by workers. The daemon's side decides with its own [`Desk`](crate::farm::desk::Desk), [`Roster`](crate::farm::roster::Roster) and
//! [`pacing`](crate::farm::pacing); the messages and operations are those of `farm/daemon.rs` and `farm/worker.rs`:
//!
//! | who | when | does |
//! |---|---|---|
//! | daemon | a film may have another run | publishes it, and waits for the acknowledgement |
//! | worker | it has nothing to do | pulls |
//! | worker | it gets a run | reads the order, counts the try, and looks for each frame if the run was begun before |
//! | worker | it draws a run | tells the broker so every [`PROGRESS`](crate::farm::pacing::PROGRESS) |
//! | worker | a frame is drawn | stores it, then sends a note |
//! | worker | all frames are stored | sends a note, reads the order, acknowledges the run |
//! | worker | always | sends a beat every second |
//! | daemon | a note comes | reads the frame and keeps it, one film on one thread |
//! | daemon | no note came for a while | lists the film in the store, less and less often while nothing is new |
//! | broker | no word of a run for [`ACK_WAIT`](crate::farm::pacing::ACK_WAIT) | delivers it again |

mod broker;
mod daemon;
mod machine;
mod worker;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::costs::{BrokerCosts, DaemonCosts, StoreCosts};
use super::events::Events;
use crate::farm::messages::{Note, Run};
use broker::Broker;
use daemon::Daemon;
use machine::{Machine, Store};
use worker::Worker;

/// One film.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    pub starts_ns: u64,
    pub frames: u64,
    /// Time in which a worker draws a frame; on shared cores, CPU time.
    pub frame_ns: u64,
    pub image_bytes: u64,
    /// Number of the scene. A worker loads a scene with the first run that needs it.
    pub scene: usize,
}

/// A cluster and its work.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    pub workers: usize,
    pub films: Vec<Film>,
    /// Films that the daemon draws at a time; others wait.
    pub runners: usize,
    pub broker: BrokerCosts,
    pub store: StoreCosts,
    pub daemon: DaemonCosts,
    /// Bytes of a scene's files, and the time to load them.
    pub scene_bytes: u64,
    pub scene_ns: u64,
    /// Cores that daemon and workers share; `None`: each worker has a machine, and so has the daemon.
    pub shared_cores: Option<f64>,
    /// Workers that are killed, and when.
    pub lost: Vec<(u64, usize)>,
    /// When the broker ends, and when it is there again.
    pub broker_restart: Option<(u64, u64)>,
    /// When the simulation ends if films are not finished, and from when its rates count.
    pub until_ns: u64,
    pub measure_from_ns: u64,
}

/// What became of a film.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilmResult {
    pub first_frame_ns: Option<u64>,
    pub finished_ns: Option<u64>,
    /// Frames that arrived, of which some in the measured time.
    pub arrived: u64,
    pub measured: u64,
}

/// Result of a simulation. Loads are shares of the measured time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    pub films: Vec<FilmResult>,
    pub measured_s: f64,
    pub frames_per_s: f64,
    pub broker_load: f64,
    pub store_load: f64,
    pub link_load: f64,
    /// CPU time of the daemon over its cores, and of the busiest film's thread.
    pub daemon_load: f64,
    pub film_load: f64,
    /// Messages to the broker, and operations of the store.
    pub messages: u64,
    pub operations: u64,
    pub frames_drawn: u64,
    pub drawn_again: u64,
    pub redelivered: u64,
    pub runs: u64,
    pub end_ns: u64,
}

/// Everything that happens at a time.
#[derive(Debug)]
enum Event {
    FilmStarts(usize),
    /// The broker has confirmed a run.
    Published(Message, Publisher),
    Tick {
        film: usize,
        number: u64,
    },
    NoteCame {
        film: usize,
        note: Note,
    },
    BeatCame {
        worker: usize,
    },
    Listed {
        film: usize,
    },
    Read {
        film: usize,
        frame: u64,
    },
    Kept {
        film: usize,
        frame: u64,
    },
    Delivered {
        to: Name,
        number: u64,
    },
    Pulls(Name, u64),
    /// One of the operations before drawing is done.
    Prepared(Name),
    SceneLoaded(Name),
    Drawn(Name),
    Stored(Name, u64),
    Cleared(Name),
    Acknowledged {
        of: Name,
        number: u64,
    },
    Progress {
        of: Name,
        number: u64,
    },
    ProgressCame {
        number: u64,
    },
    AckDue {
        number: u64,
    },
    Beat(Name),
    Lost(usize),
    BrokerEnds {
        until_ns: u64,
    },
    CoresDue {
        number: u64,
    },
    Measure,
}

/// A worker process. Events of a process that was killed are void.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Name {
    worker: usize,
    generation: u64,
}

/// Who waits for the confirmation of a run.
#[derive(Clone, Copy, Debug)]
enum Publisher {
    Film(usize),
    Worker(Name),
}

/// A run in the broker.
#[derive(Clone, Debug)]
struct Message {
    film: usize,
    run: Run,
    bytes: u64,
}

impl Message {
    fn new(film: usize, run: Run) -> Message {
        let bytes = serde_json::to_vec(&run).map_or(0, |text| text.len() as u64);
        Message { film, run, bytes }
    }
}

/// What all parts of the simulation use.
struct World {
    plan: Plan,
    start: Instant,
    events: Events<Event>,
    broker: Broker,
    store: Store,
    machine: Machine,
    /// Frames of each film, by number.
    frames: Vec<Vec<Frame>>,
    /// How often runs were begun, by film and name of the run.
    tries: BTreeMap<(usize, String), u64>,
    outcome: Outcome,
}

/// A frame's state outside the daemon.
#[derive(Clone, Copy, Debug, Default)]
struct Frame {
    is_drawn: bool,
    is_stored: bool,
}

impl World {
    fn now_ns(&self) -> u64 {
        self.events.now_ns()
    }

    /// Returns the present in the time of the program's own code.
    fn now(&self) -> Instant {
        self.start + Duration::from_nanos(self.now_ns())
    }

    fn after(&mut self, wait: Duration, event: Event) {
        self.events.add(self.now_ns() + wait.as_nanos() as u64, event);
    }

    /// Sends a message over the broker that may get lost while the broker restarts.
    fn tell(&mut self, event: Event) {
        let now_ns = self.now_ns();
        if let Some(at_ns) = self.broker.tell(now_ns) {
            self.events.add(at_ns, event);
        }
    }
}

/// Names of films in messages.
fn film_name(film: usize) -> String {
    // As long as a real one.
    format!("{film:032}")
}

/// Simulates a plan.
pub fn simulate(plan: &Plan) -> Outcome {
    let world = World {
        broker: Broker::new(plan.broker),
        store: Store::new(plan.store),
        machine: Machine::new(plan.shared_cores),
        frames: plan
            .films
            .iter()
            .map(|film| vec![Frame::default(); film.frames as usize])
            .collect(),
        tries: BTreeMap::new(),
        start: Instant::now(),
        events: Events::default(),
        outcome: Outcome {
            films: vec![FilmResult::default(); plan.films.len()],
            ..Outcome::default()
        },
        plan: plan.clone(),
    };
    let daemon = Daemon::new(plan);
    let workers = (0..plan.workers).map(Worker::new).collect();
    let mut simulation = Simulation { world, daemon, workers, before: Loads::default() };
    simulation.begin();
    while let Some(at_ns) = simulation.world.events.next_ns() {
        if at_ns > plan.until_ns || simulation.daemon.is_done() {
            break;
        }
        let Some(event) = simulation.world.events.pop() else { break };
        simulation.happens(event);
    }
    simulation.finish()
}

/// Returns a worker, unless the process of this name was killed.
fn alive(workers: &mut [Worker], name: Name) -> Option<&mut Worker> {
    workers.get_mut(name.worker).filter(|worker| worker.name() == name)
}

/// Busy times up to now.
#[derive(Clone, Copy, Debug, Default)]
struct Loads {
    at_ns: u64,
    broker_ns: u64,
    store_ns: u64,
    link_ns: u64,
    daemon_ns: u64,
}

struct Simulation {
    world: World,
    daemon: Daemon,
    workers: Vec<Worker>,
    before: Loads,
}

impl Simulation {
    fn begin(&mut self) {
        let Self { world, workers, .. } = self;
        let plan = world.plan.clone();
        world.events.add(plan.measure_from_ns, Event::Measure);
        for (number, worker) in workers.iter_mut().enumerate() {
            // Workers do not beat all at once.
            let offset_ns = number as u64 * 1_000_000_000 / plan.workers.max(1) as u64;
            world.events.add(offset_ns, Event::Beat(worker.name()));
            worker.pull(world);
        }
        for (number, film) in plan.films.iter().enumerate() {
            world.events.add(film.starts_ns, Event::FilmStarts(number));
        }
        for (at_ns, worker) in &plan.lost {
            world.events.add(*at_ns, Event::Lost(*worker));
        }
        if let Some((from_ns, until_ns)) = plan.broker_restart {
            world.events.add(from_ns, Event::BrokerEnds { until_ns });
        }
    }

    fn happens(&mut self, event: Event) {
        let Self { world, daemon, workers, .. } = self;
        match event {
            Event::FilmStarts(film) => daemon.start(world, film),
            Event::Published(message, publisher) => {
                world.broker.store(message);
                match publisher {
                    Publisher::Film(film) => daemon.published(world, film),
                    Publisher::Worker(name) => {
                        if let Some(worker) = alive(workers, name) {
                            worker.published(world);
                        }
                    }
                }
                world.deliver();
            }
            Event::Tick { film, number } => daemon.tick(world, film, number),
            Event::NoteCame { film, note } => daemon.hear(world, film, note),
            Event::BeatCame { worker } => daemon.beat(world, worker, &workers[worker]),
            Event::Listed { film } => daemon.listed(world, film),
            Event::Read { film, frame } => daemon.read(world, film, frame),
            Event::Kept { film, frame } => daemon.kept(world, film, frame),
            Event::Delivered { to, number } => {
                // The run of a worker that was killed is delivered again when nothing is heard of it.
                if let Some(worker) = alive(workers, to) {
                    worker.take(world, number);
                }
            }
            Event::Pulls(name, number) => {
                if let Some(worker) = alive(workers, name) {
                    worker.pull_again(world, number);
                }
            }
            Event::Prepared(name) => {
                if let Some(worker) = alive(workers, name) {
                    worker.prepared(world);
                }
            }
            Event::SceneLoaded(name) => {
                if let Some(worker) = alive(workers, name) {
                    worker.scene_loaded(world);
                }
            }
            Event::Drawn(name) => {
                if let Some(worker) = alive(workers, name) {
                    worker.drawn(world);
                }
            }
            Event::Stored(name, frame) => {
                if let Some(worker) = alive(workers, name) {
                    worker.stored(world, frame);
                }
            }
            Event::Cleared(name) => {
                if let Some(worker) = alive(workers, name) {
                    worker.cleared(world);
                }
            }
            Event::Acknowledged { of, number } => {
                world.broker.end(number);
                if let Some(worker) = alive(workers, of) {
                    worker.pull(world);
                }
                world.deliver();
            }
            Event::Progress { of, number } => {
                if let Some(worker) = alive(workers, of) {
                    worker.progress(world, number);
                }
            }
            Event::ProgressCame { number } => {
                let now_ns = world.now_ns();
                world.broker.renew(number, now_ns);
            }
            Event::AckDue { number } => world.ack_due(number),
            Event::Beat(name) => {
                if let Some(worker) = alive(workers, name) {
                    worker.beat(world);
                }
            }
            Event::Lost(worker) => {
                if let Some(worker) = workers.get_mut(worker) {
                    worker.die(world);
                }
            }
            Event::BrokerEnds { until_ns } => world.broker.close(until_ns),
            Event::CoresDue { number } => {
                let now_ns = world.now_ns();
                let Some(tasks) = world.machine.due(number, now_ns) else { return };
                for task in tasks {
                    match task {
                        machine::Task::Draw(name) => {
                            if let Some(worker) = alive(workers, name) {
                                worker.drawn(world);
                            }
                        }
                        machine::Task::Keep { film, frame } => daemon.kept(world, film, frame),
                    }
                }
                world.look_at_cores();
            }
            Event::Measure => self.before = self.loads(),
        }
    }

    fn loads(&self) -> Loads {
        let now_ns = self.world.now_ns();
        let (store_ns, link_ns) = self.world.store.busy_ns(now_ns);
        Loads {
            at_ns: now_ns,
            broker_ns: self.world.broker.busy_ns(now_ns),
            store_ns,
            link_ns,
            daemon_ns: self.daemon.busy_ns(now_ns),
        }
    }

    fn finish(mut self) -> Outcome {
        let (now, before) = (self.loads(), self.before);
        let Self { world, daemon, .. } = &mut self;
        let measured_ns = now.at_ns.saturating_sub(before.at_ns).max(1) as f64;
        let share = |now: u64, before: u64, servers: usize| {
            now.saturating_sub(before) as f64 / measured_ns / servers as f64
        };
        let mut outcome = std::mem::take(&mut world.outcome);
        daemon.report(&mut outcome, measured_ns, world.plan.daemon.frame_ns);
        let measured: u64 = outcome.films.iter().map(|film| film.measured).sum();
        outcome.measured_s = measured_ns / 1e9;
        outcome.frames_per_s = measured as f64 / outcome.measured_s;
        outcome.broker_load = share(now.broker_ns, before.broker_ns, 1);
        outcome.store_load = share(now.store_ns, before.store_ns, world.plan.store.servers);
        outcome.link_load = share(now.link_ns, before.link_ns, 1);
        outcome.daemon_load = share(now.daemon_ns, before.daemon_ns, world.plan.daemon.cores);
        outcome.messages = world.broker.messages();
        outcome.operations = world.store.operations();
        outcome.end_ns = now.at_ns;
        outcome
    }
}

#[cfg(test)]
mod tests;
