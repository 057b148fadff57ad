//! Keys of assets: hashes of everything that decides an asset's content, so that scenes that draw the same asset share it.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::EngineError;
use super::error::asset_error;
use crate::assets::{
    AssetError, Encoding, Material, Physical, ReadOptions, ScaledMap, stands_alone,
};
use crate::bake::external::{SpillFile, Spilled};
use crate::bake::pack::{GeometryKind, Grid, NodeRange, PackedAsset, PackedChunk, PackedTexture};
use crate::bake::tree::BAKING_VERSION;
use crate::math::Bounds;
use crate::memory::Admission;
use crate::residency::model::AssetModel;
use crate::scene::{AssetSource, FileSource, Scene};

/// Key of an asset's content.
#[derive(Clone, Copy)]
pub struct AssetKey {
    pub digest: [u8; 32],
    /// Whether the digest alone decides the content: the file names no other files.
    pub alone: bool,
}

/// The keys of a scene's assets, each file hashed once.
#[derive(Default)]
pub struct AssetKeys {
    known: HashMap<usize, AssetKey>,
    admission: Admission,
}

impl AssetKeys {
    /// Returns a set of keys whose hashing ends when the load is cancelled.
    pub fn within(admission: &Admission) -> AssetKeys {
        AssetKeys { known: HashMap::new(), admission: admission.clone() }
    }

    /// Sets the known key of an asset that is one file, so that the file is not read.
    pub fn know(&mut self, index: usize, digest: [u8; 32]) {
        self.known.insert(index, AssetKey { digest, alone: true });
    }

    /// Returns an asset's key. The recursion is as deep as solids are nested, which a scene's limits bound.
    pub fn of(&mut self, description: &Scene, index: usize) -> Result<AssetKey, EngineError> {
        if let Some(&known) = self.known.get(&index) {
            return Ok(known);
        }
        let reference = &description.assets[index];
        let key = match &reference.source {
            AssetSource::File(source) => file_key(&reference.name, source, &self.admission)?,
            AssetSource::Solid(solid) => {
                let mut hasher = Sha256::new();
                hasher.update(solid.operation.key());
                let mut alone = true;
                for operand in &solid.operands {
                    let part = self.of(description, operand.asset)?;
                    alone &= part.alone;
                    hasher.update(part.digest);
                    let map = operand.solid_from_operand.to_cols_array();
                    hasher.update(map.map(f64::to_le_bytes).concat());
                }
                AssetKey { digest: hasher.finalize().into(), alone }
            }
        };
        self.known.insert(index, key);
        Ok(key)
    }
}

fn file_key(
    name: &str,
    source: &FileSource,
    admission: &Admission,
) -> Result<AssetKey, EngineError> {
    // All of it: what is left out of the key is drawn as another scene has asked for it.
    let FileSource { path: file, sample, features, as_lines, line_radius } = source;
    let display = file
        .file_name()
        .map_or_else(|| name.to_owned(), |name| name.to_string_lossy().into_owned());
    let options = ReadOptions { admission: admission.clone(), ..ReadOptions::default() };
    let content = digest_file(file, &display, admission).map_err(asset_error)?;
    // The file's name affects how the bytes are read, and the scene affects what is made of them.
    let mut hasher = Sha256::new().chain_update(content).chain_update(file_kind(file));
    let made = (sample, features, as_lines, line_radius);
    if made != (&None, &false, &None, &None) {
        hasher.update(format!("\0{made:?}"));
    }
    Ok(AssetKey { digest: hasher.finalize().into(), alone: stands_alone(file, &options) })
}

/// Returns the part of a file's name that affects how it is read: its extensions, in lower case.
pub fn file_kind(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    name.split_once('.').map_or_else(String::new, |(_, extensions)| extensions.to_owned())
}

/// Hashes a file, which errors call `name`.
pub fn digest_file(file: &Path, name: &str, admission: &Admission) -> Result<[u8; 32], AssetError> {
    let fail = |source| AssetError::Io { file: name.to_owned(), source };
    if !std::fs::metadata(file).map_err(fail)?.is_file() {
        return Err(AssetError::unsupported(name, "is not a regular file"));
    }
    let mut hasher = Sha256::new();
    let mut reader = File::open(file).map_err(fail)?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        admission.check()?;
        let read = reader.read(&mut buffer).map_err(fail)?;
        if read == 0 {
            return Ok(hasher.finalize().into());
        }
        hasher.update(&buffer[..read]);
    }
}

