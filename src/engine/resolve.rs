//! Requests → what they mean for the scene as it is now. Everything that can be wrong with a request is found here, before any
//! work on the GPU.

use std::sync::Arc;

use glam::DVec3;
use sha2::{Digest, Sha256};

use super::bakes::Goal;
use super::job::{Drawing, Resolved};
use super::library::Loaded;
use super::receipt::CameraReceipt;
use super::shared::{Adapter, Shared};
use super::{EngineError, FrameRequest, Pose};
use crate::encode::{self, EncodeError};
use crate::math::{Camera, CameraError, FOV_RANGE_DEG, View};
use crate::passes::{LAYERS_BYTES, Slabs};
use crate::plan::auto::{self, Choice};
use crate::plan::{AdapterFacts, Lod, Output, Reconstruct, Settings, Wait, plan};

/// Most pixels and longest side of a frame on this adapter.
pub fn frame_limits(shared: &Shared) -> (u64, u32) {
    let adapter = shared.adapter();
    // The visibility buffer has eight bytes a pixel and is bound whole.
    (
        shared.config.max_pixels.min(adapter.max_binding_bytes / 8),
        shared.config.max_side.min(adapter.max_side),
    )
}

fn bad_camera(error: CameraError) -> EngineError {
    let accepted = match error.parameter {
        "fov" => {
            let [least, most] = FOV_RANGE_DEG;
            &format!("{least} to {most} degrees")
        }
        "view" => "16 numbers, column-major: rotation and translation",
        "proj" => "16 numbers, column-major: a perspective that looks along −z",
        _ => "three numbers within ±1e100, eye and target apart",
    };
    EngineError::BadParameter {
        parameter: error.parameter,
        reason: error.reason,
        accepted: accepted.to_owned(),
    }
}

fn check_size(shared: &Shared, request: &FrameRequest) -> Result<(), EngineError> {
    let (max_pixels, max_side) = frame_limits(shared);
    for (parameter, value) in [("w", request.width), ("h", request.height)] {
        if value == 0 {
            return Err(EngineError::BadParameter {
                parameter,
                reason: "a frame has at least one pixel".to_owned(),
                accepted: format!("1 to {max_side}"),
            });
        }
        if value > max_side {
            return Err(EngineError::OverLimit {
                what: if parameter == "w" { "pixels in w" } else { "pixels in h" },
                found: u64::from(value),
                limit: u64::from(max_side),
            });
        }
    }
    let found = u64::from(request.width) * u64::from(request.height);
    if found > max_pixels {
        let what = if found > shared.config.max_pixels {
            "pixels"
        } else {
            "pixels that this adapter binds at once, which no setting raises"
        };
        return Err(EngineError::OverLimit { what, found, limit: max_pixels });
    }
    Ok(())
}

fn unfit_format(error: EncodeError) -> EngineError {
    let (reason, accepted) = match error {
        EncodeError::Unsupported { format, output, accepted } => {
            (format!("{format:?} cannot hold {output:?}").to_lowercase(), accepted)
        }
        other => (other.to_string(), "another format or size"),
    };
    EngineError::BadParameter { parameter: "format", reason, accepted: accepted.to_owned() }
}

