//! The alert rules and the dashboard in `deploy/` name metrics that the server has.

use std::collections::BTreeSet;

use super::daemon::Daemon;

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
    for (file, text) in [
        ("prometheus-rules.yaml", include_str!("../../deploy/prometheus-rules.yaml")),
        ("grafana-dashboard.json", include_str!("../../deploy/grafana-dashboard.json")),
    ] {
        let named = names(text);
        assert!(named.len() > 5, "{file}: {named:?}");
        let missing: Vec<_> = named.difference(&served).collect();
        assert!(missing.is_empty(), "{file} names metrics that /metrics lacks: {missing:?}");
    }
    let dashboard = include_str!("../../deploy/grafana-dashboard.json");
    let dashboard: serde_json::Value = serde_json::from_str(dashboard).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    assert!(panels.iter().all(|panel| panel["targets"][0]["expr"].is_string()));
}
