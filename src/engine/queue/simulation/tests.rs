//! The queue with clients and a device, on a clock of its own: what each client gets of the device's time, and how long it waits.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::HashMap;

use super::*;
use crate::engine::queue::{BATCH_NS, JOB_BATCH_NS};

/// How a client asks.
#[derive(Clone, Copy, Debug)]
struct Habit {
    client: Client,
    /// Device time of a frame.
    cost_ns: u64,
    /// Frames that it has asked for and not got, always.
    window: usize,
    /// From one frame to its asking for another.
    pause_ns: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Got {
    frames: u64,
    device_ns: u64,
    longest_wait_ns: u64,
}

struct Simulation {
    habits: Vec<Habit>,
    device: Device,
    now_ns: u64,
    /// Clients by when they ask again.
    asking: Vec<(u64, usize)>,
    got: Vec<Got>,
    busy_ns: u64,
}

impl Simulation {
    fn new(habits: &[Habit], share: f64) -> Self {
        let shares =
            Shares { capacity: 4096, capacity_ns: u64::MAX, jobs: share, batch_ns: BATCH_NS };
        let ask = |(number, habit): (usize, &Habit)| vec![(0, number); habit.window];
        Self {
            device: Device::new(shares, 16, 0, Instant::now()),
            now_ns: 0,
            asking: habits.iter().enumerate().flat_map(ask).collect(),
            got: vec![Got::default(); habits.len()],
            habits: habits.to_vec(),
            busy_ns: 0,
        }
    }

    /// Those ask whose time has come.
    fn ask(&mut self) {
        let due: Vec<(u64, usize)> =
            self.asking.extract_if(.., |(at, _)| *at <= self.now_ns).collect();
        for (asked_ns, client) in due {
            let Habit { client: name, cost_ns, .. } = self.habits[client];
            let frame = Frame { client, asked_ns, pixels: 1, kind: client as u64, cost_ns };
            if self.device.admit(name, frame, asked_ns).is_err() {
                self.asking.push((self.now_ns + MS, client));
            }
        }
    }

    /// The first flight lands; meanwhile others ask.
    fn land(&mut self) {
        for frame in self.device.land(self.now_ns) {
            let habit = self.habits[frame.client];
            self.busy_ns += frame.cost_ns;
            let got = &mut self.got[frame.client];
            got.frames += 1;
            got.device_ns += frame.cost_ns;
            got.longest_wait_ns = got.longest_wait_ns.max(self.now_ns - frame.asked_ns);
            self.asking.push((self.now_ns + habit.pause_ns, frame.client));
        }
    }

    fn run(&mut self, for_ns: u64) {
        let until_ns = self.now_ns + for_ns;
        while self.now_ns < until_ns {
            self.ask();
            match self.device.work(self.now_ns) {
                Until::Landing(at) => {
                    self.now_ns = at;
                    self.land();
                }
                Until::Request(held_ns) => {
                    let next = self.asking.iter().map(|(at, _)| *at).chain(held_ns).min();
                    self.now_ns = self.now_ns.max(next.unwrap());
                }
            }
        }
    }

    /// After the queue has learnt what frames cost.
    fn measure(habits: &[Habit], share: f64, for_ns: u64) -> Simulation {
        let mut simulation = Simulation::new(habits, share);
        simulation.run(for_ns / 4);
        simulation.got.fill(Got::default());
        simulation.busy_ns = 0;
        simulation.run(for_ns);
        simulation
    }

    fn share_of_jobs(&self) -> f64 {
        let is_job = |number: &usize| self.habits[*number].client.class() == Class::Job;
        (0..self.habits.len()).filter(is_job).map(|number| self.share(number)).sum()
    }

    fn share(&self, client: usize) -> f64 {
        self.got[client].device_ns as f64 / self.busy_ns as f64
    }
}

const MS: u64 = 1_000_000;
const SECOND: u64 = 1_000 * MS;

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, rng_seed: RngSeed::Fixed(0x51ea_0003), ..ProptestConfig::default() }
}

