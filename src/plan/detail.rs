//! Choice between point trees and full detail for `lod=spt`.
//!
//! Full detail keeps within every accepted error. It is drawn where choosing the nodes of a tree would cost more than they save: a tree
//! tests about `n · (κ s / e)²` nodes in place of `n` samples or triangles that lie `s` pixels apart, if nodes may be `e` pixels wide,
//! and a node that is tested costs more than a sample that is drawn unasked. The [`Costs`] of CPUs were measured on two cores, those of discrete GPUs on an
//! NVIDIA H200, where a frame of full detail takes hardly longer than its passes take to start: 1 to 8 million samples or 0.4 to 2.9 million triangles,
//! 0.4 to 1.4 ms (statues and reliefs at 256² and 1024²). The cost of a chunk was measured on CPUs (the plaza of 17,600 instances: 4.0 to 4.5 ms to place and
//! cull about 24,000 chunks). That of GPUs was not measured: the ratio of the costs of a segment gives it.
//!
//! A frame of the tree differs from one of full detail, within the accepted error, in every part of the image at once. Therefore the error
//! decreases before full detail takes over: to a quarter of the accepted one, over the last quarter of an octave of distance, where
//! what still differs is small. That costs up to [`MOST_TIMES`] the time of full detail there, as estimated. Nodes of meshes cost several triangles
//! each: there the error decreases less.

use super::{MaxError, Settings, auto};
use crate::bake::spacing::Patch;
use crate::math::View;

/// Stored samples, triangles and segments of a scene, and chunks of all its instances, up to which full detail may be drawn. GPU memory holds both beside the
/// trees. Every frame culls all chunks, those outside of the image included.
const MOST_ELEMENTS: u64 = 8_000_000;
const MOST_CHUNKS: u64 = 1 << 18;

/// Time of the tree over that of full detail from which on the error decreases.
const NEAR: f64 = 0.7;
/// The smallest error, over the accepted one, just before full detail is drawn.
const LEAST_SHARE: f64 = 0.25;
/// How many times as long as full detail a tree with a smaller error than the accepted one may take.
const MOST_TIMES: f64 = 2.0;
/// `κ`: where nodes are chosen by their size, or stand for triangles, and where they are chosen by their error.
pub(super) const NODES_BY_SIZE: f64 = 1.9;
pub(super) const NODES_BY_ERROR: f64 = 1.6;
/// Segments of levels of detail in place of `n` that bend away by `b` pixels each: `n · κ (b / e)^p`.
const BENDS: f64 = 1.0;
const BENDS_POWER: f64 = 1.1;

/// Cost of an element by the way that samples are drawn, in ns.
#[derive(Debug)]
struct Cost {
    /// A sample of full detail that is drawn.
    full: f64,
    /// A node that is tested, and drawn where it passes.
    node: f64,
    /// A node of a mesh's tree, with the triangles that are left to draw.
    node_of_mesh: f64,
    /// Each square pixel of the square of a splat's radius.
    area: f64,
}

/// Costs of one kind of adapter, in ns.
#[derive(Debug)]
pub struct Costs {
    /// The passes that list chunks of trees.
    listing: f64,
    /// A triangle of a mesh.
    triangle: f64,
    /// A segment of a line that covers few pixels.
    segment: f64,
    /// A chunk of an instance that is culled.
    chunk: f64,
    points: Cost,
    discs: Cost,
    splats: Cost,
}

const OF_CPUS: Costs = Costs {
    listing: 1.5e6,
    triangle: 15.0,
    segment: 130.0,
    chunk: 170.0,
    points: Cost { full: 4.2, node: 20.0, node_of_mesh: 40.0, area: 0.0 },
    discs: Cost { full: 20.0, node: 50.0, node_of_mesh: 70.0, area: 0.0 },
    splats: Cost { full: 50.0, node: 70.0, node_of_mesh: 85.0, area: 8.0 },
};
const OF_GPUS: Costs = Costs {
    listing: 1.6e5,
    triangle: 0.05,
    segment: 0.5,
    chunk: 0.65,
    points: Cost { full: 0.02, node: 0.05, node_of_mesh: 0.3, area: 0.0 },
    discs: Cost { full: 0.05, node: 0.5, node_of_mesh: 0.5, area: 0.0 },
    splats: Cost { full: 0.06, node: 0.05, node_of_mesh: 0.3, area: 0.25 },
};

