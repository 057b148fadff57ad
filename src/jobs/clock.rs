//! The clock of jobs: milliseconds since 1970 that advance with the process's monotonic clock, even when the system's clock is
//! changed.

use std::time::{Duration, Instant, SystemTime};

/// Difference between the two clocks above which the system's clock counts as having jumped: larger than slewing between two
/// checks causes.
const SLACK: Duration = Duration::from_secs(2);

/// A clock that was set once, or after a jump. Pure: the caller passes both times.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    set_at: Instant,
    set_ms: u64,
}

/// Returns milliseconds since 1970 by the system's clock.
pub fn wall_ms() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

impl Clock {
    pub fn new(at: Instant, wall_ms: u64) -> Clock {
        Clock { set_at: at, set_ms: wall_ms }
    }

    /// Returns milliseconds since 1970, advanced by the time since the clock was set.
    pub fn ms(&self, at: Instant) -> u64 {
        let passed = at.saturating_duration_since(self.set_at).as_millis();
        self.set_ms.saturating_add(u64::try_from(passed).unwrap_or(u64::MAX))
    }

    /// Sets the clock when the system's clock has jumped. Returns the jump in milliseconds, which may be negative, or 0. The
    /// caller must shift all times taken from this clock before by the same amount.
    pub fn follow(&mut self, at: Instant, wall_ms: u64) -> i64 {
        let own_ms = self.ms(at);
        if u128::from(own_ms.abs_diff(wall_ms)) <= SLACK.as_millis() {
            return 0;
        }
        *self = Clock::new(at, wall_ms);
        let by = i128::from(wall_ms) - i128::from(own_ms);
        i64::try_from(by).unwrap_or(if by < 0 { i64::MIN } else { i64::MAX })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jumps_are_told_and_nothing_else_is() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut clock = Clock::new(start, 1_000_000);
        assert_eq!(clock.ms(at(500)), 1_000_500);
        // A slewed clock is not followed.
        assert_eq!(clock.follow(at(1000), 1_002_900), 0);
        assert_eq!(clock.ms(at(1000)), 1_001_000);
        assert_eq!(clock.follow(at(2000), 9_002_000), 8_000_000);
        assert_eq!(clock.ms(at(2500)), 9_002_500);
        assert_eq!(clock.follow(at(3000), 9_003_000), 0);
        assert_eq!(clock.follow(at(4000), 4_000), -9_000_000);
        assert_eq!((clock.ms(at(4000)), clock.follow(at(4000), u64::MAX)), (4_000, i64::MAX));
    }
}
