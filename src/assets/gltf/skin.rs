//! Where skinned meshes stand: their joints place them, and the transform of their own node does not count.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use ::gltf::json::Root;
use ::gltf::json::accessor::Type;
use glam::{DAffine3, DMat4};

use super::super::{AssetError, Placement};
use super::buffers::Buffers;

/// Places skinned meshes: ranges of `placements`, each with the number of its skin. Meshes of a skin without a usable joint, or whose matrices
/// cannot be read, stand as they are stored.
pub(super) fn place(
    placements: &mut [Placement],
    skinned: Vec<(Range<usize>, usize)>,
    root: &Root,
    buffers: &Buffers,
    asset_from_nodes: &[Option<DAffine3>],
    warnings: &mut Vec<String>,
) -> Result<(), AssetError> {
    if skinned.is_empty() {
        return Ok(());
    }
    let parents = parents(root, asset_from_nodes);
    let mut known: HashMap<usize, DAffine3> = HashMap::new();
    for (range, skin) in skinned {
        let asset_from_mesh = match known.get(&skin) {
            Some(&asset_from_mesh) => asset_from_mesh,
            None => {
                let found = by_uppermost_joint(skin, root, buffers, asset_from_nodes, &parents);
                let found = match found {
                    Err(AssetError::Malformed { place, reason, .. }) => {
                        warnings.push(format!(
                            "skins[{skin}]: its meshes stand as they are stored, because its matrices cannot be read: {place}: {reason}"
                        ));
                        None
                    }
                    found => found?,
                };
                let found = found.unwrap_or(DAffine3::IDENTITY);
                known.insert(skin, found);
                found
            }
        };
        for placement in &mut placements[range] {
            placement.asset_from_geometry = asset_from_mesh * placement.asset_from_geometry;
        }
    }
    Ok(())
}

/// The parent of each node that is drawn and has one.
fn parents(root: &Root, asset_from_nodes: &[Option<DAffine3>]) -> Vec<Option<usize>> {
    let mut parents = vec![None; root.nodes.len()];
    for (number, node) in root.nodes.iter().enumerate() {
        if asset_from_nodes.get(number).is_none_or(Option::is_none) {
            continue;
        }
        for child in node.children.iter().flatten() {
            if let Some(parent) = parents.get_mut(child.value()) {
                *parent = Some(number);
            }
        }
    }
    parents
}

/// The transform by a skin's uppermost joint. In the bind pose all joints have the same. `None` for a skin without a usable
/// joint.
fn by_uppermost_joint(
    skin: usize,
    root: &Root,
    buffers: &Buffers,
    asset_from_nodes: &[Option<DAffine3>],
    parents: &[Option<usize>],
) -> Result<Option<DAffine3>, AssetError> {
    let Some(skin) = root.skins.get(skin) else { return Ok(None) };
    let joints: HashSet<usize> = skin.joints.iter().map(|joint| joint.value()).collect();
    // A file may name a node with many children as a joint many times: looking at parents takes one step a joint.
    let parent = |joint: usize| parents.get(joint).copied().flatten();
    let is_below = |joint: usize| parent(joint).is_some_and(|own| joints.contains(&own));
    let uppermost = skin.joints.iter().position(|joint| !is_below(joint.value()));
    let Some(number) = uppermost else { return Ok(None) };
    let node = skin.joints[number].value();
    let Some(asset_from_joint) = asset_from_nodes.get(node).copied().flatten() else {
        return Ok(None);
    };
    let joint_from_mesh = match skin.inverse_bind_matrices {
        None => DAffine3::IDENTITY,
        Some(accessor) => {
            let (matrices, _) = buffers.floats(accessor, &[Type::Mat4])?;
            let Some(matrix) = matrices.as_chunks::<16>().0.get(number) else { return Ok(None) };
            DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)))
        }
    };
    let found = asset_from_joint * joint_from_mesh;
    Ok(Some(found).filter(|found| found.is_finite() && found.matrix3.determinant() != 0.0))
}
