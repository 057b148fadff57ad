//! The times at which requests are due, independent of the server.
//!
//! The generator is an open loop: arrivals follow a clock, not the answers to earlier requests, like the requests of many
//! independent users. In a Poisson process the gaps between arrivals are independent and exponentially distributed, so that
//! requests come in bursts. Constant spacing leaves bursts out, and shows the server at its best.

use std::time::Duration;

use serde::Serialize;

use crate::scene::random::SplitMix64;

/// Distribution of the times between requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Spacing {
    /// Random and independent arrivals, as from many users
    Poisson,
    /// One request every 1/rate seconds
    Constant,
}

/// The times at which requests are due, counted from the beginning of a step, in order and without end.
#[derive(Clone, Debug)]
pub struct Schedule {
    rate_per_s: f64,
    spacing: Spacing,
    random: SplitMix64,
    count: u64,
    elapsed_s: f64,
}

impl Schedule {
    /// `rate_per_s` must be finite and positive. Equal seeds give equal times.
    pub fn new(rate_per_s: f64, spacing: Spacing, seed: u64) -> Self {
        Self { rate_per_s, spacing, random: SplitMix64::new(seed), count: 0, elapsed_s: 0.0 }
    }
}

impl Iterator for Schedule {
    type Item = Duration;

    fn next(&mut self) -> Option<Duration> {
        self.elapsed_s = match self.spacing {
            // A multiple of the gap: a sum of gaps would drift.
            Spacing::Constant => self.count as f64 / self.rate_per_s,
            // 1 − unit lies in (0, 1], so that the logarithm is finite.
            Spacing::Poisson => self.elapsed_s - (1.0 - self.random.unit()).ln() / self.rate_per_s,
        };
        self.count += 1;
        Duration::try_from_secs_f64(self.elapsed_s).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times_s(spacing: Spacing, rate_per_s: f64, seed: u64, count: usize) -> Vec<f64> {
        Schedule::new(rate_per_s, spacing, seed).take(count).map(|due| due.as_secs_f64()).collect()
    }

    #[test]
    fn constant_spacing_does_not_drift() {
        let times = times_s(Spacing::Constant, 30.0, 1, 30_001);
        assert_eq!(times[0], 0.0);
        assert!((times[30_000] - 1000.0).abs() < 1e-8, "{}", times[30_000]);
    }

    /// The gaps of a Poisson process of rate 50 have mean and standard deviation 1/50, and e⁻¹ of them are longer than the mean.
    #[test]
    fn poisson_gaps_are_exponential() {
        const COUNT: usize = 40_000;
        let times = times_s(Spacing::Poisson, 50.0, 7, COUNT + 1);
        let gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(gaps.iter().all(|gap| *gap >= 0.0));
        let mean = gaps.iter().sum::<f64>() / COUNT as f64;
        let variance = gaps.iter().map(|gap| (gap - mean).powi(2)).sum::<f64>() / COUNT as f64;
        let longer = gaps.iter().filter(|gap| **gap > 0.02).count() as f64 / COUNT as f64;
        assert!((mean * 50.0 - 1.0).abs() < 0.02, "{mean}");
        assert!((variance.sqrt() * 50.0 - 1.0).abs() < 0.03, "{variance}");
        assert!((longer - (-1f64).exp()).abs() < 0.01, "{longer}");
    }

    /// The number of arrivals in a second has the variance of a Poisson distribution, which is its mean.
    #[test]
    fn poisson_counts_scatter_as_they_should() {
        let mut counts = vec![0.0; 800];
        for time in times_s(Spacing::Poisson, 25.0, 3, 40_000) {
            if let Some(count) = counts.get_mut(time as usize) {
                *count += 1.0;
            }
        }
        let mean = counts.iter().sum::<f64>() / 800.0;
        let variance = counts.iter().map(|count: &f64| (count - mean).powi(2)).sum::<f64>() / 800.0;
        assert!(
            (mean - 25.0).abs() < 0.6 && (variance / mean - 1.0).abs() < 0.2,
            "{mean} {variance}"
        );
    }

    #[test]
    fn seeds_decide() {
        assert_eq!(times_s(Spacing::Poisson, 9.0, 4, 99), times_s(Spacing::Poisson, 9.0, 4, 99));
        assert_ne!(times_s(Spacing::Poisson, 9.0, 4, 99), times_s(Spacing::Poisson, 9.0, 5, 99));
    }
}
