//! Limits how many messages a client may send, by a token bucket. Pure: the caller passes the time.
//!
//! The bucket absorbs a burst after a network stall. A higher rate than any client needs is refused, because reading it would
//! take a core.

use std::time::Instant;

use crate::http::bucket::{Bucket, Rate};

/// Messages per second. Mice report up to a thousand times a second; no other source comes near.
pub const MOST_PER_SECOND: u32 = 1000;
/// Size of the bucket: messages at once.
const PURSE: u32 = 4 * MOST_PER_SECOND;

const RATE: Rate = Rate { per_second: MOST_PER_SECOND as f64, burst: PURSE as f64 };

/// The token bucket of one client.
#[derive(Debug)]
pub struct Allowance(Bucket);

impl Allowance {
    pub fn new(now: Instant) -> Self {
        Self(Bucket::full(RATE, now))
    }

    /// Takes a token for a message. Returns false if there is none.
    #[must_use]
    pub fn take(&mut self, now: Instant) -> bool {
        self.0.take(now).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// Returns when the first of messages at `per_second` is refused, within a minute.
    fn refused_after(per_second: u32) -> Option<f64> {
        let start = Instant::now();
        let mut allowance = Allowance::new(start);
        (0..per_second * 60)
            .map(|number| f64::from(number) / f64::from(per_second))
            .find(|second| !allowance.take(start + Duration::from_secs_f64(*second)))
    }

    #[test]
    fn a_rate_is_borne_for_as_long_as_it_is_near_the_limit() {
        assert_eq!(refused_after(MOST_PER_SECOND - 10), None);
        let twice = refused_after(2 * MOST_PER_SECOND).unwrap();
        assert!((3.9..4.1).contains(&twice), "{twice}");
        let flood = refused_after(100 * MOST_PER_SECOND).unwrap();
        assert!(flood < 0.05, "{flood}");
    }

    #[test]
    fn a_pause_fills_the_purse_and_no_more() {
        let start = Instant::now();
        let mut allowance = Allowance::new(start);
        let mut burst = |at| (0..2 * PURSE).take_while(|_| allowance.take(at)).count();
        assert_eq!(burst(start), PURSE as usize);
        assert_eq!(burst(start + Duration::from_secs(1)), MOST_PER_SECOND as usize);
        assert_eq!(burst(start + Duration::from_secs(3600)), PURSE as usize);
    }
}
