use super::*;
use crate::accuracy::cost::Curve;
use crate::accuracy::journal::{PathRecord, PoseRecord};
use crate::accuracy::temporal::Change;

fn metrics(mse: f64) -> Metrics {
    let coverage = Coverage {
        covered_reference: 10,
        covered_image: 9,
        holes: 2,
        leaks: 1,
        silhouette_iou: 0.8,
        ..Coverage::default()
    };
    let spread = |max| Some(Spread { pixels: 8, max, mean: 0.2, median: 0.1, p99: 0.9 });
    let others = OtherMetrics {
        ssim: 0.9,
        flip: 0.1,
        max_error: 9,
        coverage,
        depth: spread(mse),
        normal_deg: None,
    };
    Metrics { mse, others: Some(others) }
}

fn given(number: u32) -> Box<Given> {
    let mut given = Given::default();
    given.set_text("edl_strength", &number.to_string()).unwrap();
    given.set_text("reconstruct", "splats").unwrap();
    Box::new(given)
}

/// Results of two poses and five rows: two on the front, one that is beaten, one that is drawn as another and one that is refused.
pub(crate) fn results() -> Results {
    let row = |label: &str| Row {
        label: label.into(),
        family: label[..3].into(),
        given: if label == "good way" { Given::default() } else { *given(1) },
        scale: 1.0,
    };
    let rows = ["fast way", "good way", "beaten way", "other way", "gone <way>"].map(row);
    let mut records = Vec::new();
    let poses = ["front", "back & side"];
    for (number, pose) in poses.iter().enumerate() {
        let (pose, more) = ((*pose).to_owned(), number as f64);
        for (index, (row, mse, ms)) in
            [("fast way", 65.025 + more, 1.0), ("good way", 6.5025, 4.0), ("beaten way", 70.0, 8.0)]
                .into_iter()
                .enumerate()
        {
            let (row, metrics, drawn) =
                (row.to_owned(), Box::new(metrics(mse)), given(index as u32));
            records.push(Record::Image {
                pose: pose.clone(),
                row: row.clone(),
                metrics,
                drawn,
                notes: vec![],
            });
            for repeat in 0..3 {
                let gpu_ms = ms * (1.0 + 0.1 * f64::from(repeat)) + more;
                records.push(Record::Time { pose: pose.clone(), row: row.clone(), repeat, gpu_ms });
            }
        }
        let notes = vec![format!("reason {number}")];
        records.push(Record::Same {
            pose: pose.clone(),
            row: "other way".into(),
            same_as: "good way".into(),
            notes,
        });
        records.push(Record::Refused { pose, row: "gone <way>".into(), why: "too large".into() });
    }
    for (row, same_as, pop_px) in
        [("good way", None, 0), ("other way", Some("good way"), 0), ("beaten way", None, 7)]
    {
        let energy = 4.0 + 4.0 * f64::from(u8::from(pop_px > 0));
        let change = Change { energy, pop_px, pops: u64::from(pop_px > 0) };
        for (frame, change) in [(3, None), (4, Some(change))] {
            let (row, same_as) = (row.to_owned(), same_as.map(str::to_owned));
            records.push(Record::Frame { frame, row, same_as, mse: 10.0, change });
        }
    }
    let (row, why) = ("gone <way>".to_owned(), "too large".to_owned());
    records.push(Record::FrameRefused { frame: 3, row, why });
    let pose = |(number, name): (usize, &str)| PoseRecord {
        name: name.into(),
        folder: format!("{}-pose", number + 1),
        eye: [0.0; 3],
        target: [0.0; 3],
        up: [0.0; 3],
        fov_deg: Some(40.0),
        ortho_height: None,
    };
    let identity = Identity {
        version: "1".into(),
        adapter: "A".into(),
        scene: "scene.json".into(),
        tag: "t".into(),
        width: 4,
        height: 3,
        repeats: 3,
        seed: 1,
        reference: "the reference".into(),
        poses: poses.into_iter().enumerate().map(pose).collect(),
        rows: rows.iter().map(|row| row.label.clone()).collect(),
        path: Some(PathRecord {
            name: "fly [1]".into(),
            fps: 30.0,
            from: 3,
            to: 4,
            cameras: "c".into(),
            rows: rows.iter().map(|row| row.label.clone()).collect(),
        }),
    };
    Results::new(identity, "2026-01-02".into(), &rows, &records)
}

