//! Frames for clients: waits, fairness and refusals by number of daemons, the loss of a daemon, a hot scene, and measured points.

use pointillist::capacity::clients::{Asker, Habit, Outcome, Plan, Scene, simulate, zipf};
use pointillist::capacity::jain;
use pointillist::engine::queue::{BATCH_NS, Shares};
use pointillist::scene::random::SplitMix64;

use crate::common::median;
use crate::common::report::number;
use crate::measured::{ClientPoint, GPU_MS, JPEG_MS, Measured, OVERHEAD_MS, RECORD_MS};
use crate::{SECOND, Section, difference, ns, percent};

const CLIENTS: usize = 100_000;
const SCENES: usize = 1000;
const STREAMS: usize = 400;
const BURSTS: usize = 100;
const DAEMONS: [usize; 3] = [32, 64, 128];
/// Points of a daemon on HAProxy's ring with weight 1 and with weight 16.
const POINTS: [usize; 2] = [16, 256];

/// The queue's limits by default.
fn shares() -> Shares {
    Shares { capacity: 256, capacity_ns: 30 * SECOND, jobs: 0.1, batch_ns: BATCH_NS }
}

fn plan(daemons: usize, clients: Vec<Asker>) -> Plan {
    // The costs of recorded scenes, in turns.
    let scene = |rank: usize| Scene {
        cost_ns: ns(GPU_MS[rank % GPU_MS.len()] + RECORD_MS),
        pixels: 640 * 480,
    };
    Plan {
        daemons,
        scenes: (0..SCENES).map(scene).collect(),
        clients,
        shares: shares(),
        most_frames: 16,
        submit_ns: 0,
        encoders: 8,
        encode_ns: ns(JPEG_MS),
        trip_ns: ns(OVERHEAD_MS),
        upload_ns: ns(200.0),
        points: POINTS[1],
        bound: None,
        lost: None,
        measure_from_ns: 5 * SECOND,
        until_ns: 15 * SECOND,
        seed: 1,
    }
}

fn everybody() -> Vec<Asker> {
    let scenes = zipf(CLIENTS, SCENES, &mut SplitMix64::new(7));
    let habit = |client: usize| match client {
        client if client < STREAMS => Habit::Stream { interval_ns: SECOND / 30 },
        client if client < STREAMS + BURSTS => Habit::Burst { frames: 64, pause_ns: 20 * SECOND },
        _ => Habit::Viewer { pause_ns: 60 * SECOND },
    };
    let asker = |(client, scene): (usize, usize)| Asker { habit: habit(client), scene };
    scenes.into_iter().enumerate().map(asker).collect()
}

pub fn sections(measured: &Measured) -> Vec<Section> {
    let makers: [fn(&Measured) -> Section; 4] = [load, loss, hot, beside];
    makers.map(|make| make(measured).shown()).into()
}

fn row(daemons: usize, how: &str, plan: &Plan, measured: &Measured) -> Vec<String> {
    let outcome = simulate(plan);
    let wait = |share: f64| {
        outcome.waits.all.quantile(share).map_or("—".to_owned(), |ns| number(ns as f64 / 1e6))
    };
    let most = outcome.loads.iter().copied().fold(0.0, f64::max);
    let mean = outcome.loads.iter().sum::<f64>() / daemons as f64;
    vec![
        number(daemons as f64),
        how.to_owned(),
        number(outcome.frames_per_s),
        wait(0.5),
        wait(0.99),
        percent(mean),
        percent(most),
        streams_index(plan, &outcome),
        percent(outcome.refused as f64 / outcome.asked.max(1) as f64),
        number(measured.idle_connection_kib * CLIENTS as f64 / daemons as f64 / 1024.0),
    ]
}

/// Jain's index of the device time of streams of the same scene, a mean over scenes with several: they want the same.
fn streams_index(plan: &Plan, outcome: &Outcome) -> String {
    let mut of_scenes = vec![Vec::new(); SCENES];
    for (client, asker) in plan.clients.iter().enumerate().take(STREAMS) {
        of_scenes[asker.scene].push(outcome.device_ns[client] as f64);
    }
    let several = of_scenes.iter().filter(|times| times.len() > 1);
    let indices: Vec<f64> = several.filter_map(|times| jain(times)).collect();
    format!("{:.3}", indices.iter().sum::<f64>() / indices.len() as f64)
}

fn load(measured: &Measured) -> Section {
    let clients = everybody();
    let mut rows = Vec::new();
    for daemons in DAEMONS {
        let plain = Plan { points: POINTS[0], ..plan(daemons, clients.clone()) };
        rows.push(row(daemons, "hash, 16 points", &plain, measured));
        let even = Plan { points: POINTS[1], ..plain.clone() };
        rows.push(row(daemons, "hash, 256 points", &even, measured));
        let bounded = Plan { bound: Some(1.5), ..even };
        rows.push(row(daemons, "the same, at most 1.5 × the mean", &bounded, measured));
    }
    Section {
        title: format!(
            "{CLIENTS} clients: {STREAMS} streams of 30 poses/s, {BURSTS} load tests of 64 frames at once about every 20 s, all others look at each frame for a minute; {SCENES} scenes by Zipf's law, 640 × 480 on an H200"
        ),
        header: vec![
            "servers",
            "balancer",
            "frames/s",
            "wait p50, ms",
            "p99, ms",
            "mean load",
            "busiest",
            "Jain's index of streams of a scene",
            "refused",
            "idle connections, MiB a server",
        ],
        rows,
    }
}

