//! Parts that the benches share: reports, files to draw, the peer, the engine and the daemon.
//!
//! The machine may be busy with other work, so every figure is a median over repeats after a warm-up, and what
//! is compared is timed in turns: one frame of the one, one of the other.
#![allow(dead_code, reason = "each bench uses its part")]

pub mod client;
pub mod daemon;
pub mod drawing;
pub mod files;
pub mod gaussians;
pub mod peer;
pub mod report;
pub mod shots;
pub mod solid;
pub mod stream;

use std::path::PathBuf;

/// Results and generated files.
pub fn folder() -> PathBuf {
    PathBuf::from("target/bench")
}

/// A smoke check: tiny files, few repeats; its figures mean nothing.
pub fn is_quick() -> bool {
    std::env::var("BENCH_QUICK").is_ok_and(|value| !value.is_empty() && value != "0")
}

/// `full`, or `quick` in a smoke check.
pub fn pick<T>(full: T, quick: T) -> T {
    if is_quick() { quick } else { full }
}

/// The value in the middle; of an even number, the mean of the two. `NaN` of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.get(sorted.len().saturating_sub(1) / 2), sorted.get(sorted.len() / 2)) {
        (Some(low), Some(high)) => 0.5 * (low + high),
        _ => f64::NAN,
    }
}

/// How many times `slow` is `fast`, for what was timed in turns: the median over the pairs, which a load that comes and goes
/// during the run spares.
pub fn median_ratio(slow: &[f64], fast: &[f64]) -> f64 {
    median(&slow.iter().zip(fast).map(|(slow, fast)| slow / fast).collect::<Vec<_>>())
}

/// Where a ratio by size falls through one for good, interpolated on logarithmic axes; `None` when it does not.
pub fn crossing_px(ratios: &[(f64, f64)]) -> Option<f64> {
    let last_fast = ratios.iter().rposition(|(_, ratio)| *ratio >= 1.0)?;
    let (low, high) = (ratios.get(last_fast)?, ratios.get(last_fast + 1)?);
    let share = low.1.ln() / (low.1.ln() - high.1.ln());
    Some((low.0.ln() + share * (high.0.ln() - low.0.ln())).exp())
}

/// The value below which `share` of all lie. `NaN` of none.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

/// Milliseconds of nanoseconds.
pub fn ms(ns: u64) -> f64 {
    ns as f64 / 1e6
}

/// Memory of a process, or of `self`, in MiB, as `/proc` tells it under `field`; `None` where it does not.
pub fn memory_mib(process: &str, field: &str) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field)?.strip_prefix(':'))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}
