use std::fmt::Write as _;
use std::path::PathBuf;

use super::*;
use crate::assets::Material;
use crate::bake::pack::PackedTexture;
use crate::engine::asset_keys::tree_key;

/// A scene of a cloud and a mesh of a hundred triangles, and a folder for the cache.
struct Stage {
    folder: tempfile::TempDir,
    config: EngineConfig,
}

impl Stage {
    fn new() -> Stage {
        let folder = tempfile::tempdir().unwrap();
        let mut config = EngineConfig::new(folder.path());
        config.bake_cache = Some(BakeCache::new(folder.path().join("cache"), 1 << 30));
        let stage = Stage { folder, config };
        stage.write_cloud(0.0);
        let mut mesh = String::from("g grid\n");
        for i in 0..121 {
            writeln!(mesh, "v {} {} {}", i % 11, i / 11, i % 3).unwrap();
        }
        for i in (0..110).filter(|i| i % 11 != 10) {
            writeln!(mesh, "f {} {} {}", i + 1, i + 2, i + 12).unwrap();
        }
        std::fs::write(stage.folder.path().join("mesh.obj"), mesh).unwrap();
        let scene = r#"{"assets": {"c": {"file": "cloud.ply"}, "m": {"file": "mesh.obj"}},
            "nodes": [{"asset": "c"}, {"asset": "m"}]}"#;
        std::fs::write(stage.path(), scene).unwrap();
        stage
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("s.json")
    }

    fn write_cloud(&self, last: f64) {
        let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 3000\n");
        for axis in ["x", "y", "z"] {
            writeln!(text, "property double {axis}").unwrap();
        }
        text += "end_header\n";
        for i in 0..3000 {
            let (x, y) = (f64::from(i % 60), f64::from(i / 60));
            let z = if i == 2999 { last } else { (0.2 * x).sin() };
            writeln!(text, "{x} {y} {z}").unwrap();
        }
        std::fs::write(self.folder.path().join("cloud.ply"), text).unwrap();
    }

    fn loaded(&self) -> Loaded {
        let (source, admission) = (Source::at(self.path()), Admission::default());
        load("s", &source, &self.config, &AssetCache::default(), &admission).unwrap()
    }

    fn cache(&self) -> Option<&BakeCache> {
        self.config.bake_cache.as_ref()
    }

    /// Loads all assets anew and returns their trees, printed with every field, and the source of each.
    fn trees(&self) -> (Vec<String>, Vec<BakeSource>) {
        let print = |asset: &std::sync::Arc<AssetModel>| {
            let (tree, source) = asset_tree(asset, self.cache()).unwrap();
            (format!("{:?} {:?} {:?}", tree.packed, tree.bounds, tree.beside), source)
        };
        self.loaded().model.assets.iter().map(print).unzip()
    }

    fn files(&self) -> Vec<PathBuf> {
        let files = std::fs::read_dir(self.folder.path().join("cache")).unwrap();
        let mut files: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
        files.sort();
        files
    }
}

const STORED: [BakeSource; 2] = [BakeSource::Stored, BakeSource::Stored];
const CACHED: [BakeSource; 2] = [BakeSource::Cached, BakeSource::Cached];

#[test]
fn what_is_cached_is_what_was_built() {
    let mut stage = Stage::new();
    let (built, sources) = stage.trees();
    assert_eq!((sources.as_slice(), stage.files().len()), (&STORED[..], 2));
    assert_eq!(stage.trees(), (built.clone(), CACHED.to_vec()));
    stage.config.bake_cache = None;
    assert_eq!(stage.trees(), (built, vec![BakeSource::Built; 2]));
}

#[test]
fn damaged_entries_are_built_and_written_anew() {
    let stage = Stage::new();
    let (built, _) = stage.trees();
    let sound: Vec<Vec<u8>> = stage.files().iter().map(|f| std::fs::read(f).unwrap()).collect();
    let [first, second] = &stage.files()[..] else { panic!("two entries") };
    let mut damaged = sound[0].clone();
    damaged[sound[0].len() / 2] ^= 1;
    std::fs::write(first, damaged).unwrap();
    std::fs::write(second, &sound[1][..sound[1].len() - 40]).unwrap();
    assert_eq!(stage.trees(), (built.clone(), STORED.to_vec()));
    for (file, bytes) in stage.files().iter().zip(&sound) {
        assert_eq!(&std::fs::read(file).unwrap(), bytes);
    }
    assert_eq!(stage.trees(), (built, CACHED.to_vec()));
}

