//! Sharp features of point sets: normals of their own side, and clip lines (Zwicker 2004, §5 and Fig. 4).
//!
//! Near an edge, a normal from the neighbours is a mean of both sides. What tells the sides apart is a little farther away:
//!
//! 1. A sample is *flat* if its nearest neighbours lie in its tangent plane. The neighbours of its neighbours (some forty
//!    samples, three to four spacings far) show what is on either side of an edge.
//! 2. The nearest flat one gives the first plane; the nearest flat one that is turned by more than the crease angle the
//!    second; one turned against both the third. Planes are fitted again, twice, to those samples that are near one
//!    of them and far from the others.
//! 3. If nearly all of the neighbourhood lies on these planes, it is a feature. The sample takes the normal of the plane it
//!    lies on, and its kernel is clipped where that plane meets the others. Lines that have samples of the plane on both
//!    sides (one wall ends at the middle of another) do not clip; where two lines cut off samples that one of them keeps,
//!    what either keeps is kept (a reflex corner).
//!
//! A smooth surface turns by less than the crease angle over that neighbourhood and gives no second plane. So edges are
//! found only where the sampling is fine enough to tell them from bends, and walls thinner than about three spacings are
//! left as they are.
//!
//! Measured on a cube of 6485 samples without normals: 94 % of the samples whose disk crosses an edge have a line, off by
//! 4 % of the spacing at most; on spheres and relief of 20 000 samples no line at all.

use glam::{DVec2, DVec3, Vec2};
use rayon::prelude::*;

use super::attributes::estimate_kernels;
use super::kernels::{CUTOFF, circle};
use super::neighbors::MAX_NEIGHBORS;
use super::normals::{least_direction, nearest};
use crate::assets::{Clip, ClipLine, Kernel, PointCloud};

/// Options that distinguish features from bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// Sides that meet at a smaller angle between their normals, in degrees, are one smooth surface.
    pub crease_deg: f64,
    /// Maximum distance of samples from the plane of their side, in spacings.
    pub noise: f64,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self { crease_deg: 35.0, noise: 0.15 }
    }
}

/// Neighbours that tell whether a sample is flat, and the spacing.
const FLAT_NEIGHBORS: usize = 8;
const SPACING_NEIGHBORS: usize = 6;
/// The part of the neighbourhood that has to lie on the planes.
const EXPLAINED: f64 = 0.9;
/// Samples of a plane that may lie beyond a line that clips it, and how far (in spacings) counts.
const STRAYS: f64 = 0.06;
const BEYOND: f64 = 0.25;
const FEWEST: usize = 4;

/// Finds sharp features, gives the samples near them the normals of their own side, and clips the kernels that cross them.
///
/// Normals, radii and kernels are estimated first where they lack. Samples with clip lines of their own keep them and
/// their normals. Orientation does not matter: a normal that is changed keeps looking to the side to which it looked.
/// Clouds of fewer than three samples, and those without features, are left as they are, without `clips`.
pub fn detect_features(cloud: &mut PointCloud, options: &FeatureOptions) {
    estimate_kernels(cloud);
    let count = cloud.positions.len();
    let given = cloud.clips.take().filter(|clips| clips.len() == count);
    let near = nearest(&cloud.positions);
    let (Some(normals), Some(kernels)) = (&cloud.normals, &cloud.kernels) else { return };
    let spacings: Vec<f64> = near
        .par_iter()
        .zip(&cloud.positions)
        .map(|(near, at)| {
            let few = near.iter().filter_map(|&i| cloud.positions.get(i as usize));
            let few: Vec<f64> = few.take(SPACING_NEIGHBORS).map(|p| p.distance(*at)).collect();
            few.iter().sum::<f64>() / few.len().max(1) as f64
        })
        .collect();
    let is_flat = |(index, near): (usize, &[u32; MAX_NEIGHBORS])| {
        let (at, normal) = (cloud.positions[index], normals[index].as_dvec3());
        let few = near.iter().take(FLAT_NEIGHBORS);
        normal != DVec3::ZERO
            && few
                .filter_map(|&i| cloud.positions.get(i as usize))
                .all(|p| (*p - at).dot(normal).abs() <= 1.5 * options.noise * spacings[index])
    };
    let field = Field {
        positions: &cloud.positions,
        normals: &normals.iter().map(|normal| normal.as_dvec3()).collect::<Vec<_>>(),
        flat: &near.par_iter().enumerate().map(is_flat).collect::<Vec<_>>(),
        spacings: &spacings,
        near: &near,
        crease_cosine: options.crease_deg.clamp(1.0, 90.0).to_radians().cos(),
        noise: options.noise,
    };
    let is_own = |index: usize| given.as_ref().is_some_and(|clips| clips[index] != Clip::NONE);
    let found: Vec<Option<(DVec3, Kernel, Clip)>> = (0..count)
        .into_par_iter()
        .map(|index| field.feature(index, &kernels[index]).filter(|_| !is_own(index)))
        .collect();
    let is_clipped = |found: &Option<(DVec3, Kernel, Clip)>| {
        found.as_ref().is_some_and(|(_, _, clip)| *clip != Clip::NONE)
    };
    let mut clips = match given {
        Some(clips) => Some(clips),
        None => found.iter().any(is_clipped).then(|| vec![Clip::NONE; count]),
    };
    for (index, found) in found.into_iter().enumerate() {
        let Some((normal, kernel, clip)) = found else { continue };
        if let Some(slot) = cloud.normals.as_mut().and_then(|normals| normals.get_mut(index)) {
            *slot = normal.as_vec3();
        }
        if let Some(slot) = cloud.kernels.as_mut().and_then(|kernels| kernels.get_mut(index)) {
            *slot = kernel;
        }
        if let Some(slot) = clips.as_mut().and_then(|clips| clips.get_mut(index)) {
            *slot = clip;
        }
    }
    cloud.clips = clips;
}

