//! Reconstruction kernels of points (Zwicker 2004, §3), from their nearest neighbours.
//!
//! A disk that ends at [`CUTOFF`] standard deviations has to reach what is nearer to its own sample than to any other:
//! the sample's Voronoi cell in the tangent plane. If every disk covers its cell, the disks together have no holes.
//! Where the sampling is denser one way than the other (scan lines), the cell is long, and so is the kernel:
//!
//! 1. The nearest twelve are projected to the tangent plane as offsets `q` and inverted, `w = q / |q|²`. The
//!    inverses span the polar dual of the cell: a neighbour twice as near is a wall twice as near and weighs four times.
//!    (The covariance of the neighbours themselves would not do: the nearest ones fill a circle, however they are
//!    spread in it.) The second moments of `w` give the axes; the ratio of their roots, bounded by [`MAX_RATIO`], gives
//!    the ellipticity.
//! 2. The cell is a polygon ([`Cell`]): a square, clipped at the walls to the neighbours. In coordinates in which the ellipse is a
//!    circle, the farthest corner is the kernel's reach. A corner counts as no farther than the farthest neighbour. Where the ellipse
//!    would be much longer than the cell, the kernel is a circle around the cell.
//! 3. At the rim of a gap, and at the border of a cloud, a cell is open: its farthest corner is farther than its neighbours. More of them
//!    tell which it is ([`open`]). Where these are no surface, a cell whose neighbours lie to one side leaves out what is open and takes, of
//!    every two opposite of [`DIRECTIONS`], the shorter extent (`1 / max 2 w · d` along `d`). One whose neighbours lie all in one direction
//!    is a stray.
//! 4. Where neighbours lie on no surface, a tangent plane means little. A sample whose sixth neighbour is [`ISOLATED`] times as
//!    far as its neighbours' own sixth neighbours is a stray, too: an echo in the air, alone or one of up to six. A small group
//!    far from all others is a group of strays, whatever these others are: any three groups lie on a plane. In a volume, such as
//!    a tree, and along a wire, kernels are circles that reach three quarters of the way to the nearest few. The less flat a
//!    neighbourhood is, the less its kernel may exceed the cloud's median.
//!
//! 5. What lies within a volume may look flat by chance. Where more than half of a cloud's neighbourhoods are not flat, no kernel
//!    exceeds what the median neighbourhood allows.
//!
//! Neighbours are the same that normals and radii come from, found in one search. Cells that they leave open take another search each: one in
//! a hundred samples that are spread at random.
//!
//! Measured on 300 k points (test profile, 2 shared cores): all three take 1.4 times what normals and radii take.

mod cell;
mod open;

use std::f32::consts::FRAC_1_SQRT_2;

use glam::{Vec2, Vec3};

use super::neighbors::{AROUND, MAX_NEIGHBORS, Neighbors};
use super::normals::{evenly, lone_size, median_of};
use crate::assets::Kernel;

pub(super) use cell::Cell;
use open::OpenCell;

