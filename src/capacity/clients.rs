//! Clients of several daemons behind a load balancer that hashes by scene. Each daemon is the engine's own queue with its estimates, a device and
//! encoders.

use std::collections::BTreeSet;
use std::time::Instant;

use super::events::Events;
use super::ring::{Ring, is_within};
use super::station::Station;
use crate::engine::Client;
use crate::engine::queue::Shares;
use crate::engine::queue::simulation::{Device, Frame, Until};
use crate::load::histogram::Histogram;
use crate::scene::random::SplitMix64;

/// How a client asks for frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Habit {
    /// A viewer that looks at each frame for this time on average, exponentially distributed.
    Viewer { pause_ns: u64 },
    /// A moving camera: two frames under way, a pose at this interval.
    Stream { interval_ns: u64 },
    /// A load test: many frames at once, then a pause.
    Burst { frames: usize, pause_ns: u64 },
    /// So many connections, each of which asks for the next frame this long after it has one.
    Loop { connections: usize, pause_ns: u64 },
}

/// A client with its scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asker {
    pub habit: Habit,
    pub scene: usize,
}

/// What a frame of a scene costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    pub cost_ns: u64,
    pub pixels: u64,
}

/// Daemons, clients, and how clients find daemons.
#[derive(Clone, Debug)]
pub struct Plan {
    pub daemons: usize,
    pub scenes: Vec<Scene>,
    pub clients: Vec<Asker>,
    pub shares: Shares,
    pub most_frames: usize,
    /// Device time of a submission beside its frames.
    pub submit_ns: u64,
    pub encoders: usize,
    pub encode_ns: u64,
    /// From a daemon to its client and back.
    pub trip_ns: u64,
    /// Device time of a scene's first frame on a daemon beside the frame: the scene is uploaded.
    pub upload_ns: u64,
    /// Points of each daemon on the ring.
    pub points: usize,
    /// Largest number of requests of a daemon over the mean; `None`: no limit.
    pub bound: Option<f64>,
    /// A daemon that is killed, and when.
    pub lost: Option<(u64, usize)>,
    pub measure_from_ns: u64,
    pub until_ns: u64,
    pub seed: u64,
}

/// What clients of a group waited for their frames in the measured time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Waits {
    pub all: Histogram,
    /// Waits of frames that came within ten seconds of the loss of a daemon: of clients that had to move, and of others.
    pub moved: Histogram,
    pub stayed: Histogram,
}

/// Result of a simulation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    pub measured_s: f64,
    pub frames: u64,
    pub frames_per_s: f64,
    pub waits: Waits,
    /// Requests, refused ones and repeated ones included, and refusals.
    pub asked: u64,
    pub refused: u64,
    /// Device time of each daemon over the measured time.
    pub loads: Vec<f64>,
    /// Device time of each client.
    pub device_ns: Vec<u64>,
    /// Clients whose daemon was killed.
    pub moved: usize,
    /// Pairs of scene and daemon that were uploaded.
    pub uploads: usize,
    /// Mean number of frames that were asked for and not answered.
    pub mean_unanswered: f64,
    /// Mean time from a request to its frame of all that were answered, in nanoseconds.
    pub mean_wait_ns: f64,
    /// Requests at the end without an answer, and all requests for new frames and all answers from the beginning.
    pub unanswered: u64,
    pub wanted: u64,
    pub answered: u64,
}

#[derive(Clone, Copy, Debug)]
enum Event {
    /// A client asks for a frame that it first asked for at `since_ns`.
    Ask {
        client: usize,
        since_ns: u64,
    },
    /// A client that draws a burst begins the next.
    Burst {
        client: usize,
    },
    Wake {
        daemon: usize,
        number: u64,
    },
    Lands {
        daemon: usize,
    },
    Encoded {
        daemon: usize,
        frame: Frame,
    },
    Lost {
        daemon: usize,
    },
    Measure,
}

struct Daemon {
    device: Device,
    encoders: Station,
    is_alive: bool,
    /// Whether the render thread waits for a batch to land.
    is_busy: bool,
    /// Number of the latest wake-up; earlier ones are void.
    wake: u64,
    /// Requests that are not answered.
    load: usize,
    scenes: BTreeSet<usize>,
    before_ns: u64,
}

