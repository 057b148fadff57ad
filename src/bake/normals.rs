//! Normals and radii of points, from their nearest neighbours.
//!
//! The normal is the direction in which a point and its 12 nearest neighbours vary least: the
//! eigenvector of their covariance with the smallest eigenvalue (principal component analysis).
//! Its sign is chosen from the cloud's overall shape: clouds much flatter than wide (terrain) look
//! up along their flat axis, all others away from the middle of their box. That is right for what
//! is roughly convex and consistent everywhere; a scanner's position would tell more, but the
//! formats seldom keep it. The radius is half the mean distance to the 6 nearest neighbours, so
//! that discs just overlap on an evenly sampled surface.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::neighbors::{MAX_NEIGHBORS, Neighbors, PointTree};

pub(super) const NORMAL_NEIGHBORS: usize = 12;
/// A cloud whose shortest extent is below this fraction of the next is flat.
const FLAT_RATIO: f64 = 1.0 / 3.0;
/// Neighbourhoods narrower than this fraction of their length (squared) are lines.
const LINE_RATIO: f64 = 1e-6;
/// Points that tell place and size of the cloud.
const SAMPLES: usize = 4096;
/// Coordinates in the tree stay below this, so that squared distances are finite.
const MAX_COORDINATE: f64 = 1e18;

pub(super) fn is_radius(radius: &f32) -> bool {
    *radius > 0.0 && radius.is_finite()
}

/// The [`MAX_NEIGHBORS`] nearest of each point, nearest first; [`u32::MAX`] for those that there are not.
pub(super) fn nearest(positions: &[DVec3]) -> Vec<[u32; MAX_NEIGHBORS]> {
    let mut lists = vec![[u32::MAX; MAX_NEIGHBORS]; positions.len()];
    let finite: Vec<u32> =
        (0..u32::MAX).zip(positions).filter(|(_, p)| p.is_finite()).map(|(i, _)| i).collect();
    let Some(frame) = Frame::of(positions, &finite) else { return lists };
    let tree = PointTree::new(finite.iter().map(|&i| frame.to_local(positions[i as usize])));
    let found = tree.map_neighbors(MAX_NEIGHBORS, |neighbors| {
        let mut list = [u32::MAX; MAX_NEIGHBORS];
        let indices = neighbors.indices().map(|index| finite[index as usize]);
        list.iter_mut().zip(indices).for_each(|(slot, index)| *slot = index);
        list
    });
    for (&place, list) in tree.order().iter().zip(found) {
        lists[finite[place as usize] as usize] = list;
    }
    lists
}

/// The size of samples where all lie on a few places, so that nothing tells a size: that of a lone sample, divided so that all disks together
/// have the area of one. Many samples at one place would otherwise be drawn as many large disks, one over the other.
pub(super) fn lone_size(one: f32, count: usize) -> f32 {
    one / (count.max(1) as f32).sqrt()
}

/// The median of what is positive and finite, of a few thousand of them if there are more.
pub(super) fn median_of(lengths: &[f32]) -> Option<f32> {
    let mut sample: Vec<f32> = evenly(lengths).copied().filter(is_radius).collect();
    if sample.is_empty() {
        sample = lengths.iter().copied().filter(is_radius).collect();
    }
    let middle = sample.len() / 2;
    let len = sample.len();
    (len > 0).then(|| *sample.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Up to about [`SAMPLES`] elements, evenly spread.
pub(super) fn evenly<T>(all: &[T]) -> impl Iterator<Item = &T> {
    all.iter().step_by(stride(all.len()))
}

/// The stride of a sample of `count` elements that stands for all of them.
pub(super) fn stride(count: usize) -> usize {
    count.div_ceil(SAMPLES).max(1)
}

/// Which way normals look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outward {
    /// Away from the middle, in local coordinates.
    From(Vec3),
    /// Along an axis.
    Along(Vec3),
}

/// The coordinates of the tree: f32 about the cloud's median, where most points are, so that
/// neither a place far from the origin nor a few stray points cost precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    origin: DVec3,
    /// Length of a local unit.
    pub(super) size: f64,
    outward: Outward,
}

impl Frame {
    /// The frame of the points of `finite`, `None` without any.
    pub(super) fn of(positions: &[DVec3], finite: &[u32]) -> Option<Self> {
        let some: Vec<DVec3> = evenly(finite).map(|&index| positions[index as usize]).collect();
        Frame::of_some(&some)
    }

