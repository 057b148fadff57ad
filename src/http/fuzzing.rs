//! Fuzz targets of what clients send: queries, JSON bodies, stream messages, headers, signed addresses; and of key files.

#![allow(clippy::unwrap_used, reason = "a target reports a fault by panicking")]

use std::net::{IpAddr, Ipv4Addr};
use std::path::{Component, Path};
use std::time::Instant;

use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri};
use serde_json::Value;

use super::access::{keys, signed};
use super::compare::{Asked, CompareRequest};
use super::mjpeg::ScreeningParams;
use super::params::{FrameParams, pairs};
use super::problem::Problem;
use super::upload::Target;
use super::{accuracy, address, body, conditional, jobs, names, scenes, stream};
use crate::encode::ImageFormat;
use crate::fuzzing::{Run, assert_finite, assert_numbers, text};
use crate::jobs::{FrameSpec, PathChoice, Spec};
use crate::plan::Output;
use crate::scene::{SceneLimits, parse_path};

pub const TARGETS: &[(&str, Run)] = &[
    ("query", read_query),
    ("pose", read_pose),
    ("stream", read_message),
    ("screening", read_screening),
    ("upload-query", read_upload_query),
    ("headers", read_headers),
    ("file-names", read_file_names),
    ("node-change", read_node_change),
    ("compare", read_comparison),
    ("survey", read_survey),
    ("job-order", read_job_order),
    ("signed", read_signed),
    ("keys", read_keys),
];

/// Longest side of a frame.
const LONGEST: u32 = 16_384;

/// A refusal is the client's fault, and says so in few words.
fn refused(problem: &Problem) {
    let status = problem.status();
    assert!((400..500).contains(&status), "status {status}: {problem:?}");
    let accepted = problem.accepted.as_ref().map_or(0, String::len);
    let parameter = problem.parameter.as_ref().map_or(0, String::len);
    assert!(problem.detail.len() + accepted + parameter < 32 << 10, "a refusal is very long");
}

fn accepted<T>(result: Result<T, Problem>) -> Option<T> {
    result.inspect_err(refused).ok()
}

/// Parameters that are accepted make a request of finite numbers, whose settings a job's record gives back.
fn check_params(params: &FrameParams) {
    let Some(request) = accepted(params.request("scene", ImageFormat::Png, Instant::now())) else {
        return;
    };
    // Clip boxes may be open to a side.
    assert_numbers(&request);
    assert_eq!(params.clone().or(&FrameParams::default()), *params);
    check_frame_spec(&FrameSpec::new(&request));
}

fn check_frame_spec(spec: &FrameSpec) {
    let stored = serde_json::to_string(spec).unwrap();
    assert_eq!(serde_json::from_str::<FrameSpec>(&stored).unwrap(), *spec, "{stored}");
}

fn read_query(data: &[u8]) {
    let Some(query) = text(data) else { return };
    if let Some(params) = accepted(FrameParams::from_query(Some(query))) {
        check_params(&params);
        accepted(params.check_sides(LONGEST));
    }
}

fn json(data: &[u8]) -> Option<Value> {
    accepted(body::parse_json::<Value>(data))
}

fn read_pose(data: &[u8]) {
    let Some(value) = json(data) else { return };
    if let Some(params) = accepted(FrameParams::from_json(value, "poses[3]")) {
        check_params(&params);
    }
}

fn read_message(data: &[u8]) {
    let Some(message) = text(data) else { return };
    let Some(message) = accepted(stream::wire::Incoming::read(message)) else { return };
    assert!(message.ack.is_some() || message.ping.is_some() || message.pose.is_some());
    if let Some(pose) = message.pose {
        check_params(&pose.params);
    }
}

fn read_screening(data: &[u8]) {
    let Some(query) = text(data) else { return };
    if let Some((screening, params)) = accepted(ScreeningParams::from_query(Some(query))) {
        assert_finite(&screening);
        check_params(&params);
    }
}

fn read_upload_query(data: &[u8]) {
    let uri = text(data).and_then(|query| format!("/v1/scenes?{query}").parse::<Uri>().ok());
    let Some(target) = uri.and_then(|uri| accepted(Target::from_uri(&uri))) else { return };
    target.check();
}