/// Radius of the disks that have to cover the surface, in standard deviations.
pub const CUTOFF: f32 = 2.0;
/// Longest axis over shortest.
const MAX_RATIO: f32 = 8.0;
/// Directions that are looked at, over half a turn; their opposites are as well.
const DIRECTIONS: usize = 8;
/// Reach beyond a cell's farthest corner: surfaces curve, and kernels are rounded.
const MARGIN: f32 = 1.05;
/// Corners of a cell beyond this part of the distance to the farthest neighbour are not known to be gaps in the sampling.
const KNOWN: f32 = 1.0;
/// Longest axis of a kernel over the distance of its cell's farthest corner: 1.42 where the cell is a rectangle.
const LONGER: f32 = 2.0;
/// Half the side of the square that cells are clipped from, in distances of the farthest neighbour.
const SQUARE: f32 = 8.0;
/// Distance of the farthest corner of a cell, in distances of the farthest neighbour, from which on the cell is open.
const OPEN: f32 = 2.5;
/// Neighbours nearer than this part of the distance to the middle one count as if they were that far: two scans of one
/// surface give pairs of points in any direction.
const NEAREST: f32 = 0.2;
/// Length of the mean offset over the root of the mean square: about 0.6 at a straight border, 0.85 at a right corner.
const BORDER: f32 = 0.45;
const STRAY: f32 = 0.95;
/// Distance of a stray's sixth neighbour over the median of its neighbours' own: 0.7 on surfaces, and 2 or more at 30 in a
/// million samples that are spread at random.
const ISOLATED: f32 = 2.0;
/// Neighbour whose distance tells how dense samples are: few enough that the sixth is a sample of the clump that most neighbours
/// of a stray lie in, and enough that samples spread at random differ little.
const RANK: usize = 6;
/// Distance of the next neighbour over that of a group's farthest member.
const GAP: f32 = 4.0;
/// Longest kernel that a sample of such a group has, in medians of the cloud; one that would have a longer one is a stray.
const GROUPED: f32 = 4.0;
/// If more than one sample in this many is in such a group, groups are how the surface was sampled, not strays.
const RARE: usize = 20;
/// Thickness of a neighbourhood over its half width: up to the first it is a surface; from the second on kernels are bounded by
/// what is near; from the third on it is a volume. A right edge has 0.43.
const FLAT: f32 = 0.15;
pub(super) const ROUGH: f32 = 0.3;
const VOLUME: f32 = 0.6;
/// Exponent by which the longest kernel falls between a surface and a volume.
const FALL: f32 = 1.5;
/// Neighbourhoods narrower than this part of their length are wires.
const WIRE: f32 = 0.2;
/// Reach of kernels without a surface, in mean distances of the nearest three.
const LOOSE: f32 = 0.75;
/// Bounds on standard deviations, in medians of the cloud.
const LARGEST: f32 = 10.0;
const SMALLEST: f32 = 0.05;
/// Nothing is smaller, in whatever unit.
const TINY: f32 = 1e-18;
/// Size of a sample if nothing determines it.
const LONE: f32 = 0.25;

/// Cosines and sines of the directions of half a turn.
const TURN_X: [f32; DIRECTIONS] = [
    1.0,
    0.923_879_5,
    FRAC_1_SQRT_2,
    0.382_683_43,
    0.0,
    -0.382_683_43,
    -FRAC_1_SQRT_2,
    -0.923_879_5,
];
const TURN_Y: [f32; DIRECTIONS] =
    [0.0, 0.382_683_43, FRAC_1_SQRT_2, 0.923_879_5, 1.0, 0.923_879_5, FRAC_1_SQRT_2, 0.382_683_43];

pub(super) fn is_kernel(kernel: &Kernel) -> bool {
    kernel.u.is_finite() && kernel.v.is_finite() && kernel.u != Vec3::ZERO && kernel.v != Vec3::ZERO
}

/// A circular kernel across a normal; in the plane of x and y where the normal is zero.
pub fn circle(normal: Vec3, deviation: f32) -> Kernel {
    let [a, b] = tangents(normal);
    Kernel { u: a * deviation, v: b * deviation }
}

/// Unit vectors with `a × b` along the normal.
pub(super) fn tangents(normal: Vec3) -> [Vec3; 2] {
    // Zero and what is not finite alike.
    let normal = normal.try_normalize().unwrap_or(Vec3::Z);
    let (a, b) = normal.any_orthonormal_pair();
    if a.cross(b).dot(normal) > 0.0 { [a, b] } else { [b, a] }
}

/// A kernel as neighbours suggest it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Fit {
    /// Zero where nothing tells a size.
    pub(super) kernel: Kernel,
    /// Longest standard deviation that it may have, in medians of the cloud.
    pub(super) most: f32,
    /// The nearest neighbours form a small group far from all others.
    pub(super) is_grouped: bool,
}

