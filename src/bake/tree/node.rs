//! A node: a disk that stands for all leaves below it, with its distance from them.

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};

use super::super::CUTOFF;
use super::super::kernels::tangents;
use super::super::pack::{Layout, Values};
use super::Measures;
use crate::assets::Kernel;

/// The part of a scan's cut-off kernel that its sample stands for; less than 1 because disks overlap.
pub const OWN: f32 = 0.5;
/// Code of the fraction around a node ([`super::coverage`]) of nodes that are never thinned.
pub const WHOLE: u8 = 3;

/// The kind of data that leaves come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matter {
    /// A scan. Sparse matter cannot be told from sparse sampling, so nothing below the root is thinned.
    Points,
    /// A mesh that is the surface of solids.
    Closed,
    /// Any other mesh.
    Open,
    /// Roots of trees; their areas are already visible areas.
    Instances,
}

#[derive(Clone, Copy, Debug)]
pub struct Node {
    pub position: DVec3,
    /// Unit vector, or zero where the leaves' normals cancel: the disk then faces the eye.
    pub normal: Vec3,
    /// Radius of the disk, which covers everything below it, seen along its normal.
    pub radius: f32,
    /// Bound on the distance of the leaves' disks from the plane.
    pub lift: f32,
    /// Bound on the distance of any point on the disk from a leaf's disk, seen along the normal.
    pub spread: f32,
    /// Bound on the angle between a leaf's normal and this normal, in radians; π if unknown.
    pub cone: f32,
    pub error: f32,
    /// The part of the error that does not depend on the viewing angle: colour contrast and what leaves stand for.
    pub even: f32,
    /// The whole error is independent of the viewing angle.
    pub alike: bool,
    /// The error if each node is drawn as one pixel: the distance of leaves from the centre, and what they stand for.
    pub size: f32,
    /// Area of the leaves.
    pub weight: f32,
    /// Area of the leaves as seen along the normal.
    pub flat: f32,
    /// Visible area, averaged over all directions.
    pub mean: f32,
    pub matter: Matter,
    /// No leaf has a normal: inner nodes are drawn unlit, as the leaves are.
    pub blank: bool,
    /// Code of the coverage around the node, see [`super::coverage`].
    pub around: u8,
    /// Codes of scalar fields.
    pub values: Values,
    /// sRGB, 0..=255.
    pub color: Vec3,
    /// Mean square difference of the leaves from the colour, per channel.
    pub variance: f32,
    pub parent: u32,
    /// Height above the leaves.
    pub level: u8,
}

pub const NO_NODE: u32 = u32::MAX;

/// Weighted means of unit normals that are shorter than this give no normal.
const LEAST_NORMAL: f32 = 0.4;
/// Standard deviations of colour (of 255) at which contrast begins to count, and at which a node's error is its radius: the mean
/// over a disk may be off by the radius. §3.9 takes the diameter. With it, frames of as many nodes are no nearer to full detail at 16 times the
/// pixels (`cargo bench --bench audit`, splats, mean nodes and median PSNR): the town 8236 nodes, 34.6 dB (radius) against 7743 and 34.2 dB
/// (diameter), the checkerboard 3053 and 41.7 dB against 2567 and 41.1 dB, or 4821 and 41.7 dB.
const FAINT: f32 = 4.0;
const STRONG: f32 = 24.0;
/// Factor by which the distance may be larger between the sampled places; measured on lattices of dots.
const BETWEEN: f32 = 1.2;
/// Places on a disk of radius 1 at which the distance of the leaves is measured: its centre, and two rings.
const PLACES: [Vec2; 19] = {
    // Sines of multiples of 30°.
    const H: f32 = 0.866_025_4;
    const R: f32 = 0.6;
    [
        Vec2::new(0.0, 0.0),
        Vec2::new(R, 0.0),
        Vec2::new(0.5 * R, H * R),
        Vec2::new(-0.5 * R, H * R),
        Vec2::new(-R, 0.0),
        Vec2::new(-0.5 * R, -H * R),
        Vec2::new(0.5 * R, -H * R),
        Vec2::new(1.0, 0.0),
        Vec2::new(H, 0.5),
        Vec2::new(0.5, H),
        Vec2::new(0.0, 1.0),
        Vec2::new(-0.5, H),
        Vec2::new(-H, 0.5),
        Vec2::new(-1.0, 0.0),
        Vec2::new(-H, -0.5),
        Vec2::new(-0.5, -H),
        Vec2::new(0.0, -1.0),
        Vec2::new(0.5, -H),
        Vec2::new(H, -0.5),
    ]
};

