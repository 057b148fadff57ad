//! Samples as splats: elliptical disks in space, seen in perspective (Zwicker et al. 2004).
//!
//! [`SeenSplat::new`] takes a sample's kernel to camera space, where x points right, y down and z forward, and settles once
//! how it is drawn:
//!
//! - wholly before the camera plane, it is *regular* and drawn by the filter that was asked for. The exact one with a
//!   low-pass filter (object-space EWA: Ren, Pfister and Zwicker, *Object Space EWA Surface Splatting*, 2002) gives way
//!   to the perspective one where the kernel is thinner than the low-pass filter;
//! - where it meets the camera plane, only its exact intersection with each ray makes sense, without any filter;
//! - wholly behind, it is not drawn.
//!
//! [`SeenSplat::at`] then says with which depth and weight it covers a pixel, and whether it is seen there: where its disk is as it is, without
//! what the filter adds, and at the pixel that its centre is in. A pixel's ray `r` meets the disk's
//! plane where `λ r = p + s·t_u + t·t_v`. Divided by the depth λ, these are three linear equations for `s/λ`, `t/λ` and `1/λ`
//! (the paper's `u = x M⁻¹`), whose solution stays finite on the plane's horizon and beyond, where a low-pass filter
//! still has weight. Whatever is not a number covers nothing.

use glam::{DMat2, DVec2, DVec3};

use crate::assets::{Clip, ClipLine, PointCloud};
use crate::math::View;
use crate::scene::{Blend, Filter, PAINT_WIDTH_PERCENT, Splats};

use super::footprint::{Disk, Gaussian, solve};
use super::prepare::PreparedItem;

/// Splats that the low-pass filter spreads thin keep this much of their weight.
const LEAST_AMPLITUDE: f64 = 1.0 / 8.0;

/// Upper bound of a depth's inverse where the plane may come as close as the eye.
const MOST_INVERSE_DEPTH: f64 = 1e30;

/// Within this share of its depth of the camera plane, a disk's box is not found from its projection.
const BOX_MARGIN: f64 = 0.01;

/// How a frame, or its finer version for supersampling, draws splats.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    pub splats: Splats,
    cutoff: f64,
    width: f64,
    /// Zero without a low-pass filter.
    lowpass_px: f64,
    least_amplitude: f64,
}

impl Settings {
    /// `fineness` sub-pixels a pixel each way: the low-pass filter keeps its size in pixels.
    pub fn new(splats: &Splats, fineness: u32) -> Self {
        let lowpass_px = f64::from(splats.lowpass_px) * f64::from(fineness);
        Self {
            splats: *splats,
            cutoff: f64::from(splats.cutoff),
            width: f64::from(splats.width),
            lowpass_px: if splats.prefilter { lowpass_px } else { 0.0 },
            least_amplitude: LEAST_AMPLITUDE,
        }
    }

    /// The settings for splats that cover their own shares of pixels, however small.
    #[must_use]
    pub fn painted(self) -> Self {
        Self { least_amplitude: 0.0, ..self }
    }
}

/// A splat's values at a pixel that it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    pub depth: f64,
    /// Its Gaussian's value.
    pub weight: f64,
    /// Its disk itself covers the pixel, or has its centre there.
    pub is_seen: bool,
    /// The filtered kernel itself covers the pixel.
    pub is_within: bool,
}

/// A splat in one view.
#[derive(Clone, Debug)]
pub struct SeenSplat {
    centre: DVec3,
    /// Bounds for a regular splat.
    centre_px: Option<DVec2>,
    tangents: [DVec3; 2],
    /// The plane does not hold the eye, or nearly so.
    has_plane: bool,
    shape: Shape,
    amplitude: f64,
    lowpass_px: f64,
    squared_cutoff: f64,
    depths: Depths,
    /// How far behind its depth at a pixel others still count as the same surface.
    pub offset: f64,
    clip: Clip,
    width: f64,
    /// Pixels `[x0, x1) × [y0, y1)` that hold every covered one.
    pub pixel_box: [usize; 4],
}

