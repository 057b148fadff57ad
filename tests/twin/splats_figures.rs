//! The figures of Zwicker et al. 2004 as scenes, with measurements of what they show.

use glam::{DVec2, DVec3, Vec3};
use pointillist::math::{Camera, View};
use pointillist::plan::{Reconstruct, Settings};
use pointillist::scene::Filter;
use serde_json::json;

use super::files::Shape;
use super::splats::{case, cube, oracle, splats};
use super::stage::{Case, Frames, look};

/// Samples on a square lattice in the xz plane, facing up, `count` per side. Their radii are half their distance, so the scene's
/// cut-off and width determine how far disks extend.
fn lattice(count: u32, spacing: f64, color: impl Fn(u32, u32) -> [u8; 4]) -> Shape {
    let mut shape = Shape::default();
    let middle = f64::from(count - 1) / 2.0;
    for i in 0..count {
        for k in 0..count {
            let place = |n: u32| (f64::from(n) - middle) * spacing;
            shape.positions.push(DVec3::new(place(i), 0.0, place(k)));
            shape.normals.push(Vec3::Y);
            shape.colors.push(color(i, k));
        }
    }
    shape
}

fn unfiltered(filter: Filter) -> Settings {
    Settings { prefilter: Some(false), ..splats(filter) }
}

/// Number of pixels that are expected to be covered but are not.
fn missing(expected: &[u32], found: &Frames) -> usize {
    expected.iter().zip(&found.id).filter(|(a, b)| **a != 0 && **b == 0).count()
}

/// Fig. 3: disks that touch on a tilted plane also touch in the image under the perspective filter, but not under the affine one.
#[test]
fn figure_3_disks_that_touch() {
    // Estimated kernels of this lattice are circles. Their width is set so that disks just touch.
    let cloud = lattice(12, 1.0, |_, _| [200, 180, 160, 255]);
    let case = case(
        "figure-3",
        &cloud,
        json!({ "splats": { "cutoff": 1.0, "width": 0.77 }, "lights": [] }),
    );
    let view = view([0.0, 1.6, 6.6], [0.0, 0.0, 1.2], 60.0, 320, 240);
    let exact = oracle(&case, &view, unfiltered(Filter::Exact));
    let area = exact.id.iter().filter(|id| **id != 0).count();
    let wrong = |filter| {
        let frames = case.draw_with(&view, unfiltered(filter));
        frames.id.iter().zip(&exact.id).filter(|(a, b)| (**a != 0) != (**b != 0)).count()
    };
    let [affine, perspective, exact] =
        [Filter::Affine, Filter::Perspective, Filter::Exact].map(wrong);
    println!("of {area} pixels wrong: affine {affine}, perspective {perspective}, exact {exact}");
    assert!(area > 10_000);
    // The outline is exact. Only rounding at the rim remains.
    assert!(perspective <= area / 500 && exact <= area / 500);
    assert!(affine > area / 50);
}

/// A view of this size.
fn view(eye: [f64; 3], target: [f64; 3], fov_deg: f64, width: u32, height: u32) -> View {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    Camera::perspective(eye, target, fov_deg).view(width, height).unwrap()
}

