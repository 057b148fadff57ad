//! Settings are chosen for goals from what was measured, and receipts say how.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3};
use pointillist::accuracy::journal::Journal;
use pointillist::accuracy::survey::{NamedPose, Purpose, Survey};
use pointillist::accuracy::sweep::Row as SurveyRow;
use pointillist::bake::cache::BakeCache;
use pointillist::engine::{
    Client, FrameRequest, MovingFrame, NodePatch, Pose, Receipt, Resolution,
};
use pointillist::math::Camera;
use pointillist::plan::planner::{Measured, MeasuredPose, MeasuredRow, Moving, Point};
use pointillist::plan::{Given, Lod, Output, Reconstruct, Settings};

use super::studio::{Studio, cloud_scene, front, wall};

/// A setting's name, its values, and the decibels and milliseconds of its frames.
type Row = (&'static str, &'static [(&'static str, &'static str)], f64, f64);

const ROWS: [Row; 4] = [
    ("points", &[("lod", "full"), ("reconstruct", "points")], 25.0, 2.0),
    ("trees", &[("lod", "spt"), ("max_error_px", "4"), ("reconstruct", "splats")], 30.0, 1e3),
    ("splats", &[("lod", "full"), ("reconstruct", "splats")], 35.0, 2e3),
    ("fine", &[("lod", "full"), ("reconstruct", "splats"), ("antialias", "4x")], 45.0, 4e3),
];

fn given(pairs: &[(&str, &str)]) -> Given {
    let mut given = Given::default();
    pairs.iter().for_each(|(name, value)| given.set_text(name, value).unwrap());
    given
}

/// Frames that were never drawn: each row has one error and one time, wherever it is seen from.
fn measured() -> Measured {
    let pose = |z: f64| MeasuredPose {
        eye: [0.0, 0.0, z],
        target: [0.0; 3],
        up: [0.0, 1.0, 0.0],
        fov_deg: Some(45.0),
        ortho_height: None,
        size: [96, 64],
    };
    let row = |&(label, pairs, db, ms): &Row| {
        let point = Some(Point { mse: 65025.0 / 10f64.powf(0.1 * db), ms });
        MeasuredRow {
            label: label.to_owned(),
            given: given(pairs),
            scale: 1.0,
            points: vec![point; 8],
        }
    };
    Measured {
        poses: (0..8).map(|at| pose(2.0 + 0.25 * f64::from(at))).collect(),
        rows: ROWS.iter().map(row).collect(),
    }
}

fn studio() -> Studio {
    let studio = Studio::new();
    studio.write("wall.ply", wall(40, |x, y| [(x * 6) as u8, (y * 6) as u8, 90]));
    studio.load_json("cloud", &cloud_scene("wall.ply"));
    studio
}

fn asking(pairs: &[(&str, &str)]) -> FrameRequest {
    let settings = given(pairs).resolve().unwrap().complete();
    FrameRequest { settings, ..front("cloud", 96, 64) }
}

fn chosen(receipt: &Receipt) -> &str {
    &receipt.planned.as_ref().unwrap().chosen.as_ref().unwrap().setting
}

