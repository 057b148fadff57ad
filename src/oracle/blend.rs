//! Splats where they overlap (Zwicker et al. 2004, §6, in its three steps).
//!
//! 1. *Visibility.* Each splat that is seen at a pixel reaches a depth that lies its offset behind its own there. The least of these,
//!    and of the depth of the triangle that the pixel would show otherwise, wins; ties go to the lower instance, then to the
//!    lower index. A pixel that a triangle wins shows no splats.
//! 2. *Sums.* All covering splats up to the depth that the winner reaches are one surface: their colours, normals and
//!    depths are added up by weight.
//! 3. *Normalisation*, and light: once for the pixel with the means, or before the sums for each splat.
//!
//! In the opaque mode no splat reaches behind itself, and the winner alone is seen.
//!
//! Bands of rows are worked on at once. Within one, splats come in the scene's order, so that sums are the same on
//! any number of threads.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::assets::{Geometry, PointCloud};
use crate::math::View;
use crate::scene::{Blend, Shading};

use super::fog;
use super::prepare::{Prepared, PreparedItem};
use super::shade::shade;
use super::splats::{SeenSplat, Settings, Touch};
use super::surface::{self, Surface};
use super::visibility::{Hit, band_rows, pixel_ray};

/// The blended splats of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blended {
    /// Linear RGB, lit.
    pub color: [f64; 3],
    /// Unit length, turned towards the eye; zero where no splat has a normal.
    pub normal_world: DVec3,
    pub depth: f64,
    pub instance: u32,
}

/// A splat with what it brings to a pixel.
pub(super) struct Splat {
    pub(super) seen: SeenSplat,
    /// At its own centre.
    surface: Surface,
    /// The blended colour: albedo, or the lit colour.
    pub(super) color: [f64; 3],
    instance: u32,
    pub(super) rank: Rank,
    /// Which side is seen: 1 the outside, −1 the inside, 0 where normals do not tell.
    pub(super) facing: i8,
}

/// Which of two wins at the same depth: instance, index, item.
pub(super) type Rank = (u32, u32, u32);

/// The nearest so far.
#[derive(Clone, Copy)]
struct Winner<'a> {
    /// Its depth, and a splat's offset behind it.
    reach: f64,
    rank: Rank,
    /// `None` for a triangle, or nothing.
    splat: Option<&'a Splat>,
}

/// Weighted sums over a pixel's splats.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    color: [f64; 3],
    normal_world: DVec3,
    depth: f64,
}

impl Sums {
    fn add(&mut self, splat: &Splat, weight: f64, depth: f64) {
        self.weight += weight;
        for (sum, channel) in self.color.iter_mut().zip(splat.color) {
            *sum += weight * channel;
        }
        self.normal_world += weight * splat.surface.normal_world;
        self.depth += weight * depth;
    }
}

/// The pixels of `view` that show splats, before the `hits` of triangles. `opaque`: translucent splats are left out.
pub fn splatted(
    prepared: &Prepared<'_>,
    view: &View,
    settings: &Settings,
    hits: &[Option<Hit>],
    opaque: bool,
) -> Vec<Option<Blended>> {
    let is_shown = |hit: &Hit| !(opaque && prepared.is_translucent(hit));
    let splats = seen_splats(prepared, view, settings, is_shown);
    let width = (view.width as usize).max(1);
    let rows = band_rows(view.height as usize);
    let mut frame = vec![None; hits.len()];
    frame.par_chunks_mut(width * rows).enumerate().for_each(|(band, pixels)| {
        let first_row = band * rows;
        let hits = &hits[first_row * width..][..pixels.len()];
        let band = Band { prepared, view, settings, splats: &splats, first_row, hits };
        pixels.copy_from_slice(&band.blended());
    });
    frame
}

