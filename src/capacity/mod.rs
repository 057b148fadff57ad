//! Planning past the machines at hand (floor 7): discrete-event simulations of a cluster that draws films, and of daemons with many clients.
//!
//! ```text
//! films     desk, pacing, roster (farm) ──runs──▶ broker ──▶ workers ──frames──▶ store ──▶ the daemon's film
//! clients   habits ──▶ consistent hash ──▶ daemon: queue, estimates (engine) ──▶ device ──▶ encoders ──▶ the client
//! ```
//!
//! The decisions are the program's own pure code; only what takes time is simulated. Costs come from measurements ([`costs`]). A simulation
//! draws its chances from a seed, and gives the same result on every machine.

pub mod clients;
pub mod costs;
pub mod events;
pub mod films;
pub mod ring;
pub mod station;

/// Returns Jain's index of fairness: 1 if all values are equal, 1/n if one of n has everything (R. Jain, D.-M. Chiu, W. Hawe, 1984). `None` for
/// no values, or if all are 0.
pub fn jain(values: &[f64]) -> Option<f64> {
    let sum: f64 = values.iter().sum();
    let squares: f64 = values.iter().map(|value| value * value).sum();
    (squares > 0.0).then(|| sum * sum / (values.len() as f64 * squares))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jains_index_is_one_for_equals_and_the_reciprocal_for_one_winner() {
        assert_eq!(jain(&[3.0; 7]), Some(1.0));
        assert_eq!(jain(&[0.0, 0.0, 5.0, 0.0]), Some(0.25));
        assert_eq!((jain(&[]), jain(&[0.0])), (None, None));
    }
}
