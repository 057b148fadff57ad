//! Scenes over many pages, and full tables and pages.

use std::sync::Arc;

use pointillist::assets::{Encoding, Material};
use pointillist::bake::pack::{PackedAsset, PackedTexture};
use pointillist::engine::FrameRequest;
use pointillist::gpu::{Gpu, GpuOptions};
use pointillist::plan::{Lod, Reconstruct, Settings};
use pointillist::residency::model::{AssetModel, SceneModel};
use pointillist::residency::{Residency, ResidencyError};

use super::studio::{OUTPUTS, Studio, orbit, same, sphere, wall};
use serde_json::json;

/// Limit of a binding in bytes, which is also the largest size of a page.
const PAGE: u64 = 2 << 20;

#[test]
fn pages_do_not_show() {
    let scene = json!({
        "assets": { "wall": { "file": "wall.ply" }, "ball": { "file": "ball.ply" } },
        "nodes": [{ "asset": "wall" }, { "asset": "ball", "scale": 0.7 }, { "asset": "ball", "translate": [1, 0, -2] }],
    });
    let [whole, paged] = [None, Some(PAGE)].map(|max_binding_bytes| {
        let studio = Studio::with(|config| config.max_binding_bytes = max_binding_bytes);
        // Three pages of samples and three of vertices.
        studio.write("wall.ply", wall(800, |x, y| [(x / 4) as u8, (y / 4) as u8, 9]));
        studio.write("ball.ply", sphere(270));
        studio.load_json("scene", &scene);
        studio
    });
    assert!(paged.engine.limits().max_pixels <= PAGE / 8);
    for (number, output) in OUTPUTS.into_iter().enumerate() {
        let mut request = orbit("scene", number as u32, 256);
        request.output = output;
        let frames = [whole.frame(&request), paged.frame(&request)];
        same(&frames[1].bytes, &frames[0].bytes, &format!("{output:?}"));
        assert_eq!(frames[0].receipt.samples.tested, frames[1].receipt.samples.tested);
        assert_eq!(frames[0].receipt.triangles.tested, frames[1].receipt.triangles.tested);
    }
    // Point trees are drawn equally, whatever page they are in.
    for reconstruct in [Reconstruct::Points, Reconstruct::Splats] {
        for (number, output) in OUTPUTS.into_iter().enumerate() {
            let settings = Settings { lod: Lod::Spt, reconstruct, ..Settings::default() };
            let request = FrameRequest { settings, output, ..orbit("scene", number as u32, 256) };
            let frames = [whole.frame(&request), paged.frame(&request)];
            same(
                &frames[1].bytes,
                &frames[0].bytes,
                &format!("trees, {reconstruct:?}, {output:?}"),
            );
            let accepted = frames.map(|frame| frame.receipt.samples.accepted);
            assert_eq!(accepted[0], accepted[1]);
        }
    }
}

fn gpu() -> Gpu {
    Gpu::open(&GpuOptions { max_binding_bytes: Some(PAGE), ..GpuOptions::default() }).unwrap()
}

/// A scene that consists of textures with these numbers of texels and of materials only.
fn textured(uid: u64, texels: &[u32], materials: usize) -> Arc<SceneModel> {
    let textures = texels
        .iter()
        .map(|&count| PackedTexture {
            width: count,
            height: 1,
            levels: 1,
            wrap: 0,
            nearest: true,
            encoding: Encoding::Srgb,
            texels: vec![uid as u32; count as usize],
        })
        .collect();
    let asset = AssetModel {
        memory: Default::default(),
        uid,
        name: format!("asset {uid}"),
        format: "test",
        packed: PackedAsset {
            geometries: Vec::new(),
            materials: vec![Material::default(); materials],
            textures,
        },
        bounds: Vec::new(),
        has_colors: false,
        shows_intensity: false,
        has_normals: false,
        normals_estimated: false,
        beside: Vec::new(),
        tree: Default::default(),
        deferred: None,
        outlined: Default::default(),
    };
    Arc::new(SceneModel {
        uid,
        id: format!("scene {uid}"),
        name: String::new(),
        revision: 1,
        assets: vec![Arc::new(asset)],
        instances: Default::default(),
        materials: Vec::new(),
        lights: Vec::new(),
        background: [0.0; 4],
        environment: None,
        fog: None,
        occlusion: None,
        cameras: Vec::new(),
        up: glam::DVec3::Y,
        splats: Default::default(),
        trees: false,
        totals: Default::default(),
    })
}

/// Number of texels in a page.
const FULL: u32 = (PAGE / 4) as u32;