/// Adds the hits of translucent splats to the layers of the pixels of `view`: each where its disk is.
pub fn add_disks(
    prepared: &Prepared<'_>,
    view: &View,
    settings: &Settings,
    layers: &mut [Vec<Hit>],
) {
    let splats = seen_splats(prepared, view, settings, |hit| prepared.is_translucent(hit));
    let width = (view.width as usize).max(1);
    let rows = band_rows(view.height as usize);
    layers.par_chunks_mut(width * rows).enumerate().for_each(|(band, layers)| {
        let hits = vec![None; layers.len()];
        let first_row = band * rows;
        let band = Band { prepared, view, settings, splats: &splats, first_row, hits: &hits };
        band.for_each_touch(|pixel, splat, touch| {
            let (_, index, item) = splat.rank;
            if touch.is_seen {
                layers[pixel].push(Hit { depth: touch.depth, item, index });
            }
        });
    });
}

/// All splats that may cover a pixel, of the samples that `is_shown` tells, in the scene's order.
pub(super) fn seen_splats(
    prepared: &Prepared<'_>,
    view: &View,
    settings: &Settings,
    is_shown: impl Fn(&Hit) -> bool + Sync,
) -> Vec<Splat> {
    let of_item = |(number, item): (usize, &PreparedItem<'_>)| match item.item.geometry {
        Geometry::Points(cloud) => {
            item_splats(prepared, view, settings, (number, item, cloud), &is_shown)
        }
        Geometry::Mesh(_) | Geometry::Lines(_) => vec![],
    };
    prepared.items.iter().enumerate().flat_map(of_item).collect()
}

fn item_splats(
    prepared: &Prepared<'_>,
    view: &View,
    settings: &Settings,
    (number, item, cloud): (usize, &PreparedItem<'_>, &PointCloud),
    is_shown: &(impl Fn(&Hit) -> bool + Sync),
) -> Vec<Splat> {
    let splat = |index: usize| {
        let hit = Hit { depth: 0.0, item: number as u32, index: index as u32 };
        if item.is_clear_sample(cloud, index) || !is_shown(&hit) {
            return None;
        }
        let seen = SeenSplat::new(view, settings, item, cloud, index)?;
        // A sample's surface is the same from every pixel: colour and normal, turned to the eye, at its own centre.
        let surface = surface::at(prepared, view, &hit, 0, 0);
        let surface = Surface { thickness: seen.offset, ..surface };
        let color = match (settings.splats.blend, settings.splats.shading) {
            (Blend::Weighted, Shading::Splat) => {
                shade(&surface, prepared, view.eye).map(|channel| channel.clamp(0.0, 1.0))
            }
            _ => surface.albedo,
        };
        // Painted splats are seen through fog one by one.
        let color = match (&prepared.scene.fog, prepared.scene.painted) {
            (Some(fog), Some(_)) => {
                let place = view.view_from_world * surface.position_from_eye;
                fog::seen_through(fog, view, color, place)
            }
            _ => color,
        };
        let instance = item.item.instance;
        let facing = facing(item, cloud, index, view);
        let rank = (instance, hit.index, hit.item);
        Some(Splat { seen, surface, color, instance, rank, facing })
    };
    (0..cloud.positions.len()).into_par_iter().filter_map(splat).collect()
}

/// Which side of its surface a sample shows.
pub(super) fn facing(item: &PreparedItem<'_>, cloud: &PointCloud, index: usize, view: &View) -> i8 {
    let normal = cloud.normals.as_ref().and_then(|normals| normals.get(index)).copied();
    let (Some(normal), true) = (normal, cloud.oriented) else { return 0 };
    let position = cloud.positions.get(index).and_then(|&position| item.to_view(position));
    let way = view.view_from_world.transpose() * view.towards(position.unwrap_or(DVec3::ZERO));
    let outward = item.normal_world_from_geometry * normal.as_dvec3();
    let turn = if item.mirrored { -1.0 } else { 1.0 };
    match turn * outward.dot(way) {
        side if side < 0.0 => 1,
        _ if normal == glam::Vec3::ZERO => 0,
        _ => -1,
    }
}

/// Rows of the frame that are worked on together.
struct Band<'a> {
    prepared: &'a Prepared<'a>,
    view: &'a View,
    settings: &'a Settings,
    splats: &'a [Splat],
    first_row: usize,
    hits: &'a [Option<Hit>],
}

