use glam::DVec3;

use super::*;
use crate::math::Camera;
use crate::plan::{Lod, Reconstruct};

/// A frame of 512² pixels, in which a unit is 512 pixels wide.
fn view() -> View {
    let camera = Camera::perspective(DVec3::Z, DVec3::ZERO, 53.130_102);
    camera.view(512, 512).unwrap()
}

fn patch(count: f64, spacing_px: f64) -> Patch {
    Patch { centre: DVec3::ZERO, radius: 0.01, spacing: spacing_px / 512.0, count }
}

fn settings(reconstruct: Reconstruct, error_px: f32) -> Settings {
    let max_error_px = MaxError::new(error_px).unwrap();
    Settings { reconstruct, max_error_px, lod: Lod::Spt, ..Settings::default() }
}

fn decide(samples: &[Patch], triangles: &[Patch], tree: &Settings) -> Detail {
    let full = Settings { lod: Lod::Full, ..*tree };
    let view = view();
    let elements = samples.iter().chain(triangles).map(|patch| patch.count as u64).sum();
    choose(&DetailGrounds {
        samples,
        triangles,
        segments: &[],
        view: &view,
        elements,
        chunks: 1,
        full: &full,
        tree,
        costs: Costs::of(false),
    })
}

fn is_full(detail: &Detail) -> bool {
    matches!(detail, Detail::Full { .. })
}

#[test]
fn few_or_sparse_elements_are_drawn_in_full() {
    let [points, splats, coarse] = [
        settings(Reconstruct::Points, 1.0),
        settings(Reconstruct::Splats, 1.0),
        settings(Reconstruct::Splats, 4.0),
    ];
    let [is_full_cloud, is_full_mesh] = [
        |spacing_px: f64, tree: &Settings| is_full(&decide(&[patch(2e6, spacing_px)], &[], tree)),
        |spacing_px: f64, tree: &Settings| is_full(&decide(&[], &[patch(2e6, spacing_px)], tree)),
    ];
    assert!(!is_full_cloud(0.1, &points) && is_full_cloud(0.3, &points));
    assert!(!is_full_cloud(0.3, &splats) && is_full_cloud(0.7, &splats));
    assert!(!is_full_cloud(1.0, &coarse) && is_full_cloud(2.0, &coarse));
    assert!(is_full_cloud(30.0, &splats) && is_full_cloud(30.0, &coarse), "close up");
    assert!(!is_full_mesh(0.1, &points) && is_full_mesh(0.4, &points));
    assert!(
        !is_full_mesh(0.1, &splats) && is_full_mesh(0.3, &splats),
        "a node costs six triangles"
    );
    assert!(is_full(&decide(&[patch(3e5, 0.01)], &[], &points)), "listing alone takes longer");
    let because = "the 2000000 samples, triangles and segments in view are drawn sooner than nodes are chosen in their place";
    assert_eq!(decide(&[patch(2e6, 0.7)], &[], &splats), Detail::Full { because: because.into() });
    assert!(is_full(&decide(&[], &[], &splats)), "nothing in view");
}

#[test]
fn large_scenes_are_drawn_from_trees() {
    let tree = settings(Reconstruct::Points, 1.0);
    assert_eq!(decide(&[patch(9e6, 2.0)], &[], &tree), Detail::Tree { error: MaxError::default() });
    let (full, view) = (Settings { lod: Lod::Full, ..tree }, view());
    let (samples, triangles) = (&[patch(1e7, 2.0)], &[]);
    let patches = &[patch(1e6, 0.28)];
    let many = DetailGrounds {
        samples,
        triangles,
        segments: &[],
        view: &view,
        elements: 1_000_000,
        chunks: MOST_CHUNKS + 1,
        full: &full,
        tree: &tree,
        costs: Costs::of(false),
    };
    assert_eq!(choose(&many), Detail::Tree { error: MaxError::default() });
    assert!(is_full(&choose(&DetailGrounds { chunks: 1, ..many })));
    assert!(is_full(&choose(&DetailGrounds { chunks: MOST_CHUNKS, ..many })));
    // Full detail of what is in view takes less time, until too many other chunks are culled for it.
    let is_full_with =
        |chunks| is_full(&choose(&DetailGrounds { samples: patches, chunks, ..many }));
    assert!(is_full_with(1000) && !is_full_with(200_000));
}

