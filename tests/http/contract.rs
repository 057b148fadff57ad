//! Compares the daemon with its contract: every answer is documented, and documented requests succeed.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::client::{raw, read_to_close};
use super::daemon::{Daemon, grid_ply};
use super::schema::Contract;

#[test]
fn the_contract_is_a_valid_one() {
    let contract = Contract::new();
    contract.compile_all();
    let mut ids = BTreeSet::new();
    for (path, method, operation) in contract.operations() {
        let id = operation["operationId"].as_str().unwrap();
        assert!(ids.insert(id), "{method} {path}: {id} is another operation's");
        let parameters: Vec<&Value> =
            operation["parameters"].as_array().into_iter().flatten().collect();
        let names = |place: &str| -> BTreeSet<&str> {
            let here = parameters.iter().filter(|parameter| parameter["in"] == place);
            here.map(|parameter| parameter["name"].as_str().unwrap()).collect()
        };
        let in_path: BTreeSet<&str> =
            path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}')).collect();
        assert_eq!(names("path"), in_path, "{method} {path}");
        // The OpenAPI standard ignores parameters of these names.
        for header in ["Accept", "Content-Type", "Authorization"] {
            assert!(!names("header").contains(header), "{method} {path}: {header}");
        }
        for parameter in &parameters {
            let shown = format!("{method} {path}: {}", parameter["name"]);
            assert!(!parameter["schema"].to_string().contains("null"), "{shown} may be null");
            let schema = &parameter["schema"];
            let is_bounded = match schema["type"].as_str() {
                Some("string") => {
                    parameter["in"] != "path"
                        || schema.get("pattern").or(schema.get("maxLength")).is_some()
                }
                Some("array") => schema.get("maxItems").is_some(),
                Some("integer") => schema.get("maximum").is_some(),
                _ => true,
            };
            assert!(is_bounded, "{shown}: {schema}");
        }
    }
    // References to schemas resolve, and arrays of numbers have a length.
    let mut rest = vec![&contract.0];
    while let Some(value) = rest.pop() {
        if let Some(target) = value.get("$ref").and_then(Value::as_str) {
            assert!(contract.0.pointer(&target[1..]).is_some(), "{target}");
        }
        if value["type"] == "array" && value["items"]["type"] == "number" {
            assert!(value.get("minItems").is_some() && value.get("maxItems").is_some(), "{value}");
        }
        assert!(value.get("allOf").is_none() || value.get("properties").is_none(), "{value}");
        rest.extend(value.as_object().into_iter().flat_map(|object| object.values()));
        rest.extend(value.as_array().into_iter().flatten());
    }
}

