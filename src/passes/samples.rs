//! Constants of passes over samples, which depend on how samples are drawn and on what a segment holds.

use super::pipelines::Constants;
use super::recorder::{Recorder, Segment};
use crate::plan::Reconstruction;
use crate::scene::Filter;

/// Number of a filter in shaders.
pub fn filter_number(filter: Filter) -> u32 {
    match filter {
        Filter::Affine => 0,
        Filter::Perspective => 1,
        Filter::Exact => 2,
    }
}

/// Overrides of `shared/splat`; `walked`: in a pass over the list of large splats.
pub fn splat_constants(reconstruction: &Reconstruction, walked: bool) -> Constants {
    if reconstruction.discs().is_some() {
        let plain = ["FILTER", "PREFILTER", "GENERAL", "WEIGHTED"].map(|name| (name, 0));
        return [&plain[..], &[("DISCS", 1)]].concat();
    }
    let Some(splats) = reconstruction.splats() else { return Constants::new() };
    vec![
        ("FILTER", filter_number(splats.filter)),
        ("PREFILTER", u32::from(splats.prefilter)),
        ("GENERAL", u32::from(walked || splats.filter == Filter::Exact)),
        ("WEIGHTED", u32::from(reconstruction.weighted().is_some())),
    ]
}

/// Overrides of passes over the visibility of splats. Translucent splats are not blended with each other: each is where its disk is.
pub fn visible_constants(recorder: &Recorder, walked: bool) -> Constants {
    let mut constants = splat_constants(&recorder.task.reconstruction, walked);
    if recorder.stage.is_windowed() {
        let weighted = constants.iter_mut().filter(|(name, _)| *name == "WEIGHTED");
        weighted.for_each(|(_, value)| *value = 0);
    }
    constants.extend(node_constants(recorder, recorder.segment));
    constants
}

/// Whether a segment's page may have both translucent and opaque elements.
pub fn is_mixed(recorder: &Recorder, segment: Segment) -> bool {
    segment.is_some_and(|index| recorder.is_mixed(recorder.scene.pages[index].kind))
}

/// Override of `shared/sorts`, for pages that may have translucent elements.
pub fn sort_constants(recorder: &Recorder, segment: Segment) -> Constants {
    let sort = match (recorder.task.draws_opaque_first(), recorder.stage.is_windowed()) {
        (false, _) => 3,
        (true, windowed) => 1 + u32::from(windowed),
    };
    is_mixed(recorder, segment).then_some(("SORT", sort)).into_iter().collect()
}

/// Whether a segment's samples carry clip lines.
pub fn is_clipped(recorder: &Recorder, segment: Segment) -> bool {
    segment.is_some_and(|index| recorder.scene.pages[index].kind.clipped)
}

/// Whether a segment's samples are nodes of point trees.
pub fn is_tree(recorder: &Recorder, segment: Segment) -> bool {
    segment.is_some_and(|index| recorder.scene.pages[index].kind.nodes)
}

/// Overrides of `shared/nodes_tree`, where a pass is made of it.
pub fn node_constants(recorder: &Recorder, segment: Segment) -> Constants {
    if !is_tree(recorder, segment) {
        return Constants::new();
    }
    recorder.tree_constants().into()
}

/// Overrides of `shared/nodes_tree` for passes that see colours.
pub fn paint_constants(recorder: &Recorder, segment: Segment) -> Constants {
    let levels = u32::from(recorder.task.levels);
    is_tree(recorder, segment).then_some(("LEVELS", levels)).into_iter().collect()
}
