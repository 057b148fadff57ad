//! What decides the content of a scene's assets, so that scenes which draw the same thing share it.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::EngineError;
use super::library::asset_error;
use crate::assets::AssetError;
use crate::scene::{AssetSource, FileSource, Scene};

/// What decides an asset's content.
#[derive(Clone, Copy)]
pub struct AssetKey {
    pub digest: [u8; 32],
    /// Whether the digest is all that decides: no file names others.
    pub alone: bool,
}

/// The keys of a scene's assets, each file hashed once.
#[derive(Default)]
pub struct AssetKeys {
    known: HashMap<usize, AssetKey>,
}

impl AssetKeys {
    /// The recursion is as deep as solids are nested, which a scene's limits bound.
    pub fn of(&mut self, description: &Scene, index: usize) -> Result<AssetKey, EngineError> {
        if let Some(&known) = self.known.get(&index) {
            return Ok(known);
        }
        let reference = &description.assets[index];
        let key = match &reference.source {
            AssetSource::File(source) => file_key(&reference.name, source)?,
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

fn file_key(name: &str, source: &FileSource) -> Result<AssetKey, EngineError> {
    let file = &source.path;
    let display = file
        .file_name()
        .map_or_else(|| name.to_owned(), |name| name.to_string_lossy().into_owned());
    let content = digest_file(file)
        .map_err(|source| asset_error(AssetError::Io { file: display.clone(), source }))?;
    // The name has a say in how the bytes are read, and the scene in what is made of them.
    let kind = display.to_ascii_lowercase();
    let kind = kind.split_once('.').map_or("", |(_, extensions)| extensions);
    let mut hasher = Sha256::new().chain_update(content).chain_update(kind);
    if source.sample.is_some() || source.features {
        hasher.update(format!("\0{:?} {}", source.sample, source.features));
    }
    Ok(AssetKey { digest: hasher.finalize().into(), alone: stands_alone(file) })
}

/// Whether a file's own bytes decide what is read. A glTF or OBJ may name buffers, materials and images beside it.
fn stands_alone(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    !["obj", "obj.gz", "gltf", "gltf.gz"].iter().any(|end| name.ends_with(end))
}

pub fn digest_file(file: &Path) -> std::io::Result<[u8; 32]> {
    let mut hasher = Sha256::new();
    let mut reader = File::open(file)?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        let read = reader.read(&mut buffer)?;
        if read == 0 {
            return Ok(hasher.finalize().into());
        }
        hasher.update(&buffer[..read]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneLimits;

    /// The keys of the scene's assets, by their place in the file.
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
