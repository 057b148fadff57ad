//! Concurrent jobs, and resources that they share: bakes, watchers, names.

use std::io::{BufRead, BufReader};

use serde_json::{Value, json};

use super::{create, drawn, ended, fly, job, name_path, post, studio, when};
use crate::client::{raw, read_to_close};
use crate::daemon::{Daemon, eventually, grid_scene, wall_ply};

#[test]
fn a_long_job_keeps_no_short_one_waiting() {
    let daemon = studio(&[]);
    let client = daemon.client();
    let long = create(&client, json!({"fps": 1000}));
    drawn(&client, &long, 5);
    for _ in 0..2 {
        let short = create(&client, json!({"to": 4}));
        ended(&client, &short, "done");
        let found = job(&client, &long);
        assert_eq!(found["state"], "running", "{found}");
    }
    assert_eq!(client.get("/v1/limits").json()["jobs"]["max_drawing"], 4);
    client.send("DELETE", &format!("/v1/jobs/{long}"), &[], None);

    // With a single runner, jobs run one at a time, in order of creation.
    let daemon = studio(&["--job-runners", "1"]);
    let client = daemon.client();
    let long = create(&client, json!({"fps": 1000}));
    drawn(&client, &long, 5);
    let short = create(&client, json!({"to": 4}));
    drawn(&client, &long, 60);
    assert_eq!(job(&client, &short)["state"], "queued");
    post(&client, &format!("/v1/jobs/{long}/cancel"));
    ended(&client, &short, "done");
}

/// A daemon with a second scene `many`, whose trees take long to build.
fn orchard() -> Daemon {
    Daemon::start_in(
        |root| {
            name_path(root);
            let (mut assets, mut nodes) = (json!({}), Vec::new());
            for number in 0..24 {
                // Each wall has its own content.
                let file = format!("wall{number}.ply");
                std::fs::write(root.join(&file), wall_ply(160 + number)).unwrap();
                assets[&file] = json!({ "file": file });
                nodes.push(json!({ "asset": file, "translate": [0, 0, number] }));
            }
            let mut scene = grid_scene("grid.ply");
            scene["assets"] = assets;
            scene["nodes"] = json!(nodes);
            scene["paths"] = json!({ "fly": fly() });
            std::fs::write(root.join("many.json"), scene.to_string()).unwrap();
        },
        &[],
    )
}

#[test]
fn baking_is_a_stage_that_can_be_given_up() {
    let daemon = orchard();
    let client = daemon.client();
    let baking = || json!({"scene": "many", "lod": "spt", "color_by": "levels", "to": 3});
    let id = create(&client, baking());
    let found = when(&client, &id, "baking", |job| job["stage"] == "baking");
    assert_eq!(found["state"], "running");
    let part = found["baked"].as_f64().unwrap();
    assert!((0.0..=1.0).contains(&part), "{part}");
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/cancel")).json()["state"], "cancelled");
    eventually("the end of the bake", || daemon.log().contains("baking is given up"));
    // When resumed, the job finishes the bake and is drawn. Other jobs do not wait for the bake.
    assert_eq!(post(&client, &format!("/v1/jobs/{id}/resume")).status, 200);
    let other = create(&client, json!({"to": 2}));
    ended(&client, &other, "done");
    assert_eq!(ended(&client, &id, "done")["frames"]["done"], 4);
    let log = daemon.log();
    let place = |text: &str| log.find(text).unwrap_or_else(|| panic!("no `{text}` in\n{log}"));
    assert!(
        place(&format!("job goes on job={other}")) < place("trees over instances built"),
        "{log}"
    );

    // A daemon that stops does not wait for a bake.
    let daemon = orchard();
    let id = create(&daemon.client(), baking());
    when(&daemon.client(), &id, "baking", |job| job["stage"] == "baking");
    let daemon = daemon.restart(&["--drain-seconds", "5"]);
    assert_eq!(ended(&daemon.client(), &id, "done")["frames"]["done"], 4);
}

