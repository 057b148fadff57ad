//! Patches of pull-push: the surface as a pixel of a level knows it. Level 0 holds the disks of single samples.

use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;

use crate::assets::{Clip, Geometry, PointCloud};
use crate::math::View;
use crate::scene::PullPush;

use super::blend::facing;
use super::footprint::Disk;
use super::prepare::{Prepared, PreparedItem};
use super::splats::{camera_from_view, clip, tangents};
use super::surface;
use super::visibility::Hit;

/// Share of the camera plane's distance that disks reach at most.
const STEEPEST: f64 = 0.8;
/// Variance in square pixels below which an ellipse tells no slope.
const THIN: f64 = 0.09;
/// Least part of its radius that a clip line leaves of a disk.
const LEAST_KEPT: f64 = 0.02;

/// A patch: the surface as a pixel of a level knows it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Patch {
    /// The sample that counts the most.
    pub source: Hit,
    /// 1 the outside, −1 the inside, 0 where normals do not tell.
    pub facing: i8,
    /// 1/z at the ellipse's centre, or z where rays are parallel.
    pub value: f64,
    /// The ellipse's centre.
    pub at_px: DVec2,
    /// Variance in square pixels; the outline is at the squared distance 1.
    pub spread: DMat2,
    /// Radius of the disks in pixels, if they faced the eye.
    pub radius_px: f64,
    /// Change of the value for each pixel; in perspective relative to the value.
    pub slope: DVec2,
    /// Linear RGB.
    pub color: [f64; 3],
    /// Unit length, or zero.
    pub normal_world: DVec3,
}

/// The rows of a level's patches. A rim of one pixel surrounds each level: rows and columns are numbered from −1. The rim of level 0 has
/// samples beside the image whose disks may reach into it.
#[derive(Clone, Debug)]
pub struct Level {
    /// Number of columns and rows without the rim.
    pub width: usize,
    pub height: usize,
    /// Row by row, with the rim.
    pub patches: Vec<Option<Patch>>,
}

impl Level {
    /// A level whose patches `patch` makes from their columns and rows.
    pub fn of(
        (width, height): (usize, usize),
        patch: impl Fn(isize, isize) -> Option<Patch> + Sync,
    ) -> Level {
        let columns = width + 2;
        let at =
            |pixel: usize| patch((pixel % columns) as isize - 1, (pixel / columns) as isize - 1);
        let patches = (0..columns * (height + 2)).into_par_iter().map(at).collect();
        Level { width, height, patches }
    }

    /// The patch in a column and row; none beyond the rim.
    pub fn at(&self, x: isize, y: isize) -> Option<Patch> {
        let (x, y) = (usize::try_from(x + 1).ok()?, usize::try_from(y + 1).ok()?);
        let is_there = x < self.width + 2 && y < self.height + 2;
        is_there.then(|| self.patches[y * (self.width + 2) + x])?
    }
}

/// The levels of an image, the finest first.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Those that pull makes, the image first.
    pub pulled: Vec<Level>,
    /// Those that push completes, from level 1 on. The image is completed where it is lit.
    pub pushed: Vec<Level>,
}

/// Facts that all steps need.
pub struct Steps<'a> {
    pub prepared: &'a Prepared<'a>,
    pub view: &'a View,
    pub settings: &'a PullPush,
}

