//! What an earlier process still holds is waited for a little: one that was killed takes its time to end, and whoever starts it again does
//! not know when that is.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// How long an address or a folder that another process holds is waited for.
const PATIENCE: Duration = Duration::from_secs(3);
/// The environment variable that replaces [`PATIENCE`], in seconds.
const VARIABLE: &str = "POINTILLIST_TAKEOVER_SECONDS";
/// How often it is tried.
const TRY_EVERY: Duration = Duration::from_millis(50);

/// How long this process waits for what an earlier one still holds.
pub fn patience() -> Duration {
    let asked = std::env::var(VARIABLE).ok().and_then(|text| text.parse().ok());
    asked.map_or(PATIENCE, Duration::from_secs)
}

/// Tries until it works, or fails with something else than that somebody holds what is wanted, or `patience` is at its end.
///
/// # Errors
/// The last one of `attempt`.
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
                    tracing::info!(%error, "trying again for {seconds} seconds, should that be a process that ends");
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
        // Waiting mends nothing else.
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
