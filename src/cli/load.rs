//! `pointillist load`: measures throughput and latency of a server, and finds the rate at which it saturates.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Deserialize;

use super::out::{self, say};
use crate::load::knee::{Demands, SearchSettings};
use crate::load::poses::{PathKind, Poses};
use crate::load::report::{Generator, Report, three_digits};
use crate::load::request::{Connections, RequestClient};
use crate::load::run::{Event, Outcomes, Rates, RunSettings, run as run_steps};
use crate::load::schedule::Spacing;
use crate::load::streams::StreamClients;
use crate::load::thresholds::{EXIT_CODE, Thresholds};
use crate::load::wire::{SceneAnswer, Target, percent_encoded};
use crate::load::{drive::Client, plot, tally::Outcome};
use crate::plan::Given;
use crate::scene::random::SplitMix64;

/// Highest rate that a single thread can keep.
const MOST_PER_S: f64 = 200_000.0;
const DAY_S: f64 = 86_400.0;

/// Options of `pointillist load`.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "The generator sends each request when it is due, even if earlier requests are unanswered. Latency counts from that time. \
Each request has its own pose on a path around the scene or between its cameras. --streams adds streaming clients. \
A streamed pose's latency counts from when the pose was due to the first frame that shows it or a newer pose. \
A generator on the daemon's own machine takes CPU time from the daemon."
)]
pub struct LoadArgs {
    /// The server's address: http://HOST:PORT
    #[arg(value_name = "URL")]
    url: String,
    /// Folder for load.json and load.svg; created if missing
    #[arg(short, long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    #[command(flatten)]
    rates: RateArgs,
    /// Seconds to measure at each rate
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    duration: f64,
    /// Seconds of warm-up at each rate, which are not measured
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = seconds_or_none)]
    warmup: f64,
    /// Distribution of the times between requests
    #[arg(long, value_enum, default_value = "poisson")]
    spacing: Spacing,
    /// Maximum number of requests in flight, each on its own connection; requests beyond it are not sent but counted
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=60_000))]
    connections: u32,
    /// Seconds after which a request counts as timed out
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    timeout: f64,
    /// Highest 99th percentile of latency at which the server counts as keeping up, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 1000.0, value_parser = positive)]
    max_p99_ms: f64,
    /// Number of streaming clients beside the requests; each sends the poses of a path and acknowledges frames
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=10_000))]
    streams: u32,
    /// Poses that each stream sends per second
    #[arg(long, value_name = "R", default_value_t = 30.0, value_parser = pose_rate, requires = "streams")]
    pose_rate: f64,
    /// Seed of the random arrival times and poses
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// API key to send to the server
    #[arg(long, env = "POINTILLIST_KEY", hide_env_values = true, value_name = "KEY")]
    key: Option<String>,
    #[command(flatten)]
    frame: FrameArgs,
    #[command(flatten)]
    thresholds: Thresholds,
    /// Print JSON on standard output instead of the table
    #[arg(long)]
    json: bool,
}

/// Request rates to measure.
#[derive(Args, Clone, Debug)]
struct RateArgs {
    /// Requests per second [default: 10]
    #[arg(long, value_name = "R", value_parser = rate, conflicts_with_all = ["rates", "saturate"])]
    rate: Option<f64>,
    /// Rates to measure one after the other, as in 10,20,40
    #[arg(long, value_name = "R,R,…", value_delimiter = ',', value_parser = rate, conflicts_with = "saturate")]
    rates: Vec<f64>,
    /// Raise the rate until the server no longer keeps up, then narrow down the rate at which this begins (the knee)
    #[arg(long)]
    saturate: bool,
    /// First rate that --saturate tries
    #[arg(long, value_name = "R", default_value_t = 4.0, value_parser = rate, requires = "saturate")]
    first_rate: f64,
    /// Highest rate that --saturate tries
    #[arg(long, value_name = "R", default_value_t = 20_000.0, value_parser = rate, requires = "saturate")]
    max_rate: f64,
    /// Factor by which --saturate raises the rate
    #[arg(long, value_name = "F", default_value_t = 2.0, value_parser = factor, requires = "saturate")]
    factor: f64,
    /// Width of the interval around the knee at which --saturate stops, as a share of the rate
    #[arg(long, value_name = "SHARE", default_value_t = 0.08, value_parser = positive, requires = "saturate")]
    resolution: f64,
    /// Maximum number of rates that --saturate tries
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..), requires = "saturate")]
    max_steps: u32,
}

