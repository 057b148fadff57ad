//! The result of a run as JSON, as a table and in sentences.

use std::fmt;

use comfy_table::{CellAlignment, Table, presets};
use serde::Serialize;

use super::following::StreamPoint;
use super::knee::Verdict;
use super::poses::PathKind;
use super::run::RunSettings;
use super::tally::{Percentiles, Point};
use super::thresholds::Thresholds;

/// A point of the curve with its verdict.
#[derive(Clone, Debug, Serialize)]
pub struct JudgedPoint {
    pub verdict: Verdict,
    #[serde(flatten)]
    pub point: Point,
}

/// The rate at which saturation begins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Knee {
    /// The highest rate that the server kept up with; `null` if it did not keep up with the lowest.
    pub keeps_up_to_per_s: Option<f64>,
    /// Whether a higher rate was tried and failed. Otherwise the limits of the search ended it.
    pub is_bounded: bool,
    /// The highest throughput of any step.
    pub most_throughput_per_s: f64,
}

/// The program that sent the requests.
#[derive(Clone, Debug, Serialize)]
pub struct Generator {
    pub version: &'static str,
    pub os: &'static str,
    pub arch: &'static str,
    pub cpus: usize,
}

impl Generator {
    /// This program on this machine.
    pub fn here() -> Self {
        Self {
            version: crate::VERSION,
            os: std::env::consts::OS,
            arch: std::env::consts::ARCH,
            cpus: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// Everything that a run reports.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub target: String,
    pub scene: String,
    pub revision: u64,
    /// Way of asking for frames: a request for each, and streams beside the requests.
    pub client: &'static str,
    pub poses: PathKind,
    /// Query parameters beside the pose.
    pub parameters: Vec<(String, String)>,
    /// The adapter of the server and the settings as it understood them, from the first receipt.
    pub adapter: Option<String>,
    pub settings_used: serde_json::Value,
    pub generator: Generator,
    pub run: RunSettings,
    /// Points in order of their rates.
    pub points: Vec<JudgedPoint>,
    pub knee: Option<Knee>,
    pub connections_opened: u64,
    pub interrupted: bool,
    /// Facts that make these figures less reliable.
    pub warnings: Vec<String>,
    /// The thresholds of the run, and a message for each one that was exceeded.
    pub thresholds: Thresholds,
    pub broken_thresholds: Vec<String>,
}

/// A time in milliseconds, with three digits.
pub fn ms(ns: Option<u64>) -> String {
    let Some(ns) = ns else { return "–".to_owned() };
    three_digits(ns as f64 / 1e6)
}

/// A number with three significant digits, and with all digits before the decimal point.
pub fn three_digits(value: f64) -> String {
    match value.abs() {
        v if v >= 99.95 || v == 0.0 => format!("{value:.0}"),
        v if v >= 9.995 => format!("{value:.1}"),
        v if v >= 0.9995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

/// A percentile of latencies: `lost` where it falls among requests without an answer, or among poses that no frame followed.
fn latency_ms(latency: &Percentiles, ns: Option<u64>) -> String {
    match ns {
        None if latency.endless > 0 => "lost".to_owned(),
        ns => ms(ns),
    }
}

/// Columns of the table of streams; the first is the rate of the requests.
const STREAM_HEADER: [&str; 15] = [
    "requested/s",
    "streams",
    "poses/s",
    "frames/s",
    "p50 ms",
    "p90",
    "p99",
    "max",
    "overtaken",
    "lost",
    "scale",
    "least–most frames",
    "GPU ms",
    "queue ms",
    "MB/s",
];

fn stream_cells(rate_per_s: f64, point: &StreamPoint) -> [String; STREAM_HEADER.len()] {
    let p = &point.latency;
    [
        three_digits(rate_per_s),
        point.streams.to_string(),
        three_digits(point.poses_per_s),
        three_digits(point.frames_per_s),
        latency_ms(p, p.p50_ns),
        latency_ms(p, p.p90_ns),
        latency_ms(p, p.p99_ns),
        latency_ms(p, p.max_ns),
        point.overtaken.to_string(),
        point.lost.to_string(),
        point.scale_mean.map_or("–".to_owned(), three_digits),
        format!("{}–{}", point.least_frames, point.most_frames),
        ms(point.gpu_p50_ns),
        ms(point.queue_p50_ns),
        three_digits(point.bytes_per_s / 1e6),
    ]
}

const HEADER: [&str; 19] = [
    "requested/s",
    "sent/s",
    "frames/s",
    "p50 ms",
    "p90",
    "p95",
    "p99",
    "p99.9",
    "max",
    "frames",
    "refused",
    "lost",
    "failed",
    "MB/s",
    "GPU ms",
    "queue ms",
    "batch",
    "views",
    "",
];

impl JudgedPoint {
    fn cells(&self) -> [String; HEADER.len()] {
        let point = &self.point;
        let mean =
            |value: Option<f64>| value.map_or("–".to_owned(), |value| format!("{value:.1}"));
        let p = &point.latency;
        let latency = |ns| latency_ms(p, ns);
        [
            three_digits(point.rate_per_s),
            three_digits(point.offered_per_s),
            three_digits(point.throughput_per_s),
            latency(p.p50_ns),
            latency(p.p90_ns),
            latency(p.p95_ns),
            latency(p.p99_ns),
            latency(p.p99_9_ns),
            latency(p.max_ns),
            (point.counts.frames + point.counts.not_modified).to_string(),
            point.counts.refused.to_string(),
            point.counts.lost().to_string(),
            point.counts.failed.to_string(),
            three_digits(point.bytes_per_s / 1e6),
            ms(point.receipts.gpu_p50_ns),
            ms(point.receipts.queue_p50_ns),
            mean(point.receipts.batch_size_mean),
            mean(point.receipts.views_mean),
            self.verdict.words().to_owned(),
        ]
    }

    /// The step as one line of progress.
    pub fn line(&self) -> String {
        let point = &self.point;
        let counts = &point.counts;
        let mut line = format!(
            "{}/s requested, {}/s sent, {} frames/s achieved, p50 {}, p99 {} (ms)",
            three_digits(point.rate_per_s),
            three_digits(point.offered_per_s),
            three_digits(point.throughput_per_s),
            latency_ms(&point.latency, point.latency.p50_ns),
            latency_ms(&point.latency, point.latency.p99_ns)
        );
        for (count, what) in
            [(counts.refused, "refused"), (counts.lost(), "lost"), (counts.failed, "failed")]
        {
            if count > 0 {
                line += &format!(", {count} {what}");
            }
        }
        line = format!("{line}: {}", self.verdict.words());
        if let Some(streams) = &point.streams {
            line += &format!(
                "; {} streams: {} frames/s, pose to frame p50 {}, p99 {} (ms)",
                streams.streams,
                three_digits(streams.frames_per_s),
                latency_ms(&streams.latency, streams.latency.p50_ns),
                latency_ms(&streams.latency, streams.latency.p99_ns)
            );
        }
        line
    }
}

impl Report {
    /// Sorts the points and adds warnings and broken thresholds.
    pub fn finish(mut self) -> Self {
        self.points.sort_by(|a, b| a.point.rate_per_s.total_cmp(&b.point.rate_per_s));
        self.warnings = self.points.iter().flat_map(|judged| warnings(&judged.point)).collect();
        self.broken_thresholds = self.thresholds.clone().broken(&self);
        self
    }

    /// The scene and the parameters of its frames on one line.
    pub fn subject(&self) -> String {
        let parameters: Vec<String> =
            self.parameters.iter().map(|(name, value)| format!("{name}={value}")).collect();
        format!("{} · {}", self.scene, parameters.join(" "))
    }

    pub fn adapter(&self) -> &str {
        self.adapter.as_deref().unwrap_or("adapter unknown: no receipt was read")
    }
}

/// A generator that is later than this gets a warning.
const LATE_NS: u64 = 10_000_000;

/// Warnings about a point.
fn warnings(point: &Point) -> Vec<String> {
    let at = format!("at {}/s", three_digits(point.rate_per_s));
    let mut warnings = Vec::new();
    if let (Some(late_ns), Some(p99_ns)) = (point.begun_late_p99_ns, point.latency.p99_ns)
        && late_ns > LATE_NS
        && late_ns > p99_ns / 10
    {
        warnings.push(format!(
            "{at} the generator itself was {} ms late (p99): it needs more of a CPU, or one of its own",
            ms(Some(late_ns))
        ));
    }
    if point.counts.not_sent > 0 {
        warnings.push(format!(
            "{at} {} requests were not sent, for as many were under way as --connections allows; they count as lost",
            point.counts.not_sent
        ));
    }
    if point.receipts.coalesced > 0 {
        warnings.push(format!(
            "{at} {} frames were drawn for somebody else who asked for the same: this server had other load, or a run with the same --seed",
            point.receipts.coalesced
        ));
    }
    if let Some(failure) = &point.first_failure {
        warnings.push(format!("{at}: {failure}"));
    }
    if let Some(streams) = &point.streams {
        warnings.extend(stream_warnings(&at, streams));
    }
    warnings
}

fn stream_warnings(at: &str, streams: &StreamPoint) -> Vec<String> {
    let mut warnings = Vec::new();
    if let (Some(late_ns), Some(p99_ns)) = (streams.sent_late_p99_ns, streams.latency.p99_ns)
        && late_ns > LATE_NS
        && late_ns > p99_ns / 10
    {
        let late = ms(Some(late_ns));
        warnings
            .push(format!("{at} poses were sent {late} ms late (p99), which is in their latency"));
    }
    if streams.broken > 0 {
        warnings.push(format!(
            "{at} {} of {} streams were not opened or broke off; their poses count as lost",
            streams.broken, streams.streams
        ));
    }
    if streams.problems > 0 {
        warnings.push(format!("{at} streams told of {} problems", streams.problems));
    }
    if let Some(failure) = &streams.first_failure {
        warnings.push(format!("{at}, on a stream: {failure}"));
    }
    warnings
}

impl Report {
    /// Writes the table of streams, if there were any.
    fn fmt_streams(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let beside = self
            .points
            .iter()
            .filter_map(|judged| Some((judged.point.rate_per_s, judged.point.streams.as_ref()?)));
        let mut beside = beside.peekable();
        if beside.peek().is_none() {
            return Ok(());
        }
        let mut table = Table::new();
        table.load_style(presets::NOTHING).set_header(STREAM_HEADER);
        for (rate_per_s, point) in beside {
            table.add_row(stream_cells(rate_per_s, point));
        }
        for column in table.column_iter_mut() {
            column.set_cell_alignment(CellAlignment::Right);
        }
        writeln!(f, "streams, from when a pose was due to a frame that shows it or a newer one\n")?;
        writeln!(f, "{table}\n")
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n{}\n", self.subject(), self.adapter())?;
        let mut table = Table::new();
        table.load_style(presets::NOTHING).set_header(HEADER);
        for judged in &self.points {
            table.add_row(judged.cells());
        }
        for column in table.column_iter_mut().take(HEADER.len() - 1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        writeln!(f, "{table}\n")?;
        self.fmt_streams(f)?;
        if let Some(knee) = &self.knee {
            writeln!(f, "{knee}")?;
        }
        for warning in &self.warnings {
            writeln!(f, "! {warning}")?;
        }
        for broken in &self.broken_thresholds {
            writeln!(f, "FAILED: {broken}")?;
        }
        if self.interrupted {
            writeln!(f, "! interrupted: the step under way is left out")?;
        }
        Ok(())
    }
}

impl fmt::Display for Knee {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let most = three_digits(self.most_throughput_per_s);
        match (self.keeps_up_to_per_s, self.is_bounded) {
            (Some(rate), true) => {
                write!(f, "keeps up with {}/s; at most {most} frames/s", three_digits(rate))
            }
            (Some(rate), false) => write!(
                f,
                "keeps up with {}/s, the highest rate tried: it may reach more (--max-rate, --max-steps)",
                three_digits(rate)
            ),
            (None, _) => write!(f, "keeps up with none of these rates; at most {most} frames/s"),
        }
    }
}

#[cfg(test)]
pub mod tests;