#[test]
fn fronts_and_prices_are_computed_for_each_pose_and_for_all() {
    let results = results();
    let names: Vec<&str> = results.scopes.iter().map(|scope| scope.name.as_str()).collect();
    assert_eq!(names, [ALL_POSES, "front", "back & side"]);
    let front = &results.scopes[1];
    assert_eq!(front.fronts["psnr"], ["fast way", "good way"]);
    assert_eq!(front.default.as_deref(), Some("good way"));
    let price = front.price.unwrap();
    assert!((price.from_db - 30.0).abs() < 1e-9 && (price.to_db - 40.0).abs() < 1e-9);
    assert!(
        (price.times - 4.0).abs() < 1e-9
            && (price.times_per_db.unwrap() - 4f64.powf(0.1)).abs() < 1e-9
    );
    assert_eq!(front.plotted().count(), 3);
    let other = front.entry("other way").unwrap();
    assert_eq!(other.same_as.as_deref(), Some("good way"));
    assert_eq!(other.notes, ["reason 0"]);
    assert_eq!(other.gpu_ms, front.entry("good way").unwrap().gpu_ms);
    assert_eq!(front.refused, [("gone <way>".to_owned(), "too large".to_owned())]);
    let all = &results.scopes[0];
    let fast = all.entry("fast way").unwrap();
    assert!((fast.metrics.mse - 65.525).abs() < 1e-9);
    assert!((fast.gpu_ms.unwrap().median - 1.6).abs() < 1e-9);
    let others = fast.metrics.others.as_ref().unwrap();
    assert_eq!(others.coverage.holes, 4);
    assert!((others.coverage.silhouette_iou - 16.0 / 22.0).abs() < 1e-12);
    assert!((others.depth.unwrap().max - 66.025).abs() < 1e-9);
}

#[test]
fn the_summary_says_what_a_decibel_costs() {
    let results = results();
    assert!(
        results.summary.starts_with("From 29.9 dB to 40.0 dB costs 3.06× the time"),
        "{}",
        results.summary
    );
    assert!(results.summary.contains("fast way (1.60 ms, 29.9 dB)"), "{}", results.summary);
    let one = Scope::new("p", None, &[], vec![results.scopes[1].entries[0].clone()]);
    let text = summary(&one, 5);
    assert!(text.contains("the fastest is fast way") && text.contains("No slower"), "{text}");
    // A frame that equals the reference has no decibels.
    let mut entries = results.scopes[1].entries.clone();
    let exact = entries.iter_mut().find(|entry| entry.row == "good way").unwrap();
    (exact.psnr_db, exact.metrics.mse) = (None, 0.0);
    let text = summary(&Scope::new("p", None, &[], entries), 5);
    assert!(text.contains("good way equals the reference and takes"), "{text}");
    assert!(!text.contains("inf"), "{text}");
    assert!(summary(&Scope::new("p", None, &[], Vec::new()), 5).starts_with("No setting"));
}

#[test]
fn prices_of_few_timed_frames_are_called_rough() {
    let mut entries = results().scopes[1].entries.clone();
    let best = entries.iter_mut().find(|entry| entry.row == "beaten way").unwrap();
    (best.psnr_db, best.metrics.mse) = (Some(50.0), 0.65025);
    let scope = Scope::new("p", None, &[], entries);
    assert_eq!(scope.fronts["psnr"], ["fast way", "good way", "beaten way"]);
    let (few, enough) = (summary(&scope, 4), summary(&scope, 5));
    let rough =
        "more time on average (rough: each setting was timed fewer than 5 times). The fastest";
    assert!(few.contains(rough) && !few.contains("neighbours"), "{few}");
    assert!(!enough.contains("rough") && enough.contains("Between neighbours"), "{enough}");
}

#[test]
fn a_drawing_that_turns_out_to_be_another_rows_is_not_plotted() {
    let row = |label: &str| Row {
        label: label.into(),
        family: "a".into(),
        given: Given::default(),
        scale: 1.0,
    };
    let image = |row: &str| Record::Image {
        pose: "p".into(),
        row: row.into(),
        metrics: Box::new(metrics(1.0)),
        drawn: given(1),
        notes: vec![],
    };
    let scope = Scope::of_pose("p", "1-p", &["a", "b"].map(row), &[image("a"), image("b")]);
    assert_eq!(scope.entries[1].same_as.as_deref(), Some("a"));
    // Both rows give nothing, so the first of them is the default.
    assert_eq!(scope.default.as_deref(), Some("a"));
}

#[test]
fn numbers_have_three_digits() {
    assert_eq!(
        [0.01234, 1.2345, 12.345, 123.45, 1234.5].map(three_digits),
        ["0.0123", "1.23", "12.3", "123", "1234"]
    );
    assert_eq!(three_digits(f64::NAN), "–");
}

/// Noise that makes the times of "fast way" reach those of "good way" leaves the front as it is and changes the price. The combined report has that price, too.
#[test]
fn prices_leave_out_settings_within_the_noise() {
    let clear = results();
    let scope = &clear.scopes[0];
    assert_eq!((scope.fronts["psnr"].len(), scope.steps.len()), (2, 1));
    let mut entries = scope.entries.clone();
    for entry in entries.iter_mut().filter(|entry| entry.row == "fast way") {
        entry.gpu_ms = entry.gpu_ms.map(|time| Quartiles { high: 100.0, ..time });
    }
    let noisy = Scope::new(ALL_POSES, None, &[], entries);
    assert_eq!(noisy.fronts, scope.fronts);
    assert_eq!((noisy.steps.len(), noisy.price), (0, None));
    let told = |scope: Scope| {
        let found = Results { scopes: vec![scope], ..clear.clone() };
        Curve::read(&serde_json::to_string(&found).unwrap()).unwrap().price
    };
    assert_eq!(told(noisy), None);
    assert_eq!(told(scope.clone()), scope.price);
}
