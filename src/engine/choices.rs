//! Choices that a request leaves to the engine: how samples are drawn, and whether point trees are worth their while.

use super::FrameRequest;
use super::loaded::Loaded;
use super::state::EngineState;
use crate::bake::pack::GeometryKind;
use crate::math::View;
use crate::plan::auto::{self, Choice};
use crate::plan::detail::{Costs, Detail, DetailGrounds, choose as choose_detail};
use crate::plan::{Lod, SceneFacts, Settings};

/// Decides how a frame with `lod=spt` is drawn. Returns the request as it is drawn, and why at full detail where the request does not ask
/// for that.
pub fn with_detail(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
    view: &View,
) -> (FrameRequest, Option<String>) {
    let mut drawn = request.clone();
    let settings = &request.settings;
    // Levels are those of nodes.
    let is_open = settings.draws_trees() && !settings.shows_levels();
    if !is_open {
        return (drawn, None);
    }
    if let Some(what) = translucent(&loaded.facts) {
        // The asset's tree has opaque samples.
        drawn.settings.lod = Lod::Full;
        return (drawn, Some(format!("{what}, which point trees lack")));
    }
    if !state.config.may_draw_in_full {
        return (drawn, None);
    }
    let counts = loaded.facts.counts;
    let drawn_as = |lod, has_samples| {
        let settings = Settings { lod, ..*settings };
        if !settings.leaves_drawing_open() {
            return settings;
        }
        let at = FrameRequest { settings, ..request.clone() };
        let chosen = choose_for(loaded, &at, has_samples, view);
        settings.decided(chosen.reconstruct)
    };
    let choice = choose_detail(&DetailGrounds {
        samples: loaded.patches(GeometryKind::Samples),
        triangles: loaded.patches(GeometryKind::Triangles),
        segments: loaded.patches(GeometryKind::Lines),
        view,
        elements: loaded.model.assets.iter().map(|asset| asset.counts().elements()).sum(),
        chunks: counts.chunks,
        full: &drawn_as(Lod::Full, counts.samples > 0),
        // Trees of meshes have samples as well.
        tree: &drawn_as(Lod::Spt, true),
        costs: Costs::of(state.is_on_discrete_gpu()),
    });
    match choice {
        Detail::Full { because } => {
            drawn.settings.lod = Lod::Full;
            (drawn, Some(because))
        }
        Detail::Tree { error } => {
            drawn.settings = settings.accepting(error);
            (drawn, None)
        }
    }
}

/// Says what of a scene is translucent that its point trees would show opaque.
fn translucent(facts: &SceneFacts) -> Option<&'static str> {
    if facts.looks.translucent_overrides.contains(&true) {
        return Some("nodes have translucent colours");
    }
    let kinds = [
        (GeometryKind::Samples, "the scene has translucent samples"),
        (GeometryKind::Lines, "the scene has translucent lines"),
    ];
    kinds.into_iter().find(|&(kind, _)| facts.is_translucent(kind)).map(|(_, what)| what)
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
    let patches = loaded.patches(GeometryKind::Samples);
    let spacing_px = auto::spacing_px(patches, view);
    auto::Grounds {
        lod: settings.lod,
        has_samples,
        spacing_px: spacing_px.map(|px| px * magnification(request)),
        parts: settings.decisive_parts(),
        covered: auto::covered_share(patches, view),
        outgrow: auto::outgrow(patches, spacing_px, view),
        are_splats_plain: !settings.has_splat_choices() && !loaded.has_clip_lines(),
        accepted_px: settings.decisive_error().px(),
        has_kernels: true,
        has_point_size: settings.has_point_size(),
    }
}
