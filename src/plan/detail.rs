//! Choice between point trees and full detail for `lod=spt`.
//!
//! Full detail keeps within every accepted error. It is drawn where choosing the nodes of a tree would cost more than they save: a tree
//! tests about `n · (κ s / e)²` nodes in place of `n` samples or triangles that lie `s` pixels apart, if nodes may be `e` pixels wide,
//! and a node that is tested costs more than a sample that is drawn unasked. The [`Cost`]s were measured on two cores without a GPU.
//!
//! A frame of the tree differs from one of full detail, within the accepted error, in every part of the image at once. Therefore the error
//! decreases before full detail takes over: to a quarter of the accepted one, over the last quarter of an octave of distance, where
//! what still differs is small. That costs up to twice the time of full detail there.

use super::{MaxError, Reconstruct, Settings, auto};
use crate::bake::spacing::Patch;
use crate::math::View;

/// Samples and triangles of a scene, and its instances, up to which full detail may be drawn: it is kept in GPU memory beside the trees, and
/// what lies outside of the image costs time there too.
const MOST_ELEMENTS: u64 = 8_000_000;
const MOST_INSTANCES: u64 = 1024;

/// Time of the passes that list chunks of trees, in ns.
const LISTING_NS: f64 = 1.5e6;
/// Time of a triangle of a mesh, in ns.
const TRIANGLE_NS: f64 = 15.0;
/// Time of a splat for each square pixel of the square of its radius, in ns.
const SPLAT_AREA_NS: f64 = 8.0;
/// Time of the tree over that of full detail from which on the error decreases.
const NEAR: f64 = 0.7;
/// The smallest error, over the accepted one, just before full detail is drawn.
const LEAST_SHARE: f64 = 0.25;
/// `κ`: where nodes are chosen by their size, or stand for triangles, and where they are chosen by their error.
const NODES_BY_SIZE: f64 = 1.9;
const NODES_BY_ERROR: f64 = 1.6;

/// What an element costs by the way that samples are drawn, in ns.
struct Cost {
    /// A sample of full detail that is drawn.
    full: f64,
    /// A node that is tested, and drawn where it passes.
    node: f64,
    /// A node of a mesh's tree, with the triangles that are left to draw.
    node_of_mesh: f64,
    /// See [`SPLAT_AREA_NS`].
    area: f64,
}

const POINTS: Cost = Cost { full: 4.2, node: 20.0, node_of_mesh: 40.0, area: 0.0 };
const DISCS: Cost = Cost { full: 20.0, node: 50.0, node_of_mesh: 70.0, area: 0.0 };
const SPLATS: Cost = Cost { full: 50.0, node: 70.0, node_of_mesh: 85.0, area: SPLAT_AREA_NS };
/// Distance of samples, in pixels, up to which the area of their splats counts: the image ends.
const WIDEST_PX: f64 = 4.0;

/// How a frame with `lod=spt` is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Detail {
    /// At full detail, and why.
    Full { because: String },
    /// From point trees, with this error. It is at most the accepted one.
    Tree { error: MaxError },
}

/// Facts that decide the choice.
#[derive(Clone, Copy, Debug)]
pub struct DetailGrounds<'a> {
    pub samples: &'a [Patch],
    pub triangles: &'a [Patch],
    pub view: &'a View,
    /// Samples and triangles of the scene.
    pub elements: u64,
    pub instances: u64,
    /// How the frame would be drawn at full detail, and from trees. Neither leaves open how samples are drawn.
    pub full: &'a Settings,
    pub tree: &'a Settings,
}

/// Returns the largest radius of a node, in pixels, that is drawn as a point. A disc about a node covers all leaves below it, and so it may
/// reach beyond them by twice its radius: that is half of the accepted error, but no less than the pixel that a point fills anyway. A single
/// pixel stands for a node of the whole error. With three quarters of it, the checkerboard of the audit has 39 pixels in place of 676 (of
/// 165,846) that full detail fills and points of one pixel's error leave empty, but distant copies of flat things are 1.8 times as bright
/// as they are.
pub fn point_error_px(accepted_px: f32, are_discs: bool) -> f32 {
    if are_discs { (0.5 * accepted_px).max(accepted_px.min(1.0)) } else { accepted_px }
}

fn cost_of(settings: &Settings) -> Cost {
    match settings.reconstruct {
        Reconstruct::Points if settings.discs().is_none() => POINTS,
        Reconstruct::Points => DISCS,
        _ => SPLATS,
    }
}

/// Elements in view, and what a tree tests in their place.
#[derive(Default)]
struct Seen {
    elements: f64,
    /// Sum of the squares of their distances, in square pixels.
    area: f64,
    nodes: f64,
    /// Sum of the squares of their widths, in square pixels.
    area_of_nodes: f64,
}

