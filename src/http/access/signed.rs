//! Signed addresses: who has one may `GET` it until a time, without a key.
//!
//! The holder of a key's URL secret signs an address offline (`pointillist sign`). The signature is the HMAC-SHA256 (RFC 2104) of
//! the path and of the query before it, so that nobody can change what was signed. A query is `OWN&signed_by=ID&signed_until=SECONDS`,
//! then optionally `&signed_pixels=N&signed_ms=N&signed_open=1`, then `&signature=HEX`. Terms are those from the last `signed_by` on: a
//! parameter of such a name before it is none, and no handler knows it. After the signature of an open address whoever
//! has it may add parameters; names that were signed may not come twice.
//!
//! A signed address reads what the key may read. Its requests count as the key's: they share its rates and quotas, and end with it.

use std::fmt::Write;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::http::Uri;
use ring::hmac;
use sha2::{Digest, Sha256};

use super::super::params::pairs;
use super::super::problem::{Kind, Problem};

/// Prefix of what is signed, so that a secret that is used for something else as well signs nothing here.
const PURPOSE: &str = "pointillist-url-1";
const SIGNATURE: &str = "signature";
/// Prefix of the names of terms; the first one is the key's.
const TERM: &str = "signed_";
const FIRST: &str = "signed_by=";
/// Length of the shortest secret, in bytes.
const LEAST_BYTES: usize = 32;

/// The secret with which addresses are signed.
#[derive(Clone)]
pub struct Secret {
    key: hmac::Key,
    /// Tells whether two secrets are the same.
    digest: [u8; 32],
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret")
    }
}

impl Secret {
    /// Reads a secret from hexadecimal digits, at least 64.
    pub fn from_hex(hex: &str) -> Option<Secret> {
        let bytes = bytes_of(hex)?;
        (bytes.len() >= LEAST_BYTES).then(|| Secret {
            key: hmac::Key::new(hmac::HMAC_SHA256, &bytes),
            digest: Sha256::digest(&bytes).into(),
        })
    }
}

impl Secret {
    pub fn digest(&self) -> [u8; 32] {
        self.digest
    }
}

fn bytes_of(hex: &str) -> Option<Vec<u8>> {
    if !hex.len().is_multiple_of(2) || !hex.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    let pairs = hex.as_bytes().chunks_exact(2);
    pairs.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()).collect()
}

/// Returns whether an id can be part of an address as it is.
pub fn is_plain(id: &str) -> bool {
    !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-._".contains(&byte))
}

/// What limits a request beside its key's quotas; `None` for no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Caps {
    /// Hash of the key, or of the URL secret, that let it in. Streams end when the key file has it no more.
    pub credential: Option<[u8; 32]>,
    /// Time from which it is refused, and its streams end.
    pub until: Option<SystemTime>,
    /// Pixels of a frame.
    pub pixels: Option<u64>,
    /// Estimated GPU time of a frame, in milliseconds.
    pub device_ms: Option<u64>,
}

/// What a signed address says about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Id of the key that signs.
    pub key: String,
    /// Time from which the address is refused, in seconds since 1970.
    pub until: u64,
    pub pixels: Option<u64>,
    pub device_ms: Option<u64>,
    /// Whether parameters may be added.
    pub is_open: bool,
}

impl Terms {
    pub fn caps(&self) -> Caps {
        let until = UNIX_EPOCH.checked_add(Duration::from_secs(self.until));
        // A time that the clock cannot tell has passed.
        let until = Some(until.unwrap_or(UNIX_EPOCH));
        Caps { credential: None, until, pixels: self.pixels, device_ms: self.device_ms }
    }
}

fn text(path: &str, query: &str) -> String {
    format!("{PURPOSE}\n{path}\n{query}")
}

/// Signs a path with a query, which may be empty. Returns the whole query.
pub fn sign(path: &str, query: &str, terms: &Terms, secret: &Secret) -> String {
    let Terms { key, until, pixels, device_ms, is_open } = terms;
    let mut signed = query.to_owned();
    if !query.is_empty() {
        signed.push('&');
    }
    // Writing to a string cannot fail.
    let _ = write!(signed, "signed_by={key}&signed_until={until}");
    for (name, value) in [("signed_pixels", pixels), ("signed_ms", device_ms)] {
        if let Some(value) = value {
            let _ = write!(signed, "&{name}={value}");
        }
    }
    if *is_open {
        signed.push_str("&signed_open=1");
    }
    let tag = hmac::sign(&secret.key, text(path, &signed).as_bytes());
    let _ = write!(signed, "&{SIGNATURE}=");
    for byte in tag.as_ref() {
        let _ = write!(signed, "{byte:02x}");
    }
    signed
}

