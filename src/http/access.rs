//! Access control: API keys with scopes, and the guard against requests from foreign web pages.
//!
//! A [file of keys](keys) holds hashes only. The server hashes a request's key once and
//! compares it with every stored hash in constant time, so that neither time nor order tells how near a guess was.
//!
//! Without keys (loopback, or `--insecure`) everybody may do everything, except that a web page from another origin may not
//! change anything: browsers send such requests to a local server without asking. An attacker can point a name of his own at
//! 127.0.0.1, which makes his page same-origin. A server that listens on loopback therefore answers only to the names of loopback.
//!
//! Browsers do not apply the same-origin policy to WebSockets, so a page of any origin could read a stream, and a page cannot set
//! headers on the request. Without keys, a stream is therefore open only to pages of the same origin or of `cors_origins`. A key
//! may also come as a subprotocol, `pointillist.key.KEY`.

use std::net::{Ipv4Addr, Ipv6Addr};
use std::time::SystemTime;

use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use self::signed::{Caps, Claim, Secret};
use super::problem::{Kind, Problem};
use super::{FRAME, STREAM};

pub mod keys;
pub mod signed;

/// The scope of a key. Each scope includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Scope {
    /// Allows frames, scenes, limits, metrics, and jobs that the key made while it had the write scope.
    Read,
    /// Also allows adding scenes, changing and removing those that the key added, and the key's own jobs.
    Write,
    /// Allows everything, including other keys' scenes and jobs, and the scenes of the root.
    Admin,
}

/// Limits of one key; `None` where the server's own limits apply.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quotas {
    /// Uploaded scenes at the same time.
    pub scenes: Option<u64>,
    /// Bytes of uploads on disk.
    pub bytes: Option<u64>,
    /// GPU time in milliseconds, by a bucket of one minute.
    pub device_ms_per_minute: Option<u64>,
    /// Open streams.
    pub streams: Option<usize>,
    pub requests_per_second: Option<f64>,
}

/// One key of the file.
#[derive(Clone, Debug)]
pub struct ApiKey {
    pub name: String,
    pub scope: Scope,
    /// Time from which the key is refused.
    pub expires: Option<SystemTime>,
    pub quotas: Quotas,
    /// Secret with which the holder signs addresses.
    pub url_secret: Option<Secret>,
    hash: [u8; 32],
}

/// The access rules for every request.
#[derive(Clone, Debug)]
pub enum Access {
    /// No keys are required; changes are accepted only from the same origin or from `cors_origins`.
    Open {
        cors_origins: Vec<String>,
        /// Answers only requests that name the server by a name or address of loopback.
        only_loopback: bool,
    },
    Keys(Vec<ApiKey>),
}

/// Why a request is refused.
#[derive(Debug)]
pub struct Refused {
    pub problem: Box<Problem>,
    /// Name of the key, if it is one of the file.
    pub key: Option<String>,
    /// Whether a key was sent that is not in the file.
    pub is_guess: bool,
}

impl ApiKey {
    /// Hashes of what lets requests of this key in.
    pub fn credentials(&self) -> [Option<[u8; 32]>; 2] {
        [Some(self.hash), self.url_secret.as_ref().map(Secret::digest)]
    }

    /// Whether both keys let the same requests in, with the same limits.
    fn is_same(&self, other: &ApiKey) -> bool {
        let allowed = |key: &ApiKey| (key.scope, key.expires, key.quotas);
        self.credentials() == other.credentials() && allowed(self) == allowed(other)
    }
}

impl Access {
    /// Returns which keys `next` adds, removes or changes, by their names, each as in `anna added`.
    pub fn changes(&self, next: &Access) -> Vec<String> {
        fn keys(access: &Access) -> &[ApiKey] {
            match access {
                Access::Open { .. } => &[],
                Access::Keys(keys) => keys,
            }
        }
        let (before, after) = (keys(self), keys(next));
        let added =
            after.iter().filter_map(|key| match before.iter().find(|old| old.name == key.name) {
                None => Some(format!("{} added", key.name)),
                Some(old) => (!key.is_same(old)).then(|| format!("{} changed", key.name)),
            });
        let is_removed = |old: &&ApiKey| !after.iter().any(|key| key.name == old.name);
        let removed = before.iter().filter(is_removed);
        added.chain(removed.map(|key| format!("{} removed", key.name))).collect()
    }
}

impl Refused {
    /// A request with a key that is not in the file.
    fn guess(problem: Problem) -> Refused {
        Refused { is_guess: true, ..Refused::from(problem) }
    }

    fn of(key: &ApiKey, problem: Problem) -> Refused {
        Refused { key: Some(key.name.clone()), ..Refused::from(problem) }
    }
}

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Refused {
        Refused { problem: Box::new(problem), key: None, is_guess: false }
    }
}

/// The key of a request, and how the request came by it.
#[derive(Clone, Copy, Debug)]
pub struct Admitted<'a> {
    pub key: &'a ApiKey,
    /// Limits of a signed address; none where the key itself was sent.
    pub caps: Caps,
    pub is_signed: bool,
}