fn seen(patches: &[Patch], view: &View, width: f64, node_px: f64) -> Seen {
    let seen = patches.iter().filter_map(|patch| auto::in_view(patch, view));
    seen.fold(Seen::default(), |sum, (spacing_px, count)| {
        let nodes = count * (width * spacing_px / node_px).powi(2).min(1.0);
        let apart_px = spacing_px.min(WIDEST_PX);
        Seen {
            elements: sum.elements + count,
            area: sum.area + count * apart_px.powi(2),
            nodes: sum.nodes + nodes,
            area_of_nodes: sum.area_of_nodes + nodes * apart_px.max(node_px).powi(2),
        }
    })
}

/// Decides whether a frame with `lod=spt` is drawn from point trees, and with which error.
pub fn choose(grounds: &DetailGrounds<'_>) -> Detail {
    let accepted = grounds.tree.max_error_px;
    let accepted_px = accepted.px();
    if grounds.instances > MOST_INSTANCES || grounds.elements > MOST_ELEMENTS {
        return Detail::Tree { error: accepted };
    }
    let by_size = grounds.tree.reconstruct == Reconstruct::Points;
    let node_px =
        if by_size { point_error_px(accepted_px, accepted_px > 1.0) } else { accepted_px };
    let (node_px, view) = (f64::from(node_px), grounds.view);
    let width = if by_size { NODES_BY_SIZE } else { NODES_BY_ERROR };
    let samples = seen(grounds.samples, view, width, node_px);
    let triangles = seen(grounds.triangles, view, NODES_BY_SIZE, node_px);
    let (full, tree) = (cost_of(grounds.full), cost_of(grounds.tree));
    let full_ns =
        full.full * samples.elements + full.area * samples.area + TRIANGLE_NS * triangles.elements;
    let tree_ns = tree.node * samples.nodes
        + tree.node_of_mesh * triangles.nodes
        + tree.area * (samples.area_of_nodes + triangles.area_of_nodes)
        + LISTING_NS;
    if tree_ns >= full_ns {
        let because = format!(
            "the {:.0} samples and triangles in view are drawn sooner than nodes are chosen in their place",
            samples.elements + triangles.elements
        );
        return Detail::Full { because };
    }
    // From 0, where the error is the accepted one, to 1, where full detail takes over.
    let nearness = 1.0 - (tree_ns / full_ns).max(NEAR).log(NEAR);
    let [least_px, _] = MaxError::RANGE;
    let error_px = accepted_px * LEAST_SHARE.powf(nearness) as f32;
    Detail::Tree { error: MaxError::new(error_px.max(least_px)).unwrap_or(accepted) }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::math::{Camera, Lens};
    use crate::plan::Lod;

    /// A frame of 512² pixels, in which a unit is 512 pixels wide.
    fn view() -> View {
        let camera = Camera {
            eye: DVec3::Z,
            target: DVec3::ZERO,
            up: DVec3::Y,
            lens: Lens::Perspective { fov_deg: 53.130_102 },
        };
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
        let instances = 1;
        choose(&DetailGrounds {
            samples,
            triangles,
            view: &view,
            elements,
            instances,
            full: &full,
            tree,
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
            |spacing_px: f64, tree: &Settings| {
                is_full(&decide(&[patch(2e6, spacing_px)], &[], tree))
            },
            |spacing_px: f64, tree: &Settings| {
                is_full(&decide(&[], &[patch(2e6, spacing_px)], tree))
            },
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
        let because = "the 2000000 samples and triangles in view are drawn sooner than nodes are chosen in their place";
        assert_eq!(
            decide(&[patch(2e6, 0.7)], &[], &splats),
            Detail::Full { because: because.into() }
        );
        assert!(is_full(&decide(&[], &[], &splats)), "nothing in view");
    }

    #[test]
    fn large_scenes_are_drawn_from_trees() {
        let tree = settings(Reconstruct::Points, 1.0);
        assert_eq!(
            decide(&[patch(9e6, 2.0)], &[], &tree),
            Detail::Tree { error: MaxError::default() }
        );
        let (full, view) = (Settings { lod: Lod::Full, ..tree }, view());
        let (samples, triangles) = (&[patch(1e6, 2.0)], &[]);
        let many = DetailGrounds {
            samples,
            triangles,
            view: &view,
            elements: 1_000_000,
            instances: 1025,
            full: &full,
            tree: &tree,
        };
        assert_eq!(choose(&many), Detail::Tree { error: MaxError::default() });
        assert!(is_full(&choose(&DetailGrounds { instances: 1024, ..many })));
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
}
