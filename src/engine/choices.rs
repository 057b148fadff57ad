//! Choices that a request leaves to the engine: how samples are drawn, and whether point trees are worth their while.

use super::FrameRequest;
use super::loaded::Loaded;
use super::state::EngineState;
use crate::math::View;
use crate::plan::Lod;
use crate::plan::auto::{self, Choice};
use crate::plan::detail::{DetailGrounds, why_full};

/// Says why a frame with `lod=spt` is drawn at full detail; `None` for a frame that is drawn from point trees or asks for full detail.
pub fn full_because(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
    view: &View,
) -> Option<String> {
    let settings = &request.settings;
    // Levels are those of nodes.
    let is_open = settings.lod == Lod::Spt && !settings.shows_levels();
    if !is_open || !state.config.may_draw_in_full {
        return None;
    }
    let counts = loaded.facts.counts;
    let grounds = DetailGrounds {
        samples: counts.samples,
        triangles: counts.triangles,
        instances: counts.instances,
        pixels: u64::from(request.width) * u64::from(request.height),
        reconstruct: settings.reconstruct,
        accepted_px: settings.accepted_px(),
    };
    why_full(&grounds, || auto::usual_spacing_px(loaded.patches(), view))
}

/// Returns the request with the level of detail that it is drawn at.
pub fn in_full(request: &FrameRequest, full: bool) -> FrameRequest {
    let mut drawn = request.clone();
    if full {
        drawn.settings.lod = Lod::Full;
    }
    drawn
}

/// Chooses how samples are drawn where the request leaves it open, as if all normals and kernels were there.
pub fn choose_for(
    loaded: &Loaded,
    request: &FrameRequest,
    has_samples: bool,
    view: &View,
) -> Choice {
    auto::choose(&grounds(loaded, request, has_samples, view))
}

/// Height of the frame that `auto` decides for, as a multiple of that of the request.
pub fn magnification(request: &FrameRequest) -> f64 {
    let still = request.settings.decide_for;
    still.map_or(1.0, |still| f64::from(still.height) / f64::from(request.height))
}

/// Returns the facts by which `auto` decides.
pub fn grounds(
    loaded: &Loaded,
    request: &FrameRequest,
    has_samples: bool,
    view: &View,
) -> auto::Grounds {
    let settings = &request.settings;
    let spacing_px = auto::spacing_px(loaded.patches(), view);
    auto::Grounds {
        lod: settings.lod,
        has_samples,
        spacing_px: spacing_px.map(|px| px * magnification(request)),
        accepted_px: settings.decisive_error().px(),
        has_kernels: true,
        has_point_size: settings.has_point_size(),
    }
}
