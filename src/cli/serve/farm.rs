//! The workers of a server that has `--nats`.

use anyhow::{Context, bail};
use tokio::runtime::Handle;

use super::ServeArgs;
use crate::engine::Engine;
use crate::farm::{Address, Farm, Store, daemon_name};
use crate::jobs::Jobs;

/// Checks the settings of workers, and opens their store.
pub(super) fn farm_store(args: &ServeArgs) -> anyhow::Result<Option<(Address, Store)>> {
    let (url, store) = match (&args.nats, &args.store) {
        (Some(url), Some(store)) => (url.clone(), store),
        (None, None) if args.nats_credentials.is_none() && args.nats_ca.is_none() => {
            return Ok(None);
        }
        (Some(_), None) => {
            bail!("--nats needs --store: a folder or s3://BUCKET/PREFIX that all workers share")
        }
        _ => {
            bail!("--store, --nats-credentials and --nats-ca need --nats: the URL of a NATS server")
        }
    };
    let (credentials, ca) = (args.nats_credentials.clone(), args.nats_ca.clone());
    Ok(Some((Address { url, credentials, ca }, Store::create(store)?)))
}

/// Has the frames of jobs drawn by workers.
pub(super) fn use_farm(
    (address, store): (Address, Store),
    engine: &Engine,
    jobs: &Jobs,
    runtime: &Handle,
) -> anyhow::Result<()> {
    let name = daemon_name(jobs.folder()).with_context(|| {
        format!(
            "--state {}: cannot read or write the file with this server's name",
            jobs.folder().display()
        )
    })?;
    let farm = Farm::new(&address, store, name, engine, runtime)?;
    tracing::info!(nats = address.without_secrets(), "workers draw the frames of jobs");
    jobs.draw_with(std::sync::Arc::new(farm));
    Ok(())
}