/// Validates a request against the scene as it is now.
pub fn resolve(shared: &Shared, request: &FrameRequest) -> Result<Resolved, EngineError> {
    let loaded = shared.library.read().get(&request.scene);
    let loaded = loaded.ok_or_else(|| EngineError::UnknownScene { id: request.scene.clone() })?;
    check_size(shared, request)?;
    if !(1..=100).contains(&request.quality) {
        return Err(EngineError::BadParameter {
            parameter: "quality",
            reason: format!("{} is out of range", request.quality),
            accepted: "1 to 100".to_owned(),
        });
    }
    encode::accepts(request.format, request.output).map_err(unfit_format)?;
    let (view, camera) = pose(&loaded, request)?;
    let adapter = shared.adapter();
    let loaded = match goal(&loaded, request) {
        Some(_) => shared.whole(&loaded)?,
        None => loaded,
    };
    let (model, facts) = match request.settings.lod {
        Lod::Full => (loaded.model.clone(), loaded.facts),
        Lod::Spt => {
            let trees = loaded.trees(shared.config.bake_cache.as_ref())?;
            (trees.model, trees.facts)
        }
    };
    let is_open = request.settings.reconstruct == Reconstruct::Auto;
    let mut auto = is_open.then(|| choose_for(&loaded, request, facts.has_samples, &view));
    let mut provisional = None;
    if let Some(choice) = &mut auto
        && loaded.lacks(choice.reconstruct, request.settings.lod, request.output)
    {
        provisional = Some(match shared.estimate_in_background(&loaded) {
            Ok(done) => {
                format!("normals and kernels are being estimated ({:.0} %)", done * 100.0)
            }
            Err(error) => format!("normals and kernels cannot be estimated: {error}"),
        });
        let grounds = grounds(&loaded, request, facts.has_samples, &view);
        *choice = auto::choose(&auto::Grounds { has_kernels: false, ..grounds });
    }
    let settings = Settings {
        reconstruct: auto.map_or(request.settings.reconstruct, |choice| choice.reconstruct),
        ..request.settings
    };
    let way = |settings: &Settings, instead_because| {
        let splats = settings.splats(&loaded.model.splats);
        let adapter = AdapterFacts {
            atomics_64: adapter.atomics_64,
            rasterises: adapter.rasterises,
            draws_hidden: shared.config.draw_hidden,
        };
        let plan = plan(&facts, request.output, splats.as_ref(), &adapter);
        Drawing { plan, reconstruct: settings.reconstruct, instead_because, splats }
    };
    let other = settings.in_three_passes();
    let is_single = settings.reconstruct == Reconstruct::Fuzzy && facts.has_samples;
    let fits = || {
        let splats = settings.splats(&loaded.model.splats);
        let accepted_px = if facts.trees { settings.max_error_px.px() } else { 0.0 };
        splats.is_none_or(|s| Slabs::new(&s, &loaded.extent, &view, accepted_px).fit())
    };
    let refused = if !is_single {
        None
    } else if let Some(reason) = no_single_pass(request, &adapter) {
        Some(reason)
    } else {
        (!fits()).then_some("the scene is too deep for the slabs of a single pass")
    };
    let drawing = match refused {
        Some(_) => way(&other, refused),
        None => way(&settings, None),
    };
    let in_three_passes = (is_single && refused.is_none()).then(|| {
        way(&other, Some("more splats lie over one pixel than a single pass has room for"))
    });
    let tagged = Tagged {
        settings: &settings,
        auto: auto.as_ref(),
        drawing: &drawing,
        is_provisional: provisional.is_some(),
    };
    let key = entity_tag(&loaded, request, &tagged, &view, &adapter);
    let extent = loaded.extent;
    Ok(Resolved {
        model,
        view,
        camera,
        extent,
        drawing,
        provisional,
        auto,
        in_three_passes,
        max_error: request.settings.max_error_px,
        key,
        picks: Arc::default(),
    })
}

/// What has to be made of a scene before a request's frame can be drawn.
pub fn goal(loaded: &Loaded, request: &FrameRequest) -> Option<Goal> {
    let Settings { lod, reconstruct, wait, .. } = request.settings;
    if lod == Lod::Spt {
        return (!loaded.has_trees()).then_some(Goal::Trees);
    }
    if loaded.is_whole() {
        return None;
    }
    let lacks = match (reconstruct, wait) {
        (_, Wait::Whole) => true,
        // A picture of normals needs them however samples are drawn.
        (Reconstruct::Auto, Wait::Ready) => {
            loaded.lacks(Reconstruct::Points, lod, request.output)
                && request.output == Output::Normal
        }
        (Reconstruct::Auto, Wait::Complete) => match pose(loaded, request) {
            Ok((view, _)) => {
                let wanted = choose_for(loaded, request, loaded.facts.has_samples, &view);
                loaded.lacks(wanted.reconstruct, lod, request.output)
            }
            // The frame is refused.
            Err(_) => false,
        },
        _ => loaded.lacks(reconstruct, lod, request.output),
    };
    lacks.then_some(Goal::Estimates)
}

/// How samples are drawn where the request leaves that open, once they have everything.
fn choose_for(loaded: &Loaded, request: &FrameRequest, has_samples: bool, view: &View) -> Choice {
    auto::choose(&grounds(loaded, request, has_samples, view))
}

fn grounds(
    loaded: &Loaded,
    request: &FrameRequest,
    has_samples: bool,
    view: &View,
) -> auto::Grounds {
    let settings = &request.settings;
    let (larger, max_error) = match settings.decide_for {
        Some(still) => (f64::from(still.height) / f64::from(request.height), still.max_error),
        None => (1.0, settings.max_error_px),
    };
    auto::Grounds {
        lod: settings.lod,
        has_samples,
        spacing_px: auto::spacing_px(loaded.patches(), view).map(|px| px * larger),
        max_error_px: max_error.px(),
        has_kernels: true,
    }
}

/// Why splats cannot be blended and depth-tested in a single pass.
fn no_single_pass(request: &FrameRequest, adapter: &Adapter) -> Option<&'static str> {
    let pixels = u64::from(request.width) * u64::from(request.height);
    if request.output != Output::Color {
        return Some("a single pass has nothing but colours");
    }
    if !adapter.atomic_sums_64 {
        return Some("a single pass needs 64-bit atomics that add and exchange");
    }
    (pixels * LAYERS_BYTES > adapter.max_binding_bytes)
        .then_some("the adapter cannot bind what a single pass needs for so many pixels")
}

