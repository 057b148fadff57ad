use std::collections::VecDeque;

use super::super::schedule::{Schedule, Spacing};
use super::super::tally::{Answer, Outcome, Sample, Tally};
use super::*;

const SETTINGS: SearchSettings = SearchSettings {
    first_per_s: 1.0,
    least_per_s: 0.1,
    most_per_s: 1e5,
    factor: 2.0,
    resolution: 0.05,
    steps_at_most: 40,
};

fn found(settings: SearchSettings, mut keeps_up: impl FnMut(f64) -> bool) -> (Option<f64>, u32) {
    let mut search = Search::new(settings);
    while let Some(rate) = search.next_rate() {
        search.tell(rate, keeps_up(rate));
    }
    (search.knee_per_s(), search.steps)
}

#[test]
fn a_sharp_knee_is_found_wherever_it_is() {
    for knee in [0.2, 0.9, 1.0, 3.7, 100.0, 1023.0, 1025.0, 77_777.0] {
        let (rate, steps) = found(SETTINGS, |rate| rate <= knee);
        let rate = rate.unwrap();
        assert!(rate <= knee && rate * 1.05 >= knee, "{knee}: {rate}");
        assert!(steps < 25, "{knee}: {steps}");
    }
}

#[test]
fn limits_end_the_search() {
    assert_eq!(found(SETTINGS, |_| true).0, Some(1e5));
    assert_eq!(found(SETTINGS, |_| false).0, None);
    let few = SearchSettings { steps_at_most: 3, ..SETTINGS };
    assert_eq!(found(few, |_| true), (Some(4.0), 3));
}

/// A server that draws one frame at a time in `service` and refuses when `queue` requests are waiting.
fn simulated(
    rate_per_s: f64,
    service: Duration,
    queue: usize,
    timeout: Duration,
    seed: u64,
) -> Point {
    let (warmup, length) = (Duration::from_secs(2), Duration::from_secs(20));
    let mut tally = Tally::new(warmup, length);
    let mut free = Duration::ZERO;
    let mut under_way: VecDeque<Duration> = VecDeque::new();
    for due in Schedule::new(rate_per_s, Spacing::Poisson, seed) {
        if due >= warmup + length {
            break;
        }
        while under_way.front().is_some_and(|done| *done <= due) {
            under_way.pop_front();
        }
        let status = if under_way.len() > queue { 503 } else { 200 };
        let mut done = due;
        if status == 200 {
            free = free.max(due) + service;
            done = free;
            under_way.push_back(done);
        }
        let outcome = if done - due > timeout {
            Outcome::TimedOut
        } else {
            Outcome::Answered(Answer {
                status,
                bytes: 1,
                has_retry_after: true,
                receipt: None,
                complaint: None,
            })
        };
        tally.record(Sample { due, begun: due, done, outcome });
    }
    tally.point(rate_per_s)
}

/// The capacity is 200/s. With a queue that refuses and with one that grows, the knee lies a little below it, where the queue
/// of a random arrival process is still short.
#[test]
fn the_knee_of_a_simulated_server_is_its_capacity() {
    let service = Duration::from_millis(5);
    for queue in [16, usize::MAX] {
        for seed in 0..5 {
            let demands = Demands::new(Duration::from_millis(250));
            let (mut search, mut seen) = (Search::new(SETTINGS), Vec::new());
            while let Some(rate) = search.next_rate() {
                let point = simulated(rate, service, queue, Duration::from_secs(10), seed);
                let verdict = judge(&point, &demands);
                search.tell(rate, verdict == Verdict::KeepsUp);
                seen.push((rate, point.throughput_per_s, verdict));
            }
            let knee = search.knee_per_s().unwrap();
            assert!((160.0..=215.0).contains(&knee), "{queue} {seed}: {knee} {seen:?}");
            assert!(seen.iter().all(|(_, throughput, _)| *throughput < 201.0), "{seen:?}");
        }
    }
}