impl Costs {
    /// Costs of GPUs with memory of their own, or of other adapters. Integrated GPUs have not been measured; they count as CPUs, whose
    /// memory they share.
    pub fn of(is_discrete_gpu: bool) -> &'static Costs {
        if is_discrete_gpu { &OF_GPUS } else { &OF_CPUS }
    }

    fn of_samples(&self, settings: &Settings) -> &Cost {
        match (settings.draws_points(), settings.discs()) {
            (true, None) => &self.points,
            (true, Some(_)) => &self.discs,
            (false, _) => &self.splats,
        }
    }
}

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
    pub segments: &'a [Patch],
    pub view: &'a View,
    /// Samples, triangles and segments of the scene's assets: those of an asset count once, however many instances it has.
    pub elements: u64,
    /// Chunks of all instances.
    pub chunks: u64,
    /// How the frame would be drawn at full detail, and from trees. Neither leaves open how samples are drawn.
    pub full: &'a Settings,
    pub tree: &'a Settings,
    pub costs: &'a Costs,
}

/// Returns the largest radius of a node, in pixels, that is drawn as a point. A disc about a node covers all leaves below it, and so it may
/// reach beyond them by twice its radius: that is half of the accepted error, but no less than the pixel that a point fills anyway. Up to an
/// error of one pixel, a node of the whole error is drawn in the pixels whose centres it covers. With three quarters of the error, distant
/// copies of flat things are 1.8 times as bright as they are.
pub fn point_error_px(accepted_px: f32, are_discs: bool) -> f32 {
    if are_discs { (0.5 * accepted_px).max(accepted_px.min(1.0)) } else { accepted_px }
}

/// Elements in view, and what a tree tests in their place.
#[derive(Clone, Copy, Default)]
pub(super) struct Seen {
    pub elements: f64,
    /// Sum of the squares of their distances, in square pixels.
    pub area: f64,
    pub nodes: f64,
    /// Sum of the squares of their widths, in square pixels.
    pub area_of_nodes: f64,
}

/// What a patch shows: the distance of its elements in pixels, and how many are in view, as [`auto::in_view`] tells.
pub(super) type InView = (f64, f64);