fn pose(loaded: &Loaded, request: &FrameRequest) -> Result<(View, CameraReceipt), EngineError> {
    let (width, height) = (request.width, request.height);
    let camera = match &request.pose {
        Pose::View(view) => {
            check_view(view, request)?;
            return Ok((*view, receipt_of_view(view)));
        }
        Pose::Camera(camera) => *camera,
        &Pose::Upright { eye, target, fov_deg } => Camera { eye, target, up: loaded.up(), fov_deg },
        &Pose::Fit { up, fov_deg } => {
            loaded.fit(f64::from(width) / f64::from(height), up, fov_deg).map_err(bad_camera)?
        }
        Pose::Named(name) => {
            let cameras = &loaded.model.cameras;
            let found = cameras.iter().find(|(known, _)| known == name);
            found.map(|(_, camera)| camera.for_frame(width, height)).ok_or_else(|| {
                let known: Vec<&str> = cameras.iter().map(|(name, _)| name.as_str()).collect();
                EngineError::BadParameter {
                    parameter: "camera",
                    reason: format!("the scene has no camera `{name}`"),
                    accepted: if known.is_empty() {
                        "eye, target, up and fov: this scene names no cameras".to_owned()
                    } else {
                        known.join(", ")
                    },
                }
            })?
        }
    };
    let view = camera.view(width, height).map_err(bad_camera)?;
    Ok((view, receipt_of_camera(&camera, width, height)))
}

/// A view made elsewhere: it must be for this size, and of numbers that can be drawn with.
fn check_view(view: &View, request: &FrameRequest) -> Result<(), EngineError> {
    let bad = |reason: String, accepted: &str| EngineError::BadParameter {
        parameter: "view",
        reason,
        accepted: accepted.to_owned(),
    };
    if (view.width, view.height) != (request.width, request.height) {
        return Err(bad(
            format!("was made for {} × {} pixels", view.width, view.height),
            "a view of the frame's own size",
        ));
    }
    let finite = view.eye.is_finite()
        && view.view_from_world.is_finite()
        && view.principal_px.is_finite()
        && view.focal_px.is_finite();
    if !finite || view.focal_px.min_element() <= 0.0 {
        return Err(bad("has numbers that are not finite".to_owned(), "finite numbers"));
    }
    Ok(())
}

fn receipt_of_camera(camera: &Camera, width: u32, height: u32) -> CameraReceipt {
    CameraReceipt {
        eye: camera.eye.into(),
        target: camera.target.into(),
        up: camera.up.into(),
        fov_deg: camera.fov_deg,
        width,
        height,
    }
}

fn receipt_of_view(view: &View) -> CameraReceipt {
    let axes = view.view_from_world.transpose();
    let forward: DVec3 = -axes.z_axis;
    CameraReceipt {
        eye: view.eye.into(),
        target: (view.eye + forward).into(),
        up: axes.y_axis.into(),
        fov_deg: 2.0 * (0.5 * f64::from(view.height) / view.focal_px.y).atan().to_degrees(),
        width: view.width,
        height: view.height,
    }
}

/// What a frame's tag depends on, beside the scene, the request and the view.
struct Tagged<'a> {
    settings: &'a Settings,
    auto: Option<&'a Choice>,
    drawing: &'a Drawing,
    is_provisional: bool,
}

/// Hash of all that decides a frame's bytes, quoted as HTTP wants it. That of a provisional frame tells it from all others while it is
/// being drawn; nobody outside gets to see it.
fn entity_tag(
    loaded: &Loaded,
    request: &FrameRequest,
    Tagged { settings, auto, drawing, is_provisional }: &Tagged<'_>,
    view: &View,
    adapter: &Adapter,
) -> String {
    let mut hasher = Sha256::new();
    hasher.update(&adapter.renderer);
    hasher.update(&adapter.name);
    hasher.update([
        u8::from(adapter.atomics_64),
        request.quality,
        request.format as u8,
        request.output as u8,
    ]);
    // The rest of what the scene says of splats is in its digest.
    hasher.update(settings.settled(drawing.splats.as_ref()).canonical());
    if *is_provisional {
        hasher.update(b"provisional");
    }
    if let Some(choice) = auto {
        // The receipt has them.
        hasher.update(b"auto");
        hasher.update(choice.spacing_px.unwrap_or(-1.0).to_bits().to_le_bytes());
    }
    hasher.update(loaded.digest);
    hasher.update(loaded.model.revision.to_le_bytes());
    hasher.update(loaded.model.id.as_bytes());
    let mut number = |v: f64| hasher.update((v + 0.0).to_bits().to_le_bytes());
    view.eye.to_array().into_iter().for_each(&mut number);
    view.view_from_world.to_cols_array().into_iter().for_each(&mut number);
    view.focal_px.to_array().into_iter().for_each(&mut number);
    view.principal_px.to_array().into_iter().for_each(&mut number);
    hasher.update(view.width.to_le_bytes());
    hasher.update(view.height.to_le_bytes());
    let digest = hasher.finalize();
    let mut tag = String::with_capacity(34);
    tag.push('"');
    for byte in &digest[..16] {
        tag.push(char::from(b"0123456789abcdef"[usize::from(byte >> 4)]));
        tag.push(char::from(b"0123456789abcdef"[usize::from(byte & 15)]));
    }
    tag.push('"');
    tag
}
