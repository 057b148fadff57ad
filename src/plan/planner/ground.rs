//! What a pose shows of a scene, in the few figures by which the planner compares poses.

use serde::{Deserialize, Serialize};

use super::super::auto;
use super::super::detail::{InView, NODES_BY_ERROR, NODES_BY_SIZE, seen, seen_segments};
use crate::bake::spacing::Patch;
use crate::math::View;

/// Accepted errors at which the nodes of point trees are counted, in pixels.
const ERRORS_PX: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// Places without any element count as this many, so that logarithms are finite.
const LEAST: f64 = 1e-3;
/// Numbers that describe a ground's likeness to another; see [`Ground::place`].
const AXES: usize = 4;

/// A pose as the planner sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ground {
    pub pixels: f64,
    /// Estimated share of the image that elements cover, from 0 to 1.
    pub covered: f64,
    /// Distance between neighbouring samples or sides of triangles in pixels, the mean over the area that they cover.
    spacing_px: f64,
    /// Samples, triangles and segments in view, and the area of the samples' splats in square pixels.
    full: Load,
    /// The same of the nodes of point trees, at each of [`ERRORS_PX`].
    nodes: [Load; ERRORS_PX.len()],
}

/// Elements that a frame has to draw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Load {
    pub samples: f64,
    pub triangles: f64,
    pub segments: f64,
    /// Square pixels of the squares of the splats' radii.
    pub area: f64,
}

impl Ground {
    /// The ground of a view of patches of samples, triangles and segments.
    pub fn new(patches: [&[Patch]; 3], view: &View) -> Ground {
        let [samples, triangles, segments] = patches.map(|patches| {
            patches.iter().filter_map(|patch| auto::in_view(patch, view)).collect::<Vec<InView>>()
        });
        let pixels = f64::from(view.width) * f64::from(view.height);
        let (mut covered, mut sum) = (0.0, 0.0);
        for &(px, count) in samples.iter().chain(&triangles) {
            let own = (count * px * px).min(pixels);
            covered += own;
            sum += own * px.max(LEAST).ln();
        }
        let spacing_px = if covered > 0.0 { (sum / covered).exp() } else { 1.0 };
        let seen_at = |error_px: f64| {
            let samples = seen(samples.iter().copied(), NODES_BY_ERROR, error_px);
            let triangles = seen(triangles.iter().copied(), NODES_BY_SIZE, error_px);
            [samples, triangles, seen_segments(segments.iter().copied(), error_px)]
        };
        let nodes = ERRORS_PX.map(|error_px| {
            let [samples, triangles, segments] = seen_at(error_px);
            Load {
                samples: samples.nodes,
                triangles: triangles.nodes,
                segments: segments.nodes,
                area: samples.area_of_nodes + triangles.area_of_nodes,
            }
        });
        let [samples, triangles, segments] = seen_at(1.0);
        let full = Load {
            samples: samples.elements,
            triangles: triangles.elements,
            segments: segments.elements,
            area: samples.area,
        };
        Ground { pixels, covered: (covered / pixels).min(1.0), spacing_px, full, nodes }
    }

    /// What is drawn at full detail, or with an accepted error in pixels.
    pub fn load(&self, error_px: Option<f64>) -> Load {
        let Some(error_px) = error_px else { return self.full };
        // Between counted errors, counts are interpolated by the logarithm of the error.
        let last = ERRORS_PX.len() - 1;
        let next = ERRORS_PX.iter().position(|&px| px >= error_px).unwrap_or(last).max(1);
        let (low, high) = (ERRORS_PX[next - 1], ERRORS_PX[next]);
        let share = ((error_px / low).ln() / (high / low).ln()).clamp(0.0, 1.0);
        let (low, high) = (self.nodes[next - 1], self.nodes[next]);
        let mix = |of: fn(&Load) -> f64| of(&low) + share * (of(&high) - of(&low));
        Load {
            samples: mix(|load| load.samples),
            triangles: mix(|load| load.triangles),
            segments: mix(|load| load.segments),
            area: mix(|load| load.area),
        }
    }

    /// Where the ground lies among others: similar poses lie near each other.
    fn place(&self) -> [f64; AXES] {
        [
            self.spacing_px.max(LEAST).log2(),
            self.covered.max(LEAST).log2(),
            0.5 * self.pixels.max(1.0).log2(),
            0.25 * (self.full.samples + self.full.triangles + self.full.segments).max(1.0).log2(),
        ]
    }

    /// Square of the distance to another ground, in octaves.
    pub fn distance2(&self, other: &Ground) -> f64 {
        let (a, b) = (self.place(), other.place());
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
    }
}
