//! Files that name other files are read again when those change.

use glam::DVec3;
use pointillist::engine::{FrameRequest, Pose, Source};
use pointillist::math::{Camera, Lens};
use pointillist::plan::{ColorBy, Output, Settings};
use serde_json::json;

use super::studio::{Studio, fit, same, wall};

/// A quad in the plane z = 0 with texture coordinates.
const QUAD_OBJ: &str = "mtllib quad.mtl\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n\
    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl paint\nf 1/1 2/2 3/3 4/4\n";

fn png(color: [u8; 3]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&color.repeat(4)).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A view from a place that does not depend on the scene's size.
fn seen_from_fixed(scene: &str) -> FrameRequest {
    let eye = DVec3::new(1.0, 2.0, 7.0);
    let pose =
        Pose::Upright { eye, target: DVec3::ZERO, lens: Lens::Perspective { fov_deg: 40.0 } };
    FrameRequest { pose, ..fit(scene, 64, Output::Color) }
}

/// Loads `file` before and after `change`, and expects different images with different tags. After `restore` the first image
/// returns.
fn sees_change(studio: &Studio, file: &str, change: &dyn Fn(), restore: &dyn Fn()) {
    let look = || {
        studio.load("x", file);
        let request = seen_from_fixed("x");
        let seen = (studio.bytes(&request), super::studio::etag(&studio.engine, &request).unwrap());
        studio.engine.remove("x").unwrap();
        seen
    };
    studio.load("kept", file);
    let kept = studio.bytes(&seen_from_fixed("kept"));
    let before = look();
    same(&before.0, &kept, "the same file twice");
    change();
    let after = look();
    assert_ne!(after.1, before.1, "{file}: the tag tells");
    assert!(after.0 != before.0, "{file}: the picture shows it");
    same(&studio.bytes(&seen_from_fixed("kept")), &kept, "what is loaded stays as it was");
    restore();
    assert!(look() == before, "{file}: as before");
    studio.engine.remove("kept").unwrap();
}

#[test]
fn an_obj_with_materials_and_textures() {
    let studio = Studio::new();
    studio.write("quad.obj", QUAD_OBJ);
    let plain = "newmtl paint\nKd 0.9 0.1 0.1\n";
    studio.write("quad.mtl", plain);
    sees_change(
        &studio,
        "quad.obj",
        &|| studio.write("quad.mtl", "newmtl paint\nKd 0.1 0.1 0.9\n"),
        &|| studio.write("quad.mtl", plain),
    );
    studio.write("quad.mtl", "newmtl paint\nKd 1 1 1\nmap_Kd paint.png\n");
    studio.write("paint.png", png([200, 30, 30]));
    sees_change(&studio, "quad.obj", &|| studio.write("paint.png", png([30, 200, 30])), &|| {
        studio.write("paint.png", png([200, 30, 30]))
    });
    // A scene file names it, too.
    studio.write(
        "scene.json",
        json!({ "assets": { "q": { "file": "quad.obj" } }, "nodes": [{ "asset": "q" }] })
            .to_string(),
    );
    sees_change(&studio, "scene.json", &|| studio.write("paint.png", png([30, 30, 200])), &|| {
        studio.write("paint.png", png([200, 30, 30]))
    });
}

#[test]
fn a_gltf_with_a_buffer_beside_it() {
    let bin = |scale: f32, depth: f32| -> Vec<u8> {
        [[-1.0, -1.0, 0.0], [1.0, -1.0, depth], [0.0, 1.0, 0.0f32]]
            .iter()
            .flatten()
            .flat_map(|v| (v * scale).to_le_bytes())
            .collect()
    };
    let gltf = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0, 1] }],
        "nodes": [{ "mesh": 0 }, { "mesh": 0, "translation": [0, 0, -3] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "buffers": [{ "uri": "triangle.bin", "byteLength": 36 }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
    });
    let studio = Studio::new();
    studio.write("triangle.gltf", gltf.to_string());
    studio.write("triangle.bin", bin(1.0, 0.5));
    let restore = || studio.write("triangle.bin", bin(1.0, 0.5));
    sees_change(
        &studio,
        "triangle.gltf",
        &|| studio.write("triangle.bin", bin(1.0, -0.5)),
        &restore,
    );
    // At twice the size, the coordinates on a grid with twice the step are equal.
    sees_change(
        &studio,
        "triangle.gltf",
        &|| studio.write("triangle.bin", bin(2.0, 0.5)),
        &restore,
    );
}

