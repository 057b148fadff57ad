//! Estimates the device time of frames from measurements of similar frames. Pure: the caller passes the measurements.
//!
//! ```text
//! same kind, same size          mean of its last frames
//! same kind, another size       mean of the kind, half of it in proportion to the pixels, but not much for each
//! unknown                       mean of all frames
//! ```
//!
//! A kind is a scene together with the settings that decide how it is drawn. Means are exponentially weighted: about the last
//! four frames decide, and the first measurement is taken as it is.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

/// Estimate before anything was measured.
const FIRST_NS: f64 = 20e6;
/// Weight of a new measurement in its mean.
const WEIGHT: f64 = 0.25;
/// Largest number of entries in either table; a full table drops the half with the oldest measurements.
const MOST_KINDS: usize = 1024;
/// Largest cost of an additional pixel, until it was measured.
const MOST_PIXEL_NS: f64 = 100.0;
/// Smallest cost of a frame.
const LEAST_NS: u64 = 1000;

/// Kind and size of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CostKey {
    /// Hash of the scene and the settings.
    pub kind: u64,
    pub pixels: u64,
}

#[derive(Clone, Copy, Debug)]
struct Mean {
    ns: f64,
    pixels: f64,
    /// Number of the last measurement.
    at: u64,
}

impl Mean {
    fn fold(&mut self, ns: f64, pixels: f64, at: u64) {
        self.ns += WEIGHT * (ns - self.ns);
        self.pixels += WEIGHT * (pixels - self.pixels);
        self.at = at;
    }
}

/// Measured costs of frames.
#[derive(Debug)]
pub struct Costs {
    sizes: HashMap<CostKey, Mean>,
    kinds: HashMap<u64, Mean>,
    all: Option<Mean>,
    /// Elapsed time per nanosecond of estimated device time, while there is enough to do.
    pace: f64,
    measured: u64,
}

impl Default for Costs {
    fn default() -> Self {
        Self { sizes: HashMap::new(), kinds: HashMap::new(), all: None, pace: 1.0, measured: 0 }
    }
}

impl Costs {
    /// Returns the estimated device time of a frame, in nanoseconds.
    pub fn estimate_ns(&self, key: CostKey) -> u64 {
        let pixels = key.pixels as f64;
        let scaled = |mean: &Mean| {
            let in_part = mean.ns * (0.5 + 0.5 * pixels / mean.pixels.max(1.0));
            // The time of a thumbnail hardly depends on its pixels.
            in_part.min(mean.ns + MOST_PIXEL_NS * (pixels - mean.pixels).max(0.0))
        };
        let ns = match (self.sizes.get(&key), self.kinds.get(&key.kind)) {
            (Some(size), _) => size.ns,
            (None, Some(kind)) => scaled(kind),
            (None, None) => self.all.as_ref().map_or(FIRST_NS, scaled),
        };
        (ns as u64).max(LEAST_NS)
    }

    /// Records that a frame took `ns` of device time.
    pub fn measured(&mut self, key: CostKey, ns: u64) {
        self.measured += 1;
        let (ns, pixels, at) = (ns as f64, key.pixels as f64, self.measured);
        let first = Mean { ns, pixels, at };
        fold(&mut self.sizes, key, first);
        fold(&mut self.kinds, key.kind, first);
        match &mut self.all {
            Some(all) => all.fold(ns, pixels, at),
            None => self.all = Some(first),
        }
    }

    /// Records that a batch estimated at `cost_ns` landed `took` after the previous batch, or after it was begun.
    pub fn landed(&mut self, cost_ns: u64, took: Duration) {
        if cost_ns >= LEAST_NS {
            // The clamp limits the effect of a batch that waited for a shader to be compiled.
            let pace = took.as_nanos() as f64 / cost_ns as f64;
            let pace = pace.clamp(0.5 * self.pace, 2.0 * self.pace);
            self.pace = (self.pace + WEIGHT * (pace - self.pace)).clamp(0.1, 100.0);
        }
    }