struct Simulation<'a> {
    plan: &'a Plan,
    ring: Ring,
    events: Events<Event>,
    daemons: Vec<Daemon>,
    random: SplitMix64,
    /// Where each client's requests of now are, and the daemon of its stream.
    at: Vec<Option<usize>>,
    /// Frames of a burst that are not answered.
    left: Vec<usize>,
    load: usize,
    moved: Vec<bool>,
    outcome: Outcome,
    /// Sum of unanswered frames over time, and when it was added to last.
    area: f64,
    area_at_ns: u64,
    wait_sum_ns: f64,
}

/// Simulates a plan.
pub fn simulate(plan: &Plan) -> Outcome {
    let start = Instant::now();
    let daemon = |_| Daemon {
        device: Device::new(plan.shares, plan.most_frames, plan.submit_ns, start),
        encoders: Station::new(plan.encoders),
        is_alive: true,
        is_busy: false,
        wake: 0,
        load: 0,
        scenes: BTreeSet::new(),
        before_ns: 0,
    };
    let count = plan.clients.len();
    let mut simulation = Simulation {
        plan,
        ring: Ring::new(plan.daemons, plan.points),
        events: Events::default(),
        daemons: (0..plan.daemons).map(daemon).collect(),
        random: SplitMix64::new(plan.seed),
        at: vec![None; count],
        left: vec![0; count],
        load: 0,
        moved: vec![false; count],
        outcome: Outcome { device_ns: vec![0; count], ..Outcome::default() },
        area: 0.0,
        area_at_ns: 0,
        wait_sum_ns: 0.0,
    };
    simulation.begin();
    while let Some(at_ns) = simulation.events.next_ns() {
        if at_ns > plan.until_ns {
            break;
        }
        let Some(event) = simulation.events.pop() else { break };
        simulation.happens(event);
    }
    simulation.finish()
}

