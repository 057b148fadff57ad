//! Pipelines are built before frames need them, and remembered between processes.
//!
//! `src/passes/common_pipelines.json` lists the pipelines that the first frames of most scenes use. After a change of shaders or
//! of their overrides, write it anew:
//! `POINTILLIST_RECORD_PIPELINES=1 cargo nextest run --test engine -E 'test(common_frames)'`

use std::path::{Path, PathBuf};
use std::time::Duration;

use pointillist::engine::{FrameRequest, PrimeConfig};
use pointillist::plan::{Lod, Output, Reconstruct, Settings};

use super::studio::{Studio, fit};

const PATIENCE: Duration = Duration::from_secs(120);
/// A scene with lights, a point cloud, and a mesh.
const SCENES: [&str; 3] = ["scenes/plaza.json", "scenes/town-scan.laz", "scenes/relief-asset.ply"];

fn studio(folder: Option<&Path>, common: bool) -> Studio {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = folder.map(Path::to_path_buf);
    Studio::below(root, |config| config.prime = Some(PrimeConfig { folder, common }))
}

/// Draws a small frame in each mode that the viewer offers first.
fn draw_common_frames(studio: &Studio, id: &str) {
    for (reconstruct, output, lod) in [
        (Reconstruct::Auto, Output::Color, Lod::Full),
        (Reconstruct::Auto, Output::Color, Lod::Spt),
        (Reconstruct::Points, Output::Color, Lod::Full),
        (Reconstruct::Splats, Output::Color, Lod::Full),
        (Reconstruct::Points, Output::Color, Lod::Spt),
        (Reconstruct::Splats, Output::Color, Lod::Spt),
        (Reconstruct::Points, Output::Normal, Lod::Full),
        (Reconstruct::Points, Output::Depth, Lod::Full),
        (Reconstruct::Points, Output::Id, Lod::Full),
    ] {
        let settings = Settings { lod, reconstruct, ..Settings::default() };
        studio.frame(&FrameRequest { settings, ..fit(id, 64, output) });
    }
}

/// Common frames find all their pipelines: none is built late on a CPU adapter.
#[test]
fn common_frames_need_no_new_pipeline() {
    let list = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/passes/common_pipelines.json");
    let records = std::env::var_os("POINTILLIST_RECORD_PIPELINES").is_some();
    let kept = tempfile::tempdir().unwrap();
    let studio = studio(Some(kept.path()), !records);
    assert!(studio.engine.await_primed(PATIENCE));
    for (number, file) in SCENES.iter().enumerate() {
        let id = format!("scene{number}");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        studio.engine.load(&id, &path).unwrap();
        draw_common_frames(&studio, &id);
    }
    let stats = studio.engine.stats();
    drop(studio);
    if records {
        std::fs::write(list, variants(kept.path())).unwrap();
    } else {
        assert_eq!(stats.pipelines_late, 0, "see this file's first lines for how to list them");
        assert!(stats.pipelines_primed > 20, "{stats:?}");
    }
}

fn kept_file(folder: &Path) -> PathBuf {
    let files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    let [file] = &files[..] else { panic!("{files:?}") };
    file.clone()
}

/// The list in the file that an engine wrote.
fn variants(folder: &Path) -> Vec<u8> {
    let bytes = std::fs::read(kept_file(folder)).unwrap();
    let length = u64::from_le_bytes(bytes[40..48].try_into().unwrap());
    bytes[48..48 + length as usize].to_vec()
}

#[test]
fn what_frames_used_is_there_in_the_next_process() {
    let kept = tempfile::tempdir().unwrap();
    let late = |lost: bool| {
        let studio = studio(Some(kept.path()), false);
        assert!(studio.engine.await_primed(PATIENCE));
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/relief-asset.ply");
        studio.engine.load("a", &path).unwrap();
        let draw = || studio.bytes(&fit("a", 64, Output::Color));
        let first = draw();
        let late = studio.engine.stats().pipelines_late;
        if lost {
            studio.engine.lose_device();
            assert_eq!(draw(), first, "from another device with pipelines of its own");
        }
        late
    };
    let cold = late(false);
    assert!(cold > 5, "{cold}");
    assert_eq!(late(true), 0);
    // A damaged file is no error, and is replaced.
    let file = kept_file(kept.path());
    let mut bytes = std::fs::read(&file).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    assert_eq!(late(false), cold);
    assert_eq!(late(false), 0);
}
