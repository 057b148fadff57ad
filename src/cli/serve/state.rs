//! The server's state folder: its place, its limits, and locking it.

use anyhow::ensure;

use super::patience::{patience, patiently};
use super::{ServeArgs, number};
use crate::engine::Engine;
use crate::jobs::{self, Jobs, StateError};

/// Largest number of ended jobs that are kept.
const MOST_ENDED_JOBS: usize = 1000;

/// The folder and the limits of jobs, or the reason why there are no jobs.
pub(super) fn jobs_config(args: &ServeArgs) -> anyhow::Result<Result<jobs::Config, String>> {
    let mib = number("job-disk-mib", args.job_disk_mib, 10_240, 1)?;
    let ttl_seconds = number("job-ttl-seconds", args.job_ttl_seconds, 7 * 24 * 3600, 1)?;
    let most_unfinished = number("job-queue", args.job_queue, 64, 1)?;
    let drawing = number("job-runners", args.job_runners, 4, 1)?;
    ensure!(drawing <= 64, "--job-runners {drawing}: must be at most 64");
    if args.no_jobs == Some(true) {
        return Ok(Err("this server accepts no jobs (--no-jobs)".to_owned()));
    }
    let Some(folder) = args.state.clone().or_else(jobs::store::default_folder) else {
        return Ok(Err(
            "this server has no state folder for jobs: --state was not given, and neither XDG_STATE_HOME nor HOME is set"
                .to_owned(),
        ));
    };
    Ok(Ok(jobs::Config {
        folder,
        limits: jobs::Limits {
            most_unfinished,
            most: most_unfinished.saturating_add(MOST_ENDED_JOBS),
            ttl_ms: ttl_seconds.saturating_mul(1000),
            // Each of these jobs uses all cores for most of its time.
            slots: jobs::Slots { baking: 2, drawing, coding: 2 },
        },
        most_bytes: mib.saturating_mul(1 << 20),
    }))
}

/// Opens the state folder, and waits briefly for a process that is about to end. If the folder was not requested explicitly, a
/// failure only disables jobs.
pub(super) fn open_jobs(
    engine: &Engine,
    config: Result<jobs::Config, String>,
    is_asked_for: bool,
) -> anyhow::Result<Result<Jobs, String>> {
    let config = match config {
        Ok(config) => config,
        Err(reason) => return Ok(Err(reason)),
    };
    let is_held = |error: &StateError| matches!(error, StateError::Locked { .. });
    match patiently(patience(), is_held, || Jobs::open(engine.clone(), config.clone())) {
        Ok(jobs) => Ok(Ok(jobs)),
        Err(error) if is_asked_for => Err(anyhow::anyhow!("--state: {error}")),
        Err(error) => {
            tracing::warn!(%error, "jobs are disabled");
            // Clients must not learn where the server keeps its files.
            let reason = match error {
                StateError::Locked { .. } => "another running server uses the state folder",
                _ => "the state folder cannot be used; the server's log says why",
            };
            Ok(Err(reason.to_owned()))
        }
    }
}
