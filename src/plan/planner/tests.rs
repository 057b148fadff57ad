use glam::DVec3;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::*;
use crate::bake::spacing::Patch;
use crate::math::Camera;
use crate::plan::Reconstruct;

const COUNT: f64 = 1e6;

/// A surface of samples, seen from a distance, in a frame of this width.
fn ground_at(distance: f64, width: u32) -> Ground {
    let patch = |x: f64| Patch {
        centre: DVec3::new(x, 0.0, 0.0),
        radius: 0.5,
        spacing: 0.002,
        count: COUNT / 4.0,
    };
    let patches: Vec<Patch> = [-0.75, -0.25, 0.25, 0.75].map(patch).into();
    let camera = Camera::perspective(DVec3::new(0.0, 0.0, distance), DVec3::ZERO, 40.0);
    Ground::new([&patches, &[], &[]], &camera.view(width, width / 2).unwrap())
}

fn given(pairs: &[(&str, &str)]) -> Given {
    let mut given = Given::default();
    pairs.iter().for_each(|(name, value)| given.set_text(name, value).unwrap());
    given
}

const FULL: &[(&str, &str)] = &[("lod", "full"), ("reconstruct", "splats")];
const TREES: &[(&str, &str)] = &[("lod", "spt"), ("max_error_px", "1"), ("reconstruct", "splats")];
const COARSE: &[(&str, &str)] = &[("lod", "spt"), ("max_error_px", "4"), ("reconstruct", "points")];
const FINE: &[(&str, &str)] = &[("lod", "full"), ("reconstruct", "splats"), ("antialias", "4x")];

/// A time that the linear model can express, with factors of its own for each row, and an error that grows with the distance of samples.
fn point(row: usize, given: &Given, ground: &Ground) -> Point {
    point_at(row, given, 1.0, ground)
}

/// Time and error of a frame that is drawn at a scale.
fn point_at(row: usize, given: &Given, scale: f64, ground: &Ground) -> Point {
    let effort = effort(given, scale);
    let load = ground.load(effort.error_px);
    let ms = 0.5 + 1e-5 * ground.pixels * effort.parts + 2e-5 * load.samples;
    let db = [36.0, 34.0, 28.0, 44.0][row] + 12.0 * scale.log2() - 10.0 * ground.covered.log10();
    Point { mse: 65025.0 / 10f64.powf(0.1 * db), ms }
}

fn rows() -> Vec<(&'static str, Given)> {
    [("splats full", FULL), ("splats spt 1 px", TREES), ("points spt 4 px", COARSE), ("fine", FINE)]
        .map(|(label, pairs)| (label, given(pairs)))
        .into()
}

fn planner() -> (Planner, Vec<Ground>) {
    let places = [1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0];
    let grounds: Vec<Ground> = places
        .iter()
        .enumerate()
        .map(|(at, &distance)| ground_at(distance, [320, 640][at % 2]))
        .collect();
    let row = |(index, (label, given)): (usize, (&str, Given)), scale: f64| MeasuredRow {
        label: if scale < 1.0 { format!("{label} size={scale}") } else { label.to_owned() },
        given,
        scale,
        points: grounds.iter().map(|ground| Some(point_at(index, &given, scale, ground))).collect(),
    };
    let sizes = [1.0, 0.5, 0.25].into_iter();
    let rows =
        sizes.flat_map(|scale| rows().into_iter().enumerate().map(move |found| row(found, scale)));
    let rows = rows.collect();
    let planner = Planner::fit(&Measured { poses: Vec::new(), rows }, &grounds);
    (planner, grounds)
}

fn asked(pairs: &[(&str, &str)]) -> Settings {
    given(pairs).resolve().unwrap()
}

fn choose(planner: &Planner, pairs: &[(&str, &str)], ground: &Ground) -> Option<Chosen> {
    let asked = asked(pairs);
    planner.choose(
        &asked.goal()?,
        &planner.asked(&asked),
        std::slice::from_ref(ground),
        &Paces::default(),
        |_| true,
    )
}

