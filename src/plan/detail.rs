//! Choice of full detail for `lod=spt`.
//!
//! Full detail keeps within every accepted error. It is drawn where a point tree has little to leave out: choosing its nodes then costs
//! more than they save. On two cores without a GPU (`cargo bench --bench audit`), a tree whose nodes were mostly leaves took 1.2 to 2.4
//! times the time of full detail, and a mesh of up to 400,000 triangles 1.0 to 3.5 times, from close up as from far away.

use super::Reconstruct;

/// Samples, triangles and instances up to which full detail may be drawn: what lies outside of the image costs time there too.
const MOST_SAMPLES: u64 = 2_000_000;
const MOST_INSTANCES: u64 = 1024;
/// Triangles that are drawn in the time of a point tree that draws nothing, and those to add for each pixel of the frame.
const FEW_TRIANGLES: f64 = 200_000.0;
const TRIANGLES_A_PIXEL: f64 = 0.3;
/// Distance between neighbouring samples from which on most nodes are leaves, in widths of the largest node that is accepted.
const LEAVES_FROM: f64 = 0.4;

/// Returns the largest radius of a node, in pixels, that is drawn as a point. A disc about a node covers all leaves below it, and so it may
/// reach beyond them by twice its radius: that is half of the accepted error, but no less than the pixel that a point fills anyway. A single
/// pixel stands for a node of the whole error. With three quarters of it, the checkerboard of the audit has 39 pixels in place of 676 (of
/// 165,846) that full detail fills and points of one pixel's error leave empty, but distant copies of flat things are 1.8 times as bright
/// as they are.
pub fn point_error_px(accepted_px: f32, are_discs: bool) -> f32 {
    if are_discs { (0.5 * accepted_px).max(accepted_px.min(1.0)) } else { accepted_px }
}

/// Facts that decide the choice.
#[derive(Clone, Copy, Debug)]
pub struct DetailGrounds {
    /// Instances counted.
    pub samples: u64,
    pub triangles: u64,
    pub instances: u64,
    pub pixels: u64,
    pub reconstruct: Reconstruct,
    pub accepted_px: f32,
}

/// Why a frame with `lod=spt` is drawn at full detail; `None` where it is drawn from point trees. `spacing_px`: the usual distance between
/// neighbouring samples, in pixels; `None` where none is in view. It is asked for only where it matters.
pub fn why_full(
    grounds: &DetailGrounds,
    spacing_px: impl FnOnce() -> Option<f64>,
) -> Option<String> {
    let few_triangles = FEW_TRIANGLES + TRIANGLES_A_PIXEL * grounds.pixels as f64;
    if grounds.instances > MOST_INSTANCES
        || grounds.samples > MOST_SAMPLES
        || grounds.triangles as f64 > few_triangles
    {
        return None;
    }
    if grounds.samples == 0 {
        return Some(format!(
            "{} triangles are drawn sooner than nodes are chosen",
            grounds.triangles
        ));
    }
    let spacing_px = spacing_px()?;
    let error_px = grounds.accepted_px;
    let node_px = match grounds.reconstruct {
        Reconstruct::Points => point_error_px(error_px, error_px > 1.0),
        _ => error_px,
    };
    (spacing_px >= LEAVES_FROM * f64::from(node_px)).then(|| {
        format!("samples lie {spacing_px:.2} px apart: a point tree would draw most of them too")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOUD: DetailGrounds = DetailGrounds {
        samples: 300_000,
        triangles: 0,
        instances: 1,
        pixels: 1 << 20,
        reconstruct: Reconstruct::Splats,
        accepted_px: 1.0,
    };

    fn is_full(grounds: DetailGrounds, spacing_px: f64) -> bool {
        why_full(&grounds, || Some(spacing_px)).is_some()
    }

    #[test]
    fn sparse_samples_are_drawn_in_full() {
        assert!(is_full(CLOUD, 0.5) && !is_full(CLOUD, 0.3));
        let coarse = DetailGrounds { accepted_px: 4.0, ..CLOUD };
        assert!(is_full(coarse, 1.7) && !is_full(coarse, 1.5));
        let points = DetailGrounds { reconstruct: Reconstruct::Points, ..coarse };
        assert!(is_full(points, 0.9) && !is_full(points, 0.7));
        let fine = DetailGrounds { accepted_px: 0.5, ..points };
        assert!(is_full(fine, 0.25) && !is_full(fine, 0.15));
        assert!(why_full(&CLOUD, || None).is_none(), "nothing in view");
        let text = why_full(&CLOUD, || Some(0.5));
        assert_eq!(
            text.as_deref(),
            Some("samples lie 0.50 px apart: a point tree would draw most of them too")
        );
    }

    #[test]
    fn large_scenes_are_drawn_from_trees() {
        assert!(!is_full(DetailGrounds { samples: 2_000_001, ..CLOUD }, 2.0));
        assert!(!is_full(DetailGrounds { instances: 1025, ..CLOUD }, 2.0));
        assert!(!is_full(DetailGrounds { triangles: 600_000, ..CLOUD }, 2.0));
    }

    #[test]
    fn meshes_are_drawn_in_full_while_they_are_small_beside_the_frame() {
        let mesh = DetailGrounds { samples: 0, triangles: 400_000, ..CLOUD };
        let nothing = || -> Option<f64> { unreachable!("a mesh has no samples") };
        assert!(why_full(&mesh, nothing).is_some());
        assert!(why_full(&DetailGrounds { pixels: 1 << 16, ..mesh }, nothing).is_none());
    }
}
