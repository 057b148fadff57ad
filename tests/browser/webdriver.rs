//! A minimal client of the W3C WebDriver protocol, over plain HTTP to `chromedriver`.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// A browser with one page, closed when dropped.
pub struct Browser {
    agent: ureq::Agent,
    session: String,
    driver: Child,
    _profile: tempfile::TempDir,
}

/// Finds a `chromedriver` that can be started.
pub fn find_driver() -> Option<String> {
    let candidates = [std::env::var("CHROMEDRIVER").unwrap_or_default(), "chromedriver".into()];
    candidates.into_iter().filter(|name| !name.is_empty()).find(|name| {
        let probe = Command::new(name).arg("--version").stdout(Stdio::null()).status();
        probe.is_ok_and(|status| status.success())
    })
}

impl Browser {
    /// Starts chromedriver on a port of its choice and a headless Chromium with a fresh profile.
    pub fn start(driver: &str, width: u32, height: u32) -> Browser {
        let (driver, port) = start_driver(driver);
        let profile = tempfile::tempdir().expect("a folder for the profile");
        let agent: ureq::Agent = ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs(60)))
            .http_status_as_error(false)
            .build()
            .into();
        let base = format!("http://127.0.0.1:{port}");
        let mut options = json!({
            "args": [
                "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                "--disable-dev-shm-usage",
                format!("--window-size={width},{height}"),
                format!("--user-data-dir={}", profile.path().display()),
            ],
        });
        if let Ok(binary) = std::env::var("CHROMIUM") {
            options["binary"] = json!(binary);
        }
        let answer = call(
            &agent,
            "POST",
            &format!("{base}/session"),
            json!({ "capabilities": { "alwaysMatch": {
                "browserName": "chrome",
                "goog:chromeOptions": options,
                "goog:loggingPrefs": { "browser": "ALL" },
            } } }),
        );
        let id = answer["sessionId"].as_str().expect("a session id").to_owned();
        Browser { agent, session: format!("{base}/session/{id}"), driver, _profile: profile }
    }

    fn post(&self, path: &str, body: Value) -> Value {
        call(&self.agent, "POST", &format!("{}/{path}", self.session), body)
    }

    pub fn open(&self, url: &str) {
        self.post("url", json!({ "url": url }));
    }

    /// Runs a function body in the page and returns what it returns.
    pub fn script(&self, body: &str) -> Value {
        self.post("execute/sync", json!({ "script": body, "args": [] }))
    }

    /// Waits until a function body returns a truthy value, and returns it.
    pub fn wait_for(&self, what: &str, limit: Duration, body: &str) -> Value {
        let until = Instant::now() + limit;
        loop {
            let found = self.script(body);
            let truthy = match &found {
                Value::Null | Value::Bool(false) => false,
                Value::String(text) => !text.is_empty(),
                Value::Number(number) => number.as_f64() != Some(0.0),
                _ => true,
            };
            if truthy {
                return found;
            }
            assert!(
                Instant::now() < until,
                "{what}: not within {limit:?}; the page says: {}",
                self.script("return document.body.innerText")
            );
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Drags with a pointer through points (x, y) in CSS pixels: pressed at the first, released at the last.
    pub fn drag(&self, pointer: &str, button: u32, points: &[(i64, i64)]) {
        let mut actions = Vec::new();
        for (index, (x, y)) in points.iter().enumerate() {
            let duration_ms = if index == 0 { 0 } else { 60 };
            actions.push(json!({ "type": "pointerMove", "duration": duration_ms, "x": x, "y": y, "origin": "viewport" }));
            if index == 0 {
                actions.push(json!({ "type": "pointerDown", "button": button }));
            }
        }
        actions.push(json!({ "type": "pointerUp", "button": button }));
        let source = json!({ "type": "pointer", "id": format!("{pointer}-1"), "parameters": { "pointerType": pointer }, "actions": actions });
        self.post("actions", json!({ "actions": [source] }));
    }

    /// Moves two fingers from a distance of `from` to one of `to` CSS pixels, around a centre.
    pub fn pinch(&self, centre: (i64, i64), from: i64, to: i64) {
        let finger = |name: &str, side: i64| {
            let at = |distance: i64, duration_ms: u32| json!({ "type": "pointerMove", "duration": duration_ms, "x": centre.0 + side * distance, "y": centre.1, "origin": "viewport" });
            json!({ "type": "pointer", "id": name, "parameters": { "pointerType": "touch" }, "actions": [
                at(from, 0), { "type": "pointerDown", "button": 0 }, at((from + to) / 2, 60), at(to, 60),
                { "type": "pointerUp", "button": 0 },
            ] })
        };
        self.post("actions", json!({ "actions": [finger("left", -1), finger("right", 1)] }));
    }

    pub fn wheel(&self, at: (i64, i64), delta_y: i64) {
        self.post(
            "actions",
            json!({ "actions": [{ "type": "wheel", "id": "wheel", "actions": [
                { "type": "scroll", "x": at.0, "y": at.1, "deltaX": 0, "deltaY": delta_y, "duration": 0, "origin": "viewport" },
            ] }] }),
        );
    }

    /// Presses and releases a key. Special keys are given by their code points in the WebDriver standard.
    pub fn key(&self, key: char) {
        self.post(
            "actions",
            json!({ "actions": [{ "type": "key", "id": "keys", "actions": [
                { "type": "keyDown", "value": key }, { "type": "keyUp", "value": key },
            ] }] }),
        );
    }

    /// Presses a key and holds it, or releases it.
    pub fn hold(&self, key: char, is_down: bool) {
        let kind = if is_down { "keyDown" } else { "keyUp" };
        self.post(
            "actions",
            json!({ "actions": [{ "type": "key", "id": "keys", "actions": [{ "type": kind, "value": key }] }] }),
        );
    }

    /// Passes files to an `<input type="file">`, as its dialogue would.
    pub fn choose_files(&self, selector: &str, files: &[&str]) {
        let element = self.post("element", json!({ "using": "css selector", "value": selector }));
        let id = element.as_object().and_then(|element| element.values().next());
        let id = id.and_then(Value::as_str).expect("an element's id");
        self.post(&format!("element/{id}/value"), json!({ "text": files.join("\n") }));
    }

    /// Drops files and folders onto the page, as from a file manager.
    pub fn drop_from_disk(&self, at: (i64, i64), files: &[&str]) {
        for kind in ["dragEnter", "dragOver", "drop"] {
            let data = json!({ "items": [], "files": files, "dragOperationsMask": 1 });
            let params = json!({ "type": kind, "x": at.0, "y": at.1, "data": data });
            self.post(
                "goog/cdp/execute",
                json!({ "cmd": "Input.dispatchDragEvent", "params": params }),
            );
        }
    }

    /// Adds a script that every page runs before its own.
    pub fn before_pages(&self, script: &str) {
        self.post(
            "goog/cdp/execute",
            json!({ "cmd": "Page.addScriptToEvaluateOnNewDocument", "params": { "source": script } }),
        );
    }

    /// Sets a media feature such as `prefers-reduced-motion`.
    pub fn emulate_media(&self, feature: &str, value: &str) {
        let params = json!({ "features": [{ "name": feature, "value": value }] });
        self.post(
            "goog/cdp/execute",
            json!({ "cmd": "Emulation.setEmulatedMedia", "params": params }),
        );
    }

    /// Emulates a mobile screen of another size and density.
    pub fn emulate(&self, width: u32, height: u32, density: f64) {
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": density, "mobile": true });
        self.post(
            "goog/cdp/execute",
            json!({ "cmd": "Emulation.setDeviceMetricsOverride", "params": metrics }),
        );
        self.post(
            "goog/cdp/execute",
            json!({ "cmd": "Emulation.setTouchEmulationEnabled", "params": { "enabled": true } }),
        );
    }

    /// Console errors since the last call.
    pub fn console_errors(&self) -> Vec<String> {
        let log = self.post("se/log", json!({ "type": "browser" }));
        let entries = log.as_array().expect("a list of log entries");
        entries
            .iter()
            .filter(|e| e["level"] == "SEVERE")
            .map(|e| e["message"].to_string())
            .collect()
    }

    /// Saves a screenshot of the window as a PNG.
    pub fn screenshot(&self, file: &Path) {
        let answer = call(&self.agent, "GET", &format!("{}/screenshot", self.session), Value::Null);
        let png = decode_base64(answer.as_str().expect("a picture in base64"));
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("the folder can be made");
        std::fs::write(file, png).expect("the screenshot can be written");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // This ends Chromium; chromedriver must be ended after it. Ignore errors, because a failing test must not panic twice.
        let _ = self.agent.delete(&self.session).call();
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

/// Starts chromedriver on a port of its choice.
///
/// Given port 0, chromedriver takes a free port for one version of IP and then binds the same number for the other. It
/// ends with "port not available" where another process holds that number, as servers of tests beside this one do, so
/// it is started again with another port.
fn start_driver(program: &str) -> (Child, u16) {
    const ATTEMPTS: usize = 20;
    let mut said = Vec::new();
    for _ in 0..ATTEMPTS {
        let mut driver = Command::new(program)
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("chromedriver starts");
        match announced_port(&mut driver) {
            Ok(port) => return (driver, port),
            Err(output) => said.push(output),
        }
        driver.kill().expect("chromedriver can be ended");
        driver.wait().expect("chromedriver ends");
    }
    panic!("chromedriver found no port in {ATTEMPTS} attempts; it said: {said:#?}");
}

/// Reads the port from "… started successfully on port N.", or returns all output where that line is missing. A thread
/// drains the rest of the output.
fn announced_port(driver: &mut Child) -> Result<u16, String> {
    let stdout = driver.stdout.take().expect("chromedriver's output");
    let mut lines = BufReader::new(stdout).lines().map_while(Result::ok);
    let mut said = String::new();
    let port = lines.by_ref().find_map(|line| {
        said += &format!("{line}\n");
        let (_, rest) = line.split_once("successfully on port ")?;
        rest.trim_end_matches('.').parse().ok()
    });
    std::thread::spawn(move || lines.for_each(drop));
    port.ok_or(said)
}

/// Runs a WebDriver command and returns its `value`.
fn call(agent: &ureq::Agent, method: &str, url: &str, body: Value) -> Value {
    let mut response = match method {
        "GET" => agent.get(url).call(),
        _ => agent.post(url).send_json(&body),
    }
    .unwrap_or_else(|error| panic!("{method} {url}: {error}"));
    let text = response
        .body_mut()
        .with_config()
        .limit(64 << 20)
        .read_to_string()
        .expect("chromedriver answers in text");
    let answer: Value = serde_json::from_str(&text).expect("chromedriver answers in JSON");
    let value = answer["value"].clone();
    assert!(value.get("error").is_none(), "{method} {url} with {body}: {value}");
    value
}

/// Decodes base64.
pub fn decode_base64(text: &str) -> Vec<u8> {
    let digit = |byte: u8| match byte {
        b'A'..=b'Z' => Some(u32::from(byte - b'A')),
        b'a'..=b'z' => Some(u32::from(byte - b'a') + 26),
        b'0'..=b'9' => Some(u32::from(byte - b'0') + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let digits: Vec<u32> = text.bytes().filter_map(digit).collect();
    let mut bytes = Vec::with_capacity(digits.len() * 3 / 4);
    for group in digits.chunks(4) {
        let word =
            group.iter().enumerate().fold(0, |word, (i, digit)| word | digit << (18 - 6 * i));
        bytes.extend_from_slice(&word.to_be_bytes()[1..group.len()]);
    }
    bytes
}
