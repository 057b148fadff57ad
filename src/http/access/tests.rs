use super::*;

/// Reads a key file of lines.
fn parse_keys(text: &str) -> Result<Vec<ApiKey>, String> {
    keys::read(std::path::Path::new("keys"), text)
}
use axum::http::HeaderValue;

fn line(name: &str, scope: &str, key: &str) -> String {
    let hex: String =
        Sha256::digest(key.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{name} {scope} {hex}\n")
}

fn bearer(key: &str) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(header::AUTHORIZATION, HeaderValue::from_str(&format!("Bearer {key}")).unwrap());
    headers
}

#[test]
fn scopes_are_enforced() {
    let text = format!("# keys\n{}{}", line("eye", "read", "r"), line("hand", "write", "w"));
    let access = Access::Keys(parse_keys(&text).unwrap());
    let status = |method: &Method, route, headers: &HeaderMap| {
        access
            .check(method, &Uri::default(), route, headers)
            .err()
            .map(|refused| refused.problem.status())
    };
    let frame = "/v1/scenes/{id}/frame";
    assert_eq!(status(&Method::GET, frame, &bearer("r")), None);
    assert_eq!(status(&Method::POST, "/v1/scenes/{id}/frames", &bearer("r")), None);
    assert_eq!(status(&Method::POST, "/v1/scenes/{id}/pick", &bearer("r")), None);
    assert_eq!(status(&Method::POST, "/v1/scenes", &bearer("r")), Some(403));
    assert_eq!(status(&Method::POST, "/v1/scenes", &bearer("w")), None);
    assert_eq!(status(&Method::DELETE, "/v1/scenes/{id}", &bearer("r")), Some(403));
    assert_eq!(status(&Method::GET, frame, &bearer("x")), Some(401));
    assert_eq!(status(&Method::GET, frame, &HeaderMap::new()), Some(401));
    assert_eq!(status(&Method::GET, "/metrics", &HeaderMap::new()), Some(401));
    assert_eq!(status(&Method::GET, "/healthz", &HeaderMap::new()), None);
    let mut basic = HeaderMap::new();
    basic.insert(header::AUTHORIZATION, HeaderValue::from_static("Basic r"));
    assert_eq!(status(&Method::GET, frame, &basic), Some(401));
}

#[test]
fn pages_send_their_key_as_a_subprotocol_of_streams_only() {
    let access = Access::Keys(parse_keys(&line("eye", "read", "r-1")).unwrap());
    let mut headers = HeaderMap::new();
    let offered = HeaderValue::from_static("pointillist, pointillist.key.r-1");
    headers.insert(header::SEC_WEBSOCKET_PROTOCOL, offered);
    let check = |route| access.check(&Method::GET, &Uri::default(), route, &headers);
    assert_eq!(check(STREAM).unwrap().map(|admitted| admitted.key.name.as_str()), Some("eye"));
    assert_eq!(check("/v1/scenes").unwrap_err().problem.status(), 401);
    let wrong = HeaderValue::from_static("pointillist.key.r-2");
    headers.insert(header::SEC_WEBSOCKET_PROTOCOL, wrong);
    let refused = access.check(&Method::GET, &Uri::default(), STREAM, &headers);
    assert_eq!(refused.unwrap_err().problem.status(), 401);
}

#[test]
fn foreign_pages_cannot_open_streams() {
    let from = |origin: &str, allowed: &str| {
        let cors_origins = vec![allowed.to_owned()];
        let access = Access::Open { cors_origins, only_loopback: true };
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, HeaderValue::from_static("127.0.0.1:8080"));
        headers.insert(header::ORIGIN, HeaderValue::from_str(origin).unwrap());
        access.check(&Method::GET, &Uri::default(), STREAM, &headers).is_ok()
    };
    assert!(from("http://127.0.0.1:8080", "https://app.example"));
    assert!(from("https://app.example", "https://app.example"));
    assert!(!from("https://evil.example", "https://app.example"));
    assert!(from("https://evil.example", "*"));
    let mut headers = HeaderMap::new();
    headers.insert(header::ORIGIN, HeaderValue::from_static("http://localhost:5173"));
    let detail = foreign(&headers, "open a stream").detail;
    assert!(
        detail.contains("(http://localhost:5173)") && detail.contains("--cors-origin"),
        "{detail}"
    );
}

#[test]
fn key_files_are_checked() {
    let good = line("a", "admin", "k");
    assert_eq!(parse_keys(&good).unwrap()[0].scope, Scope::Admin);
    for bad in ["", "# only\n", "a read\n", "a root 00\n", "a read 00\n"] {
        assert!(parse_keys(bad).is_err(), "{bad:?}");
    }
    assert!(parse_keys(&format!("{good}{good}")).unwrap_err().starts_with("line 2"));
}

