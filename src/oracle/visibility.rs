//! Which sample or triangle each pixel shows.

use std::cmp::Ordering;
use std::ops::Range;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::assets::{Geometry, Mesh, PointCloud};
use crate::math::{Projection, View};

use super::predicates::{edge_sign, volume_sign};
use super::prepare::{Prepared, PreparedItem};
use super::{blend, lines, splats, surface};

/// The element that covers a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hit {
    /// Distance along the viewing axis, positive.
    pub depth: f64,
    /// Number of the item in the scene.
    pub item: u32,
    /// Number of the sample or triangle in its geometry, or of the first vertex of the line's segment.
    pub index: u32,
}

/// A triangle in view space, seen from the eye at the origin or along −z.
#[derive(Clone, Copy, Debug)]
pub struct SeenTriangle {
    pub corners: [DVec3; 3],
    /// The corners' images in homogeneous coordinates: the corners themselves, or at z = −1 where rays are parallel.
    image: [DVec3; 3],
    /// The sign of the corners' volume: −1 when they run counter-clockwise for the viewer, 1 clockwise.
    facing: i8,
}

impl SeenTriangle {
    /// `None` for triangles seen edge-on, which cover nothing.
    pub fn new(corners: [DVec3; 3], projection: Projection) -> Option<Self> {
        let image = match projection {
            Projection::Perspective => corners,
            Projection::Orthographic => corners.map(|corner| DVec3 { z: -1.0, ..corner }),
        };
        let facing = volume_sign(image[0], image[1], image[2]);
        (facing != 0).then_some(Self { corners, image, facing })
    }

    /// Whether its corners run counter-clockwise for the viewer.
    pub fn is_counter_clockwise(&self) -> bool {
        self.facing < 0
    }

    /// Whether `ray` meets the triangle in front of the eye. Of triangles that share an edge, one has its points.
    pub fn covers(&self, ray: DVec3) -> bool {
        let [a, b, c] = self.image;
        // A positive combination of the corners along the ray has these three volumes of the sign of the triangle's own; a
        // combination along the opposite ray has them of the other sign.
        edge_sign(ray, a, b) == self.facing
            && edge_sign(ray, b, c) == self.facing
            && edge_sign(ray, c, a) == self.facing
    }

    /// The planes that hold each corner's opposite edge and the rays through it: `ray · plane` is the corner's weight, unnormalised.
    pub fn weight_planes(&self) -> [DVec3; 3] {
        let [a, b, c] = self.image;
        let sign = f64::from(self.facing);
        // b × c = b × (c − b), with less cancellation for a small triangle far away.
        [b.cross(c - b) * sign, c.cross(a - c) * sign, a.cross(b - a) * sign]
    }

    /// The barycentric weights where a covering `ray` meets the plane: perspective-correct, never negative, sum 1.
    pub fn weights(&self, ray: DVec3) -> [f64; 3] {
        let weights = self.weight_planes().map(|plane| ray.dot(plane).max(0.0));
        let sum: f64 = weights.iter().sum();
        if sum > 0.0 { weights.map(|weight| weight / sum) } else { [1.0 / 3.0; 3] }
    }

    /// Depth where a covering `ray` meets the triangle.
    pub fn depth(&self, ray: DVec3) -> f64 {
        let weights = self.weights(ray);
        (0..3).map(|i| weights[i] * -self.corners[i].z).sum()
    }

    /// Pixels `[x0, x1) × [y0, y1)` that hold every covered one; `None` when it lies behind the eye.
    pub fn pixel_box(&self, view: &View) -> Option<[usize; 4]> {
        if self.corners.iter().all(|corner| corner.z >= 0.0) {
            return None;
        }
        let projected = self.corners.map(|corner| view.project(corner));
        let [Some(a), Some(b), Some(c)] = projected else {
            return Some([0, view.width as usize, 0, view.height as usize]);
        };
        Some(pixels_between(view, a.min(b).min(c), a.max(b).max(c)))
    }
}

/// Pixels `[x0, x1) × [y0, y1)` of a view that hold all centres between two places of the image.
pub fn pixels_between(view: &View, low: DVec2, high: DVec2) -> [usize; 4] {
    let (width, height) = (f64::from(view.width), f64::from(view.height));
    // One pixel more on every side than the rounded projection asks for. NaN (from an overflow) clamps to the frame.
    let (low, high) = (low - 1.0, high + 1.0);
    let range = |low: f64, high: f64, size: f64| {
        let low = if low > 0.0 { low.min(size) } else { 0.0 };
        let high = if high < size { high.max(0.0) } else { size };
        (low.floor() as usize, high.ceil() as usize)
    };
    let ((x0, x1), (y0, y1)) = (range(low.x, high.x, width), range(low.y, high.y, height));
    [x0, x1, y0, y1]
}

/// The ray through a pixel's centre in view space, with z = −1.
pub fn pixel_ray(view: &View, x: usize, y: usize) -> DVec3 {
    view.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5))
}

