//! The passes of every shipped scene: what a scene does not call for does not run.

use std::collections::BTreeMap;
use std::path::Path;

use pointillist::engine::{FrameRequest, Pose};
use pointillist::plan::{Edl, Effect, FramePlan, Settings, Shadows};

use super::studio::{Studio, front};

/// Scenes, the passes of their default view at default settings, and the effects that these passes have.
const SHIPPED: [(&str, &str, &str); 9] = [
    (
        "glasshouse-night",
        "shadow_map clear place cull scan compact project_triangles walk_triangles resolve_triangles project_triangles_layers walk_triangles_layers resolve_triangles_layers composite_layers",
        "materials physical transmits point_lights",
    ),
    (
        "glasshouse",
        "shadow_map clear place cull scan compact project_triangles walk_triangles resolve_triangles project_triangles_layers walk_triangles_layers resolve_triangles_layers composite_layers",
        "materials physical transmits",
    ),
    (
        "materials",
        "shadow_map clear environment_background place cull scan compact project_triangles walk_triangles resolve_triangles ambient_occlusion write_output",
        "textures maps materials specular physical emissive environment",
    ),
    ("neurons", "clear place cull scan compact project_lines walk_lines resolve_lines", ""),
    (
        "part",
        "clear place cull scan compact project_splats walk_splats blend_splats blend_walked resolve_splats",
        "",
    ),
    (
        "plaza",
        "shadow_map clear fog_background place cull scan compact launch_portions project_triangles walk_triangles depth_pyramid cull_hidden resolve_triangles",
        "fog",
    ),
    (
        "relief",
        "clear place cull scan compact project_triangles walk_triangles resolve_triangles",
        "",
    ),
    (
        "textured",
        "shadow_map clear place cull scan compact project_triangles walk_triangles resolve_triangles ambient_occlusion write_output",
        "textures materials specular",
    ),
    (
        "town",
        "clear place cull scan compact launch_portions project_splats walk_splats depth_pyramid cull_hidden blend_splats blend_walked resolve_splats write_output",
        "edl",
    ),
];

/// Names of the passes and of the effects of a frame.
fn called_for(studio: &Studio, scene: &str, settings: Settings) -> [String; 2] {
    let request = FrameRequest { pose: Pose::FIT, settings, ..front(scene, 320, 240) };
    let frame = studio.engine.resolve_blocking(request).unwrap();
    let FramePlan { passes, specialisations, .. } = frame.plan();
    let passes = passes.iter().filter(|planned| planned.skipped.is_none());
    let passes: Vec<&str> = passes.map(|planned| planned.pass.name()).collect();
    let effects = specialisations.iter().filter(|planned| planned.skipped.is_none());
    let effects: Vec<String> = effects.map(|planned| planned.specialisation.name()).collect();
    [passes.join(" "), effects.join(" ")]
}

#[test]
fn shipped_scenes_run_the_passes_that_they_call_for() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let studio = Studio::below(&root, |_| {});
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(&root).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            studio.engine.load(&name, &path).unwrap();
            found.insert(name.clone(), called_for(&studio, &name, Settings::default()));
        }
    }
    for (name, [passes, effects]) in &found {
        println!("    (\"{name}\", \"{passes}\", \"{effects}\"),");
    }
    let expected = SHIPPED
        .map(|(name, passes, effects)| (name.to_owned(), [passes.to_owned(), effects.to_owned()]));
    assert_eq!(found, BTreeMap::from(expected));
}

const EFFECTS: [&str; 4] =
    ["shadow_map", "environment_background", "ambient_occlusion", "fog_background"];

const SPECIALISED: [&str; 3] = ["environment", "fog", "edl"];

/// With its effects turned off, a scene has neither passes nor code for them.
#[test]
fn effects_that_are_off_have_no_pass() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let studio = Studio::below(&root, |_| {});
    let off = Settings {
        shadows: Shadows::Off,
        ao: Effect::Off,
        environment: Effect::Off,
        fog: Effect::Off,
        edl: Edl::Off,
        ..Settings::default()
    };
    for (name, all, effects) in SHIPPED {
        studio.engine.load(name, &root.join(format!("{name}.json"))).unwrap();
        let [left, left_effects] = called_for(&studio, name, off);
        let rest = effects.split(' ').filter(|effect| !SPECIALISED.contains(effect));
        assert_eq!(left_effects, rest.collect::<Vec<_>>().join(" "), "{name}");
        for pass in EFFECTS {
            assert!(!left.split(' ').any(|one| one == pass), "{name}: {left}");
        }
        // Nothing else changes but the pass that waits for effects.
        let rest = all.split(' ').filter(|pass| *pass != "write_output" && !EFFECTS.contains(pass));
        let left = left.split(' ').filter(|pass| *pass != "write_output");
        assert!(left.eq(rest), "{name}");
    }
}