#[test]
fn goals_choose_from_what_was_measured() {
    let studio = studio();
    // Nothing is known: drawn as without the goal, and said.
    let ample = asking(&[("budget_ms", "60000")]);
    let unknown = studio.frame(&ample);
    let plan = unknown.receipt.planned.clone().unwrap();
    assert_eq!((plan.keeps, plan.chosen.as_ref(), plan.compared), (None, None, 0));
    assert!(plan.because.contains("not measured"), "{}", plan.because);
    let plain = asking(&[]);
    assert_eq!(unknown.bytes, studio.frame(&plain).bytes);
    assert!(studio.frame(&plain).receipt.planned.is_none());

    assert_eq!(studio.engine.learn("cloud", measured()).unwrap(), 4);
    assert_eq!(studio.engine.planner_size("cloud").unwrap(), Some([4, 8]));
    let fine = studio.frame(&ample);
    assert_eq!(chosen(&fine.receipt), "fine");
    let plan = fine.receipt.planned.clone().unwrap();
    assert_eq!((plan.keeps, plan.budget_ms, plan.poses), (Some(true), Some(60_000.0), 8));
    assert!(plan.actual_ms.is_some_and(|ms| ms > 0.0));
    let same = asking(&[("reconstruct", "splats"), ("antialias", "4x")]);
    assert_eq!(fine.bytes, studio.frame(&same).bytes);

    for (goal, expected, keeps) in [
        (&[("budget_ms", "500")][..], "points", true),
        (&[("budget_ms", "0.01")], "points", false),
        (&[("min_psnr_db", "28")], "trees", true),
        (&[("min_psnr_db", "33")], "splats", true),
        (&[("min_psnr_db", "90")], "fine", false),
        (&[("min_psnr_db", "28"), ("lod", "full")], "splats", true),
        (&[("min_psnr_db", "28"), ("max_error_px", "2")], "splats", true),
        (&[("min_psnr_db", "28"), ("budget_ms", "10")], "points", false),
        (&[("budget_ms", "60000"), ("antialias", "off")], "splats", true),
    ] {
        let frame = studio.frame(&asking(goal));
        let plan = frame.receipt.planned.clone().unwrap();
        assert_eq!((chosen(&frame.receipt), plan.keeps), (expected, Some(keeps)), "{goal:?}");
    }
    // What is given and was never measured cannot be promised.
    let painted = studio.frame(&asking(&[("budget_ms", "500"), ("reconstruct", "painted")]));
    let plan = painted.receipt.planned.clone().unwrap();
    assert_eq!((plan.keeps, painted.receipt.settings.applied.draws_samples()), (None, true));
    assert!(plan.because.contains("goes with those that are given"), "{}", plan.because);
}

#[test]
fn outputs_and_picks_follow_the_colours() {
    let studio = studio();
    studio.engine.learn("cloud", measured()).unwrap();
    let goal = [("min_psnr_db", "33")];
    let depth = FrameRequest { output: Output::Depth, ..asking(&goal) };
    let plain = FrameRequest { output: Output::Depth, ..asking(&[("reconstruct", "splats")]) };
    assert_eq!(studio.bytes(&depth), studio.bytes(&plain));
    // Tags tell goals apart, since receipts do.
    let tag = |request: &FrameRequest| super::studio::etag(&studio.engine, request).unwrap();
    let tags: BTreeSet<String> =
        [asking(&goal), asking(&[("min_psnr_db", "34")]), asking(&[("reconstruct", "splats")])]
            .iter()
            .map(tag)
            .collect();
    assert_eq!(tags.len(), 3);
    assert_eq!(tag(&asking(&goal)), tag(&asking(&goal)));
}