impl<'a> Band<'a> {
    fn blended(&self) -> Vec<Option<Blended>> {
        let winners = self.winners();
        let mut sums = vec![Sums::default(); winners.len()];
        self.for_each_touch(|pixel, splat, touch| {
            let winner = &winners[pixel];
            let Some(best) = winner.splat else { return };
            let is_winner = splat.rank == best.rank;
            // The other side of a surface lies within the offset near its silhouette, and is hidden.
            if splat.facing * best.facing < 0 {
                return;
            }
            match self.settings.splats.blend {
                // However small, a weight must count where there is no other.
                Blend::Weighted if is_winner || touch.depth <= winner.reach => {
                    sums[pixel].add(splat, touch.weight.max(f64::MIN_POSITIVE), touch.depth);
                }
                Blend::Opaque if is_winner => sums[pixel].add(splat, 1.0, touch.depth),
                _ => {}
            }
        });
        let pixels = winners.iter().zip(&sums).enumerate();
        let blended = |(pixel, (winner, sums)): (usize, (&Winner<'a>, &Sums))| {
            Some(self.finish(pixel, winner.splat?, sums))
        };
        pixels.map(blended).collect()
    }

    /// The foremost splat of each pixel.
    fn winners(&self) -> Vec<Winner<'a>> {
        let of_hit = |hit: &Option<Hit>| match hit {
            Some(hit) => {
                let rank = (self.prepared.instance(hit), hit.index, hit.item);
                Winner { reach: hit.depth, rank, splat: None }
            }
            None => {
                Winner { reach: f64::INFINITY, rank: (u32::MAX, u32::MAX, u32::MAX), splat: None }
            }
        };
        let mut winners: Vec<Winner<'a>> = self.hits.iter().map(of_hit).collect();
        self.for_each_touch(|pixel, splat, touch| {
            if !touch.is_seen {
                return;
            }
            let reach = touch.depth + splat.seen.offset;
            let best = &mut winners[pixel];
            if reach < best.reach || (reach == best.reach && splat.rank < best.rank) {
                *best = Winner { reach, rank: splat.rank, splat: Some(splat) };
            }
        });
        winners
    }

    /// Every splat at every pixel of the band that it covers.
    fn for_each_touch(&self, mut visit: impl FnMut(usize, &'a Splat, Touch)) {
        let width = self.view.width as usize;
        let end_row = self.first_row + self.hits.len() / width.max(1);
        for splat in self.splats {
            let [x0, x1, y0, y1] = splat.seen.pixel_box;
            for y in y0.max(self.first_row)..y1.min(end_row) {
                for x in x0..x1 {
                    let centre = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                    let ray = pixel_ray(self.view, x, y);
                    if let Some(touch) = splat.seen.at(centre, ray)
                        && self.prepared.shows(self.view, self.view.at_depth(ray, touch.depth))
                    {
                        visit((y - self.first_row) * width + x, splat, touch);
                    }
                }
            }
        }
    }

    /// Means of a pixel's sums, lit.
    fn finish(&self, pixel: usize, winner: &Splat, sums: &Sums) -> Blended {
        let weight = sums.weight;
        let width = self.view.width as usize;
        let ray = pixel_ray(self.view, pixel % width, self.first_row + pixel / width);
        let depth = sums.depth / weight;
        let position_view = self.view.at_depth(ray, depth);
        let world_from_view = self.view.view_from_world.transpose();
        let mut surface = Surface {
            albedo: sums.color.map(|channel| channel / weight),
            position_from_eye: world_from_view * position_view,
            way: world_from_view * self.view.towards(position_view),
            normal_world: sums.normal_world.try_normalize().unwrap_or(DVec3::ZERO),
            ..winner.surface
        };
        surface.turn_to_eye();
        surface.recolor(self.prepared.scene.recolor.as_ref(), self.view, winner.instance);
        let color = match (self.settings.splats.blend, self.settings.splats.shading) {
            (Blend::Weighted, Shading::Splat) => surface.albedo,
            _ => {
                surface.open = self.prepared.ambient_share(&surface);
                shade(&surface, self.prepared, self.view.eye)
            }
        };
        let normal_world = surface.normal_world;
        Blended { color, normal_world, depth, instance: winner.instance }
    }
}