/// Returns the scope that a request needs, or `None` where no key is needed.
pub fn needed(method: &Method, route: &str) -> Option<Scope> {
    match route {
        "/" | "/viewer/{file}" | "/healthz" | "/readyz" | "/openapi.yaml" | "/v1/settings" => None,
        // Renders, and changes nothing.
        "/v1/scenes/{id}/frames" | "/v1/scenes/{id}/pick" | "/v1/scenes/{id}/compare" => {
            Some(Scope::Read)
        }
        _ if method == Method::GET || method == Method::HEAD => Some(Scope::Read),
        _ => Some(Scope::Write),
    }
}

/// Returns whether a request of this route uses the GPU.
pub fn draws(route: &str) -> bool {
    route == STREAM
        || [
            FRAME,
            "/v1/scenes/{id}/frames",
            "/v1/scenes/{id}/pick",
            "/v1/scenes/{id}/compare",
            "/v1/scenes/{id}/mjpeg",
        ]
        .contains(&route)
}

/// Prefix of a subprotocol that carries a key.
pub const KEY_PROTOCOL: &str = "pointillist.key.";

impl Access {
    /// Checks the name by which a request calls the server, then its sender. Returns the key, if keys are required.
    pub fn check(
        &self,
        method: &Method,
        uri: &Uri,
        route: &str,
        headers: &HeaderMap,
    ) -> Result<Option<Admitted<'_>>, Refused> {
        if matches!(self, Access::Open { only_loopback: true, .. }) {
            check_host(uri, headers)?;
        }
        self.check_sender(method, uri, route, headers)
    }

    fn check_sender(
        &self,
        method: &Method,
        uri: &Uri,
        route: &str,
        headers: &HeaderMap,
    ) -> Result<Option<Admitted<'_>>, Refused> {
        let Some(scope) = needed(method, route) else { return Ok(None) };
        match self {
            Access::Open { cors_origins, .. } => {
                let anybody_reads = cors_origins.iter().any(|origin| origin == "*");
                if route == STREAM && !anybody_reads && is_foreign(uri, headers, cors_origins) {
                    return Err(foreign(headers, "open a stream").into());
                }
                if scope > Scope::Read && is_foreign(uri, headers, cors_origins) {
                    return Err(foreign(headers, "change anything").into());
                }
                Ok(None)
            }
            Access::Keys(keys) => match Claim::read(uri.query()) {
                Some(_) if method != Method::GET && method != Method::HEAD => {
                    let detail = "a signed address only reads, with GET; changes need a key";
                    Err(Problem::new(Kind::Forbidden, detail).into())
                }
                Some(claim) => check_signed(keys, scope, uri.path(), route, claim?).map(Some),
                None => check_key(keys, scope, route, headers).map(Some),
            },
        }
    }
}

/// Builds the problem for a page of another origin; it names the flag that lets the page in.
fn foreign(headers: &HeaderMap, may_not: &str) -> Problem {
    let origin =
        headers.get(header::ORIGIN).map(|origin| String::from_utf8_lossy(origin.as_bytes()));
    let origin: String = origin.unwrap_or_default().chars().take(128).collect();
    let detail = format!(
        "a page of another origin ({}) may not {may_not} unless the server was started with --cors-origin",
        origin.escape_debug()
    );
    let accepted =
        "a page of the server's own origin, or of an origin allowed with --cors-origin ORIGIN";
    Problem::new(Kind::Forbidden, detail).at("Origin").accepted(accepted)
}

/// Refuses a request whose host is missing or not loopback.
pub fn check_host(uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
    let mut named = hosts(uri, headers).peekable();
    let is_named = named.peek().is_some();
    if is_named && named.all(|host| host.is_some_and(is_loopback)) {
        return Ok(());
    }
    Err(Problem::new(
        Kind::WrongHost,
        "a listener on loopback that asks for no key answers only to loopback names",
    )
    .at("Host")
    .accepted("localhost, 127.0.0.1 or [::1], with any port"))
}

/// The hosts that a request names: that of its address, where HTTP/2 has it, and those of `Host`; `None` for one that is no text.
fn hosts<'r>(uri: &'r Uri, headers: &'r HeaderMap) -> impl Iterator<Item = Option<&'r str>> {
    let authority = uri.authority().map(|authority| Some(authority.as_str()));
    let text = |host: &'r HeaderValue| std::str::from_utf8(host.as_bytes()).ok();
    authority.into_iter().chain(headers.get_all(header::HOST).iter().map(text))
}

/// Returns whether an authority, with or without port, is a name or an address of loopback.
fn is_loopback(authority: &str) -> bool {
    let is_port = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit());
    if let Some(rest) = authority.strip_prefix('[') {
        let Some((address, port)) = rest.split_once(']') else { return false };
        let has_port = port.is_empty() || port.strip_prefix(':').is_some_and(is_port);
        return has_port
            && address
                .parse::<Ipv6Addr>()
                .is_ok_and(|address| address.to_canonical().is_loopback());
    }
    let (name, port) = authority.split_once(':').unwrap_or((authority, ""));
    is_port(port)
        && (name.eq_ignore_ascii_case("localhost")
            || name.parse::<Ipv4Addr>().is_ok_and(|address| address.is_loopback()))
}