/// The hit of every pixel of a frame, or of its `fineness` × `fineness` sub-pixels: samples cover
/// whole pixels, triangles the fine ones. Samples that are drawn as splats give no hits. `opaque`: what is translucent gives none
/// either.
pub fn resolve(
    prepared: &Prepared<'_>,
    view: &View,
    fineness: u32,
    opaque: bool,
) -> Vec<Option<Hit>> {
    let keep = |kept: &mut Option<Hit>, hit| {
        if !(opaque && prepared.is_translucent(&hit)) {
            keep_nearer(prepared, kept, hit);
        }
    };
    let mut fine = add_points(prepared, view, fineness, keep);
    let fine_view = view.finer(fineness);
    for (number, item) in prepared.items.iter().enumerate() {
        if let Geometry::Mesh(mesh) = item.item.geometry {
            add_triangles(prepared, &fine_view, &mut fine, (number as u32, item, mesh), keep);
        }
        if let Geometry::Lines(lines) = item.item.geometry {
            lines::add(prepared, &fine_view, &mut fine, (number as u32, item, lines), keep);
        }
    }
    fine
}

/// All hits of translucent triangles, lines and samples of every pixel of a view, or of its `fineness` × `fineness` sub-pixels, the nearest
/// first. Translucent splats are not blended with each other: each is where its disk is.
pub fn layers(prepared: &Prepared<'_>, view: &View, fineness: u32) -> Vec<Vec<Hit>> {
    let keep = |kept: &mut Vec<Hit>, hit| {
        if prepared.is_translucent(&hit) {
            kept.push(hit);
        }
    };
    let mut layers = add_points(prepared, view, fineness, keep);
    let view = &view.finer(fineness);
    for (number, item) in prepared.items.iter().enumerate() {
        if let Geometry::Mesh(mesh) = item.item.geometry {
            add_triangles(prepared, view, &mut layers, (number as u32, item, mesh), keep);
        }
        if let Geometry::Lines(lines) = item.item.geometry {
            lines::add(prepared, view, &mut layers, (number as u32, item, lines), keep);
        }
    }
    if let Some(splats) = &prepared.scene.splats {
        blend::add_disks(prepared, view, &splats::Settings::new(splats, fineness), &mut layers);
    }
    let width = view.width as usize;
    layers.par_iter_mut().enumerate().for_each(|(pixel, hits)| {
        hits.sort_by(|a, b| order(prepared, a, b));
        let ray = pixel_ray(view, pixel % width, pixel / width);
        let is_seen = |&(number, hit): &(usize, &Hit)| {
            let before = |nearer: &Hit| lines::is_joint(prepared, view, nearer, hit, ray);
            !hits[..number].iter().any(before)
        };
        *hits = hits.iter().enumerate().filter(is_seen).map(|(_, hit)| *hit).collect();
    });
    layers
}

/// The order in which two hits of a pixel are seen, the nearer first.
pub fn order(prepared: &Prepared<'_>, a: &Hit, b: &Hit) -> Ordering {
    let number = |hit: &Hit| (prepared.instance(hit), hit.index, hit.item);
    a.depth.total_cmp(&b.depth).then_with(|| number(a).cmp(&number(b)))
}

/// Keeps the nearer of two hits.
pub fn keep_nearer(prepared: &Prepared<'_>, kept: &mut Option<Hit>, hit: Hit) {
    if kept.is_none_or(|old| order(prepared, &hit, &old).is_lt()) {
        *kept = Some(hit);
    }
}

/// Rows a task works on.
pub fn band_rows(height: usize) -> usize {
    height.div_ceil(4 * rayon::current_num_threads()).max(1)
}

/// Returns what the pixels of a view show of samples that are drawn as points, for each of its `fineness` × `fineness` sub-pixels.
fn add_points<Kept: Clone + Default + Send + Sync>(
    prepared: &Prepared<'_>,
    view: &View,
    fineness: u32,
    keep: impl Fn(&mut Kept, Hit) + Sync,
) -> Vec<Kept> {
    let (width, height) = (view.width as usize, view.height as usize);
    let mut coarse = vec![Kept::default(); width * height];
    for (number, item) in prepared.items.iter().enumerate() {
        if let Geometry::Points(cloud) = item.item.geometry
            && prepared.scene.splats.is_none()
            && prepared.scene.pull_push.is_none()
        {
            add_samples(prepared, view, &mut coarse, (number as u32, item, cloud), &keep);
        }
    }
    let n = fineness as usize;
    let coarse_of = |i: usize| i / (width * n) / n * width + i % (width * n) / n;
    let sub_pixels = (0..width * n * height * n).into_par_iter();
    sub_pixels.map(|i| coarse[coarse_of(i)].clone()).collect()
}