/// Parameters of the requested frames. The server checks all but the pose.
#[derive(Args, Clone, Debug)]
struct FrameArgs {
    /// Id of the scene [default: the first that is ready]
    #[arg(long, value_name = "ID")]
    scene: Option<String>,
    /// Path that the poses lie on
    #[arg(long, value_enum, default_value = "orbit")]
    poses: PathKind,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = super::frame::size)]
    size: (u32, u32),
    /// Image format
    #[arg(long, default_value = "jpeg")]
    format: String,
    /// Quality of lossy formats
    #[arg(long)]
    quality: Option<String>,
    /// Kind of image to request
    #[arg(long)]
    output: Option<String>,
    #[command(flatten)]
    settings: Given,
    /// Any other frame parameter; may be repeated
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = parameter)]
    parameters: Vec<(String, String)>,
}

fn number(text: &str, least: f64, most: f64, what: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok();
    number.filter(|n| (least..=most).contains(n)).ok_or_else(|| format!("expected {what}"))
}

fn rate(text: &str) -> Result<f64, String> {
    number(text, 0.01, MOST_PER_S, "requests per second, 0.01 to 200000")
}

/// Parses a rate of poses. Together with acknowledgements, it stays below the rate of messages that a server accepts from a
/// stream.
fn pose_rate(text: &str) -> Result<f64, String> {
    number(text, 0.01, 400.0, "poses per second, 0.01 to 400")
}

fn factor(text: &str) -> Result<f64, String> {
    number(text, 1.05, 100.0, "a factor of 1.05 to 100")
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, 1e-3, 1e9, "a number above 0")
}

fn seconds(text: &str) -> Result<f64, String> {
    number(text, 0.05, DAY_S, "seconds, at least 0.05")
}

fn seconds_or_none(text: &str) -> Result<f64, String> {
    number(text, 0.0, DAY_S, "seconds, or 0")
}

fn parameter(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected NAME=VALUE".to_owned()),
    }
}

impl FrameArgs {
    /// The query parameters besides the pose.
    fn query(&self) -> Vec<(String, String)> {
        let given = [("quality", &self.quality), ("output", &self.output)];
        let (width, height) = self.size;
        let always =
            [("w", width.to_string()), ("h", height.to_string()), ("format", self.format.clone())];
        let given = given.into_iter().filter_map(|(name, value)| Some((name, value.clone()?)));
        let named = always.into_iter().chain(given).map(|(name, value)| (name.to_owned(), value));
        named.chain(self.settings.pairs()).chain(self.parameters.iter().cloned()).collect()
    }
}

impl LoadArgs {
    fn settings(&self) -> anyhow::Result<RunSettings> {
        let RateArgs { rate, rates, saturate, .. } = &self.rates;
        let rates = match (saturate, rate, rates.is_empty()) {
            (true, ..) => Rates::Saturate(self.rates.search()?),
            (false, Some(rate), _) => Rates::Given(vec![*rate]),
            (false, None, false) => Rates::Given(rates.clone()),
            (false, None, true) => Rates::Given(vec![10.0]),
        };
        Ok(RunSettings {
            rates,
            spacing: self.spacing,
            seed: self.seed,
            warmup_s: self.warmup,
            duration_s: self.duration,
            timeout_s: self.timeout,
            connections_at_most: self.connections as usize,
            demands: Demands::new(Duration::from_secs_f64(self.max_p99_ms / 1e3)),
            streams: self.streams as usize,
            poses_per_s: self.pose_rate,
        })
    }
}

impl RateArgs {
    fn search(&self) -> anyhow::Result<SearchSettings> {
        let RateArgs { first_rate, max_rate, factor, resolution, max_steps, .. } = *self;
        ensure!(first_rate <= max_rate, "--first-rate {first_rate} is above --max-rate {max_rate}");
        Ok(SearchSettings {
            first_per_s: first_rate,
            least_per_s: 0.05_f64.min(first_rate),
            most_per_s: max_rate,
            factor,
            resolution,
            steps_at_most: max_steps,
        })
    }
}

