//! Checks every example in README and docs against the contract and against a daemon.
//!
//! Shell blocks contain `curl` lines. The keys of a JSON block tell its schema. An example that this test does not understand
//! fails, because nothing would check it.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::daemon::{Daemon, eventually};
use super::schema::Contract;

/// A fenced block of a page.
struct Block {
    page: String,
    line: usize,
    language: String,
    text: String,
}

fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let docs = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let docs = docs.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let mut pages: Vec<PathBuf> = docs.collect();
    pages.extend([root.join("README.md"), root.join("scenes/README.md")]);
    pages.sort();
    pages
}

fn blocks() -> Vec<Block> {
    let mut found = Vec::new();
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        let mut open: Option<Block> = None;
        for (index, line) in text.lines().enumerate() {
            match (line.trim_start().strip_prefix("```"), open.as_mut()) {
                (Some(language), None) => {
                    let (page, language) = (page.display().to_string(), language.to_owned());
                    open = Some(Block { page, line: index + 1, language, text: String::new() });
                }
                (Some(_), Some(_)) => found.extend(open.take()),
                (None, Some(block)) => block.text += &format!("{line}\n"),
                (None, None) => {}
            }
        }
    }
    found
}

/// The request of a `curl` line.
#[derive(Debug, Default)]
struct Curl {
    method: Option<String>,
    url: String,
    headers: Vec<(String, String)>,
    body: Option<String>,
    /// Number of files that the line sends, as a body or in a form.
    files: usize,
}

/// Splits a shell line into words, with quotes, backslashes and comments.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    let mut characters = line.chars();
    while let Some(c) = characters.next() {
        match (quote, c) {
            (Some(open), c) if c == open => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                word.get_or_insert_default();
                quote = Some(c);
            }
            (None, '\\') => word.get_or_insert_default().extend(characters.next()),
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, '#') if word.is_none() => break,
            (None, '|' | ';' | '&' | '>') => break,
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

fn curl(line: &str) -> Option<Curl> {
    let mut words = words(line).into_iter();
    if words.next()? != "curl" {
        return None;
    }
    let mut curl = Curl::default();
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap_or_else(|| panic!("{line}: {word} has no value"));
        match word.as_str() {
            "-H" | "--header" => {
                let header = value();
                let (name, text) =
                    header.split_once(':').unwrap_or_else(|| panic!("{line}: {header}"));
                curl.headers.push((name.trim().to_owned(), text.trim().to_owned()));
            }
            "-X" | "--request" => curl.method = Some(value()),
            "-o" | "--output" | "-D" | "--dump-header" => drop(value()),
            "-F" | "--form" => {
                value();
                curl.files += 1;
            }
            "-d" | "--data" | "--data-binary" => {
                let data = value();
                if data.starts_with('@') { curl.files += 1 } else { curl.body = Some(data) }
            }
            "-T" | "--upload-file" => {
                value();
                curl.files += 1;
            }
            flag if flag.starts_with('-') => {
                let known = [
                    "-N", "-s", "-S", "-sS", "-i", "-f", "-sf", "-I", "-L", "-v", "--fail",
                    "--silent",
                ];
                assert!(known.contains(&flag), "{line}: the test does not know {flag}");
            }
            url => {
                assert!(curl.url.is_empty(), "{line}: two addresses");
                curl.url = url.to_owned();
            }
        }
    }
    Some(curl)
}

impl Curl {
    fn method(&self) -> &str {
        let default = if self.body.is_some() || self.files > 0 { "POST" } else { "GET" };
        self.method.as_deref().unwrap_or(default)
    }

    /// Path and query of a request to the documentation's daemon; `None` for another server.
    fn target(&self) -> Option<&str> {
        let rest = ["http://127.0.0.1:8080", "http://localhost:8080"];
        let rest = rest.iter().find_map(|origin| self.url.strip_prefix(origin))?;
        Some(if rest.is_empty() { "/" } else { rest })
    }
}

fn query(text: &str) -> Vec<(String, String)> {
    let pairs = text.split('&').filter(|pair| !pair.is_empty());
    pairs
        .map(|pair| {
            let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
            (name.to_owned(), value.replace("%20", " "))
        })
        .collect()
}

/// The lines of a shell block, with continued lines joined.
fn commands(block: &Block) -> Vec<String> {
    let joined = block.text.replace("\\\n", " ");
    joined.lines().map(|line| line.trim().trim_start_matches("$ ").to_owned()).collect()
}