/// A quad as PLY with texture coordinates and a texture beside it.
const QUAD_PLY: &str = "ply\nformat ascii 1.0\ncomment TextureFile paint.png\nelement vertex 4\nproperty float x\n\
    property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 2\n\
    property list uchar int vertex_indices\nend_header\n-1 -1 0 0 0\n1 -1 0 1 0\n1 1 0 1 1\n-1 1 0 0 1\n3 0 1 2\n3 0 2 3\n";

/// A GLB whose texture is a file beside it.
fn quad_glb() -> Vec<u8> {
    let places = [-1f32, -1.0, 0.0, 1.0, -1.0, 0.0, 1.0, 1.0, 0.0];
    let corners = [0f32, 0.0, 1.0, 0.0, 1.0, 1.0];
    let binary: Vec<u8> = places.iter().chain(&corners).flat_map(|v| v.to_le_bytes()).collect();
    let json = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
        "textures": [{ "source": 0 }],
        "images": [{ "uri": "paint.png" }],
        "buffers": [{ "byteLength": 60 }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }, { "buffer": 0, "byteOffset": 36, "byteLength": 24 }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0] },
            { "bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2" },
        ],
    });
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let word = |number: usize| (number as u32).to_le_bytes();
    let head = [&b"glTF"[..], &word(2), &word(total), &word(json.len()), b"JSON"].concat();
    [head, json, [&word(binary.len())[..], b"BIN\0"].concat(), binary].concat()
}

/// Equal bytes are another asset beside another texture: neither a picture nor a tag may be taken from it.
#[test]
fn textures_of_ply_and_glb_files() {
    let studio = Studio::new();
    studio.write("quad.ply", QUAD_PLY);
    studio.write("quad.glb", quad_glb());
    let restore = || studio.write("paint.png", png([200, 30, 30]));
    restore();
    for file in ["quad.ply", "quad.glb"] {
        sees_change(&studio, file, &|| studio.write("paint.png", png([30, 30, 200])), &restore);
    }
}

/// Heights, and so their colours, depend on which way is up.
#[test]
fn another_up_direction_has_other_tags() {
    let studio = Studio::new();
    studio.write("cloud.ply", wall(30, |x, y| [x as u8 * 8, y as u8 * 8, 0]));
    let request = FrameRequest {
        settings: Settings { color_by: ColorBy::Height, ..fit("x", 64, Output::Color).settings },
        ..seen_from_fixed("x")
    };
    let pose = Pose::Camera(Camera::perspective(DVec3::new(1.0, 2.0, 7.0), DVec3::ZERO, 40.0));
    let request = FrameRequest { pose, ..request };
    let seen = [DVec3::X, DVec3::Y].map(|up| {
        let source = Source { up: Some(up), ..Source::at(studio.folder().join("cloud.ply")) };
        studio.engine.load_within("x", &source, &studio.engine.admission()).unwrap();
        let seen = (studio.bytes(&request), super::studio::etag(&studio.engine, &request).unwrap());
        studio.engine.remove("x").unwrap();
        seen
    });
    assert!(seen[0].0 != seen[1].0, "the pictures differ");
    assert_ne!(seen[0].1, seen[1].1);
}

#[test]
fn equal_files_are_held_once_under_their_own_names() {
    let studio = Studio::new();
    let text = wall(40, |x, y| [x as u8 * 6, y as u8 * 6, 0]);
    studio.write("one.ply", &text);
    studio.write("two.ply", &text);
    let scene = |name: &str, file: &str| json!({ "assets": { name: { "file": file } }, "nodes": [{ "asset": name }] });
    let one = studio.load_json("one", &scene("first", "one.ply"));
    let two = studio.load_json("two", &scene("second", "two.ply"));
    assert_eq!((one.assets[0].name.as_str(), two.assets[0].name.as_str()), ("first", "second"));
    let frames = ["one", "two"].map(|id| studio.bytes(&fit(id, 50, Output::Color)));
    same(&frames[0], &frames[1], "two names");
    assert_eq!(studio.engine.stats().uploads, 1);
    // Equal bytes under a name of another format are another asset.
    studio.write("three.txt", "0 0 0\n1 1 1\n");
    studio.write("three.obj", "0 0 0\n1 1 1\n");
    studio.load("text", "three.txt");
    assert!(studio.try_load("object", "three.obj").is_err());
}
