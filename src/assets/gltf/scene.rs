//! The node hierarchy to placements and cameras.

use ::gltf::json::accessor::Type;
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Node, Root, camera, scene};
use glam::{DAffine3, DMat4, DQuat, DVec3, Vec3};

use super::super::{AssetError, Placement};
use super::buffers::Buffers;
use super::material::Materials;
use super::primitive::Primitives;
use super::skin;
use crate::math::{Bounds, Camera, Lens};

/// Vertices that a placement counts for.
const PLACEMENT_COST: u64 = 4;

#[derive(Default)]
pub(super) struct Drawn {
    pub placements: Vec<Placement>,
    pub cameras: Vec<(String, Camera)>,
    pub lights: usize,
    pub unusable_cameras: usize,
}

/// Walks the default scene; without one the first; without any, from all roots.
pub(super) fn walk(
    root: &Root,
    buffers: &Buffers,
    file: &str,
    primitives: &mut Primitives,
    materials: &mut Materials,
) -> Result<Drawn, AssetError> {
    let fail =
        |node: usize, reason: &str| AssetError::malformed(file, format!("nodes[{node}]"), reason);
    let mut drawn = Drawn::default();
    let mut asset_from_nodes: Vec<Option<DAffine3>> = vec![None; root.nodes.len()];
    // Placements of skinned meshes, and their skins. Joints may come behind the meshes that they move.
    let mut skinned = Vec::new();
    let mut stack: Vec<(usize, DAffine3)> =
        roots(root, file)?.into_iter().rev().map(|node| (node, DAffine3::IDENTITY)).collect();
    while let Some((index, asset_from_parent)) = stack.pop() {
        let Some(node) = root.nodes.get(index) else {
            return Err(fail(index, "does not exist"));
        };
        if asset_from_nodes[index].is_some() {
            return Err(fail(index, "has two parents or is its own ancestor"));
        }
        let asset_from_node = asset_from_parent * parent_from_node(node);
        if !asset_from_node.is_finite() {
            return Err(fail(index, "its transform is not finite"));
        }
        asset_from_nodes[index] = Some(asset_from_node);
        drawn.node(root, node, index, asset_from_node);
        if let Some(mesh) = node.mesh {
            let geometries = primitives.get(mesh, materials)?;
            let mesh_name = root.get(mesh).and_then(|mesh| mesh.name.clone());
            let name = node.name.clone().or(mesh_name).unwrap_or_else(|| format!("node {index}"));
            let first = drawn.placements.len();
            // The joints alone place a skinned mesh (glTF 2.0, section 3.7.3.3).
            let asset_from_mesh =
                if node.skin.is_some() { DAffine3::IDENTITY } else { asset_from_node };
            for local in instances(node, index, buffers, file)? {
                let place = format!("nodes[{index}]");
                buffers.keep(&place, PLACEMENT_COST.saturating_mul(geometries.len() as u64))?;
                let asset_from_geometry = asset_from_mesh * local;
                for &geometry in &geometries {
                    let name = name.clone();
                    drawn.placements.push(Placement { name, geometry, asset_from_geometry });
                }
            }
            if let Some(skin) = node.skin {
                skinned.push((first..drawn.placements.len(), skin.value()));
            }
        }
        for child in node.children.iter().flatten().rev() {
            stack.push((child.value(), asset_from_node));
        }
    }
    let (placements, warnings) = (&mut drawn.placements, &mut primitives.warnings);
    skin::place(placements, skinned, root, buffers, &asset_from_nodes, warnings)?;
    // Skinned meshes have their scale only now.
    for Placement { name, geometry, asset_from_geometry } in &mut drawn.placements {
        let scale = mean_scale(asset_from_geometry);
        *geometry = primitives.scaled(*geometry, scale, name, materials)?;
    }
    Ok(drawn)
}