#[test]
fn predictions_hit_frames_between_measured_ones() {
    let (planner, _) = planner();
    for (distance, width) in [(1.7, 400), (2.5, 500), (5.0, 320), (10.0, 640), (10.0, 1600)] {
        let ground = ground_at(distance, width);
        for (row, (label, given)) in rows().iter().enumerate() {
            let found = planner.rows[row].model.predict(&ground, 1.0);
            let truth = point(row, given, &ground);
            let db = 10.0 * (65025.0 / truth.mse).log10();
            assert!(
                (found.ms / truth.ms).ln().abs() < 0.05,
                "{label} at {distance}: {found:?}, {truth:?}"
            );
            assert!((found.psnr_db - db).abs() < 0.3, "{label} at {distance}: {found:?}, {db}");
            assert!(found.most_ms >= found.ms && found.least_psnr_db < found.psnr_db);
            let slow = planner.rows[row].model.predict(&ground, 2.0);
            assert!((slow.ms / found.ms - 2.0).abs() < 1e-9);
        }
    }
}

#[test]
fn a_budget_gets_the_most_exact_setting_and_an_error_the_fastest() {
    let (planner, grounds) = planner();
    let ground = &grounds[4];
    let ample = choose(&planner, &[("budget_ms", "1000")], ground).unwrap();
    assert_eq!(ample.plan.chosen.as_ref().unwrap().setting, "fine");
    assert_eq!((ample.plan.keeps, ample.settings.parts()), (Some(true), 2));
    assert!(ample.settings.goal().is_none());
    let times: Vec<f64> = ample.plan.alternatives.iter().map(|one| one.ms).collect();
    assert!(times.is_sorted() && !times.is_empty(), "{times:?}");
    let none = choose(&planner, &[("budget_ms", "0.01")], ground).unwrap();
    assert_eq!(none.plan.keeps, Some(false));
    assert_eq!(ample.plan.unpromised(), None);
    let told = none.plan.unpromised().unwrap();
    let reason = "the goal of 0.01 ms is not promised: no setting is known to keep 0.01 ms; this is the fastest one";
    assert!(told.starts_with(reason), "{told}");
    let chosen = none.plan.chosen.clone().unwrap();
    assert_eq!(chosen.setting, "points spt 4 px");
    let predicted = format!(
        "; the prediction for `points spt 4 px` is at most {} ms and at least {} dB",
        chosen.most_ms, chosen.least_psnr_db
    );
    assert!(told.ends_with(&predicted), "{told}");
    let unmeasured =
        Goal { most_ms: Some(20.0), least_db: Some(30.0) }.unplanned("of a test".into());
    let expected = "the goal of 20 ms and 30 dB is not promised: of a test";
    assert_eq!(unmeasured.unpromised().as_deref(), Some(expected));

    let drawn = |ms| ample.plan.clone().of_drawn(ms);
    assert_eq!(
        [Some(1000.0), Some(1000.1), None].map(|ms| drawn(ms).in_budget),
        [Some(true), Some(false), None]
    );
    assert_eq!(drawn(Some(1000.0)).warning(), None);
    let told = drawn(Some(1234.567)).warning().unwrap();
    let expected = "the frame took 1234.57 ms, longer than the 1000 ms that were promised";
    assert!(told.starts_with(expected), "{told}");
    // A budget that was not promised is not broken.
    let late = none.plan.clone().of_drawn(Some(5.0));
    assert_eq!((late.in_budget, late.warning()), (Some(false), late.unpromised()));
    let without_budget = choose(&planner, &[("min_psnr_db", "20")], ground).unwrap().plan;
    assert_eq!(without_budget.of_drawn(Some(1.0)).in_budget, None);

    let own_db = 10.0 * (65025.0 / point(1, &rows()[1].1, ground).mse).log10();
    let least = format!("{}", (own_db - 1.5).floor());
    let exact = choose(&planner, &[("min_psnr_db", &least)], ground).unwrap();
    assert_eq!(exact.plan.chosen.as_ref().unwrap().setting, "splats spt 1 px", "{:?}", exact.plan);
    assert_eq!(exact.plan.keeps, Some(true));
    let exact = choose(&planner, &[("min_psnr_db", "90")], ground).unwrap();
    assert_eq!(exact.plan.chosen.unwrap().setting, "fine");
    assert_eq!(exact.plan.keeps, Some(false));
    let both = choose(&planner, &[("min_psnr_db", &least), ("budget_ms", "0.02")], ground).unwrap();
    assert_eq!(both.plan.keeps, Some(false));
}

