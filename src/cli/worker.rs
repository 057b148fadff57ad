//! `pointillist worker`: draws frames of films for servers that share a NATS server and a store.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use tempfile::TempDir;

use super::out::say;
use super::serve::{ServeArgs, engine_config};
use crate::engine::Engine;
use crate::farm::{Address, Store, Worker};
use crate::http::server::stop_signal;
use crate::lock::Locked;
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
    /// Folder, or s3://BUCKET/PREFIX, that the server and all workers share; the worker waits until the folder exists
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

const FOLDER_PREFIX: &str = "pointillist-worker-";
/// File whose lock a living worker holds.
const LOCK: &str = "lock";

/// A temporary folder for scenes. It is removed with the process, or by the next worker if the process was killed.
struct SceneFolder {
    folder: TempDir,
    /// Held while the process lives.
    _lock: Locked,
}

impl SceneFolder {
    /// Creates a folder in `parent`, and removes those of workers that were killed.
    fn new(parent: &Path) -> std::io::Result<SceneFolder> {
        for entry in std::fs::read_dir(parent)?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(FOLDER_PREFIX)
                // Opening a pipe would wait.
                && let path = entry.path().join(LOCK)
                && path.symlink_metadata().is_ok_and(|found| found.is_file())
                && let Ok(lock) = File::open(path)
                && let Ok(Some(_lock)) = Locked::attempt(lock)
                // Another user's folder cannot be removed.
                && std::fs::remove_dir_all(entry.path()).is_ok()
            {
                tracing::info!(folder = %entry.path().display(), "a killed worker's folder is removed");
            }
        }
        let folder = tempfile::Builder::new().prefix(FOLDER_PREFIX).tempdir_in(parent)?;
        // A worker that starts now sees the lock file only when it is locked.
        let unnamed = folder.path().join("lock.new");
        let lock = Locked::attempt(File::create(&unnamed)?)?;
        let lock = lock.ok_or(std::io::ErrorKind::WouldBlock)?;
        std::fs::rename(unnamed, folder.path().join(LOCK))?;
        Ok(SceneFolder { folder, _lock: lock })
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Draws frames until a signal stops the worker.
///
/// # Errors
/// A setting cannot be used, or there is no GPU adapter.
pub fn run(args: WorkerArgs) -> anyhow::Result<()> {
    memory::set_up_allocator();
    super::serve::init_log(super::serve::LogFormat::Text);
    let folder =
        SceneFolder::new(&std::env::temp_dir()).context("cannot create a folder for scenes")?;
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
    let store = args.store;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let worked = runtime.block_on(async {
        let mut signal = std::pin::pin!(stop_signal()?);
        let store = tokio::select! {
            opened = Store::wait(&store) => opened?,
            name = &mut signal => {
                tracing::info!("{name}: the worker stops");
                return anyhow::Ok(());
            }
        };
        store.try_writing().await.context("a worker must be able to write to the store")?;
        let worker = Worker::new(&address, store, engine.clone(), &root).await?;
        say!("drawing frames on {} for {}", engine.adapter(), address.without_secrets());
        let stop = Arc::new(AtomicBool::new(false));
        let working = tokio::spawn(Arc::new(worker).run(stop.clone()));
        let name = signal.await;
        tracing::info!("{name}: the worker stops");
        stop.store(true, Ordering::Relaxed);
        working.await?;
        anyhow::Ok(())
    });
    // Do not wait for a scene that is still being read.
    runtime.shutdown_timeout(Duration::from_millis(100));
    worked
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_killed_workers_are_removed() {
        let parent = tempfile::tempdir().unwrap();
        let killed = parent.path().join(format!("{FOLDER_PREFIX}killed"));
        std::fs::create_dir(&killed).unwrap();
        std::fs::write(killed.join(LOCK), "").unwrap();
        let begun = parent.path().join(format!("{FOLDER_PREFIX}begun"));
        std::fs::create_dir(&begun).unwrap();
        let foreign = parent.path().join("other");
        std::fs::create_dir(&foreign).unwrap();
        std::fs::write(foreign.join(LOCK), "").unwrap();
        let living = SceneFolder::new(parent.path()).unwrap();
        assert!(!killed.exists() && begun.exists() && foreign.exists());
        let other = SceneFolder::new(parent.path()).unwrap();
        assert!(living.path().exists() && living.path() != other.path());
        let path = living.path().to_owned();
        drop(living);
        assert!(!path.exists());
    }
}
