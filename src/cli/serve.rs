//! `pointillist serve`: the server.
//!
//! A setting may come from a flag, from the environment (`POINTILLIST_` and the flag's name in capitals), or from the TOML file
//! given with `--config` (the flag's name without leading dashes). The first of these that has the setting wins; otherwise it has
//! its default. [`ServeArgs`] is all three: serde reads the file into it, clap writes flags and environment over that.

use std::io::IsTerminal;
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use clap::{ArgMatches, Args, Command, FromArgMatches, ValueEnum};
use serde::Deserialize;

use self::claim::claim;
use self::edge::{bounds, edge, passed_socket, reread};
use self::farm::{farm_store, use_farm};
use self::files::{root, start_scenes};
use self::greeting::{example, greeting, tell};
use self::patience::{patience, patiently};
use self::state::{jobs_config, open_jobs};
use super::cache::CacheArgs;
use super::out::say;
use crate::assets::ReadOptions;
use crate::engine::{Engine, EngineConfig, PrimeConfig};
use crate::http::access::{Access, keys};
use crate::http::rules::Reread;
use crate::http::server::{serve, serve_monitoring};
use crate::http::{App, Settings, Uploads, push_last_metrics, push_metrics};
use crate::memory::{self, HostMemory};
use crate::scene::Up;
use crate::spelling::nearest;

mod claim;
mod edge;
mod farm;
mod files;
mod greeting;
mod patience;
mod state;

/// Longest wait for the last lines of the access and the audit log when the server stops.
const LOG_PATIENCE: Duration = Duration::from_secs(2);

