//! Percentiles of durations, from a histogram of three significant digits (`hdrhistogram`, after G. Tene).

use hdrhistogram::Histogram as Counts;

/// Significant digits of the values that percentiles are.
const DIGITS: u8 = 3;

/// Counts of durations in nanoseconds, or of any other whole numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    /// `None` while nothing is recorded.
    counts: Option<Counts<u64>>,
    sum: u128,
    most: u64,
}

impl Histogram {
    pub fn record(&mut self, value: u64) {
        if self.counts.is_none() {
            // Only more than five digits would be refused.
            self.counts = Counts::new(DIGITS).ok();
        }
        if let Some(counts) = &mut self.counts {
            // The histogram grows with its values, so none is refused.
            let _ = counts.record(value);
        }
        self.sum += u128::from(value);
        self.most = self.most.max(value);
    }

    pub fn count(&self) -> u64 {
        self.counts.as_ref().map_or(0, Counts::len)
    }

    /// The largest recorded value; `None` while nothing was recorded.
    pub fn max(&self) -> Option<u64> {
        self.counts.as_ref().map(|_| self.most)
    }

    /// The mean; `None` while nothing was recorded.
    pub fn mean(&self) -> Option<f64> {
        self.counts.as_ref().map(|counts| self.sum as f64 / counts.len() as f64)
    }

    /// The smallest recorded value such that at least `share` (0 to 1) of all values are no larger, to three digits.
    pub fn quantile(&self, share: f64) -> Option<u64> {
        self.quantile_with_endless(share, 0)
    }

    /// The quantile as if `endless` more values had been recorded that are larger than every other. `None` where the quantile is
    /// one of those.
    pub fn quantile_with_endless(&self, share: f64, endless: u64) -> Option<u64> {
        let counts = self.counts.as_ref()?;
        let all = (counts.len() + endless) as f64;
        // Subtract a trifle, because rounding must not turn 0.99 · 100 into more than 99.
        let rank = (share.clamp(0.0, 1.0) * all - 1e-6).ceil().max(1.0);
        let own = counts.len() as f64;
        (rank <= own).then(|| counts.value_at_quantile((rank - 0.5) / own).min(self.most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::random::SplitMix64;

    /// Compares with nearest-rank percentiles of the sorted values, for counts from one to 20 000 and spreads up to six decades.
    #[test]
    fn percentiles_are_those_of_the_sorted_values() {
        let mut random = SplitMix64::new(11);
        for count in [1usize, 2, 3, 10, 99, 100, 101, 1000, 20_000] {
            for decades in [0.0, 0.5, 6.0] {
                let mut histogram = Histogram::default();
                let mut values: Vec<u64> = (0..count)
                    .map(|_| (1e3 * 10f64.powf(random.range(0.0, decades + 1e-9))) as u64)
                    .collect();
                values.iter().for_each(|value| histogram.record(*value));
                values.sort_unstable();
                for per_mille in [0usize, 1, 250, 500, 900, 950, 990, 999, 1000] {
                    let rank = (per_mille * count).div_ceil(1000).max(1);
                    let exact = values[rank - 1] as f64;
                    let found = histogram.quantile(per_mille as f64 / 1000.0).unwrap() as f64;
                    assert!(
                        (found / exact - 1.0).abs() <= 0.004,
                        "{count} {per_mille}: {found} {exact}"
                    );
                }
                assert_eq!(histogram.max(), values.last().copied());
                let mean = values.iter().sum::<u64>() as f64 / count as f64;
                assert!((histogram.mean().unwrap() / mean - 1.0).abs() < 1e-12);
                assert_eq!(histogram.count(), count as u64);
            }
        }
    }

    #[test]
    fn what_never_ended_is_above_everything() {
        let mut histogram = Histogram::default();
        (1..=98).for_each(|value| histogram.record(value));
        assert_eq!(histogram.quantile_with_endless(0.5, 2), Some(50));
        assert_eq!(histogram.quantile_with_endless(0.98, 2), Some(98));
        assert_eq!(histogram.quantile_with_endless(0.99, 2), None);
        assert_eq!(Histogram::default().quantile_with_endless(0.5, 3), None);
    }

    #[test]
    fn nothing_has_no_percentiles() {
        let empty = Histogram::default();
        assert_eq!((empty.quantile(0.5), empty.max(), empty.mean()), (None, None, None));
        let mut largest = Histogram::default();
        largest.record(u64::MAX);
        assert_eq!(
            largest.quantile(1.0),
            Some(u64::MAX - 1),
            "the last value that the crate tells apart"
        );
    }
}