#[test]
fn sound_entries_that_do_not_fit_are_built_anew() {
    let stage = Stage::new();
    let (built, _) = stage.trees();
    let loaded = stage.loaded();
    let cache = stage.cache().unwrap();
    let keys: Vec<_> = loaded.model.assets.iter().map(|asset| tree_key(asset)).collect();
    let [cloud, mesh] = [cache.load(&keys[0]).unwrap(), cache.load(&keys[1]).unwrap()];
    let PackedGeometry::Triangles(mut painted) = mesh[1].clone() else {
        panic!("a mesh's triangles")
    };
    painted.chunks[0].material = 9;
    let PackedGeometry::Triangles(mut moved) = mesh[1].clone() else {
        panic!("a mesh's triangles")
    };
    moved.grid.step *= 2.0;
    let untreed = loaded.model.assets[0].packed.geometries.clone();
    for (asset, wrong) in [
        (0, mesh.clone()),
        (0, Vec::new()),
        (0, untreed),
        (1, cloud),
        (1, vec![mesh[1].clone(), mesh[0].clone()]),
        (1, vec![mesh[0].clone(), mesh[0].clone()]),
        (1, vec![mesh[0].clone(), PackedGeometry::Triangles(painted)]),
        (1, vec![mesh[0].clone(), PackedGeometry::Triangles(moved)]),
    ] {
        assert!(cache.store(&keys[asset], &wrong).unwrap());
        let mut sources = CACHED;
        sources[asset] = BakeSource::Stored;
        assert_eq!(stage.trees(), (built.clone(), sources.to_vec()));
    }
}

#[test]
fn keys_follow_contents_and_not_names() {
    let stage = Stage::new();
    let key = |asset: usize| tree_key(&stage.loaded().model.assets[asset]);
    let before = [key(0), key(1)];
    stage.write_cloud(0.5);
    assert_ne!(key(0), before[0]);
    assert_eq!(key(1), before[1]);
    stage.write_cloud(0.0);
    let renamed = r#"{"assets": {"other": {"file": "cloud.ply"}}, "nodes": [{"asset": "other"}]}"#;
    std::fs::write(stage.path(), renamed).unwrap();
    assert_eq!(key(0), before[0]);
}

#[test]
fn keys_cover_everything() {
    let stage = Stage::new();
    let loaded = stage.loaded();
    let [cloud, mesh] = [&loaded.model.assets[0], &loaded.model.assets[1]];
    let mut keys = vec![tree_key(cloud), tree_key(mesh)];
    let mut changed = |asset: &AssetModel, change: &dyn Fn(&mut AssetModel)| {
        let mut copy = AssetModel {
            memory: Default::default(),
            name: "copy".to_owned(),
            packed: asset.packed.clone(),
            bounds: asset.bounds.clone(),
            beside: Vec::new(),
            tree: Default::default(),
            deferred: None,
            outlined: Default::default(),
            ..*asset
        };
        assert!(keys.contains(&tree_key(&copy)), "a name is no content");
        change(&mut copy);
        let key = tree_key(&copy);
        assert!(!keys.contains(&key), "change {}", keys.len());
        keys.push(key);
    };
    use crate::bake::pack::{PackedMesh, PackedSamples};
    let samples: [fn(&mut PackedSamples); 9] = [
        |s| s.positions[7][0] ^= 1,
        |s| s.attributes[7][1] ^= 1,
        |s| s.kernels[7] ^= 1,
        |s| s.clips.push([0; 2]),
        |s| s.nodes.push([0; 2]),
        |s| s.grid.step *= 2.0,
        |s| s.chunks[0].kernel_base *= 2.0,
        |s| s.chunks[0].sides = crate::bake::pack::Sides::Closed,
        |s| s.chunks[0].origin.x += 1,
    ];
    for change in samples {
        changed(cloud, &|asset| match &mut asset.packed.geometries[0] {
            PackedGeometry::Samples(samples) => change(samples),
            _ => panic!("a cloud"),
        });
    }
    let meshes: [fn(&mut PackedMesh); 4] = [
        |m| m.vertices[3][4] ^= 1,
        |m| m.triangles[3] ^= 1,
        |m| m.chunks[0].material += 1,
        |m| m.grid.origin.y += 1.0,
    ];
    for change in meshes {
        changed(mesh, &|asset| match &mut asset.packed.geometries[0] {
            PackedGeometry::Triangles(mesh) => change(mesh),
            _ => panic!("a mesh"),
        });
    }
    changed(mesh, &|asset| asset.bounds[0].max.x += 1.0);
    changed(mesh, &|asset| asset.packed.materials.push(Material::default()));
    changed(mesh, &|asset| {
        let cut = Material { alpha_cutoff: Some(0.5), ..Material::default() };
        asset.packed.materials.push(cut);
    });
    for (nearest, texel) in [(false, 0), (true, 0), (false, 1)] {
        changed(mesh, &|asset| {
            let texels = vec![texel];
            let (width, height, levels, wrap) = (1, 1, 1, 0);
            let encoding = crate::assets::Encoding::Srgb;
            let texture = PackedTexture { width, height, levels, wrap, nearest, encoding, texels };
            asset.packed.textures.push(texture);
        });
    }
}