fn stream(number: u64, cost_ns: u64) -> Habit {
    Habit { client: Client::Stream { of: number, number }, cost_ns, window: 2, pause_ns: 0 }
}

fn caller(number: u64, cost_ns: u64, window: usize) -> Habit {
    Habit { client: Client::Caller(number), cost_ns, window, pause_ns: 0 }
}

fn film(number: u64, cost_ns: u64) -> Habit {
    Habit { client: Client::Job(number), cost_ns, window: 32, pause_ns: 0 }
}

proptest! {
    #![proptest_config(config(48))]
    /// Clients that always have frames waiting, from thumbnails to frames of a hundred times their cost, get the same of the
    /// device's time, to a frame's worth.
    #[test]
    fn who_has_frames_waiting_has_an_equal_share(
        costs in prop::collection::vec(500_000u64..30 * MS, 2..9),
        windows in prop::collection::vec(2usize..24, 9),
        are_streams in prop::collection::vec(any::<bool>(), 9),
    ) {
        let habits: Vec<Habit> = costs.iter().enumerate().map(|(number, &cost_ns)| {
            let (name, window) = (number as u64, windows[number].max((40 * MS / cost_ns) as usize));
            match are_streams[number] {
                true => Habit { window, ..stream(name, cost_ns) },
                false => caller(name, cost_ns, window),
            }
        }).collect();
        let simulation = Simulation::measure(&habits, 0.1, 20 * SECOND);
        let fair = 1.0 / habits.len() as f64;
        for client in 0..habits.len() {
            let share = simulation.share(client);
            let frame = 2.0 * habits[client].cost_ns as f64 / simulation.busy_ns as f64;
            prop_assert!(share > 0.75 * fair - frame && share < 1.35 * fair + frame,
                "{client}: {share} of {fair}: {habits:?}");
        }
    }

    /// Streams, which have two frames asked for, against callers that have many: none gets under half its share.
    #[test]
    fn no_stream_gets_under_half_its_share(
        streams in 1u64..8,
        callers in 1u64..4,
        cost_ms in 1u64..40,
        window in 4usize..40,
    ) {
        let habits: Vec<Habit> = (0..streams).map(|number| stream(100 + number, cost_ms * MS))
            .chain((0..callers).map(|number| caller(number, cost_ms * MS, window))).collect();
        let simulation = Simulation::measure(&habits, 0.1, 30 * SECOND);
        let fair = 1.0 / habits.len() as f64;
        for client in 0..habits.len() {
            prop_assert!(simulation.share(client) > 0.5 * fair, "{client}: {}", simulation.share(client));
        }
    }

    /// Jobs get their share under a load that never ends, and little more; alone they get all.
    #[test]
    fn jobs_get_their_share_and_what_is_left(
        share in 0.05f64..0.4,
        cost_ms in 1u64..30,
        job_ms in 1u64..60,
        callers in 1u64..4,
        pause_ms in 0u64..80,
    ) {
        let busy: Vec<Habit> = (0..callers).map(|number| caller(number, cost_ms * MS, 60))
            .chain([film(0, job_ms * MS), film(1, job_ms * MS / 2)]).collect();
        let loaded = Simulation::measure(&busy, share, 60 * SECOND);
        let jobs = [callers as usize, callers as usize + 1].map(|client| loaded.share(client));
        let sum: f64 = jobs.iter().sum();
        prop_assert!((sum - share).abs() < 0.15 * share + 0.02, "{sum} of {share}");
        prop_assert!(jobs.iter().all(|of| *of > 0.35 * sum), "{jobs:?}");
        // Beside a stream it is the same, up to what a short batch of theirs is beside one of others.
        let watched: Vec<Habit> = busy.iter().copied().chain([stream(100, cost_ms * MS)]).collect();
        let watched = Simulation::measure(&watched, share.min(0.2), 60 * SECOND);
        let of_jobs: f64 = watched.share_of_jobs();
        prop_assert!((of_jobs - share.min(0.2)).abs() < 0.15 * share + 0.02, "{of_jobs} of {share}");
        // One that asks for a frame now and then leaves the rest.
        let now_and_then = Habit { pause_ns: pause_ms * MS, ..caller(0, cost_ms * MS, 1) };
        let left = Simulation::measure(&[now_and_then, film(0, job_ms * MS)], share, 20 * SECOND);
        // As many frames of the job as end before the next is asked for.
        let fits_ms = pause_ms.saturating_sub(1) / job_ms * job_ms;
        let least = 0.8 * fits_ms as f64 / (fits_ms + cost_ms) as f64;
        let found = left.share(1);
        prop_assert!(found > least.max(0.85 * share), "{found} of {least} and {share}");
    }

    /// Under flooding jobs a stream's frame waits for one batch of theirs at most, and for what it shares with others.
    #[test]
    fn a_streams_frame_waits_for_one_batch_of_jobs(
        cost_ms in 1u64..20,
        job_ms in 1u64..120,
        pause_ms in 0u64..100,
        window in 1usize..3,
    ) {
        let cost_ns = cost_ms * MS;
        let moving = Habit { window, pause_ns: pause_ms * MS, ..stream(0, cost_ns) };
        let habits = [moving, film(0, job_ms * MS), film(1, job_ms * MS / 2)];
        let simulation = Simulation::measure(&habits, 0.1, 20 * SECOND);
        let batch_of_jobs = JOB_BATCH_NS.max(job_ms * MS);
        // Its own frames, twice because they are asked for one behind the other, and one batch of jobs.
        let most = 2 * window as u64 * cost_ns + batch_of_jobs + MS;
        let found = simulation.got[0].longest_wait_ns;
        prop_assert!(found <= most, "{} ms of {}", found / MS, most / MS);
        prop_assert!(simulation.got[1].frames > 0 && simulation.got[2].frames > 0);
    }

    /// Every waiting client is served, also against clients that come once each and without end.
    #[test]
    fn newcomers_without_end_starve_nobody(cost_ms in 1u64..30, dear_ms in 1u64..200, a_time in 1usize..6) {
        let mut queue: Queue<Frame> = Queue::new(Shares { capacity: 64, capacity_ns: u64::MAX, jobs: 0.1, batch_ns: BATCH_NS });
        let (now, dear) = (Instant::now(), Client::Caller(0));
        let moment = Moment { now, flying_ns: 1, are_jobs_flying: false, are_streams_open: false, are_jobs_held: false };
        let (mut comers, mut served, mut most) = (1u64, 0, 0);
        let frame = |client| Frame { client, asked_ns: 0, pixels: 1, kind: 0, cost_ns: 0 };
        for round in 0..4000 {
            if !queue.first.has_lane(dear) {
                prop_assert!(queue.admit(dear, frame(0), dear_ms * MS, now).0.is_ok());
                (served, most) = (round, most.max(round - served));
            }
            while queue.len() < a_time + 1 {
                comers += 1;
                let comer = Client::Caller(comers);
                prop_assert!(queue.admit(comer, frame(1), cost_ms * MS, now).0.is_ok());
            }
            prop_assert_eq!(queue.take(1, moment).batch.len(), 1);
            prop_assert!(queue.first.accounts() < 2000);
        }
        most = most.max(4000 - served);
        // Its debt, paid at a quarter of an equal share at the slowest.
        let bound = (4 * (a_time + 2) as u64 * dear_ms / cost_ms + 4 * (a_time + 2) as u64) as usize;
        prop_assert!(most <= bound, "{most} rounds of {bound}");
    }
}

