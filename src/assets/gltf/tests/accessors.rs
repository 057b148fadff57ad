//! Accessors: what they hold and what may share them.

use glam::{DVec3, Vec3};
use serde_json::{Value, json};

use super::{Document, mesh, square};

#[test]
fn sparse_and_normalised_accessors() {
    let mut document = square();
    let at = document.view(&2u16.to_le_bytes());
    let new: Vec<u8> = [9f32, 8., 7.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let new = document.view(&new);
    document.json["accessors"][0]["sparse"] = json!({ "count": 1,
        "indices": { "bufferView": at, "componentType": 5123 }, "values": { "bufferView": new } });
    let color = document.accessor(&[255, 0, 128, 0, 64, 255], "VEC3", 5121, 2);
    document.json["accessors"][color]["normalized"] = json!(true);
    document.json["accessors"][color]["count"] = json!(4);
    document.json["accessors"][color]["bufferView"] = json!(null);
    document.json["accessors"][color]["sparse"] = json!({ "count": 2,
        "indices": { "bufferView": document.view(&[0, 3]), "componentType": 5121 },
        "values": { "bufferView": color + 2 } });
    document.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(color);
    let asset = document.read().unwrap();
    assert_eq!(mesh(&asset, 0).positions[2], DVec3::new(9.0, 8.0, 7.0));
    let colors = mesh(&asset, 0).colors.as_ref().unwrap();
    // Linear 128 and 64 are sRGB 188 and 137.
    assert_eq!(*colors, [[255, 0, 188, 255], [0, 0, 0, 255], [0, 0, 0, 255], [0, 137, 255, 255]]);
}

#[test]
fn strides_and_shared_accessors() {
    let mut document = Document::new();
    let mut bytes = Vec::new();
    for at in 0..5u32 {
        for value in [at as f32, (at * at) as f32, 0.0, 99.0] {
            bytes.extend(f32::to_le_bytes(value));
        }
    }
    let position = document.accessor(&bytes, "VEC3", 5126, 5);
    document.json["bufferViews"][0]["byteStride"] = json!(16);
    let indices = document.accessor(&[4, 2, 3], "SCALAR", 5121, 3);
    document.mesh(json!({ "attributes": { "POSITION": position }, "indices": indices }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    assert_eq!(mesh(&asset, 0).positions.len(), 3);
    assert_eq!(mesh(&asset, 0).triangles, [[2, 0, 1]]);
    assert_eq!(mesh(&asset, 0).positions[2], DVec3::new(4.0, 16.0, 0.0));
}

#[test]
fn neighbours_share_what_they_read() {
    let mut document = Document::new();
    let position = document.square();
    let primitives: Vec<Value> = [[0, 1, 2], [0, 2, 3], [3, 1, 0]]
        .iter()
        .map(|corners| {
            let indices = document.accessor(corners, "SCALAR", 5121, 3);
            json!({ "attributes": { "POSITION": position }, "indices": indices })
        })
        .collect();
    document.push("meshes", json!({ "primitives": primitives }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    assert_eq!(mesh(&asset, 1).positions, [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]);
    assert_eq!(mesh(&asset, 2).triangles, [[2, 1, 0]]);
    assert_eq!(mesh(&asset, 2).positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
}

#[test]
fn repetition_is_bounded() {
    let mut document = square();
    let primitive = document.json["meshes"][0]["primitives"][0].clone();
    let indices = document.accessor(&[0; 3 << 16], "SCALAR", 5121, 3 << 16);
    let mut repeated = primitive.clone();
    repeated["indices"] = json!(indices);
    document.json["meshes"][0]["primitives"] = json!(vec![repeated; 1000]);
    let error = document.read().unwrap_err().to_string();
    assert!(error.contains("multiplies its buffers' data"), "{error}");
}

#[test]
fn normals_are_scaled_and_zero_ones_unknown() {
    let mut document = square();
    let normal = document.floats(&[0., 0., 2., 0., 0., 0., 0., 3., 4., 1., 0., 0.], "VEC3");
    document.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normal);
    let asset = document.read().unwrap();
    let normals = mesh(&asset, 0).normals.as_ref().unwrap();
    assert_eq!(*normals, [Vec3::Z, Vec3::ZERO, Vec3::new(0.0, 0.6, 0.8), Vec3::X]);
    document.json["accessors"][normal]["count"] = json!(3);
    let asset = document.read().unwrap();
    assert!(mesh(&asset, 0).normals.is_none() && asset.warnings.len() == 1);
}

#[test]
fn accessors_without_a_view_hold_zeros() {
    let mut document = square();
    let color =
        document.push("accessors", json!({ "componentType": 5126, "type": "VEC3", "count": 4 }));
    document.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(color);
    let asset = document.read().unwrap();
    assert_eq!(mesh(&asset, 0).colors, Some(vec![[0, 0, 0, 255]; 4]));
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    let indices = json!({ "componentType": 5125, "type": "SCALAR", "count": 1u64 << 40 });
    let indices = document.push("accessors", indices);
    document.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let error = document.read().unwrap_err().to_string();
    assert!(error.contains("multiplies its buffers' data"), "{error}");
}
