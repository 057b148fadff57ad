//! Choice of a reconstruction for `reconstruct=auto`.
//!
//! Points leave a pixel empty where no sample falls into it: `e^(-1/s²)` of a randomly sampled surface whose samples lie `s`
//! pixels apart, 2 % at half a pixel and 37 % at one. [`choose`] draws splats where more than a tenth of what samples cover has more
//! holes than at [`DENSE_PX`]: the median would let the sparse parts of an uneven scan be riddled with holes.
//!
//! Where samples lie [`WIDE_PX`] apart and more and cover much of the picture, pull-push closes the surface sooner than splats do: splats touch each of
//! their pixels about eleven times, and pull-push has a fixed cost for each pixel. `docs/pull-push.md` has the times.
//!
//! Pull-push knows of samples beside the image no more than its border has pixels for. [`outgrow`] tells where so few samples lie in the image that those beside
//! it decide what it shows.

use crate::bake::spacing::Patch;
use crate::math::View;

use super::{Lod, Reconstruct};

/// Most accepted error of point trees, in pixels, up to which their nodes are as dense as pixels.
const COARSE_PX: f64 = 1.0;
/// Samples that lie closer together, in pixels, are drawn as points.
pub const DENSE_PX: f64 = 0.6;
/// Share of the area covered by samples that has to be at least as dense.
const DENSE_SHARE: f64 = 0.9;
/// Samples that lie farther apart, in pixels, are drawn by pull-push.
const WIDE_PX: f64 = 8.0;
/// Least number of samples along the image's shorter side from which pull-push reconstructs a surface. With a quarter of it, the step of a thousandth of a pixel
/// changed whole images, when a sample moved to another pixel of the border; see `docs/pull-push.md`.
const LEAST_ALONG: f64 = 8.0;
/// Share of the picture that they have to cover.
const WIDE_SHARE: f64 = 0.25;
/// Farther apart, samples cover no more of the picture: strays in an empty sky do not decide how the rest is drawn.
const SPARSE_PX: f64 = 3.0;
/// Diameter of discs in distances between neighbouring samples: on a randomly sampled surface they leave 4 % of the pixels empty.
const DISC_SPACINGS: f64 = 2.0;
/// Diameter beyond which discs hide more than they close.
const WIDEST_DISC_PX: f64 = 12.0;
/// Share of a patch's radius from which its samples are seen at the nearest.
const NEAREST: f64 = 0.25;

/// Facts that decide the choice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grounds {
    pub lod: Lod,
    pub has_samples: bool,
    /// Distance between neighbouring samples in pixels, as [`spacing_px`] tells; `None` where none is in view.
    pub spacing_px: Option<f64>,
    /// Parts along each side of a pixel that are averaged.
    pub parts: u32,
    /// Share of the picture that samples cover, as [`covered_share`] tells.
    pub covered: f64,
    /// Samples lie too far apart for pull-push, as [`outgrow`] tells.
    pub outgrow: bool,
    /// Settings of splats are those of the scene, and no kernel has clip lines.
    pub are_splats_plain: bool,
    /// Error that `lod=spt` may have.
    pub accepted_px: f32,
    /// Kernels of all samples are there; without them nothing but points can be drawn.
    pub has_kernels: bool,
    /// The request says how large points are.
    pub has_point_size: bool,
}

/// A choice, with the spacing and the reason that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    pub reconstruct: Reconstruct,
    pub spacing_px: Option<f64>,
    pub reason: Reason,
}

/// Why samples are drawn as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    NoSamples,
    NoKernels,
    PointSize,
    NothingInView,
    /// Samples are denser than pixels.
    Dense,
    /// Samples leave pixels empty.
    Sparse,
    /// They leave so many empty that splats would take longer than pull-push.
    Wide,
    /// Nodes of point trees are as small as pixels.
    Fine,
    /// Nodes of point trees leave pixels empty, since errors of so many pixels are accepted.
    Coarse {
        accepted_px: f32,
    },
}

impl Choice {
    /// One line for the receipt.
    pub fn because(&self) -> String {
        let apart = || {
            let px = self.spacing_px.unwrap_or_default();
            // Two digits that count.
            let digits = if px < 0.095 {
                3
            } else if px < 0.95 {
                2
            } else {
                usize::from(px < 9.5)
            };
            format!(
                "samples lie up to {px:.digits$} px apart in {:.0} % of what they cover",
                100.0 * DENSE_SHARE
            )
        };
        match self.reason {
            Reason::NoSamples => "the scene has no samples".to_owned(),
            Reason::PointSize => "a size of points was given".to_owned(),
            Reason::NoKernels => "kernels are not estimated yet".to_owned(),
            Reason::NothingInView => "no sample is in view".to_owned(),
            Reason::Dense | Reason::Sparse | Reason::Wide => apart(),
            Reason::Fine => "nodes of point trees are as small as pixels".to_owned(),
            Reason::Coarse { accepted_px } => {
                format!("nodes of point trees may be {accepted_px} px wide")
            }
        }
    }
}