/// Fig. 7: at a flat angle and far off the axis, the affine filter leaves holes, and the others leave none.
#[test]
fn figure_7_extreme_perspective() {
    let cloud = lattice(160, 0.05, |i, k| {
        if (i / 8 + k / 8).is_multiple_of(2) { [230; 4] } else { [40, 60, 90, 255] }
    });
    let case = case("figure-7", &cloud, json!({ "lights": [], "splats": { "cutoff": 1.92 } }));
    // A wide lens that looks past the plane, which is in the corner of the image.
    let base = view([0.0, 0.06, 3.2], [0.0, 0.3, -0.5], 120.0, 400, 300);
    for (name, shift) in [("centred", DVec2::ZERO), ("off axis", DVec2::new(190.0, 0.0))] {
        let view = View { principal_px: base.principal_px + shift, ..base };
        // The pixels that the plane covers, a little inside its rim.
        let inside: Vec<u32> = (0..view.width * view.height)
            .map(|i| {
                let pixel = DVec2::new(f64::from(i % view.width), f64::from(i / view.width)) + 0.5;
                let ray = view.view_from_world.transpose() * view.ray(pixel);
                let t = -view.eye.y / ray.y;
                let hit = view.eye + ray * t;
                u32::from(t > 0.0 && hit.x.abs() < 3.9 && hit.z.abs() < 3.9)
            })
            .collect();
        let area = inside.iter().filter(|id| **id != 0).count();
        let holes = |filter| missing(&inside, &case.draw_with(&view, unfiltered(filter)));
        let [affine, perspective, exact] =
            [Filter::Affine, Filter::Perspective, Filter::Exact].map(holes);
        println!(
            "{name}: holes in {area} pixels: affine {affine}, perspective {perspective}, exact {exact}"
        );
        assert!(area > 20_000);
        assert_eq!((perspective, exact), (0, 0), "{name}");
        assert!(affine > 0 || name == "centred", "{name}");
    }
}

/// Mean squared deviation of the luminance from its local mean, over these rows.
fn roughness(frames: &Frames, rows: std::ops::Range<usize>) -> f64 {
    let width = frames.width as usize;
    let light = |i: usize| f64::from(frames.color[i][0]) / 255.0;
    let mut sum = 0.0;
    let mut count = 0.0;
    for y in rows {
        for x in 1..width - 1 {
            let i = y * width + x;
            // The part that a low-pass filter at the Nyquist frequency would remove, along both axes.
            let around = [i - 1, i + 1, i - width, i + width].map(light).iter().sum::<f64>() / 4.0;
            sum += (light(i) - around).powi(2);
            count += 1.0;
        }
    }
    sum / count
}

/// Fig. 6: a checkerboard whose squares shrink below a pixel. Compares energy above the Nyquist frequency with and without the
/// low-pass filter.
#[test]
fn figure_6_checkerboard() {
    let check =
        |i: u32, k: u32| if (i / 2 + k / 2).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 255] };
    let cloud = lattice(700, 0.02, check);
    let case = case("figure-6", &cloud, json!({ "lights": [], "background": "#808080" }));
    let view = view([0.0, 1.1, 7.2], [0.0, 0.0, 0.0], 40.0, 320, 240);
    let draw = |prefilter| {
        let settings = Settings { prefilter: Some(prefilter), ..splats(Filter::Perspective) };
        case.draw_with(&view, settings)
    };
    // Rows near the horizon, where a pixel covers two squares.
    let rows = 100..118;
    let (with, without) = (roughness(&draw(true), rows.clone()), roughness(&draw(false), rows));
    println!("energy above Nyquist: {with:.2e} with the low-pass filter, {without:.2e} without");
    assert!(with < without / 4.0 && without > 1e-3);
}

/// Number of pixels in which two frames differ, per pixel of the outlines and creases at which they could differ.
fn edge_error(solid: &Frames, sampled: &Frames) -> (f64, f64) {
    let width = solid.width as usize;
    let differs = |a: [u8; 4], b: [u8; 4]| (0..4).any(|c| a[c].abs_diff(b[c]) > 40);
    let edge = |i: usize| {
        i % width + 1 < width
            && i / width + 1 < solid.height as usize
            && (differs(solid.normal[i], solid.normal[i + 1])
                || differs(solid.normal[i], solid.normal[i + width]))
    };
    let length = (0..solid.normal.len()).filter(|&i| edge(i)).count() as f64;
    let wrong = (0..solid.normal.len()).filter(|&i| differs(solid.normal[i], sampled.normal[i]));
    let silhouette = (0..solid.id.len()).filter(|&i| (solid.id[i] != 0) != (sampled.id[i] != 0));
    (wrong.count() as f64 / length, silhouette.count() as f64 / length)
}

