//! The rules in force, which a reload may replace: keys, certificates and limits. Everything else in [`Settings`](super::Settings) stays as it is
//! while the process lives.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::App;
use super::access::Access;
use super::jobs::WatchLimits;
use super::journal::Notice;
use super::stream::StreamLimits;
use super::tls::Tls;
use super::upload::quota::UploadLimits;

/// The rules in force.
#[derive(Clone, Debug)]
pub struct Rules {
    pub access: Access,
    /// Certificate and key; `None` where the server speaks plain HTTP.
    pub tls: Option<Tls>,
    pub bounds: Bounds,
}

/// Limits that a reload may change. Open streams, connections and stored uploads beyond a new limit stay.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Proxies whose `X-Forwarded-For` is believed.
    pub trusted_proxies: Vec<ipnet::IpNet>,
    /// Requests per second of one address; `None` for no limit.
    pub requests_per_second_per_address: Option<f64>,
    /// Connections of one address; `None` for no limit.
    pub max_connections_per_address: Option<usize>,
    /// Largest upload in bytes, all files together.
    pub max_upload_bytes: u64,
    pub uploads: UploadLimits,
    pub streams: StreamLimits,
    pub watches: WatchLimits,
}

/// Reads something again from its files.
#[derive(Clone)]
pub struct Reader<T>(pub Arc<dyn Fn() -> Result<T, String> + Send + Sync>);

impl<T> std::fmt::Debug for Reader<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Reader")
    }
}

/// What a reload reads; `None` where there is nothing to read.
#[derive(Clone, Debug, Default)]
pub struct Reread {
    pub access: Option<Reader<Access>>,
    pub tls: Option<Reader<Tls>>,
    /// The limits, and what has changed since they were last read, each as in `max-streams 64 to 32`.
    pub bounds: Option<Reader<(Bounds, Vec<String>)>>,
}

impl App {
    /// Reads keys, certificates and limits again, and has the logs opened anew. Each is put in force by itself: if one of them cannot be
    /// used, it stays as it was. Files may be slow, so this is not for a thread of the runtime.
    pub fn reload(&self) {
        let edge = &self.settings.edge;
        for journal in edge.access_log.iter().chain(&edge.audit_log) {
            journal.reopen();
        }
        self.wants_reload.store(true, Ordering::SeqCst);
        // If another reload is reading, it reads once more.
        while self.wants_reload.load(Ordering::SeqCst)
            && let Some(_turn) = self.reloading.try_lock()
        {
            while self.wants_reload.swap(false, Ordering::SeqCst) {
                self.read_rules();
            }
        }
    }

    fn read_rules(&self) {
        let Reread { access, tls, bounds } = &self.settings.reread;
        if access.is_none() && tls.is_none() && bounds.is_none() {
            tracing::info!("no API keys, certificates or settings file to read again");
        }
        if let Some(read) = access {
            let read = read.0().map(|access| {
                let changes = self.rules().access.changes(&access);
                self.know_keys(&access);
                self.put_in_force(|rules| Rules { access, ..rules });
                changes
            });
            self.tell_reload("API keys", "keys", read);
        }
        if let Some(read) = tls {
            let read = read.0().map(|tls| {
                self.put_in_force(|rules| Rules { tls: Some(tls), ..rules });
                Vec::new()
            });
            self.tell_reload("certificates", "certificates", read);
        }
        if let Some(read) = bounds {
            let read = read.0().map(|(bounds, changes)| {
                self.put_in_force(|rules| Rules { bounds, ..rules });
                changes
            });
            self.tell_reload("limits", "limits", read);
        }
    }

    fn put_in_force(&self, change: impl FnOnce(Rules) -> Rules) {
        let mut rules = self.rules.write();
        *rules = Arc::new(change(Rules::clone(&rules)));
    }

    /// Logs the outcome of a reload of `what`, with what has changed.
    fn tell_reload(&self, what: &str, subject: &'static str, read: Result<Vec<String>, String>) {
        match &read {
            Ok(changes) if changes.is_empty() => tracing::info!("{what} read again"),
            Ok(changes) => tracing::info!("{what} read again: {}", changes.join(", ")),
            Err(error) => tracing::error!(error, "the {what} in force stay"),
        }
        self.audit(&Notice::reload(subject, read));
    }
}
