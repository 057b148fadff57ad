//! Waits briefly for resources that an earlier process still holds. A killed process takes some time to end, and its successor
//! cannot know when that is.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// Time to wait for an address or a folder that another process holds.
const PATIENCE: Duration = Duration::from_secs(3);
/// The environment variable that replaces [`PATIENCE`], in seconds.
const VARIABLE: &str = "POINTILLIST_TAKEOVER_SECONDS";
/// Interval between attempts.
const TRY_EVERY: Duration = Duration::from_millis(50);

/// Time that this process waits for resources of an earlier one.
pub fn patience() -> Duration {
    let asked = std::env::var(VARIABLE).ok().and_then(|text| text.parse().ok());
    asked.map_or(PATIENCE, Duration::from_secs)
}

/// Repeats `attempt` until it succeeds, fails with an error other than `is_held`, or `patience` is over.
///
/// # Errors
/// The error of the last attempt.
pub fn patiently<T, E: Display>(
    patience: Duration,
    is_held: impl Fn(&E) -> bool,
    mut attempt: impl FnMut() -> Result<T, E>,
) -> Result<T, E> {
    let until = Instant::now() + patience;
    let mut is_told = false;
    loop {
        match attempt() {
            Err(error) if is_held(&error) && Instant::now() < until => {
                if !is_told {
                    let seconds = patience.as_secs();
                    tracing::info!(%error, "retrying for {seconds} seconds, in case another process is still shutting down");
                    is_told = true;
                }
                std::thread::sleep(TRY_EVERY);
            }
            done => return done,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_let_go_in_time_is_had() {
        let try_it = |patience_ms: u64, held: u32| {
            let mut tries = 0;
            let got = patiently(
                Duration::from_millis(patience_ms),
                |error| *error == "held",
                || {
                    tries += 1;
                    if tries <= held { Err("held") } else { Ok(tries) }
                },
            );
            (got, tries)
        };
        assert_eq!(try_it(10_000, 2), (Ok(3), 3));
        assert_eq!(try_it(0, 2), (Err("held"), 1));
        // Waiting does not help against other errors.
        let mut tries = 0;
        let other = patiently(
            PATIENCE,
            |error: &&str| *error == "held",
            || {
                tries += 1;
                Err::<(), _>("no such address")
            },
        );
        assert_eq!((other, tries), (Err("no such address"), 1));
    }
}
