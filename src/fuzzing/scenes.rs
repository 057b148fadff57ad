//! Scene and path files.

use glam::DVec3;

use super::{Run, assert_finite, text};
use crate::scene::{self, CameraPath, SceneLimits};

pub const TARGETS: &[(&str, Run)] = &[("scene", read_scene), ("path", read_path)];

/// Reads a scene beside the assets `a.ply` and `b.obj`, below a root.
fn read_scene(data: &[u8]) {
    thread_local! {
        static FOLDER: tempfile::TempDir = {
            let folder = tempfile::tempdir().unwrap();
            for name in ["a.ply", "b.obj", "sky.hdr"] {
                std::fs::write(folder.path().join(name), name).unwrap();
            }
            folder
        };
    }
    let Some(text) = text(data) else { return };
    let limits = SceneLimits::default();
    FOLDER.with(|folder| {
        let folder = folder.path();
        match scene::parse(text, "a.json", folder, folder, &limits) {
            Ok(scene) => {
                assert_finite(&scene);
                scene.paths.iter().for_each(|(_, path)| check_path(path));
            }
            Err(error) => {
                let error = error.to_string();
                assert!(error.starts_with("a.json"), "{error}");
                assert!(error.len() < 4096 + data.len(), "{} bytes of error", error.len());
            }
        }
    });
}

fn read_path(data: &[u8]) {
    let Some(text) = text(data) else { return };
    match scene::parse_path(text, "a.json", DVec3::Y) {
        Ok(path) => check_path(&path),
        Err(error) => assert!(error.to_string().starts_with("a.json"), "{error}"),
    }
}

/// Every camera of a path that is accepted is finite.
fn check_path(path: &CameraPath) {
    assert_finite(path);
    let sampler = path.sampler().unwrap();
    let count = path.frame_count(path.fps);
    for number in [0, 1, count / 3, count / 2, count.saturating_sub(1), count] {
        assert_finite(&sampler.at(path.frame_time_s(number, path.fps)));
    }
    assert!(sampler.while_open(0.5, 0.1, 3).len() <= 3);
}