/// Samples or triangles, where nodes may be `node_px` wide.
pub(super) fn seen(patches: impl Iterator<Item = InView>, width: f64, node_px: f64) -> Seen {
    patches.fold(Seen::default(), |sum, (spacing_px, count)| {
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

/// Segments, where levels of detail may be off by `node_px`.
pub(super) fn seen_segments(patches: impl Iterator<Item = InView>, node_px: f64) -> Seen {
    patches.fold(Seen::default(), |sum, (bend_px, count)| Seen {
        elements: sum.elements + count,
        nodes: sum.nodes + count * (BENDS * (bend_px / node_px).powf(BENDS_POWER)).min(1.0),
        ..sum
    })
}

/// The patches of a scene that are in view. The costs of every error follow from them.
struct Shown<'a> {
    samples: Vec<InView>,
    triangles: Vec<InView>,
    segments: Vec<InView>,
    chunks: f64,
    by_size: bool,
    costs: &'a Costs,
    full: &'a Cost,
    tree: &'a Cost,
}

impl<'a> Shown<'a> {
    fn of(grounds: &DetailGrounds<'a>) -> Shown<'a> {
        let in_view = |patches: &[Patch]| {
            patches.iter().filter_map(|patch| auto::in_view(patch, grounds.view)).collect()
        };
        Shown {
            samples: in_view(grounds.samples),
            triangles: in_view(grounds.triangles),
            segments: in_view(grounds.segments),
            chunks: grounds.chunks as f64,
            by_size: grounds.tree.draws_points(),
            costs: grounds.costs,
            full: grounds.costs.of_samples(grounds.full),
            tree: grounds.costs.of_samples(grounds.tree),
        }
    }

    /// Samples, triangles and segments with what a tree of an accepted error tests in their place.
    fn at(&self, accepted_px: f32) -> [Seen; 3] {
        let node_px =
            if self.by_size { point_error_px(accepted_px, accepted_px > 1.0) } else { accepted_px };
        let node_px = f64::from(node_px);
        let width = if self.by_size { NODES_BY_SIZE } else { NODES_BY_ERROR };
        [
            seen(self.samples.iter().copied(), width, node_px),
            seen(self.triangles.iter().copied(), NODES_BY_SIZE, node_px),
            seen_segments(self.segments.iter().copied(), node_px),
        ]
    }

    fn full_ns(&self, [samples, triangles, segments]: [Seen; 3]) -> f64 {
        self.full.full * samples.elements
            + self.full.area * samples.area
            + self.costs.triangle * triangles.elements
            + self.costs.segment * segments.elements
            + self.costs.chunk * self.chunks
    }

    fn tree_ns(&self, [samples, triangles, segments]: [Seen; 3]) -> f64 {
        self.tree.node * samples.nodes
            + self.tree.node_of_mesh * triangles.nodes
            + self.costs.segment * segments.nodes
            + self.tree.area * (samples.area_of_nodes + triangles.area_of_nodes)
            + self.costs.listing
    }

    /// The smallest error from `wanted_px` to `accepted_px` with which the tree takes at most `most_ns`, within a hundredth of an octave.
    fn affordable(&self, wanted_px: f32, accepted_px: f32, most_ns: f64) -> f32 {
        let is_dear = |error_px: f32| self.tree_ns(self.at(error_px)) > most_ns;
        if !is_dear(wanted_px) {
            return wanted_px;
        }
        let [mut dear, mut fine] = [wanted_px, accepted_px].map(f32::log2);
        while fine - dear > 0.01 {
            let middle = 0.5 * (dear + fine);
            if is_dear(middle.exp2()) { dear = middle } else { fine = middle }
        }
        fine.exp2().min(accepted_px)
    }
}

/// Decides whether a frame with `lod=spt` is drawn from point trees, and with which error.
pub fn choose<'a>(grounds: &DetailGrounds<'a>) -> Detail {
    let accepted = grounds.tree.accepted_error();
    let accepted_px = accepted.px();
    if grounds.chunks > MOST_CHUNKS || grounds.elements > MOST_ELEMENTS {
        return Detail::Tree { error: accepted };
    }
    let shown = Shown::of(grounds);
    let seen = shown.at(accepted_px);
    let (full_ns, tree_ns) = (shown.full_ns(seen), shown.tree_ns(seen));
    if tree_ns >= full_ns {
        let because = format!(
            "the {:.0} samples, triangles and segments in view are drawn sooner than nodes are chosen in their place",
            seen.iter().map(|of_kind| of_kind.elements).sum::<f64>()
        );
        return Detail::Full { because };
    }
    // From 0, where the error is the accepted one, to 1, where full detail takes over.
    let nearness = 1.0 - (tree_ns / full_ns).max(NEAR).log(NEAR);
    let [least_px, _] = MaxError::RANGE;
    let wanted_px = accepted_px * LEAST_SHARE.powf(nearness) as f32;
    let error_px = shown.affordable(wanted_px, accepted_px, MOST_TIMES * full_ns);
    Detail::Tree { error: MaxError::new(error_px.max(least_px)).unwrap_or(accepted) }
}

#[cfg(test)]
mod tests;
