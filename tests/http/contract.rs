//! The contract against the daemon: what is answered is documented, and success needs no guessing.

use serde_json::Value;

use super::daemon::{Daemon, grid_ply};

/// The document as JSON, from the same types as `openapi.yaml`.
fn document() -> Value {
    pointillist::http::openapi_json().unwrap()
}

#[test]
fn answers_are_documented() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let document = document();
    let ply = grid_ply();
    let json = "application/json";
    let frame = "/v1/scenes/{id}/frame";
    let frames = "/v1/scenes/{id}/frames";
    let stream = "/v1/scenes/{id}/stream";
    let mjpeg = "/v1/scenes/{id}/mjpeg";
    let path = "/v1/scenes/{id}/paths/{name}";
    let node = "/v1/scenes/{id}/nodes/{node}";
    // A film of two frames.
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
        check_schema(&document, response, &reply);
    }
}

/// Required properties of a JSON answer's schema are there, and there are no others.
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
    let document = document();
    let schema = &document["components"]["schemas"]["Receipt"]["properties"];
    let known: Vec<&String> = schema.as_object().unwrap().keys().collect();
    let found: Vec<&String> = receipt.as_object().unwrap().keys().collect();
    assert_eq!(known, found);
}
