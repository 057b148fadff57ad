mod accessors;
mod alpha;
mod nodes;

use glam::{DVec3, Vec2};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::super::{
    Encoding, Filter, Geometry, LEAST_ALPHA, Mesh, PointCloud, ScaledMap, Wrap, texture,
};
use super::*;
use crate::memory::{Admission, HostMemory, Interrupt};

/// A document under construction: JSON and one buffer.
struct Document {
    json: Value,
    buffer: Vec<u8>,
}

impl Document {
    fn new() -> Self {
        let json = json!({ "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [],
            "meshes": [], "nodes": [], "materials": [] });
        Self { json, buffer: Vec::new() }
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let entry = &mut self.json[list];
        if entry.is_null() {
            *entry = json!([]);
        }
        let list = entry.as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.buffer.len().is_multiple_of(4) {
            self.buffer.push(0);
        }
        let offset = self.buffer.len();
        self.buffer.extend(bytes);
        self.push(
            "bufferViews",
            json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }),
        )
    }

    fn accessor(&mut self, bytes: &[u8], kind: &str, component: u32, count: usize) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }),
        )
    }

    fn floats(&mut self, values: &[f32], kind: &str) -> usize {
        let components = match kind {
            "VEC2" => 2,
            "VEC4" => 4,
            _ => 3,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(&bytes, kind, 5126, values.len() / components)
    }

    /// A square's corners.
    fn square(&mut self) -> usize {
        self.floats(&[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.], "VEC3")
    }

    fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({ "primitives": [primitive] }))
    }

    fn node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    fn glb(&self) -> Vec<u8> {
        let mut root = self.json.clone();
        root["buffers"] = json!([{ "byteLength": self.buffer.len() }]);
        let mut text = serde_json::to_vec(&root).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut binary = self.buffer.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        let total = 12 + 8 + text.len() + 8 + binary.len();
        let mut bytes = b"glTF".to_vec();
        for word in [2, total as u32, text.len() as u32, 0x4e4f_534a] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(text);
        bytes.extend((binary.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(binary);
        bytes
    }

    fn read(&self) -> Result<Asset, AssetError> {
        read_bytes(self.glb())
    }
}

fn read_bytes(bytes: Vec<u8>) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(bytes, "a.glb"), &ReadOptions::default())
}

fn mesh(asset: &Asset, at: usize) -> &Mesh {
    match &asset.geometries[at] {
        Geometry::Mesh(mesh) => mesh,
        _ => panic!("points"),
    }
}

/// A square drawn once by a root node.
fn square() -> Document {
    let mut document = Document::new();
    let position = document.square();
    let indices = document.accessor(&[0, 1, 2, 0, 2, 3], "SCALAR", 5121, 6);
    document.mesh(json!({ "attributes": { "POSITION": position }, "indices": indices }));
    document.node(json!({ "mesh": 0, "name": "thing" }));
    document
}

fn close(found: DVec3, expected: [f64; 3]) -> bool {
    (found - DVec3::from_array(expected)).length() < 1e-6
}