impl Simulation<'_> {
    fn begin(&mut self) {
        let plan = self.plan;
        self.events.add(plan.measure_from_ns, Event::Measure);
        if let Some((at_ns, daemon)) = plan.lost {
            self.events.add(at_ns, Event::Lost { daemon });
        }
        for (client, asker) in plan.clients.iter().enumerate() {
            // Nobody begins at the same time.
            let spread = |of_ns: u64, unit: f64| (of_ns as f64 * unit) as u64;
            let at_ns = spread(pause_of(asker.habit), self.random.unit());
            match asker.habit {
                Habit::Burst { .. } => self.events.add(at_ns, Event::Burst { client }),
                Habit::Viewer { .. } => {
                    self.events.add(at_ns, Event::Ask { client, since_ns: at_ns })
                }
                Habit::Stream { interval_ns } => {
                    for at_ns in [at_ns, at_ns + interval_ns] {
                        self.events.add(at_ns, Event::Ask { client, since_ns: at_ns });
                    }
                }
                Habit::Loop { connections, .. } => {
                    for _ in 0..connections {
                        self.events.add(at_ns, Event::Ask { client, since_ns: at_ns });
                    }
                }
            }
        }
    }

    fn happens(&mut self, event: Event) {
        match event {
            Event::Ask { client, since_ns } => self.ask(client, since_ns),
            Event::Burst { client } => {
                if let Habit::Burst { frames, .. } = self.plan.clients[client].habit {
                    self.left[client] = frames;
                    for _ in 0..frames {
                        self.ask(client, self.events.now_ns());
                    }
                }
            }
            Event::Wake { daemon, number } => {
                if self.daemons[daemon].wake == number {
                    self.work(daemon);
                }
            }
            Event::Lands { daemon } => {
                if self.daemons[daemon].is_alive {
                    self.land(daemon);
                }
            }
            Event::Encoded { daemon, frame } => self.answer(daemon, frame),
            Event::Lost { daemon } => self.lose(daemon),
            Event::Measure => {
                for daemon in &mut self.daemons {
                    daemon.before_ns = daemon.device.busy_ns();
                }
                self.outcome.device_ns.fill(0);
            }
        }
    }

    /// Counts the change of the number of unanswered frames.
    fn count(&mut self, change: i64) {
        let now_ns = self.events.now_ns();
        self.area += self.load as f64 * (now_ns - self.area_at_ns) as f64;
        self.area_at_ns = now_ns;
        self.load = self.load.saturating_add_signed(change as isize);
    }

    /// Returns the daemon of a client's next request.
    fn daemon_of(&mut self, client: usize) -> Option<usize> {
        let Asker { habit, scene } = self.plan.clients[client];
        let is_stream = matches!(habit, Habit::Stream { .. });
        if let Some(daemon) = self.at[client].filter(|at| is_stream && self.daemons[*at].is_alive) {
            return Some(daemon);
        }
        let daemons = &self.daemons;
        let alive = daemons.iter().filter(|daemon| daemon.is_alive).count();
        let total = self.load;
        let bound = self.plan.bound;
        let may = |daemon: usize| {
            let it = &daemons[daemon];
            it.is_alive && bound.is_none_or(|bound| is_within(bound, it.load, total, alive))
        };
        let daemon = self.ring.daemon(scene, may);
        self.at[client] = daemon;
        daemon
    }

    fn ask(&mut self, client: usize, since_ns: u64) {
        let now_ns = self.events.now_ns();
        if since_ns == now_ns {
            self.outcome.wanted += 1;
            self.count(1);
        }
        let Asker { habit, scene } = self.plan.clients[client];
        let Scene { mut cost_ns, pixels } = self.plan.scenes[scene];
        let Some(number) = self.daemon_of(client) else { return };
        let daemon = &mut self.daemons[number];
        if !daemon.scenes.contains(&scene) {
            cost_ns += self.plan.upload_ns;
        }
        let id = client as u64;
        let name = match habit {
            Habit::Stream { .. } => Client::Stream { of: id, number: id },
            _ => Client::Caller(id),
        };
        let frame = Frame { client, asked_ns: since_ns, pixels, kind: scene as u64, cost_ns };
        let is_measured = now_ns >= self.plan.measure_from_ns;
        self.outcome.asked += u64::from(is_measured);
        match daemon.device.admit(name, frame, now_ns) {
            Ok(()) => {
                if daemon.scenes.insert(scene) {
                    self.outcome.uploads += 1;
                }
                daemon.load += 1;
                if !daemon.is_busy {
                    self.work(number);
                }
            }
            Err(backlog_ns) => {
                self.outcome.refused += u64::from(is_measured);
                // As clients do: not all of them come back at the same time.
                let wait_ns = backlog_ns.max(50_000_000) as f64 * (1.0 + self.random.unit());
                self.events.add(now_ns + wait_ns as u64, Event::Ask { client, since_ns });
            }
        }
    }

    fn work(&mut self, number: usize) {
        let now_ns = self.events.now_ns();
        let daemon = &mut self.daemons[number];
        daemon.wake += 1;
        match daemon.device.work(now_ns) {
            Until::Landing(at_ns) => {
                daemon.is_busy = true;
                self.events.add(at_ns, Event::Lands { daemon: number });
            }
            Until::Request(held_ns) => {
                daemon.is_busy = false;
                if let Some(at_ns) = held_ns {
                    self.events.add(at_ns, Event::Wake { daemon: number, number: daemon.wake });
                }
            }
        }
    }

    fn land(&mut self, number: usize) {
        let now_ns = self.events.now_ns();
        let daemon = &mut self.daemons[number];
        for frame in daemon.device.land(now_ns) {
            self.outcome.device_ns[frame.client] += frame.cost_ns;
            let at_ns = daemon.encoders.serve(now_ns, self.plan.encode_ns) + self.plan.trip_ns;
            self.events.add(at_ns, Event::Encoded { daemon: number, frame });
        }
        self.work(number);
    }

    fn answer(&mut self, number: usize, frame: Frame) {
        let now_ns = self.events.now_ns();
        if !self.daemons[number].is_alive {
            // It was encoded when its daemon was killed.
            let since_ns = frame.asked_ns;
            self.events.add(now_ns, Event::Ask { client: frame.client, since_ns });
            return;
        }
        self.daemons[number].load -= 1;
        self.count(-1);
        self.outcome.answered += 1;
        let wait_ns = now_ns - frame.asked_ns;
        self.wait_sum_ns += wait_ns as f64;
        if now_ns >= self.plan.measure_from_ns {
            self.outcome.frames += 1;
            self.outcome.waits.all.record(wait_ns);
        }
        if let Some((at_ns, _)) = self.plan.lost
            && (at_ns..at_ns + 10_000_000_000).contains(&now_ns)
        {
            match self.moved[frame.client] {
                true => self.outcome.waits.moved.record(wait_ns),
                false => self.outcome.waits.stayed.record(wait_ns),
            }
        }
        self.next(frame, now_ns);
    }

    /// Lets a client that has a frame ask for another.
    fn next(&mut self, frame: Frame, now_ns: u64) {
        let client = frame.client;
        let exponential = |mean_ns: u64, unit: f64| (-(1.0 - unit).ln() * mean_ns as f64) as u64;
        let at_ns = match self.plan.clients[client].habit {
            Habit::Viewer { pause_ns } => now_ns + exponential(pause_ns, self.random.unit()),
            Habit::Stream { interval_ns } => now_ns.max(frame.asked_ns + 2 * interval_ns),
            Habit::Loop { pause_ns, .. } => now_ns + pause_ns,
            Habit::Burst { pause_ns, .. } => {
                self.left[client] -= 1;
                if self.left[client] == 0 {
                    let at_ns = now_ns + exponential(pause_ns, self.random.unit());
                    self.events.add(at_ns, Event::Burst { client });
                }
                return;
            }
        };
        self.events.add(at_ns, Event::Ask { client, since_ns: at_ns });
    }

    fn lose(&mut self, number: usize) {
        let alive = |daemon: &&Daemon| daemon.is_alive;
        if self.daemons.iter().filter(alive).count() < 2 {
            return;
        }
        let ring = &self.ring;
        for (client, asker) in self.plan.clients.iter().enumerate() {
            let daemons = &self.daemons;
            let home = ring.daemon(asker.scene, |daemon| daemons[daemon].is_alive);
            self.moved[client] = home == Some(number);
        }
        self.outcome.moved = self.moved.iter().filter(|moved| **moved).count();
        let now_ns = self.events.now_ns();
        let daemon = &mut self.daemons[number];
        daemon.is_alive = false;
        let lost = daemon.device.kill();
        // Their connections end at once, and the balancer finds another daemon.
        let at_ns = now_ns + self.plan.trip_ns;
        for Frame { client, asked_ns, .. } in lost {
            self.events.add(at_ns, Event::Ask { client, since_ns: asked_ns });
        }
    }

    fn finish(mut self) -> Outcome {
        let end_ns = self.plan.until_ns;
        self.area += self.load as f64 * end_ns.saturating_sub(self.area_at_ns) as f64;
        let measured_ns = end_ns.saturating_sub(self.plan.measure_from_ns).max(1) as f64;
        let mut outcome = self.outcome;
        outcome.measured_s = measured_ns / 1e9;
        outcome.frames_per_s = outcome.frames as f64 / outcome.measured_s;
        let busy = |daemon: &Daemon| (daemon.device.busy_ns() - daemon.before_ns) as f64;
        outcome.loads = self.daemons.iter().map(|daemon| busy(daemon) / measured_ns).collect();
        outcome.mean_unanswered = self.area / end_ns.max(1) as f64;
        outcome.mean_wait_ns = self.wait_sum_ns / outcome.answered.max(1) as f64;
        outcome.unanswered = self.load as u64;
        outcome
    }
}

fn pause_of(habit: Habit) -> u64 {
    match habit {
        Habit::Viewer { pause_ns } | Habit::Burst { pause_ns, .. } => pause_ns,
        Habit::Stream { interval_ns } => interval_ns,
        Habit::Loop { .. } => 0,
    }
}

/// Returns scenes of clients by Zipf's law: the scene of rank r is chosen with a probability in proportion to 1/r.
pub fn zipf(clients: usize, scenes: usize, random: &mut SplitMix64) -> Vec<usize> {
    let mut sums = Vec::with_capacity(scenes);
    let mut sum = 0.0;
    for rank in 1..=scenes {
        sum += 1.0 / rank as f64;
        sums.push(sum);
    }
    let last = scenes.saturating_sub(1);
    let mut chosen = || {
        let at = random.unit() * sum;
        sums.partition_point(|sum| *sum <= at).min(last)
    };
    (0..clients).map(|_| chosen()).collect()
}

#[cfg(test)]
mod tests;