#[test]
fn figures_that_miss_a_goal_do_not_look_as_if_they_kept_it() {
    let (planner, _) = planner();
    let found = Prediction { ms: 19.991, most_ms: 20.001, psnr_db: 31.239, least_psnr_db: 29.996 };
    let shown = planner.alternative(0, &found);
    assert_eq!((shown.ms, shown.most_ms), (20.0, 20.01));
    assert_eq!((shown.psnr_db, shown.least_psnr_db), (31.23, 29.99));
}

#[test]
fn what_is_given_stays() {
    let (planner, grounds) = planner();
    let ground = &grounds[4];
    let label = |pairs: &[(&str, &str)]| {
        let chosen = choose(&planner, pairs, ground)?;
        Some((chosen.plan.chosen.unwrap().setting, chosen.settings))
    };
    let budget = ("budget_ms", "1000");
    assert_eq!(label(&[budget, ("lod", "spt")]).unwrap().0, "splats spt 1 px");
    assert_eq!(label(&[budget, ("reconstruct", "points")]).unwrap().0, "points spt 4 px");
    assert_eq!(label(&[budget, ("reconstruct", "auto")]).unwrap().0, "fine");
    assert_eq!(label(&[budget, ("antialias", "off")]).unwrap().0, "splats full");
    // An upper bound, with and without a level of detail.
    let (found, settings) = label(&[budget, ("max_error_px", "2"), ("lod", "spt")]).unwrap();
    assert_eq!((found.as_str(), settings.max_error_px.px()), ("splats spt 1 px", 1.0));
    assert_eq!(
        label(&[("budget_ms", "0.01"), ("max_error_px", "2")]).unwrap().0,
        "splats spt 1 px"
    );
    // What no row varies is kept in all of them.
    let (_, settings) = label(&[budget, ("filter", "exact"), ("background", "#102030")]).unwrap();
    let kept = asked(&[("filter", "exact"), ("background", "#102030")]);
    assert_eq!((settings.filter, settings.background), (kept.filter, kept.background));
    assert!(label(&[budget, ("reconstruct", "painted")]).is_none());
    // Round points exclude splats.
    let (found, settings) = label(&[budget, ("point_size_px", "3")]).unwrap();
    assert_eq!((found.as_str(), settings.reconstruct), ("points spt 4 px", Reconstruct::Points));
}

#[test]
fn another_look_is_promised_nothing() {
    let (planner, grounds) = planner();
    for others in [
        &[("background", "#ffffff")][..],
        &[("fog", "off"), ("color_by", "normal")],
        // A prediction for the unshifted eye says nothing of an eye that may be anywhere beside it.
        &[("eye_offset", "0.03")],
    ] {
        let pairs = [&[("budget_ms", "1000")], others].concat();
        let chosen = choose(&planner, &pairs, &grounds[4]).unwrap();
        assert_eq!(chosen.plan.chosen.unwrap().setting, "fine", "{others:?}");
        assert_eq!((chosen.plan.keeps, chosen.is_as_measured), (None, false), "{others:?}");
        assert!(chosen.plan.because.contains(others[0].0), "{}", chosen.plan.because);
    }
    let plain = [("budget_ms", "1000"), ("projection", "orthographic"), ("lod", "full")];
    let chosen = choose(&planner, &plain, &grounds[4]).unwrap();
    assert_eq!((chosen.plan.keeps, chosen.is_as_measured), (Some(true), true));
}