/// A client that opens many streams has no more of the device than who opens one, or asks for frames.
#[test]
fn streams_of_one_caller_share_what_is_his() {
    let of = |of, number| Habit { client: Client::Stream { of, number }, ..stream(0, 3 * MS) };
    let many = (0..15).map(|number| of(1, number));
    let habits: Vec<Habit> = many.chain([of(2, 15), caller(3, 3 * MS, 6)]).collect();
    let simulation = Simulation::measure(&habits, 0.1, 60 * SECOND);
    let his: f64 = (0..15).map(|client| simulation.share(client)).sum();
    let shares = [his, simulation.share(15), simulation.share(16)];
    assert!(shares.iter().all(|share| (0.2..0.45).contains(share)), "{shares:?}");
    assert!((0..15).all(|client| simulation.share(client) > 0.5 * his / 15.0));
    // Alone he has all of it.
    let alone = Simulation::measure(&habits[..15], 0.1, 10 * SECOND);
    assert!((0..15).all(|client| alone.share(client) > 0.9 / 15.0));
}

/// A stream whose next pose comes while a frame is drawn keeps most of its rate beside a job, which takes what is left where there is.
#[test]
fn a_stream_beside_a_job_keeps_its_rate() {
    for (cost_ms, pause_ms, least) in [(17, 8, 0.8), (17, 0, 0.85), (4, 2, 0.8)] {
        let moving = Habit { pause_ns: pause_ms * MS, ..stream(0, cost_ms * MS) };
        let alone = Simulation::measure(&[moving], 0.1, 20 * SECOND);
        let beside = Simulation::measure(&[moving, film(0, 10 * MS)], 0.1, 20 * SECOND);
        let kept = beside.got[0].frames as f64 / alone.got[0].frames as f64;
        assert!(kept > least, "{cost_ms} {pause_ms}: {kept}");
        assert!(beside.share(1) > 0.08, "{}", beside.share(1));
    }
    // One that draws a frame of 5 ms every 30 leaves most of the device.
    let seldom = Habit { pause_ns: 25 * MS, window: 1, ..stream(0, 5 * MS) };
    let beside = Simulation::measure(&[seldom, film(0, 4 * MS)], 0.1, 20 * SECOND);
    assert!(beside.share(1) > 0.6, "{}", beside.share(1));
}

