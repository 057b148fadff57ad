use std::time::Duration;

use super::super::knee::Demands;
use super::super::run::Rates;
use super::super::schedule::Spacing;
use super::super::tally::{Answer, Outcome, Sample, Tally};
use super::*;

/// A point of one second with `requests` requests. The first `frames` take 1 ms, 2 ms, …; the others are lost or refused by
/// turns.
pub fn point(requests: u64, frames: u64) -> JudgedPoint {
    let mut tally = Tally::new(Duration::ZERO, Duration::from_secs(1));
    for number in 0..requests {
        let answer = Answer {
            status: if number < frames { 200 } else { 503 },
            bytes: 50_000,
            has_retry_after: true,
            receipt: None,
            complaint: None,
        };
        let outcome = match number {
            number if number >= frames && number % 2 == 0 => Outcome::TimedOut,
            _ => Outcome::Answered(answer),
        };
        let done = Duration::from_millis(1 + number.min(frames));
        tally.record(Sample { due: Duration::ZERO, begun: Duration::ZERO, done, outcome });
    }
    let verdict = if frames == requests { Verdict::KeepsUp } else { Verdict::Unanswered };
    JudgedPoint { verdict, point: tally.point(requests as f64) }
}

/// That point with a stream beside it. Of its ten poses every second one is drawn, 10 ms after it was due.
pub fn point_with_stream(requests: u64, frames: u64) -> JudgedPoint {
    use super::super::following::{Following, StreamTally};
    use super::super::wire::FrameAnswer;
    let mut judged = point(requests, frames);
    let mut tally = StreamTally::new(1, Duration::ZERO, Duration::from_secs(1));
    let mut stream = Following::default();
    for seq in 1..=10u64 {
        let due = Duration::from_millis(50 * seq);
        stream.due(seq, due);
        if seq % 2 == 0 {
            let receipt = crate::engine::Receipt::default();
            let header = serde_json::json!({
                "frame": seq, "seq": seq, "quality": "moving", "scale": 1.0, "receipt": receipt,
            });
            let frame: FrameAnswer = serde_json::from_value(header).unwrap();
            tally.frame(&mut stream, &frame, 1000, due + Duration::from_millis(10));
        }
    }
    tally.ended(&stream);
    judged.point.streams = Some(tally.point());
    judged
}

#[test]
fn streams_have_a_table_of_their_own() {
    let text = report(vec![point(40, 40)]).to_string();
    assert!(!text.contains("overtaken"), "{text}");
    let report = report(vec![point_with_stream(40, 40)]);
    let text = report.to_string();
    let row = text.lines().skip_while(|line| !line.contains("overtaken")).nth(1).unwrap();
    let cells: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(cells[..3], ["40.0", "1", "10.0"], "{text}");
    assert!(cells.contains(&"5–5") && cells.contains(&"10.0"), "{text}");
    let json = serde_json::to_value(&report).unwrap();
    let streams = &json["points"][0]["streams"];
    assert_eq!((&streams["overtaken"], &streams["frames"]), (&5.into(), &5.into()));
    assert!(report.points[0].line().contains("1 streams: 5.00 frames/s"));
}

pub fn report(points: Vec<JudgedPoint>) -> Report {
    let knee =
        Knee { keeps_up_to_per_s: Some(80.0), is_bounded: true, most_throughput_per_s: 95.0 };
    Report {
        target: "127.0.0.1:8080".into(),
        scene: "<town> & \"country\"".into(),
        revision: 1,
        client: "request",
        poses: PathKind::Orbit,
        parameters: vec![("w".into(), "64".into()), ("format".into(), "jpeg".into())],
        adapter: Some("a <software> adapter".into()),
        settings_used: serde_json::Value::Null,
        generator: Generator::here(),
        run: RunSettings {
            rates: Rates::Given(vec![1.0]),
            spacing: Spacing::Poisson,
            seed: 1,
            warmup_s: 0.0,
            duration_s: 1.0,
            timeout_s: 10.0,
            connections_at_most: 8,
            demands: Demands::new(Duration::from_secs(1)),
            streams: 0,
            poses_per_s: 30.0,
        },
        points,
        knee: Some(knee),
        connections_opened: 3,
        interrupted: false,
        warnings: Vec::new(),
        thresholds: Thresholds::default(),
        broken_thresholds: Vec::new(),
    }
    .finish()
}

#[test]
fn the_table_has_a_row_a_rate_in_order() {
    let text = report(vec![point(200, 90), point(40, 40), point(80, 80)]).to_string();
    let rows: Vec<&str> =
        text.lines().filter(|line| line.contains("keeps up") || line.contains("leaves")).collect();
    assert_eq!(rows.len(), 4, "{text}");
    assert!(rows[0].trim_start().starts_with("40.0"), "{text}");
    assert!(rows[2].contains("lost") && rows[2].contains("without a frame"), "{text}");
    assert!(rows[3].starts_with("keeps up with 80.0/s; at most 95.0 frames/s"), "{text}");
}

#[test]
fn json_says_null_for_what_never_came() {
    let json = serde_json::to_value(report(vec![point(200, 90)])).unwrap();
    let point = &json["points"][0];
    assert_eq!(point["latency"]["p99_ns"], serde_json::Value::Null);
    assert!(point["latency"]["p50_ns"].is_u64(), "{point}");
    assert_eq!(point["verdict"], "unanswered");
    assert_eq!(point["counts"]["refused"], 55);
    assert_eq!(json["knee"]["keeps_up_to_per_s"], 80.0);
    assert_eq!(json["run"]["rates"]["given"][0], 1.0);
}

#[test]
fn what_takes_from_the_figures_is_said() {
    let mut late = point(10, 10);
    late.point.begun_late_p99_ns = Some(20_000_000);
    late.point.counts.not_sent = 3;
    late.point.receipts.coalesced = 2;
    late.point.first_failure = Some("404: there is no such scene".into());
    let text = report(vec![late]).to_string();
    for said in ["20.0 ms late", "3 requests were not sent", "2 frames were drawn for", "404"] {
        assert!(text.contains(said), "{said}: {text}");
    }
}

#[test]
fn numbers_have_three_digits() {
    let found = [0.0, 0.01234, 0.9999, 1.234, 12.34, 99.97, 1234.5].map(three_digits);
    assert_eq!(found, ["0", "0.012", "1.00", "1.23", "12.3", "100", "1234"]);
}
