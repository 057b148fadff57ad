use super::*;
use crate::math::{Disk, Lens};
use glam::{DVec2, Vec3, dvec2, vec2};
use proptest::prelude::*;

/// The truth against another route: 720 points of the rim, projected, and their extremes. Between two points the outline
/// goes at most `1 − cos(π/720)` of its size beyond them, more where perspective spaces them unevenly.
#[test]
fn the_truth_is_what_projecting_the_rim_finds() {
    for (index, class) in cases::classes().iter().enumerate() {
        let mut random = SplitMix64::stream(7, index as u64);
        for _ in 0..40 {
            let case = class.draw(&mut random);
            let TrueSide::Regular(truth) = truth::truth(&case.disk, case.cutoff, &case.lens) else {
                continue;
            };
            // Finer than the rim's points by as much as perspective spreads them.
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
    let report = stability(3, 200);
    for row in &report.rows {
        assert!(row.holds, "{row:#?}");
    }
    assert!(report.holds);
    assert_eq!(report, stability(3, 200));
    let named = |name: &str| report.rows.iter().find(|row| row.class == name).unwrap();
    assert_eq!(named("ordinary").regular, 200);
    assert!(named("ordinary").ours_outline.worst_px < 1e-3);
    assert!(named("edge-on within 1e-12 rad").ours_box.worst_px < 1e-3);
    let crossing = named("about the camera plane");
    assert!(crossing.regular > 20 && crossing.regular < 180, "{crossing:?}");
}

#[test]
fn a_broken_bound_shows() {
    let mut judged = Judged::default();
    judged.add(0.0, 0.0);
    judged.add(1.0, 2.0);
    assert!(judged.holds());
    judged.add(f64::NAN, 2.0);
    assert!(!judged.holds());
    let mut report = stability(1, 2);
    report.rows[0].holds = false;
    report.rows[0].misclassified = 5;
    assert!(report.to_string().contains("BROKEN, 5 on the wrong side"));
    assert!(report.markdown().contains("| ordinary"));
}

/// Variance and determinant, which the table does not show: relative to their own size, with what the gap amplifies.
#[test]
fn variance_and_determinant_keep_their_digits() {
    for (index, class) in cases::classes().iter().enumerate() {
        let mut random = SplitMix64::stream(11, index as u64);
        for _ in 0..100 {
            let Case { disk, cutoff, lens } = class.draw(&mut random);
            let (TrueSide::Regular(truth), Side::Regular(image)) =
                (truth::truth(&disk, cutoff, &lens), disk.seen(cutoff, &lens))
            else {
                continue;
            };
            let (conic, [xx, xy, yy]) = (image.conic(), truth.variance());
            let tan = (truth.projected - lens.principal_px.as_dvec2()).length();
            let radii = DVec2::new(truth.x.length(), truth.y.length()).length();
            let input = radii + tan * truth.z.length();
            if radii.max(tan) > f64::from(crate::math::conic::LENGTH_MAX_PX) {
                continue; // shrunk
            }
            let (cutoff, step) = (f64::from(cutoff), 1e-6);
            let allowed =
                step * input * (input + radii / truth.gap) / truth.gap.powi(2) / cutoff.powi(2);
            for (found, expected) in conic.variance_px2.iter().zip([xx, xy, yy]) {
                let error = (f64::from(*found) - expected).abs();
                assert!(error <= allowed + 1e-30, "{class:?}: {error} {allowed} {expected}");
            }
            let root = truth.area().abs() / truth.gap.powf(1.5) / cutoff.powi(2);
            let error = (f64::from(conic.root_det_px2) - root).abs();
            assert!(error <= allowed + 1e-30, "{class:?}: {error} {allowed} {root}");
        }
    }
}

/// Any finite number: half of them of a size that scenes have, the rest with any bits.
fn number() -> impl Strategy<Value = f32> {
    let any = any::<u32>().prop_map(|bits| {
        let value = f32::from_bits(bits);
        if value.is_finite() { value } else { 0.0 }
    });
    prop_oneof![4 => -20f32..20.0, 3 => any, 1 => Just(0.0), 1 => Just(1e-45), 1 => Just(f32::MAX)]
}

fn vector() -> impl Strategy<Value = Vec3> {
    [number(), number(), number()].prop_map(Vec3::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_finite_disk_gives_finite_numbers_and_a_box_that_holds_it(
        centre in vector(), u in vector(), v in vector(), shrink in prop_oneof![Just(1f32), 1e-6f32..1.0],
        cutoff in 1f32..3.0, focal in 1f32..1e7, pixel in [-1e4f32..1e4, -1e4f32..1e4],
    ) {
        let disk = Disk { centre, tangents: [u * shrink, v * shrink] };
        let lens = Lens { focal_px: vec2(focal, focal * 0.9), principal_px: vec2(512.0, 300.0) };
        if let Side::Regular(image) = disk.seen(cutoff, &lens) {
            let conic = image.conic();
            prop_assert!(Outline::from(&conic).is_finite(), "{conic:?}");
            prop_assert!(conic.variance_px2.iter().all(|v| v.is_finite()), "{conic:?}");
            prop_assert!(conic.root_det_px2.is_finite(), "{conic:?}");
            for pixel in [pixel.into(), image.projected_px, conic.centre_px, conic.min_px] {
                prop_assert!(image.kernel_at(pixel).is_none_or(|k| k.is_finite()));
            }
            match truth::truth(&disk, cutoff, &lens) {
                TrueSide::Regular(truth) => {
                    let ([low, high], bound) = (truth.corners(), truth.bounds().box_px);
                    for axis in 0..2 {
                        prop_assert!(f64::from(conic.min_px[axis]) <= hold(low[axis]) + bound);
                        prop_assert!(f64::from(conic.max_px[axis]) >= hold(high[axis]) - bound);
                    }
                }
                side => prop_assert_eq!(side, TrueSide::Close),
            }
        }
    }
}