/// Chooses between points, splats and pull-push. Every frame with `reconstruct=auto` is decided here.
pub fn choose(grounds: &Grounds) -> Choice {
    let parts = f64::from(grounds.parts);
    let coarse = grounds.lod == Lod::Spt && parts * f64::from(grounds.accepted_px) > COARSE_PX;
    // The look of a surface stays the same with antialiasing.
    let is_wide = |px: f64| {
        let may_pull = !grounds.outgrow && grounds.are_splats_plain;
        px > WIDE_PX && grounds.covered >= WIDE_SHARE && may_pull
    };
    let (reconstruct, reason) = match grounds.spacing_px {
        _ if !grounds.has_samples => (Reconstruct::Points, Reason::NoSamples),
        _ if grounds.has_point_size => (Reconstruct::Points, Reason::PointSize),
        _ if !grounds.has_kernels => (Reconstruct::Points, Reason::NoKernels),
        Some(px) if is_wide(px) => (Reconstruct::PullPush, Reason::Wide),
        Some(px) if parts * px > DENSE_PX => (Reconstruct::Splats, Reason::Sparse),
        _ if coarse => (Reconstruct::Splats, Reason::Coarse { accepted_px: grounds.accepted_px }),
        Some(_) => (Reconstruct::Points, Reason::Dense),
        // Trees of meshes have all the samples that can be told apart.
        None if grounds.lod == Lod::Spt => (Reconstruct::Points, Reason::Fine),
        None => (Reconstruct::Points, Reason::NothingInView),
    };
    Choice { reconstruct, spacing_px: grounds.spacing_px, reason }
}

/// Returns the diameter, in pixels, of discs that close surfaces whose samples lie apart by `spacing_px`; `None` where samples are dense
/// enough as points.
pub fn disc_px(spacing_px: Option<f64>) -> Option<f64> {
    let px = spacing_px.filter(|px| *px > DENSE_PX)?;
    Some((DISC_SPACINGS * px).clamp(1.0, WIDEST_DISC_PX))
}

/// Returns the spacing of neighbouring samples, in pixels, that [`DENSE_SHARE`] of the area covered by samples does not exceed. `None` if
/// no patch is in view.
pub fn spacing_px(patches: &[Patch], view: &View) -> Option<f64> {
    let pixels = f64::from(view.width) * f64::from(view.height);
    let mut seen: Vec<(f64, f64)> = patches
        .iter()
        .filter_map(|patch| in_view(patch, view))
        .map(|(px, count)| (px, (count * px.min(SPARSE_PX).powi(2)).min(pixels)))
        .filter(|(_, covered)| *covered > 0.0)
        .collect();
    seen.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let dense = DENSE_SHARE * seen.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = seen.iter().find(|(_, weight)| {
        sum += weight;
        sum >= dense
    });
    reached.map(|(px, _)| *px)
}

/// Whether samples lie so far apart that pull-push cannot reconstruct the image from those in it: fewer than [`LEAST_ALONG`] along its shorter side, or none. `spacing_px`: what [`spacing_px`] tells.
/// Scenes without samples of their own have patches of none: nodes of their point trees lie about a pixel apart.
pub fn outgrow(patches: &[Patch], spacing_px: Option<f64>, view: &View) -> bool {
    let widest_px = f64::from(view.width.min(view.height)) / LEAST_ALONG;
    !patches.is_empty() && spacing_px.is_none_or(|px| px > widest_px)
}

/// Returns the share of a picture that samples cover, each a square of its spacing; 1 at most.
pub fn covered_share(patches: &[Patch], view: &View) -> f64 {
    let pixels = f64::from(view.width) * f64::from(view.height);
    let covered: f64 = patches
        .iter()
        .filter_map(|patch| in_view(patch, view))
        .map(|(px, count)| (count * px * px).min(pixels))
        .sum();
    (covered / pixels).min(1.0)
}