/// Bodies that schemas and daemon both accept, or both refuse.
#[test]
fn schemas_and_daemon_agree_on_bodies() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let contract = Contract::new();
    let keys = json!({ "keys": [{ "t": 0, "eye": [0, 0, 3], "target": [0, 0, 0] }] });
    let (jobs, frames, node) = ("/v1/jobs", "/v1/scenes/grid/frames", "/v1/scenes/grid/nodes/wall");
    let pick = "/v1/scenes/grid/pick";
    let (compare, accuracy) = ("/v1/scenes/grid/compare", "/v1/scenes/grid/accuracy");
    for (method, path, body, is_fine) in [
        (
            "POST",
            jobs,
            json!({ "scene": "grid", "path": "past", "w": 8, "h": 8, "want": ["frames"] }),
            true,
        ),
        (
            "POST",
            jobs,
            json!({ "scene": "grid", "path": keys, "w": 8, "h": 8, "reconstruct": "splats" }),
            true,
        ),
        (
            "POST",
            jobs,
            json!({ "scene": "grid", "path": "past", "w": 8.0, "h": 8.0, "to": 1.0 }),
            true,
        ),
        ("POST", jobs, json!({ "scene": "grid", "path": "past", "w": 8.5 }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": 3 }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": { "keys": [] } }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": "past", "camera": "front" }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": "past", "speed": 2 }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": "past", "want": [] }), false),
        ("POST", jobs, json!({ "scene": "grid", "path": "past", "w": 0 }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": { "lod": "full" }, "b": {} }), true),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": {}, "against": "reference" }), true),
        ("POST", compare, json!({ "w": 8, "h": 8, "b": {} }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": { "w": 8 }, "b": {} }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": { "lod": "half" }, "b": {} }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": {}, "b": {}, "format": "raw" }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": {}, "b": {}, "output": "id" }), false),
        ("POST", compare, json!({ "w": 8, "h": 8, "a": {}, "against": "oracle" }), false),
        ("POST", accuracy, json!({ "w": 0 }), false),
        ("POST", accuracy, json!({ "repeats": 101 }), false),
        ("POST", accuracy, json!({ "cameras": [] }), false),
        ("POST", accuracy, json!({ "seed": 1 }), false),
        ("POST", accuracy, json!({ "w": 8, "h": 8.0, "repeats": 1, "cameras": ["front"] }), true),
        ("POST", pick, json!({ "w": 8, "h": 8, "x": 1, "y": 2.0 }), true),
        ("POST", pick, json!({ "w": 8, "h": 8, "pixels": [[1, 2]], "lod": "full" }), true),
        ("POST", pick, json!({ "w": 8, "h": 8, "pixels": [[1, 2, 3]] }), false),
        ("POST", pick, json!({ "w": 8, "h": 8, "pixels": [] }), false),
        ("POST", pick, json!({ "w": 8, "h": 8, "x": 1, "y": 2, "format": "png" }), false),
        (
            "POST",
            frames,
            json!({ "w": 8, "h": 8, "poses": [{ "camera": "front" }, { "eye": [0, 0, 3], "target": [0, 0, 0] }] }),
            true,
        ),
        ("POST", frames, json!({ "poses": [] }), false),
        ("POST", frames, json!({ "poses": [{ "eye": [0, 0] }] }), false),
        ("POST", frames, json!({ "poses": [{}, { "format": "gif" }] }), false),
        ("POST", frames, json!({ "poses": [{ "fov": 180 }] }), false),
        ("POST", frames, json!({ "poses": [{ "fov": 5e-324 }] }), false),
        ("POST", frames, json!({ "poses": [{ "wait": "none" }] }), false),
        ("POST", frames, json!({ "poses": [{}], "quality": 101 }), false),
        ("POST", frames, json!({ "poses": [{}], "w": 20000 }), false),
        ("POST", frames, json!({ "poses": [{ "deadline_ms": 0 }] }), false),
        ("PATCH", node, json!({ "translate": [1, 2, 3], "scale": -2, "visible": true }), true),
        (
            "PATCH",
            node,
            json!({ "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1] }),
            true,
        ),
        ("PATCH", node, json!({ "scale": [1, 0, 1] }), false),
        ("PATCH", node, json!({ "scale": 1e-10 }), false),
        ("PATCH", node, json!({ "translate": [1e13, 0, 0] }), false),
        ("PATCH", node, json!({ "matrix": vec![1; 16] }), false),
        ("PATCH", node, json!({}), false),
    ] {
        let (_, operation) = contract.operation(method, path).unwrap();
        let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
        let faults = contract.faults(schema, &body);
        assert_eq!(faults.is_empty(), is_fine, "{method} {path} {body}: {faults:?}");
        let json = [("content-type", "application/json")];
        let reply = client.send(method, path, &json, Some(body.to_string().as_bytes()));
        let status = reply.status;
        assert!(
            if is_fine { status < 300 } else { status == 422 },
            "{body}: {status} {}",
            reply.text()
        );
    }
}

/// The pattern and the daemon accept the same keys. Blanks and tabs around a key belong to the header.
#[test]
fn keys_of_jobs_are_as_their_pattern_says() {
    let daemon = Daemon::start(&[]);
    let contract = Contract::new();
    let (_, operation) = contract.operation("POST", "/v1/jobs").unwrap();
    let parameters = operation["parameters"].as_array().unwrap();
    let key = parameters.iter().find(|of| of["name"] == "Idempotency-Key").unwrap();
    let body = json!({ "scene": "grid", "path": "past", "w": 8, "h": 8 }).to_string();
    for (value, is_fine) in [
        ("a", true),
        (" a b \t", true),
        ("\"", true),
        ("a\tb", false),
        ("é", false),
        (" ", false),
        (&"x".repeat(256), false),
    ] {
        let faults = contract.faults(&key["schema"], &json!(value));
        assert_eq!(faults.is_empty(), is_fine, "{value:?}: {faults:?}");
        let request = format!(
            "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nIdempotency-Key:{value}\r\n\r\n{body}",
            body.len()
        );
        let answer = read_to_close(&mut raw(daemon.address, request.as_bytes()));
        let status = if is_fine { "HTTP/1.1 201" } else { "HTTP/1.1 422" };
        assert!(answer.starts_with(status), "{value:?}: {answer}");
    }
}