#[test]
fn the_error_decreases_steadily_to_a_quarter_before_full_detail() {
    let tree = settings(Reconstruct::Splats, 4.0);
    let errors: Vec<f32> = (0..400)
        .map_while(|step| {
            let spacing_px = 0.4 * 1.005f64.powi(step);
            match decide(&[patch(2e6, spacing_px)], &[], &tree) {
                Detail::Tree { error } => Some(error.px()),
                Detail::Full { .. } => None,
            }
        })
        .collect();
    assert!(errors.len() < 400 && errors[0] == 4.0);
    assert!(errors.windows(2).all(|pair| pair[1] <= pair[0] && pair[1] > 0.9 * pair[0]));
    assert!(*errors.last().unwrap() < 1.1, "{errors:?}");
}

/// A node of a mesh costs several triangles. With a quarter of the error, the tree would take up to five times as long as full detail.
#[test]
fn the_error_of_meshes_decreases_as_far_as_time_allows() {
    let tree = settings(Reconstruct::Splats, 4.0);
    let full = Settings { lod: Lod::Full, ..tree };
    let view = view();
    let mut errors = Vec::new();
    for step in 0..400 {
        let triangles = [patch(2e6, 0.1 * 1.005f64.powi(step))];
        let grounds = DetailGrounds {
            samples: &[],
            triangles: &triangles,
            segments: &[],
            view: &view,
            elements: 2_000_000,
            chunks: 1,
            full: &full,
            tree: &tree,
            costs: Costs::of(false),
        };
        let Detail::Tree { error } = choose(&grounds) else { break };
        let shown = Shown::of(&grounds);
        let [drawn, accepted] = [error.px(), 4.0].map(|px| shown.at(px));
        assert!(shown.tree_ns(drawn) <= (MOST_TIMES + 1e-6) * shown.full_ns(accepted));
        errors.push(error.px());
    }
    assert!(errors.len() < 400 && errors[0] == 4.0);
    assert!(errors.windows(2).all(|pair| pair[1] > 0.9 * pair[0]));
    let last = *errors.last().unwrap();
    assert!((2.0..3.5).contains(&last), "{last}");
}

#[test]
fn straight_segments_are_drawn_from_levels_sooner_than_bent_ones() {
    let tree = settings(Reconstruct::Points, 1.0);
    let (full, view) = (Settings { lod: Lod::Full, ..tree }, view());
    let is_tree = |bend_px: f64, count: f64| {
        let segments = &[patch(count, bend_px)];
        let grounds = DetailGrounds {
            samples: &[],
            triangles: &[],
            segments,
            view: &view,
            elements: count as u64,
            chunks: 1,
            full: &full,
            tree: &tree,
            costs: Costs::of(false),
        };
        !is_full(&choose(&grounds))
    };
    assert!(is_tree(0.05, 2e6) && is_tree(0.4, 2e6));
    assert!(!is_tree(1.0, 2e6), "as many are left");
    assert!(!is_tree(0.05, 4e3), "listing alone takes longer");
}

/// On a GPU, passes take longer to start than most elements to draw.
#[test]
fn gpus_draw_millions_of_elements_in_full() {
    let (full, view) = (settings(Reconstruct::Splats, 1.0), view());
    let is_tree = |count: f64, spacing_px: f64| {
        let samples = &[patch(count, spacing_px)];
        let (full, tree) = (&Settings { lod: Lod::Full, ..full }, &full);
        let grounds = DetailGrounds {
            samples,
            triangles: &[],
            segments: &[],
            view: &view,
            elements: count as u64,
            chunks: 1,
            full,
            tree,
            costs: Costs::of(true),
        };
        !is_full(&choose(&grounds))
    };
    assert!(!is_tree(1e6, 0.1) && !is_tree(2e6, 0.05), "listing alone takes longer");
    assert!(is_tree(8e6, 0.05) && !is_tree(8e6, 1.0));
}
