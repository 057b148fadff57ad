use super::*;
use crate::plan::{ColorBy, Lod, MaxError};
use crate::scene::Filter;

pub fn spec(scene: &str) -> Spec {
    let request = FrameRequest {
        scene: scene.to_owned(),
        pose: Pose::FIT,
        width: 64,
        height: 48,
        settings: Settings {
            lod: Lod::Spt,
            max_error_px: MaxError::new(2.5).unwrap(),
            ..Settings::default()
        },
        output: Output::Color,
        format: ImageFormat::Png,
        quality: 85,
        deadline: None,
    };
    Spec {
        scene: scene.to_owned(),
        path: PathChoice::Named("fly".to_owned()),
        fps: None,
        from: None,
        to: Some(9),
        frame: FrameSpec::new(&request),
        want: Want { frames: true, video: false, bitrate_kbps: None },
    }
}

/// A frame of a job as the previous version stored it.
const STORED: &str = r#"{
    "width": 64, "height": 48, "format": "png", "quality": 85, "output": "color", "lod": "spt", "max_error_px": 2.5,
    "error_mode": "unified", "paint": "levels", "reconstruct": "splats", "filter": "exact", "prefilter": false,
    "blend": null, "shading": null
}"#;

#[test]
fn jobs_of_earlier_versions_stay_readable() {
    let stored: FrameSpec = serde_json::from_str(STORED).unwrap();
    let asked = Settings {
        lod: Lod::Spt,
        max_error_px: MaxError::new(2.5).unwrap(),
        // It was called `paint`.
        color_by: ColorBy::Levels,
        reconstruct: Reconstruct::Splats,
        filter: Some(Filter::Exact),
        prefilter: Some(false),
        edl: Edl::Off,
        ..Settings::default()
    };
    let mut spec = spec("s");
    spec.frame = stored;
    assert_eq!(spec.request().settings, Settings { wait: Wait::Whole, ..asked });
    // An equal job created today has the same frame specification.
    let today = FrameRequest { settings: asked, ..spec.request() };
    assert_eq!(FrameSpec::new(&today), stored);
    // A goal leaves open what it does not store.
    let given = Given { min_psnr_db: Some(30.0), ..Given::default() };
    let goal = FrameRequest { settings: given.into(), ..spec.request() };
    let text = serde_json::to_string(&FrameSpec::new(&goal)).unwrap();
    let stored: FrameSpec = serde_json::from_str(&text).unwrap();
    assert_eq!(
        Settings::from(stored.settings),
        Settings { wait: Wait::default(), ..goal.settings }
    );
    let full: FrameSpec = serde_json::from_str(&STORED.replace("spt", "full")).unwrap();
    assert_eq!(full.settings.max_error_px, None, "full detail has no error");
}

#[test]
fn jobs_that_name_no_reconstruction_are_drawn_as_points() {
    let mut kept = serde_json::to_value(spec("s")).unwrap();
    assert_eq!(kept["frame"]["reconstruct"], "auto");
    kept["frame"].as_object_mut().unwrap().remove("reconstruct");
    let kept: Spec = serde_json::from_value(kept).unwrap();
    assert_eq!(kept.request().settings.reconstruct, Reconstruct::Points);
}

#[test]
fn what_is_kept_is_what_was_asked_for() {
    let one = spec("s");
    let kept: Spec = serde_json::from_slice(&serde_json::to_vec(&one).unwrap()).unwrap();
    assert_eq!(kept, one);
    assert_eq!(FrameSpec::new(&kept.request()), one.frame);
    assert_eq!(kept.fingerprint(), one.fingerprint());
    assert_ne!(spec("t").fingerprint(), one.fingerprint());
}
