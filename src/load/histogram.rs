//! A histogram of durations with logarithmic buckets: percentiles are known to half a percent from a few kilobytes, however many
//! durations were recorded (the layout of HdrHistogram, G. Tene).
//!
//! Below [`EXACT`] ns each value has a bucket. Above, every octave is cut into [`EXACT`]/2 buckets of equal width, so that a
//! bucket is at most 1/128 as wide as the values in it. Percentiles are nearest-rank, reported as the middle of their bucket.

/// Values below this are kept exactly. It is a power of two.
const EXACT: u64 = 256;
const EXACT_BITS: u32 = EXACT.trailing_zeros();

/// Counts of durations in nanoseconds, or of any other whole numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Histogram {
    buckets: Vec<u64>,
    count: u64,
    sum: u128,
    least: u64,
    most: u64,
}

/// The bucket of a value, from the number of halvings until it is below `EXACT` and the value that remains.
fn bucket_of(value: u64) -> usize {
    let halvings = (u64::BITS - value.leading_zeros()).saturating_sub(EXACT_BITS);
    (u64::from(halvings) * (EXACT / 2) + (value >> halvings)) as usize
}

/// The middle of a bucket.
fn middle_of(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < EXACT {
        return bucket;
    }
    let halvings = bucket / (EXACT / 2) - 1;
    let mantissa = bucket - halvings * (EXACT / 2);
    (mantissa << halvings) + (1 << halvings) / 2
}

impl Histogram {
    pub fn record(&mut self, value: u64) {
        let bucket = bucket_of(value);
        if bucket >= self.buckets.len() {
            self.buckets.resize(bucket + 1, 0);
        }
        if let Some(count) = self.buckets.get_mut(bucket) {
            *count += 1;
        }
        self.least = if self.count == 0 { value } else { self.least.min(value) };
        self.most = self.most.max(value);
        self.count += 1;
        self.sum += u128::from(value);
    }

    pub fn count(&self) -> u64 {
        self.count
    }

    /// The largest recorded value; `None` while nothing was recorded.
    pub fn max(&self) -> Option<u64> {
        (self.count > 0).then_some(self.most)
    }

    /// The mean; `None` while nothing was recorded.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum as f64 / self.count as f64)
    }

    /// The smallest recorded value such that at least `share` (0 to 1) of all values are no larger, to half a percent.
    pub fn quantile(&self, share: f64) -> Option<u64> {
        self.quantile_with_endless(share, 0)
    }

    /// The quantile as if `endless` more values had been recorded that are larger than every other. `None` where the quantile is
    /// one of those.
    pub fn quantile_with_endless(&self, share: f64, endless: u64) -> Option<u64> {
        let all = self.count + endless;
        // Subtract a trifle, because rounding must not turn 0.99 · 100 into more than 99.
        let rank = ((share.clamp(0.0, 1.0) * all as f64 - 1e-6).ceil() as u64).max(1);
        let mut seen = 0;
        for (bucket, count) in self.buckets.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return Some(middle_of(bucket).clamp(self.least, self.most));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::random::SplitMix64;

    #[test]
    fn buckets_are_in_order_and_narrow() {
        let mut values: Vec<u64> = (0..5000).collect();
        for octave in 12..64 {
            let power = 1u64 << octave;
            values.extend([power - 1, power, power + 1, power + power / 3, power + (power - 1)]);
        }
        values.sort_unstable();
        for pair in values.windows(2) {
            assert!(bucket_of(pair[0]) <= bucket_of(pair[1]), "{pair:?}");
        }
        for value in values {
            let middle = middle_of(bucket_of(value));
            assert_eq!(bucket_of(middle), bucket_of(value), "{value}");
            let error = middle.abs_diff(value) as f64 / value.max(1) as f64;
            assert!(error <= 1.0 / EXACT as f64, "{value} became {middle}");
            assert!(value >= EXACT || middle == value);
        }
    }

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
        assert_eq!(largest.quantile(1.0), Some(u64::MAX));
    }
}
