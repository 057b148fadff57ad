//! Reader for glTF 2.0 (Khronos Group), `.gltf` and `.glb`.
//!
//! The JSON is taken apart by the `gltf` crate's types; every index, offset and count in it is checked
//! here, against the document and against the buffers. Each primitive becomes one geometry with one
//! material, each node that draws it a placement (several under `EXT_mesh_gpu_instancing`). The default
//! scene is drawn; skins, morph targets, animations and lights are not, and a warning says so. A skinned mesh stands where
//! the uppermost joint of its skin places it in the bind pose.
//!
//! Colours: vertex colours and factors are linear in glTF, textures sRGB. See [`material`] for how
//! metallic–roughness becomes Phong.

mod buffers;
mod container;
mod material;
mod primitive;
mod scene;
mod skin;

#[cfg(test)]
mod tests;

use ::gltf::json::Root;

use self::buffers::Buffers;
pub use self::container::names_no_files;
use self::material::Materials;
use self::primitive::Primitives;
use super::input::Input;
use super::warnings::counted;
use super::{Asset, AssetError, ReadOptions};

/// Extensions that may be required.
const SUPPORTED: [&str; 12] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Reads glTF from `input`.
///
/// # Errors
/// Malformed JSON, indices or ranges that lead nowhere (naming the object), buffers that are missing,
/// outside the root or too short, required extensions that are not offered, counts over the limits.
/// Textures that cannot be read are warnings.
pub fn read_from(mut input: Input, options: &ReadOptions) -> Result<Asset, AssetError> {
    let bytes = input.read_all()?;
    let file = input.origin.name.as_str();
    let (json, binary) = container::split(&bytes, file)?;
    let root = container::parse(json, file, &options.admission)?;
    let mut warnings = Vec::new();
    check_extensions(&root, file, &mut warnings)?;
    let folder = input.origin.folder.as_ref();
    let buffers = Buffers::load(&root, binary, folder, file, options)?;
    let mut materials = Materials::new(&root, &buffers, folder, options);
    let mut primitives = Primitives::new(&root, &buffers, file, options);
    let drawn = scene::walk(&root, &buffers, file, &mut primitives, &mut materials)?;
    warnings.append(&mut primitives.warnings);
    warnings.append(&mut materials.warnings);
    if drawn.placements.is_empty() {
        warnings.insert(0, "the scene draws nothing".to_owned());
        return Err(AssetError::malformed(file, "scene", warnings.join("; ")));
    }
    for (count, one, many) in [
        (root.animations.len(), "animation is ignored", "animations are ignored"),
        (
            root.skins.len(),
            "skin is ignored: meshes stand in their bind pose",
            "skins are ignored: meshes stand in their bind pose",
        ),
        (drawn.lights, "light is ignored", "lights are ignored"),
        (
            drawn.unusable_cameras,
            "camera without a usable field of view or height is ignored",
            "cameras without a usable field of view or height are ignored",
        ),
    ] {
        warnings.extend(counted(count as u64, one, many));
    }
    options.progress.report(1.0);
    let mut asset = Asset {
        geometries: primitives.geometries,
        materials: materials.materials,
        textures: materials.textures,
        placements: drawn.placements,
        cameras: drawn.cameras,
        sensor: None,
        warnings,
        format: if bytes.starts_with(container::MAGIC) { "glb" } else { "gltf" },
    };
    if !asset.cameras.is_empty() {
        let bounds = asset.bounds();
        scene::aim(&mut asset.cameras, &bounds);
    }
    Ok(asset)
}

fn check_extensions(root: &Root, file: &str, warnings: &mut Vec<String>) -> Result<(), AssetError> {
    for name in &root.extensions_required {
        let appearance = name.starts_with("KHR_materials_") || name == "KHR_texture_basisu";
        if SUPPORTED.contains(&name.as_str()) {
            continue;
        }
        if appearance {
            warnings.push(format!("extension {name} is ignored"));
            continue;
        }
        let what = match name.as_str() {
            "KHR_draco_mesh_compression" => "Draco compression",
            "EXT_meshopt_compression" | "KHR_meshopt_compression" => "meshopt compression",
            _ => "an extension",
        };
        return Err(AssetError::unsupported(
            file,
            format!("needs {what} ({name}), which is not offered; export the file without it"),
        ));
    }
    Ok(())
}
