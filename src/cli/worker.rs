//! `pointillist worker`: draws frames of films for daemons that share a NATS server and a store.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::Args;

use super::out::say;
use super::serve::{ServeArgs, engine_config};
use crate::engine::Engine;
use crate::farm::{Address, Store, Worker};
use crate::http::server::stop_signal;
use crate::memory;

/// Options of `pointillist worker`.
#[derive(Args, Clone, Debug)]
pub struct WorkerArgs {
    /// NATS server with JetStream, as in nats://HOST:4222; several servers of a cluster are separated by commas
    #[arg(long, env = "POINTILLIST_NATS", value_name = "URL")]
    nats: String,
    /// Credentials for the NATS server: a file of a JWT and a seed
    #[arg(long, env = "POINTILLIST_NATS_CREDENTIALS", value_name = "FILE")]
    nats_credentials: Option<PathBuf>,
    /// Certificates, in PEM form, that sign the NATS server's own; requires TLS
    #[arg(long, env = "POINTILLIST_NATS_CA", value_name = "FILE")]
    nats_ca: Option<PathBuf>,
    /// Folder, or s3://BUCKET/PREFIX, that the daemon and all workers share
    #[arg(long, env = "POINTILLIST_STORE", value_name = "FOLDER_OR_URL")]
    store: String,
    /// Cache folder for point trees [default: `pointillist` in the user's cache folder]
    #[arg(long, env = "POINTILLIST_CACHE", value_name = "FOLDER")]
    cache: Option<PathBuf>,
    /// Do not use the point tree cache, even if --cache is given
    #[arg(long, env = "POINTILLIST_NO_CACHE", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    no_cache: Option<bool>,
    /// Maximum scene data kept on the GPU, in MiB [default: as for `serve`]
    #[arg(long, env = "POINTILLIST_GPU_BUDGET_MIB", value_name = "MIB")]
    gpu_budget_mib: Option<u64>,
    /// Host memory budget for scenes, in MiB [default: as for `serve`]
    #[arg(long, env = "POINTILLIST_HOST_MEMORY_MIB", value_name = "MIB")]
    host_memory_mib: Option<u64>,
    /// Threads that encode images [default: one per core]
    #[arg(long, env = "POINTILLIST_ENCODER_THREADS", value_name = "N")]
    encoder_threads: Option<usize>,
    /// Build pipelines on first use instead of at the start
    #[arg(long, env = "POINTILLIST_NO_PRIME", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    no_prime: Option<bool>,
    /// Do not use 64-bit atomics, even if the adapter has them
    #[arg(long, env = "POINTILLIST_FORCE_32_BIT", hide = true, num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    force_32_bit: Option<bool>,
}

/// Draws frames until a signal stops the worker.
///
/// # Errors
/// A setting cannot be used, or there is no GPU adapter.
pub fn run(args: WorkerArgs) -> anyhow::Result<()> {
    memory::set_up_allocator();
    super::serve::init_log(super::serve::LogFormat::Text);
    let store = Store::open(&args.store)?;
    let folder = tempfile::Builder::new().prefix("pointillist-worker-").tempdir();
    let folder = folder.context("cannot create a folder for scenes")?;
    let root = folder.path().canonicalize().context("cannot open the folder for scenes")?;
    let settings = ServeArgs {
        cache: args.cache,
        no_cache: args.no_cache,
        gpu_budget_mib: args.gpu_budget_mib,
        host_memory_mib: args.host_memory_mib,
        encoder_threads: args.encoder_threads,
        no_prime: args.no_prime,
        force_32_bit: args.force_32_bit,
        ..ServeArgs::default()
    };
    let engine = Engine::start(engine_config(&settings, root.clone())?)?;
    let address = Address { url: args.nats, credentials: args.nats_credentials, ca: args.nats_ca };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let signal = stop_signal()?;
        let worker = Worker::new(&address, store, engine.clone(), &root).await?;
        say!("drawing frames on {} for {}", engine.adapter(), address.url);
        let stop = Arc::new(AtomicBool::new(false));
        let working = tokio::spawn(Arc::new(worker).run(stop.clone()));
        let name = signal.await;
        tracing::info!("{name}: the worker stops");
        stop.store(true, Ordering::Relaxed);
        working.await?;
        anyhow::Ok(())
    })
}
