//! Films: throughput, loads and fairness by number of workers, lost workers, and measured points.

use pointillist::capacity::costs::StoreCosts;
use pointillist::capacity::films::{Film, Outcome, Plan, simulate};
use pointillist::capacity::jain;

use crate::common::median;
use crate::common::report::number;
use crate::measured::{CPU_FRAME_MS, FilmPoint, GPU_FRAME_MS, Measured, bucket};
use crate::{SECOND, Section, difference, ns, percent};

/// Films at a time, of as many owners.
const FILMS: usize = 16;
const WORKERS: [usize; 7] = [1, 3, 10, 30, 100, 300, 1000];
/// Cores of the daemon's machine.
const DAEMON_CORES: usize = 16;

fn plan(measured: &Measured, workers: usize, store: StoreCosts, films: Vec<Film>) -> Plan {
    Plan {
        workers,
        films,
        runners: 64,
        broker: measured.broker_costs(),
        store,
        daemon: measured.daemon_costs(DAEMON_CORES),
        // Scenes are loaded already.
        scene_bytes: 0,
        scene_ns: 0,
        shared_cores: None,
        lost: Vec::new(),
        broker_restart: None,
        until_ns: 3600 * SECOND,
        measure_from_ns: 0,
    }
}

fn film(measured: &Measured, frames: u64, frame_ms: f64) -> Film {
    let image_bytes = measured.image_bytes();
    Film { starts_ns: 2 * SECOND, frames, frame_ns: ns(frame_ms), image_bytes, scene: 0 }
}

/// Films without end, measured when all workers draw.
fn steady(measured: &Measured, workers: usize, frame_ms: f64, store: StoreCosts) -> Outcome {
    let until_s = 40;
    // More than can be drawn.
    let frames = (until_s as f64 * 1e3 / frame_ms * workers as f64) as u64 + 1000;
    let most = (workers as f64 * 1e3 / frame_ms).min(12_000.0) as u64;
    let frames = frames.min(most * until_s) / FILMS as u64 + 1000;
    let films = vec![film(measured, frames, frame_ms); FILMS];
    let mut plan = plan(measured, workers, store, films);
    plan.until_ns = until_s * SECOND;
    plan.measure_from_ns = 20 * SECOND;
    simulate(&plan)
}

pub fn sections(measured: &Measured) -> Vec<Section> {
    let mut sections = Vec::new();
    let mut limits = Vec::new();
    for (what, frame_ms) in [("a GPU", GPU_FRAME_MS), ("two CPU cores", CPU_FRAME_MS)] {
        for (store_name, store) in [("folder", measured.folder()), ("bucket", bucket())] {
            let mut rows = Vec::new();
            let (mut best, mut is_settled) = (0.0_f64, true);
            for workers in WORKERS {
                let outcome = steady(measured, workers, frame_ms, store);
                let most = workers as f64 * 1e3 / frame_ms;
                let rates: Vec<f64> =
                    outcome.films.iter().map(|film| film.measured as f64).collect();
                if workers == 10 {
                    limits.push(limit_row(what, store_name, &outcome, workers));
                }
                // Beyond what the store serves, twenty seconds are too few for a steady rate.
                is_settled &= outcome.frames_per_s > 1.05 * best;
                best = best.max(outcome.frames_per_s);
                let settled = |text: String| if is_settled { text } else { "–".to_owned() };
                rows.push(vec![
                    number(workers as f64),
                    settled(number(outcome.frames_per_s)),
                    settled(percent(outcome.frames_per_s / most)),
                    percent(outcome.broker_load),
                    percent(outcome.store_load.max(outcome.link_load)),
                    percent(outcome.daemon_load),
                    percent(outcome.film_load),
                    jain(&rates).map_or("—".to_owned(), |index| format!("{index:.3}")),
                ]);
            }
            let section = Section {
                title: format!(
                    "{FILMS} films at a time, each worker with {what} ({frame_ms} ms a frame), store: {store_name}. Load: the share of a second for which a part is busy"
                ),
                header: vec![
                    "workers",
                    "frames/s",
                    "share of workers ÷ frame time",
                    "broker",
                    "store",
                    "server",
                    "busiest film",
                    "Jain's index of films",
                ],
                rows,
            };
            sections.push(section.shown());
        }
    }
    let limits = Section {
        title: "Workers at which each part passes 70 % of its time, by its load with 10 workers"
            .to_owned(),
        header: vec![
            "workers with",
            "store",
            "broker",
            "store's operations",
            "store's link",
            "server",
        ],
        rows: limits,
    };
    sections.extend([limits.shown(), lost(measured).shown(), beside(measured).shown()]);
    sections
}