#[test]
fn measurements_outlive_the_engine_and_belong_to_the_content() {
    let folder = tempfile::tempdir().unwrap();
    let cache = || Some(BakeCache::new(folder.path().join("cache"), 1 << 30));
    let open = |points: usize| {
        let studio = Studio::with(|config| config.bake_cache = cache());
        studio.write("wall.ply", wall(points, |x, _| [(x * 6) as u8, 0, 90]));
        studio.load_json("cloud", &cloud_scene("wall.ply"));
        studio
    };
    let first = open(20);
    first.engine.learn("cloud", measured()).unwrap();
    drop(first);
    let second = open(20);
    assert_eq!(chosen(&second.frame(&asking(&[("min_psnr_db", "33")])).receipt), "splats");
    // Under another id as well, but not for another content.
    second.load_json("other", &cloud_scene("wall.ply"));
    assert_eq!(second.engine.planner_size("other").unwrap(), Some([4, 8]));
    // Moved nodes are another content: what was measured chooses, and promises nothing.
    let aside = DAffine3::from_translation(DVec3::new(0.1, 0.0, 0.0));
    let moved = NodePatch { world_from_node: Some(aside), ..NodePatch::default() };
    second.engine.patch("other", "wall", &moved).unwrap();
    assert_eq!(second.engine.planner_size("other").unwrap(), Some([4, 8]));
    let plan_of = |studio: &Studio, scene: &str| {
        let request = FrameRequest { scene: scene.to_owned(), ..asking(&[("min_psnr_db", "33")]) };
        studio.frame(&request).receipt.planned.clone().unwrap()
    };
    let plan = plan_of(&second, "other");
    assert_eq!((plan.keeps, plan.chosen.unwrap().setting.as_str()), (None, "splats"));
    assert!(plan.because.contains("before its nodes were changed"), "{}", plan.because);
    assert_eq!(plan_of(&second, "cloud").keeps, Some(true));
    // Measurements of the patched scene are none of the scene as it was loaded.
    let mut own = measured();
    own.rows.truncate(3);
    second.engine.learn("other", own).unwrap();
    assert_eq!(plan_of(&second, "other").keeps, Some(true));
    assert_eq!(second.engine.planner_size("other").unwrap(), Some([3, 8]));
    assert_eq!(second.engine.planner_size("cloud").unwrap(), Some([4, 8]));
    drop(second);
    assert_eq!(open(20).engine.planner_size("cloud").unwrap(), Some([4, 8]));
    assert_eq!(open(21).engine.planner_size("cloud").unwrap(), None);
    // A damaged note is none.
    for note in std::fs::read_dir(folder.path().join("cache")).unwrap().flatten() {
        if note.path().extension().is_some_and(|extension| extension == "note") {
            std::fs::write(note.path(), b"damaged").unwrap();
        }
    }
    let fourth = open(20);
    assert_eq!(fourth.engine.planner_size("cloud").unwrap(), None);
    fourth.engine.learn("cloud", measured()).unwrap();
    assert!(fourth.engine.unlearn("cloud").unwrap());
    assert!(!fourth.engine.unlearn("cloud").unwrap());
    assert_eq!(fourth.engine.planner_size("cloud").unwrap(), None);
}

#[test]
fn predicted_times_follow_the_frames() {
    let studio = studio();
    studio.engine.learn("cloud", measured()).unwrap();
    let predicted = || {
        let frame = studio.frame(&asking(&[("min_psnr_db", "33")]));
        let plan = frame.receipt.planned.clone().unwrap();
        (plan.chosen.unwrap().ms, plan.actual_ms.unwrap())
    };
    let (first, _) = predicted();
    assert!((first - 2e3).abs() < 200.0, "{first}");
    // It was never that slow.
    let mut last = first;
    for _ in 0..30 {
        let (ms, actual) = predicted();
        assert!(ms <= last * 1.01 && actual < 2e3, "{ms} after {last}");
        last = ms;
    }
    assert!(last < 0.3 * first, "{last} after {first}");
}

