use std::cell::RefCell;

use super::*;
use crate::engine::Pose;

fn params(query: &str) -> FrameParams {
    FrameParams::from_query(Some(query)).unwrap()
}

fn coarse(query: &str, scale: f64, coarseness: f64) -> Wanted {
    wanted("s", &params(query), Quality::Moving, pace(scale, coarseness), None).unwrap()
}

fn pace(scale: f64, coarseness: f64) -> Pace {
    Pace { scale, coarseness, jpeg_quality: 60, link_scale: 0.75, draw_ms: 20.0 }
}

fn still(query: &str) -> Wanted {
    let no_plan: Plan<'_> = &|_, _, _| panic!("frames of poses that rest are not planned");
    wanted("s", &params(query), Quality::Still, pace(0.25, 4.0), Some(no_plan)).unwrap()
}

fn moving(query: &str, scale: f64) -> Wanted {
    coarse(query, scale, 1.0)
}

#[test]
fn moving_frames_are_smaller_and_jpeg_where_a_browser_could_show_them() {
    let seen = moving("w=800&h=600&format=png", 0.5).request;
    assert_eq!(
        (seen.width, seen.height, seen.format, seen.quality),
        (400, 300, ImageFormat::Jpeg, 60)
    );
    let raw = moving("w=800&h=600&format=raw", 0.5).request;
    assert_eq!((raw.width, raw.format), (400, ImageFormat::Raw));
    let depth = moving("w=800&h=600&output=depth", 0.5).request;
    assert_eq!((depth.width, depth.format), (400, ImageFormat::Png));
    assert_eq!(moving("w=800&h=600&quality=30", 0.5).request.quality, 30, "no better than asked");
}

#[test]
fn small_frames_stay_visible() {
    let seen = moving("w=100&h=80", 0.25);
    assert_eq!((seen.request.width, seen.request.height), (80, 64));
    assert_eq!(moving("w=20&h=10", 0.25).request.height, 10);
}

#[test]
fn what_is_as_good_as_asked_is_still() {
    assert_eq!(moving("w=64&h=64&format=raw", 0.25).quality, Quality::Still);
    assert_eq!(moving("w=64&h=64&quality=50", 1.0).quality, Quality::Still);
    assert_eq!(moving("w=64&h=64&quality=90", 1.0).quality, Quality::Moving);
    assert_eq!(moving("w=64&h=64&format=png", 1.0).quality, Quality::Moving);
    // The still frame has smooth edges.
    assert_eq!(moving("w=64&h=64&format=raw&antialias=4x", 0.25).quality, Quality::Moving);
    let depths = moving("w=64&h=64&format=raw&output=depth&antialias=4x", 0.25);
    assert_eq!(depths.quality, Quality::Still);
    // Full detail has no error that could grow.
    assert_eq!(coarse("w=64&h=64&format=raw", 0.25, 4.0).quality, Quality::Still);
    assert_eq!(coarse("w=64&h=64&format=raw&lod=spt", 0.25, 4.0).quality, Quality::Moving);
}

#[test]
fn moving_frames_have_no_depth_of_field_and_the_still_one_has() {
    let seen = moving("w=64&h=64&format=raw&aperture=0.1&focus_distance=2", 0.25);
    assert_eq!((seen.quality, seen.request.settings.exposures()), (Quality::Moving, 1));
    let settings = still("aperture=0.1&shutter=1").request.settings;
    assert_eq!(
        (settings.exposures(), settings.open_share()),
        (32, None),
        "no path moves the camera"
    );
}

#[test]
fn moving_frames_of_point_trees_are_coarser_and_still_ones_are_not() {
    let error = |query: &str, coarseness| {
        let request = coarse(query, 0.25, coarseness).request;
        Made::of(&request).accepted_px
    };
    assert_eq!(error("lod=spt", 1.0), Some(1.0));
    assert_eq!(error("lod=spt", 4.0), Some(4.0));
    assert_eq!(error("lod=spt&max_error_px=0.5", 4.0), Some(2.0));
    assert_eq!(error("lod=spt&max_error_px=2", 4.0), Some(4.0), "no more than that");
    assert_eq!(error("lod=spt&max_error_px=9", 4.0), Some(9.0), "unless it was asked for");
    assert_eq!(error("lod=full", 4.0), None);
    assert_eq!(Made::of(&still("lod=spt").request).accepted_px, Some(1.0));
}

#[test]
fn planned_frames_are_asked_for_in_full_size_with_what_the_link_and_the_target_allow() {
    let seen = RefCell::new(None);
    let query = "w=400&h=200&antialias=4x&aperture=0.1&lod=spt&max_error_px=2";
    let plan: Plan<'_> = &|request, _, scales| {
        seen.replace(Some((request.clone(), scales)));
        None
    };
    let found = wanted("s", &params(query), Quality::Moving, pace(0.25, 4.0), Some(plan));
    let (request, scales) = seen.take().unwrap();
    assert_eq!((request.width, request.height, scales), (400, 200, [0.32, 0.75]));
    let settings = request.settings;
    assert_eq!(settings.goal().and_then(|goal| goal.most_ms), Some(20.0));
    assert_eq!((settings.exposures(), settings.parts()), (1, 1));
    // Nothing is known: the frame is drawn as one without a plan.
    let found = found.unwrap();
    assert_eq!((found.request.width, found.request.settings.goal()), (128, None));
    assert_eq!(found.scale, 0.32);
}

#[test]
fn planned_frames_show_the_view_of_the_still_one_in_another_size() {
    let plan: Plan<'_> = &|request, _, _| {
        let settings = request.settings.without_goal();
        let planned = PlannedFrame::unplanned(&request.settings.goal()?, "a test");
        Some(MovingFrame { settings, size: [200, 100], planned })
    };
    let matrices =
        "view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,-4,1&proj=1,0,0,0,0,2,0,0,0,0,-1,-1,0,0,-0.2,0";
    for query in ["", "eye=0,0,4&target=0,0,0&", matrices] {
        let query = format!("w=400&h=200&format=raw&{query}");
        let found =
            wanted("s", &params(&query), Quality::Moving, pace(1.0, 1.0), Some(plan)).unwrap();
        let request = found.request;
        assert_eq!((request.width, request.height, found.scale), (200, 100, 0.5));
        assert_eq!((found.quality, request.settings.goal()), (Quality::Moving, None));
        if let Pose::View(view) = request.pose {
            assert_eq!((view.width, view.height), (200, 100));
        }
    }
}