/// Settings of the server; `None` marks a setting that was not given.
#[derive(Args, Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ServeArgs {
    /// Scene or asset files to serve; without --root, their common folder becomes the root
    #[arg(value_name = "FILE")]
    #[serde(skip)]
    pub files: Vec<PathBuf>,
    /// TOML file that may hold any of these settings
    #[arg(long, env = "POINTILLIST_CONFIG", value_name = "FILE")]
    #[serde(skip)]
    pub config: Option<PathBuf>,
    /// Address and port; port 0 picks a free one [default: 127.0.0.1:8080]
    #[arg(long, env = "POINTILLIST_LISTEN", value_name = "HOST:PORT")]
    pub listen: Option<String>,
    /// Folder from which scenes and their files are read; uploads are stored below it [default: scenes]
    #[arg(long, env = "POINTILLIST_ROOT", value_name = "FOLDER")]
    pub root: Option<PathBuf>,
    /// Scene or asset file to load at the start, relative to the root; may be repeated [default: every *.json directly in the root; if there is none, every asset file]
    #[arg(long, env = "POINTILLIST_SCENE", value_name = "FILE", value_delimiter = ',')]
    pub scene: Vec<PathBuf>,
    /// Up direction of point and triangle files: x, y, z, -x, -y, -z or X,Y,Z [default: guessed for each file]
    #[arg(long, env = "POINTILLIST_UP", value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Maximum scene data kept on the GPU, in MiB [default: three quarters of what the adapter can bind, at most 4096; with a CPU adapter at most an eighth of the memory]
    #[arg(long, env = "POINTILLIST_GPU_BUDGET_MIB", value_name = "MIB")]
    pub gpu_budget_mib: Option<u64>,
    /// Host memory budget for loaded scenes, loading and baking together, in MiB; loads that do not fit are refused with 413 or 507 [default: half of the memory of the machine or its cgroup]
    #[arg(long, env = "POINTILLIST_HOST_MEMORY_MIB", value_name = "MIB")]
    pub host_memory_mib: Option<u64>,
    /// Cache folder for point trees [default: `pointillist` in the user's cache folder]
    #[arg(long, env = "POINTILLIST_CACHE", value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Do not use the point tree cache, even if --cache is given
    #[arg(long, env = "POINTILLIST_NO_CACHE", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub no_cache: Option<bool>,
    /// Maximum size of the cache folder, in MiB; the least recently used trees are deleted first [default: 4096]
    #[arg(long, env = "POINTILLIST_CACHE_MAX_MIB", value_name = "MIB")]
    pub cache_max_mib: Option<u64>,
    /// Memory limit for building point trees, in MiB; larger builds use temporary files in the cache folder [default: half of the free memory]
    #[arg(long, env = "POINTILLIST_BAKE_MEMORY_MIB", value_name = "MIB")]
    pub bake_memory_mib: Option<u64>,
    /// Maximum number of queued frames; further frames are refused with 503 [default: 256]
    #[arg(long, env = "POINTILLIST_QUEUE", value_name = "N")]
    pub queue: Option<usize>,
    /// Maximum estimated GPU time of the queued frames, in seconds; further frames are refused with 503 [default: 30]
    #[arg(long, env = "POINTILLIST_QUEUE_SECONDS", value_name = "S")]
    pub queue_seconds: Option<f64>,
    /// Minimum share of GPU time reserved for job frames: 0.01 to 0.5 [default: 0.1]
    #[arg(long, env = "POINTILLIST_JOB_SHARE", value_name = "SHARE")]
    pub job_share: Option<f64>,
    /// Maximum number of frames in one submission to the GPU [default: 16]
    #[arg(long, env = "POINTILLIST_MAX_BATCH", value_name = "N")]
    pub max_batch: Option<usize>,
    /// Threads that encode job images [default: one per core]; requests and streams have one more thread each
    #[arg(long, env = "POINTILLIST_ENCODER_THREADS", value_name = "N")]
    pub encoder_threads: Option<usize>,
    /// Maximum width times height of a frame; the adapter may allow less [default: 16777216, or what a third of --host-memory-mib has room for]
    #[arg(long, env = "POINTILLIST_MAX_PIXELS", value_name = "N")]
    pub max_pixels: Option<u64>,
    /// Maximum width and height of a frame, in pixels [default: 8192]
    #[arg(long, env = "POINTILLIST_MAX_SIDE", value_name = "PX")]
    pub max_side: Option<u32>,
    /// Refuse uploads; if several servers share a root, all but one need this flag or --follow-uploads
    #[arg(long, env = "POINTILLIST_NO_UPLOADS", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub no_uploads: Option<bool>,
    /// Refuse uploads, and serve those of the server that keeps the uploads of this root; new ones are loaded within seconds
    #[arg(long, env = "POINTILLIST_FOLLOW_UPLOADS", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub follow_uploads: Option<bool>,
    /// Maximum size of one upload, in MiB [default: 4096]
    #[arg(long, env = "POINTILLIST_MAX_UPLOAD_MIB", value_name = "MIB")]
    pub max_upload_mib: Option<u64>,
    /// Maximum number of uploaded scenes; further uploads are refused with 429 [default: 1000]
    #[arg(long, env = "POINTILLIST_MAX_UPLOADS", value_name = "N")]
    pub max_uploads: Option<u64>,
    /// Maximum number of uploaded scenes per API key [default: 250]
    #[arg(long, env = "POINTILLIST_MAX_UPLOADS_PER_KEY", value_name = "N")]
    pub max_uploads_per_key: Option<u64>,
    /// Maximum disk space of all uploads, in MiB; further uploads are refused with 507 [default: 65536]
    #[arg(long, env = "POINTILLIST_UPLOAD_DISK_MIB", value_name = "MIB")]
    pub upload_disk_mib: Option<u64>,
    /// Maximum disk space of uploads per API key, in MiB [default: 16384]
    #[arg(long, env = "POINTILLIST_UPLOAD_DISK_MIB_PER_KEY", value_name = "MIB")]
    pub upload_disk_mib_per_key: Option<u64>,
    /// Maximum number of open connections [default: 1024]
    #[arg(long, env = "POINTILLIST_MAX_CONNECTIONS", value_name = "N")]
    pub max_connections: Option<usize>,
    /// Maximum wait for a frame, in seconds [default: 120]
    #[arg(long, env = "POINTILLIST_FRAME_TIMEOUT_SECONDS", value_name = "S")]
    pub frame_timeout_seconds: Option<u64>,
    /// Maximum wait for a request's head or the next piece of its body, in seconds [default: 30]
    #[arg(long, env = "POINTILLIST_READ_TIMEOUT_SECONDS", value_name = "S")]
    pub read_timeout_seconds: Option<u64>,
    /// Maximum number of open streams [default: 64]
    #[arg(long, env = "POINTILLIST_MAX_STREAMS", value_name = "N")]
    pub max_streams: Option<usize>,
    /// Maximum number of open streams per client; a client is a key, or an address where there are no keys [default: 16]
    #[arg(long, env = "POINTILLIST_MAX_STREAMS_PER_CLIENT", value_name = "N")]
    pub max_streams_per_client: Option<usize>,
    /// Seconds after which a stream is closed if its client sends nothing, or an `mjpeg` if its client reads nothing [default: 60]
    #[arg(long, env = "POINTILLIST_STREAM_IDLE_SECONDS", value_name = "S")]
    pub stream_idle_seconds: Option<u64>,
    /// File of API keys: TOML with limits of each key if its name ends in `.toml`, otherwise one `name scope sha256hex` per line; scopes are read, write and admin
    #[arg(long, env = "POINTILLIST_API_KEYS", value_name = "FILE")]
    pub api_keys: Option<PathBuf>,
    /// Allow a --listen address other than loopback without API keys
    #[arg(long, env = "POINTILLIST_INSECURE", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub insecure: Option<bool>,
    /// Origin whose pages may read answers (`https://app.example`, or `*`); may be repeated
    #[arg(long, env = "POINTILLIST_CORS_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    pub cors_origin: Vec<String>,
    /// Address or range of a proxy whose X-Forwarded-For is believed (`10.0.0.0/8`); may be repeated
    #[arg(long, env = "POINTILLIST_TRUSTED_PROXIES", value_name = "CIDR", value_delimiter = ',')]
    pub trusted_proxies: Vec<String>,
    /// Maximum number of requests per second from one address; bursts may last two seconds, further requests are refused with 429 [default: no limit]
    #[arg(long, env = "POINTILLIST_REQUESTS_PER_SECOND_PER_ADDRESS", value_name = "N")]
    pub requests_per_second_per_address: Option<f64>,
    /// Maximum number of open connections from one address (IPv6: from one /64 network); trusted proxies are exempt [default: no limit]
    #[arg(long, env = "POINTILLIST_MAX_CONNECTIONS_PER_ADDRESS", value_name = "N")]
    pub max_connections_per_address: Option<usize>,
    /// Certificates for TLS, in PEM form, the server's own first; needs --tls-key
    #[arg(long, env = "POINTILLIST_TLS_CERT", value_name = "FILE")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, in PEM form
    #[arg(long, env = "POINTILLIST_TLS_KEY", value_name = "FILE")]
    pub tls_key: Option<PathBuf>,
    /// Serve /metrics, /healthz and /readyz on this address too, without keys and TLS, and /metrics nowhere else
    #[arg(long, env = "POINTILLIST_METRICS_LISTEN", value_name = "HOST:PORT")]
    pub metrics_listen: Option<String>,
    /// File to which each request is appended as a line of JSON; `-` is standard output
    #[arg(long, env = "POINTILLIST_ACCESS_LOG", value_name = "FILE", allow_hyphen_values = true)]
    pub access_log: Option<PathBuf>,
    /// File to which each change, reload and refused key is appended as a line of JSON; `-` is standard output
    #[arg(long, env = "POINTILLIST_AUDIT_LOG", value_name = "FILE", allow_hyphen_values = true)]
    pub audit_log: Option<PathBuf>,
    /// OpenTelemetry collector to which traces of requests and metrics are sent by OTLP over HTTP, as in http://127.0.0.1:4318
    #[arg(long, env = "POINTILLIST_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
    /// Folder for jobs and their frames; each server needs its own [default: `pointillist` in the user's state folder]
    #[arg(long, env = "POINTILLIST_STATE", value_name = "FOLDER")]
    pub state: Option<PathBuf>,
    /// Accept no jobs, even if --state is given
    #[arg(long, env = "POINTILLIST_NO_JOBS", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub no_jobs: Option<bool>,
    /// Maximum number of queued and running jobs; further jobs, and more than half of them of one API key, are refused with 429 [default: 64]
    #[arg(long, env = "POINTILLIST_JOB_QUEUE", value_name = "N")]
    pub job_queue: Option<usize>,
    /// Maximum number of jobs whose frames are drawn at the same time; they share the jobs' GPU time [default: 4]
    #[arg(long, env = "POINTILLIST_JOB_RUNNERS", value_name = "N")]
    pub job_runners: Option<usize>,
    /// Maximum disk space of all jobs, in MiB [default: 10240]
    #[arg(long, env = "POINTILLIST_JOB_DISK_MIB", value_name = "MIB")]
    pub job_disk_mib: Option<u64>,
    /// Maximum number of open answers that follow jobs (`events` and `multipart`) [default: 256]
    #[arg(long, env = "POINTILLIST_MAX_WATCHERS", value_name = "N")]
    pub max_watchers: Option<usize>,
    /// Maximum number of open answers that follow jobs, per client [default: 32]
    #[arg(long, env = "POINTILLIST_MAX_WATCHERS_PER_CLIENT", value_name = "N")]
    pub max_watchers_per_client: Option<usize>,
    /// Seconds after which an answer that follows a job ends, and the client has to reconnect [default: 3600]
    #[arg(long, env = "POINTILLIST_WATCH_SECONDS", value_name = "S")]
    pub watch_seconds: Option<u64>,
    /// Seconds for which an ended job is kept, and for which a job waits for its scene [default: 604800, a week]
    #[arg(long, env = "POINTILLIST_JOB_TTL_SECONDS", value_name = "S")]
    pub job_ttl_seconds: Option<u64>,
    /// NATS server with JetStream, as in nats://HOST:4222: `pointillist worker` processes draw the frames of jobs, this server draws none of them; needs --store
    #[arg(long, env = "POINTILLIST_NATS", value_name = "URL")]
    pub nats: Option<String>,
    /// Credentials for the NATS server: a file of a JWT and a seed
    #[arg(long, env = "POINTILLIST_NATS_CREDENTIALS", value_name = "FILE")]
    pub nats_credentials: Option<PathBuf>,
    /// Certificates, in PEM form, that sign the NATS server's own; requires TLS
    #[arg(long, env = "POINTILLIST_NATS_CA", value_name = "FILE")]
    pub nats_ca: Option<PathBuf>,
    /// Folder, or s3://BUCKET/PREFIX, that this server and all workers share
    #[arg(long, env = "POINTILLIST_STORE", value_name = "FOLDER_OR_URL")]
    pub store: Option<String>,
    /// Seconds to keep serving after SIGTERM while /readyz answers 503, so that load balancers notice [default: 0]
    #[arg(long, env = "POINTILLIST_DRAIN_DELAY", value_name = "S")]
    pub drain_delay: Option<u64>,
    /// Maximum time for answers in flight to finish after SIGTERM, in seconds [default: 20]
    #[arg(long, env = "POINTILLIST_DRAIN_SECONDS", value_name = "S")]
    pub drain_seconds: Option<u64>,
    /// Format of the log on standard error [default: text]
    #[arg(long, env = "POINTILLIST_LOG_FORMAT", value_name = "FORMAT")]
    pub log_format: Option<LogFormat>,
    /// Build pipelines on first use instead of at the start
    #[arg(long, env = "POINTILLIST_NO_PRIME", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub no_prime: Option<bool>,
    /// Do not use 64-bit atomics, even if the adapter has them
    #[arg(long, env = "POINTILLIST_FORCE_32_BIT", hide = true, num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub force_32_bit: Option<bool>,
}