/// The arrays from which a sample's surroundings are read.
struct Field<'a> {
    positions: &'a [DVec3],
    normals: &'a [DVec3],
    flat: &'a [bool],
    spacings: &'a [f64],
    near: &'a [[u32; MAX_NEIGHBORS]],
    crease_cosine: f64,
    noise: f64,
}

/// Relative to the sample at hand.
#[derive(Clone, Copy, Debug)]
struct Plane {
    normal: DVec3,
    offset: f64,
}

impl Plane {
    fn distance(&self, at: DVec3) -> f64 {
        (at.dot(self.normal) - self.offset).abs()
    }
}

impl Field<'_> {
    /// A sample's neighbours and theirs, nearest first, relative to it.
    fn surroundings(&self, index: usize) -> Vec<(u32, DVec3)> {
        let lists = self.near[index].iter().filter_map(|&i| self.near.get(i as usize));
        let mut ring: Vec<u32> = lists.flatten().chain(&self.near[index]).copied().collect();
        ring.push(index as u32);
        ring.sort_unstable();
        ring.dedup();
        let mut ring: Vec<(u32, DVec3)> = ring
            .into_iter()
            .filter_map(|i| Some((i, *self.positions.get(i as usize)? - self.positions[index])))
            .collect();
        ring.sort_by(|a, b| a.1.length_squared().total_cmp(&b.1.length_squared()));
        ring
    }

    /// The planes of the sides about a sample: two or three, or none.
    fn planes(&self, ring: &[(u32, DVec3)], spacing: f64) -> Vec<Plane> {
        let mut planes: Vec<Plane> = Vec::new();
        for &(index, at) in ring.iter().filter(|(index, _)| self.flat[*index as usize]) {
            let normal = self.normals[index as usize];
            let is_new = planes.iter().all(|p| p.normal.dot(normal).abs() < self.crease_cosine);
            if is_new && planes.len() < 3 {
                planes.push(Plane { normal, offset: at.dot(normal) });
            }
        }
        if planes.len() < 2 {
            return Vec::new();
        }
        for _ in 0..2 {
            let fitted = (0..planes.len()).filter_map(|i| self.refit(&planes, i, ring, spacing));
            planes = fitted.collect();
        }
        let turned = |a: &Plane, b: &Plane| a.normal.dot(b.normal).abs() < self.crease_cosine;
        let apart =
            planes.iter().enumerate().all(|(i, a)| planes[i + 1..].iter().all(|b| turned(a, b)));
        if apart && planes.len() >= 2 { planes } else { Vec::new() }
    }

    /// A plane through those of the surroundings that are near it and far from the others.
    fn refit(
        &self,
        planes: &[Plane],
        which: usize,
        ring: &[(u32, DVec3)],
        spacing: f64,
    ) -> Option<Plane> {
        let limit = self.noise * spacing;
        let own = ring.iter().map(|&(_, at)| at).filter(|&at| {
            planes
                .iter()
                .enumerate()
                .all(|(i, plane)| (plane.distance(at) <= 1.5 * limit) == (i == which))
        });
        let own: Vec<DVec3> = own.collect();
        if own.len() < FEWEST {
            return None;
        }
        let mean = own.iter().sum::<DVec3>() / own.len() as f64;
        let unit = |at: &DVec3| ((*at - mean) / spacing).as_vec3().to_array();
        let normal = least_direction(own.iter().map(unit), own.len());
        (normal != DVec3::ZERO).then(|| Plane { normal, offset: mean.dot(normal) })
    }

    /// Normal, kernel and clip of a sample near a feature.
    fn feature(&self, index: usize, kernel: &Kernel) -> Option<(DVec3, Kernel, Clip)> {
        let spacing = self.spacings[index];
        if spacing <= 0.0 || !spacing.is_finite() {
            return None;
        }
        // Far from any feature all neighbours are flat and face alike: most samples end here.
        let normal = self.normals[index];
        let is_alike = |&i: &u32| {
            let (flat, other) = (self.flat.get(i as usize), self.normals.get(i as usize));
            flat.is_some_and(|flat| *flat)
                && other.is_some_and(|other| other.dot(normal).abs() > 0.99)
        };
        if self.flat[index] && self.near[index].iter().all(is_alike) {
            return None;
        }
        let ring = self.surroundings(index);
        let mut planes = self.planes(&ring, spacing);
        let limit = self.noise * spacing;
        let on_any = |at: DVec3| planes.iter().any(|plane| plane.distance(at) <= limit);
        let explained = ring.iter().filter(|(_, at)| on_any(*at)).count();
        if planes.is_empty() || (explained as f64) < EXPLAINED * ring.len() as f64 {
            return None;
        }
        // The sample's own side first.
        planes.sort_by(|a, b| a.offset.abs().total_cmp(&b.offset.abs()));
        let own = planes[0];
        if own.offset.abs() > limit {
            return None;
        }
        let side = if own.normal.dot(normal) < 0.0 { -own.normal } else { own.normal };
        let kernel = turned(kernel, side);
        let mates: Vec<DVec3> = ring
            .iter()
            .map(|&(_, at)| at)
            .filter(|&at| planes.iter().all(|p| p.distance(at) >= own.distance(at)))
            .filter(|&at| own.distance(at) <= limit)
            .collect();
        let clip = clip(&kernel, &planes[1..], &mates, spacing);
        Some((side, kernel, clip))
    }
}