/// Runs the load, then prints and writes the report.
///
/// # Errors
/// The server cannot be reached, refuses the scene or a parameter, or gave no frame at all; or a file cannot be written.
pub fn run(args: &LoadArgs) -> anyhow::Result<ExitCode> {
    super::local::init_log();
    let settings = args.settings()?;
    let target = Target::parse(&args.url)?;
    if let Some(folder) = &args.out {
        // Fail now rather than after minutes of load.
        std::fs::create_dir_all(folder)
            .with_context(|| format!("making the folder {}", folder.display()))?;
    }
    let runtime = tokio::runtime::Runtime::new().context("starting the async runtime")?;
    let report = runtime.block_on(measure(args, &target, settings))?;
    let json = serde_json::to_string_pretty(&report)? + "\n";
    if args.json {
        out::print(&json)?;
    } else {
        out::print(&report.to_string())?;
    }
    if let Some(folder) = &args.out {
        for (name, text) in [("load.json", &json), ("load.svg", &plot::svg(&report))] {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        }
        say!("load.json and load.svg are in {}", folder.display());
    }
    let frames: u64 = report.points.iter().map(|judged| judged.point.counts.frames).sum();
    ensure!(report.interrupted || frames > 0, "no frame arrived; the report counts the errors");
    if report.broken_thresholds.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    let count = report.broken_thresholds.len();
    say!("{count} {} broken", if count == 1 { "threshold is" } else { "thresholds are" });
    Ok(ExitCode::from(EXIT_CODE))
}

async fn measure(
    args: &LoadArgs,
    target: &Target,
    settings: RunSettings,
) -> anyhow::Result<Report> {
    let connections = Arc::new(Connections::new(target, args.key.as_deref()).await?);
    let scene = find_scene(&connections, &target.prefix, args.frame.scene.as_deref()).await?;
    let streams = Arc::new(stream_clients(args, target, &scene)?);
    let client = Arc::new(RequestClient {
        connections: connections.clone(),
        prefix: target.prefix.clone(),
        scene: scene.id.clone(),
        poses: Poses::new(args.frame.poses, &scene, args.seed)?,
        parameters: args.frame.query(),
    });
    try_once(client.as_ref(), settings.timeout_s).await?;
    streams.try_once(&connections).await?;
    let stop = Arc::new(AtomicBool::new(false));
    stop_on_interrupt(stop.clone());
    let shown = Shown::new();
    let beside = async |step| {
        let (streams, connections, stop) = (streams.clone(), connections.clone(), stop.clone());
        if streams.count == 0 { None } else { Some(streams.run(connections, step, stop).await) }
    };
    let tell = |event: Event<'_>| shown.tell(&event);
    let outcomes = run_steps(client.clone(), beside, &settings, stop.clone(), tell).await?;
    shown.bar.finish_and_clear();
    let Outcomes { points, knee, interrupted, adapter, settings: settings_used } = outcomes;
    Ok(Report {
        target: target.authority(),
        scene: scene.id,
        revision: scene.revision,
        client: if args.streams == 0 { "request" } else { "request, stream" },
        poses: args.frame.poses,
        parameters: client.parameters.clone(),
        adapter,
        settings_used,
        generator: Generator::here(),
        run: settings,
        points,
        knee,
        connections_opened: client.connections.opened(),
        interrupted,
        warnings: Vec::new(),
        thresholds: args.thresholds.clone(),
        broken_thresholds: Vec::new(),
    }
    .finish())
}

/// The streams of a run, each with its own path.
fn stream_clients(
    args: &LoadArgs,
    target: &Target,
    scene: &SceneAnswer,
) -> anyhow::Result<StreamClients> {
    let paths = 0..u64::from(args.streams);
    // These seeds differ from the seed of the requests' path.
    let seeds = paths.map(|number| SplitMix64::stream(args.seed, number + 1).next_u64());
    let poses: Result<Vec<Poses>, _> =
        seeds.map(|seed| Poses::new(args.frame.poses, scene, seed)).collect();
    Ok(StreamClients {
        count: args.streams as usize,
        poses_per_s: args.pose_rate,
        prefix: target.prefix.clone(),
        scene: scene.id.clone(),
        poses: poses?,
        parameters: args.frame.query(),
        timeout: Duration::from_secs_f64(args.timeout),
    })
}