fn roots(root: &Root, file: &str) -> Result<Vec<usize>, AssetError> {
    let chosen: Option<Index<scene::Scene>> =
        root.scene.or((!root.scenes.is_empty()).then(|| Index::new(0)));
    if let Some(index) = chosen {
        let place = format!("scenes[{}]", index.value());
        let scene =
            root.get(index).ok_or_else(|| AssetError::malformed(file, place, "does not exist"))?;
        return Ok(scene.nodes.iter().map(Index::value).collect());
    }
    let mut is_child = vec![false; root.nodes.len()];
    for child in root.nodes.iter().flat_map(|node| node.children.iter().flatten()) {
        if let Some(flag) = is_child.get_mut(child.value()) {
            *flag = true;
        }
    }
    Ok((0..root.nodes.len()).filter(|node| !is_child[*node]).collect())
}

fn parent_from_node(node: &Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
    }
    let translation = node.translation.map_or(DVec3::ZERO, |t| Vec3::from_array(t).as_dvec3());
    let scale = node.scale.map_or(DVec3::ONE, |s| Vec3::from_array(s).as_dvec3());
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| quaternion(q.0));
    DAffine3::from_scale_rotation_translation(scale, rotation, translation)
}

/// The factor of lengths, as the geometric mean of three axes, in steps of 0.07 %: scales that differ by rounding alone are one.
fn mean_scale(map: &DAffine3) -> f64 {
    const STEPS: f64 = 1024.0;
    let scale = map.matrix3.determinant().abs().cbrt();
    if scale.is_finite() { ((scale.log2() * STEPS).round() / STEPS).exp2() } else { 1.0 }
}

fn quaternion(xyzw: [f32; 4]) -> DQuat {
    let rotation = DQuat::from_array(xyzw.map(f64::from));
    let length = rotation.length();
    if length > 0.0 && length.is_finite() { rotation / length } else { DQuat::IDENTITY }
}

/// The node's own copies: one, or those that EXT_mesh_gpu_instancing lists.
fn instances(
    node: &Node,
    index: usize,
    buffers: &Buffers,
    file: &str,
) -> Result<Vec<DAffine3>, AssetError> {
    let place = || format!("nodes[{index}].extensions.EXT_mesh_gpu_instancing");
    let fail = |reason: String| AssetError::malformed(file, place(), reason);
    let attributes = node
        .extensions
        .as_ref()
        .and_then(|ext| ext.others.get("EXT_mesh_gpu_instancing")?.get("attributes"));
    let Some(attributes) = attributes else { return Ok(vec![DAffine3::IDENTITY]) };
    let mut count = None;
    let mut read = |name: &str, kind: Type| -> Result<Option<Vec<f32>>, AssetError> {
        let Some(value) = attributes.get(name) else { return Ok(None) };
        let accessor = value.as_u64().and_then(|value| u32::try_from(value).ok());
        let accessor = accessor.ok_or_else(|| fail(format!("{name} is no index")))?;
        let (values, components) = buffers.floats(Index::new(accessor), &[kind])?;
        let items = values.len() / components;
        if *count.get_or_insert(items) != items {
            return Err(fail(format!("{name} has another number of items")));
        }
        Ok(Some(values))
    };
    let translations = read("TRANSLATION", Type::Vec3)?;
    let rotations = read("ROTATION", Type::Vec4)?;
    let scales = read("SCALE", Type::Vec3)?;
    let vector = |values: &Option<Vec<f32>>, at: usize, default: DVec3| {
        let chunk = values.as_ref().and_then(|values| values.as_chunks::<3>().0.get(at));
        chunk.map_or(default, |v| Vec3::from_array(*v).as_dvec3())
    };
    (0..count.unwrap_or(1))
        .map(|at| {
            let turn = rotations.as_ref().and_then(|values| values.as_chunks::<4>().0.get(at));
            let local = DAffine3::from_scale_rotation_translation(
                vector(&scales, at, DVec3::ONE),
                turn.map_or(DQuat::IDENTITY, |q| quaternion(*q)),
                vector(&translations, at, DVec3::ZERO),
            );
            if local.is_finite() {
                Ok(local)
            } else {
                Err(fail(format!("instance {at} is not finite")))
            }
        })
        .collect()
}