/// Returns the key of an asset's point trees, regardless of the source of its content: equal keys mean equal trees.
pub fn tree_key(asset: &AssetModel) -> [u8; 32] {
    let mut hasher = Sha256::new_with_prefix(b"point trees\0");
    hasher.update(BAKING_VERSION.to_le_bytes());
    digest_packed(&mut hasher, &asset.packed);
    // The bounds decide how large the trees of meshes are.
    for bounds in &asset.bounds {
        numbers(&mut hasher, &[bounds.min.to_array(), bounds.max.to_array()].concat());
    }
    hasher.finalize().into()
}

/// Returns the key that [`tree_key`] gives an asset of only these samples, in this box.
pub fn spilled_tree_key(samples: &Spilled, bounds: &Bounds) -> std::io::Result<[u8; 32]> {
    let mut hasher = Sha256::new_with_prefix(b"point trees\0");
    hasher.update(BAKING_VERSION.to_le_bytes());
    for count in [1u64, 0, 0] {
        hasher.update(count.to_le_bytes());
    }
    let Spilled { grid, chunks, positions, attributes, kernels, fields, values, nodes } = samples;
    digest_head(&mut hasher, GeometryKind::Samples, grid, chunks);
    spilled_words(&mut hasher, positions)?;
    spilled_words(&mut hasher, attributes)?;
    spilled_words(&mut hasher, kernels)?;
    // There are no clip lines.
    words(&mut hasher, &[]);
    words(&mut hasher, bytemuck::cast_slice(fields));
    spilled_words(&mut hasher, values)?;
    spilled_words(&mut hasher, nodes)?;
    numbers(&mut hasher, &[bounds.min.to_array(), bounds.max.to_array()].concat());
    Ok(hasher.finalize().into())
}

fn spilled_words<R: bytemuck::Pod>(
    hasher: &mut Sha256,
    file: &SpillFile<R>,
) -> std::io::Result<()> {
    hasher.update((file.count() * size_of::<R>() as u64 / 4).to_le_bytes());
    file.each_block(|block| {
        hasher.update(bytemuck::cast_slice(block));
        Ok(())
    })
}

/// Adds all of an asset's packed contents, lists with their lengths in front. Records are destructured field by field, so that no
/// new field is forgotten.
pub fn digest_packed(hasher: &mut Sha256, packed: &PackedAsset) {
    let PackedAsset { geometries, materials, textures } = packed;
    for count in [geometries.len(), materials.len(), textures.len()] {
        hasher.update((count as u64).to_le_bytes());
    }
    for geometry in geometries {
        digest_head(hasher, geometry.kind(), geometry.grid(), geometry.chunks());
        for array in geometry.arrays() {
            words(hasher, array);
        }
    }
    for material in materials {
        digest_material(hasher, material);
    }
    for texture in textures {
        let PackedTexture { width, height, levels, wrap, nearest, encoding, texels } = texture;
        let linear = *encoding == Encoding::Linear;
        let read = [*nearest, linear].map(u32::from);
        words(hasher, &[&[*width, *height, *levels, *wrap], &read[..]].concat());
        words(hasher, texels);
    }
}

fn words(hasher: &mut Sha256, words: &[u32]) {
    hasher.update((words.len() as u64).to_le_bytes());
    hasher.update(bytemuck::cast_slice(words));
}

fn numbers(hasher: &mut Sha256, numbers: &[f64]) {
    hasher.update(bytemuck::cast_slice(numbers));
}

/// Adds everything of a geometry but its arrays.
fn digest_head(hasher: &mut Sha256, kind: GeometryKind, grid: &Grid, chunks: &[PackedChunk]) {
    hasher.update((kind as u32).to_le_bytes());
    digest_grid(hasher, grid);
    digest_chunks(hasher, chunks);
}

fn digest_grid(hasher: &mut Sha256, grid: &Grid) {
    let Grid { origin, step, reach } = grid;
    numbers(hasher, &[origin.x, origin.y, origin.z, *step]);
    hasher.update(reach.to_le_bytes());
}

fn digest_chunks(hasher: &mut Sha256, chunks: &[PackedChunk]) {
    hasher.update((chunks.len() as u64).to_le_bytes());
    for chunk in chunks {
        let PackedChunk {
            origin,
            extent,
            first,
            count,
            shift,
            vertex_first,
            vertex_count,
            material,
            kernel_base,
            sides,
            translucent,
            range,
        } = chunk;
        let NodeRange { base, error_parent, size_parent, error_least, size_least, delta_most } =
            range;
        hasher.update(bytemuck::bytes_of(origin));
        hasher.update(bytemuck::bytes_of(extent));
        let indices = [first, count, shift, vertex_first, vertex_count, material];
        words(hasher, &indices.map(|index| *index));
        let lengths =
            [kernel_base, base, error_parent, size_parent, error_least, size_least, delta_most];
        words(hasher, &lengths.map(|length| length.to_bits()));
        hasher.update([*sides as u8, u8::from(*translucent)]);
    }
}