/// A query that says that it is signed.
pub struct Claim<'a> {
    /// The query before the signature.
    signed: &'a str,
    signature: &'a str,
    pub terms: Terms,
    /// The query without the signature and its terms: what the handler reads.
    pub query: String,
}

/// Returns whether a query has a signature or a term of one, also where these are percent-encoded.
pub fn is_signed(query: &str) -> bool {
    let is_one = |(name, _): &(String, String)| name == SIGNATURE || name.starts_with(TERM);
    pairs(Some(query)).is_ok_and(|pairs| pairs.iter().any(is_one))
}

/// Splits a query into what is signed, the signature, and what comes behind it.
fn find(query: Option<&str>) -> Option<(&str, &str, &str)> {
    let query = query?;
    let mut start = 0;
    for part in query.split('&') {
        if let Some(value) = part.strip_prefix(SIGNATURE).and_then(|rest| rest.strip_prefix('=')) {
            let signed = query.get(..start.max(1) - 1).unwrap_or_default();
            let behind = query.get(start + part.len()..).unwrap_or_default();
            return Some((signed, value, behind.strip_prefix('&').unwrap_or_default()));
        }
        start += part.len() + 1;
    }
    None
}

impl<'a> Claim<'a> {
    /// Reads what a signed query claims. Returns `None` where the query has no signature.
    ///
    /// # Errors
    /// A term is missing, is given twice or is no number, or parameters were added to an address that is not open.
    pub fn read(query: Option<&'a str>) -> Option<Result<Claim<'a>, Problem>> {
        let (signed, signature, behind) = find(query)?;
        Some(Claim::of(signed, signature, behind))
    }

    fn of(signed: &'a str, signature: &'a str, behind: &str) -> Result<Claim<'a>, Problem> {
        let parts: Vec<&str> = signed.split('&').filter(|part| !part.is_empty()).collect();
        let first = parts.iter().rposition(|part| part.starts_with(FIRST)).unwrap_or(0);
        let (own, terms) = parts.split_at(first);
        let mut own = own.to_vec();
        let (mut key, mut until, mut pixels, mut device_ms, mut open) =
            (None, None, None, None, None);
        for part in terms {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            let number = || {
                let bad = || malformed(name, "a whole number");
                value.parse::<u64>().map_err(|_| bad())
            };
            let is_again = match name {
                "signed_by" => key.replace(value).is_some(),
                "signed_until" => until.replace(number()?).is_some(),
                "signed_pixels" => pixels.replace(number()?).is_some(),
                "signed_ms" => device_ms.replace(number()?).is_some(),
                "signed_open" => open.replace(number()? == 1).is_some(),
                _ => return Err(malformed(name, "no parameters between the terms")),
            };
            if is_again {
                return Err(malformed(name, "to be given once"));
            }
        }
        let (Some(key), Some(until)) = (key, until) else {
            return Err(malformed(SIGNATURE, "`signed_by` and `signed_until` before it"));
        };
        let terms =
            Terms { key: key.to_owned(), until, pixels, device_ms, is_open: open == Some(true) };
        if !behind.is_empty() && !terms.is_open {
            return Err(malformed(SIGNATURE, "to come last, unless the address is signed as open"));
        }
        own.extend(behind.split('&').filter(|part| !part.is_empty()));
        let query = own.join("&");
        Ok(Claim { signed, signature, terms, query })
    }

    /// Returns whether the signature is that of the path and of what is signed.
    pub fn is_signed_with(&self, secret: &Secret, path: &str) -> bool {
        let Some(tag) = bytes_of(self.signature) else { return false };
        // In constant time.
        hmac::verify(&secret.key, text(path, self.signed).as_bytes(), &tag).is_ok()
    }
}

/// Returns an address without its signature and its terms, as handlers read it; `None` where it has no signature.
pub fn without_signature(uri: &Uri) -> Option<Uri> {
    let query = Claim::read(uri.query())?.ok()?.query;
    let path = uri.path();
    let own = if query.is_empty() { path.to_owned() } else { format!("{path}?{query}") };
    let mut parts = uri.clone().into_parts();
    parts.path_and_query = Some(own.parse().ok()?);
    Uri::from_parts(parts).ok()
}

