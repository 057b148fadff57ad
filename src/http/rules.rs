//! The rules in force, which a reload may replace: keys, certificates and limits. Everything else in [`Settings`](super::Settings) stays as it is
//! while the process lives.

use std::sync::Arc;

use super::access::Access;
use super::jobs::WatchLimits;
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
#[derive(Clone, Debug)]
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
    pub bounds: Option<Reader<Bounds>>,
}
