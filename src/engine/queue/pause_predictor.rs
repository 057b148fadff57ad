//! Predicts when clients ask again. A client that draws a frame, looks at it and asks for the next leaves the device idle for a
//! moment. A job's frame begun then would delay the client's next frame (anticipatory scheduling: S. Iyer, P. Druschel, SOSP
//! 2001).
//!
//! ```text
//! client   frame ▓▓▓▓│·pause·│▓▓▓▓│·pause·│▓▓▓▓          A: frames of jobs that end by then may be drawn
//! jobs               └ A ┘B  └ ...                       B: wait, for twice the pause and PATIENCE at most
//! ```
//!
//! A pause lasts from a frame's landing to its client's next request, including encoding and the round trip; means are
//! exponentially weighted.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::Client;

/// The queue does not wait for a client with a longer pause.
pub const MOST_PAUSE: Duration = Duration::from_millis(80);
/// Time for which a client is waited for, beside twice its pause.
pub const PATIENCE: Duration = Duration::from_millis(2);
/// Assumed pause of a client that has not asked twice.
const FIRST_PAUSE: Duration = Duration::from_millis(4);
/// Upper limit of a measured pause; a client that comes back later was away.
const LONGEST: Duration = Duration::from_secs(1);
/// Time for which an inactive client is remembered.
const MEMORY: Duration = Duration::from_secs(10);
/// Interval at which inactive clients are looked for. A request costs the same with ten thousand clients as with ten.
const SWEEP: Duration = Duration::from_secs(1);
/// Number of clients below which none is forgotten.
const MOST_CLIENTS: usize = 256;

#[derive(Clone, Copy, Debug)]
struct Habit {
    pause: Duration,
    /// Time when a frame landed after which the client has not asked again.
    landed: Option<Instant>,
    /// Time of its last request or frame.
    seen: Instant,
}

/// Expected requests of clients that have just got a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    /// Time until one of them may ask.
    pub free: Duration,
    /// Time after which none of them is waited for.
    pub until: Duration,
}

/// Pauses of the clients that wait for each frame.
#[derive(Debug, Default)]
pub struct PausePredictor {
    clients: HashMap<Client, Habit>,
    /// When inactive clients were forgotten last.
    swept: Option<Instant>,
}

impl PausePredictor {
    /// Records a client's request for a frame.
    pub fn asked(&mut self, client: Client, now: Instant) {
        self.forget(now);
        let first = Habit { pause: FIRST_PAUSE, landed: None, seen: now };
        let habit = self.clients.entry(client).or_insert(first);
        habit.seen = now;
        if let Some(landed) = habit.landed.take() {
            let pause = now.saturating_duration_since(landed).min(LONGEST);
            habit.pause = (habit.pause * 3 + pause) / 4;
        }
    }

    /// Records that a client's frame is drawn.
    pub fn landed(&mut self, client: Client, now: Instant) {
        if let Some(habit) = self.clients.get_mut(&client) {
            habit.landed = Some(now);
            habit.seen = now;
        }
    }

    /// Returns whether a client is known to ask again soon after a frame.
    pub fn is_quick(&self, client: Client) -> bool {
        self.clients.get(&client).is_some_and(|habit| habit.pause <= MOST_PAUSE)
    }

    /// Returns when requests of waiting clients are expected.
    pub fn expected(&self, now: Instant) -> Option<Expected> {
        let waited_for = self.clients.values().filter_map(|habit| {
            let since = now.saturating_duration_since(habit.landed?);
            let until = (habit.pause * 2 + PATIENCE).checked_sub(since)?;
            let is_waited_for = habit.pause <= MOST_PAUSE && until > Duration::ZERO;
            is_waited_for.then(|| Expected { free: habit.pause.saturating_sub(since), until })
        });
        waited_for.reduce(|a, b| Expected { free: a.free.min(b.free), until: a.until.min(b.until) })
    }

    fn forget(&mut self, now: Instant) {
        let is_due = self.swept.is_none_or(|at| now.saturating_duration_since(at) >= SWEEP);
        if self.clients.len() >= MOST_CLIENTS && is_due {
            self.clients.retain(|_, habit| now.saturating_duration_since(habit.seen) < MEMORY);
            self.swept = Some(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn who_asks_after_each_frame_is_waited_for() {
        let (mut pauses, start, who) =
            (PausePredictor::default(), Instant::now(), Client::Caller(1));
        pauses.landed(who, start);
        assert_eq!(pauses.expected(start), None, "it was never heard of");
        let mut now = start;
        for _ in 0..30 {
            pauses.asked(who, now);
            assert_eq!(pauses.expected(now), None, "it has asked");
            now += 20 * MS;
            pauses.landed(who, now);
            now += 10 * MS;
        }
        assert!(pauses.is_quick(who));
        now -= 10 * MS;
        let Expected { free, until } = pauses.expected(now + 4 * MS).unwrap();
        assert!(free > 5 * MS && free < 7 * MS, "{free:?}");
        assert!(until > 17 * MS && until < 19 * MS, "{until:?}");
        assert_eq!(pauses.expected(now + 15 * MS).unwrap().free, Duration::ZERO);
        assert_eq!(pauses.expected(now + 23 * MS), None, "it is away");
    }

    #[test]
    fn who_asks_now_and_then_is_not() {
        let (mut pauses, mut now, who) =
            (PausePredictor::default(), Instant::now(), Client::Caller(1));
        for _ in 0..20 {
            pauses.asked(who, now);
            pauses.landed(who, now);
            now += 300 * MS;
        }
        assert!(!pauses.is_quick(who));
        pauses.landed(who, now);
        assert_eq!(pauses.expected(now), None);
    }

    #[test]
    fn the_first_of_several_decides() {
        let (mut pauses, start) = (PausePredictor::default(), Instant::now());
        for (number, pause) in [(1, 40), (2, 10)] {
            let mut now = start;
            for _ in 0..40 {
                pauses.asked(Client::Caller(number), now);
                pauses.landed(Client::Caller(number), now);
                now += pause * MS;
            }
            pauses.asked(Client::Caller(number), now);
            pauses.landed(Client::Caller(number), start);
        }
        let expected = pauses.expected(start).unwrap();
        assert!(expected.free < 11 * MS && expected.until < 23 * MS, "{expected:?}");
    }

    #[test]
    fn clients_without_end_are_forgotten() {
        let (mut pauses, mut now) = (PausePredictor::default(), Instant::now());
        for number in 0..20_000 {
            pauses.asked(Client::Caller(number), now);
            now += 20 * MS;
        }
        assert!(pauses.clients.len() < 1000, "{}", pauses.clients.len());
        // They are looked for once in a while, not with each request.
        let swept = pauses.swept;
        pauses.asked(Client::Caller(0), swept.unwrap() + SWEEP / 2);
        assert_eq!(pauses.swept, swept);
        pauses.asked(Client::Caller(0), swept.unwrap() + SWEEP);
        assert_eq!(pauses.swept, swept.map(|at| at + SWEEP));
    }
}