#[test]
fn full_texel_pages_push_others_out() {
    let gpu = gpu();
    // The budget has room for all of them.
    let mut residency = Residency::new(&gpu, 64 * PAGE);
    let scenes = [
        textured(1, &[FULL], 3),
        textured(2, &[FULL], 3),
        textured(3, &[FULL / 2, FULL / 2], 3),
        textured(4, &[FULL / 2, FULL], 3),
        textured(5, &[FULL / 3; 6], 3),
    ];
    for round in 0..3 {
        for scene in &scenes {
            let result = residency.ensure(&gpu, scene);
            assert_eq!(result, Ok(true), "round {round}, {}", scene.id);
            assert!(residency.is_current(scene));
            assert_eq!(residency.ensure(&gpu, scene), Ok(false));
            assert!(residency.used() <= 2 * PAGE + 64 * 1024);
        }
    }
    assert!(residency.evictions() > 0);
    for scene in &scenes {
        residency.remove(&gpu, &scene.id);
    }
    assert_eq!(residency.used(), 0);
    assert_eq!(residency.ids().count(), 0);
}

#[test]
fn what_fits_no_table_is_refused_and_harms_nobody() {
    let gpu = gpu();
    let mut residency = Residency::new(&gpu, 3 * PAGE);
    let there = textured(1, &[FULL / 2, 100], 5);
    residency.ensure(&gpu, &there).unwrap();
    let used = residency.used();
    for too_much in [
        textured(2, &[FULL + 1], 1),
        textured(3, &[FULL, FULL, 1], 1),
        textured(4, &[FULL / 2 + 1; 3], 1),
        textured(5, &[10], 1 << 17),
        textured(6, &[1; 1 << 17], 1),
    ] {
        let error = residency.ensure(&gpu, &too_much).unwrap_err();
        let (needed, limit) = match error {
            ResidencyError::OverBudget { needed, budget, .. } => (needed, budget),
            ResidencyError::OverBinding { needed, limit, .. } => (needed, limit),
        };
        assert!(needed > limit, "{error}");
        assert!(!residency.is_current(&too_much));
        assert!(residency.is_current(&there), "{error}");
        assert_eq!((residency.used(), residency.evictions()), (used, 0));
    }
    // All room is still available for a scene that just fits.
    let exact = textured(7, &[FULL, FULL], 1);
    residency.ensure(&gpu, &exact).unwrap();
    assert!(!residency.is_current(&there));
}

#[test]
fn a_budget_counts_lists_too() {
    let gpu = gpu();
    let scenes: Vec<_> = (1..=6).map(|uid| textured(uid, &[1000], 1)).collect();
    let each = scenes[0].gpu_bytes();
    let mut residency = Residency::new(&gpu, 3 * each);
    for scene in &scenes {
        residency.ensure(&gpu, scene).unwrap();
        assert!(residency.used() <= residency.budget());
    }
    assert_eq!(residency.evictions(), 3);
    assert_eq!(residency.ids().count(), 3);
    // That asset in another scene only needs memory for lists.
    let uploads = residency.uploads();
    let again = SceneModel { uid: 99, id: "other".to_owned(), ..SceneModel::clone(&scenes[5]) };
    residency.ensure(&gpu, &Arc::new(again)).unwrap();
    assert_eq!((residency.uploads(), residency.evictions()), (uploads, 3));
    // The asset stays as long as one of both scenes does.
    residency.remove(&gpu, &scenes[5].id);
    assert_eq!(residency.used(), 3 * each);
    residency.remove(&gpu, "other");
    assert_eq!(residency.used(), 2 * each);
}

#[test]
fn a_scene_keeps_its_own_assets_while_it_comes() {
    let gpu = gpu();
    let [one, two, three] = [1, 2, 3].map(|uid| textured(uid, &[1000], 1));
    let mut residency = Residency::new(&gpu, 2 * one.gpu_bytes());
    residency.ensure(&gpu, &one).unwrap();
    residency.ensure(&gpu, &two).unwrap();
    // The part that the new scene shares with the first one was used least recently, but stays.
    let both = Arc::new(SceneModel {
        uid: 50,
        id: "both".to_owned(),
        assets: vec![one.assets[0].clone(), three.assets[0].clone()],
        ..SceneModel::clone(&one)
    });
    residency.ensure(&gpu, &both).unwrap();
    assert_eq!((residency.uploads(), residency.evictions()), (3, 1));
    assert!(residency.is_current(&both) && residency.is_current(&one));
    assert!(!residency.is_current(&two));
    assert_eq!(residency.used(), residency.budget());
}