#[test]
fn strips_fans_points_and_lines() {
    let mut document = Document::new();
    let position = document.square();
    let primitive = |mode: u32| json!({ "attributes": { "POSITION": position }, "mode": mode });
    let primitives = json!([primitive(5), primitive(6), primitive(0), primitive(1)]);
    document.push("meshes", json!({ "primitives": primitives }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    assert_eq!(mesh(&asset, 0).triangles, [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(mesh(&asset, 1).triangles, [[0, 1, 2], [0, 2, 3]]);
    assert!(matches!(&asset.geometries[2], Geometry::Points(PointCloud { positions, .. })
        if positions.len() == 4));
    assert!(matches!(&asset.geometries[3], Geometry::Lines(_)));
    assert_eq!((asset.geometries.len(), asset.warnings.len()), (4, 0));
}

#[test]
fn lines_are_strands() {
    let mut document = Document::new();
    let position = document.square();
    let color = document.floats(&[1.0, 0.0, 0.0].repeat(4), "VEC3");
    let bytes: Vec<u8> = [0.5f32, 0.25, 2.0, -1.0].iter().flat_map(|r| r.to_le_bytes()).collect();
    let radius = document.accessor(&bytes, "SCALAR", 5126, 4);
    let few = document.accessor(&bytes, "SCALAR", 5126, 3);
    let joined = document.accessor(&[0, 1, 1, 2, 0, 3, 1], "SCALAR", 5121, 7);
    let single = document.accessor(&[2], "SCALAR", 5121, 1);
    let attributes = json!({ "POSITION": position, "COLOR_0": color, "_RADIUS": radius });
    let primitives = json!([
        { "attributes": attributes, "mode": 1, "indices": joined },
        { "attributes": attributes, "mode": 2 },
        { "attributes": { "POSITION": position, "_RADIUS": few }, "mode": 3 },
        { "attributes": { "POSITION": position }, "mode": 3, "indices": single },
    ]);
    document.push("meshes", json!({ "primitives": primitives }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    let lines: Vec<_> = asset
        .geometries
        .iter()
        .map(|geometry| match geometry {
            Geometry::Lines(lines) => lines,
            _ => panic!("no lines"),
        })
        .collect();
    assert_eq!(lines.len(), 3);
    assert_eq!(lines[0].strands, [0, 3, 5]);
    assert_eq!(lines[0].radii.as_ref().unwrap()[..], [0.5, 0.25, 2.0, 0.5, 0.0]);
    assert_eq!(lines[0].colors.as_ref().unwrap()[4], [255, 0, 0, 255]);
    assert_eq!(lines[1].strands, [0, 5], "a loop");
    assert_eq!(lines[1].positions[4], lines[1].positions[0]);
    assert_eq!(lines[2].strands, [0, 4]);
    assert!(lines[2].radii.is_none() && lines[2].colors.is_none());
    for expected in [
        "primitives[0]: the last line lacks an end",
        "primitives[0]: 1 radius is negative",
        "primitives[2]: _RADIUS has another number of items",
        "primitives[3] is left out",
    ] {
        assert!(asset.warnings.iter().any(|text| text.contains(expected)), "{:?}", asset.warnings);
    }
}

#[test]
fn points_and_lines_have_the_base_color_of_their_material() {
    let mut document = Document::new();
    let position = document.square();
    let color = document.floats(&[1.0, 0.5, 0.25].repeat(4), "VEC3");
    let few = document.accessor(&[2, 0], "SCALAR", 5121, 2);
    document.push(
        "materials",
        json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 1, 0, 1] } }),
    );
    let plain = json!({ "POSITION": position });
    let colored = json!({ "POSITION": position, "COLOR_0": color });
    let primitives = json!([
        { "attributes": plain, "mode": 0, "material": 0 },
        { "attributes": colored, "mode": 0, "material": 0, "indices": few },
        { "attributes": plain, "mode": 3, "material": 0 },
        { "attributes": colored, "mode": 3, "material": 0 },
        { "attributes": plain, "mode": 0 },
    ]);
    document.push("meshes", json!({ "primitives": primitives }));
    document.node(json!({ "mesh": 0 }));
    let asset = document.read().unwrap();
    let colors: Vec<Option<&[[u8; 4]]>> = asset
        .geometries
        .iter()
        .map(|geometry| match geometry {
            Geometry::Points(cloud) => cloud.colors.as_deref(),
            Geometry::Lines(lines) => lines.colors.as_deref(),
            Geometry::Mesh(_) => panic!("a mesh"),
        })
        .collect();
    // Linear 0.5 is sRGB 188.
    let (factor, product) = ([188, 255, 0, 255], [188, 188, 0, 255]);
    assert_eq!(colors[0], Some(&[factor; 4][..]));
    assert_eq!(colors[1], Some(&[product; 2][..]));
    assert_eq!(colors[2], Some(&[factor; 4][..]));
    assert_eq!(colors[3], Some(&[product; 4][..]));
    assert_eq!(colors[4], None);
}

/// A square with a texture of two by two texels and two sets of coordinates.
fn textured() -> Document {
    let mut document = square();
    let first = document.floats(&[0.5; 8], "VEC2");
    let second = document.floats(&[0., 0., 1., 0., 1., 1., 0., 1.], "VEC2");
    let attributes = &mut document.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["TEXCOORD_0"] = json!(first);
    attributes["TEXCOORD_1"] = json!(second);
    document.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let view = document.view(&texture::tests::png(2, &[[1, 2, 3, 255]; 4]));
    document.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    document.json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728 }]);
    document.json["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    document.push(
        "materials",
        json!({ "name": "paint", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true,
            "extensions": { "KHR_materials_unlit": {} },
            "pbrMetallicRoughness": { "baseColorFactor": [1, 0.5, 0, 1], "metallicFactor": 0.5,
                "roughnessFactor": 0.5, "baseColorTexture": { "index": 0, "texCoord": 1,
                    "extensions": { "KHR_texture_transform": { "offset": [0.25, 0.5],
                        "rotation": std::f32::consts::FRAC_PI_2, "scale": [2, 3] } } } } }),
    );
    document
}

