//! `pointillist sign`: signs addresses, which anybody may fetch without a key until they expire.

use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, bail, ensure};
use clap::Args;

use super::out;
use crate::http::access::keys::instant;
use crate::http::access::signed::{Secret, Terms, is_plain, is_signed, sign};

/// Options of `pointillist sign`.
#[derive(Args, Clone, Debug)]
pub struct SignArgs {
    /// Address to sign, or its path and query, as in /v1/scenes/town/frame?w=640&h=480
    #[arg(value_name = "ADDRESS")]
    address: String,
    /// Id of the key in the server's key file
    #[arg(long, value_name = "ID")]
    key: String,
    /// File with the key's `url-secret`, in hexadecimal digits; `-` is standard input
    #[arg(long, value_name = "FILE", allow_hyphen_values = true)]
    secret: PathBuf,
    /// Time for which the address works (90s, 15m, 12h, 30d), or its end (2030-01-31T12:00:00Z)
    #[arg(long, value_name = "TIME")]
    expires: String,
    /// Maximum pixels of a frame: width × height × parts per antialiased pixel × exposures
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    max_pixels: Option<u64>,
    /// Maximum estimated GPU time of a frame, in milliseconds
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..))]
    max_device_ms: Option<u64>,
    /// Let parameters be added to the address, as a viewer or a stream does; needs --max-pixels
    #[arg(long, requires = "max_pixels")]
    open: bool,
}

/// Prints the signed address.
///
/// # Errors
/// The address, the secret, the id or the time cannot be used.
pub fn run(args: &SignArgs) -> anyhow::Result<()> {
    let name = args.secret.display();
    let text = match args.secret.to_str() {
        Some("-") => std::io::read_to_string(std::io::stdin()).context("--secret -")?,
        _ => std::fs::read_to_string(&args.secret)
            .with_context(|| format!("--secret: cannot read {name}"))?,
    };
    let secret = Secret::from_hex(text.trim()).with_context(|| {
        format!("--secret {name}: expected at least 64 hexadecimal digits, the key's `url-secret`")
    })?;
    out::print(&format!("{}\n", signed(args, &secret, SystemTime::now())?))
}

/// Returns the signed address.
fn signed(args: &SignArgs, secret: &Secret, now: SystemTime) -> anyhow::Result<String> {
    let SignArgs { address, key, .. } = args;
    ensure!(is_plain(key), "--key {key}: expected letters, digits, `-`, `.` and `_`");
    // After the scheme and the host.
    let start = address.find("://").map_or(Some(0), |at| {
        let host = at + "://".len();
        address[host..].find('/').map(|slash| host + slash)
    });
    let local = start.map_or("", |start| &address[start..]);
    let (path, query) = local.split_once('?').unwrap_or((local, ""));
    let is_address = local.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'#');
    ensure!(
        path.starts_with("/v1/") && is_address,
        "{address}: expected the address of something below /v1/, percent-encoded and without a fragment"
    );
    ensure!(
        !is_signed(query),
        "{address}: it has a signature, or terms of one (`signed_…`), already"
    );
    let until = end(&args.expires, now)?;
    let terms = Terms {
        key: key.clone(),
        until: until.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs()),
        pixels: args.max_pixels,
        device_ms: args.max_device_ms,
        is_open: args.open,
    };
    let host = &address[..address.len() - local.len()];
    Ok(format!("{host}{path}?{}", sign(path, query, &terms, secret)))
}

/// Returns when an address stops working.
fn end(text: &str, now: SystemTime) -> anyhow::Result<SystemTime> {
    let accepted =
        "expected a duration (90s, 15m, 12h, 30d), or a time with an offset (2030-01-31T12:00:00Z)";
    let mut digits = text.chars();
    let unit = match digits.next_back() {
        Some('s') => Some(1),
        Some('m') => Some(60),
        Some('h') => Some(3600),
        Some('d') => Some(86_400),
        _ => None,
    };
    let end = match (unit, digits.as_str().parse::<u64>()) {
        (Some(unit), Ok(count)) => {
            let seconds = Duration::from_secs(count.saturating_mul(unit));
            now.checked_add(seconds).with_context(|| format!("--expires {text}: too long"))?
        }
        _ => {
            let time = text.parse().ok().and_then(|time| instant(&time));
            time.with_context(|| format!("--expires {text}: {accepted}"))?
        }
    };
    if end <= now {
        bail!("--expires {text}: this time has passed");
    }
    Ok(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(address: &str, expires: &str) -> SignArgs {
        SignArgs {
            address: address.to_owned(),
            key: "studio".to_owned(),
            secret: PathBuf::new(),
            expires: expires.to_owned(),
            max_pixels: None,
            max_device_ms: Some(50),
            open: false,
        }
    }

    #[test]
    fn whole_addresses_and_paths_get_the_same_signature() {
        let secret = Secret::from_hex(&"a".repeat(64)).unwrap();
        let now = UNIX_EPOCH + Duration::from_secs(1_000_000);
        let of = |address: &str, expires: &str| signed(&args(address, expires), &secret, now);
        let path = of("/v1/scenes/a/frame?w=9", "15m").unwrap();
        let whole = of("https://render.example:8443/v1/scenes/a/frame?w=9", "15m").unwrap();
        assert_eq!(whole, format!("https://render.example:8443{path}"));
        let start = "/v1/scenes/a/frame?w=9&signed_by=studio&signed_until=1000900&signed_ms=50&sig";
        assert!(path.starts_with(start), "{path}");
        let at = of("/v1/scenes", "1970-02-01T00:00:00Z").unwrap();
        assert!(at.contains("signed_until=2678400&"), "{at}");
        for (address, expires, word) in [
            ("https://render.example", "1h", "/v1/"),
            ("/metrics", "1h", "/v1/"),
            ("/v1/scenes#a", "1h", "fragment"),
            ("/v1/scenes/a b", "1h", "percent"),
            (path.as_str(), "1h", "already"),
            ("/v1/scenes", "soon", "duration"),
            ("/v1/scenes", "0s", "passed"),
            ("/v1/scenes", "1970-01-01T00:00:00Z", "passed"),
            ("/v1/scenes", "é", "duration"),
        ] {
            let error = of(address, expires).unwrap_err().to_string();
            assert!(error.contains(word), "{address} {expires}: {error}");
        }
    }
}