    /// Returns how long `cost_ns` of work will take.
    pub fn duration(&self, cost_ns: u64) -> Duration {
        // A pace below one means that the estimate is wrong and about to be corrected.
        Duration::from_nanos((cost_ns as f64 * self.pace.max(1.0)) as u64)
    }
}

fn fold<K: Copy + Eq + Hash>(table: &mut HashMap<K, Mean>, key: K, first: Mean) {
    if let Some(mean) = table.get_mut(&key) {
        mean.fold(first.ns, first.pixels, first.at);
        return;
    }
    if table.len() >= MOST_KINDS {
        let mut ages: Vec<u64> = table.values().map(|mean| mean.at).collect();
        let (_, middle, _) = ages.select_nth_unstable(MOST_KINDS / 2);
        let middle = *middle;
        table.retain(|_, mean| mean.at > middle);
    }
    table.insert(key, first);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn key(kind: u64, pixels: u64) -> CostKey {
        CostKey { kind, pixels }
    }

    #[test]
    fn what_is_known_best_decides() {
        let mut costs = Costs::default();
        assert_eq!(costs.estimate_ns(key(1, 100)), 20_000_000);
        costs.measured(key(1, 100), 4_000_000);
        assert_eq!(costs.estimate_ns(key(1, 100)), 4_000_000, "its own");
        assert_eq!(costs.estimate_ns(key(1, 50)), 3_000_000, "its kind's, by size");
        assert_eq!(costs.estimate_ns(key(1, 1 << 20)), 108_847_600, "by size, not beyond reason");
        assert_eq!(costs.estimate_ns(key(2, 100)), 4_000_000, "anybody's");
        costs.measured(key(1, 100), 8_000_000);
        assert_eq!(costs.estimate_ns(key(1, 100)), 5_000_000);
        costs.measured(key(2, 100), 0);
        assert_eq!(costs.estimate_ns(key(2, 100)), LEAST_NS, "nothing is free");
    }

    #[test]
    fn waits_are_in_time_that_passes() {
        let mut costs = Costs::default();
        for _ in 0..40 {
            costs.landed(1_000_000, Duration::from_millis(3));
        }
        let wait = costs.duration(10_000_000).as_secs_f64();
        assert!((wait - 0.03).abs() < 0.001, "{wait}");
        for _ in 0..40 {
            costs.landed(1_000_000, Duration::from_micros(100));
        }
        assert_eq!(costs.duration(10_000_000), Duration::from_millis(10));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, rng_seed: RngSeed::Fixed(0x51ea_0002), ..ProptestConfig::default() })]
        /// After a dozen equal frames, a twentieth of the estimate's earlier error is left, whatever was measured before.
        #[test]
        fn estimates_follow(before in prop::collection::vec(1_000u64..1_000_000_000, 0..20), now in 1_000u64..1_000_000_000) {
            let mut costs = Costs::default();
            for ns in before {
                costs.measured(key(1, 1), ns);
            }
            let wrong = costs.estimate_ns(key(1, 1)).abs_diff(now);
            for _ in 0..12 {
                costs.measured(key(1, 1), now);
            }
            prop_assert!(costs.estimate_ns(key(1, 1)).abs_diff(now) <= wrong / 20 + 1);
        }

        #[test]
        fn memory_is_bounded_and_the_latest_is_kept(keys in prop::collection::vec((0u64..4000, 1u64..9), 1..4000)) {
            let mut costs = Costs::default();
            for (kind, pixels) in keys {
                costs.measured(key(kind, pixels), 5_000);
                prop_assert!(costs.sizes.contains_key(&key(kind, pixels)));
                prop_assert!(costs.sizes.len() <= MOST_KINDS && costs.kinds.len() <= MOST_KINDS);
            }
        }
    }
}