    /// The frame of a cloud of which these are evenly spread ([`stride`]).
    pub(super) fn of_some(some: &[DVec3]) -> Option<Self> {
        let quantiles = |axis: usize| {
            let mut values: Vec<f64> = some.iter().map(|position| position[axis]).collect();
            values.sort_unstable_by(f64::total_cmp);
            let at = |fraction: f64| {
                values.get(((values.len() as f64 - 1.0) * fraction).round() as usize).copied()
            };
            Some([at(0.01)?, at(0.5)?, at(0.99)?])
        };
        let axes = [quantiles(0)?, quantiles(1)?, quantiles(2)?];
        let [low, origin, high] = std::array::from_fn(|i| DVec3::from(axes.map(|axis| axis[i])));
        let extent = high * 0.5 - low * 0.5;
        let size = extent.max_element();
        let mut frame = Self {
            origin,
            size: if size > 0.0 { size } else { 1.0 },
            outward: Outward::Along(Vec3::Z),
        };
        let centre = Vec3::from(frame.to_local(low * 0.5 + high * 0.5));
        frame.outward = match flat_axis(extent) {
            Some(axis) => Outward::Along(axis),
            None => Outward::From(centre),
        };
        Some(frame)
    }

    pub(super) fn to_local(self, position: DVec3) -> [f32; 3] {
        // Halves keep differences of huge coordinates finite.
        let local = (position * 0.5 - self.origin * 0.5) / (self.size * 0.5);
        local.clamp(DVec3::splat(-MAX_COORDINATE), DVec3::splat(MAX_COORDINATE)).as_vec3().into()
    }

    /// The direction of least variance, looking outward.
    pub(super) fn normal(&self, neighbors: &Neighbors) -> Vec3 {
        let normal = least_direction(neighbors.offsets(), neighbors.len()).as_vec3();
        let outward = match self.outward {
            Outward::Along(axis) => axis,
            Outward::From(centre) => Vec3::from(neighbors.position()) - centre,
        };
        if normal.dot(outward) < 0.0 { -normal } else { normal }
    }
}

/// The axis of a box that is much shorter than the other two.
fn flat_axis(extent: DVec3) -> Option<Vec3> {
    let mut axes = [(extent.x, Vec3::X), (extent.y, Vec3::Y), (extent.z, Vec3::Z)];
    axes.sort_by(|a, b| a.0.total_cmp(&b.0));
    (axes[0].0 < FLAT_RATIO * axes[1].0).then_some(axes[0].1)
}

/// The unit vector along which the point (at the origin) and `count` offsets vary least, zero if
/// they lie on a line or a place, or vary alike in all directions.
pub(super) fn least_direction(offsets: impl Iterator<Item = [f32; 3]>, count: usize) -> DVec3 {
    let (mut sum, mut squares, mut products) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
    for offset in offsets {
        let d = DVec3::from(offset.map(f64::from));
        sum += d;
        squares += d * d;
        products += DVec3::new(d.y * d.z, d.z * d.x, d.x * d.y);
    }
    let inverse = 1.0 / (count as f64 + 1.0);
    let diagonal = squares - sum * sum * inverse;
    let others = products - DVec3::new(sum.y * sum.z, sum.z * sum.x, sum.x * sum.y) * inverse;
    let scale = diagonal.max_element();
    if count < 2 || scale <= 0.0 || !scale.is_finite() {
        return DVec3::ZERO;
    }
    smallest_eigenvector(diagonal / scale, others / scale)
}

/// The eigenvector of a symmetric matrix (diagonal xx yy zz; others yz zx xy) with the smallest
/// eigenvalue, by the trigonometric solution of the cubic; zero where it is not unique.
fn smallest_eigenvector(diagonal: DVec3, others: DVec3) -> DVec3 {
    let mean = diagonal.element_sum() / 3.0;
    let d = diagonal - mean;
    let spread = ((d.length_squared() + 2.0 * others.length_squared()) / 6.0).sqrt();
    if spread <= 1e-9 {
        return DVec3::ZERO;
    }
    let determinant = d.x * d.y * d.z + 2.0 * others.x * others.y * others.z
        - d.x * others.x * others.x
        - d.y * others.y * others.y
        - d.z * others.z * others.z;
    let angle = (determinant / (2.0 * spread * spread * spread)).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * spread * angle.cos();
    let smallest = mean + 2.0 * spread * (angle + TAU / 3.0).cos();
    let middle = 3.0 * mean - largest - smallest;
    if middle <= LINE_RATIO * largest {
        return DVec3::ZERO;
    }
    // The rows of A − λI span the plane across the eigenvector.
    let shifted = diagonal - smallest;
    let rows = [
        DVec3::new(shifted.x, others.z, others.y),
        DVec3::new(others.z, shifted.y, others.x),
        DVec3::new(others.y, others.x, shifted.z),
    ];
    let crosses = [rows[0].cross(rows[1]), rows[1].cross(rows[2]), rows[2].cross(rows[0])];
    let best = crosses
        .into_iter()
        .fold(DVec3::ZERO, |a, b| if b.length_squared() > a.length_squared() { b } else { a });
    best.try_normalize().unwrap_or(DVec3::ZERO)
}

#[cfg(test)]
mod tests;
