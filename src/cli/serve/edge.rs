//! Settings of what stands between the network and the handlers: keys, certificates, trusted proxies, limits of addresses, logs.

use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, ensure};

use super::{ServeArgs, access, number};
use crate::http::Edge;
use crate::http::access::{Reader, Reread};
use crate::http::journal::Journal;
use crate::http::{address, tls};

/// Reads the settings, opens the logs, and reads the certificate.
pub(super) fn edge(args: &ServeArgs) -> anyhow::Result<Edge> {
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
    let log = |flag: &str, path: Option<&Path>| {
        let opened = path.map(|path| {
            let journal = Journal::open(path);
            journal.with_context(|| format!("--{flag}: cannot open {}", path.display()))
        });
        anyhow::Ok(opened.transpose()?.map(Arc::new))
    };
    Ok(Edge {
        trusted_proxies,
        requests_per_second_per_address: rate,
        max_connections_per_address: connections.transpose()?,
        metrics_apart: args.metrics_listen.is_some(),
        tls: certificate(args)?,
        access_log: log("access-log", args.access_log.as_deref())?,
        audit_log: log("audit-log", args.audit_log.as_deref())?,
    })
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

/// Returns what a reload reads: keys and certificates, if there are any.
pub(super) fn reread(args: &ServeArgs, address: SocketAddr) -> Reread {
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
    }
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
