//! Thresholds for scripts and CI: if a run exceeds one, the program ends with [`EXIT_CODE`].

use clap::Args;
use serde::Serialize;

use super::report::{Report, ms, three_digits};
use super::tally::Point;

/// Exit code of a run that was measured and exceeded a threshold.
pub const EXIT_CODE: u8 = 3;

/// Thresholds of a run; every measured rate is checked against all given thresholds.
#[derive(Args, Clone, Debug, Default, PartialEq, Serialize)]
#[command(next_help_heading = "Thresholds (a broken one ends the program with exit code 3)")]
pub struct Thresholds {
    /// Fail if the 95th percentile of latency is above this many milliseconds, or falls among unanswered requests
    #[arg(long, value_name = "MS", value_parser = milliseconds)]
    pub fail_p95_ms: Option<f64>,
    /// Fail if the 99th percentile of latency is above this many milliseconds, or falls among unanswered requests
    #[arg(long, value_name = "MS", value_parser = milliseconds)]
    pub fail_p99_ms: Option<f64>,
    /// Fail if a larger share of the requests is never answered: a share such as 0.01 or 1%; 0 allows none
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub fail_lost: Option<f64>,
    /// Fail if a larger share of the requests is refused with 429 or 503
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub fail_refused: Option<f64>,
    /// Fail if a larger share of the requests gets no frame: unanswered, refused, or answered with another status
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub fail_errors: Option<f64>,
    /// Fail if fewer frames arrive than this share of the requested rate
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub fail_achieved: Option<f64>,
    /// Fail if --saturate finds that the server keeps up with fewer requests per second than this
    #[arg(long, value_name = "R", value_parser = rate, requires = "saturate", conflicts_with_all = ["rate", "rates"])]
    pub fail_knee: Option<f64>,
}

fn parsed(text: &str, unit: f64, most: f64) -> Option<f64> {
    let number = text.trim().parse::<f64>().ok()? / unit;
    (0.0..=most).contains(&number).then_some(number)
}