/// Fig. 5: compares a cube of splats with a cube of triangles: the error of edges and silhouette in pixels.
#[test]
fn figure_5_sharp_edges() {
    let file = ("box.ply", cube().ply());
    let mesh = json!({ "assets": { "b": { "file": "box.ply" } }, "nodes": [{ "asset": "b" }] });
    let sampled = json!({
        "assets": { "b": { "file": "box.ply", "sample": { "spacing": 0.2 } } },
        "nodes": [{ "asset": "b" }]
    });
    let mesh = Case::new("figure-5-mesh", std::slice::from_ref(&file), &mesh);
    let splatted = Case::new("figure-5", std::slice::from_ref(&file), &sampled);
    for eye in [[2.0, 2.4, 3.2], [1.7, 1.6, 1.8]] {
        let view = view(eye, [0.0; 3], 45.0, 320, 240);
        let solid = mesh.draw(&view);
        for (filter, prefilter, bound) in [
            (Filter::Exact, false, 0.1),
            (Filter::Perspective, false, 0.1),
            (Filter::Perspective, true, 0.6),
        ] {
            let settings = Settings { prefilter: Some(prefilter), ..splats(filter) };
            let frames = splatted.draw_with(&view, settings);
            let (edges, silhouette) = edge_error(&solid, &frames);
            println!(
                "{filter:?}, prefilter {prefilter}: edges off by {edges:.3} px, silhouette by {silhouette:.3} px"
            );
            assert!(edges < bound && silhouette < bound);
        }
    }
}

/// Fig. 8: compares an edge from a CSG operation, a bore in a block, with the exact circle.
#[test]
fn figure_8_edges_of_csg() {
    let case = Case::committed("part");
    let settings = Settings {
        reconstruct: Reconstruct::Splats,
        filter: Some(Filter::Exact),
        prefilter: Some(false),
        ..Settings::default()
    };
    // The bore's rim on the top face: its axis, and its radius, a tenth of the block's length, as in the generator.
    const RADIUS: f64 = 0.24;
    let view = look([0.816, 2.0, 0.001], [0.816, 0.0, 0.0], 40.0);
    let frames = case.draw_with(&view, settings);
    let (top, radius) = rim(&frames, &view);
    println!("rim at height {top:.4}: radius {radius:?}");
    let [least, mean, most] = radius;
    let pixel = (view.eye.y - top) / view.focal_px.y;
    let off = |found: f64| (found - RADIUS).abs() / pixel;
    assert!(off(least) < 1.5 && off(most) < 1.5, "{radius:?}, a pixel is {pixel:.4}");
    assert!(off(mean) < 0.4, "{radius:?}, a pixel is {pixel:.4}");
}

/// Height of the face around the bore below the eye, and the smallest, mean and largest distance of the bore's rim from its axis.
fn rim(frames: &Frames, view: &View) -> (f64, [f64; 3]) {
    let width = frames.width as usize;
    let at = |x: usize, y: usize| y * width + x;
    let depth_of_face = {
        let mut depths: Vec<f32> = frames.depth.iter().copied().filter(|d| d.is_finite()).collect();
        depths.sort_by(f32::total_cmp);
        f64::from(depths[depths.len() / 20])
    };
    let top = view.eye.y - depth_of_face;
    let centre = DVec2::new(view.principal_px.x, view.principal_px.y);
    let distance = |direction: DVec2| {
        // Step from the axis outwards to the first pixel of the face.
        (0..frames.width).map(|step| f64::from(step) * 0.25).find(|step| {
            let p = centre + direction * *step;
            let i = at(p.x as usize, p.y as usize);
            (f64::from(frames.depth[i]) - depth_of_face).abs() < 0.01 * depth_of_face
        })
    };
    let found: Vec<f64> = (0..64)
        .filter_map(|k| {
            let (sin, cos) = (f64::from(k) / 64.0 * std::f64::consts::TAU).sin_cos();
            Some(distance(DVec2::new(cos, sin))? * depth_of_face / view.focal_px.y)
        })
        .collect();
    assert!(found.len() == 64, "{} of 64 directions meet the face", found.len());
    let least = found.iter().copied().fold(f64::INFINITY, f64::min);
    let most = found.iter().copied().fold(0.0, f64::max);
    (top, [least, found.iter().sum::<f64>() / 64.0, most])
}
