use super::*;
use crate::plan::{Lod, Reconstruct};
use crate::scene::{Blend, Filter, Painting, Shading};

fn request(query: &str) -> Result<FrameRequest, Problem> {
    FrameParams::from_query(Some(query))?.request("s", ImageFormat::Png, Instant::now())
}

fn fault(query: &str) -> (String, String, String) {
    let p = request(query).unwrap_err();
    assert_eq!(p.status(), 422, "{query}");
    (p.parameter.unwrap_or_default(), p.detail, p.accepted.unwrap_or_default())
}

#[test]
fn a_full_query() {
    let r = request("eye=0,1,3&target=0,0,0&up=0,0,1&fov=40&w=640&h=480&quality=90&output=depth")
        .unwrap();
    let Pose::Camera(camera) = r.pose else { panic!("{:?}", r.pose) };
    assert_eq!(camera.eye, DVec3::new(0.0, 1.0, 3.0));
    assert_eq!((camera.up, camera.lens.fov_deg()), (DVec3::Z, Some(40.0)));
    assert_eq!((r.width, r.height, r.quality, r.output), (640, 480, 90, Output::Depth));
    assert!(r.deadline.is_none());
}

#[test]
fn whole_numbers_may_have_a_fraction_of_zero() {
    let sizes = |r: FrameRequest| (r.width, r.height, r.quality);
    assert_eq!(sizes(request("w=64.0&h=4.8e1&quality=90.0").unwrap()), (64, 48, 90));
    let json = serde_json::json!({"w": 64.0, "h": 48.0, "quality": 90.0});
    let params = FrameParams::from_json(json, "").unwrap();
    let r = params.request("s", ImageFormat::Png, Instant::now()).unwrap();
    assert_eq!(sizes(r), (64, 48, 90));
}

#[test]
fn nothing_given_shows_everything() {
    let r = FrameParams::from_query(None)
        .unwrap()
        .request("s", ImageFormat::Png, Instant::now())
        .unwrap();
    assert_eq!((r.pose, r.width, r.height), (Pose::FIT, 1024, 1024));
}

#[test]
fn escapes_are_decoded() {
    let r = request("camera=front%20door&eye=").unwrap_err();
    assert_eq!(r.parameter.as_deref(), Some("eye"));
    let r = request("camera=front+door").unwrap();
    assert_eq!(r.pose, Pose::Named("front door".into()));
}

#[test]
fn unknown_names_are_suggested() {
    assert!(fault("reconstuct=points").1.contains("`reconstruct`"));
    assert!(fault("width=3").1.contains("`w`"));
    assert!(fault("zzzz=3").2.contains("deadline_ms"));
}

#[test]
fn unknown_values_are_suggested() {
    for (query, meant) in [
        ("reconstruct=pullpush", "pull_push"),
        ("color_by=hight", "height"),
        ("color_map=Virids", "viridis"),
        ("lod=sptt", "spt"),
        ("output=colour", "color"),
        ("wait=redy", "ready"),
    ] {
        let (name, value) = query.split_once('=').unwrap();
        let body = serde_json::json!({ name: value });
        let refused = FrameParams::from_json(body, "").and_then(|params| params.check());
        for detail in [fault(query).1, refused.unwrap_err().detail] {
            assert!(detail.ends_with(&format!("; did you mean `{meant}`?")), "{query}: {detail}");
        }
    }
    assert!(!fault("reconstruct=zzzz").1.contains("did you mean"));
}

#[test]
fn names_are_those_of_the_way_of_asking() {
    let names = Names { own: &["speed"], without: &[("deadline_ms", "it is never late")] };
    assert!(names.check("speed").is_ok() && names.check("eye").is_ok());
    let problem = |name: &str| {
        let problem = names.check(name).unwrap_err();
        (problem.kind, problem.detail, problem.accepted.unwrap_or_default())
    };
    let (kind, detail, accepted) = problem("deadline_ms");
    assert_eq!((kind, accepted.as_str()), (Kind::Unavailable, "leave it out"));
    assert!(detail.contains("it is never late"), "{detail}");
    let (_, detail, accepted) = problem("sped");
    assert!(detail.contains("did you mean `speed`"), "{detail}");
    assert!(
        accepted.starts_with("speed, camera") && accepted.ends_with("background"),
        "{accepted}"
    );
    let (_, detail, _) = problem("timeout");
    assert!(!detail.contains("deadline_ms"), "{detail}");
}