/// A kernel turned into another tangent plane. Both axes get the longer one's length where the old plane was far off: what
/// it saw of its side was foreshortened.
fn turned(kernel: &Kernel, normal: DVec3) -> Kernel {
    let normal = normal.as_vec3();
    let (u, v) = (kernel.u.length(), kernel.v.length());
    let was = kernel.u.cross(kernel.v).normalize_or_zero();
    let flat = kernel.u - normal * kernel.u.dot(normal);
    match flat.try_normalize() {
        Some(axis) if was.dot(normal).abs() > 0.97 => {
            Kernel { u: axis * u, v: normal.cross(axis) * v }
        }
        _ => circle(normal, u.max(v)),
    }
}

/// The clip of a kernel at other planes. `mates` are the samples of its own side.
fn clip(kernel: &Kernel, others: &[Plane], mates: &[DVec3], spacing: f64) -> Clip {
    let [a, b] = [kernel.u, kernel.v].map(|axis| axis.as_dvec3().normalize_or_zero());
    let flat = |at: DVec3| DVec2::new(at.dot(a), at.dot(b));
    // In the tangent plane through the sample, in units of the cloud; the side with most mates is kept.
    let line = |other: &Plane| {
        let across = flat(other.normal);
        let along = across.try_normalize()?;
        let line = (along, other.offset / across.length());
        let is_kept = |at: &&DVec3| along.dot(flat(**at)) >= line.1;
        let kept = mates.iter().filter(is_kept).count();
        Some(if 2 * kept < mates.len() { (-line.0, -line.1) } else { line })
    };
    let lines: Vec<(DVec2, f64)> = others.iter().filter_map(line).collect();
    let lost = |keeps: &dyn Fn(DVec2) -> bool| {
        mates.iter().filter(|at| !keeps(flat(**at))).count() as f64 > STRAYS * mates.len() as f64
    };
    let inside = |line: &(DVec2, f64), at: DVec2| line.0.dot(at) >= line.1 - BEYOND * spacing;
    let is_clear = |line: &&(DVec2, f64)| !lost(&|at| inside(line, at)) && line.1 <= 0.0;
    let mut clear: Vec<(DVec2, f64)> = lines.iter().filter(is_clear).copied().collect();
    let either = match lines[..] {
        [one, two] if clear.is_empty() => {
            !lost(&|at| inside(&one, at) || inside(&two, at)) && (one.1 <= 0.0 || two.1 <= 0.0)
        }
        _ => false,
    };
    if either {
        clear = lines;
    }
    let in_kernel = |line: &(DVec2, f64)| {
        // normal · x ≥ offset with x = (s · |u|, t · |v|).
        let scaled = line.0 * DVec2::new(kernel.u.length().into(), kernel.v.length().into());
        let length = scaled.length().max(f64::MIN_POSITIVE);
        let normal: Vec2 = (scaled / length).as_vec2();
        ClipLine { normal, offset: (line.1 / length) as f32 }
    };
    let crossing = |line: &ClipLine| line.offset > -CUTOFF;
    let mut crossed = clear.iter().map(in_kernel).filter(|line| either || crossing(line));
    let lines = [crossed.next(), crossed.next()];
    let is_crossed = lines.iter().flatten().any(crossing);
    if is_crossed { Clip { lines, either } } else { Clip::NONE }
}

#[cfg(test)]
mod tests;
