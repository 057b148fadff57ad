//! Where a frame is seen from, and what clips it.

use glam::{DAffine3, DVec3};

use super::loaded::Loaded;
use super::receipt::CameraReceipt;
use super::{EngineError, FrameRequest, Pose};
use crate::math::{Camera, CameraError, FOV_RANGE_DEG, ORTHO_HEIGHT_RANGE, View};
use crate::plan::{ImagePart, Settings};
use crate::scene::clipping::ClipRegion;

/// Returns the boxes that a frame is clipped with, at their place in the scene.
///
/// # Errors
/// The scene has no such node, or the node has no inside.
pub fn clip_region(
    loaded: &Loaded,
    settings: &Settings,
) -> Result<Option<ClipRegion>, EngineError> {
    let Some(boxes) = settings.clip_boxes else { return Ok(None) };
    let box_from_world = match settings.clip_node {
        None => DAffine3::IDENTITY,
        Some(name) => {
            let bad = |reason: String, accepted: String| EngineError::BadParameter {
                parameter: "clip_node",
                reason,
                accepted,
            };
            let node = loaded.node(name.as_str()).ok_or_else(|| {
                let known = loaded.info.nodes.iter().take(20).cloned().collect::<Vec<_>>();
                bad(format!("the scene has no top-level node `{name}`"), known.join(", "))
            })?;
            let inverse = node.parent_from_node.inverse();
            if !inverse.is_finite() {
                let reason =
                    format!("node `{name}` is scaled to nothing, so that it has no inside");
                return Err(bad(reason, "a node whose transform can be inverted".to_owned()));
            }
            inverse
        }
    };
    Ok(Some(ClipRegion { boxes, box_from_world }))
}

/// Size of the image that the pose shows: that of the frame, or of the image that the frame is a part of.
pub fn whole_size(request: &FrameRequest) -> (u32, u32) {
    let of = request.settings.part_of;
    of.map_or((request.width, request.height), |part| (part.width, part.height))
}

/// The part of the whole image's view that the frame shows.
///
/// # Errors
/// The frame reaches beyond the image.
pub fn shown_part(whole: &View, request: &FrameRequest) -> Result<View, EngineError> {
    let Some(part) = request.settings.part_of else { return Ok(*whole) };
    for (name, place, side, all) in [
        ("columns", part.x, request.width, part.width),
        ("rows", part.y, request.height, part.height),
    ] {
        if place.checked_add(side).is_none_or(|end| end > all) {
            return Err(EngineError::BadParameter {
                parameter: ImagePart::NAME,
                reason: format!(
                    "the image has {all} {name}, and a frame of {side} that begins at {place} reaches beyond them"
                ),
                accepted: format!(
                    "a part that lies within {} × {} pixels",
                    part.width, part.height
                ),
            });
        }
    }
    Ok(whole.part([part.x, part.y], [request.width, request.height]))
}

/// Returns the view of the whole image of a frame, and the camera for its receipt.
///
/// # Errors
/// A camera that the scene does not have, or that cannot be drawn.
pub fn pose(
    loaded: &Loaded,
    request: &FrameRequest,
    clip: Option<&ClipRegion>,
) -> Result<(View, CameraReceipt), EngineError> {
    let (width, height) = whole_size(request);
    let camera = match &request.pose {
        Pose::View(view) => {
            if request.settings.part_of.is_some() {
                return Err(EngineError::BadParameter {
                    parameter: ImagePart::NAME,
                    reason: "`view` and `proj` say themselves which part of an image they show"
                        .to_owned(),
                    accepted: "no value, or a pose of another kind".to_owned(),
                });
            }
            check_view(view, request)?;
            let wanted = request.settings.projection;
            if wanted.is_some_and(|wanted| wanted != view.projection) {
                return Err(EngineError::BadParameter {
                    parameter: "projection",
                    reason: "`proj` is another projection".to_owned(),
                    accepted: "no value, or that of `proj`".to_owned(),
                });
            }
            return Ok((*view, receipt_of_view(view)));
        }
        Pose::Camera(camera) | Pose::Moving { camera, .. } => *camera,
        &Pose::Upright { eye, target, lens } => Camera { eye, target, up: loaded.up(), lens },
        &Pose::Fit { up, lens } => loaded
            .fit(f64::from(width) / f64::from(height), up, lens, request.settings.projection, clip)
            .map_err(bad_camera)?,
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
    let (view, camera) = view_of(&camera, request)?;
    Ok((view, receipt_of_camera(&camera, width, height)))
}

/// The view of a camera for the whole image of a frame, and the camera in the projection that the request asks for.
///
/// # Errors
/// A camera that cannot be drawn.
pub fn view_of(camera: &Camera, request: &FrameRequest) -> Result<(View, Camera), EngineError> {
    let (width, height) = whole_size(request);
    // A camera that cannot be drawn has no other projection either.
    camera.view(width, height).map_err(bad_camera)?;
    let camera =
        request.settings.projection.map_or(*camera, |wanted| camera.with_projection(wanted));
    Ok((camera.view(width, height).map_err(bad_camera)?, camera))
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
        fov_deg: camera.lens.fov_deg(),
        ortho_height: camera.lens.ortho_height(),
        width,
        height,
    }
}

fn receipt_of_view(view: &View) -> CameraReceipt {
    let axes = view.view_from_world.transpose();
    let forward: DVec3 = -axes.z_axis;
    let height = f64::from(view.height) / view.focal_px.y;
    let is_orthographic = view.is_orthographic();
    CameraReceipt {
        eye: view.eye.into(),
        target: (view.eye + forward).into(),
        up: axes.y_axis.into(),
        fov_deg: (!is_orthographic).then(|| 2.0 * (0.5 * height).atan().to_degrees()),
        ortho_height: is_orthographic.then_some(height),
        width: view.width,
        height: view.height,
    }
}

fn bad_camera(error: CameraError) -> EngineError {
    let accepted = match error.parameter {
        "fov" => {
            let [least, most] = FOV_RANGE_DEG;
            &format!("{least} to {most} degrees")
        }
        "ortho_height" => {
            let [least, most] = ORTHO_HEIGHT_RANGE;
            &format!("{least:e} to {most:e} scene units")
        }
        "view" => "16 numbers, column-major: rotation and translation",
        "proj" => {
            "16 numbers, column-major: a perspective that looks along −z, or an orthographic projection"
        }
        _ => "three numbers within ±1e100, eye and target apart",
    };
    EngineError::BadParameter {
        parameter: error.parameter,
        reason: error.reason,
        accepted: accepted.to_owned(),
    }
}