#[test]
fn values_are_checked() {
    for (query, parameter) in [
        ("w=0", "w"),
        ("w=-1", "w"),
        ("h=1.5", "h"),
        ("w=5&w=5", "w"),
        ("quality=0", "quality"),
        ("quality=101", "quality"),
        ("eye=1,2&target=0,0,0", "eye"),
        ("eye=1,2,nan&target=0,0,0", "eye"),
        ("eye=1,2,inf&target=0,0,0", "eye"),
        ("eye=1,2,3,4&target=0,0,0", "eye"),
        ("eye=1,2,3", "target"),
        ("target=1,2,3", "eye"),
        ("up=w", "up"),
        ("up=0,1", "up"),
        ("up=z&up=z", "up"),
        ("camera=a&up=z", "up"),
        ("fov=30&eye=0,0,1", "target"),
        ("fov=5e-324", "fov"),
        ("fov=179.9999999999999", "fov"),
        ("camera=a&fov=30", "fov"),
        ("eye=1,2,3&target=0,0,0&view=1", "view"),
        ("view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1", "proj"),
        ("deadline_ms=0", "deadline_ms"),
        ("deadline_ms=nan", "deadline_ms"),
        ("output=colour", "output"),
        ("lod=coarse", "lod"),
        ("lod=full&max_error_px=1", "max_error_px"),
        ("lod=spt&max_error_px=0", "max_error_px"),
        ("lod=spt&max_error_px=nan", "max_error_px"),
        ("error_mode=split", "error_mode"),
        ("lod=spt&reconstruct=points&error_mode=split", "error_mode"),
        ("reconstruct=splats&error_mode=split", "error_mode"),
        ("lod=spt&reconstruct=splats&error_mode=both", "error_mode"),
        ("color_by=levels", "color_by"),
        ("lod=spt&color_by=red", "color_by"),
        ("reconstruct=disks", "reconstruct"),
        ("reconstruct=splats&reconstruct=splats", "reconstruct"),
        ("reconstruct=splats&filter=box", "filter"),
        ("reconstruct=splats&filter=exact&filter=exact", "filter"),
        ("reconstruct=splats&prefilter=1", "prefilter"),
        ("reconstruct=splats&prefilter=", "prefilter"),
        ("reconstruct=splats&prefilter=true&prefilter=true", "prefilter"),
        ("reconstruct=splats&blend=max", "blend"),
        ("reconstruct=splats&blend=opaque&blend=weighted", "blend"),
        ("reconstruct=splats&shading=phong", "shading"),
        ("reconstruct=splats&shading=splat&shading=splat", "shading"),
        ("format=gif", "format"),
        ("lod=full&max_error_px=1", "max_error_px"),
        ("budget_ms=0", "budget_ms"),
        ("min_psnr_db=1000", "min_psnr_db"),
        ("effects=ao", "effects"),
    ] {
        let params = FrameParams::from_query(Some(query));
        let found = params.and_then(|p| {
            p.format()?;
            p.request("s", ImageFormat::Png, Instant::now())
        });
        let problem = found.err().unwrap_or_else(|| panic!("{query} was taken"));
        assert_eq!(problem.parameter.as_deref(), Some(parameter), "{query}: {}", problem.detail);
        assert_eq!(problem.status(), 422);
    }
}

#[test]
fn what_is_accepted_comes_from_the_type() {
    assert_eq!(fault("output=x").2, "color, depth, normal, id");
    assert_eq!(fault("reconstruct=x").2, "auto, points, splats, fuzzy, painted, pull_push");
    for (query, accepted) in [
        ("filter=x", "affine, perspective, exact"),
        ("prefilter=yes", "true or false"),
        ("blend=x", "weighted or opaque"),
        ("shading=x", "deferred or splat"),
    ] {
        assert_eq!(fault(&format!("reconstruct=splats&{query}")).2, accepted, "{query}");
    }
}

/// A request can override the scene's settings of splats. Settings that the request leaves out come from the scene.
#[test]
fn settings_of_splats_in_both_notations() {
    const QUERY: &str =
        "reconstruct=splats&filter=exact&prefilter=false&blend=opaque&shading=splat";
    let asked = request(QUERY).unwrap().settings;
    let expected = Settings {
        lod: Lod::Full,
        max_error_px: Default::default(),
        error_mode: Default::default(),
        reconstruct: Reconstruct::Splats,
        decide_for: None,
        filter: Some(Filter::Exact),
        prefilter: Some(false),
        blend: Some(Blend::Opaque),
        shading: Some(Shading::Splat),
        wait: Default::default(),
        ..Settings::default()
    };
    assert_eq!(asked, expected);
    let json = serde_json::json!({"reconstruct": "splats", "filter": "exact", "prefilter": false,
        "blend": "opaque", "shading": "splat"});
    let same = FrameParams::from_json(json, "").unwrap();
    assert_eq!(same.request("s", ImageFormat::Png, Instant::now()).unwrap().settings, expected);
    for (query, filter) in
        [("affine", Filter::Affine), ("perspective", Filter::Perspective), ("exact", Filter::Exact)]
    {
        let settings = request(&format!("reconstruct=splats&filter={query}")).unwrap().settings;
        let left = (settings.prefilter, settings.blend, settings.shading);
        assert_eq!((settings.filter, left), (Some(filter), (None, None, None)), "{query}");
    }
    assert_eq!(request("").unwrap().settings, Settings::default());
}