impl Steps<'_> {
    pub fn focal_px(&self) -> f64 {
        self.view.focal_px.y
    }

    /// Level 0.
    pub fn samples(&self, hits: &[Option<Hit>]) -> Level {
        let (width, height) = (self.view.width as usize, self.view.height as usize);
        // With the rim, as in a level.
        let mut nearest: Vec<Option<(Hit, u32)>> = vec![None; (width + 2) * (height + 2)];
        for (number, item) in self.prepared.items.iter().enumerate() {
            let Geometry::Points(cloud) = item.item.geometry else { continue };
            for index in 0..cloud.positions.len() {
                let Some(((x, y), depth)) = self.pixel_of(item, cloud, index) else { continue };
                let pixel = (y + 1) as usize * (width + 2) + (x + 1) as usize;
                let hit = Hit { depth, item: number as u32, index: index as u32 };
                let key = |hit: &Hit, instance: u32| (instance, hit.index, hit.item);
                let instance = item.item.instance;
                let is_nearer = nearest[pixel].is_none_or(|(old, other)| {
                    depth < old.depth
                        || (depth == old.depth && key(&hit, instance) < key(&old, other))
                });
                // Triangles hide nothing in the rim.
                let is_inside =
                    (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
                let triangle = is_inside.then(|| hits[y as usize * width + x as usize]).flatten();
                if is_nearer && triangle.is_none_or(|triangle| depth < triangle.depth) {
                    nearest[pixel] = Some((hit, instance));
                }
            }
        }
        let disk = |nearest: &Option<(Hit, u32)>| nearest.and_then(|(hit, _)| self.disk(&hit));
        Level { width, height, patches: nearest.par_iter().map(disk).collect() }
    }

    /// The column and row of the pixel that a sample is drawn in: its own, or the nearest one of the rim if its disk may reach into the
    /// image from beside it.
    fn pixel_of(
        &self,
        item: &PreparedItem<'_>,
        cloud: &PointCloud,
        index: usize,
    ) -> Option<((isize, isize), f64)> {
        let view = self.view;
        let position = item.to_view(*cloud.positions.get(index)?)?;
        let depth = -position.z;
        let centre = view.project(position)?;
        if depth <= 0.0 || !self.prepared.shows(view, position) {
            return None;
        }
        let size = DVec2::new(f64::from(view.width), f64::from(view.height));
        let axes = self.axes(item, cloud, index, position);
        let longest = axes[0].length().max(axes[1].length());
        let reach = view.focal_px
            * (f64::from(self.settings.splats.cutoff) * longest / view.divisor(depth));
        let inside = centre.cmpge(DVec2::ZERO).all() && centre.cmplt(size).all();
        let near = (centre + reach).cmpgt(DVec2::ZERO).all() && (centre - reach).cmplt(size).all();
        (inside || near).then(|| {
            let pixel = centre.floor().clamp(DVec2::NEG_ONE, size);
            ((pixel.x as isize, pixel.y as isize), depth)
        })
    }

    /// A disk's axes in camera space, one standard deviation long.
    fn axes(
        &self,
        item: &PreparedItem<'_>,
        cloud: &PointCloud,
        index: usize,
        position: DVec3,
    ) -> [DVec3; 2] {
        let way = camera_from_view(self.view.towards(position));
        let width = f64::from(self.settings.splats.width);
        tangents(item, cloud, index, way).map(|axis| axis * width)
    }

    /// The patch of a sample's disk.
    fn disk(&self, hit: &Hit) -> Option<Patch> {
        let view = self.view;
        let item = &self.prepared.items[hit.item as usize];
        let Geometry::Points(cloud) = item.item.geometry else { return None };
        let index = hit.index as usize;
        let position = item.to_view(*cloud.positions.get(index)?)?;
        let cutoff = f64::from(self.settings.splats.cutoff);
        let whole = self.axes(item, cloud, index, position);
        let (centre, axes) =
            kept_part(&clip(cloud, index), f64::from(self.settings.splats.width), cutoff, whole);
        let centre = camera_from_view(position) + centre;
        let radius = cutoff * axes[0].length().max(axes[1].length());
        let radius_px = radius * self.focal_px() / view.divisor(centre.z) + 0.5;
        let mut disk = Disk::new(centre, axes, view);
        let slopes = match view.is_orthographic() {
            true => DVec2::new(axes[0].z, axes[1].z),
            false => {
                let steep = cutoff * disk.tangents[0].z.hypot(disk.tangents[1].z);
                let shrunk = (STEEPEST / steep.max(1e-20)).min(1.0);
                disk.tangents = disk.tangents.map(|tangent| tangent * shrunk);
                DVec2::new(disk.tangents[0].z, disk.tangents[1].z)
            }
        };
        let outline = disk.perspective_by_dual(cutoff);
        let jacobian = disk.jacobian();
        let thin = DMat2::from_diagonal(DVec2::splat(THIN / (cutoff * cutoff)));
        let sign = if view.is_orthographic() { 1.0 } else { -1.0 };
        let slope = (jacobian * jacobian.transpose() + thin).inverse() * (jacobian * slopes * sign);
        let shift = outline.centre_px - disk.centre_px;
        let (value, slope) = if view.is_orthographic() {
            (centre.z, slope)
        } else {
            let change = (1.0 + slope.dot(shift)).clamp(0.1, 10.0);
            (change / centre.z, slope / change)
        };
        let surface = surface::at(self.prepared, view, hit, 0, 0);
        Some(Patch {
            source: *hit,
            facing: facing(item, cloud, index, view),
            value,
            at_px: outline.centre_px,
            spread: outline.variance() * (cutoff * cutoff),
            radius_px,
            slope,
            color: surface.albedo,
            normal_world: surface.normal_world,
        })
    }
}

