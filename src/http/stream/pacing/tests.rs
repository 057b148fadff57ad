use super::*;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1000.0)
}

/// Simulates an engine, a link and a decoder, with a pose that always moves.
struct Bench {
    /// Time to draw all pixels of a frame.
    draw_ms: f64,
    /// Time to draw a frame's detail at the requested error, independent of its pixels.
    detail_ms: f64,
    /// Round trip.
    distance_ms: f64,
    bytes_per_ms: f64,
    decode_ms: f64,
    full_bytes: f64,
    answers_pings: bool,
}

/// A client on the same machine, with a decoder that takes no time.
const NEAR: Bench = Bench {
    draw_ms: 0.0,
    detail_ms: 0.0,
    distance_ms: 2.0,
    bytes_per_ms: 1e5,
    decode_ms: 2.0,
    full_bytes: 2e5,
    answers_pings: true,
};

/// Results: frames in the last second, and the longest time from request to acknowledgement, in that second and overall.
struct Seen {
    frames: usize,
    oldest_ever_ms: f64,
    scale: f64,
    jpeg_quality: u8,
    coarseness: f64,
    oldest_ms: f64,
    most_on_the_way: usize,
}

impl Bench {
    /// Requests a frame whenever allowed, for `seconds`, in steps of a millisecond.
    fn run(&self, seconds: usize) -> Seen {
        let start = Instant::now();
        let mut pacer = Pacer::new();
        let (mut draws, mut flights) = (VecDeque::new(), VecDeque::new());
        let (mut engine_free, mut link_free, mut decoder_free) = (0.0f64, 0.0f64, 0.0f64);
        let mut number = 0;
        let mut pong_at = f64::INFINITY;
        let mut seen = Seen {
            frames: 0,
            oldest_ever_ms: 0.0,
            scale: 0.0,
            jpeg_quality: 0,
            coarseness: 0.0,
            oldest_ms: 0.0,
            most_on_the_way: 0,
        };
        for step in 0..seconds * 1000 {
            let now_ms = step as f64;
            let now = start + ms(now_ms);
            let is_last = step >= (seconds - 1) * 1000;
            while let Some(&(done, asked, share)) =
                draws.front().filter(|draw: &&(f64, f64, f64)| draw.0 <= now_ms)
            {
                draws.pop_front();
                pacer.drawn(start + ms(asked), start + ms(done), Some(share), None);
                number += 1;
                if pacer.ping(now) && self.answers_pings {
                    pong_at = link_free.max(now_ms) + self.distance_ms;
                }
                let bytes: f64 =
                    self.full_bytes * share * f64::from(pacer.pace().jpeg_quality) / 80.0;
                pacer.sent(number, bytes as u64, now, Some(share));
                link_free = link_free.max(now_ms) + bytes / self.bytes_per_ms;
                decoder_free =
                    decoder_free.max(link_free + self.distance_ms / 2.0) + self.decode_ms * share;
                flights.push_back((decoder_free + self.distance_ms / 2.0, number, asked));
            }
            if now_ms >= pong_at {
                pacer.ponged(now);
                pong_at = f64::INFINITY;
            }
            while let Some(&(at, acked, asked)) =
                flights.front().filter(|flight: &&(f64, u64, f64)| flight.0 <= now_ms)
            {
                flights.pop_front();
                pacer.acked(acked, now).unwrap();
                seen.oldest_ever_ms = seen.oldest_ever_ms.max(at - asked);
                if is_last {
                    seen.frames += 1;
                    seen.oldest_ms = seen.oldest_ms.max(at - asked);
                }
            }
            if draws.len() < 2 && pacer.may_ask(draws.len()) {
                let Pace { scale, coarseness, .. } = pacer.pace();
                let share = scale.powi(2);
                let draw_ms = self.draw_ms * share + self.detail_ms / coarseness;
                engine_free = engine_free.max(now_ms) + draw_ms;
                draws.push_back((engine_free, now_ms, share));
            }
            seen.most_on_the_way = seen.most_on_the_way.max(draws.len() + flights.len());
        }
        let Pace { scale, jpeg_quality, coarseness, .. } = pacer.pace();
        (seen.scale, seen.jpeg_quality, seen.coarseness) = (scale, jpeg_quality, coarseness);
        seen
    }
}

#[test]
fn a_fast_engine_on_a_fast_link_draws_at_full_size() {
    let bench = Bench { draw_ms: 5.0, detail_ms: 0.0, ..NEAR };
    let seen = bench.run(4);
    assert!(seen.scale > 0.95 && seen.jpeg_quality >= 78, "{} {}", seen.scale, seen.jpeg_quality);
    assert!(seen.frames >= 30, "{}", seen.frames);
}