fn limit_row(what: &str, store: &str, outcome: &Outcome, workers: usize) -> Vec<String> {
    let limit = |load: f64| number((0.7 * workers as f64 / load).floor());
    vec![
        what.to_owned(),
        store.to_owned(),
        limit(outcome.broker_load),
        limit(outcome.store_load),
        limit(outcome.link_load),
        limit(outcome.daemon_load),
    ]
}

/// One film whose worker is killed, or whose broker restarts, halfway.
fn lost(measured: &Measured) -> Section {
    let mut rows = Vec::new();
    for (workers, frames) in [(10, 3600), (100, 3600), (1000, 3600), (100, 36_000)] {
        let calm = plan(measured, workers, bucket(), vec![film(measured, frames, CPU_FRAME_MS)]);
        let took = |plan: &Plan| {
            let outcome = simulate(plan);
            let end_ns = outcome.films[0].finished_ns.unwrap_or(plan.until_ns);
            ((end_ns - plan.films[0].starts_ns) as f64 / 1e9, outcome)
        };
        let (seconds, outcome) = took(&calm);
        let half_ns = 2 * SECOND + (seconds / 2.0 * 1e9) as u64;
        let (lost_s, lost) = took(&Plan { lost: vec![(half_ns, 0)], ..calm.clone() });
        let restart = Some((half_ns, half_ns + 5 * SECOND));
        let (restart_s, restarted) = took(&Plan { broker_restart: restart, ..calm.clone() });
        let ideal = frames as f64 * CPU_FRAME_MS / 1e3 / workers as f64;
        rows.push(vec![
            number(workers as f64),
            number(frames as f64),
            number(ideal),
            number(seconds),
            number(outcome.runs as f64),
            format!("{:+.1}", lost_s - seconds),
            number(lost.drawn_again as f64),
            format!("{:+.1}", restart_s - seconds),
            number(restarted.drawn_again as f64),
        ]);
    }
    Section {
        title: format!(
            "One film of {CPU_FRAME_MS} ms a frame, store: bucket; a worker is killed, or the broker is away for 5 s, halfway"
        ),
        header: vec![
            "workers",
            "frames",
            "drawing alone, s",
            "film, s",
            "runs",
            "worker lost, s",
            "drawn twice",
            "broker away, s",
            "drawn twice ",
        ],
        rows,
    }
}

/// What was measured with one to three workers on shared cores.
fn beside(measured: &Measured) -> Section {
    let daemon_ms = measured.daemon_ms();
    // With one worker, which the others are predicted from.
    let alone = measured.films.iter().filter(|point| point.workers == 1);
    let alone_ms = median(&alone.map(FilmPoint::cpu_ms).collect::<Vec<_>>());
    let mut counts: Vec<usize> = measured.films.iter().map(|point| point.workers).collect();
    counts.sort_unstable();
    counts.dedup();
    let mut rows = Vec::new();
    for workers in counts {
        let points = measured.films.iter().filter(|point| point.workers == workers);
        let rate = |simulated: bool| {
            let rates = points.clone().map(|point| {
                if !simulated {
                    return point.frames as f64 / point.seconds;
                }
                let film = film(measured, point.frames, alone_ms);
                let film = Film { image_bytes: measured.store.image_bytes, ..film };
                let mut plan = plan(measured, workers, measured.folder(), vec![film]);
                plan.shared_cores = Some(measured.cores as f64 - point.others_cores);
                plan.daemon.frame_ns = ns(daemon_ms);
                let outcome = simulate(&plan);
                let end_ns = outcome.films[0].finished_ns.unwrap_or(plan.until_ns);
                point.frames as f64 / ((end_ns - plan.films[0].starts_ns) as f64 / 1e9)
            });
            median(&rates.collect::<Vec<_>>())
        };
        let (simulated, found) = (rate(true), rate(false));
        let cpu_ms = median(&points.clone().map(FilmPoint::cpu_ms).collect::<Vec<_>>());
        let others = median(&points.clone().map(|point| point.others_cores).collect::<Vec<_>>());
        rows.push(vec![
            workers.to_string(),
            format!("{:.2}", measured.cores as f64 - others),
            number(cpu_ms),
            number(found),
            number(simulated),
            difference(simulated, found),
        ]);
    }
    Section {
        title: format!(
            "Comparison with a measurement: a film of {} on {}. Server, broker and workers share the cores that other programs left. The simulation has the CPU time of a frame with one worker",
            measured.film_size,
            measured.machine()
        ),
        header: vec![
            "workers",
            "cores left",
            "CPU ms a frame, measured",
            "frames/s, measured",
            "frames/s, simulated",
            "difference",
        ],
        rows,
    }
}