fn milliseconds(text: &str) -> Result<f64, String> {
    parsed(text, 1.0, 1e9).ok_or_else(|| "expected milliseconds, as in 250".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    parsed(text, 1.0, 1e9).ok_or_else(|| "expected requests per second, as in 40".to_owned())
}

fn share(text: &str) -> Result<f64, String> {
    let found = match text.trim().strip_suffix('%') {
        Some(percent) => parsed(percent, 100.0, 1.0),
        None => parsed(text, 1.0, 1.0),
    };
    found.ok_or_else(|| {
        "expected a share from 0 to 1, as in 0.01, or a percentage, as in 1%".to_owned()
    })
}

impl Thresholds {
    /// A message for each threshold that the report exceeds.
    pub fn broken(&self, report: &Report) -> Vec<String> {
        let mut broken = Vec::new();
        // A search exceeds the server's capacity on purpose: this is how it finds the knee.
        if report.knee.is_none() {
            broken.extend(report.points.iter().flat_map(|judged| self.broken_at(&judged.point)));
        }
        if let (Some(least), Some(knee)) = (self.fail_knee, &report.knee)
            && knee.keeps_up_to_per_s.unwrap_or_default() < least
        {
            let found = knee
                .keeps_up_to_per_s
                .map_or("no rate".to_owned(), |rate| format!("{}/s", three_digits(rate)));
            broken.push(format!(
                "the server keeps up with {found}, and --fail-knee is {}/s",
                three_digits(least)
            ));
        }
        broken
    }

    fn broken_at(&self, point: &Point) -> Vec<String> {
        let at = format!("at {}/s", three_digits(point.rate_per_s));
        let mut broken = Vec::new();
        let percentiles = [
            ("p95", "--fail-p95-ms", self.fail_p95_ms, point.latency.p95_ns),
            ("p99", "--fail-p99-ms", self.fail_p99_ms, point.latency.p99_ns),
        ];
        for (name, flag, most_ms, found_ns) in percentiles {
            let Some(most_ms) = most_ms else { continue };
            // Without a single frame there is no percentile, and every bound is exceeded.
            if found_ns.is_none_or(|found_ns| found_ns as f64 / 1e6 > most_ms) {
                let found = found_ns.map_or("lost".to_owned(), |_| format!("{} ms", ms(found_ns)));
                broken.push(format!("{at} {name} is {found}, and {flag} is {most_ms}"));
            }
        }
        let (counts, all) = (&point.counts, point.counts.all().max(1) as f64);
        let shares = [
            ("lost", "--fail-lost", self.fail_lost, counts.lost()),
            ("refused", "--fail-refused", self.fail_refused, counts.refused),
            (
                "without a frame",
                "--fail-errors",
                self.fail_errors,
                counts.lost() + counts.refused + counts.failed,
            ),
        ];
        for (what, flag, most, found) in shares {
            if let Some(most) = most
                && found as f64 > most * all
            {
                let percent = 100.0 * found as f64 / all;
                broken.push(format!(
                    "{at} {found} of {all} requests are {what} ({percent:.2} %), and {flag} is {} %",
                    100.0 * most
                ));
            }
        }
        if let Some(least) = self.fail_achieved
            && point.throughput_per_s < least * point.rate_per_s
        {
            broken.push(format!(
                "{at} {} frames/s arrive, and --fail-achieved is {} % of the rate",
                three_digits(point.throughput_per_s),
                100.0 * least
            ));
        }
        broken
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::{point, report};
    use super::*;

    fn broken(thresholds: Thresholds, requests: u64, frames: u64) -> Vec<String> {
        let mut report = report(vec![point(requests, frames)]);
        report.knee = None;
        thresholds.broken(&report)
    }

    #[test]
    fn each_threshold_has_its_figure() {
        assert_eq!(broken(Thresholds::default(), 40, 10), [] as [String; 0]);
        // 40 frames that take 1 to 40 ms.
        let p99 = |ms| Thresholds { fail_p99_ms: Some(ms), ..Thresholds::default() };
        assert_eq!(broken(p99(50.0), 40, 40), [] as [String; 0]);
        let found = broken(p99(20.0), 40, 40);
        assert!(
            found[0].starts_with("at 40.0/s p99 is ") && found[0].ends_with("--fail-p99-ms is 20"),
            "{found:?}"
        );
        // 10 frames; of the other 30 requests, half are lost and half are refused.
        assert!(broken(p99(1000.0), 40, 10)[0].contains("p99 is lost"));
        let lost = |share| Thresholds { fail_lost: Some(share), ..Thresholds::default() };
        assert_eq!(broken(lost(0.375), 40, 10), [] as [String; 0]);
        assert!(broken(lost(0.37), 40, 10)[0].contains("15 of 40 requests are lost (37.50 %)"));
        assert!(broken(lost(0.0), 40, 40).is_empty(), "none is lost");
        let refused = Thresholds { fail_refused: Some(0.1), ..Thresholds::default() };
        assert!(broken(refused, 40, 10)[0].contains("15 of 40 requests are refused"));
        let errors = Thresholds { fail_errors: Some(0.7), ..Thresholds::default() };
        assert!(broken(errors, 40, 10)[0].contains("30 of 40"));
        let achieved = Thresholds { fail_achieved: Some(0.5), ..Thresholds::default() };
        assert!(broken(achieved.clone(), 40, 40).is_empty());
        assert!(broken(achieved, 40, 10)[0].contains("--fail-achieved is 50 %"));
    }

    #[test]
    fn a_search_is_held_against_its_knee_alone() {
        let thresholds = |least| Thresholds {
            fail_p99_ms: Some(1.0),
            fail_knee: Some(least),
            ..Thresholds::default()
        };
        let report = report(vec![point(40, 10)]);
        assert!(thresholds(80.0).broken(&report).is_empty());
        assert!(thresholds(81.0).broken(&report)[0].contains("keeps up with 80.0/s"));
    }

    #[test]
    fn shares_and_percentages() {
        assert_eq!((share("0.01"), share("1%"), share("0")), (Ok(0.01), Ok(0.01), Ok(0.0)));
        for bad in ["2", "101%", "-1", "nan", ""] {
            assert!(share(bad).is_err(), "{bad}");
        }
    }
}