fn malformed(name: &str, accepted: &str) -> Problem {
    let name: String = name.chars().take(32).collect();
    Problem::new(
        Kind::Unauthorized,
        format!("`{name}` of a signed address is not as it was signed"),
    )
    .at(name)
    .accepted(format!("{accepted}, as `pointillist sign` writes it"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PATH: &str = "/v1/scenes/town/frame";

    fn secret(digit: &str) -> Secret {
        Secret::from_hex(&digit.repeat(64)).unwrap()
    }

    fn terms() -> Terms {
        let key = "studio".to_owned();
        Terms { key, until: 2_000_000_000, pixels: Some(10_000), device_ms: None, is_open: false }
    }

    fn claim(query: &str) -> Result<Claim<'_>, Problem> {
        Claim::read(Some(query)).unwrap()
    }

    #[test]
    fn what_is_signed_is_read_again() {
        for own in ["", "w=100&h=100"] {
            let query = sign(PATH, own, &terms(), &secret("a"));
            let claim = claim(&query).unwrap();
            assert_eq!((&claim.terms, claim.query.as_str()), (&terms(), own));
            assert!(claim.is_signed_with(&secret("a"), PATH));
            assert!(!claim.is_signed_with(&secret("b"), PATH), "another secret");
            assert!(!claim.is_signed_with(&secret("a"), "/v1/scenes/town/mjpeg"), "another path");
        }
        assert!(Claim::read(Some("w=100&signatures=1")).is_none() && Claim::read(None).is_none());
    }

    /// The HMAC of the documented text, computed with openssl.
    #[test]
    fn signatures_are_what_the_contract_says() {
        let query = sign("/v1/scenes", "", &terms(), &secret("0"));
        assert_eq!(
            query,
            "signed_by=studio&signed_until=2000000000&signed_pixels=10000&signature=dcc18c9788b06b8c5e512f250797b13f0a1d17fcb794e299c5b4178ba1aa7542"
        );
    }

    #[test]
    fn no_byte_of_a_signed_query_can_be_changed() {
        let query = sign(PATH, "w=100&h=100", &terms(), &secret("a"));
        for at in 0..query.len() {
            let mut bytes = query.clone().into_bytes();
            bytes[at] = if bytes[at] == b'1' { b'2' } else { b'1' };
            let changed = String::from_utf8(bytes).unwrap();
            // A changed name of the signature leaves a query without one, which needs a key.
            let Some(Ok(claim)) = Claim::read(Some(&changed)) else { continue };
            assert!(!claim.is_signed_with(&secret("a"), PATH), "{changed}");
        }
    }

    #[test]
    fn only_open_addresses_take_more_parameters() {
        let closed = format!("{}&w=9999", sign(PATH, "", &terms(), &secret("a")));
        assert_eq!(claim(&closed).err().unwrap().status(), 401);
        let open = Terms { is_open: true, ..terms() };
        let query = format!("{}&w=100&signed_pixels=1", sign(PATH, "h=9", &open, &secret("a")));
        let claim = claim(&query).unwrap();
        assert!(claim.is_signed_with(&secret("a"), PATH));
        // What is added is no term: the handler refuses it as unknown.
        assert_eq!(claim.query, "h=9&w=100&signed_pixels=1");
        assert_eq!(claim.terms.pixels, Some(10_000));
    }

    #[test]
    fn terms_are_given_once_and_are_numbers() {
        for query in [
            "signature=00",
            "signed_by=a&signature=00",
            "signed_by=a&signed_until=soon&signature=00",
            "signed_by=a&signed_until=1&signed_until=2&signature=00",
            "signed_by=a&w=9&signed_until=1&signature=00",
            "signed_by=a&signed_until=-1&signature=00",
        ] {
            assert_eq!(claim(query).err().unwrap().status(), 401, "{query}");
        }
    }

    /// Whoever proposes an address to be signed cannot choose its terms.
    #[test]
    fn planted_terms_are_none() {
        for planted in ["signed_open=1&w=9", "signed_by=studio&signed_until=9&signed_open=1"] {
            let query = sign(PATH, planted, &terms(), &secret("a"));
            let claim = claim(&query).unwrap();
            assert_eq!((&claim.terms, claim.query.as_str()), (&terms(), planted));
            assert!(is_signed(planted));
        }
        assert!(is_signed("w=9&signed%5Fopen=1") && is_signed("%73ignature=1"));
        assert!(!is_signed("w=9&design=1"));
    }

    #[test]
    fn secrets_are_long() {
        assert!(Secret::from_hex(&"a".repeat(63)).is_none());
        assert!(Secret::from_hex(&"a".repeat(62)).is_none());
        assert!(Secret::from_hex(&"g".repeat(64)).is_none());
        assert!(is_plain("studio-1") && !is_plain("a&b") && !is_plain(""));
    }

    proptest! {
        #[test]
        fn no_query_makes_it_panic(query in "(signed_by=|signature=|signed_until=|[a-z&=%0-9é]){0,40}") {
            if let Some(Ok(claim)) = Claim::read(Some(&query)) {
                let _ = claim.is_signed_with(&secret("a"), PATH);
            }
        }
    }
}