/// The largest ellipses within the sides that clip lines keep of a disk: the centre relative to the disk's, and the axes.
fn kept_part(clip: &Clip, width: f64, cutoff: f64, axes: [DVec3; 2]) -> (DVec3, [DVec3; 2]) {
    let mut centre = DVec2::ZERO;
    let mut part = DMat2::IDENTITY;
    let lines: Vec<_> = clip.lines.iter().flatten().collect();
    if !(clip.either && lines.len() == 2) {
        for line in lines {
            let normal = line.normal.as_dvec2();
            let across = part.transpose() * normal;
            let size = across.length().max(1e-6);
            let n = across / size;
            let offset = (f64::from(line.offset) / width - normal.dot(centre)) / size;
            let begin = offset.clamp(-cutoff, cutoff * (1.0 - 2.0 * LEAST_KEPT));
            centre += part * n * (0.5 * (begin + cutoff));
            let shrunk = (cutoff - begin) / (2.0 * cutoff) - 1.0;
            part += part * DMat2::from_cols(n * n.x, n * n.y) * shrunk;
        }
    }
    let place = |at: DVec2| axes[0] * at.x + axes[1] * at.y;
    (place(centre), [place(part.x_axis), place(part.y_axis)])
}

#[cfg(test)]
mod tests {
    use super::super::tests::{item, scene};
    use super::super::tests_splats::{cloud, view};
    use super::*;
    use crate::scene::random::SplitMix64;
    use crate::scene::{PullPushWeights, Splats};

    /// Level 0 of disks seen by a view.
    fn level_0(geometry: &Geometry, view: &View) -> Level {
        let scene = scene(vec![item(geometry)]);
        let prepared = Prepared::new(&scene, view);
        let settings = PullPush { splats: Splats::default(), weights: PullPushWeights::default() };
        let hits = vec![None; (view.width * view.height) as usize];
        Steps { prepared: &prepared, view, settings: &settings }.samples(&hits)
    }

    /// The image keeps the samples that it has within a larger one.
    #[test]
    fn samples_beside_the_image_take_no_pixel_of_it() {
        let (view, beside) = (view(), 20);
        let mut random = SplitMix64::new(7);
        // Their radius is 8 pixels.
        let disks: Vec<[DVec3; 3]> = (0..1500)
            .map(|_| {
                let depth = random.range(1.0, 2.0);
                let pixel = DVec2::new(random.range(-20.0, 84.0), random.range(-20.0, 68.0));
                let [u, v] = [DVec3::X, DVec3::Y].map(|axis| axis * (0.04 * depth));
                [view.ray(pixel) * depth, u, v]
            })
            .collect();
        let geometry = Geometry::Points(cloud(&disks));
        let part = level_0(&geometry, &view);
        let larger = View {
            width: view.width + 2 * beside,
            height: view.height + 2 * beside,
            principal_px: view.principal_px + f64::from(beside),
            ..view
        };
        let whole = level_0(&geometry, &larger);
        let source = |patch: Option<Patch>| patch.map(|patch| patch.source);
        let mut shown = 0;
        for (x, y) in (0..48).flat_map(|y| (0..64).map(move |x| (x, y))) {
            let own = source(part.at(x, y));
            assert_eq!(own, source(whole.at(x + 20, y + 20)), "{x}, {y}");
            shown += usize::from(own.is_some());
        }
        // Most pixels of the rim have a sample whose disk reaches into the image.
        let rim = part.patches.iter().flatten().count() - shown;
        assert!(shown > 300 && rim > 100, "{shown} {rim}");
    }
}