#[test]
fn materials_textures_samplers_and_transforms() {
    let asset = textured().read().unwrap();
    let material = &asset.materials[0];
    assert_eq!((material.name.as_str(), material.base_texture), ("paint", Some(0)));
    assert_eq!(material.base_color, [1.0, 0.5, 0.0, 1.0]);
    assert!(material.unlit && material.double_sided && material.alpha_cutoff == Some(0.25));
    assert!((material.shininess - 30.0).abs() < 1e-3);
    for (found, expected) in material.specular.iter().zip([0.52, 0.27, 0.02]) {
        assert!((found - expected).abs() < 1e-6);
    }
    let texture = &asset.textures[0];
    assert_eq!((texture.wrap, texture.filter), ([Wrap::Clamp, Wrap::Mirror], Filter::Nearest));
    assert_eq!(texture.rgba, [[1, 2, 3, 255]; 4]);
    // A quarter turn, counter-clockwise with v downwards: u goes to −v, v to u.
    let uvs = mesh(&asset, 0).uvs.as_ref().unwrap();
    for (found, expected) in uvs.iter().zip([[0.25, 0.5], [0.25, -1.5], [3.25, -1.5], [3.25, 0.5]])
    {
        assert!((*found - Vec2::from_array(expected)).length() < 1e-5, "{found}");
    }
    assert_eq!(mesh(&asset, 0).parts[0].material, Some(0));
}