#[test]
fn a_cache_that_cannot_be_written_costs_nothing_else() {
    let mut stage = Stage::new();
    let (built, _) = stage.trees();
    let file = stage.folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    stage.config.bake_cache = Some(BakeCache::new(&file, 1 << 30));
    let (trees, sources) = stage.trees();
    assert_eq!(trees, built);
    assert!(sources.iter().all(|source| matches!(source, BakeSource::NotStored { .. })));
    stage.config.bake_cache = Some(BakeCache::new(stage.folder.path().join("small"), 100));
    assert_eq!(stage.trees(), (built, vec![BakeSource::TooLarge; 2]));
}

#[test]
fn files_are_baked_without_a_gpu_and_told_in_order() {
    let stage = Stage::new();
    let mut told = Vec::new();
    let baked = bake_file(&stage.path(), &stage.config, |event| {
        told.push(match event {
            BakeEvent::Started { asset, done, total } => format!("{asset} {done} {total}"),
            BakeEvent::Phase { phase, .. } => phase.name().to_owned(),
            BakeEvent::Finished(asset) => format!("{} {:?}", asset.name, asset.source),
        });
    });
    assert_eq!(told, ["c 0 3100", "c Stored", "m 3000 3100", "m Stored"]);
    let baked = baked.unwrap();
    assert_eq!(
        (baked[0].samples, baked[0].tree.leaves, baked[0].triangles_beside),
        (3000, 3000, 0)
    );
    assert_eq!((baked[1].triangles, baked[1].triangles_beside), (100, 100));
    for asset in &baked {
        let tree = &asset.tree;
        let nodes = tree.leaves + tree.inner;
        assert_eq!(tree.levels.iter().sum::<u64>(), nodes);
        assert_eq!(tree.errors.iter().sum::<u64>(), nodes);
        assert!(tree.base > 0.0 && tree.bytes >= 28 * nodes && asset.elapsed_ns > 0);
    }
    let again = bake_file(&stage.path(), &stage.config, |_| ()).unwrap();
    assert!(again.iter().all(|asset| asset.source == BakeSource::Cached));
    let json = serde_json::to_value(&again[0]).unwrap();
    assert_eq!((&json["source"], &json["tree"]["leaves"]), (&"cached".into(), &3000.into()));
}

/// Assets beyond the memory limit are built with temporary files, from the file or from the samples in memory.
#[test]
fn large_assets_become_the_same_entries() {
    let mut stage = Stage::new();
    let (built, _) = stage.trees();
    let sound: Vec<Vec<u8>> = stage.files().iter().map(|f| std::fs::read(f).unwrap()).collect();
    let names = |stage: &Stage| -> Vec<_> {
        stage.files().iter().map(|file| file.file_name().unwrap().to_owned()).collect()
    };
    let expected = names(&stage);
    let clear = |stage: &Stage| stage.files().iter().for_each(|f| std::fs::remove_file(f).unwrap());
    stage.config.bake_cache =
        stage.config.bake_cache.take().map(|cache| cache.with_bake_bytes(Some(1)));
    clear(&stage);
    assert_eq!(stage.trees(), (built.clone(), STORED.to_vec()));
    clear(&stage);
    let mut phases = Vec::new();
    let baked = bake_file(&stage.path(), &stage.config, |event| {
        if let BakeEvent::Phase { phase, .. } = event {
            phases.push(phase);
        }
    });
    let baked = baked.unwrap();
    assert!(baked.iter().all(|asset| asset.source == BakeSource::Stored));
    phases.dedup();
    assert_eq!(phases, Phase::ALL);
    assert_eq!(names(&stage), expected);
    for (file, bytes) in stage.files().iter().zip(&sound) {
        assert_eq!(&std::fs::read(file).unwrap(), bytes);
    }
    let again = bake_file(&stage.path(), &stage.config, |_| ()).unwrap();
    for (again, first) in again.iter().zip(&baked) {
        assert_eq!(again.source, BakeSource::Cached);
        assert_eq!(format!("{:?}", again.tree), format!("{:?}", first.tree));
        assert_eq!((again.samples, again.triangles), (first.samples, first.triangles));
    }
    // A file that is changed meanwhile gives an error or another asset, never a wrong one.
    std::fs::write(stage.folder.path().join("cloud.ply"), "ply\nbroken").unwrap();
    assert!(bake_file(&stage.path(), &stage.config, |_| ()).is_err());
}