/// Length of a kernel's longer axis; 0 if it is not finite.
pub fn kernel_length(kernel: &Kernel) -> f32 {
    let length = kernel.u.length().max(kernel.v.length());
    if length.is_finite() { length } else { 0.0 }
}

/// The area that a kernel stands for by itself.
fn kernel_area(kernel: &Kernel) -> f32 {
    let area = OWN * PI * CUTOFF * CUTOFF * kernel.u.length() * kernel.v.length();
    if area.is_finite() { area } else { 0.0 }
}

/// The length of a vector. Squares of coordinates beyond 10¹⁹ overflow in `f32`.
fn length_of(way: Vec3) -> f32 {
    let length = way.length();
    if length.is_finite() { length } else { way.as_dvec3().length() as f32 }
}

impl Node {
    /// The visible area of a node: along its normal, or the mean over all directions if it has none.
    pub fn seen(&self) -> f32 {
        if self.normal == Vec3::ZERO {
            return self.mean;
        }
        self.flat.min(PI * self.radius * self.radius)
    }

    /// Builds the leaf of a sample, which may stand for something finer.
    pub fn leaf(
        position: DVec3,
        normal: Vec3,
        color: [u8; 4],
        kernel: &Kernel,
        is_clipped: bool,
        stands: Measures,
        matter: Matter,
    ) -> Node {
        let radius = CUTOFF * kernel_length(kernel);
        let known = |measure: f32| if measure > 0.0 { measure } else { 0.0 };
        let area = match known(stands.area) {
            0.0 => kernel_area(kernel),
            area => area,
        };
        // Samples without a size count as well.
        let weight = area.clamp(f32::MIN_POSITIVE, f32::MAX);
        Node {
            position,
            normal,
            radius,
            lift: 0.0,
            // The clipped part of the disk is missing.
            spread: if is_clipped { radius } else { 0.0 },
            cone: if normal == Vec3::ZERO { PI } else { known(stands.cone) },
            error: known(stands.error),
            even: known(stands.error),
            alike: false,
            size: known(stands.size),
            weight,
            flat: weight,
            mean: weight * matter.share(normal),
            matter,
            blank: normal == Vec3::ZERO && matter != Matter::Instances,
            around: WHOLE,
            values: Values::default(),
            color: Vec3::new(f32::from(color[0]), f32::from(color[1]), f32::from(color[2])),
            variance: 0.0,
            parent: NO_NODE,
            level: 0,
        }
    }

    /// Builds the parent of `children`, at least two, whose values have this layout.
    pub fn above(children: &[&Node], layout: &Layout) -> Node {
        // Weights may differ by a factor of 10³⁰.
        let total: f64 = children.iter().map(|child| f64::from(child.weight)).sum();
        let share = |child: &Node| (f64::from(child.weight) / total) as f32;
        let origin = children[0].position;
        let (mut mean, mut normal, mut color) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        for child in children {
            let part = share(child);
            mean += (child.position - origin).as_vec3() * part;
            normal += child.normal * part;
            color += child.color * part;
        }
        let variance = children.iter().map(|child| {
            let off = child.color - color;
            (off.length_squared() / 3.0 + child.variance) * share(child)
        });
        let variance = variance.sum();
        let length = normal.length();
        let normal = if length > LEAST_NORMAL { normal / length } else { Vec3::ZERO };
        let mut node = Node {
            position: origin + mean.as_dvec3(),
            normal,
            radius: 0.0,
            lift: 0.0,
            spread: 0.0,
            cone: PI,
            error: 0.0,
            even: 0.0,
            alike: false,
            size: 0.0,
            weight: total.min(f64::from(f32::MAX)) as f32,
            flat: 0.0,
            mean: 0.0,
            matter: children[0].matter,
            blank: children.iter().all(|child| child.blank),
            around: WHOLE,
            values: layout.above(children.iter().map(|child| (child.values, child.weight))),
            color,
            variance,
            parent: NO_NODE,
            level: children.iter().map(|child| child.level).max().unwrap_or(0).saturating_add(1),
        };
        if normal == Vec3::ZERO {
            node.enclose_in_a_ball(children);
        } else {
            node.enclose_in_a_disk(children);
            let flat: f32 = children.iter().map(|child| child.seen_along(normal)).sum();
            node.flat = flat.min(f32::MAX);
            node.cone = children.iter().fold(0.0, |most, child| {
                let cosine = child.normal.dot(normal).clamp(-1.0, 1.0);
                most.max(cosine.acos() + child.cone)
            });
        }
        let areas = children.iter().map(|child| child.mean).sum();
        node.mean = node.matter.joined(areas, node.radius).min(f32::MAX);
        let contrast = ((variance.sqrt() - FAINT) / (STRONG - FAINT)).clamp(0.0, 1.0);
        let own = length_of(Vec3::new(node.lift, node.spread, 0.0));
        let even = node.radius * contrast;
        node.even = children.iter().fold(even, |most, child| most.max(child.even));
        node.error = children.iter().fold(own.max(even), |most, child| most.max(child.error));
        let own = node.reach();
        node.size = children.iter().fold(own, |most, child| most.max(child.size));
        node
    }