fn digest_material(hasher: &mut Sha256, material: &Material) {
    let Material {
        name,
        base_color,
        base_texture,
        specular,
        shininess,
        physical,
        emissive,
        emissive_map,
        normal_map,
        occlusion_map,
        double_sided,
        unlit,
        alpha_cutoff,
        translucent,
    } = material;
    hasher.update((name.len() as u64).to_le_bytes());
    hasher.update(name);
    words(hasher, &base_color.map(f32::to_bits));
    words(hasher, &specular.map(f32::to_bits));
    words(hasher, base_texture.as_slice());
    words(hasher, alpha_cutoff.map(f32::to_bits).as_slice());
    let flags = [*double_sided, *unlit, *translucent].map(u32::from);
    words(hasher, &[&[shininess.to_bits()], &flags[..]].concat());
    // Each is preceded by whether it is there, so that none is taken for another.
    let mut optional = |own: Option<&[u32]>| {
        hasher.update([u8::from(own.is_some())]);
        words(hasher, own.unwrap_or_default());
    };
    let scaled = |map: &ScaledMap| [map.texture, map.factor.to_bits()];
    optional(normal_map.as_ref().map(scaled).as_ref().map(|own| &own[..]));
    optional(occlusion_map.as_ref().map(scaled).as_ref().map(|own| &own[..]));
    optional(emissive_map.as_ref().map(std::slice::from_ref));
    optional(Some(&emissive.map(f32::to_bits)));
    optional(physical.map(|_| &[][..]));
    if let Some(physical) = *physical {
        let Physical {
            metallic,
            roughness,
            dielectric: [r, g, b],
            grazing,
            map,
            transmission,
            transmission_map,
            volume,
        } = physical;
        optional(Some(&[metallic, roughness, r, g, b, grazing, transmission].map(f32::to_bits)));
        optional(Some(&volume.map(f32::to_bits)));
        for map in [map, transmission_map] {
            optional(map.as_ref().map(std::slice::from_ref));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneLimits;

    /// Returns the keys of the scene's assets, in the order of the file.
    fn keys(folder: &Path, assets: &str) -> Vec<[u8; 32]> {
        let text = format!(r#"{{"assets": {{{assets}}}, "nodes": []}}"#);
        let limits = SceneLimits::default();
        let scene = crate::scene::parse(&text, "s", folder, folder, &limits).unwrap();
        let mut keys = AssetKeys::default();
        (0..scene.assets.len()).map(|index| keys.of(&scene, index).unwrap().digest).collect()
    }

    #[test]
    fn keys_tell_scene_assets_apart() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.ply"), "a").unwrap();
        std::fs::write(folder.path().join("b.ply"), "b").unwrap();
        let solid = |b: &str, key: &str, x: f64| {
            let (a, b) = (r#""a": {"file": "a.ply"}"#, format!(r#""b": {{"file": "b.ply"{b}}}"#));
            let operands =
                format!(r#"[{{"asset": "a"}}, {{"asset": "b", "translate": [{x}, 0, 0]}}]"#);
            keys(folder.path(), &format!(r#"{a}, {b}, "s": {{"{key}": {operands}}}"#))
        };
        let plain = solid("", "union", 0.0);
        assert_eq!(plain, solid("", "union", 0.0));
        let sampled = solid(r#", "sample": {}"#, "union", 0.0);
        assert_eq!(plain[0], sampled[0]);
        assert!(plain[1] != sampled[1] && plain[2] != sampled[2]);
        let finer = solid(r#", "sample": {"spacing": 0.5}"#, "union", 0.0);
        assert!(finer[1] != sampled[1] && finer[2] != sampled[2]);
        assert_ne!(solid(r#", "features": true"#, "union", 0.0)[1], plain[1]);
        assert_ne!(solid("", "difference", 0.0)[2], plain[2]);
        assert_ne!(solid("", "union", 1.0)[2], plain[2]);
        std::fs::write(folder.path().join("b.ply"), "c").unwrap();
        assert_ne!(solid("", "union", 0.0)[2], plain[2]);
    }
}
