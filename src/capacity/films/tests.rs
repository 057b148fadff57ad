use super::*;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1000 * MS;

fn film(frames: u64, frame_ms: u64) -> Film {
    Film { starts_ns: 2 * SECOND, frames, frame_ns: frame_ms * MS, image_bytes: 100_000, scene: 0 }
}

fn plan(workers: usize, films: Vec<Film>) -> Plan {
    Plan {
        workers,
        films,
        runners: 64,
        broker: BrokerCosts {
            publish_ns: 10_000,
            pull_and_ack_ns: 20_000,
            kib_ns: 2_000,
            progress_ns: 2_000,
            note_ns: 2_000,
            trip_ns: 50_000,
        },
        store: StoreCosts {
            servers: 4,
            put_ns: 100_000,
            get_ns: 30_000,
            head_ns: 5_000,
            trip_ns: 100_000,
            bytes_per_s: 1e9,
        },
        daemon: DaemonCosts { cores: 4, frame_ns: 500_000, beat_ns: 5_000 },
        scene_bytes: 1_000_000,
        scene_ns: 10 * MS,
        shared_cores: None,
        lost: Vec::new(),
        broker_restart: None,
        until_ns: 600 * SECOND,
        measure_from_ns: 0,
    }
}

/// The time that drawing takes at least.
fn ideal_ns(plan: &Plan) -> u64 {
    plan.films.iter().map(|film| film.frames * film.frame_ns).sum::<u64>() / plan.workers as u64
}

#[test]
fn every_frame_arrives_once_whatever_is_lost() {
    let mut plan = plan(5, vec![film(300, 40), film(200, 25)]);
    let calm = simulate(&plan);
    assert_eq!((calm.drawn_again, calm.redelivered, calm.frames_drawn), (0, 0, 500));
    plan.lost = vec![(3 * SECOND, 0), (3_500 * MS, 3), (5 * SECOND, 1)];
    plan.broker_restart = Some((4 * SECOND, 6 * SECOND));
    let rough = simulate(&plan);
    for outcome in [&calm, &rough] {
        let arrived: Vec<u64> = outcome.films.iter().map(|film| film.arrived).collect();
        assert_eq!(arrived, [300, 200]);
        assert_eq!(outcome.frames_drawn, 500 + outcome.drawn_again);
    }
    assert!(rough.redelivered >= 2, "{rough:?}");
    assert!(rough.end_ns > calm.end_ns);
    // What is drawn twice is what the lost workers had not stored.
    assert!(rough.drawn_again <= 3 * 13, "{rough:?}");
    assert_eq!(simulate(&plan), rough);
}

#[test]
fn a_film_takes_the_time_of_its_frames_over_the_workers() {
    for workers in [1, 4, 16] {
        let plan = plan(workers, vec![film(2000, 50)]);
        let outcome = simulate(&plan);
        let took_ns = outcome.films[0].finished_ns.unwrap() - plan.films[0].starts_ns;
        let ideal_ns = ideal_ns(&plan);
        assert!(took_ns > ideal_ns, "{workers}");
        assert!(took_ns < ideal_ns + ideal_ns / 20 + SECOND, "{workers}: {took_ns} {ideal_ns}");
    }
}

#[test]
fn a_lost_worker_delays_its_run_until_the_broker_misses_it() {
    // The last run of the film: other workers have nothing else to do.
    let mut plan = plan(2, vec![film(2, 3000)]);
    let calm = simulate(&plan);
    plan.lost = vec![(4 * SECOND, 0)];
    let lost = simulate(&plan);
    let added_ns = lost.end_ns - calm.end_ns;
    let wait_ns = crate::farm::pacing::ACK_WAIT.as_nanos() as u64;
    assert!((wait_ns..wait_ns + 4 * SECOND).contains(&added_ns), "{added_ns}");
    assert_eq!((lost.redelivered, lost.frames_drawn), (1, 2));
}

#[test]
fn loads_are_the_work_of_messages_and_operations() {
    let mut plan = plan(8, vec![film(4000, 20), film(4000, 20)]);
    plan.store.bytes_per_s = 1e15;
    let outcome = simulate(&plan);
    // Each frame is stored and read; each run takes its order twice, and counts a try.
    let (frames, seconds) = (8000.0, outcome.measured_s);
    let of_frames = frames * (100e-6 + 30e-6);
    let of_runs = outcome.runs as f64 * (3.0 * 30e-6 + 100e-6);
    let found = outcome.store_load * seconds * 4.0;
    assert!((found - of_frames - of_runs).abs() < 0.01 * found, "{found} {of_frames} {of_runs}");
    let daemon = (frames * 500e-6 + 8.0 * seconds * 5e-6) / seconds / 4.0;
    assert!((outcome.daemon_load - daemon).abs() < 0.02 * daemon, "{}", outcome.daemon_load);
}

#[test]
fn films_that_want_equally_get_equally_and_a_new_film_begins_soon() {
    let mut plan = plan(40, vec![film(100_000, 20); 8]);
    plan.until_ns = 30 * SECOND;
    plan.measure_from_ns = 10 * SECOND;
    plan.daemon.frame_ns = 100_000;
    plan.films.push(Film { starts_ns: 15 * SECOND, ..film(100_000, 20) });
    let outcome = simulate(&plan);
    let rates: Vec<f64> = outcome.films[..8].iter().map(|film| film.measured as f64).collect();
    assert!(crate::capacity::jain(&rates).unwrap() > 0.98, "{rates:?}");
    // Its first run waits for the three runs of two seconds that each worker has before it, and a bit.
    let waited_ns = outcome.films[8].first_frame_ns.unwrap() - 15 * SECOND;
    assert!(waited_ns < 8 * SECOND, "{waited_ns}");
}

#[test]
fn shared_cores_limit_all_workers_together() {
    let rate = |workers, cores| {
        let mut plan = plan(workers, vec![film(100_000, 40)]);
        plan.shared_cores = Some(cores);
        plan.until_ns = 30 * SECOND;
        plan.measure_from_ns = 10 * SECOND;
        simulate(&plan).frames_per_s
    };
    // A frame takes 40.5 ms of CPU time, with the daemon's part.
    for (workers, cores) in [(1, 1.0), (3, 1.0), (3, 2.0)] {
        let (found, most) = (rate(workers, cores), cores / 0.0405);
        assert!(found > 0.9 * most && found < 1.01 * most, "{workers} {cores}: {found} of {most}");
    }
}