    /// The area of the leaves, seen along a direction.
    fn seen_along(&self, direction: Vec3) -> f32 {
        if self.normal == Vec3::ZERO {
            return self.seen();
        }
        self.flat * self.normal.dot(direction).abs()
    }

    /// Makes the error independent of the viewing angle.
    pub fn see_alike(&mut self) {
        self.alike = true;
    }

    /// Bound on the distance of leaves from the centre: they lie in a ball, or in a cylinder about the disk.
    fn reach(&self) -> f32 {
        if self.normal == Vec3::ZERO { self.radius } else { self.radius.hypot(self.lift) }
    }

    fn enclose_in_a_ball(&mut self, children: &[&Node]) {
        for step in 0..4 {
            let far = children.iter().map(|child| {
                let way = (child.position - self.position).as_vec3();
                (length_of(way) + child.reach(), way)
            });
            let (_, way) = far.fold((-1.0, Vec3::ZERO), |a, b| if b.0 > a.0 { b } else { a });
            self.position += (way / (step as f32 + 2.0)).as_dvec3();
        }
        self.radius = children.iter().fold(0.0, |most, child| {
            let way = length_of((child.position - self.position).as_vec3());
            most.max(way + child.reach())
        });
        // A disk that faces the eye shows nothing of the shape within and is as wide as all of it.
        self.lift = self.radius;
        self.spread = 0.0;
    }

    fn enclose_in_a_disk(&mut self, children: &[&Node]) {
        let [a, b] = tangents(self.normal);
        let places: [(Vec2, f32); 8] = std::array::from_fn(|i| {
            let Some(child) = children.get(i) else { return (Vec2::ZERO, 0.0) };
            let way = (child.position - self.position).as_vec3();
            (Vec2::new(way.dot(a), way.dot(b)), way.dot(self.normal))
        });
        let places = &places[..children.len().min(8)];
        // An approximation of the smallest enclosing circle (Bădoiu & Clarkson 2003).
        let mut centre = Vec2::ZERO;
        for step in 0..4 {
            let far = places.iter().zip(children).map(|((at, _), child)| {
                let way = *at - centre;
                (length_of(way.extend(0.0)) + child.radius, way)
            });
            let (_, way) = far.fold((-1.0, Vec2::ZERO), |a, b| if b.0 > a.0 { b } else { a });
            centre += way / (step as f32 + 2.0);
        }
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for ((at, height), child) in places.iter().zip(children) {
            // The child's leaves lie in a cylinder about its disk, or in a ball.
            let cosine = child.normal.dot(self.normal);
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            let lift = if child.normal == Vec3::ZERO { 0.0 } else { child.lift };
            let across = child.radius + lift * sine;
            let reach = child.radius * sine + lift;
            self.radius = self.radius.max(length_of((*at - centre).extend(0.0)) + across);
            low = low.min(height - reach);
            high = high.max(height + reach);
        }
        self.lift = 0.5 * (high - low);
        let raise = 0.5 * (high + low);
        // The largest distance from the leaves, between children as well as beyond them.
        let at: [Vec2; PLACES.len()] = PLACES.map(|place| centre + place * self.radius);
        let mut least = [f32::MAX; PLACES.len()];
        for ((place, _), child) in places.iter().zip(children) {
            // A disk seen at an angle contains a circle scaled by the cosine.
            let seen = if child.normal == Vec3::ZERO { 1.0 } else { child.normal.dot(self.normal) };
            let extent = child.radius * seen.abs() - child.spread;
            for (least, at) in least.iter_mut().zip(&at) {
                let (x, y) = (at.x - place.x, at.y - place.y);
                let way = (x * x + y * y).sqrt() - extent;
                // A comparison vectorises to four lanes; `min` has to handle NaN.
                *least = if way < *least { way } else { *least };
            }
        }
        let farthest = least.into_iter();
        self.spread = (BETWEEN * farthest.fold(0.0, f32::max)).min(2.0 * self.radius);
        self.position += (a * centre.x + b * centre.y + self.normal * raise).as_dvec3();
    }
}
