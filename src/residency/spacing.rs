//! Where a scene's samples and triangles are and how far apart, in few words.

use crate::bake::pack::{GeometryKind, PackedGeometry};
use crate::bake::spacing::{Patch, measure, merged};

use super::model::SceneModel;

/// Patches of a scene, roughly, at most.
const PATCHES: usize = 512;
/// Instances that are looked at for a patch that stands for many.
const LOOKED_AT: usize = 16;

/// The patches of a scene's elements of one kind in world space. Their number is bounded by a constant, however many elements and
/// instances there are.
pub fn patches(model: &SceneModel, kind: GeometryKind) -> Vec<Patch> {
    let has_any = |geometry: &PackedGeometry| geometry.kind() == kind && !geometry.is_empty();
    let holding = || model.instances.iter().filter(|instance| has_any(model.geometry(instance)));
    let count = holding().count();
    let each = PATCHES.checked_div(count).unwrap_or(0).max(1);
    let local: Vec<Vec<Vec<Patch>>> = model
        .assets
        .iter()
        .map(|asset| {
            let of = |geometry: &PackedGeometry| {
                let is_asked_for = count > 0 && has_any(geometry);
                if is_asked_for { measure(geometry, each) } else { Vec::new() }
            };
            asset.packed.geometries.iter().map(of).collect()
        })
        .collect();
    let run = count.div_ceil(PATCHES).max(1);
    let every = run.div_ceil(LOOKED_AT).max(1);
    let looked_at = holding().step_by(every).flat_map(|instance| {
        let local = &local[instance.asset][instance.geometry];
        local.iter().map(move |patch| {
            let placed = patch.placed(&instance.world_from_geometry);
            Patch { count: placed.count * every as f64, ..placed }
        })
    });
    let placed: Vec<Patch> = looked_at
        .filter(|patch| {
            patch.centre.is_finite() && patch.radius.is_finite() && patch.spacing.is_finite()
        })
        .collect();
    if run > 1 { merged(&placed, PATCHES) } else { placed }
}

/// Distance between neighbouring samples, at the median over samples; 0 where there are none.
pub fn usual(patches: &[Patch]) -> f64 {
    let mut spacings: Vec<(f64, f64)> =
        patches.iter().map(|patch| (patch.spacing, patch.count)).collect();
    spacings.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut left = 0.5 * spacings.iter().map(|(_, count)| count).sum::<f64>();
    let reached = spacings.iter().find(|(_, count)| {
        left -= count;
        left <= 0.0
    });
    reached.map_or(0.0, |(spacing, _)| *spacing)
}