#[test]
fn settings_of_splats_need_splats() {
    for (name, value) in [
        ("filter", serde_json::json!("exact")),
        ("prefilter", serde_json::json!(true)),
        ("blend", serde_json::json!("weighted")),
        ("shading", serde_json::json!("deferred")),
    ] {
        let word = value.to_string().replace('"', "");
        let (parameter, _, accepted) = fault(&format!("reconstruct=points&{name}={word}"));
        assert_eq!(parameter, name);
        assert!(accepted.contains("`reconstruct=splats`"), "{name}: {accepted}");
        // `auto` may draw splats, and the setting says how.
        for auto in ["", "reconstruct=auto&"] {
            let settings = request(&format!("{auto}{name}={word}")).unwrap().settings;
            assert_eq!(settings.reconstruct, Reconstruct::Auto);
        }
        let points = ("reconstruct".to_owned(), serde_json::json!("points"));
        let body =
            serde_json::Value::Object([(name.to_owned(), value), points].into_iter().collect());
        let params = FrameParams::from_json(body, "").unwrap();
        let problem = params.request("s", ImageFormat::Png, Instant::now()).unwrap_err();
        assert_eq!((problem.status(), problem.parameter.as_deref()), (422, Some(name)));
    }
    // A single pass accepts settings of kernels as the three passes do, but has only one way to blend and to shade.
    let fuzzy = request("reconstruct=fuzzy&filter=exact&prefilter=false").unwrap().settings;
    assert_eq!((fuzzy.reconstruct, fuzzy.filter), (Reconstruct::Fuzzy, Some(Filter::Exact)));
    for given in ["blend=weighted", "shading=deferred"] {
        let (parameter, _, accepted) = fault(&format!("reconstruct=fuzzy&{given}"));
        assert!(given.starts_with(&parameter) && accepted.contains("`reconstruct=splats`"));
    }
    // Painted splats are always filtered.
    let painted = request("reconstruct=painted&painted_as=splats&filter=exact").unwrap().settings;
    assert_eq!((painted.reconstruct, painted.painted_as), (Reconstruct::Painted, Painting::Splats));
    for (query, at) in [
        ("reconstruct=painted&prefilter=false", "prefilter"),
        ("reconstruct=painted&blend=opaque", "blend"),
        ("reconstruct=splats&painted_as=splats", "painted_as"),
    ] {
        assert_eq!(fault(query).0, at);
    }
    let (parameter, _, accepted) = fault("reconstruct=splats&blend=fuzzy");
    assert_eq!(parameter, "blend");
    assert!(accepted.contains("opaque") && !accepted.contains("fuzzy"), "{accepted}");
    let fail = |json| FrameParams::from_json(json, "").unwrap_err().parameter.unwrap();
    assert_eq!(fail(serde_json::json!({"prefilter": "true"})), "prefilter");
    assert_eq!(fail(serde_json::json!({"blend": 1})), "blend");
}

/// A word that no frame can have is refused even if other parameters are wrong as well.
#[test]
fn words_are_checked_before_anything_else() {
    for name in ["format", "output", "wait"].iter().chain(Given::NAMES) {
        let params = FrameParams::from_json(serde_json::json!({ *name: "none\n" }), "poses[3]");
        let problem = params.and_then(|params| params.check()).unwrap_err();
        let place = problem.parameter.as_deref().map(|place| place.trim_start_matches("poses[3]."));
        assert_eq!((place, problem.status()), (Some(*name), 422));
    }
}

#[test]
fn settings_of_splats_are_inherited() {
    let json = |v| FrameParams::from_json(v, "").unwrap();
    let defaults = json(serde_json::json!({"reconstruct": "splats", "filter": "affine",
        "prefilter": false, "blend": "opaque", "shading": "splat"}));
    assert_eq!(json(serde_json::json!({})).or(&defaults), defaults);
    let other = json(serde_json::json!({"prefilter": true, "filter": "exact"})).or(&defaults);
    let (other, inherited) = (other.settings, defaults.settings);
    assert_eq!((other.prefilter, other.filter), (Some(true), Some(Filter::Exact)));
    assert_eq!((other.blend, other.shading), (inherited.blend, inherited.shading));
    let points = json(serde_json::json!({"reconstruct": "points"})).or(&defaults);
    assert!(points.request("s", ImageFormat::Png, Instant::now()).is_ok());
}