fn loss(_: &Measured) -> Section {
    let clients = everybody();
    let mut rows = Vec::new();
    for daemons in [32, 128] {
        for bound in [None, Some(1.5)] {
            let plan =
                Plan { lost: Some((5 * SECOND, 0)), bound, ..plan(daemons, clients.clone()) };
            let outcome = simulate(&plan);
            let ms = |ns: Option<u64>| ns.map_or("—".to_owned(), |ns| number(ns as f64 / 1e6));
            rows.push(vec![
                number(daemons as f64),
                if bound.is_some() { "at most 1.5 × the mean" } else { "hash alone" }.to_owned(),
                percent(outcome.moved as f64 / CLIENTS as f64),
                ms(outcome.waits.moved.quantile(0.5)),
                ms(outcome.waits.moved.quantile(0.99)),
                ms(outcome.waits.stayed.quantile(0.5)),
                ms(outcome.waits.stayed.quantile(0.99)),
                percent(outcome.refused as f64 / outcome.asked.max(1) as f64),
            ]);
        }
    }
    Section {
        title: "One server is killed; waits of frames that come within 10 s after that".to_owned(),
        header: vec![
            "servers",
            "balancer",
            "clients moved",
            "moved: p50, ms",
            "p99, ms",
            "others: p50, ms",
            "p99, ms ",
            "refused",
        ],
        rows,
    }
}

/// How many clients of one scene a daemon serves.
fn hot(_: &Measured) -> Section {
    let mut rows = Vec::new();
    for (what, habit, most) in [
        ("streams of 30 poses/s", Habit::Stream { interval_ns: SECOND / 30 }, [5, 10, 20, 40]),
        (
            "viewers, a frame a minute",
            Habit::Viewer { pause_ns: 60 * SECOND },
            [3000, 10_000, 20_000, 40_000],
        ),
    ] {
        for clients in most {
            // The plaza.
            let plan = plan(1, vec![Asker { habit, scene: 4 }; clients]);
            let outcome = simulate(&plan);
            let ms =
                |share| outcome.waits.all.quantile(share).map_or(f64::NAN, |ns| ns as f64 / 1e6);
            rows.push(vec![
                what.to_owned(),
                number(clients as f64),
                number(outcome.frames_per_s),
                percent(outcome.loads[0]),
                number(ms(0.5)),
                number(ms(0.99)),
                percent(outcome.refused as f64 / outcome.asked.max(1) as f64),
            ]);
        }
    }
    Section {
        title: "Clients of one scene (the plaza, 2.65 ms a frame) on one server".to_owned(),
        header: vec!["clients", "number", "frames/s", "load", "wait p50, ms", "p99, ms", "refused"],
        rows,
    }
}

/// What was measured with 1, 8 and 64 connections. The point of one connection gives the costs.
fn beside(measured: &Measured) -> Section {
    let of = |clients: usize, value: fn(&ClientPoint) -> f64| {
        let points = measured.clients.iter().filter(|point| point.clients == clients);
        median(&points.map(value).collect::<Vec<_>>())
    };
    let (cost_ns, encode_ns) =
        (of(1, |point| point.receipts.gpu_p50_ns), of(1, |point| point.receipts.encode_p50_ns));
    let service_ns = of(1, |point| point.service.mean_ns);
    let mut rows = Vec::new();
    for connections in [1, 8, 64] {
        let found = of(connections, |point| point.throughput_per_s);
        let found_ms = of(connections, |point| point.service.mean_ns / 1e6);
        let habit = Habit::Loop { connections, pause_ns: 0 };
        let mut plan = plan(1, vec![Asker { habit, scene: 0 }]);
        plan.scenes = vec![Scene { cost_ns: cost_ns as u64, pixels: 320 * 240 }];
        plan.encoders = measured.cores;
        plan.encode_ns = encode_ns as u64;
        plan.trip_ns = (service_ns - cost_ns - encode_ns).max(0.0) as u64;
        let outcome = simulate(&plan);
        let wait_ms = outcome.waits.all.mean().unwrap_or(f64::NAN) / 1e6;
        rows.push(vec![
            connections.to_string(),
            number(found),
            number(outcome.frames_per_s),
            difference(outcome.frames_per_s, found),
            number(found_ms),
            number(wait_ms),
            difference(wait_ms, found_ms),
        ]);
    }
    Section {
        title: format!(
            "Comparison with a measurement: requests of {} by `pointillist load` on {}, each connection asking for the next frame as soon as it has one",
            measured.client_size,
            measured.machine()
        ),
        header: vec![
            "connections",
            "frames/s, measured",
            "simulated",
            "difference",
            "mean wait, ms, measured",
            "simulated ",
            "difference ",
        ],
        rows,
    }
}