impl Fit {
    /// The kernel in units that are `size` times smaller.
    pub(super) fn scaled(mut self, size: f64) -> Fit {
        for axis in [&mut self.kernel.u, &mut self.kernel.v] {
            *axis = (axis.as_dvec3() * size).as_vec3();
        }
        self
    }
}

/// The kernel of a point with a normal (possibly zero), in the coordinates of the tree. `is_given`: the normal is the file's own,
/// and right also where neighbours lie on a line. Also returns up to which squared distance the kernel depends on other points than the
/// neighbours; 0 where it does not.
pub(super) fn fit(neighbors: &Neighbors, normal: Vec3, is_given: bool) -> (Fit, f32) {
    let mut near = [Vec3::ZERO; MAX_NEIGHBORS];
    let count = neighbors.len();
    for (slot, offset) in near.iter_mut().zip(neighbors.offsets()) {
        *slot = Vec3::from(offset);
    }
    let near = &near[..count];
    let is_isolated = is_isolated(near);
    let loose = LOOSE * mean_distance(near) / CUTOFF;
    let lone = Fit { kernel: circle(normal, loose), most: 1.0, is_grouped: false };
    if normal == Vec3::ZERO {
        return (if is_isolated { Fit::default() } else { lone }, 0.0);
    }
    let [a, b] = tangents(normal);
    let mut offsets = [Vec2::ZERO; MAX_NEIGHBORS];
    for (offset, near) in offsets.iter_mut().zip(near) {
        *offset = Vec2::new(near.dot(a), near.dot(b));
    }
    let offsets = &offsets[..count];
    let [thickness, width] = proportions(near, offsets, normal);
    let is_wire = width < WIRE && !is_given;
    let Some(shape) = Shape::of(offsets) else { return (Fit::default(), 0.0) };
    let mut reach = 0.0;
    let mut open = None;
    let is_surface = thickness < ROUGH && (width >= WIRE || is_wire);
    if is_surface && (is_isolated || is_wire || shape.is_open()) {
        let mut around = Vec::with_capacity(AROUND);
        reach = neighbors.around(&mut around);
        let around: Vec<Vec3> = around.into_iter().map(Vec3::from).collect();
        open = OpenCell::of(&around, [a, b], normal);
    }
    // A gap in a surface, from whose rim the nearest neighbours look like something else.
    let is_gap = open.as_ref().is_some_and(|open| open.is_closed);
    let is_stray = (is_isolated || shape.aside > STRAY) && !is_gap;
    if is_wire && !is_stray && !is_gap {
        return (lone, reach);
    }
    let axes = match &open {
        _ if is_stray => None,
        Some(open) => shape.around(open.corners()),
        None => shape.around_neighbors(offsets),
    };
    // v = n × u keeps the frame right-handed.
    let Some([u, v]) = axes else { return (Fit::default(), reach) };
    let kernel = Kernel { u: a * u.x + b * u.y, v: a * v.x + b * v.y };
    let part = |from: f32| ((thickness - from) / (VOLUME - from)).clamp(0.0, 1.0);
    let most = LARGEST.powf((1.0 - part(FLAT)).powf(FALL));
    let is_grouped = is_grouped(near) && !is_gap;
    let bounded = |axis: Vec3| axis * (loose / (part(ROUGH) * axis.length())).min(1.0);
    let fit = match part(ROUGH) > 0.0 {
        true => {
            Fit { kernel: Kernel { u: bounded(kernel.u), v: bounded(kernel.v) }, most, is_grouped }
        }
        false => Fit { kernel, most, is_grouped },
    };
    (fit, reach)
}

/// Mean distance of the nearest three that are not at the same place.
fn mean_distance(near: &[Vec3]) -> f32 {
    let lengths = near.iter().map(|q| q.length()).filter(|&d| d > 0.0).take(3);
    let (sum, count) = lengths.fold((0.0, 0.0f32), |(sum, n), d| (sum + d, n + 1.0));
    sum / count.max(1.0)
}