/// How depths follow from the disk's plane.
#[derive(Clone, Copy, Debug)]
enum Depths {
    /// Inverse depths are linear in the pixel, within bounds.
    Inverse([f64; 2]),
    /// Inverse depths without bounds, of a disk that meets the camera plane.
    Crossing,
    /// Rays are parallel: depths are linear in the pixel, within bounds.
    Parallel([f64; 2]),
}

/// How the squared distance of a pixel from the kernel's centre is measured.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// In the kernel's coordinates where the ray meets it.
    Disk,
    /// There too, against the kernel widened by the low-pass filter, which the affine map takes to the image.
    WidenedDisk { affine: Gaussian, jacobian: DMat2 },
    /// In the image.
    Image(Gaussian),
}

impl SeenSplat {
    /// The sample as `view` sees it; `None` where no pixel can show it.
    pub fn new(
        view: &View,
        settings: &Settings,
        item: &PreparedItem<'_>,
        cloud: &PointCloud,
        index: usize,
    ) -> Option<Self> {
        let centre = camera_from_view(item.to_view(*cloud.positions.get(index)?)?);
        let tangents =
            tangents(item, cloud, index, camera_from_view(view.towards(camera_from_view(centre))))
                .map(|t| t * settings.width);
        let [u, v] = tangents;
        if !(u.is_finite() && v.is_finite()) {
            return None;
        }
        let cutoff = settings.cutoff;
        let reach = cutoff * u.z.hypot(v.z);
        // Parallel rays meet every disk alike; each pixel asks whether that is before the eye.
        let is_parallel = view.is_orthographic();
        let meets_plane = centre.z * centre.z <= reach * reach;
        if !meets_plane && centre.z <= 0.0 {
            return None;
        }
        let crossing = meets_plane && !is_parallel;
        let lowpass_px = if crossing { 0.0 } else { settings.lowpass_px };
        let lowpass = cutoff * lowpass_px * view.divisor(centre.z) / view.focal_px.y;
        let disk = Disk::new(centre, tangents, view);
        let (shape, amplitude) =
            if crossing { (Shape::Disk, 1.0) } else { shape(settings, &disk, lowpass_px) };
        // Beyond a disk's own radius, the margin that the filter adds lies no longer in the disk's plane.
        let beyond = reach + lowpass.min(cutoff * u.length().max(v.length()));
        let (far, near) = (centre.z + beyond, centre.z - beyond);
        let depths = match (is_parallel, crossing) {
            (true, _) => Depths::Parallel([near, far]),
            (false, true) => Depths::Crossing,
            (false, false) => {
                let most = if near > 0.0 { 1.0 / near } else { MOST_INVERSE_DEPTH };
                Depths::Inverse([1.0 / far, most])
            }
        };
        let depth_offset = match settings.splats.blend {
            // However many passes it takes, this is what they are after.
            Blend::Weighted => f64::from(settings.splats.depth_offset),
            Blend::Opaque => 0.0,
        };
        let seen = Self {
            centre,
            centre_px: (!crossing).then_some(disk.centre_px),
            tangents,
            has_plane: is_parallel || has_plane(centre, tangents),
            shape,
            amplitude,
            lowpass_px,
            squared_cutoff: cutoff * cutoff,
            depths,
            offset: depth_offset * (cutoff * u.length().max(v.length()) + lowpass),
            clip: clip(cloud, index),
            width: settings.width,
            pixel_box: pixel_box(view, &disk, (centre, tangents), &shape, (cutoff, lowpass_px)),
        };
        let [x0, x1, y0, y1] = seen.pixel_box;
        (x0 < x1 && y0 < y1 && seen.offset.is_finite()).then_some(seen)
    }