/// The HTTP library's answers to malformed requests are problems, too.
#[test]
fn heads_that_cannot_be_read_are_problems() {
    let daemon = Daemon::start(&[]);
    let contract = Contract::new();
    let many = (0..100).map(|number| format!("x-{number}: 1\r\n")).collect::<String>();
    for (status, kind, request) in [
        (
            400,
            "malformed-request",
            "GET / HTTP/1.1\r\nHost: localhost\r\nno colon\r\n\r\n".to_owned(),
        ),
        (400, "malformed-request", "GARBAGE THAT IS NO REQUEST\r\n\r\n".to_owned()),
        (431, "head-too-large", format!("GET / HTTP/1.1\r\nHost: localhost\r\n{many}\r\n")),
        (
            431,
            "head-too-large",
            format!("GET / HTTP/1.1\r\nHost: localhost\r\nx: {}\r\n\r\n", "y".repeat(60 << 10)),
        ),
        (
            431,
            "head-too-large",
            format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "y".repeat(60 << 10)),
        ),
    ] {
        let answer = read_to_close(&mut raw(daemon.address, request.as_bytes()));
        let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{answer}"));
        assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{head}");
        assert!(head.contains("content-type: application/problem+json"), "{head}");
        assert!(head.contains(&format!("content-length: {}", body.len())), "{head}");
        let problem: Value = serde_json::from_str(body).unwrap();
        assert_eq!(problem["type"], format!("urn:pointillist:problem:{kind}"));
        assert_eq!(contract.faults(contract.component("Problem"), &problem), [] as [String; 0]);
    }
    // A complete answer precedes the refusal.
    let mixed = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGARBAGE\r\n\r\n";
    let answer = read_to_close(&mut raw(daemon.address, mixed.as_bytes()));
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("HTTP/1.1 400 "), "{answer}");
}

#[test]
fn routes_and_methods_that_are_not_there_are_problems() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for (method, path, status, kind) in [
        ("GET", "/v1/scene", 404, "unknown-route"),
        ("GET", "/v1/scenes/", 404, "unknown-route"),
        ("GET", "/v1/scenes//frame", 404, "unknown-scene"),
        ("POST", "/v1/limits", 405, "method-not-allowed"),
        ("DELETE", "/v1/jobs", 405, "method-not-allowed"),
        ("GET", "/v1/jobs?state=lost", 422, "bad-parameter"),
        ("GET", "/v1/limits?all=true", 422, "unknown-parameter"),
    ] {
        let reply = client.send(method, path, &[], None);
        assert_eq!(reply.status, status, "{method} {path}: {}", reply.text());
        assert_eq!(
            reply.problem()["type"],
            format!("urn:pointillist:problem:{kind}"),
            "{method} {path}"
        );
        assert_eq!(reply.header("allow").is_some(), status == 405, "{method} {path}");
    }
}