#[test]
fn metals_maps_and_light_of_their_own() {
    let mut document = textured();
    document.json["textures"] = json!([{ "source": 0 }, { "source": 0, "sampler": 0 }]);
    let transform =
        json!({ "offset": [0.25, 0.5], "rotation": std::f32::consts::FRAC_PI_2, "scale": [2, 3] });
    let placed = |index: usize| json!({ "index": index, "texCoord": 1, "extensions": { "KHR_texture_transform": transform } });
    let with = |mut own: Value, key: &str, factor: f64| {
        own[key] = json!(factor);
        own
    };
    document.json["materials"] = json!([{ "emissiveFactor": [1, 0.5, 0],
        "emissiveTexture": placed(0),
        "normalTexture": with(placed(0), "scale", 0.5),
        "occlusionTexture": with(placed(1), "strength", 0.25),
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4 }, "KHR_materials_ior": { "ior": 2 },
            "KHR_materials_specular": { "specularFactor": 0.5, "specularColorFactor": [1, 0.5, 20] } },
        "pbrMetallicRoughness": { "metallicFactor": 0.75, "roughnessFactor": 0.5,
            "baseColorTexture": placed(0), "metallicRoughnessTexture": placed(1) } }]);
    let asset = document.read().unwrap();
    let own = &asset.materials[0];
    let physical = own.physical.unwrap();
    assert_eq!((physical.metallic, physical.roughness), (0.75, 0.5));
    for (found, expected) in physical.dielectric.iter().zip([1.0 / 18.0, 1.0 / 36.0, 0.5]) {
        assert!((found - expected).abs() < 1e-6, "{found}");
    }
    assert_eq!(physical.grazing, 0.5);
    assert_eq!(own.emissive, [4.0, 2.0, 0.0]);
    // Of each image and sampler one as colours and one as values.
    let encodings: Vec<(Encoding, Filter)> =
        asset.textures.iter().map(|own| (own.encoding, own.filter)).collect();
    let (linear, nearest) = (Filter::Linear, Filter::Nearest);
    assert_eq!(
        encodings,
        [(Encoding::Srgb, linear), (Encoding::Linear, nearest), (Encoding::Linear, linear)]
    );
    assert_eq!((own.base_texture, physical.map, own.emissive_map), (Some(0), Some(1), Some(0)));
    assert_eq!(own.normal_map, Some(ScaledMap { texture: 2, factor: 0.5 }));
    assert_eq!(own.occlusion_map, Some(ScaledMap { texture: 1, factor: 0.25 }));
    assert!(own.varies() && own.differs() && asset.warnings.is_empty(), "{:?}", asset.warnings);

    // Other texture coordinates than the first texture's.
    document.json["materials"][0]["normalTexture"]["texCoord"] = json!(0);
    let asset = document.read().unwrap();
    assert_eq!(asset.materials[0].normal_map, None);
    let warning = asset.warnings.concat();
    assert!(warning.contains("texture 0") && warning.contains("texture coordinates"), "{warning}");

    // Nowhere to look them up.
    let mut bare = document.json.clone();
    bare["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_1");
    let whole = std::mem::replace(&mut document.json, bare);
    let asset = document.read().unwrap();
    document.json = whole;
    let own = &asset.materials[mesh(&asset, 0).parts[0].material.unwrap() as usize];
    assert!(!own.has_maps() && own.base_texture.is_none() && own.physical.is_some());
    assert!(asset.warnings.concat().contains("no texture coordinates"), "{:?}", asset.warnings);

    // Unlit surfaces have a colour alone.
    document.json["materials"][0]["extensions"]["KHR_materials_unlit"] = json!({});
    let asset = document.read().unwrap();
    let own = &asset.materials[0];
    assert!(own.unlit && own.physical.is_none() && !own.has_maps() && !own.varies());
    assert_eq!((own.emissive, asset.textures.len()), ([0.0; 3], 1));
}

#[test]
fn specular_glossiness_is_understood() {
    let mut document = textured();
    document.json["materials"] = json!([{ "extensions": {
        "KHR_materials_transmission": { "transmissionFactor": 0.75, "transmissionTexture": { "index": 0 } },
        "KHR_materials_volume": { "thicknessFactor": 2, "attenuationDistance": 4, "attenuationColor": [0.25, 1, 0] } } }]);
    document.json["extensionsRequired"] = json!(["KHR_materials_transmission"]);
    let asset = document.read().unwrap();
    let (own, physical) = (&asset.materials[0], asset.materials[0].physical.unwrap());
    assert!(own.translucent && own.transmits() && !own.blends() && own.has_maps());
    assert_eq!((physical.transmission, physical.transmission_map), (0.75, Some(0)));
    assert_eq!(physical.volume, [0.5, 1.0, 0.0]);
    document.json["materials"][0]["extensions"]["KHR_materials_unlit"] = json!({});
    let asset = document.read().unwrap();
    assert!(!asset.materials[0].translucent && !asset.materials[0].has_maps());
    document.json["materials"] = json!([{ "alphaMode": "BLEND", "extensions": {
        "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0, 1, 0, 0.5],
            "specularFactor": [0.1, 0.2, 0.3], "glossinessFactor": 0.5,
            "diffuseTexture": { "index": 0 } } } }]);
    document.json["extensionsRequired"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    let asset = document.read().unwrap();
    let material = &asset.materials[0];
    assert_eq!(material.base_color, [0.0, 1.0, 0.0, 0.5]);
    assert_eq!((material.specular, material.base_texture), ([0.1, 0.2, 0.3], Some(0)));
    assert!((material.shininess - 30.0).abs() < 1e-3);
    assert_eq!((material.translucent, material.alpha_cutoff), (true, Some(LEAST_ALPHA)));
    assert_eq!(mesh(&asset, 0).uvs.as_ref().unwrap()[0], Vec2::splat(0.5));
}

