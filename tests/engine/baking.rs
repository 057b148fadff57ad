//! Frames of point trees that are built, read from the cache, or built again because an entry was damaged: the same bytes.

use std::path::{Path, PathBuf};

use pointillist::bake::cache::BakeCache;
use pointillist::engine::BakeSource;
use pointillist::plan::Lod;

use super::studio::{Studio, front, same};

/// A frame of both scenes of a fresh engine, and where their trees came from.
fn frames(cache: Option<&Path>) -> (Vec<Vec<u8>>, Vec<BakeSource>) {
    let cache = cache.map(|folder| BakeCache::new(folder, 1 << 30));
    let studio = Studio::with(|config| config.bake_cache = cache);
    studio.load_two();
    let mut frames = Vec::new();
    let mut sources = Vec::new();
    for scene in ["solid", "cloud"] {
        let baked = studio.engine.bake_all(scene, |_| ()).unwrap();
        sources.extend(baked.into_iter().map(|asset| asset.source));
        let mut request = front(scene, 160, 120);
        request.settings.lod = Lod::Spt;
        frames.push(studio.bytes(&request));
        let again = studio.engine.bake_all(scene, |_| ()).unwrap();
        assert!(again.iter().all(|asset| asset.source == BakeSource::Kept));
    }
    (frames, sources)
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn the_cache_changes_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    // Both scenes have an asset in common.
    let all = |sources: &[BakeSource], expected: [BakeSource; 2]| {
        assert!(sources.iter().all(|source| expected.contains(source)), "{sources:?}");
    };
    let (expected, sources) = frames(None);
    all(&sources, [BakeSource::Built, BakeSource::Kept]);
    let check = |what: &str| {
        let (found, sources) = frames(Some(folder.path()));
        for (found, expected) in found.iter().zip(&expected) {
            same(found, expected, what);
        }
        sources
    };
    all(&check("built and stored"), [BakeSource::Stored, BakeSource::Kept]);
    all(&check("from the cache"), [BakeSource::Cached, BakeSource::Kept]);
    let files = entries(folder.path());
    let bytes: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    for (file, bytes) in files.iter().zip(&bytes) {
        let mut damaged = bytes.clone();
        damaged[bytes.len() * 2 / 3] ^= 0x10;
        std::fs::write(file, damaged).unwrap();
    }
    all(&check("built again"), [BakeSource::Stored, BakeSource::Kept]);
    assert_eq!(entries(folder.path()), files);
    for (file, bytes) in files.iter().zip(&bytes) {
        same(&std::fs::read(file).unwrap(), bytes, &file.display().to_string());
    }
}
