//! The alert rules, the dashboard and the autoscaler in `deploy/` name metrics that the server has.

use std::collections::BTreeSet;

use super::daemon::{Daemon, eventually};
use super::servers::prometheus;

/// Names of metrics in a text.
fn names(text: &str) -> BTreeSet<String> {
    text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
        .filter(|word| word.starts_with("pointillist_"))
        .map(str::to_owned)
        .collect()
}

#[test]
fn rules_and_dashboard_name_metrics_that_exist() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/grid/frame?w=8&h=8").status, 200);
    let served = names(&client.get("/metrics").text());
    for (file, text, least) in [
        ("prometheus-rules.yaml", include_str!("../../deploy/prometheus-rules.yaml"), 10),
        ("prometheus-rules-test.yaml", include_str!("../../deploy/prometheus-rules-test.yaml"), 10),
        ("grafana-dashboard.json", include_str!("../../deploy/grafana-dashboard.json"), 10),
        ("autoscaler.yaml", include_str!("../../deploy/kubernetes/autoscaler.yaml"), 1),
    ] {
        let named = names(text);
        assert!(named.len() >= least, "{file}: {named:?}");
        let missing: Vec<_> = named.difference(&served).collect();
        assert!(missing.is_empty(), "{file} names metrics that /metrics lacks: {missing:?}");
    }
    let dashboard = include_str!("../../deploy/grafana-dashboard.json");
    let dashboard: serde_json::Value = serde_json::from_str(dashboard).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    assert!(panels.iter().all(|panel| panel["targets"][0]["expr"].is_string()));
}

/// A real Prometheus loads the rules, scrapes the daemon, finds nothing wrong, and answers every query of the dashboard.
#[test]
fn prometheus_understands_rules_metrics_and_dashboard() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    assert_eq!(client.get("/v1/scenes/grid/frame?w=8&h=8").status, 200);
    let Some(server) = prometheus(daemon.address) else { return };
    let prometheus = server.client();
    let query = |expression: &str| {
        let address = format!("/api/v1/query?query={}", encoded(expression));
        let reply = prometheus.get(&address);
        assert_eq!(reply.status, 200, "{expression}: {}", reply.text());
        reply.json()["data"]["result"].as_array().unwrap().clone()
    };
    // Rates need two samples.
    eventually("two scrapes", || {
        query("count_over_time(up{job=\"pointillist\"}[1m]) >= 3 and up == 1").len() == 1
    });
    eventually("rules that were evaluated", || {
        let rules = prometheus.get("/api/v1/rules").json();
        let rules = rules["data"]["groups"][0]["rules"].as_array().unwrap().clone();
        assert!(rules.len() > 5);
        rules.iter().all(|rule| {
            assert_ne!(rule["health"], "err", "{rule}");
            rule["health"] == "ok"
        })
    });
    assert!(query("ALERTS").is_empty(), "a daemon that has just started is well");
    let phases = query("pointillist_phase == 1");
    assert_eq!((phases.len(), &phases[0]["metric"]["phase"]), (1, &"serving".into()));
    let dashboard = include_str!("../../deploy/grafana-dashboard.json");
    let dashboard: serde_json::Value = serde_json::from_str(dashboard).unwrap();
    for panel in dashboard["panels"].as_array().unwrap() {
        for target in panel["targets"].as_array().unwrap() {
            let expression = target["expr"].as_str().unwrap().replace("$instance", ".*");
            assert!(!expression.contains('$'), "{expression}");
            assert!(!query(&expression).is_empty(), "no data for {expression}");
        }
    }
}

fn encoded(text: &str) -> String {
    let byte = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'_' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    text.bytes().map(byte).collect()
}