/// The thickness of a volume is in the units of the mesh, the attenuation distance in those of the scene.
#[test]
fn volumes_are_as_thick_as_nodes_scale_them() {
    let mut document = square();
    document.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    document.json["materials"] = json!([{ "extensions": {
        "KHR_materials_transmission": { "transmissionFactor": 1 },
        "KHR_materials_volume": { "thicknessFactor": 2000, "attenuationDistance": 1, "attenuationColor": [0.25, 1, 0] } } }]);
    document.json["nodes"] = json!([
        { "mesh": 0, "scale": [0.00025, 0.00025, 0.00025] },
        { "mesh": 0, "scale": [0.0005, 0.0005, 0.0005] },
        { "mesh": 0, "scale": [0.00025, 0.00025, 0.00025], "rotation": [0, 0.6, 0, 0.8] }
    ]);
    let mut left = |distance: f64| -> Vec<[f32; 3]> {
        let own = &mut document.json["materials"][0]["extensions"]["KHR_materials_volume"];
        own["attenuationDistance"] = json!(distance);
        let asset = document.read().unwrap();
        let placements = asset.placements.iter();
        placements
            .map(|placement| {
                let part = mesh(&asset, placement.geometry).parts[0];
                asset.materials[part.material.unwrap() as usize].physical.unwrap().volume
            })
            .collect()
    };
    let found = left(1.0);
    for (found, expected) in found.iter().zip([[0.5, 1.0, 0.0], [0.25, 1.0, 0.0], [0.5, 1.0, 0.0]])
    {
        assert!((0..3).all(|i| (found[i] - expected[i]).abs() < 1e-3_f32), "{found:?}");
    }
    // Rounding of a rotation makes no other scale.
    assert_eq!(found[0], found[2]);
    // The standard excludes it.
    assert_eq!(left(0.0), [[1.0; 3]; 3]);
    // Bodies without a thickness share a geometry, as others of one scale do.
    document.json["materials"][0]["extensions"]["KHR_materials_volume"]["attenuationDistance"] =
        json!(1);
    let flat = json!({ "mesh": 0, "scale": [1, 1, 0] });
    document.json["nodes"] = json!([{ "mesh": 0 }, flat, flat]);
    let asset = document.read().unwrap();
    assert_eq!(asset.geometries.len(), 2);
    assert_eq!(asset.placements[1].geometry, asset.placements[2].geometry);
    // Joints scale a skinned mesh, and its own node does not.
    document.json["nodes"] = json!([{ "mesh": 0, "skin": 0, "scale": [9, 9, 9] }, { "scale": [0.00025, 0.00025, 0.00025] }]);
    document.json["skins"] = json!([{ "joints": [1] }]);
    let asset = document.read().unwrap();
    let part = mesh(&asset, asset.placements[0].geometry).parts[0];
    let left = asset.materials[part.material.unwrap() as usize].physical.unwrap().volume;
    assert!((left[0] - 0.5).abs() < 1e-3, "{left:?}");
}