#[test]
fn requests_that_look_otherwise_have_the_same_choice() {
    let (planner, grounds) = planner();
    let moved = asked(&[
        ("budget_ms", "1000"),
        ("clip_boxes", "0,0,0,2,1,1"),
        ("exposure", "-2.5"),
        ("color_by", "height"),
        ("color_least", "-4"),
        ("color_most", "-3"),
    ]);
    let chosen = |asked: &Asked| {
        let is_clipped = |settings: &Settings| settings.clip_boxes == moved.clip_boxes;
        let goal = moved.goal().unwrap();
        planner.choose(&goal, asked, &grounds[..1], &Paces::default(), is_clipped).unwrap()
    };
    let of_any = planner.asked(&moved.with_some_goal_and_look());
    let shared = chosen(&of_any.looking_like(&moved));
    assert_eq!(shared, chosen(&planner.asked(&moved)));
    assert_eq!((shared.settings.clip_boxes, shared.plan.keeps), (moved.clip_boxes, None));
    let look = |settings: &Settings| (settings.exposure, settings.color_least, settings.color_most);
    assert_eq!(look(&shared.settings), look(&moved));
    assert!(shared.plan.because.contains("clip_boxes"), "{}", shared.plan.because);
}

#[test]
fn painted_splats_are_chosen_where_they_are_the_most_exact_in_time() {
    let (_, grounds) = planner();
    let full = given(FULL);
    // Painted frames take three times as long, and are 4 dB more exact.
    let row = |label: &str, reconstruct: &str, db: f64, times: f64| MeasuredRow {
        label: label.to_owned(),
        given: given(&[("lod", "full"), ("reconstruct", reconstruct)]),
        scale: 1.0,
        points: grounds
            .iter()
            .map(|ground| point(0, &full, ground))
            .map(|Point { mse, ms }| {
                Some(Point { mse: mse / 10f64.powf(0.1 * db), ms: ms * times })
            })
            .collect(),
    };
    let rows = vec![row("plain", "splats", 0.0, 1.0), row("over", "painted", 4.0, 3.0)];
    let planner = Planner::fit(&Measured { poses: Vec::new(), rows }, &grounds);
    let ground = &grounds[4];
    let of = |ms: f64| {
        let chosen = choose(&planner, &[("budget_ms", &format!("{ms:.3}"))], ground).unwrap();
        (chosen.settings.reconstruct, chosen.plan.keeps)
    };
    let plain_ms = point(0, &full, ground).ms;
    assert_eq!(of(6.0 * plain_ms), (Reconstruct::Painted, Some(true)));
    assert_eq!(of(2.0 * plain_ms), (Reconstruct::Splats, Some(true)));
    // What is given stays.
    let pairs = [("budget_ms", "1000"), ("reconstruct", "splats")];
    let chosen = choose(&planner, &pairs, ground).unwrap();
    assert_eq!(chosen.settings.reconstruct, Reconstruct::Splats);
}

#[test]
fn settings_that_are_drawn_alike_count_as_the_first() {
    let (_, grounds) = planner();
    let given = given(FULL);
    let points: Vec<Option<Point>> =
        grounds.iter().map(|ground| Some(point(0, &given, ground))).collect();
    let row = |label: &str, given| MeasuredRow {
        label: label.to_owned(),
        given,
        scale: 1.0,
        points: points.clone(),
    };
    let rows = vec![row("full", given), row("twin", self::given(TREES))];
    let planner = Planner::fit(&Measured { poses: Vec::new(), rows }, &grounds);
    for goal in [("budget_ms", "1000"), ("min_psnr_db", "10"), ("min_psnr_db", "90")] {
        let chosen = choose(&planner, &[goal], &grounds[2]).unwrap();
        assert_eq!(chosen.plan.chosen.unwrap().setting, "full", "{goal:?}");
        assert!(chosen.plan.alternatives.is_empty());
    }
    let twin = choose(&planner, &[("budget_ms", "1000"), ("lod", "spt")], &grounds[2]).unwrap();
    assert_eq!((twin.plan.chosen.unwrap().setting.as_str(), twin.row), ("twin", 0));
}

