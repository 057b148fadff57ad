use super::*;
use crate::capacity::jain;
use crate::engine::queue::BATCH_NS;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1000 * MS;

fn plan(daemons: usize, clients: Vec<Asker>) -> Plan {
    Plan {
        daemons,
        scenes: vec![Scene { cost_ns: 5 * MS, pixels: 300_000 }; 50],
        clients,
        shares: Shares { capacity: 256, capacity_ns: 30 * SECOND, jobs: 0.1, batch_ns: BATCH_NS },
        most_frames: 16,
        submit_ns: 0,
        encoders: 8,
        encode_ns: MS,
        trip_ns: MS,
        upload_ns: 50 * MS,
        points: 256,
        bound: None,
        lost: None,
        measure_from_ns: 5 * SECOND,
        until_ns: 25 * SECOND,
        seed: 1,
    }
}

fn many(count: usize, habit: Habit) -> Vec<Asker> {
    (0..count).map(|client| Asker { habit, scene: client % 50 }).collect()
}

#[test]
fn every_request_is_answered_once_and_waits_follow_littles_law() {
    let viewers = many(2000, Habit::Viewer { pause_ns: 4 * SECOND });
    let streams = many(20, Habit::Stream { interval_ns: 33 * MS });
    let mut plan = plan(8, [viewers, streams].concat());
    plan.measure_from_ns = 0;
    for lost in [None, Some((10 * SECOND, 2))] {
        plan.lost = lost;
        let outcome = simulate(&plan);
        assert_eq!(outcome.wanted, outcome.answered + outcome.unanswered);
        // All device time is some client's.
        let busy_ns: f64 = outcome.loads.iter().sum::<f64>() * outcome.measured_s * 1e9;
        let of_clients: u64 = outcome.device_ns.iter().sum();
        assert!((busy_ns - of_clients as f64).abs() < 1e3, "{busy_ns} {of_clients}");
        // L = λ W, to what is under way at the end.
        let rate_per_ns = outcome.answered as f64 / plan.until_ns as f64;
        let (found, expected) = (outcome.mean_unanswered, rate_per_ns * outcome.mean_wait_ns);
        assert!((found - expected).abs() < 0.02 * expected, "{found} {expected}");
        assert_eq!(simulate(&plan), outcome);
    }
}

#[test]
fn a_loop_keeps_its_connections_busy() {
    for connections in [1, 8, 64] {
        let habit = Habit::Loop { connections, pause_ns: MS };
        let outcome = simulate(&plan(1, vec![Asker { habit, scene: 0 }]));
        // One frame at a time takes the device's time, the encoder's, the way and the pause. Many are limited by the device alone.
        let expected = if connections == 1 { 1000.0 / 8.0 } else { 200.0 };
        let found = outcome.frames_per_s;
        assert!((found / expected - 1.0).abs() < 0.02, "{connections}: {found}");
        let waited = outcome.frames_per_s * outcome.waits.all.mean().unwrap() / 1e9;
        let away = outcome.frames_per_s * 1e-3;
        assert!((waited + away - connections as f64).abs() < 0.1, "{connections}: {waited}");
    }
}

#[test]
fn equal_clients_have_equal_device_time_beside_bursts() {
    let mut clients = many(12, Habit::Stream { interval_ns: 33 * MS });
    clients.extend(many(3, Habit::Burst { frames: 64, pause_ns: SECOND }));
    for asker in &mut clients {
        asker.scene = 0;
    }
    let outcome = simulate(&plan(1, clients));
    let times: Vec<f64> = outcome.device_ns[..12].iter().map(|ns| *ns as f64).collect();
    assert!(jain(&times).unwrap() > 0.999, "{times:?}");
    assert!(outcome.loads[0] > 0.95, "{:?}", outcome.loads);
}

#[test]
fn clients_of_a_lost_daemon_find_another() {
    let mut plan = plan(10, many(1000, Habit::Viewer { pause_ns: 2 * SECOND }));
    plan.lost = Some((12 * SECOND, 4));
    let outcome = simulate(&plan);
    assert!(outcome.moved > 0 && outcome.moved < 400, "{}", outcome.moved);
    assert_eq!(outcome.refused, 0);
    // They wait for their scenes to be uploaded.
    let [moved, stayed] = [&outcome.waits.moved, &outcome.waits.stayed].map(|waits| waits.max());
    assert!(moved.unwrap() >= 50 * MS && moved.unwrap() < SECOND, "{moved:?} {stayed:?}");
}

#[test]
fn a_bound_spreads_a_scene_that_is_too_hot_for_one_daemon() {
    let mut plan = plan(8, many(400, Habit::Viewer { pause_ns: SECOND / 2 }));
    for asker in &mut plan.clients {
        asker.scene = 7;
    }
    let hot = simulate(&plan);
    plan.bound = Some(1.25);
    let spread = simulate(&plan);
    assert!(hot.frames_per_s < 205.0, "{}", hot.frames_per_s);
    assert!(spread.frames_per_s > 3.0 * hot.frames_per_s, "{}", spread.frames_per_s);
    assert_eq!((hot.uploads, spread.uploads > 1), (1, true));
}

#[test]
fn popularity_follows_zipf() {
    let scenes = zipf(100_000, 1000, &mut SplitMix64::new(3));
    let of = |rank: usize| scenes.iter().filter(|scene| **scene == rank).count() as f64;
    // The thousandth harmonic number is 7.485.
    assert!((of(0) / 100_000.0 - 1.0 / 7.485).abs() < 0.005, "{}", of(0));
    assert!((of(0) / of(3) - 4.0).abs() < 0.3, "{}", of(0) / of(3));
    assert!(scenes.iter().all(|scene| *scene < 1000));
}
