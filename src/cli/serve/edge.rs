//! Settings of what stands between the network and the handlers: keys, certificates, limits, logs; and what a reload does with them.

use std::collections::BTreeSet;
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, ensure};

use super::{Given, ServeArgs, access, number, parse_file, read_file};
use crate::http::journal::Journal;
use crate::http::rules::{Bounds, Reader, Reread};
use crate::http::telemetry::Telemetry;
use crate::http::{Edge, StreamLimits, UploadLimits, WatchLimits, address, tls};

/// Settings that a reload puts in force, by their flags. Changes of others need a restart.
pub(super) const RELOADED: [&str; 14] = [
    "max-connections-per-address",
    "max-streams",
    "max-streams-per-client",
    "max-upload-mib",
    "max-uploads",
    "max-uploads-per-key",
    "max-watchers",
    "max-watchers-per-client",
    "requests-per-second-per-address",
    "stream-idle-seconds",
    "trusted-proxies",
    "upload-disk-mib",
    "upload-disk-mib-per-key",
    "watch-seconds",
];

/// Reads the limits that a reload may change.
pub(super) fn bounds(args: &ServeArgs) -> anyhow::Result<Bounds> {
    let proxies = args.trusted_proxies.iter().map(|range| address::parse_range(range));
    let trusted_proxies = proxies
        .collect::<Result<Vec<_>, _>>()
        .map_err(|reason| anyhow::anyhow!("--trusted-proxies {reason}"))?;
    let rate = args.requests_per_second_per_address;
    if let Some(rate) = rate {
        let is_fine = (0.01..=100_000.0).contains(&rate);
        ensure!(is_fine, "--requests-per-second-per-address {rate}: must be from 0.01 to 100000");
    }
    let connections = args.max_connections_per_address;
    let connections =
        connections.map(|most| number("max-connections-per-address", Some(most), most, 1));
    let seconds = |name, value, default| number(name, value, default, 1).map(Duration::from_secs);
    let mib = |name, value, default| {
        number(name, value, default, 1).map(|mib: u64| mib.saturating_mul(1 << 20))
    };
    Ok(Bounds {
        trusted_proxies,
        requests_per_second_per_address: rate,
        max_connections_per_address: connections.transpose()?,
        max_upload_bytes: mib("max-upload-mib", args.max_upload_mib, 4096)?,
        uploads: UploadLimits {
            scenes: number("max-uploads", args.max_uploads, 1000, 1)?,
            scenes_per_key: number("max-uploads-per-key", args.max_uploads_per_key, 250, 1)?,
            bytes: mib("upload-disk-mib", args.upload_disk_mib, 65_536)?,
            bytes_per_key: mib("upload-disk-mib-per-key", args.upload_disk_mib_per_key, 16_384)?,
        },
        streams: StreamLimits {
            most: number("max-streams", args.max_streams, 64, 0)?,
            most_per_client: number("max-streams-per-client", args.max_streams_per_client, 16, 1)?,
            idle: seconds("stream-idle-seconds", args.stream_idle_seconds, 60)?,
        },
        watches: WatchLimits {
            most: number("max-watchers", args.max_watchers, 256, 0)?,
            most_per_client: number(
                "max-watchers-per-client",
                args.max_watchers_per_client,
                32,
                1,
            )?,
            longest: seconds("watch-seconds", args.watch_seconds, 3600)?,
        },
    })
}

/// Opens the logs, and reads the certificate.
pub(super) fn edge(args: &ServeArgs) -> anyhow::Result<Edge> {
    let log = |flag: &str, path: Option<&Path>| {
        let opened = path.map(|path| {
            let journal = Journal::open(path);
            journal.with_context(|| format!("--{flag}: cannot open {}", path.display()))
        });
        anyhow::Ok(opened.transpose()?.map(Arc::new))
    };
    Ok(Edge {
        metrics_apart: args.metrics_listen.is_some(),
        tls: certificate(args)?,
        access_log: log("access-log", args.access_log.as_deref())?,
        audit_log: log("audit-log", args.audit_log.as_deref())?,
        telemetry: args.otlp.as_deref().map(telemetry).transpose()?,
    })
}