/// Tells whether a sample at the origin is much farther from its neighbours than they are from each other. The test compares the
/// sixth neighbours, so pairs and triples (of strays as of samples) have no effect.
fn is_isolated(near: &[Vec3]) -> bool {
    let (Some(own), true) = (near.get(RANK - 1), near.len() > RANK) else { return false };
    let mut least = [[f32::INFINITY; RANK]; MAX_NEIGHBORS];
    let insert = |least: &mut [f32; RANK], d: f32| {
        if d < least[RANK - 1] {
            let at = least.partition_point(|&nearer| nearer <= d);
            least.copy_within(at..RANK - 1, at + 1);
            least[at] = d;
        }
    };
    for (a, from) in near.iter().enumerate() {
        for (b, to) in near[..a].iter().enumerate() {
            let d = from.distance_squared(*to);
            insert(&mut least[a], d);
            insert(&mut least[b], d);
        }
    }
    let mut ranked = least.map(|least| least[RANK - 1]);
    let ranked = &mut ranked[..near.len()];
    ranked.sort_unstable_by(f32::total_cmp);
    own.length_squared() > ISOLATED * ISOLATED * ranked[near.len() / 2]
}

/// Tells whether there is a gap behind the nearest two or more neighbours. Samples at the same position do not count as
/// neighbours here, because files may hold each sample several times.
fn is_grouped(near: &[Vec3]) -> bool {
    let distances = near.iter().map(|q| q.length_squared()).filter(|&d| d > 0.0).skip(1);
    distances.clone().zip(distances.skip(1)).any(|(last, next)| next > GAP * GAP * last)
}

/// Thickness of a neighbourhood, with the sample itself, across its tangent plane over its half width in it, and its width in the
/// plane over its length: 0 to 1.
pub(super) fn proportions(near: &[Vec3], offsets: &[Vec2], normal: Vec3) -> [f32; 2] {
    let inverse = 1.0 / (near.len() as f32 + 1.0);
    let (mut high, mut high_squared) = (0.0f32, 0.0f32);
    let (mut sum, mut squares, mut product) = (Vec2::ZERO, Vec2::ZERO, 0.0f32);
    for (q, flat) in near.iter().zip(offsets) {
        let height = q.dot(normal);
        (high, high_squared) = (high + height, high_squared + height * height);
        (sum, squares, product) = (sum + *flat, squares + *flat * *flat, product + flat.x * flat.y);
    }
    let spread = squares - sum * sum * inverse;
    let across = (high_squared - high * high * inverse).max(0.0);
    let half = 0.5 * (spread.x + spread.y);
    let skew = product - sum.x * sum.y * inverse;
    let difference = (0.25 * (spread.x - spread.y).powi(2) + skew * skew).sqrt();
    let (long, short) = (half + difference, (half - difference).max(0.0));
    if long <= 0.0 || !long.is_finite() {
        return [0.0, 1.0];
    }
    [(across / half).sqrt(), (short / long).sqrt()]
}

/// The cell of a sample at the origin, and the shape of the ellipse that covers it.
struct Shape {
    cell: Cell,
    /// Unit vector along the short axis.
    axis: Vec2,
    /// Root of the ratio of both axes: scaling the axes by this and its inverse makes the ellipse round.
    scale: f32,
    /// Distance of the farthest neighbour, and the squared distance up to which one is the sample itself once more.
    farthest: f32,
    same: f32,
    /// Length of the mean offset over the root of the mean square.
    aside: f32,
}