#[test]
fn streams_are_judged_beside_requests() {
    use super::super::following::{Following, StreamTally};
    use super::super::wire::FrameAnswer;
    let demands = Demands::new(Duration::from_millis(250));
    let service = Duration::from_millis(5);
    let mut point = simulated(50.0, service, 16, Duration::from_secs(10), 1);
    assert_eq!(judge(&point, &demands), Verdict::KeepsUp);
    // A stream of 100 poses: every `every`th of the first `followed` gets a frame, `took_ms` after it was due.
    let streams = |followed: u64, every: u64, took_ms: u64, broken: bool| {
        let mut tally = StreamTally::new(1, Duration::ZERO, Duration::from_secs(10));
        let mut following = Following::default();
        for seq in 1..=100 {
            let due = Duration::from_millis(seq * 30);
            following.due(seq, due);
            if seq <= followed && seq % every == 0 {
                let frame = FrameAnswer::of(seq, "moving");
                let at = due + Duration::from_millis(took_ms);
                tally.frame(&mut following, &frame, 1000, at);
            }
        }
        if broken {
            tally.broken("closed".to_owned());
        }
        tally.ended(&following);
        Some(tally.point())
    };
    for (followed, every, took_ms, broken, verdict) in [
        (100, 1, 30, false, Verdict::KeepsUp),
        (100, 2, 30, false, Verdict::KeepsUp),
        (100, 5, 30, false, Verdict::StreamsSkip),
        (100, 1, 30, true, Verdict::StreamsStarve),
        (90, 1, 30, false, Verdict::StreamsStarve),
        (0, 1, 30, false, Verdict::StreamsStarve),
        (100, 1, 300, false, Verdict::StreamsSlow),
    ] {
        point.streams = streams(followed, every, took_ms, broken);
        let what = format!("{followed} {every} {took_ms} {broken}");
        assert_eq!(judge(&point, &demands), verdict, "{what}");
    }
    let mut idle = simulated(1e-9, service, 1, service, 1);
    idle.streams = streams(0, 1, 0, true);
    assert_eq!(judge(&idle, &demands), Verdict::StreamsStarve, "streams alone");
}

/// At 2.5 requests per second, a throughput of 87 % still counts as falling behind.
#[test]
fn few_requests_are_no_excuse() {
    let demands = Demands::new(Duration::from_secs(1));
    let mut point = simulated(2.5, Duration::from_millis(5), 16, Duration::from_secs(1), 1);
    assert_eq!(judge(&point, &demands), Verdict::KeepsUp);
    point.throughput_per_s *= 0.87;
    assert_eq!(judge(&point, &demands), Verdict::FallsBehind);
}

#[test]
fn overload_shows_as_what_it_is() {
    let demands = Demands::new(Duration::from_secs(1));
    let service = Duration::from_millis(5);
    let refusing = simulated(400.0, service, 8, Duration::from_secs(10), 1);
    assert_eq!(judge(&refusing, &demands), Verdict::Unanswered);
    assert!((refusing.throughput_per_s - 200.0).abs() < 2.0);
    let patient = simulated(400.0, service, usize::MAX, Duration::from_secs(100), 1);
    assert_eq!(patient.counts.frames, patient.requests);
    assert_eq!(judge(&patient, &demands), Verdict::FallsBehind);
    let slow = simulated(20.0, Duration::from_millis(45), usize::MAX, Duration::from_secs(10), 1);
    assert_eq!(judge(&slow, &Demands::new(Duration::from_millis(100))), Verdict::Slow);
    let lost = simulated(400.0, service, usize::MAX, Duration::from_millis(300), 1);
    assert_eq!(judge(&lost, &demands), Verdict::Unanswered);
    assert_eq!(lost.latency.p99_ns, None);
    assert_eq!(judge(&simulated(1e-9, service, 1, service, 1), &demands), Verdict::Idle);
}