#[test]
fn a_slow_engine_draws_smaller_frames() {
    let bench = Bench { draw_ms: 200.0, detail_ms: 0.0, ..NEAR };
    let seen = bench.run(6);
    assert!((0.3..0.5).contains(&seen.scale), "{}", seen.scale);
    assert!((22..45).contains(&seen.frames), "{}", seen.frames);
    assert!(seen.oldest_ms < 150.0, "{}", seen.oldest_ms);
}

#[test]
fn an_engine_that_fewer_pixels_do_not_help_draws_less_detail() {
    // Modelled on the plaza: 300 ms in full, 112 ms at a sixteenth of the pixels, and 37 ms at four times the error.
    let mut bench = Bench { draw_ms: 200.0, detail_ms: 100.0, ..NEAR };
    let seen = bench.run(6);
    assert!((0.25..0.3).contains(&seen.scale), "{}", seen.scale);
    assert!(seen.coarseness > 3.0 && seen.frames >= 22, "{} {}", seen.coarseness, seen.frames);
    // At half the cost, pixels grow before detail does.
    (bench.draw_ms, bench.detail_ms) = (100.0, 50.0);
    let seen = bench.run(6);
    assert!((1.2..3.0).contains(&seen.coarseness), "{}", seen.coarseness);
    assert!(seen.frames >= 25, "{}", seen.frames);
}

#[test]
fn a_slow_link_gets_less_and_no_queue() {
    // One megabyte per second, with frames of 400 KB.
    let bench = Bench {
        draw_ms: 5.0,
        detail_ms: 0.0,
        distance_ms: 40.0,
        bytes_per_ms: 1e3,
        decode_ms: 2.0,
        full_bytes: 4e5,
        answers_pings: true,
    };
    let seen = bench.run(8);
    assert!(seen.jpeg_quality <= 60 && seen.scale < 0.6, "{} {}", seen.jpeg_quality, seen.scale);
    assert_eq!(seen.coarseness, 1.0, "the engine has time for detail");
    assert!(seen.frames >= 15, "{}", seen.frames);
    assert!(seen.oldest_ms < 300.0, "{}", seen.oldest_ms);
}

#[test]
fn a_very_slow_link_never_has_old_frames_on_it() {
    // 60 and 20 kilobytes per second, with frames of 120 KB, with and without a client that answers pings.
    for (bytes_per_ms, answers_pings) in [(60.0, true), (60.0, false), (20.0, true)] {
        let bench = Bench {
            draw_ms: 10.0,
            detail_ms: 0.0,
            distance_ms: 60.0,
            bytes_per_ms,
            decode_ms: 2.0,
            full_bytes: 1.2e5,
            answers_pings,
        };
        let seen = bench.run(20);
        // The first frame has a quarter of the pixels on every link; no frame takes much longer.
        let first_ms = 0.25 * 1.2e5 * 70.0 / 80.0 / bytes_per_ms + 100.0;
        assert!(seen.oldest_ever_ms < 1.2 * first_ms, "{} of {first_ms}", seen.oldest_ever_ms);
        assert!(seen.oldest_ms < 3.0 * 0.0625 * 1.2e5 / bytes_per_ms + 100.0, "{}", seen.oldest_ms);
        assert_eq!((seen.jpeg_quality, seen.scale), (40, 0.25), "as small as may be");
        assert_eq!(seen.coarseness, 1.0, "the engine has time for detail");
    }
}

#[test]
fn a_path_that_became_longer_is_no_slow_link() {
    let start = Instant::now();
    let mut pacer = Pacer::new();
    // The first ping measures 10 ms; later the distance is 200 ms, with an occasional pause.
    let mut now = start;
    for number in 1..60 {
        let distance = ms(if number < 4 { 10.0 } else { 200.0 });
        if pacer.ping(now) {
            pacer.ponged(now + distance);
        }
        let share = pacer.pace().scale.powi(2);
        pacer.drawn(now, now, Some(share), None);
        pacer.sent(number, 50_000, now, Some(share));
        pacer.acked(number, now + distance + ms(4.0)).unwrap();
        now += distance + ms(150.0);
    }
    assert!(pacer.pace().scale > 0.9 && pacer.pace().jpeg_quality >= 70, "{:?}", pacer.pace());
}