#[test]
fn frames_of_a_film_all_keep_the_goal() {
    let (planner, grounds) = planner();
    let ms = |of: &[Ground]| {
        let asked = asked(&[("budget_ms", "1000")]);
        let goal = asked.goal().unwrap();
        let chosen =
            planner.choose(&goal, &planner.asked(&asked), of, &Paces::default(), |_| true).unwrap();
        chosen.plan.chosen.unwrap()
    };
    let each: Vec<Alternative> = grounds.iter().map(|one| ms(std::slice::from_ref(one))).collect();
    let all = ms(&grounds);
    assert!(each.iter().all(|one| one.ms <= all.ms && one.psnr_db >= all.psnr_db));
    assert!(
        each.iter().any(|one| one.ms == all.ms)
            && each.iter().any(|one| one.psnr_db == all.psnr_db)
    );
}

#[test]
fn settings_that_cannot_be_drawn_are_not_chosen() {
    let (planner, grounds) = planner();
    let asked = asked(&[("budget_ms", "1000")]);
    let goal = asked.goal().unwrap();
    let paces = Paces::default();
    let one = |settings: &Settings| settings.parts() == 1;
    let chosen = planner.choose(&goal, &planner.asked(&asked), &grounds[..1], &paces, one).unwrap();
    assert_eq!(chosen.plan.chosen.unwrap().setting, "splats full");
    assert_eq!(chosen.plan.compared, 3);
    assert!(
        planner.choose(&goal, &planner.asked(&asked), &grounds[..1], &paces, |_| false).is_none()
    );
}

/// Chooses for a moving pose from settings that are given beside the time.
fn choose_moving(
    planner: &Planner,
    pairs: &[(&str, &str)],
    most_ms: f64,
    (scales, held): ([f64; 2], Option<&str>),
    still: &[(&str, &str)],
) -> Chosen {
    let asked = Settings::from(given(pairs).moving_within(most_ms));
    let still = given(still).resolve().unwrap();
    let moving = Moving { scales, held, still: &still };
    let goal = Goal { most_ms: Some(most_ms), least_db: None };
    let asked = planner.asked(&asked);
    let (ground, paces) = (ground_at(2.5, 500), Paces::default());
    let chosen = planner.choose_moving(&goal, &moving, &asked, &ground, &paces, |_, _| true);
    let chosen = chosen.unwrap();
    assert!(chosen.settings.goal().is_none() && chosen.plan.budget_ms == Some(most_ms));
    chosen
}

/// Any size.
const ANY: [f64; 2] = [0.0, 1.0];
/// A still frame that is as fine as any.
const FINEST: &[(&str, &str)] = &[("antialias", "16x")];

/// The setting, its scale, and whether it is in time.
fn moving(
    planner: &Planner,
    most_ms: f64,
    scales: [f64; 2],
    held: Option<&str>,
) -> (String, f64, Option<bool>) {
    let chosen = choose_moving(planner, &[], most_ms, (scales, held), FINEST);
    (chosen.plan.chosen.unwrap().setting, chosen.scale, chosen.plan.keeps)
}