impl Drawn {
    /// Cameras and lights of a node.
    fn node(&mut self, root: &Root, node: &Node, index: usize, asset_from_node: DAffine3) {
        if node.extensions.as_ref().is_some_and(|ext| ext.khr_lights_punctual.is_some()) {
            self.lights += 1;
        }
        let Some(source) = node.camera.and_then(|camera| root.get(camera)) else { return };
        let lens = match (&source.type_, &source.perspective, &source.orthographic) {
            (Checked::Valid(camera::Type::Perspective), Some(perspective), _) => {
                Lens::Perspective { fov_deg: f64::from(perspective.yfov).to_degrees() }
            }
            (Checked::Valid(camera::Type::Orthographic), _, Some(orthographic)) => {
                Lens::Orthographic { height: 2.0 * f64::from(orthographic.ymag) }
            }
            _ => {
                self.unusable_cameras += 1;
                return;
            }
        };
        let name = source.name.clone().or_else(|| node.name.clone());
        let name = name.unwrap_or_else(|| format!("camera {index}"));
        let taken = |name: &str| self.cameras.iter().any(|(known, _)| known == name);
        let name = if taken(&name) { format!("{name} ({index})") } else { name };
        let forward = asset_from_node.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
        let camera = Camera {
            eye: asset_from_node.translation,
            target: asset_from_node.translation + forward,
            up: asset_from_node.transform_vector3(DVec3::Y).normalize_or(DVec3::Y),
            lens,
        };
        if camera.view(1, 1).is_ok() {
            self.cameras.push((name, camera));
        } else {
            self.unusable_cameras += 1;
        }
    }
}

/// Moves the target of each camera along its viewing direction into the middle of what it sees of the scene. glTF has no targets; what
/// frames derive from their distance (focus, the plane of stereo pairs, the middle of an orbit) must have the scene's size.
pub(super) fn aim(cameras: &mut [(String, Camera)], scene: &Bounds) {
    for (_, camera) in cameras {
        let forward = (camera.target - camera.eye).normalize_or(DVec3::NEG_Z);
        let distance = target_distance(scene, camera.eye, forward);
        let aimed = Camera { target: camera.eye + forward * distance, ..*camera };
        if aimed.view(1, 1).is_ok() {
            *camera = aimed;
        }
    }
}

/// Middle of the depths of the box that lie before the eye. Half the box's diagonal where next to nothing does, and 1 for a point.
fn target_distance(scene: &Bounds, eye: DVec3, forward: DVec3) -> f64 {
    /// Share of the diagonal that must lie before the eye.
    const LEAST_SEEN: f64 = 0.1;
    let extent = scene.extent();
    let diagonal = extent.length();
    let middle = (scene.centre() - eye).dot(forward);
    let half = 0.5 * extent.dot(forward.abs());
    let (near, far) = ((middle - half).max(0.0), middle + half);
    let distance = if far > LEAST_SEEN * diagonal { 0.5 * (near + far) } else { 0.5 * diagonal };
    if distance.is_finite() && distance > 0.0 { distance } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_lie_in_the_middle_of_what_is_seen() {
        let scene = Bounds { min: DVec3::splat(-100.0), max: DVec3::splat(100.0) };
        let diagonal = 200.0 * 3f64.sqrt();
        for (eye, forward, expected) in [
            // From outside the middle of the scene, from within that of what lies ahead.
            (DVec3::Z * 900.0, DVec3::NEG_Z, 900.0),
            (DVec3::Z * 50.0, DVec3::NEG_Z, 75.0),
            (DVec3::ZERO, DVec3::X, 50.0),
            // The scene lies behind.
            (DVec3::Z * 900.0, DVec3::Z, 0.5 * diagonal),
        ] {
            let lens = Lens::Orthographic { height: 6.0 };
            let camera = Camera { eye, target: eye + forward, up: DVec3::Y, lens };
            let mut cameras = [("a".to_owned(), camera)];
            aim(&mut cameras, &scene);
            let aimed = cameras[0].1;
            assert!((aimed.target - eye - forward * expected).length() < 1e-9, "{aimed:?}");
            assert_eq!((aimed.eye, aimed.up, aimed.lens), (eye, DVec3::Y, lens));
        }
        let point = Bounds { min: DVec3::ONE, max: DVec3::ONE };
        assert_eq!(target_distance(&point, DVec3::ONE, DVec3::X), 1.0);
        assert_eq!(target_distance(&Bounds::EMPTY, DVec3::ONE, DVec3::X), 1.0);
    }
}