impl Shape {
    /// `offsets`: the neighbours in the tangent plane, nearest first; `None` where all are at one place.
    fn of(offsets: &[Vec2]) -> Option<Shape> {
        let farthest = offsets.iter().fold(0.0f32, |far, q| far.max(q.length_squared()));
        let nearest = NEAREST * NEAREST * offsets.get(offsets.len() / 2)?.length_squared();
        let same = 1e-8 * farthest;
        let (mut sum, mut count, mut dual) = (Vec2::ZERO, 0.0f32, [0.0f32; 3]);
        for q in offsets {
            let d = q.length_squared();
            if d > same {
                let weight = 1.0 / (d * d.max(nearest));
                dual = [
                    dual[0] + weight * q.x * q.x,
                    dual[1] + weight * q.x * q.y,
                    dual[2] + weight * q.y * q.y,
                ];
                sum += *q;
                count += 1.0;
            }
        }
        if count == 0.0 || !dual[0].is_finite() || !dual[2].is_finite() {
            return None;
        }
        let square: f32 = offsets.iter().map(|q| q.length_squared()).sum();
        let (axis, ratio) = axes(dual);
        let farthest = farthest.sqrt();
        Some(Shape {
            cell: Cell::of(offsets, SQUARE * farthest, same),
            axis,
            scale: ratio.sqrt(),
            farthest,
            same,
            aside: sum.length() / (square * count).sqrt(),
        })
    }

    /// Distance up to which corners are known to be gaps in the sampling.
    fn known(&self) -> f32 {
        KNOWN * self.farthest
    }

    fn is_open(&self) -> bool {
        self.cell.extent() > self.known()
    }

    fn round(&self, v: Vec2) -> Vec2 {
        Vec2::new(v.dot(self.axis) * self.scale, v.dot(self.axis.perp()) / self.scale)
    }

    /// The axes of an ellipse, or of a circle, that covers these corners; `None` without any.
    fn around(&self, corners: &[Vec2]) -> Option<[Vec2; 2]> {
        let reach = corners.iter().fold(0.0f32, |reach, c| reach.max(self.round(*c).length()));
        let radius = corners.iter().fold(0.0f32, |radius, c| radius.max(c.length()));
        self.covering(reach, radius, false)
    }

    /// The axes of an ellipse that covers the known part of the neighbours' cell.
    fn around_neighbors(&self, offsets: &[Vec2]) -> Option<[Vec2; 2]> {
        let known = self.known();
        let is_border = self.aside > BORDER && self.cell.extent() > OPEN * self.farthest;
        let round = |v| self.round(v);
        let mut reach = match is_border {
            true => shorter_extent(offsets, round, known / self.scale, self.same),
            false => 0.0,
        };
        let mut radius = reach / self.scale;
        for corner in self.cell.corners() {
            let length = corner.length();
            let part = match length <= known {
                true => 1.0,
                false if is_border => 0.0,
                false => known / length,
            };
            reach = reach.max(part * self.round(*corner).length());
            radius = radius.max(part * length);
        }
        self.covering(reach, radius, is_border)
    }

    /// `reach`: distance of the farthest corner where the ellipse is a circle; `radius`: of the farthest one.
    fn covering(&self, reach: f32, radius: f32, is_border: bool) -> Option<[Vec2; 2]> {
        // A corner across a long ellipse makes it longer still. The circle around all corners is then the better kernel.
        let is_long = reach > radius || reach * self.scale > LONGER * radius;
        let [short, long] = match is_long && !is_border {
            true => [radius; 2],
            false => [reach / self.scale, reach * self.scale],
        };
        let part = MARGIN / CUTOFF;
        (reach > 0.0).then(|| [self.axis * (short * part), self.axis.perp() * (long * part)])
    }
}