fn check_key<'a>(
    keys: &'a [ApiKey],
    scope: Scope,
    route: &str,
    headers: &HeaderMap,
) -> Result<Admitted<'a>, Refused> {
    const HOW: &str = "Authorization: Bearer KEY";
    let unauthorized =
        |detail| Problem::new(Kind::Unauthorized, detail).at("Authorization").accepted(HOW);
    let in_protocol = || (route == STREAM).then(|| protocol_key(headers)).flatten();
    let token = match headers.get(header::AUTHORIZATION) {
        Some(value) => match value.as_bytes().split_at_checked(7) {
            Some((scheme, token)) if scheme.eq_ignore_ascii_case(b"Bearer ") => token.trim_ascii(),
            _ => return Err(unauthorized("not a bearer key").into()),
        },
        None => in_protocol().ok_or_else(|| unauthorized("no key was sent"))?,
    };
    let hash: [u8; 32] = Sha256::digest(token).into();
    let mut granted: Option<&ApiKey> = None;
    for key in keys {
        // Compare every key, even after a hit.
        let is_same = bool::from(key.hash.ct_eq(&hash));
        if is_same && granted.is_none_or(|best| best.scope < key.scope) {
            granted = Some(key);
        }
    }
    let Some(granted) = granted else {
        return Err(Refused::guess(unauthorized("the key is not known")));
    };
    let refused = |problem| Refused::of(granted, problem);
    if has_passed(granted.expires) {
        return Err(refused(unauthorized("the key has expired")));
    }
    if granted.scope < scope {
        let detail =
            format!("the key's scope is {:?}, but this operation needs {scope:?}", granted.scope);
        return Err(refused(Problem::new(Kind::Forbidden, detail.to_lowercase())));
    }
    let caps = Caps { credential: Some(granted.hash), ..Caps::default() };
    Ok(Admitted { key: granted, caps, is_signed: false })
}

fn has_passed(end: Option<SystemTime>) -> bool {
    end.is_some_and(|end| end <= SystemTime::now())
}

/// Checks a request by a signed address, which reads what its key may read.
fn check_signed<'a>(
    keys: &'a [ApiKey],
    scope: Scope,
    path: &str,
    route: &str,
    claim: Claim<'_>,
) -> Result<Admitted<'a>, Refused> {
    let unauthorized = |detail| {
        let accepted = "an address as `pointillist sign` writes it, before its time has passed";
        Problem::new(Kind::Unauthorized, detail).at("signature").accepted(accepted)
    };
    let signed_with = |key: &&ApiKey| {
        key.name == claim.terms.key
            && key.url_secret.as_ref().is_some_and(|secret| claim.is_signed_with(secret, path))
    };
    let Some(key) = keys.iter().find(signed_with) else {
        return Err(Refused::guess(unauthorized("the signature is not that of this address")));
    };
    let refused = |problem| Refused::of(key, problem);
    let credential = key.url_secret.as_ref().map(Secret::digest);
    let caps = Caps { credential, ..claim.terms.caps() };
    if has_passed(caps.until) {
        return Err(refused(unauthorized("this signed address has expired")));
    }
    if has_passed(key.expires) {
        return Err(refused(unauthorized("the key that signed this address has expired")));
    }
    if scope > Scope::Read {
        let detail = "a signed address only reads; changes need a key";
        return Err(refused(Problem::new(Kind::Forbidden, detail)));
    }
    if route == STREAM && !claim.terms.is_open {
        let detail =
            "a stream gets its poses as messages, which this signed address does not allow";
        let accepted = "an address signed with --open";
        return Err(refused(Problem::new(Kind::Forbidden, detail).accepted(accepted)));
    }
    Ok(Admitted { key, caps, is_signed: true })
}

/// Returns the key among the subprotocols that a client offers, the only field of a WebSocket request that a page can set.
fn protocol_key(headers: &HeaderMap) -> Option<&[u8]> {
    headers
        .get_all(header::SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .flat_map(|list| list.as_bytes().split(|&byte| byte == b','))
        .find_map(|name| name.trim_ascii().strip_prefix(KEY_PROTOCOL.as_bytes()))
}

/// Returns whether a browser sent this request for a page of another origin.
fn is_foreign(uri: &Uri, headers: &HeaderMap, cors_origins: &[String]) -> bool {
    let Some(origin) = headers.get(header::ORIGIN) else { return false };
    let Ok(origin) = origin.to_str() else { return true };
    if cors_origins.iter().any(|allowed| allowed == origin) {
        return false;
    }
    match (origin.split_once("://"), hosts(uri, headers).next().flatten()) {
        (Some((_, authority)), Some(host)) => !authority.eq_ignore_ascii_case(host),
        _ => true,
    }
}

#[cfg(test)]
mod tests;