fn is_shell(block: &Block) -> bool {
    ["", "sh", "bash", "console"].contains(&block.language.as_str())
}

/// Every `curl` line and its place.
fn curls() -> Vec<(String, Curl)> {
    let mut found = Vec::new();
    for block in blocks().iter().filter(|block| is_shell(block)) {
        for line in commands(block) {
            let here = format!("{}:{}: {line}", block.page, block.line);
            found.extend(curl(&line).map(|curl| (here, curl)));
        }
    }
    found
}

/// Faults of an address, by the contract.
fn faults_of_address(contract: &Contract, method: &str, target: &str) -> Vec<String> {
    let (path, text) = target.split_once('?').unwrap_or((target, ""));
    match contract.operation(method, path) {
        None => vec![format!("there is no {method} {path}")],
        Some((_, operation)) => contract.query_faults(operation, &query(text)),
    }
}

#[test]
fn curl_lines_follow_the_contract() {
    let contract = Contract::new();
    let mut checked = 0;
    for (here, curl) in curls() {
        let Some(target) = curl.target() else { continue };
        let (method, path) = (curl.method(), target.split('?').next().unwrap());
        let faults = faults_of_address(&contract, method, target);
        assert!(faults.is_empty(), "{here}: {faults:?}");
        if let Some(body) = &curl.body {
            let body: Value =
                serde_json::from_str(body).unwrap_or_else(|error| panic!("{here}: {error}"));
            let (_, operation) = contract.operation(method, path).unwrap();
            let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
            let faults = contract.faults(schema, &body);
            assert!(faults.is_empty(), "{here}: {faults:?}");
            let is_json = |(name, value): &(String, String)| {
                name.eq_ignore_ascii_case("content-type") && value == "application/json"
            };
            assert!(
                curl.headers.iter().any(is_json),
                "{here}: curl sends a form without a Content-Type"
            );
        }
        checked += 1;
    }
    assert!(checked >= 9, "{checked} lines were found");
}

/// Checks addresses in the HTML, scripts and text of pages: of `<img>`, of sockets, and all others that are written in full.
#[test]
fn addresses_follow_the_contract() {
    let contract = Contract::new();
    let mut checked = 0;
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for (start, _) in text.match_indices("//127.0.0.1:8080/") {
            let rest = &text[start + "//127.0.0.1:8080".len()..];
            let end =
                rest.find(['\'', '"', '`', '>', ' ', '\n', ')', '\\', '|']).unwrap_or(rest.len());
            let target = rest[..end].trim_end_matches(['.', ',']);
            // Skip placeholders, and addresses that stand for several ones.
            if target.contains(['{', '[', '$', '…']) || rest[end..].starts_with('\\') {
                continue;
            }
            let is_posted = target.ends_with("/v1/jobs")
                || target.ends_with("/frames")
                || target.ends_with("/pick")
                || target.ends_with("/compare")
                || target.ends_with("/cancel")
                || target.ends_with("/retry")
                || target.starts_with("/v1/scenes?");
            let method = if is_posted { "POST" } else { "GET" };
            let faults = faults_of_address(&contract, method, target);
            assert!(faults.is_empty(), "{}: {target}: {faults:?}", page.display());
            checked += 1;
        }
    }
    assert!(checked >= 12, "{checked} addresses were found");
}

/// The schema of a JSON example, by its keys.
fn schema_of(value: &Value) -> Option<&'static str> {
    let has = |name: &str| value.get(name).is_some();
    Some(match () {
        () if has("assets") || has("nodes") => "SceneFile",
        () if has("keys") => "PathFile",
        () if has("poses") => "FramesRequest",
        () if has("pixels") => "PickRequest",
        () if has("picks") => "Picks",
        () if has("scene") && has("path") => "JobRequest",
        () if has("request_id") && has("passes") || has("planned") => "Receipt",
        () if has("seq") => "StreamPose",
        () if has("type") && has("title") => "Problem",
        () if has("translate") || has("matrix") || has("visible") => "NodeChange",
        () => return None,
    })
}