#[test]
fn webp_and_broken_textures() {
    let mut document = textured();
    let mut webp = Vec::new();
    image_webp::WebPEncoder::new(&mut webp)
        .encode(&[9, 8, 7], 1, 1, image_webp::ColorType::Rgb8)
        .unwrap();
    let view = document.view(&webp);
    document.push("images", json!({ "bufferView": view, "mimeType": "image/webp" }));
    document.json["textures"] = json!([{ "extensions": { "EXT_texture_webp": { "source": 1 } } }]);
    assert_eq!(document.read().unwrap().textures[0].rgba, [[9, 8, 7, 255]]);
    for image in [
        json!({ "uri": "../x.png" }),
        json!({ "uri": "data:image/png;base64,AAAA" }),
        json!({ "bufferView": 99 }),
        json!({}),
    ] {
        document.json["images"][1] = image;
        let asset = document.read().unwrap();
        assert!(asset.textures.is_empty() && asset.materials[0].base_texture.is_none());
        assert_eq!(asset.warnings.len(), 1);
    }
}

#[test]
fn required_extensions_are_refused_by_name() {
    let mut document = square();
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_teapot"] {
        document.json["extensionsRequired"] = json!([name]);
        let error = document.read().unwrap_err();
        assert!(matches!(error, AssetError::Unsupported { .. }));
        assert!(error.to_string().contains(name), "{error}");
    }
}

#[test]
fn required_extensions_of_materials_are_ignored_only_where_they_are() {
    let mut document = square();
    document.json["extensionsRequired"] = json!([
        "KHR_materials_emissive_strength",
        "KHR_materials_ior",
        "KHR_materials_transmission",
        "KHR_materials_volume"
    ]);
    let asset = document.read().unwrap();
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    document.json["extensionsRequired"] = json!(["KHR_materials_sheen"]);
    let asset = document.read().unwrap();
    assert_eq!(asset.warnings, ["extension KHR_materials_sheen is ignored"]);
}

#[test]
fn every_index_and_range_is_checked() {
    let base = textured();
    for (pointer, value, words) in [
        ("/nodes/0/mesh", json!(7), "meshes[7]: does not exist"),
        ("/meshes/0/primitives/0/material", json!(7), "materials[7] does not exist"),
        ("/meshes/0/primitives/0/indices", json!(70), "accessors[70]: does not exist"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(70), "accessors[70]"),
        ("/meshes/0/primitives/0/mode", json!(9), "mode is unknown"),
        ("/accessors/0/count", json!(5), "accessors[0]: 5 items at 0 lie outside"),
        ("/accessors/0/count", json!(u64::MAX), "18446744073709551615"),
        ("/accessors/0/count", json!(1_000_000_000), "multiplies its buffers' data"),
        ("/accessors/0/type", json!("VEC2"), "accessors[0]: type must be one of"),
        ("/accessors/1/componentType", json!(5126), "accessors[1]: indices must be unsigned"),
        ("/accessors/0/bufferView", json!(99), "bufferViews[99]: does not exist"),
        ("/bufferViews/0/byteOffset", json!(u64::MAX), "bufferViews[0]"),
        ("/bufferViews/0/buffer", json!(3), "buffers[3] does not exist"),
        ("/accessors/1/count", json!("x"), "accessors[1].count"),
        ("/nodes/0/translation", json!([1e39, 0, 0]), "nodes[0]"),
    ] {
        let mut document = Document { json: base.json.clone(), buffer: base.buffer.clone() };
        let parent = pointer.rsplit_once('/').unwrap();
        document.json.pointer_mut(parent.0).unwrap()[parent.1] = value;
        let error = document.read().map(|_| ()).unwrap_err().to_string();
        assert!(error.starts_with("a.glb: ") && error.contains(words), "{error} / {words}");
    }
    let mut document = square();
    document.buffer[48] = 200;
    let error = document.read().unwrap_err().to_string();
    assert!(error.contains("indices, item 0: vertex 200 does not exist"), "{error}");
}