#[test]
fn a_slow_decoder_counts_as_a_slow_link() {
    let bench = Bench { draw_ms: 5.0, detail_ms: 0.0, decode_ms: 150.0, ..NEAR };
    let seen = bench.run(8);
    assert!(seen.scale < 0.7 && seen.frames >= 15, "{} {}", seen.scale, seen.frames);
    assert!(seen.oldest_ms < 300.0, "{}", seen.oldest_ms);
}

#[test]
fn a_long_link_is_kept_full() {
    let bench = Bench { draw_ms: 5.0, detail_ms: 0.0, distance_ms: 150.0, ..NEAR };
    let seen = bench.run(6);
    assert!(seen.scale > 0.9, "distance is not slowness: {}", seen.scale);
    assert!(seen.frames >= 25, "{}", seen.frames);
}

#[test]
fn acknowledgements_are_cumulative_and_checked() {
    let now = Instant::now();
    let mut pacer = Pacer::new();
    for number in 1..=2 {
        pacer.sent(number, 1000, now, Some(0.25));
    }
    assert!(!pacer.may_ask(0));
    assert_eq!(pacer.acked(3, now), Err(2));
    assert_eq!(pacer.acked(2, now + ms(5.0)), Ok(()));
    assert_eq!((pacer.unacked.len(), pacer.may_ask(1)), (0, true));
    assert_eq!(pacer.acked(1, now + ms(6.0)), Ok(()), "again, which changes nothing");
}

#[test]
fn who_does_not_acknowledge_is_known_after_a_while() {
    let now = Instant::now();
    let mut pacer = Pacer::new();
    assert_eq!(pacer.unacknowledged(), None);
    pacer.sent(1, 1000, now, None);
    pacer.sent(2, 1000, now + ms(10.0), None);
    assert_eq!(pacer.unacknowledged(), Some((1, now + PATIENCE)));
    pacer.acked(1, now + ms(50.0)).unwrap();
    assert_eq!(pacer.unacknowledged(), Some((2, now + ms(10.0) + 4 * PATIENCE)));
    pacer.acked(2, now + ms(60.0)).unwrap();
    assert_eq!(pacer.unacknowledged(), None);
}

#[test]
fn a_large_still_is_waited_for() {
    let now = Instant::now();
    let mut pacer = Pacer::new();
    pacer.sent(1, FIRST_BYTES + 1, now, None);
    assert!(!pacer.may_ask(0), "a moving frame would stand behind it");
    pacer.acked(1, now + ms(900.0)).unwrap();
    assert!(pacer.may_ask(0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: RngSeed::Fixed(0x51ea_0003), ..ProptestConfig::default() })]
    /// For every sequence of frames drawn, sent and acknowledged: the window bounds the frames in flight, numbers stay in their
    /// ranges, and once all frames are acknowledged, another may be requested.
    #[test]
    fn bounds_hold(steps in prop::collection::vec((0u64..400, 0u8..4, 0u64..5_000_000), 1..150)) {
        let mut now = Instant::now();
        let mut pacer = Pacer::new();
        let (mut sent, mut acked) = (0, 0);
        for (passed_ms, what, bytes) in steps {
            let before = now;
            now += Duration::from_millis(passed_ms);
            match what {
                0 if acked < sent => {
                    acked += 1 + bytes % (sent - acked);
                    prop_assert!(pacer.acked(acked, now).is_ok());
                }
                1 => prop_assert!(pacer.acked(sent + 1 + bytes, now).is_err()),
                _ if pacer.may_ask(0) => {
                    sent += 1;
                    let share = (what == 2).then(|| pacer.pace().scale.powi(2));
                    pacer.drawn(before, now, share, None);
                    pacer.sent(sent, bytes, now, share);
                }
                _ => prop_assert!(!pacer.unacked.is_empty()),
            }
            prop_assert_eq!(pacer.unacked.len() as u64, sent - acked);
            prop_assert!(pacer.unacked.len() <= MAX_WINDOW);
            prop_assert!((MIN_WINDOW..=MAX_WINDOW).contains(&pacer.window()));
            let pace = pacer.pace();
            prop_assert!((0.25..=1.0).contains(&pace.scale));
            prop_assert!((1.0..=4.0).contains(&pace.coarseness));
            prop_assert!((40..=80).contains(&pace.jpeg_quality));
        }
        prop_assert!(pacer.acked(sent, now).is_ok());
        prop_assert!(pacer.may_ask(0) && !pacer.may_ask(MAX_WINDOW));
    }
}