/// Reads lines `name: value`.
fn read_headers(data: &[u8]) {
    let mut headers = HeaderMap::new();
    for line in data.split(|&byte| byte == b'\n').take(64) {
        let Some(colon) = line.iter().position(|&byte| byte == b':') else { continue };
        let (name, value) = (&line[..colon], line[colon + 1..].trim_ascii());
        let name = HeaderName::from_bytes(name);
        let value = HeaderValue::from_bytes(value);
        if let (Ok(name), Ok(value)) = (name, value) {
            headers.append(name, value);
        }
    }
    if let Some(Some(name)) = accepted(names::disposition_name(&headers)) {
        check_file_name(&name);
    }
    if let Some(Some(key)) = accepted(jobs::create::idempotency_key(&headers)) {
        assert!((1..=255).contains(&key.len()) && key.bytes().all(|b| (b' '..=b'~').contains(&b)));
    }
    for output in [Output::Color, Output::Depth] {
        accepted(conditional::negotiate(&headers, output));
    }
    accepted(body::check_length(&headers, 1 << 20));
    conditional::prefer_wait(&headers);
    conditional::none_match_hits(&headers, "\"abc\"");
    body::is_json(&body::media_type(&headers));
    let peer = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let proxies = ["127.0.0.0/8", "10.0.0.0/8"].map(|range| address::parse_range(range).unwrap());
    let client = address::of_client(peer, &headers, &proxies);
    assert_eq!(address::of_client(peer, &headers, &[]), peer);
    assert_eq!(address::network(address::network(client)), address::network(client));
}

/// A file name names a file of its folder.
fn check_file_name(name: &str) {
    let mut components = Path::new(name).components();
    assert!(matches!(components.next(), Some(Component::Normal(_))) && components.next().is_none());
}

/// Reads a form's file names, one a line.
fn read_file_names(data: &[u8]) {
    let Some(lines) = text(data) else { return };
    let mut files = Vec::new();
    for line in lines.split('\n') {
        assert!(names::valid_id(names::slug(line)).is_ok(), "{:?}", names::slug(line));
        if let Some(name) = accepted(names::valid_file_name(line)) {
            check_file_name(&name);
            files.push(name);
        }
    }
    for named in [None, files.last().map(String::as_str), Some("a.ply")] {
        if let Some(main) = accepted(names::main_file(&files, named)) {
            assert!(files.contains(&main));
        }
    }
}

fn read_node_change(data: &[u8]) {
    let change = json(data).and_then(|value| accepted(scenes::node_change(value)));
    if let Some(patch) = change.and_then(|change| accepted(change.patch())) {
        assert_finite(&patch);
    }
}

fn read_comparison(data: &[u8]) {
    let request = accepted(body::parse_json::<CompareRequest>(data));
    request.and_then(|request| accepted(Asked::read(request, LONGEST)));
}

fn read_survey(data: &[u8]) {
    json(data).and_then(|value| accepted(accuracy::wanted(value)));
}

fn read_job_order(data: &[u8]) {
    let Some(spec) = json(data).and_then(|value| accepted(jobs::create::spec(value))) else {
        return;
    };
    check_frame_spec(&spec.frame);
    let stored = serde_json::to_string(&spec).unwrap();
    let read: Spec = serde_json::from_str(&stored).unwrap();
    assert_eq!(serde_json::to_string(&read).unwrap(), stored);
    if let PathChoice::Inline(path) = &spec.path
        && let Ok(path) = parse_path(path, "path", glam::DVec3::Y)
    {
        assert_finite(&path);
        assert!(path.keys.len() as u64 <= SceneLimits::default().max_json_objects);
    }
}

/// Reads a path and a query, on two lines.
fn read_signed(data: &[u8]) {
    let Some((path, query)) = text(data).and_then(|text| text.split_once('\n')) else { return };
    let secret = signed::Secret::from_hex(&"5a".repeat(32)).unwrap();
    if let Some(claim) = signed::Claim::read(Some(query))
        && let Some(claim) = accepted(claim)
    {
        assert!(!claim.is_signed_with(&secret, path), "a signature was forged");
    }
    if let Ok(uri) = format!("/{path}?{query}").parse::<Uri>() {
        signed::without_signature(&uri);
    }
    // A client cannot send a fragment.
    if query.contains('#') || pairs(Some(query)).is_err() || signed::is_signed(query) {
        return;
    }
    let terms = signed::Terms {
        key: "studio".to_owned(),
        until: 2_000_000_000,
        pixels: Some(10_000),
        device_ms: None,
        is_open: query.len().is_multiple_of(2),
    };
    let signed = signed::sign(path, query, &terms, &secret);
    let claim = accepted(signed::Claim::read(Some(&signed)).unwrap()).unwrap();
    assert!(claim.is_signed_with(&secret, path), "{signed}");
    assert_eq!(claim.terms, terms, "{signed}");
}

fn read_keys(data: &[u8]) {
    let Some(text) = text(data) else { return };
    for name in ["keys", "keys.toml"] {
        match keys::read(Path::new(name), text) {
            Ok(keys) => assert!(!keys.is_empty()),
            // It may name a key.
            Err(reason) => assert!(reason.len() < 4096 + 2 * text.len(), "{reason}"),
        }
    }
}
