//! How samples are drawn as splats (Zwicker et al. 2004): what a scene says, and what a request may say instead.

use crate::words::words;

words! {
    /// How a kernel is taken to the image.
    #[derive(schemars::JsonSchema)]
    pub enum Filter {
        /// By the projection's linear approximation at the kernel's centre (Heckbert 1989; Zwicker et al. 2001): exact there.
        Affine,
        /// As the ellipse that the cut-off projects to (Zwicker et al. 2004, §4): exact at the outline.
        #[default]
        Perspective,
        /// By intersecting each pixel's ray with the kernel's plane (Botsch et al. 2005): exact everywhere.
        Exact,
    }

    /// How overlapping splats are combined.
    #[derive(schemars::JsonSchema)]
    pub enum Blend {
        /// Three passes: visibility, weighted sums, normalisation.
        #[default]
        Weighted,
        /// One pass: the nearest splat alone, depth-tested.
        Opaque,
    }

    /// When splats are lit.
    #[derive(schemars::JsonSchema)]
    pub enum Shading {
        /// Once a pixel, from blended colours and normals (Phong splatting).
        #[default]
        Deferred,
        /// Each splat by its own normal; lit colours are blended.
        Splat,
    }

    /// Weights of the samples around a gap that pull-push fills (Marroquim et al. 2008, §3.3).
    pub enum PullPushWeights {
        /// Elliptical Gaussians: smooth colours and normals.
        #[default]
        Gaussian,
        /// Equal weights for all samples whose disks cover a place.
        Box,
    }
}

/// Parameters of pull-push reconstruction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PullPush {
    /// The disks that samples stand for. Neither a filter nor a low-pass filter applies to them.
    pub splats: Splats,
    pub weights: PullPushWeights,
}

words! {
    /// What is blended when splats are painted (Coconu & Hege 2002, §5.4).
    pub enum Painting {
        /// Surfaces: splats at the same depth are averaged first (Zwicker et al. 2004, §6)
        #[default]
        Surfaces,
        /// Each splat by itself, as in the paper: faster, but the front splats of a surface get the largest weights
        Splats,
    }
}

/// Parameters of splats that are painted over each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Painted {
    pub splats: Splats,
    pub each: Painting,
}

/// Number of layers of a painted splat's Gaussian whose combined opacity is that of the splat (compare Coconu & Hege 2002, §5.4). With one
/// layer, a third of the background would show through between four samples of a regular grid.
pub const PAINT_LAYERS: u32 = 5;

/// Width of what a painted splat covers, in percent of its kernel. Kernels end at the corners of their cells; surfaces of random samples
/// would be open there.
pub const PAINT_WIDTH_PERCENT: u32 = 115;

/// How a scene's samples are drawn as splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splats {
    pub filter: Filter,
    pub blend: Blend,
    pub shading: Shading,
    /// Whether kernels are convolved with a low-pass filter of the image (EWA).
    pub prefilter: bool,
    /// Standard deviation of that filter, in pixels.
    pub lowpass_px: f32,
    /// Where kernels end, in their standard deviations.
    pub cutoff: f32,
    /// Multiplies every kernel's axes.
    pub width: f32,
    /// How far behind the nearest surface splats still count, in radii of the nearest splat.
    pub depth_offset: f32,
}

impl Default for Splats {
    fn default() -> Self {
        Self {
            filter: Filter::default(),
            blend: Blend::default(),
            shading: Shading::default(),
            prefilter: true,
            lowpass_px: 0.5,
            cutoff: 2.0,
            width: 1.0,
            depth_offset: 1.0,
        }
    }
}
