//! Decides which frame of a path is due. Pure: the caller passes the time.
//!
//! A tick counts frames in the time that passes: the first frame is tick 0, and tick `n` is due `n / fps` seconds later.
//! Ticks that could not be drawn in time are skipped, so that the film keeps the path's own time. The last tick is never skipped.

use std::time::Duration;

/// When the frames of a path are due.
#[derive(Clone, Copy, Debug)]
pub struct Timeline {
    fps: f64,
    /// Number of frames of the path, at least one.
    count: u64,
    loops: bool,
}

/// The next action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// Draw this tick.
    Draw(u64),
    /// Wait until this long after the start.
    WaitUntil(Duration),
    End,
}

impl Timeline {
    pub fn new(fps: f64, count: u64, loops: bool) -> Self {
        Self { fps, count: count.max(1), loops }
    }

    /// Returns the action at time `elapsed` after tick 0 was shown, when `shown` is the last tick shown.
    pub fn next(&self, shown: u64, elapsed: Duration) -> Next {
        let last = self.count - 1;
        if !self.loops && shown >= last {
            return Next::End;
        }
        // Without this slack, a rounding error could make a timer that fires on time wait again.
        const SLACK: f64 = 1e-6;
        let now = (elapsed.as_secs_f64() * self.fps + SLACK) as u64;
        let now = if self.loops { now } else { now.min(last) };
        if now > shown {
            return Next::Draw(now);
        }
        // Both numbers are finite and positive; a time too long for `Duration` is never reached.
        let due_s = (shown + 1) as f64 / self.fps;
        Next::WaitUntil(Duration::try_from_secs_f64(due_s).unwrap_or(Duration::MAX))
    }

    /// Returns the number of the path's frame that a tick shows.
    pub fn frame(&self, tick: u64) -> u64 {
        if self.loops { tick % self.count } else { tick.min(self.count - 1) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    use super::*;

    #[test]
    fn frames_come_when_they_are_due() {
        let timeline = Timeline::new(10.0, 3, false);
        let at = |shown, ms| timeline.next(shown, Duration::from_millis(ms));
        assert_eq!(at(0, 0), Next::WaitUntil(Duration::from_millis(100)));
        assert_eq!(at(0, 100), Next::Draw(1));
        assert_eq!(at(0, 250), Next::Draw(2), "the one between is left out");
        assert_eq!(at(0, 99_000), Next::Draw(2), "the last one is not");
        assert_eq!(at(2, 99_000), Next::End);
        let looping = Timeline::new(10.0, 3, true);
        assert_eq!(looping.next(2, Duration::from_millis(300)), Next::Draw(3));
        assert_eq!([3, 4, 5, 6].map(|tick| looping.frame(tick)), [0, 1, 2, 0]);
        assert_eq!(Timeline::new(30.0, 1, false).next(0, Duration::ZERO), Next::End);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, rng_seed: RngSeed::Fixed(0x51ea_0003), ..ProptestConfig::default() })]
        /// For all drawing times: ticks grow, none is early, none is later than the time that the previous drawing took, and a
        /// path that does not loop ends with its last frame at the right time.
        #[test]
        fn playing_keeps_the_time(
            fps in 0.1..120.0f64,
            count in 1u64..200,
            took_ms in prop::collection::vec(0u64..400, 400),
        ) {
            let timeline = Timeline::new(fps, count, false);
            let (mut now, mut shown) = (Duration::ZERO, 0);
            let mut took = took_ms.into_iter().map(Duration::from_millis).cycle();
            loop {
                match timeline.next(shown, now) {
                    Next::WaitUntil(until) => {
                        prop_assert!(until + Duration::from_millis(1) > now, "waits for what has been");
                        now = now.max(until);
                        prop_assert!(!matches!(timeline.next(shown, now), Next::WaitUntil(_)));
                    }
                    Next::Draw(tick) => {
                        prop_assert!(tick > shown && tick < count);
                        prop_assert!(now.as_secs_f64() * fps > tick as f64 - 1e-3, "early");
                        prop_assert!(tick == count - 1 || now.as_secs_f64() * fps < tick as f64 + 1.001, "late");
                        shown = tick;
                        now += took.next().unwrap_or_default();
                    }
                    Next::End => break,
                }
            }
            prop_assert_eq!(shown, count - 1);
            prop_assert_eq!(timeline.frame(shown), count - 1);
        }
    }
}