#[test]
fn foreign_pages_cannot_change_scenes() {
    let access =
        Access::Open { cors_origins: vec!["https://app.example".into()], only_loopback: false };
    let from = |origin: &str| {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, HeaderValue::from_static("127.0.0.1:8080"));
        headers.insert(header::ORIGIN, HeaderValue::from_str(origin).unwrap());
        access.check(&Method::POST, &Uri::default(), "/v1/scenes", &headers).is_ok()
    };
    assert!(from("http://127.0.0.1:8080"));
    assert!(from("https://app.example"));
    assert!(!from("https://evil.example"));
    assert!(!from("null"));
    // HTTP/2 names the host in the address, and has no `Host`.
    let over_http2 = |origin: &'static str| {
        let uri = Uri::from_static("https://render.example:8443/v1/scenes");
        let headers = HeaderMap::from_iter([(header::ORIGIN, HeaderValue::from_static(origin))]);
        access.check(&Method::POST, &uri, "/v1/scenes", &headers).is_ok()
    };
    assert!(over_http2("https://render.example:8443"));
    assert!(!over_http2("https://evil.example"));
    let none = HeaderMap::new();
    assert!(access.check(&Method::POST, &Uri::default(), "/v1/scenes", &none).is_ok());
}

#[test]
fn on_loopback_only_loopback_names_are_answered() {
    let check = |only_loopback, uri: &'static str, hosts: &[&'static str]| {
        let access = Access::Open { cors_origins: Vec::new(), only_loopback };
        let mut headers = HeaderMap::new();
        for host in hosts {
            headers.append(header::HOST, HeaderValue::from_static(host));
        }
        let result = access.check(&Method::GET, &Uri::from_static(uri), "/healthz", &headers);
        result.err().map(|refused| refused.problem.status())
    };
    for host in ["localhost", "LocalHost:8080", "127.0.0.1:1", "127.9.9.9", "[::1]", "[::1]:80"] {
        assert_eq!(check(true, "/healthz", &[host]), None, "{host}");
    }
    for host in [
        "evil.example",
        "evil.example:80",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "127.0.0.1:80@evil.example",
        "[::1].evil.example",
        "[::2]",
        "[::1",
        "10.0.0.1",
        "0.0.0.0",
        "",
        "localhost:80:80",
    ] {
        assert_eq!(check(true, "/healthz", &[host]), Some(421), "{host}");
        assert_eq!(check(false, "/healthz", &[host]), None, "{host}");
    }
    assert_eq!(check(true, "/healthz", &[]), Some(421));
    assert_eq!(check(true, "/healthz", &["localhost", "evil.example"]), Some(421));
    assert_eq!(check(true, "http://localhost:80/healthz", &[]), None);
    assert_eq!(check(true, "http://evil.example/healthz", &["localhost"]), Some(421));
}

#[test]
fn signed_addresses_read_and_nothing_else() {
    let hex = "5".repeat(64);
    let hash = "6".repeat(64);
    let text = format!(
        "[[key]]\nid = \"boss\"\nscope = \"admin\"\nhash = \"{hash}\"\nurl-secret = \"{hex}\"\n"
    );
    let keys = keys::read(std::path::Path::new("keys.toml"), &text).unwrap();
    let access = Access::Keys(keys);
    let secret = signed::Secret::from_hex(&hex).unwrap();
    let status = |method: &Method, route: &str, path: &str, until: u64, is_open: bool| {
        let key = "boss".to_owned();
        let terms = signed::Terms { key, until, pixels: Some(5), device_ms: None, is_open };
        let query = signed::sign(path, "", &terms, &secret);
        let uri: Uri = format!("{path}?{query}").parse().unwrap();
        let checked = access.check(method, &uri, route, &HeaderMap::new());
        checked.map(|admitted| admitted.unwrap().caps.pixels).map_err(|r| r.problem.status())
    };
    let (frame, path) = ("/v1/scenes/{id}/frame", "/v1/scenes/a/frame");
    let later = 4_000_000_000;
    assert_eq!(status(&Method::GET, frame, path, later, false), Ok(Some(5)));
    assert_eq!(status(&Method::GET, frame, path, 1_000_000_000, false), Err(401));
    assert_eq!(status(&Method::GET, frame, path, u64::MAX, false), Err(401), "no such time");
    assert_eq!(status(&Method::DELETE, "/v1/scenes/{id}", "/v1/scenes/a", later, false), Err(403));
    let (frames, many) = ("/v1/scenes/{id}/frames", "/v1/scenes/a/frames");
    assert_eq!(status(&Method::POST, frames, many, later, true), Err(403), "a body is not signed");
    assert_eq!(status(&Method::GET, STREAM, "/v1/scenes/a/stream", later, false), Err(403));
    assert_eq!(status(&Method::GET, STREAM, "/v1/scenes/a/stream", later, true), Ok(Some(5)));
}