#[test]
fn frames_of_moving_poses_are_as_exact_as_the_time_allows_in_any_size() {
    let (planner, _) = planner();
    let whole = moving(&planner, 1e4, ANY, None);
    assert_eq!(whole, ("fine".into(), 1.0, Some(true)));
    let link = moving(&planner, 1e4, [0.0, 0.5], None);
    assert_eq!(link, ("fine size=0.5".into(), 0.5, Some(true)), "the link allows no more");
    // Each step down in time is one in error, to the fastest at last.
    let mut last = f64::INFINITY;
    for most_ms in [300.0, 30.0, 10.0, 3.0, 1.5] {
        let plan = choose_moving(&planner, &[], most_ms, (ANY, None), FINEST).plan;
        let chosen = plan.chosen.unwrap();
        assert!(chosen.ms <= most_ms && chosen.psnr_db <= last, "{most_ms}: {chosen:?}");
        last = chosen.psnr_db;
    }
    let (_, scale, keeps) = moving(&planner, 1e-3, ANY, None);
    assert_eq!((scale, keeps), (0.25, Some(false)), "nothing is that fast");
    assert_eq!(moving(&planner, 1e-3, [0.5, 1.0], None).1, 0.5, "smaller ones are too small");
}

#[test]
fn moving_frames_are_no_finer_than_the_still_one() {
    let (planner, _) = planner();
    let chosen = |pairs: &[(&str, &str)], still: &[(&str, &str)]| {
        let chosen = choose_moving(&planner, pairs, 1e4, (ANY, None), still);
        chosen.plan.chosen.unwrap().setting
    };
    assert_eq!(chosen(&[], &[("antialias", "4x")]), "fine");
    assert_eq!(chosen(&[], &[]), "splats full", "no antialiasing");
    let trees = |px| {
        let given = [("lod", "spt"), ("reconstruct", "splats")];
        chosen(&given, &[("lod", "spt"), ("max_error_px", px)])
    };
    assert_eq!(
        (trees("1").as_str(), trees("2").as_str()),
        ("splats spt 1 px", "splats spt 1 px size=0.5")
    );
}

#[test]
fn the_setting_of_the_frame_before_stays_if_little_is_gained() {
    let (planner, _) = planner();
    let of = |held| moving(&planner, 1e4, ANY, held).0;
    assert_eq!(of(Some("splats full")), "fine", "8 dB are much");
    let exact = |most_ms: f64, held| moving(&planner, most_ms, ANY, held);
    // A time at which the best setting just fits, and one a little shorter.
    let ms = planner.rows[0].model.predict(&ground_at(2.5, 500), 1.0).ms;
    let fits = exact(1.01 * ms, None);
    let held = exact(0.95 * ms, Some(&fits.0));
    assert_eq!((&fits.0, fits.1), (&held.0, held.1));
    assert_ne!(exact(0.7 * ms, Some("splats full")).0, "splats full");
}

#[test]
fn a_moving_frame_keeps_what_is_given_but_its_error_and_antialiasing() {
    let pairs =
        [("lod", "spt"), ("max_error_px", "0.5"), ("antialias", "4x"), ("min_psnr_db", "40")];
    let moved = given(&pairs).moving_within(12.0);
    let expected = given(&[("lod", "spt"), ("budget_ms", "12")]);
    assert_eq!(moved, expected);
    let asked = given(&[("budget_ms", "5")]).moving_within(12.0);
    assert_eq!(asked.budget_ms, Some(5.0));
}

#[test]
fn too_few_poses_tell_nothing() {
    let grounds: Vec<Ground> = [2.0, 3.0, 4.0].map(|distance| ground_at(distance, 320)).into();
    let given = given(FULL);
    let points = grounds.iter().map(|ground| Some(point(0, &given, ground))).collect();
    let rows = vec![MeasuredRow { label: "splats full".into(), given, scale: 1.0, points }];
    let planner = Planner::fit(&Measured { poses: Vec::new(), rows }, &grounds);
    assert!(planner.is_empty());
}