#[test]
fn matrices_become_a_view() {
    let f = 1.0 / 20f64.to_radians().tan();
    let query = format!(
        "w=64&h=64&view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,-5,1&proj={f},0,0,0,0,{f},0,0,0,0,-1,-1,0,0,-0.1,0"
    );
    let Pose::View(view) = request(&query).unwrap().pose else { panic!() };
    assert_eq!(view.eye, DVec3::new(0.0, 0.0, 5.0));
    assert_eq!(fault(&query.replace("view=1,", "view=2,")).0, "view");
}

#[test]
fn json_names_the_place() {
    let fail = |json: serde_json::Value| {
        let p = FrameParams::from_json(json, "poses[3]").unwrap_err();
        (p.parameter.clone().unwrap(), p.status())
    };
    assert_eq!(fail(serde_json::json!({"eye": [1, 2]})), ("poses[3].eye".into(), 422));
    assert_eq!(fail(serde_json::json!({"eyes": 1})), ("poses[3].eyes".into(), 422));
    assert_eq!(fail(serde_json::json!({"filter": 1})), ("poses[3].filter".into(), 422));
    assert_eq!(fail(serde_json::json!([1])).1, 422);
    assert!(FrameParams::from_json(serde_json::json!({"w": 3}), "").is_ok());
}

#[test]
fn defaults_fill_but_do_not_mix_poses() {
    let json = |v| FrameParams::from_json(v, "").unwrap();
    let defaults = json(serde_json::json!({"eye": [1,2,3], "target": [0,0,0], "fov": 30, "w": 7}));
    let moved = json(serde_json::json!({"eye": [4,5,6]})).or(&defaults);
    assert_eq!((moved.target, moved.fov, moved.w), (Some([0.0; 3]), Some(30.0), Some(7)));
    let named = json(serde_json::json!({"camera": "front", "h": 9})).or(&defaults);
    assert_eq!((named.eye, named.fov, named.w, named.h), (None, None, Some(7), Some(9)));
    assert!(named.request("s", ImageFormat::Png, Instant::now()).is_ok());
    assert_eq!(json(serde_json::json!({})).or(&defaults), defaults);
}

#[test]
fn up_and_fov_apply_to_the_whole_scene() {
    let pose = |query: &str| request(query).unwrap().pose;
    assert_eq!(pose("up=z"), Pose::Fit { up: Some(DVec3::Z), lens: None });
    assert_eq!(
        pose("up=-y&fov=30"),
        Pose::Fit { up: Some(DVec3::NEG_Y), lens: Some(Lens::Perspective { fov_deg: 30.0 }) }
    );
    assert_eq!(pose("up=0,0,2"), Pose::Fit { up: Some(DVec3::Z * 2.0), lens: None });
    let Pose::Camera(camera) = pose("eye=1,0,0&target=0,0,0&up=z") else { panic!("no camera") };
    assert_eq!(camera.up, DVec3::Z);
    let json = |text: &str| {
        let params = FrameParams::from_json(serde_json::from_str(text).unwrap(), "")?;
        params.request("s", ImageFormat::Png, Instant::now())
    };
    let by_name = json(r#"{ "up": "-x" }"#).unwrap().pose;
    assert_eq!(by_name, Pose::Fit { up: Some(DVec3::NEG_X), lens: None });
    let refused = json(r#"{ "up": "w" }"#).unwrap_err();
    assert!(refused.detail.contains("`w` is no axis"), "{}", refused.detail);
}

#[test]
fn a_height_of_the_view_takes_the_place_of_a_field_of_view() {
    let pose = |query: &str| request(query).unwrap().pose;
    let lens = Lens::Orthographic { height: 2.5 };
    assert_eq!(pose("ortho_height=2.5"), Pose::Fit { up: None, lens: Some(lens) });
    let Pose::Camera(camera) = pose("eye=0,0,1&target=0,0,0&up=y&ortho_height=2.5") else {
        panic!("no camera")
    };
    assert_eq!(camera.lens, lens);
    for query in ["fov=30&ortho_height=2", "ortho_height=2&projection=perspective"] {
        assert_eq!(
            request(query).unwrap_err().parameter.as_deref(),
            Some("ortho_height"),
            "{query}"
        );
    }
    let json = |value| FrameParams::from_json(value, "").unwrap();
    let wide = json(serde_json::json!({"eye": [1,2,3], "target": [0,0,0], "fov": 30}));
    let flat = json(serde_json::json!({"ortho_height": 2.0})).or(&wide);
    assert_eq!((flat.fov, flat.ortho_height, flat.eye), (None, Some(2.0), Some([1.0, 2.0, 3.0])));
    assert_eq!(json(serde_json::json!({"fov": 20})).or(&flat).ortho_height, None);
}
