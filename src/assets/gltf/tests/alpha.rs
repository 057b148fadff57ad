//! Alpha of points and lines.

use serde_json::json;

use super::{Document, Geometry};

/// The alphas of points, and of the ends of a line, that have 0.8 and 0.4 themselves, in a material like this.
fn alphas(material: serde_json::Value) -> [Vec<u8>; 2] {
    let mut document = Document::new();
    let position = document.floats(&[0., 0., 0., 1., 0., 0.], "VEC3");
    let color = document.floats(&[1., 1., 1., 0.8, 1., 1., 1., 0.4], "VEC4");
    document.push("materials", material);
    let attributes = json!({ "POSITION": position, "COLOR_0": color });
    let of = |mode| json!({ "attributes": attributes, "mode": mode, "material": 0 });
    document.push("meshes", json!({ "primitives": [of(0), of(3)] }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    let [Geometry::Points(cloud), Geometry::Lines(lines)] = &asset.geometries[..] else {
        panic!("points and a line")
    };
    [&cloud.colors, &lines.colors].map(|colors| colors.iter().flatten().map(|c| c[3]).collect())
}

#[test]
fn alpha_of_points_and_lines_counts_as_their_material_says() {
    let half = json!({ "baseColorFactor": [1, 1, 1, 0.5] });
    let with = |mode: &str| json!({ "alphaMode": mode, "pbrMetallicRoughness": half });
    assert_eq!(alphas(with("BLEND")), [[102, 51]; 2]);
    assert_eq!(alphas(with("OPAQUE")), [[255, 255]; 2]);
    let mut cut = with("MASK");
    cut["alphaCutoff"] = json!(0.3);
    assert_eq!(alphas(cut), [[255, 0]; 2]);
}