#[test]
fn answers_are_documented() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let contract = Contract::new();
    let document = &contract.0;
    let ply = grid_ply();
    let json = "application/json";
    let frame = "/v1/scenes/{id}/frame";
    let frames = "/v1/scenes/{id}/frames";
    let pick = "/v1/scenes/{id}/pick";
    let compare = "/v1/scenes/{id}/compare";
    let accuracy = "/v1/scenes/{id}/accuracy";
    let cancel = "/v1/scenes/{id}/accuracy/cancel";
    let stream = "/v1/scenes/{id}/stream";
    let mjpeg = "/v1/scenes/{id}/mjpeg";
    let path = "/v1/scenes/{id}/paths/{name}";
    let node = "/v1/scenes/{id}/nodes/{node}";
    // A job of two frames.
    let film = r#"{"scene": "grid", "w": 8, "h": 8, "fps": 1, "path": {"keys": [
        {"t": 0, "eye": [0, 0, 3], "target": [0, 0, 0]}, {"t": 1, "eye": [1, 0, 3], "target": [0, 0, 0]}]}}"#;
    for (method, route, path, content_type, body) in [
        ("GET", "/", "/", "", ""),
        ("GET", "/healthz", "/healthz", "", ""),
        ("GET", "/readyz", "/readyz", "", ""),
        ("GET", "/metrics", "/metrics", "", ""),
        ("GET", "/openapi.yaml", "/openapi.yaml", "", ""),
        ("GET", "/v1/limits", "/v1/limits", "", ""),
        ("GET", "/v1/scene-schema.json", "/v1/scene-schema.json", "", ""),
        ("GET", "/v1/scenes", "/v1/scenes", "", ""),
        ("GET", "/v1/scenes/{id}", "/v1/scenes/grid", "", ""),
        ("GET", "/v1/scenes/{id}", "/v1/scenes/none", "", ""),
        ("GET", frame, "/v1/scenes/grid/frame?w=8&h=8", "", ""),
        ("GET", frame, "/v1/scenes/grid/frame?w=8&h=8&format=raw", "", ""),
        ("GET", frame, "/v1/scenes/grid/frame?w=8&h=8&output=depth&format=pfm", "", ""),
        ("GET", frame, "/v1/scenes/grid/frame?x=8", "", ""),
        ("GET", frame, "/v1/scenes/none/frame", "", ""),
        ("GET", "/viewer/{file}", "/viewer/app.js", "", ""),
        ("GET", "/viewer/{file}", "/viewer/style.css", "", ""),
        ("GET", "/viewer/{file}", "/viewer/none.js", "", ""),
        ("GET", path, "/v1/scenes/grid/paths/past", "", ""),
        ("GET", path, "/v1/scenes/grid/paths/none", "", ""),
        ("GET", path, "/v1/scenes/none/paths/past", "", ""),
        ("GET", mjpeg, "/v1/scenes/grid/mjpeg?path=past&w=8&h=8", "", ""),
        ("GET", mjpeg, "/v1/scenes/grid/mjpeg?path=none", "", ""),
        ("GET", mjpeg, "/v1/scenes/none/mjpeg", "", ""),
        ("GET", stream, "/v1/scenes/grid/stream", "", ""),
        ("GET", stream, "/v1/scenes/grid/stream?deadline_ms=5", "", ""),
        ("GET", stream, "/v1/scenes/none/stream", "", ""),
        ("POST", frames, "/v1/scenes/grid/frames", json, "{\"poses\":[{}],\"w\":8,\"h\":8}"),
        ("POST", frames, "/v1/scenes/grid/frames", "text/plain", "{}"),
        ("POST", frames, "/v1/scenes/grid/frames", json, "{}"),
        ("GET", pick, "/v1/scenes/grid/pick?camera=front&w=8&h=8&x=4&y=4", "", ""),
        ("GET", pick, "/v1/scenes/grid/pick?w=8&h=8&x=8&y=4", "", ""),
        ("GET", pick, "/v1/scenes/none/pick?x=8&y=4", "", ""),
        ("POST", pick, "/v1/scenes/grid/pick", json, "{\"pixels\":[[1,2],[3,4]],\"w\":8,\"h\":8}"),
        ("POST", pick, "/v1/scenes/grid/pick", "text/plain", "{}"),
        ("POST", pick, "/v1/scenes/grid/pick", json, "{}"),
        ("POST", compare, "/v1/scenes/grid/compare", json, "{\"a\":{},\"b\":{},\"w\":8,\"h\":8}"),
        ("POST", compare, "/v1/scenes/grid/compare", "text/plain", "{}"),
        ("POST", compare, "/v1/scenes/grid/compare", json, "{\"a\":{}}"),
        ("POST", compare, "/v1/scenes/none/compare", json, "{\"a\":{},\"b\":{}}"),
        ("GET", accuracy, "/v1/scenes/grid/accuracy", "", ""),
        ("POST", accuracy, "/v1/scenes/grid/accuracy", json, "{\"w\":0}"),
        ("POST", accuracy, "/v1/scenes/grid/accuracy", json, "{\"w\":8,\"h\":8}"),
        ("POST", accuracy, "/v1/scenes/grid/accuracy", json, "{}"),
        ("GET", accuracy, "/v1/scenes/grid/accuracy", "", ""),
        ("POST", cancel, "/v1/scenes/grid/accuracy/cancel", "", ""),
        ("POST", cancel, "/v1/scenes/none/accuracy/cancel", "", ""),
        ("DELETE", accuracy, "/v1/scenes/grid/accuracy", "", ""),
        ("DELETE", accuracy, "/v1/scenes/grid/accuracy", "", ""),
        ("POST", "/v1/scenes", "/v1/scenes?id=a&name=a.ply", "application/octet-stream", &ply),
        ("POST", "/v1/scenes", "/v1/scenes?id=a&name=a.ply", "application/octet-stream", &ply),
        ("POST", "/v1/scenes", "/v1/scenes?name=b.ply", "application/octet-stream", "ply"),
        ("PATCH", node, "/v1/scenes/grid/nodes/wall", json, "{\"visible\":false}"),
        ("PATCH", node, "/v1/scenes/grid/nodes/none", json, "{\"visible\":false}"),
        ("GET", "/v1/jobs", "/v1/jobs", "", ""),
        ("POST", "/v1/jobs", "/v1/jobs", json, film),
        ("POST", "/v1/jobs", "/v1/jobs", json, "{}"),
        ("POST", "/v1/jobs", "/v1/jobs", "text/plain", "{}"),
        ("POST", "/v1/jobs", "/v1/jobs", json, "{\"scene\": \"none\", \"path\": \"p\"}"),
        ("GET", "/v1/jobs/{id}", "/v1/jobs/1", "", ""),
        ("GET", "/v1/jobs/{id}", "/v1/jobs/2", "", ""),
        ("GET", "/v1/jobs/{id}/events", "/v1/jobs/1/events", "", ""),
        ("GET", "/v1/jobs/{id}/frames", "/v1/jobs/1/frames", "", ""),
        ("GET", "/v1/jobs/{id}/frames/{n}", "/v1/jobs/1/frames/0", "", ""),
        ("GET", "/v1/jobs/{id}/frames/{n}", "/v1/jobs/1/frames/99", "", ""),
        ("GET", "/v1/jobs/{id}/multipart", "/v1/jobs/1/multipart", "", ""),
        ("GET", "/v1/jobs/{id}/video.mp4", "/v1/jobs/1/video.mp4", "", ""),
        ("POST", "/v1/jobs/{id}/cancel", "/v1/jobs/1/cancel", "", ""),
        ("POST", "/v1/jobs/{id}/resume", "/v1/jobs/2/resume", "", ""),
        ("DELETE", "/v1/jobs/{id}", "/v1/jobs/1", "", ""),
        ("DELETE", "/v1/jobs/{id}", "/v1/jobs/1", "", ""),
        ("DELETE", "/v1/scenes/{id}", "/v1/scenes/a", "", ""),
        ("DELETE", "/v1/scenes/{id}", "/v1/scenes/a", "", ""),
    ] {
        let headers = [("content-type", content_type)];
        let reply = match content_type {
            "" => client.send(method, path, &[], None),
            _ => client.send(method, path, &headers, Some(body.as_bytes())),
        };
        let operation = &document["paths"][route][method.to_lowercase()];
        let response = &operation["responses"][reply.status.to_string()];
        assert!(response.is_object(), "{method} {path}: {} is not documented", reply.status);
        if let Some(found) = reply.header("content-type") {
            let found = found.split(';').next().unwrap();
            let documented = response["content"].as_object().unwrap();
            assert!(documented.contains_key(found), "{method} {path}: {found}");
        }
        let kind = reply.header("content-type").unwrap_or_default();
        if kind.ends_with("json") {
            let schema = &response["content"][kind]["schema"];
            let faults = contract.faults(schema, &reply.json());
            assert!(faults.is_empty(), "{method} {path}: {faults:?}");
        }
        check_schema(document, response, &reply);
    }
}

