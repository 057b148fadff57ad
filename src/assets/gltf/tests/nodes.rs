//! Nodes: placements, cameras and lights.

use glam::DVec3;
use serde_json::json;

use super::{Document, close, square};

#[test]
fn transforms_chain_in_f64() {
    let mut document = square();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    document.node(json!({ "translation": [10, 0, 0], "children": [2] }));
    document.node(json!({ "rotation": [0, 0, half, half], "scale": [2, 2, 2], "mesh": 0 }));
    let asset = document.read().unwrap();
    assert_eq!((asset.geometries.len(), asset.placements.len()), (1, 2));
    assert_eq!(asset.placements[0].name, "thing");
    let turned = asset.placements[1].asset_from_geometry;
    assert!(close(turned.transform_point3(DVec3::X), [10.0, 2.0, 0.0]));
    assert_eq!(asset.format, "glb");
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
}

#[test]
fn only_the_default_scene_is_drawn() {
    let mut document = square();
    let node = document.node(json!({ "mesh": 0, "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,6,7,1] }));
    document.json["scenes"] = json!([{ "nodes": [0] }, { "nodes": [node] }]);
    document.json["scene"] = json!(1);
    let asset = document.read().unwrap();
    assert_eq!(asset.placements.len(), 1);
    assert!(close(asset.placements[0].asset_from_geometry.translation, [5.0, 6.0, 7.0]));
}

#[test]
fn cycles_and_double_parents_are_refused() {
    let mut document = square();
    document.json["nodes"] = json!([{ "children": [1] }, { "children": [0], "mesh": 0 }]);
    document.json["scenes"] = json!([{ "nodes": [0] }]);
    let error = document.read().unwrap_err().to_string();
    assert!(error.starts_with("a.glb: nodes[0]: has two parents"), "{error}");
    document.json["nodes"] = json!([{ "children": [1, 1] }, { "mesh": 0 }]);
    assert!(document.read().is_err());
}

#[test]
fn gpu_instances_become_placements() {
    let mut document = square();
    let translation = document.floats(&[1., 0., 0., 2., 0., 0., 3., 0., 0.], "VEC3");
    let scale = document.floats(&[1., 1., 1., 2., 2., 2., 3., 3., 3.], "VEC3");
    document.json["nodes"][0]["translation"] = json!([0, 5, 0]);
    document.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing":
        { "attributes": { "TRANSLATION": translation, "SCALE": scale } } });
    document.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let asset = document.read().unwrap();
    assert_eq!((asset.geometries.len(), asset.placements.len()), (1, 3));
    let last = asset.placements[2].asset_from_geometry;
    assert!(close(last.transform_point3(DVec3::X), [6.0, 5.0, 0.0]));
    document.json["accessors"][scale]["count"] = json!(2);
    assert!(document.read().is_err());
}

#[test]
fn cameras_and_lights() {
    let mut document = square();
    document.json["cameras"] = json!([
        { "type": "perspective", "name": "front", "perspective": { "yfov": 1.0, "znear": 0.1 } },
        { "type": "orthographic",
          "orthographic": { "xmag": 1, "ymag": 1, "zfar": 2, "znear": 1 } }
    ]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    document.node(json!({ "camera": 0, "translation": [9, 0, 0], "rotation": [0, half, 0, half] }));
    document.node(json!({ "camera": 1 }));
    document.node(json!({ "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
    let asset = document.read().unwrap();
    let [(name, camera), (_, flat)] = &asset.cameras[..] else { panic!("{:?}", asset.cameras) };
    assert_eq!(name, "front");
    // It looks at the middle of the square, whose x are 0 to 1.
    assert!(close(camera.eye, [9.0, 0.0, 0.0]) && close(camera.target, [0.5, 0.0, 0.0]));
    assert!((camera.lens.fov_deg().unwrap() - 57.29578).abs() < 1e-4);
    assert_eq!(flat.lens.ortho_height(), Some(2.0), "twice ymag");
    assert_eq!(asset.warnings.len(), 1);
}

#[test]
fn skinned_meshes_stand_where_their_joints_are() {
    let mut document = square();
    let moved = |x: f32| [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., x, 0., 0., 1.];
    let matrices = [moved(-7.0), moved(-4.0)].concat();
    let bytes: Vec<u8> = matrices.iter().flat_map(|value| value.to_le_bytes()).collect();
    let bind = document.accessor(&bytes, "MAT4", 5126, 2);
    // The skeleton is half as large as the mesh, whose own node stands elsewhere.
    document.json["nodes"] = json!([
        { "mesh": 0, "skin": 0, "translation": [100, 0, 0] },
        { "scale": [0.5, 0.5, 0.5], "children": [2] },
        { "translation": [4, 0, 0], "children": [3] },
        { "translation": [3, 0, 0] },
    ]);
    document.json["skins"] = json!([{ "joints": [3, 2], "inverseBindMatrices": bind }]);
    let place = |document: &Document| {
        let asset = document.read().unwrap();
        assert_eq!((asset.placements.len(), asset.warnings.len()), (1, 1));
        asset.placements[0].asset_from_geometry.transform_point3(DVec3::X)
    };
    assert!(close(place(&document), [0.5, 0.0, 0.0]));
    // Without matrices, the joint's own transform is all there is.
    document.json["skins"] = json!([{ "joints": [3, 2] }]);
    assert!(close(place(&document), [2.5, 0.0, 0.0]));
    for unusable in [json!([{ "joints": [] }]), json!([{ "joints": [9] }]), json!([])] {
        document.json["skins"] = unusable;
        let asset = document.read().unwrap();
        let stands = asset.placements[0].asset_from_geometry.transform_point3(DVec3::X);
        assert!(close(stands, [1.0, 0.0, 0.0]));
    }
    // Matrices that cannot be read leave the mesh where it is stored.
    for (bind, place) in [(json!(99), "accessors[99]"), (json!(0), "accessors[0]")] {
        document.json["skins"] = json!([{ "joints": [3, 2], "inverseBindMatrices": bind }]);
        let asset = document.read().unwrap();
        let stands = asset.placements[0].asset_from_geometry.transform_point3(DVec3::X);
        assert!(close(stands, [1.0, 0.0, 0.0]));
        let said = &asset.warnings[0];
        assert!(said.starts_with("skins[0]: its meshes stand") && said.contains(place), "{said}");
    }
}