/// A client that asks for one frame after the other keeps most of that rate beside a job whose frames are as dear, or dearer: they get their share, and
/// do not begin in the pause after each frame.
#[test]
fn one_frame_after_the_other_keeps_its_rate_beside_a_job() {
    for client in [Client::Stream { of: 0, number: 0 }, Client::Caller(0)] {
        for (cost_ms, pause_ms, job_ms) in [(40, 2, 40), (40, 2, 120), (5, 28, 100), (8, 10, 300)] {
            let (cost_ns, pause_ns) = (cost_ms * MS, pause_ms * MS);
            let habit = Habit { client, cost_ns, window: 1, pause_ns };
            let alone = Simulation::measure(&[habit], 0.1, 60 * SECOND);
            let beside = Simulation::measure(&[habit, film(0, job_ms * MS)], 0.1, 60 * SECOND);
            let kept = beside.got[0].frames as f64 / alone.got[0].frames as f64;
            let of_job = beside.got[1].device_ns as f64 / (60 * SECOND) as f64;
            let what = format!("{client:?} {cost_ms} {pause_ms} {job_ms}: {kept} {of_job}");
            assert!(kept > 0.85 && of_job > 0.08, "{what}");
        }
    }
}

/// The measured way of it: eight streams of unlike frames and a flooding job.
#[test]
fn eight_streams_and_a_job() {
    let habits: Vec<Habit> =
        (0..8).map(|number| stream(number, (4 + number) * MS)).chain([film(0, 25 * MS)]).collect();
    let simulation = Simulation::measure(&habits, 0.1, 60 * SECOND);
    let shares: HashMap<usize, f64> =
        (0..9).map(|client| (client, simulation.share(client))).collect();
    assert!((0..8).all(|client| (0.9 / 8.0 - shares[&client]).abs() < 0.02), "{shares:?}");
    assert!((shares[&8] - 0.1).abs() < 0.02, "{shares:?}");
}