    /// What a painted splat covers of a pixel: a Gaussian of [`PAINT_WIDTH_PERCENT`] of the width, less its value at the kernel's end. Splats
    /// smaller than a pixel cover no more of it for their greater width.
    pub fn cover(&self, touch: &Touch) -> f64 {
        let narrow = (100.0 / f64::from(PAINT_WIDTH_PERCENT)).powi(2);
        let least = (-0.5 * self.squared_cutoff * narrow).exp();
        let own = (touch.weight / self.amplitude).powf(narrow);
        let amplitude = self.amplitude * (narrow + (1.0 - narrow) * self.amplitude);
        let cover = amplitude * (own - least) / (1.0 - least);
        // Not a number where nothing is left of the amplitude.
        cover.clamp(0.0, 1.0).max(0.0)
    }

    /// Its weight among the splats of a surface: the Gaussian less its value at the end of the kernel that is not widened. However small, a
    /// weight counts where there is no other.
    pub fn painted_weight(&self, touch: &Touch) -> f64 {
        let narrow = (100.0 / f64::from(PAINT_WIDTH_PERCENT)).powi(2);
        let least = self.amplitude * (-0.5 * self.squared_cutoff * narrow).exp();
        (touch.weight - least).max(1e-12)
    }

    /// Distance of the centre from the eye, or its depth where rays are parallel.
    pub fn distance(&self, is_parallel: bool) -> f64 {
        if is_parallel { self.centre.z.abs() } else { self.centre.length() }
    }

    /// Returns the splat's values at an image position, whose `ray` is in view space; `None` where it does not cover it.
    pub fn at(&self, pixel: DVec2, ray: DVec3) -> Option<Touch> {
        let plane = self.plane_coordinates(camera_from_view(ray));
        // Kernel coordinates before the eye.
        let hit = || plane.filter(|at| at.z > 0.0).map(|at| at.truncate() / at.z);
        let in_plane = || hit().map_or(f64::INFINITY, DVec2::length_squared);
        // With the filter, and without.
        let (squared, own) = match &self.shape {
            Shape::Disk => (in_plane(), in_plane()),
            Shape::WidenedDisk { affine, jacobian } => {
                let widened = |at| affine.squared_distance(*jacobian * at, self.lowpass_px);
                (hit().map_or(f64::INFINITY, widened), in_plane())
            }
            Shape::Image(gaussian) => {
                let away = pixel - gaussian.centre_px;
                (
                    gaussian.squared_distance(away, self.lowpass_px),
                    gaussian.squared_distance(away, 0.0),
                )
            }
        };
        let holds_centre = self.centre_px.is_some_and(|at| at.floor() == pixel.floor());
        let is_seen = own <= self.squared_cutoff || holds_centre;
        let covered = (squared <= self.squared_cutoff || holds_centre) && self.keeps(plane);
        let depth = self.depth(plane);
        // Not a number, a distance counts as any that is covered.
        let weight = self.amplitude * (-0.5 * squared.min(self.squared_cutoff)).exp();
        let sound = depth > 0.0 && depth.is_finite() && weight.is_finite();
        let is_within = squared <= self.squared_cutoff;
        (covered && sound).then_some(Touch { depth, weight, is_seen, is_within })
    }

    /// `(s/λ, t/λ, 1/λ)` where the ray meets the disk's plane, with λ = 1 for parallel rays; `None` for a plane that rays lie in.
    fn plane_coordinates(&self, ray: DVec3) -> Option<DVec3> {
        let vectors = [self.tangents[0], self.tangents[1], self.centre];
        match self.depths {
            Depths::Parallel(_) => {
                let [u, v, centre] = vectors;
                let flat = |vector: DVec3, w: f64| vector.truncate().extend(w);
                solve([flat(u, 0.0), flat(v, 0.0), flat(centre, 1.0)], ray)
            }
            _ if self.has_plane => solve(vectors, ray),
            _ => None,
        }
    }

