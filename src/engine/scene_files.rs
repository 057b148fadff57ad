//! The files of a scene, and what distinguishes one renderer from another: what other machines need to draw the same frames.

use std::path::PathBuf;

use glam::DVec3;
use sha2::{Digest, Sha256};

use super::{Engine, Source};
use crate::assets::NamedFiles;
use crate::scene::{AssetSource, EnvironmentSource, Scene};

/// The files that a scene was read from.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFiles {
    /// The scene file or asset file, absolute.
    pub path: PathBuf,
    /// Folder to which file names in the scene are relative; `None`: the scene file's own.
    pub base: Option<PathBuf>,
    /// Up direction that a bare asset file was given.
    pub up: Option<DVec3>,
    /// All files, sorted: the one at `path`, the assets, the surroundings, and the files that assets name.
    pub files: Vec<PathBuf>,
}

impl SceneFiles {
    pub(super) fn of(
        Source { path, base, up }: &Source,
        description: &Scene,
        named: &NamedFiles,
    ) -> SceneFiles {
        let assets = description.assets.iter().filter_map(|asset| match &asset.source {
            AssetSource::File(source) => Some(source.path.clone()),
            AssetSource::Solid(_) => None,
        });
        let around = description.environment.iter().filter_map(|around| match &around.image {
            EnvironmentSource::File(path) => Some(path.clone()),
            EnvironmentSource::Studio => None,
        });
        let mut files: Vec<PathBuf> =
            assets.chain(around).chain(named.list()).chain([path.clone()]).collect();
        files.sort();
        files.dedup();
        SceneFiles { path: path.clone(), base: base.clone(), up: *up, files }
    }
}

impl Engine {
    /// Returns the files of a scene. `None` for an unknown scene, and for one that was patched: its files do not say how it looks.
    pub fn scene_files(&self, id: &str) -> Option<SceneFiles> {
        let loaded = self.state().library.read().get(id)?;
        loaded.files.as_deref().cloned()
    }

    /// Returns the folder that scenes are read from.
    pub fn root(&self) -> PathBuf {
        self.state().config.root.clone()
    }

    /// Hashes what decides the pixels of every frame besides its scene and settings: adapter, driver, and the program's build.
    pub fn identity(&self) -> String {
        let adapter = self.state().adapter();
        let mut hasher = Sha256::new();
        for part in [&adapter.name, &adapter.renderer] {
            hasher.update((part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        hasher.update([u8::from(adapter.atomics_64)]);
        hasher.finalize()[..8].iter().map(|byte| format!("{byte:02x}")).collect()
    }
}