/// Checks that a JSON answer has the required properties of its schema and no unknown ones.
fn check_schema(document: &Value, response: &Value, reply: &super::client::Reply) {
    let problem = response["content"]["application/problem+json"]["schema"]["$ref"].as_str();
    let Some(name) = problem.and_then(|r| r.strip_prefix("#/components/schemas/")) else { return };
    let schema = &document["components"]["schemas"][name];
    let body = reply.json();
    for required in schema["required"].as_array().unwrap() {
        assert!(body.get(required.as_str().unwrap()).is_some(), "{required} in {body}");
    }
    for key in body.as_object().unwrap().keys() {
        assert!(schema["properties"].get(key).is_some(), "{key} is not in the schema");
    }
}

#[test]
fn receipts_match_their_schema() {
    let daemon = Daemon::start(&[]);
    let receipt = daemon.client().get("/v1/scenes/grid/frame?w=8&h=8").receipt();
    let contract = Contract::new();
    let schema = contract.component("Receipt");
    assert_eq!(contract.faults(schema, &receipt), [] as [String; 0]);
    let schema = &schema["properties"];
    let known: Vec<&String> = schema.as_object().unwrap().keys().collect();
    let found: Vec<&String> = receipt.as_object().unwrap().keys().collect();
    assert_eq!(known, found);
}