fn telemetry(url: &str) -> anyhow::Result<Arc<Telemetry>> {
    let opened = Telemetry::open(url);
    opened.map(Arc::new).map_err(|reason| anyhow::anyhow!("--otlp {url}: {reason}"))
}

/// Reads certificate and private key, if the server has them.
fn certificate(args: &ServeArgs) -> anyhow::Result<Option<tls::Tls>> {
    match (&args.tls_cert, &args.tls_key) {
        (Some(cert), Some(key)) => tls::load(cert, key).map(Some).map_err(anyhow::Error::msg),
        (None, None) => Ok(None),
        (Some(_), None) => anyhow::bail!("--tls-cert: give its private key with --tls-key FILE"),
        (None, Some(_)) => anyhow::bail!("--tls-key: give the certificate with --tls-cert FILE"),
    }
}

/// Returns what a reload reads: keys, certificates and the file of settings, where they are given. `given` has the flags and
/// the environment alone, which no reload changes; `args` has the file's settings too.
pub(super) fn reread(given: Given, args: &ServeArgs, address: SocketAddr) -> Reread {
    fn reader<T>(read: impl Fn() -> anyhow::Result<T> + Send + Sync + 'static) -> Reader<T> {
        Reader(Arc::new(move || read().map_err(|error| format!("{error:#}"))))
    }
    Reread {
        access: args.api_keys.as_ref().map(|_| {
            let args = args.clone();
            reader(move || access(&args, address))
        }),
        tls: args.tls_cert.as_ref().map(|_| {
            let args = args.clone();
            reader(move || certificate(&args)?.context("--tls-cert"))
        }),
        bounds: args.config.clone().map(|path| {
            let table = |text: &str| text.parse::<toml::Table>().unwrap_or_default();
            let begun_with = table(&read_file(&path).unwrap_or_default());
            let last = parking_lot::Mutex::new(begun_with.clone());
            reader(move || {
                let text = read_file(&path)?;
                let file = parse_file(&text).with_context(|| path.display().to_string())?;
                let of = |file| bounds(&given.over(file)?);
                let found = of(file)?;
                let now = table(&text);
                let is_reloaded = |name: &str| RELOADED.contains(&name);
                for name in changed(&begun_with, &now).filter(|name| !is_reloaded(name)) {
                    tracing::warn!(
                        "the setting {name} has changed in the file; it needs a restart"
                    );
                }
                let last = std::mem::replace(&mut *last.lock(), now.clone());
                let is_in_force = |name: &&str| {
                    let before = with(&now, name, last.get(*name));
                    // A flag wins over the file.
                    parse_file(&before.to_string()).and_then(of).ok().as_ref() != Some(&found)
                };
                let limits = changed(&last, &now).filter(|name| is_reloaded(name));
                let told = limits.filter(is_in_force).map(|name| {
                    let [before, after] = [&last, &now].map(|table| match table.get(name) {
                        Some(value) => value.to_string(),
                        None => "its default".to_owned(),
                    });
                    format!("{name} {before} to {after}")
                });
                let changes = told.collect();
                Ok((found, changes))
            })
        }),
    }
}

/// Returns the table with another value of one setting, or without it.
fn with(table: &toml::Table, name: &str, value: Option<&toml::Value>) -> toml::Table {
    let mut table = table.clone();
    match value {
        Some(value) => drop(table.insert(name.to_owned(), value.clone())),
        None => drop(table.remove(name)),
    }
    table
}

/// Returns the names of settings that differ, in their order.
fn changed<'a>(before: &'a toml::Table, now: &'a toml::Table) -> impl Iterator<Item = &'a str> {
    let names: BTreeSet<&str> = before.keys().chain(now.keys()).map(String::as_str).collect();
    names.into_iter().filter(|name| before.get(*name) != now.get(*name))
}

/// Returns the first socket that systemd passes to this process (socket activation).
#[cfg(unix)]
pub(super) fn passed_socket() -> anyhow::Result<Option<TcpListener>> {
    let mut sockets = listenfd::ListenFd::from_env();
    sockets.take_tcp_listener(0).context("the socket that systemd passes (LISTEN_FDS)")
}

#[cfg(not(unix))]
pub(super) fn passed_socket() -> anyhow::Result<Option<TcpListener>> {
    Ok(None)
}