#[test]
fn json_follows_the_contract() {
    let contract = Contract::new();
    let mut checked = 0;
    for block in blocks().iter().filter(|block| block.language == "json") {
        let here = format!("{}:{}", block.page, block.line);
        let value: Value =
            serde_json::from_str(&block.text).unwrap_or_else(|error| panic!("{here}: {error}"));
        let name =
            schema_of(&value).unwrap_or_else(|| panic!("{here}: what is this an example of?"));
        let mut schema = contract.component(name).clone();
        // Receipts are shown abridged: the shown fields must match the contract, and unknown ones are errors.
        if name == "Receipt" {
            for key in value.as_object().unwrap().keys() {
                assert!(schema["properties"].get(key).is_some(), "{here}: a receipt has no {key}");
            }
            schema.as_object_mut().unwrap().remove("required");
        }
        let faults = contract.faults(&schema, &value);
        assert!(faults.is_empty(), "{here}: {faults:?}");
        checked += 1;
    }
    assert!(checked >= 4, "{checked} examples were found");
}

/// Copies the shipped scenes that the examples need. A daemon in the debug profile has to draw them.
fn shipped(root: &Path) {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for entry in std::fs::read_dir(scenes).unwrap() {
        let file = entry.unwrap().path();
        let name = file.file_name().unwrap().to_str().unwrap().to_owned();
        if ["town", "plaza"].iter().any(|scene| name.starts_with(scene)) {
            std::fs::copy(&file, root.join(name)).unwrap();
        }
    }
}

/// Makes a request cheaper.
fn smaller(text: &str) -> String {
    let mut text = text.to_owned();
    // Picked pixels.
    for (far, near) in
        [("x=640&y=400", "x=32&y=20"), ("[640, 400], [641, 400]", "[32, 20], [33, 20]")]
    {
        text = text.replace(far, near);
    }
    for (large, small) in [
        ("1280", "64"),
        ("1024", "64"),
        ("720", "48"),
        ("768", "48"),
        ("640", "64"),
        ("480", "48"),
        ("360", "48"),
    ] {
        for side in ["w", "h"] {
            text = text.replace(&format!("{side}={large}"), &format!("{side}={small}"));
            text = text.replace(&format!("\"{side}\": {large}"), &format!("\"{side}\": {small}"));
        }
    }
    text
}

/// A daemon with the shipped scenes accepts the pages' `curl` lines, in their order.
#[test]
fn curl_lines_are_accepted_by_a_daemon() {
    let daemon = Daemon::start_in(shipped, &[]);
    let client = daemon.client();
    let ready = |id: &str| client.get(&format!("/v1/scenes/{id}")).json()["state"] == "ready";
    eventually("the scenes are there", || ready("town") && ready("plaza"));
    let mut accepted = 0;
    for (here, curl) in curls() {
        let Some(target) = curl.target() else { continue };
        // `uploads.rs` sends files, `jobs/` waits for a job's products, and `admission.rs` retries and deletes uploads.
        if curl.files > 0 || target.starts_with("/v1/jobs/") || target.contains("/scenes/statue") {
            continue;
        }
        let headers: Vec<(&str, &str)> =
            curl.headers.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
        let body = curl.body.as_deref().map(smaller);
        let reply = client.send(
            curl.method(),
            &smaller(target),
            &headers,
            body.as_deref().map(str::as_bytes),
        );
        assert!(reply.status < 300, "{here}: {} {}", reply.status, reply.text());
        accepted += 1;
    }
    assert!(accepted >= 5, "{accepted} lines were sent");
}

/// Command lines of the program use only flags that exist.
#[test]
fn command_lines_are_understood() {
    let mut checked = 0;
    for block in blocks().iter().filter(|block| is_shell(block)) {
        for line in commands(block) {
            let words = words(&line);
            if words.first().is_none_or(|word| word.rsplit('/').next() != Some("pointillist")) {
                continue;
            }
            let parsed = <pointillist::cli::Cli as clap::Parser>::try_parse_from(&words);
            if let Err(error) = parsed {
                panic!("{}:{}: {line}\n{error}", block.page, block.line);
            }
            checked += 1;
        }
    }
    assert!(checked >= 8, "{checked} lines were found");
}

#[test]
fn shell_lines_are_taken_apart() {
    let found =
        curl(r#"curl -H 'A: b c' -o x 'http://127.0.0.1:8080/v1/jobs' -d '{"a": "b"}' # why"#)
            .unwrap();
    assert_eq!(found.headers, [("A".to_owned(), "b c".to_owned())]);
    assert_eq!((found.method(), found.target()), ("POST", Some("/v1/jobs")));
    assert_eq!(found.body.as_deref(), Some(r#"{"a": "b"}"#));
    assert!(curl("pointillist load http://127.0.0.1:8080").is_none());
}