#[test]
fn a_goal_is_stored_without_what_is_left_open() {
    let asked = asked(&[("budget_ms", "10"), ("max_error_px", "2"), ("edl", "off")]);
    let stored = asked.applied();
    let names: Vec<String> = stored.pairs().into_iter().map(|(name, _)| name).collect();
    assert!(names.iter().all(|name| name != "lod" && name != "reconstruct"), "{names:?}");
    assert_eq!(stored.max_error_px, Some(2.0));
    assert_eq!(Settings::from(stored), asked);
    // Without a goal, the error decides the level of detail. Full detail has none.
    let trees = given(&[("max_error_px", "2"), ("lod", "spt"), ("edl", "off")]).resolve().unwrap();
    assert_eq!(asked.without_goal(), trees);
    assert_eq!(given(&[("max_error_px", "2"), ("edl", "off")]).resolve().unwrap(), trees);
    assert!(given(&[("max_error_px", "2"), ("lod", "full")]).resolve().is_err());
}

#[test]
fn paces_follow_frames() {
    let mut paces = Paces::default();
    assert_eq!(paces.of(3), 1.0);
    for _ in 0..40 {
        paces.see(1, 10.0, 20.0);
    }
    assert!((paces.of(1) - 2.0).abs() < 0.02, "{}", paces.of(1));
    // Others are slower as well, as far as is known.
    assert!((paces.of(0) - 2.0).abs() < 0.02, "{}", paces.of(0));
    for _ in 0..40 {
        paces.see(0, 10.0, 10.0);
    }
    assert!((paces.of(0) - 1.0).abs() < 0.1 && (paces.of(1) - 2.0).abs() < 0.2);
    // One frame that waited for a compiler changes little.
    let before = paces.of(0);
    paces.see(0, 10.0, 100_000.0);
    assert!(paces.of(0) < before * MOST_CHANGE);
    paces.see(0, 0.0, 1.0);
    paces.see(0, 1.0, f64::NAN);
    assert!(paces.of(0).is_finite());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: RngSeed::Fixed(0x51ea_0020), ..ProptestConfig::default() })]
    /// Whatever was measured, predictions are finite and chosen settings keep what the receipt says.
    #[test]
    fn choices_keep_what_they_say(
        points in prop::collection::vec((0.0f64..70_000.0, 1e-3f64..1e5), 32),
        budget in 0.01f64..1000.0,
        least_db in 1.0f64..90.0,
        distance in 0.01f64..1e6,
    ) {
        let grounds: Vec<Ground> =
            (0..8).map(|at| ground_at(1.5f64.powi(at), 320)).collect();
        let measured_rows = rows().into_iter().enumerate().map(|(row, (label, given))| MeasuredRow {
            label: label.to_owned(),
            given,
            scale: 1.0,
            points: points[8 * row..8 * (row + 1)].iter().map(|&(mse, ms)| Some(Point { mse, ms })).collect(),
        });
        let measured = Measured { poses: Vec::new(), rows: measured_rows.collect() };
        let planner = Planner::fit(&measured, &grounds);
        let ground = ground_at(distance, 640);
        for row in &planner.rows {
            let found = row.model.predict(&ground, 1.0);
            prop_assert!(found.ms > 0.0 && found.most_ms >= found.ms && found.most_ms.is_finite());
            prop_assert!(found.psnr_db.is_finite() && found.least_psnr_db <= found.psnr_db);
        }
        let goals = [(Some(budget), None), (None, Some(least_db)), (Some(budget), Some(least_db))];
        for (budget_ms, min_psnr_db) in goals {
            let goal = Goal { most_ms: budget_ms, least_db: min_psnr_db };
            let asked = Settings::from(Given { budget_ms, min_psnr_db, ..Given::default() });
            let chosen = planner.choose(&goal, &planner.asked(&asked), std::slice::from_ref(&ground), &Paces::default(), |_| true).unwrap();
            let found = planner.rows[chosen.row].model.predict(&ground, 1.0);
            prop_assert_eq!(chosen.plan.keeps, Some(goal.keeps(&found)));
            if chosen.plan.keeps == Some(false) {
                let any = planner.rows.iter().any(|row| goal.keeps(&row.model.predict(&ground, 1.0)));
                prop_assert!(!any, "another setting keeps {:?}", goal);
            }
        }
    }
}