/// The spacing of a patch in pixels, and how many of its samples or triangles lie within the image, roughly. `None` if none does.
pub fn in_view(patch: &Patch, view: &View) -> Option<(f64, f64)> {
    let at = view.to_view(patch.centre);
    let depth = -at.z;
    if depth.is_nan() || depth <= -patch.radius {
        return None;
    }
    let depth = depth.max(NEAREST * patch.radius).max(f64::MIN_POSITIVE);
    let depth = view.divisor(depth);
    let focal = (view.focal_px.x * view.focal_px.y).sqrt();
    let (px, radius_px) = (patch.spacing * focal / depth, patch.radius * focal / depth);
    if !px.is_finite() || !radius_px.is_finite() {
        return None;
    }
    // The share of its square that lies within the image, along both axes.
    let share = |middle: f64, size: u32| {
        let radius = radius_px.max(0.5);
        let inside = (middle + radius).min(f64::from(size)) - (middle - radius).max(0.0);
        inside.max(0.0) / (2.0 * radius)
    };
    let x = view.principal_px.x + view.focal_px.x * at.x / depth;
    let y = view.principal_px.y - view.focal_px.y * at.y / depth;
    let count = patch.count * share(x, view.width) * share(y, view.height);
    (count > 0.0).then_some((px, count))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::math::Camera;

    fn view(distance: f64, height: u32) -> View {
        let eye = DVec3::new(0.0, 0.0, distance);
        let camera = Camera::perspective(eye, DVec3::ZERO, 53.130_102);
        camera.view(height * 4 / 3, height).unwrap()
    }

    fn patch(centre: DVec3, spacing: f64) -> Patch {
        Patch { centre, radius: 0.1, spacing, count: 1000.0 }
    }

    fn grounds(spacing_px: Option<f64>) -> Grounds {
        Grounds {
            lod: Lod::Full,
            has_samples: true,
            spacing_px,
            covered: 1.0,
            outgrow: false,
            are_splats_plain: true,
            accepted_px: 1.0,
            has_kernels: true,
            has_point_size: false,
            parts: 1,
        }
    }

    #[test]
    fn spacing_follows_distance_and_size_of_the_frame() {
        // Focal length in pixels: the height.
        let one = [patch(DVec3::ZERO, 0.01)];
        let px = |distance, height| spacing_px(&one, &view(distance, height)).unwrap();
        assert!((px(10.0, 1000) - 1.0).abs() < 1e-6);
        assert!((px(20.0, 1000) - 0.5).abs() < 1e-6);
        assert!((px(10.0, 500) - 0.5).abs() < 1e-6);
        assert_eq!(spacing_px(&one, &view(-10.0, 1000)).map(|px| px > 0.0), Some(true));
        assert_eq!(spacing_px(&[patch(DVec3::Z * 30.0, 0.01)], &view(10.0, 1000)), None, "behind");
        assert_eq!(spacing_px(&[patch(DVec3::X * 30.0, 0.01)], &view(10.0, 1000)), None, "aside");
        assert_eq!(spacing_px(&[], &view(10.0, 1000)), None);
    }

    #[test]
    fn nine_tenths_of_what_is_covered_decide_and_strays_have_no_say() {
        let far = (0..10).map(|i| patch(DVec3::new(f64::from(i), 0.0, -390.0), 0.01));
        let near = patch(DVec3::new(0.0, -1.0, 5.0), 0.01);
        let view = view(10.0, 1000);
        let both: Vec<Patch> = far.chain([near]).collect();
        assert!(spacing_px(&both, &view).unwrap() > 1.0, "what is near covers most");
        let ground = (0..10).map(|i| patch(DVec3::new(f64::from(i) - 5.0, 0.0, 0.0), 0.004));
        let uneven = ground.clone().chain([patch(DVec3::Y, 0.009)]);
        let px = spacing_px(&uneven.collect::<Vec<_>>(), &view).unwrap();
        assert!(
            px > DENSE_PX,
            "an eleventh of the samples leaves holes in a third of the picture: {px}"
        );
        let stray = Patch { centre: DVec3::ZERO, radius: 5.0, spacing: 1.0, count: 5.0 };
        let px = spacing_px(&ground.chain([stray]).collect::<Vec<_>>(), &view).unwrap();
        assert!((px - 0.4).abs() < 1e-3, "{px}");
    }

    #[test]
    fn the_share_that_samples_cover_follows_from_their_spacing() {
        let view = view(10.0, 1000);
        // A thousand samples, 1 and 20 pixels apart.
        let share = |spacing| covered_share(&[patch(DVec3::ZERO, spacing)], &view);
        assert!((share(0.01) - 1000.0 / 1_333_000.0).abs() < 1e-5, "{}", share(0.01));
        assert!((share(0.2) - 400_000.0 / 1_333_000.0).abs() < 1e-3, "{}", share(0.2));
        assert_eq!(share(2.0), 1.0);
        assert_eq!(covered_share(&[], &view), 0.0);
    }

    #[test]
    fn what_holds_the_eye_is_in_view() {
        let around = Patch { centre: DVec3::Z * 10.2, radius: 4.0, spacing: 0.01, count: 1e5 };
        assert!(spacing_px(&[around], &view(10.0, 1000)).unwrap() > DENSE_PX);
    }

    #[test]
    fn samples_denser_than_pixels_are_points() {
        let drawn = |grounds: &Grounds| (choose(grounds).reconstruct, choose(grounds).reason);
        assert_eq!(drawn(&grounds(Some(0.5))), (Reconstruct::Points, Reason::Dense));
        assert_eq!(drawn(&grounds(Some(0.9))), (Reconstruct::Splats, Reason::Sparse));
        assert_eq!(drawn(&grounds(None)), (Reconstruct::Points, Reason::NothingInView));
        let bare = Grounds { has_samples: false, ..grounds(None) };
        assert_eq!(drawn(&bare), (Reconstruct::Points, Reason::NoSamples));
        let early = Grounds { has_kernels: false, ..grounds(Some(9.0)) };
        assert_eq!(drawn(&early), (Reconstruct::Points, Reason::NoKernels));
        // The parts of pixels are to be closed.
        assert_eq!(
            choose(&Grounds { parts: 2, ..grounds(Some(0.4)) }).reconstruct,
            Reconstruct::Splats
        );
        assert_eq!(choose(&grounds(Some(0.4))).reconstruct, Reconstruct::Points);
        let sized = Grounds { has_point_size: true, ..grounds(Some(9.0)) };
        assert_eq!(drawn(&sized), (Reconstruct::Points, Reason::PointSize));
        let coarse = Grounds { lod: Lod::Spt, accepted_px: 4.0, ..grounds(Some(0.1)) };
        let reason = Reason::Coarse { accepted_px: 4.0 };
        assert_eq!(drawn(&coarse), (Reconstruct::Splats, reason));
        let of_mesh = Grounds { lod: Lod::Spt, ..grounds(None) };
        assert_eq!(drawn(&of_mesh), (Reconstruct::Points, Reason::Fine));
        let wide = grounds(Some(9.0));
        assert_eq!(drawn(&wide), (Reconstruct::PullPush, Reason::Wide));
        for other in [
            Grounds { covered: 0.2, ..wide },
            Grounds { are_splats_plain: false, ..wide },
            Grounds { outgrow: true, ..wide },
            Grounds { spacing_px: Some(7.9), ..wide },
        ] {
            assert_eq!(drawn(&other), (Reconstruct::Splats, Reason::Sparse), "{other:?}");
        }
        let fine = Grounds { accepted_px: 1.0, ..coarse };
        assert_eq!(drawn(&fine), (Reconstruct::Points, Reason::Dense));
    }

    /// Images with fewer samples along a side than pull-push needs, and those between samples, are told from all others, whatever their size.
    #[test]
    fn sparse_images_outgrow_pull_push() {
        let near = |spacing: f64| [patch(DVec3::ZERO, spacing)];
        for height in [64, 1024] {
            // The image is as high as the distance.
            let view = view(2.0, height);
            let of = |patches: &[Patch]| outgrow(patches, spacing_px(patches, &view), &view);
            assert!(!of(&near(0.24)) && of(&near(0.26)), "{height}");
            assert!(of(&[patch(DVec3::X * 50.0, 0.01)]), "nothing in view");
            assert!(!of(&[]), "a scene of meshes");
        }
    }

    #[test]
    fn reasons_have_figures() {
        let because = |px| choose(&grounds(Some(px))).because();
        let coarse = Grounds { lod: Lod::Spt, accepted_px: 2.5, ..grounds(None) };
        assert_eq!(choose(&coarse).because(), "nodes of point trees may be 2.5 px wide");
        assert_eq!(because(3.21), "samples lie up to 3.2 px apart in 90 % of what they cover");
        assert_eq!(because(0.512), "samples lie up to 0.51 px apart in 90 % of what they cover");
        assert_eq!(because(0.0123), "samples lie up to 0.012 px apart in 90 % of what they cover");
        assert_eq!(because(14.4), "samples lie up to 14 px apart in 90 % of what they cover");
    }
}
