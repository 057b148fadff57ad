//! Whether a scene fits a budget and an adapter, from its model alone.

use std::collections::HashSet;
use std::sync::Arc;

use super::layout::{self, GpuMaterial, GpuTexture};
use super::model::{AssetModel, SceneModel};
use super::{PARTS_BYTES, ResidencyError, TEXEL_PAGES, slots};

/// The part of a scene that has to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Everything that its frames need.
    Whole,
    /// All but the list of every chunk of every instance: frames of point trees list what they need.
    Stored,
}

/// Whether a scene fits a budget and an adapter's largest binding.
///
/// # Errors
/// The part of a scene that is too large, and by how much.
pub fn check_fits(
    max_binding: u64,
    budget: u64,
    model: &SceneModel,
    part: Part,
) -> Result<(), ResidencyError> {
    let lists = if part == Part::Whole { model.list_bytes() } else { model.group_bytes() };
    let needed = model.asset_bytes() + lists;
    if needed > budget {
        return Err(ResidencyError::OverBudget {
            what: format!("scene `{}`", model.id),
            needed,
            budget,
        });
    }
    let counts = model.counts();
    // A frame of point trees lists what it needs.
    let listed = if model.trees || part == Part::Stored { 0 } else { counts.chunks };
    let slots = listed * size_of::<layout::GpuSlot>() as u64;
    let instances = if model.trees {
        slots::groups_of(&model.instances) as u64 * slots::SLOT_BYTES
    } else {
        counts.instances * size_of::<layout::GpuInstance>() as u64
    };
    let chunks = distinct_assets(model)
        .flat_map(|asset| &asset.packed.geometries)
        .map(|geometry| geometry.chunks().len() as u64 * PARTS_BYTES)
        .sum();
    let materials =
        distinct_assets(model).map(|asset| asset.packed.materials.len() as u64).sum::<u64>()
            + model.materials.len() as u64
            + 1;
    let textures: u64 =
        distinct_assets(model).map(|asset| asset.packed.textures.len() as u64).sum();
    for (what, needed) in [
        ("materials", materials * size_of::<GpuMaterial>() as u64),
        ("textures", textures * size_of::<GpuTexture>() as u64),
        ("visible chunks of all instances", slots),
        ("instances", instances),
        ("chunks of all assets", chunks),
    ] {
        if needed > max_binding {
            return Err(ResidencyError::OverBinding { what, needed, limit: max_binding });
        }
    }
    check_textures(max_binding, model)?;
    if listed >= 1 << 22 {
        return Err(ResidencyError::OverBinding {
            what: "chunks of all instances",
            needed: listed,
            limit: 1 << 22,
        });
    }
    Ok(())
}

/// Whether the textures of a scene alone fit the pages of texels: first fit, as they are uploaded.
fn check_textures(max_binding: u64, model: &SceneModel) -> Result<(), ResidencyError> {
    let mut free_bytes: Vec<u64> = Vec::new();
    for texture in distinct_assets(model).flat_map(|asset| &asset.packed.textures) {
        let needed = texture.texels.len() as u64 * 4;
        if needed > max_binding {
            let what = "a texture with its smaller levels";
            return Err(ResidencyError::OverBinding { what, needed, limit: max_binding });
        }
        match free_bytes.iter_mut().find(|free| **free >= needed) {
            Some(free) => *free -= needed,
            None => free_bytes.push(max_binding - needed),
        }
    }
    if free_bytes.len() > TEXEL_PAGES {
        return Err(ResidencyError::OverBudget {
            what: format!("pages for the textures of scene `{}`", model.id),
            needed: free_bytes.len() as u64 * max_binding,
            budget: TEXEL_PAGES as u64 * max_binding,
        });
    }
    Ok(())
}

/// The assets of a model, one that it names twice only once.
fn distinct_assets(model: &SceneModel) -> impl Iterator<Item = &Arc<AssetModel>> {
    let mut seen = HashSet::new();
    model.assets.iter().filter(move |asset| seen.insert(asset.uid))
}