#[test]
fn containers_are_checked() {
    let good = square().glb();
    for length in [4, 11, 15, 30, good.len() - 1] {
        assert!(read_bytes(good[..length].to_vec()).is_err(), "{length}");
    }
    let mut old = good.clone();
    old[4] = 1;
    assert!(matches!(read_bytes(old), Err(AssetError::Unsupported { .. })));
    let old = br#"{"asset":{"version":"1.0"},"scenes":{}}"#.to_vec();
    assert!(matches!(read_bytes(old), Err(AssetError::Unsupported { .. })));
    let empty = br#"{"asset":{"version":"2.0"}}"#.to_vec();
    assert!(read_bytes(empty).unwrap_err().to_string().contains("draws nothing"));
}

#[test]
fn buffers_come_from_files_and_data_uris() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let mut document = square();
    let length = document.buffer.len();
    std::fs::write(inner.join("a b.bin"), &document.buffer).unwrap();
    std::fs::write(folder.path().join("out.bin"), &document.buffer).unwrap();
    let path = inner.join("m.gltf");
    let options = ReadOptions::default();
    let mut read = |uri: &str, length: usize, options: &ReadOptions| {
        document.json["buffers"] = json!([{ "uri": uri, "byteLength": length }]);
        std::fs::write(&path, serde_json::to_vec(&document.json).unwrap()).unwrap();
        read_from(Input::open(&path, "m.gltf", options)?, options)
    };
    assert_eq!(read("a%20b.bin", length, &options).unwrap().format, "gltf");
    for uri in ["../out.bin", "http://x/a.bin", "gone.bin", "/etc/passwd"] {
        let error = read(uri, length, &options).unwrap_err().to_string();
        assert!(error.starts_with("m.gltf: buffers[0]: "), "{error}");
    }
    assert!(read("a%20b.bin", length + 1, &options).is_err());
    let wide = ReadOptions { root: Some(folder.path().to_owned()), ..ReadOptions::default() };
    assert!(read("../out.bin", length, &wide).is_ok());
    let plain: String =
        std::fs::read(inner.join("a b.bin")).unwrap().iter().map(|b| format!("%{b:02x}")).collect();
    let uri = format!("data:application/octet-stream,{plain}");
    assert!(read(&uri, length, &options).is_ok());
}

#[test]
fn buffers_that_do_not_fit_are_told_with_figures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.gltf");
    let mut document = square();
    document.buffer.resize(1 << 20, 0);
    std::fs::write(folder.path().join("a.bin"), &document.buffer).unwrap();
    document.json["buffers"] = json!([{ "uri": "a.bin", "byteLength": 1 << 20 }]);
    std::fs::write(&path, serde_json::to_vec(&document.json).unwrap()).unwrap();
    let read = |options: &ReadOptions| {
        read_from(Input::open(&path, "m.gltf", options).unwrap(), options).unwrap_err()
    };
    let admission = Admission::new(&HostMemory::new(256 << 10));
    match read(&ReadOptions { admission, ..ReadOptions::default() }) {
        AssetError::Interrupted(Interrupt::OutOfMemory(error)) => {
            let told = error.to_string();
            assert!(error.is_hopeless() && told.starts_with("a.bin needs 10"), "{told}");
            assert!(told.contains("the budget of 262144 bytes"), "{told}");
        }
        error => panic!("{error:?}"),
    }
    match read(&ReadOptions { max_decompressed_bytes: 1 << 19, ..ReadOptions::default() }) {
        AssetError::TooLarge { file, found, limit, .. } => {
            assert_eq!((file.as_str(), found, limit), ("a.bin", 1 << 20, 1 << 19));
        }
        error => panic!("{error:?}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]
    #[test]
    fn damage_never_panics(at in 0usize..4000, value: u8, cut in 0usize..4000) {
        let mut bytes = textured().glb();
        let length = bytes.len();
        bytes[at % length] = value;
        if cut % 3 == 0 {
            bytes.truncate(length - cut % length);
        }
        let _ = read_bytes(bytes);
    }
}