    fn depth(&self, plane: Option<DVec3>) -> f64 {
        let inverse = plane.map_or(1.0 / self.centre.z, |at| at.z);
        match self.depths {
            // Not `clamp`, which panics on bounds that are not numbers.
            Depths::Inverse([least, most]) => 1.0 / inverse.max(least).min(most),
            Depths::Crossing => 1.0 / inverse,
            Depths::Parallel([near, far]) => {
                let [u, v] = self.tangents;
                let slope = plane.map_or(0.0, |at| at.x * u.z + at.y * v.z);
                (self.centre.z + slope).max(near).min(far)
            }
        }
    }

    /// Whether the clip lines keep a place. A plane through the eye has no sides, and all of it is kept.
    fn keeps(&self, plane: Option<DVec3>) -> bool {
        let Some(at) = plane else { return true };
        // Multiplied by 1/λ, which is positive at the centre: beyond the horizon each side goes on as it was.
        let side = |line: &ClipLine| {
            let offset = f64::from(line.offset) / self.width;
            line.normal.as_dvec2().dot(at.truncate()) - offset * at.z >= 0.0
        };
        match &self.clip.lines {
            [Some(first), Some(second)] if self.clip.either => side(first) || side(second),
            lines => lines.iter().flatten().all(side),
        }
    }
}

/// View space (y up, looking along −z) → camera space (y down, looking along z), or back.
pub fn camera_from_view(view: DVec3) -> DVec3 {
    DVec3::new(view.x, -view.y, -view.z)
}

/// Whether the plane misses the eye by more than rounding can tell.
fn has_plane(centre: DVec3, [u, v]: [DVec3; 2]) -> bool {
    let distance = centre.dot(u.cross(v)).abs();
    distance > 8.0 * f64::EPSILON * u.length() * v.length() * centre.length()
}

/// The sample's unit normal, where one is known.
pub(super) fn normal(cloud: &PointCloud, index: usize) -> Option<DVec3> {
    cloud.normals.as_ref()?.get(index)?.as_dvec3().try_normalize()
}

/// The part of the kernel that is kept. One that turns with the eye has no axes for lines to refer to.
pub(super) fn clip(cloud: &PointCloud, index: usize) -> Clip {
    let clip = cloud.clips.as_ref().and_then(|clips| clips.get(index));
    normal(cloud, index).and(clip).copied().unwrap_or(Clip::NONE)
}

/// The kernel's axes in camera space, before the scene's width.
pub(super) fn tangents(
    item: &PreparedItem<'_>,
    cloud: &PointCloud,
    index: usize,
    towards: DVec3,
) -> [DVec3; 2] {
    let normal = normal(cloud, index);
    let kernel = match (&cloud.kernels, &cloud.radii) {
        (Some(kernels), _) => kernels.get(index).map(|k| [k.u.as_dvec3(), k.v.as_dvec3()]),
        (None, Some(radii)) => radii.get(index).map(|&radius| {
            let (u, v) = normal.unwrap_or(DVec3::Z).any_orthonormal_pair();
            [u * f64::from(radius), v * f64::from(radius)]
        }),
        (None, None) => None,
    };
    let kernel = kernel.filter(|axes| axes.iter().all(|axis| axis.is_finite()));
    let Some([u, v]) = kernel else { return [DVec3::ZERO; 2] };
    if normal.is_some() {
        return [u, v].map(|axis| camera_from_view(item.to_view_direction(axis)));
    }
    // Nobody knows which way it lies: it faces the eye, as a circle that holds the ellipse.
    let radius = u.length().max(v.length()) * item.greatest_stretch();
    let Some(towards) = towards.try_normalize() else { return [DVec3::ZERO; 2] };
    let (u, v) = towards.any_orthonormal_pair();
    [u * radius, v * radius]
}