/// The requested scene, or the first one that is ready.
async fn find_scene(
    connections: &Connections,
    prefix: &str,
    asked: Option<&str>,
) -> anyhow::Result<SceneAnswer> {
    #[derive(Deserialize)]
    struct Listed {
        id: String,
        state: String,
    }
    #[derive(Deserialize)]
    struct List {
        scenes: Vec<Listed>,
    }
    let id = match asked {
        Some(id) => id.to_owned(),
        None => {
            let list: List = connections.json(&format!("{prefix}/v1/scenes")).await?;
            let mut ready = list.scenes.into_iter().filter(|scene| scene.state == "ready");
            let first = ready.next().context("the server has no scene that is ready")?;
            let others = ready.count();
            if others > 0 {
                say!("--scene {}, the first of {} that are ready", first.id, others + 1);
            }
            first.id
        }
    };
    let path = format!("{prefix}/v1/scenes/{}", percent_encoded(&id));
    let answer: serde_json::Value = connections.json(&path).await?;
    let state = answer["state"].as_str().unwrap_or("unknown");
    ensure!(state == "ready", "scene `{id}` is not ready: it is {state}");
    serde_json::from_value(answer).with_context(|| format!("GET {path}: the answer is not a scene"))
}

/// Gets one frame before the run begins, so that a refusal shows early and one-time work is not measured.
async fn try_once(client: &RequestClient, timeout_s: f64) -> anyhow::Result<()> {
    // The server may have to build point trees first.
    let patience = Duration::from_secs_f64(timeout_s.max(120.0));
    // No request of the run has the pose of this number.
    let first = tokio::time::timeout(patience, client.frame(u64::from(u32::MAX)));
    match first.await {
        Err(_) => bail!("no first frame within {} s", patience.as_secs()),
        Ok(Outcome::Answered(answer)) => match answer.status {
            200..=299 => Ok(()),
            // The server is busy with other clients. This is to be measured, not refused.
            429 | 503 => Ok(()),
            status => {
                bail!("{}", answer.complaint.unwrap_or_else(|| format!("status {status}")))
            }
        },
        Ok(Outcome::NotConnected(why) | Outcome::BrokenOff(why)) => bail!("no first frame: {why}"),
        Ok(Outcome::TimedOut | Outcome::NotSent) => bail!("no first frame"),
    }
}

/// A first interrupt ends the run after the requests in flight, a second one ends the program.
fn stop_on_interrupt(stop: Arc<AtomicBool>) {
    tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            stop.store(true, Ordering::Relaxed);
            if tokio::signal::ctrl_c().await.is_ok() {
                std::process::exit(130);
            }
        }
    });
}

/// Shows progress: a bar on a terminal, and a line for each step everywhere.
struct Shown {
    bar: ProgressBar,
}

impl Shown {
    fn new() -> Self {
        let bar = ProgressBar::new(1000);
        if !std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} %") {
            bar.set_style(style);
        }
        Self { bar }
    }

    fn tell(&self, event: &Event<'_>) {
        match event {
            Event::Began { rate_per_s, sends_for } => {
                self.bar.set_message(format!("{}/s", three_digits(*rate_per_s)));
                self.bar.set_position(0);
                self.follow(*sends_for);
            }
            Event::Ended(point) if std::io::stderr().is_terminal() => {
                self.bar.println(point.line());
            }
            Event::Ended(point) => say!("{}", point.line()),
        }
    }

    /// Advances the bar for a time of `length`.
    fn follow(&self, length: Duration) {
        const TICK: Duration = Duration::from_millis(100);
        if self.bar.is_hidden() {
            return;
        }
        let (bar, began) = (self.bar.clone(), Instant::now());
        tokio::spawn(async move {
            while began.elapsed() < length && !bar.is_finished() {
                tokio::time::sleep(TICK).await;
                let share = began.elapsed().as_secs_f64() / length.as_secs_f64();
                bar.set_position((share.min(1.0) * 1000.0) as u64);
            }
        });
    }
}

#[cfg(test)]
mod tests;