/// The largest, over all directions, of the shorter of a cell's two extents along the direction and its opposite, in the
/// coordinates that `round` gives. Extents beyond `known` do not count.
fn shorter_extent(offsets: &[Vec2], round: impl Fn(Vec2) -> Vec2, known: f32, same: f32) -> f32 {
    let mut nearest = [0.0f32; DIRECTIONS];
    for q in offsets {
        if q.length_squared() > same {
            let q = round(*q);
            let wall = q * (2.0 / q.length_squared());
            for (i, nearest) in nearest.iter_mut().enumerate() {
                *nearest = nearest.max((wall.x * TURN_X[i] + wall.y * TURN_Y[i]).abs());
            }
        }
    }
    nearest.iter().map(|near| 1.0 / near).filter(|extent| *extent <= known).fold(0.0, f32::max)
}

/// The direction along which a symmetric matrix (xx, xy, yy) is largest, and the root of the ratio of its eigenvalues.
fn axes([xx, xy, yy]: [f32; 3]) -> (Vec2, f32) {
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let spread = (half * half + xy * xy).sqrt();
    let least = (mean - spread).max((mean + spread) / (MAX_RATIO * MAX_RATIO));
    // The half angle, from the longer of the two ways to write it.
    let axis = if half > 0.0 { Vec2::new(half + spread, xy) } else { Vec2::new(xy, spread - half) };
    (axis.try_normalize().unwrap_or(Vec2::X), ((mean + spread) / least).sqrt())
}

pub(super) fn longest_axis(kernel: &Kernel) -> f32 {
    kernel.v.as_dvec3().length().max(kernel.u.as_dvec3().length()) as f32
}

/// The standard deviations that a cloud's kernels may have.
pub(super) struct Bounds {
    median: f32,
    least: f32,
    most: f32,
    /// Longest axis of samples that form small groups; longer ones are strays.
    grouped: f32,
}

impl Bounds {
    pub(super) fn of(fits: &[Fit]) -> Self {
        Bounds::of_some(&evenly(fits).copied().collect::<Vec<Fit>>(), fits.len())
    }

    /// Bounds for a cloud of `count` samples of whose kernels these are some, evenly spread.
    pub(super) fn of_some(fits: &[Fit], count: usize) -> Self {
        let lengths: Vec<f32> = fits.iter().map(|fit| longest_axis(&fit.kernel)).collect();
        let median = median_of(&lengths).unwrap_or(lone_size(LONE, count));
        // Between these, squares of lengths are ordinary numbers.
        let allowed: Vec<f32> =
            fits.iter().map(|fit| fit.most).filter(|most| *most > 0.0).collect();
        let allowed = median_of(&allowed).unwrap_or(LARGEST);
        let most = (median * allowed).clamp(TINY, f32::MAX.sqrt() * 1e-3);
        let least = (median * SMALLEST).clamp(TINY, most);
        let median = median.clamp(least, most);
        let grouped = fits.iter().filter(|fit| fit.is_grouped).count();
        let is_grouped = grouped * RARE > fits.len();
        Self {
            median,
            least,
            most,
            grouped: if is_grouped { f32::INFINITY } else { GROUPED * median },
        }
    }

    /// Gives a stray the median and keeps all others near it.
    pub(super) fn apply(&self, fit: Fit, normal: Vec3) -> Kernel {
        let Fit { kernel, most, is_grouped } = fit;
        // An axis so short that f32 has not kept its direction.
        let is_vague = |axis: Vec3| axis.as_dvec3().length() < 1e-30;
        let is_stray = is_grouped && longest_axis(&kernel) > self.grouped;
        if is_stray || !is_kernel(&kernel) || is_vague(kernel.u) || is_vague(kernel.v) {
            return circle(normal, self.median);
        }
        let bounded = |axis: Vec3| {
            // In f64, where squares neither vanish nor overflow.
            let (axis, length) = (axis.as_dvec3(), axis.as_dvec3().length());
            let most = (f64::from(self.median) * f64::from(most)).min(self.most.into());
            let within = length.min(most).max(self.least.into());
            if within == length { axis.as_vec3() } else { (axis * (within / length)).as_vec3() }
        };
        Kernel { u: bounded(kernel.u), v: bounded(kernel.v) }
    }
}

#[cfg(test)]
mod tests;
