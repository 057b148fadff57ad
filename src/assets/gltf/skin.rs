//! Where skinned meshes stand: their joints place them, and the transform of their own node does not count.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use ::gltf::json::Root;
use ::gltf::json::accessor::Type;
use glam::{DAffine3, DMat4};

use super::super::{AssetError, Placement};
use super::buffers::Buffers;

/// Places skinned meshes: ranges of `placements`, each with the number of its skin.
pub(super) fn place(
    placements: &mut [Placement],
    skinned: Vec<(Range<usize>, usize)>,
    root: &Root,
    buffers: &Buffers,
    asset_from_nodes: &[Option<DAffine3>],
) -> Result<(), AssetError> {
    let mut known: HashMap<usize, DAffine3> = HashMap::new();
    for (range, skin) in skinned {
        let asset_from_mesh = match known.get(&skin) {
            Some(&asset_from_mesh) => asset_from_mesh,
            None => {
                let found = by_uppermost_joint(skin, root, buffers, asset_from_nodes)?;
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

/// The transform by a skin's uppermost joint. In the bind pose all joints have the same. `None` for a skin without a usable
/// joint.
fn by_uppermost_joint(
    skin: usize,
    root: &Root,
    buffers: &Buffers,
    asset_from_nodes: &[Option<DAffine3>],
) -> Result<Option<DAffine3>, AssetError> {
    let Some(skin) = root.skins.get(skin) else { return Ok(None) };
    let nodes = skin.joints.iter().filter_map(|joint| root.nodes.get(joint.value()));
    let below: HashSet<usize> =
        nodes.flat_map(|node| node.children.iter().flatten()).map(|child| child.value()).collect();
    let uppermost = skin.joints.iter().position(|joint| !below.contains(&joint.value()));
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
