use glam::dvec2;

use super::*;
use crate::gpu::shader;
use crate::passes::shaders::{Choices, composed};

/// Compares the truth with the extremes of 720 projected points of the rim. Between two points the outline extends beyond them by
/// at most `1 − cos(π/720)` of its size, and by more where perspective spaces them unevenly.
#[test]
fn the_truth_is_what_projecting_the_rim_finds() {
    for (index, class) in cases::classes().iter().enumerate() {
        let mut random = SplitMix64::stream(7, index as u64);
        for _ in 0..40 {
            let case = class.draw(&mut random);
            let TrueSide::Regular(truth) = truth::truth(&case.disk, case.cutoff, &case.lens) else {
                continue;
            };
            // Perspective spreads the rim's points, so the tolerance grows with it.
            let slack = 2e-5 / truth.gap;
            let (p, [u, v]) =
                (case.disk.centre.as_dvec3(), case.disk.tangents.map(|t| t.as_dvec3()));
            let focal = case.lens.focal_px.as_dvec2();
            let rim = |i: u32| {
                let angle = f64::from(i) * std::f64::consts::TAU / 720.0;
                let (sin, cos) = angle.sin_cos();
                let q = p + (u * cos + v * sin) * f64::from(case.cutoff);
                dvec2(q.x, q.y) / q.z * focal + case.lens.principal_px.as_dvec2()
            };
            for i in 0..DIRECTIONS {
                let d = direction(i);
                let found = (0..720).map(|i| rim(i).dot(d)).fold(f64::NEG_INFINITY, f64::max);
                let [low, high] = truth.extent(d);
                let size = high - low;
                let error = truth.support(d) - found;
                let rounding = 1e-11 * (truth.projected.length() + size) / truth.gap;
                assert!(
                    error >= -rounding && error <= slack * size + rounding,
                    "{class:?}: {error} of {size}"
                );
            }
        }
    }
}

#[test]
fn the_report_holds_and_repeats() {
    let report = stability(3, 200).unwrap();
    for row in &report.rows {
        assert!(row.holds, "{row:#?}");
    }
    assert!(report.holds);
    assert_eq!(report, stability(3, 200).unwrap());
    // Disks thinner than rounding can resolve are left to the outline.
    let judged = report.rows.iter().filter(|row| row.exact_judged > 0).count();
    assert!(judged >= 21, "{judged} classes");
    let named = |name: &str| report.rows.iter().find(|row| row.class == name).unwrap();
    assert_eq!(named("ordinary").regular, 200);
    assert!(named("ordinary").ours_outline.worst_px < 1e-2);
    assert!(named("ordinary").exact_judged > 10 * named("ordinary").exact_unresolved);
    assert!(named("edge-on within 1e-12 rad").ours_box.worst_px < 1e-2);
    let crossing = named("about the camera plane");
    assert!(crossing.regular > 20 && crossing.regular < 180, "{crossing:?}");
}

/// Where the truth can tell kernel coordinates, a formula that gives none is wrong.
#[test]
fn a_filter_without_coordinates_does_not_hold() {
    let mut random = SplitMix64::stream(9, 0);
    let case = cases::classes()[0].draw(&mut random);
    let TrueSide::Regular(truth) = truth::truth(&case.disk, case.cutoff, &case.lens) else {
        panic!("the first class lies before the camera plane");
    };
    let mut judged = Judged::default();
    for pixel in points_px(&TrueSide::Regular(truth)) {
        if let Some((error, bound)) = truth.kernel_error(pixel, None) {
            judged.add(error, bound);
        }
    }
    assert!(!judged.holds(), "{judged:?}");
}

#[test]
fn a_broken_bound_shows() {
    let mut judged = Judged::default();
    judged.add(0.0, 0.0);
    judged.add(1.0, 2.0);
    assert!(judged.holds());
    judged.add(f64::NAN, 2.0);
    assert!(!judged.holds());
    let row = Row { class: "ordinary".to_owned(), misclassified: 5, ..Row::default() };
    let adapter = "a GPU".to_owned();
    let report = Stability {
        adapter,
        seed: 1,
        count: 2,
        condition_max: 1.0,
        rows: vec![row],
        holds: false,
        scenes: Vec::new(),
    };
    assert!(report.to_string().contains("BROKEN, 5 on the wrong side"));
    assert!(report.markdown().contains("| ordinary"));
}

#[test]
fn pixel_boxes_are_judged_by_half_pixels() {
    let low = |pixel, truth| edge_error_px(pixel, truth, 70.0, true);
    let high = |pixel, truth| edge_error_px(pixel, truth, 70.0, false);
    // The first pixel centre behind 8.6 is that of pixel 9.
    assert_eq!((low(9, 8.6), low(9, 9.5)), (0.0, 0.0));
    assert!((low(9, 8.25) - 0.25).abs() < 1e-12 && (low(9, 10.0) - 0.5).abs() < 1e-12);
    assert_eq!((high(9, 9.5), high(9, 10.4)), (0.0, 0.0));
    assert!((high(9, 9.25) - 0.25).abs() < 1e-12 && (high(9, 11.0) - 0.5).abs() < 1e-12);
    // Boxes are clipped to the image, and contain the disk's own pixel.
    assert_eq!((low(0, -1e9), high(16_383, 1e9)), (0.0, 0.0));
    assert_eq!((low(70, 70.9), high(70, 70.1)), (0.0, 0.0));
    assert!(low(70, 69.0) > 0.4 && high(70, 72.0) > 0.4);
}

/// The layout of the shader's records matches WGSL.
#[test]
fn records_agree_with_the_shader() {
    let shader = composed("measure/measure_splats", &Choices::default()).unwrap();
    let module = shader::parse("measure_splats", &shader).unwrap();
    let offsets = |record: &str| -> Vec<usize> {
        let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(record)).unwrap();
        let naga::TypeInner::Struct { members, span } = &found.1.inner else { panic!("{record}") };
        members.iter().map(|member| member.offset as usize).chain([*span as usize]).collect()
    };
    assert_eq!(offsets("Probe"), Probe::OFFSETS);
    assert_eq!(offsets("Found"), Found::OFFSETS);
}