#[test]
fn frames_are_named_after_their_job() {
    let daemon = Daemon::start_talkative_in(name_path, &[]);
    let client = daemon.client();
    let headers = [("content-type", "application/json"), ("x-request-id", "films.3")];
    let body = super::body(json!({"to": 5})).to_string();
    let made = client.send("POST", "/v1/jobs", &headers, Some(body.as_bytes())).json();
    assert_eq!(made["request_id"], "films.3");
    ended(&client, "1", "done");
    eventually("the frame's spans", || {
        let log = daemon.log();
        let lines: Vec<Value> = log
            .lines()
            .filter(|line| line.contains("job-1/4"))
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect();
        let closed = |span: &str| {
            lines.iter().any(|line| {
                line["fields"]["message"] == "close"
                    && line["span"]["name"] == span
                    && line["span"]["request_id"] == "job-1/4"
            })
        };
        let in_batch = lines.iter().any(|line| {
            let frames = &line["span"]["frames"];
            frames.as_str().is_some_and(|frames| frames.contains("job-1/4"))
        });
        closed("queue") && closed("encode") && in_batch
    });
    // The log leads from the frame's id to the job, and from there to the request that created it.
    let log = daemon.log();
    let begun = log.lines().find(|line| line.contains("job goes on")).unwrap();
    assert!(begun.contains("\"films.3\"") && begun.contains("\"job\":1"), "{begun}");
}

#[test]
fn watchers_are_few_and_come_again() {
    let daemon = studio(&["--max-watchers-per-client", "1", "--watch-seconds", "1"]);
    let client = daemon.client();
    let limits = client.get("/v1/limits").json()["jobs"].clone();
    let told = (&limits["max_watchers_per_client"], &limits["watch_ms"]);
    assert_eq!(told, (&json!(1), &json!(1000)));
    // A job that waits for its scene has no events.
    let id = create(&client, json!({"fps": 1000}));
    drawn(&client, &id, 3);
    assert_eq!(client.send("DELETE", "/v1/scenes/grid", &[], None).status, 204);
    let waiting = when(&client, &id, "the wait", |job| job["waits_for"].is_string());
    let events = format!(
        "GET /v1/jobs/{id}/events HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    );
    let mut first = BufReader::new(raw(daemon.address, events.as_bytes()));
    let mut line = String::new();
    while !line.contains("event: job") {
        line.clear();
        assert!(first.read_line(&mut line).unwrap() > 0);
    }
    for path in ["events", "multipart"] {
        let refused = client.get(&format!("/v1/jobs/{id}/{path}"));
        let problem = refused.problem();
        assert_eq!(problem["type"], "urn:pointillist:problem:busy", "{problem}");
        assert!(problem["accepted"].as_str().unwrap().contains("max_watchers_per_client"));
        assert!(refused.header("retry-after").is_some());
    }
    // The stream ends with a reason, and its place becomes free.
    let mut rest = String::new();
    std::io::Read::read_to_string(&mut first, &mut rest).unwrap();
    assert!(rest.contains("event: reconnect") && rest.contains("its limit of 1 seconds"), "{rest}");
    let next = waiting["frames"]["done"].as_u64().unwrap();
    let whole = format!(
        "GET /v1/jobs/{id}/multipart?from={next} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    );
    eventually("a place", || {
        let text = read_to_close(&mut raw(daemon.address, whole.as_bytes()));
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        if !head.contains("200 OK") {
            return false;
        }
        assert!(
            body.contains("frame-not-drawn") && body.contains("its limit of 1 seconds"),
            "{body}"
        );
        assert!(body.contains(&format!("multipart?from={next}")), "{body}");
        true
    });
    for query in ["from=x", "from=-1", "from=1&from=2", "form=3"] {
        let refused = client.get(&format!("/v1/jobs/{id}/multipart?{query}"));
        assert_eq!(refused.status, 422, "{query}: {}", refused.text());
    }
}