#[test]
fn frames_of_moving_poses_are_chosen_with_their_size() {
    let studio = studio();
    let mut known = measured();
    let half = |of: usize, db: f64, ms: f64| {
        let point = Some(Point { mse: 65025.0 / 10f64.powf(0.1 * db), ms });
        let row = known.rows[of].clone();
        let label = format!("{} size=1/2", row.label);
        MeasuredRow { label, scale: 0.5, points: vec![point; 8], ..row }
    };
    let halves = [half(1, 28.0, 10.0), half(2, 27.0, 20.0)];
    let asked = |pairs: &[(&str, &str)]| {
        let settings = given(pairs).moving_within(50.0).resolve().unwrap();
        FrameRequest { settings, ..front("cloud", 96, 64) }
    };
    let still = Settings::default();
    let moving = Moving { scales: [0.1, 1.0], held: None, still: &still };
    let plan = |request: &FrameRequest, at_once: bool| {
        let MovingFrame { settings, size: [width, height], planned } =
            studio.engine.plan_moving(request, &moving, at_once).unwrap()?;
        Some((FrameRequest { settings, width, height, ..request.clone() }, planned))
    };
    assert!(plan(&asked(&[]), true).is_none(), "nothing was measured");
    known.rows.extend(halves);
    studio.engine.learn("cloud", known).unwrap();
    let (trees, _) = plan(&asked(&[]), false).unwrap();
    assert_eq!((trees.width, trees.height, trees.settings.lod), (48, 32, Lod::Spt));
    // Without its trees, the next best is drawn.
    let (request, _) = plan(&asked(&[]), true).unwrap();
    assert_eq!((request.width, request.settings.lod), (48, Lod::Full));
    studio.engine.bake(&trees).unwrap();
    let (request, planned) = plan(&asked(&[]), true).unwrap();
    assert_eq!((request.width, request.settings.lod), (48, Lod::Spt));
    let Resolution::Ready(frame) = studio.engine.resolve_planned(request, Some(planned)).unwrap()
    else {
        panic!("the trees are there");
    };
    let receipt =
        studio.engine.queue(Client::Unnamed, frame).unwrap().wait().unwrap().receipt.clone();
    let plan_of = receipt.planned.unwrap();
    assert_eq!(plan_of.chosen.unwrap().setting, "trees size=1/2");
    assert_eq!((plan_of.keeps, plan_of.budget_ms), (Some(true), Some(50.0)));
    // What is given stays; a part of an image has the size that it has.
    let (request, _) = plan(&asked(&[("reconstruct", "points")]), true).unwrap();
    assert_eq!((request.width, request.settings.reconstruct), (96, Reconstruct::Points));
    let part = asked(&[("part_of", "192,128,0,0")]);
    assert!(studio.engine.plan_moving(&part, &moving, true).is_err());
}

/// Rows that are drawn as others are not timed.
#[test]
fn a_survey_takes_as_many_steps_as_it_says() {
    let studio = studio();
    let row = |label: &str, pairs: &[(&str, &str)]| SurveyRow {
        label: label.to_owned(),
        family: String::new(),
        given: given(pairs),
        scale: 1.0,
    };
    let rows = vec![
        row("points", &[("reconstruct", "points")]),
        row("clear points", &[("reconstruct", "points"), ("fog", "off")]),
        row("splats", &[("reconstruct", "splats")]),
    ];
    let camera = Camera::perspective(DVec3::new(0.0, 0.0, 2.0), DVec3::ZERO, 45.0);
    let stop = AtomicBool::new(false);
    let survey = Survey {
        engine: &studio.engine,
        client: Client::Unnamed,
        scene: "cloud",
        poses: vec![NamedPose::new(0, "front", camera)],
        rows,
        size: [48, 32],
        repeats: 2,
        seed: 1,
        oracle: None,
        folder: None,
        purpose: Purpose::Report,
        stop: &stop,
    };
    let mut journal = Journal::in_memory(&survey.identity("cloud").unwrap(), "2026-01-02");
    let mut steps = Vec::new();
    assert!(survey.run(&mut journal, |event| steps.push((event.done, event.total))).unwrap());
    assert_eq!(steps, (1..=7).map(|step| (step, 7)).collect::<Vec<_>>());
}

#[test]
fn a_film_keeps_its_goal_with_one_setting() {
    let studio = studio();
    studio.engine.learn("cloud", measured()).unwrap();
    let at = |z: f64| {
        let camera = Camera::perspective(glam::DVec3::new(0.0, 0.0, z), glam::DVec3::ZERO, 45.0);
        FrameRequest { pose: Pose::Camera(camera), ..asking(&[("min_psnr_db", "28")]) }
    };
    let frames = [at(2.0), at(3.0), at(30.0)];
    let (settings, plan) = studio.engine.settings_for_all(&frames).unwrap().unwrap();
    assert!(plan.min_psnr_db == Some(28.0) && plan.chosen.is_some() && plan.poses == 8, "{plan:?}");
    assert!(settings.goal().is_none() && settings.reconstruct == Reconstruct::Splats);
    assert!(settings.lod == Lod::Spt || settings.lod == Lod::Full);
    let plain = FrameRequest { settings: Settings::default(), ..at(2.0) };
    assert_eq!(studio.engine.settings_for_all(&[plain]).unwrap(), None);
}