fn add_samples<Kept: Send>(
    prepared: &Prepared<'_>,
    view: &View,
    frame: &mut [Kept],
    (number, item, cloud): (u32, &PreparedItem<'_>, &PointCloud),
    keep: impl Fn(&mut Kept, Hit) + Sync,
) {
    let (width, height) = (view.width as usize, view.height as usize);
    let discs = prepared.scene.discs;
    let project = |(index, &position): (usize, _)| {
        if item.is_clear_sample(cloud, index) {
            return None;
        }
        let position_view = item.to_view(position)?;
        let centre = view.project(position_view)?;
        let depth = -position_view.z;
        let radius = discs.map(|discs| {
            let in_scene = view.focal_px * (0.5 * f64::from(discs.diameter) / view.divisor(depth));
            in_scene.max(DVec2::splat(0.5 * f64::from(discs.diameter_px)))
        });
        let hit = Hit { depth, item: number, index: index as u32 };
        // Discs are clipped pixel by pixel.
        if radius.is_none() && !prepared.shows(view, position_view) {
            return None;
        }
        Some(SeenPoint { centre, radius, hit })
    };
    let projected: Vec<SeenPoint> =
        cloud.positions.par_iter().enumerate().filter_map(project).collect();
    let rows = band_rows(height);
    frame.par_chunks_mut((width * rows).max(1)).enumerate().for_each(|(band, pixels)| {
        let (y0, y1) = (band * rows, (band * rows + rows).min(height));
        for point in &projected {
            let [columns, rows] = point.covered([0..width, y0..y1]);
            for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
                let place = || view.at_depth(pixel_ray(view, x, y), point.hit.depth);
                let is_shown = || point.radius.is_none() || prepared.shows(view, place());
                if point.covers(x, y) && is_shown() {
                    keep(&mut pixels[(y - y0) * width + x], point.hit);
                }
            }
        }
    });
}

/// A sample as a point in the image: one pixel, or a disc.
struct SeenPoint {
    centre: DVec2,
    /// Half axes of the disc, in pixels.
    radius: Option<DVec2>,
    hit: Hit,
}

impl SeenPoint {
    /// The columns and rows, within bounds, that may show the point.
    fn covered(&self, [columns, rows]: [Range<usize>; 2]) -> [Range<usize>; 2] {
        let reach = self.radius.unwrap_or_default();
        let (low, high) = ((self.centre - reach).floor(), (self.centre + reach).floor());
        // Conversions saturate.
        let cut = |bounds: Range<usize>, low: f64, high: f64| {
            let end = if high < 0.0 { 0 } else { (high as usize).saturating_add(1) };
            bounds.start.max(low as usize)..bounds.end.min(end)
        };
        [cut(columns, low.x, high.x), cut(rows, low.y, high.y)]
    }

    fn covers(&self, x: usize, y: usize) -> bool {
        let pixel = DVec2::new(x as f64, y as f64);
        let holds_centre = pixel == self.centre.floor();
        let away = pixel + 0.5 - self.centre;
        holds_centre || self.radius.is_some_and(|radius| (away / radius).length_squared() <= 1.0)
    }
}

fn add_triangles<Kept: Send>(
    prepared: &Prepared<'_>,
    view: &View,
    frame: &mut [Kept],
    (number, item, mesh): (u32, &PreparedItem<'_>, &Mesh),
    keep: impl Fn(&mut Kept, Hit) + Sync,
) {
    let seen = |index: u32| {
        let triangle = SeenTriangle::new(item.triangle_view(mesh, index)?, view.projection)?;
        let counter_clockwise = triangle.is_counter_clockwise() != item.mirrored;
        // Clip boxes open what is closed.
        let is_open = prepared.scene.clip.is_some();
        let drawn = counter_clockwise || is_open || item.double_sided(mesh, index);
        drawn.then_some((index, triangle, triangle.pixel_box(view)?))
    };
    let triangles: Vec<(u32, SeenTriangle, [usize; 4])> =
        (0..mesh.triangles.len() as u32).into_par_iter().filter_map(seen).collect();
    let width = view.width as usize;
    let rows = band_rows(view.height as usize);
    frame.par_chunks_mut((width * rows).max(1)).enumerate().for_each(|(band, pixels)| {
        let (y_begin, y_end) = (band * rows, band * rows + pixels.len() / width);
        for (index, triangle, [x0, x1, y0, y1]) in &triangles {
            for y in (*y0).max(y_begin)..(*y1).min(y_end) {
                for x in *x0..*x1 {
                    let ray = pixel_ray(view, x, y);
                    if !triangle.covers(ray) {
                        continue;
                    }
                    let hit = Hit { depth: triangle.depth(ray), item: number, index: *index };
                    // Depth 0 means that the eye touches the triangle.
                    if hit.depth > 0.0
                        && prepared.shows(view, view.at_depth(ray, hit.depth))
                        && !surface::is_cut_out(prepared, view, &hit, x, y)
                    {
                        keep(&mut pixels[(y - y_begin) * width + x], hit);
                    }
                }
            }
        }
    });
}
