//! Entity tags of frames.

use sha2::{Digest, Sha256};

use super::FrameRequest;
use super::loaded::Loaded;
use super::resolved::Drawing;
use super::state::Adapter;
use crate::encode::ImageFormat;
use crate::math::View;
use crate::plan::auto::Choice;
use crate::plan::planner::Goal;

/// Inputs of an entity tag besides the scene, the request and the view.
pub struct Tagged<'a> {
    pub auto: Option<&'a Choice>,
    pub goal: Option<Goal>,
    pub drawing: &'a Drawing,
    /// How the frame is drawn where it turns out that this way cannot draw it.
    pub instead: Option<&'a Drawing>,
    pub is_provisional: bool,
}

/// Returns a hash of all that decides a frame's bytes, in quotes as HTTP requires. The tag of a provisional frame only distinguishes it
/// from other frames while it is being drawn; no client receives it. `views` are the frame's view and those of its exposures.
pub fn entity_tag(
    loaded: &Loaded,
    request: &FrameRequest,
    Tagged { auto, goal, drawing, instead, is_provisional }: &Tagged<'_>,
    views: &[View],
    adapter: &Adapter,
) -> String {
    let mut hasher = Sha256::new();
    hasher.update(&adapter.renderer);
    hasher.update(&adapter.name);
    let is_jpeg = request.format == ImageFormat::Jpeg;
    hasher.update([
        u8::from(adapter.atomics_64),
        if is_jpeg { request.quality } else { 0 },
        request.format as u8,
        request.output as u8,
    ]);
    // The rest of what the scene says of splats is in its digest.
    hasher.update(drawing.applied.bytes());
    if let Some(instead) = instead {
        // Settings without effect on one of the ways may have an effect on the other.
        hasher.update(b"instead");
        hasher.update(instead.applied.bytes());
    }
    if *is_provisional {
        hasher.update(b"provisional");
    }
    if let Some(goal) = goal {
        // The receipt has them.
        hasher.update(b"planned");
        for bound in [goal.most_ms, goal.least_db] {
            hasher.update(bound.unwrap_or(-1.0).to_bits().to_le_bytes());
        }
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
    for view in views {
        view.eye.to_array().into_iter().for_each(&mut number);
        view.view_from_world.to_cols_array().into_iter().for_each(&mut number);
        number(view.focus);
        view.focal_px.to_array().into_iter().for_each(&mut number);
        view.principal_px.to_array().into_iter().for_each(&mut number);
    }
    // They are all of one size.
    if let Some(view) = views.first() {
        hasher.update(view.width.to_le_bytes());
        hasher.update(view.height.to_le_bytes());
    }
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