/// The shape that draws a regular splat, and the height of its Gaussian.
fn shape(settings: &Settings, disk: &Disk, lowpass_px: f64) -> (Shape, f64) {
    let (least, cutoff) = (settings.least_amplitude, settings.cutoff);
    let affine = disk.affine();
    let amplitude = |gaussian: &Gaussian| match gaussian.amplitude(lowpass_px) {
        _ if lowpass_px == 0.0 => 1.0,
        thin if thin < least => least,
        // NaN stays NaN, and covers nothing.
        amplitude => amplitude,
    };
    let image = |gaussian: Gaussian| (Shape::Image(gaussian), amplitude(&gaussian));
    match settings.splats.filter {
        Filter::Affine => image(affine),
        Filter::Perspective => image(disk.perspective(cutoff)),
        Filter::Exact if lowpass_px == 0.0 => (Shape::Disk, 1.0),
        Filter::Exact => {
            let [along, across] = affine.lowpass_share(lowpass_px);
            if along + across > 1.0 {
                return image(disk.perspective(cutoff));
            }
            (Shape::WidenedDisk { affine, jacobian: disk.jacobian() }, amplitude(&affine))
        }
    }
}

/// Pixels `[x0, x1) × [y0, y1)` that hold every covered one, and at least one more on every side.
fn pixel_box(
    view: &View,
    disk: &Disk,
    seen: (DVec3, [DVec3; 2]),
    shape: &Shape,
    (cutoff, lowpass_px): (f64, f64),
) -> [usize; 4] {
    let radius = match shape {
        Shape::Image(gaussian) => {
            let half = gaussian.half_extent_px(cutoff, lowpass_px);
            return clamped_box(view, gaussian.centre_px - half, gaussian.centre_px + half);
        }
        Shape::Disk => cutoff,
        // The widened kernel ends within the circle of its own longest axis.
        Shape::WidenedDisk { affine, .. } => {
            cutoff * (1.0 + affine.lowpass_share(lowpass_px)[1]).sqrt()
        }
    };
    let is_before = seen.0.z > 0.0 || view.is_orthographic();
    if is_before && disk.is_before_camera_plane(radius, BOX_MARGIN) {
        let outline = disk.perspective_by_dual(radius);
        let half = outline.half_extent_px(radius, 0.0);
        return clamped_box(view, outline.centre_px - half, outline.centre_px + half);
    }
    swept_box(view, seen, radius)
}

/// Where neither side of a row or column of pixels is out of a disk's reach: for disks that come near the camera plane
/// or lie on both sides of it.
fn swept_box(view: &View, (centre, [u, v]): (DVec3, [DVec3; 2]), radius: f64) -> [usize; 4] {
    // No point of the disk is on the side of a plane through the eye to which `normal` points.
    let is_empty =
        |normal: DVec3| normal.dot(centre) + radius * normal.dot(u).hypot(normal.dot(v)) < 0.0;
    let sweep = |size: u32, axis: usize| {
        let (mut low, mut high) = (0.0f64, f64::from(size));
        for edge in 0..=size {
            let mut normal = DVec3::ZERO;
            normal[axis] = 1.0;
            normal.z = -(f64::from(edge) - view.principal_px[axis]) / view.focal_px[axis];
            if is_empty(-normal) {
                low = low.max(f64::from(edge));
            }
            if is_empty(normal) {
                high = high.min(f64::from(edge));
            }
        }
        (low, high)
    };
    let ((x0, x1), (y0, y1)) = (sweep(view.width, 0), sweep(view.height, 1));
    clamped_box(view, DVec2::new(x0, y0), DVec2::new(x1, y1))
}

fn clamped_box(view: &View, low: DVec2, high: DVec2) -> [usize; 4] {
    let range = |low: f64, high: f64, size: u32| {
        let size = f64::from(size);
        // NaN, after an overflow, spans the frame.
        let low = if low > 1.0 { (low - 1.0).min(size) } else { 0.0 };
        let high = if high < size - 1.0 { (high + 1.0).max(0.0) } else { size };
        (low.floor() as usize, high.ceil() as usize)
    };
    let ((x0, x1), (y0, y1)) =
        (range(low.x, high.x, view.width), range(low.y, high.y, view.height));
    [x0, x1, y0, y1]
}