/// Flags and environment, before they are written over a file's settings.
#[derive(Clone, Debug)]
pub struct Given(ArgMatches);

impl Args for Given {
    fn augment_args(command: Command) -> Command {
        ServeArgs::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        ServeArgs::augment_args_for_update(command)
    }
}

impl FromArgMatches for Given {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Given, clap::Error> {
        Ok(Given(matches.clone()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0.clone_from(matches);
        Ok(())
    }
}

impl Given {
    /// The settings of a file, with those that are given in their place.
    fn over(&self, mut file: ServeArgs) -> anyhow::Result<ServeArgs> {
        file.update_from_arg_matches(&self.0)?;
        Ok(file)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    Text,
    Json,
}

/// Runs the server until a signal stops it.
///
/// # Errors
/// A setting cannot be used, the address is in use, there is no GPU adapter, or none of the scenes given with `--scene` loads.
pub fn run(given: Given) -> anyhow::Result<()> {
    memory::set_up_allocator();
    let args = with_file(&given)?;
    init_log(args.log_format.unwrap_or(LogFormat::Text));
    let root = root(&args)?;
    let passed = passed_socket()?;
    let address = match &passed {
        Some(listener) => listener.local_addr().context("the socket that systemd passes")?,
        None => listen_address("listen", args.listen.as_deref().unwrap_or("127.0.0.1:8080"))?,
    };
    let monitoring = args.metrics_listen.as_deref();
    let monitoring = monitoring.map(|text| listen_address("metrics-listen", text)).transpose()?;
    let access = access(&args, address)?;
    let is_tls = args.tls_cert.is_some();
    let has_keys = matches!(access, Access::Keys(_));
    let settings = settings(&args, root.clone(), access)?;
    let settings = Settings { reread: reread(given, &args, address), ..settings };
    let start = start_scenes(&args, &root)?;
    let jobs_config = jobs_config(&args)?;
    let farm = farm_store(&args)?;
    let is_taken = |error: &std::io::Error| error.kind() == std::io::ErrorKind::AddrInUse;
    let bind = |option: &str, address: SocketAddr| {
        patiently(patience(), is_taken, || TcpListener::bind(address))
            .with_context(|| format!("--{option}: cannot listen on {address}"))
    };
    if address.port() != 0 && monitoring == Some(address) {
        anyhow::bail!("--metrics-listen: {address} is the address of --listen; give another port");
    }
    let listener = passed.map_or_else(|| bind("listen", address), Ok)?;
    let monitoring = monitoring.map(|address| bind("metrics-listen", address)).transpose()?;
    let claim = if settings.uploads.are_kept() { claim(&root)? } else { None };
    let engine = Engine::start(engine_config(&args, root)?)?;
    tracing::info!(adapter = engine.adapter(), "engine started");

    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let jobs = open_jobs(&engine, jobs_config, args.state.is_some())?;
    let logs = [settings.edge.access_log.clone(), settings.edge.audit_log.clone()];
    let telemetry = settings.edge.telemetry.clone();
    if let (Some(farm), Ok(jobs)) = (farm, &jobs) {
        use_farm(farm, &engine, jobs, runtime.handle())?;
    }
    let app = App::new(engine, settings, jobs);
    if let Some(listener) = monitoring {
        tracing::info!(address = %listener.local_addr()?, "metrics are served");
        runtime.spawn(serve_monitoring(app.clone(), listener));
    }
    if let Some(telemetry) = &telemetry {
        runtime.spawn(push_metrics(app.clone(), telemetry.clone()));
    }
    let ready = |engine: &Engine, address| tell(&example(engine, address, is_tls, has_keys));
    let listening = |address| tell(&greeting(address, is_tls));
    let result = runtime.block_on(serve(app.clone(), listener, start, listening, ready));
    if let Some(telemetry) = &telemetry {
        let last = push_last_metrics(&app, telemetry);
        let last = runtime.block_on(async { tokio::time::timeout(LOG_PATIENCE, last).await });
        if !matches!(last, Ok(Ok(()))) {
            tracing::error!("the OpenTelemetry collector did not take the last metrics");
        }
    }
    // Do not wait for a scene that is still being read.
    runtime.shutdown_timeout(Duration::from_millis(100));
    for log in logs.iter().flatten() {
        if !log.flush(LOG_PATIENCE) {
            tracing::error!("the last lines of a log are not written");
        }
    }
    if let Some(Err(error)) = telemetry.map(|telemetry| telemetry.close(LOG_PATIENCE)) {
        tracing::error!(error, "the OpenTelemetry collector did not take the last spans");
    }
    drop(claim);
    result
}

pub(super) fn init_log(format: LogFormat) {
    use tracing_subscriber::EnvFilter;
    use tracing_subscriber::fmt::format::FmtSpan;
    let filter = EnvFilter::try_from_env("POINTILLIST_LOG").unwrap_or_else(|_| {
        EnvFilter::new("info,wgpu_core=warn,wgpu_hal=warn,naga=warn,async_nats=error")
    });
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        // Log each span's duration when it ends. There are spans only at debug level.
        .with_span_events(FmtSpan::CLOSE)
        .with_writer(std::io::stderr);
    let result = match format {
        LogFormat::Text => log.with_target(false).try_init(),
        LogFormat::Json => log.json().try_init(),
    };
    if let Err(error) = result {
        say!("cannot set up the log: {error}");
    }
}

/// Returns what is given, completed with the settings of the file that it names.
fn with_file(given: &Given) -> anyhow::Result<ServeArgs> {
    let args = given.over(ServeArgs::default())?;
    let Some(path) = &args.config else { return Ok(args) };
    let text = read_file(path)?;
    let file = parse_file(&text).with_context(|| path.display().to_string())?;
    given.over(file)
}

fn read_file(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

pub(crate) fn parse_file(text: &str) -> anyhow::Result<ServeArgs> {
    let table: toml::Table = text.parse()?;
    let known = setting_names();
    if let Some(key) = table.keys().find(|key| !known.contains(key)) {
        match nearest(key, known.iter().map(String::as_str)) {
            Some(near) => bail!("there is no setting `{key}`; did you mean `{near}`?"),
            None => bail!("there is no setting `{key}`; the settings are: {}", known.join(", ")),
        }
    }
    // Parse the text once more, so that errors show the line.
    Ok(toml::from_str(text)?)
}

/// Names of the settings that a file may have, which are the names of the flags.
fn setting_names() -> Vec<String> {
    ServeArgs::augment_args(Command::new("serve"))
        .get_arguments()
        .filter_map(|argument| argument.get_long())
        .filter(|name| *name != "config")
        .map(str::to_owned)
        .collect()
}

fn listen_address(flag: &str, text: &str) -> anyhow::Result<SocketAddr> {
    text.to_socket_addrs()
        .with_context(|| format!("--{flag} {text}: expected HOST:PORT, as in 127.0.0.1:8080"))?
        .next()
        .with_context(|| format!("--{flag} {text}: the host name has no address; give an IP address or a name that resolves"))
}

/// The access rules: the keys of the key file, or without one, access from loopback only.
fn access(args: &ServeArgs, address: SocketAddr) -> anyhow::Result<Access> {
    if let Some(path) = &args.api_keys {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("--api-keys: cannot read {}", path.display()))?;
        let keys = keys::read(path, &text)
            .map_err(|reason| anyhow::anyhow!("--api-keys: {}: {reason}", path.display()))?;
        return Ok(Access::Keys(keys));
    }
    ensure!(
        address.ip().is_loopback() || args.insecure == Some(true),
        "--listen {address} can be reached from other machines: give --api-keys FILE, or --insecure to allow access without keys"
    );
    // Behind a proxy on the same machine, requests carry the proxy's host name.
    let only_loopback = address.ip().is_loopback() && args.insecure != Some(true);
    Ok(Access::Open { cors_origins: args.cors_origin.clone(), only_loopback })
}

/// Returns `value` or the default, and fails below `least`.
fn number<T: PartialOrd + std::fmt::Display>(
    name: &str,
    value: Option<T>,
    default: T,
    least: T,
) -> anyhow::Result<T> {
    let value = value.unwrap_or(default);
    ensure!(value >= least, "--{name} {value}: must be at least {least}");
    Ok(value)
}

/// Returns how the server treats uploads.
fn uploads(args: &ServeArgs) -> anyhow::Result<Uploads> {
    match (args.no_uploads == Some(true), args.follow_uploads == Some(true)) {
        (false, false) => Ok(Uploads::Kept),
        (false, true) => Ok(Uploads::Followed),
        (true, false) => Ok(Uploads::Refused),
        (true, true) => bail!(
            "--no-uploads and --follow-uploads exclude each other: give --follow-uploads alone to serve the uploads of another server"
        ),
    }
}

fn settings(args: &ServeArgs, root: PathBuf, access: Access) -> anyhow::Result<Settings> {
    for origin in &args.cors_origin {
        let fine = origin == "*" || (origin.contains("://") && !origin.ends_with('/'));
        ensure!(fine, "--cors-origin {origin}: expected an origin such as https://app.example");
    }
    let seconds =
        |name, value, default, least| number(name, value, default, least).map(Duration::from_secs);
    Ok(Settings {
        root,
        access,
        cors_origins: args.cors_origin.clone(),
        max_connections: number("max-connections", args.max_connections, 1024, 1)?,
        frame_timeout: seconds("frame-timeout-seconds", args.frame_timeout_seconds, 120, 1)?,
        read_timeout: seconds("read-timeout-seconds", args.read_timeout_seconds, 30, 1)?,
        drain: seconds("drain-seconds", args.drain_seconds, 20, 0)?,
        drain_delay: seconds("drain-delay", args.drain_delay, 0, 0)?,
        uploads: uploads(args)?,
        bounds: bounds(args)?,
        reread: Reread::default(),
        edge: edge(args)?,
    })
}

pub(super) fn engine_config(args: &ServeArgs, root: PathBuf) -> anyhow::Result<EngineConfig> {
    let memory_mib = args.host_memory_mib.map(|mib| number("host-memory-mib", Some(mib), 1, 1));
    let memory_bytes = memory_mib.transpose()?.map(|mib| mib.saturating_mul(1 << 20));
    let memory_bytes = memory_bytes.unwrap_or_else(memory::default_budget);
    let default = EngineConfig::within(root.clone(), memory_bytes);
    let cache = CacheArgs {
        cache: args.cache.clone(),
        no_cache: args.no_cache,
        cache_max_mib: args.cache_max_mib,
        bake_memory_mib: args.bake_memory_mib,
    };
    let queue_s = number("queue-seconds", args.queue_seconds, 30.0, 0.1)?;
    let queue_time = Duration::try_from_secs_f64(queue_s)
        .with_context(|| format!("--queue-seconds {queue_s}: too many"))?;
    let job_share = number("job-share", args.job_share, default.job_share, 0.01)?;
    ensure!(job_share <= 0.5, "--job-share {job_share}: must be at most 0.5");
    let budget_mib = args.gpu_budget_mib.map(|mib| number("gpu-budget-mib", Some(mib), 1, 1));
    let bake_cache = cache.open()?;
    let prime = (args.no_prime != Some(true)).then(|| PrimeConfig {
        folder: bake_cache.as_ref().map(|cache| cache.folder().to_path_buf()),
        common: true,
    });
    Ok(EngineConfig {
        memory: HostMemory::new(memory_bytes),
        may_draw_in_full: true,
        read: ReadOptions { root: Some(root), ..ReadOptions::default() },
        gpu_budget_bytes: budget_mib.transpose()?.map(|mib| mib.saturating_mul(1 << 20)),
        bake_cache,
        prime,
        queue_capacity: number("queue", args.queue, default.queue_capacity, 1)?,
        queue_time,
        job_share,
        max_batch: number("max-batch", args.max_batch, default.max_batch, 1)?,
        encoder_threads: number(
            "encoder-threads",
            args.encoder_threads,
            default.encoder_threads,
            1,
        )?,
        max_pixels: number("max-pixels", args.max_pixels, default.max_pixels, 1)?,
        max_side: number("max-side", args.max_side, default.max_side, 1)?,
        force_32_bit: args.force_32_bit == Some(true),
        up: args.up.map(|Up(up)| up),
        ..default
    })
}

#[cfg(test)]
mod tests;
