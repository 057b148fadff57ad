//! How much of its disk a node's leaves cover, and so how often it is drawn where it is smaller than what it is drawn as.
//!
//! A node that is drawn covers a pixel or more, however little is below it. So that a crowd of such nodes covers as much of the image
//! as their leaves do, each is drawn with the probability that it has to cover a pixel, by a number of its own that never changes:
//! as the eye comes nearer, they appear one by one (continuous thinning, Coconu & Hege 2002). With `A` the area of the leaves in the
//! image, `D` the area that the node is drawn as, and `f` the part of the image around it that its surface covers,
//!
//! ```text
//! p = 1 − (1 − f)^(A / (f D))        A / D where f = 0, 1 where f = 1
//! ```
//!
//! `f D / A` nodes lie over a pixel, and all of them leave it empty in `1 − f` of cases. Were `f` not known, surfaces would have holes
//! where they are cut into nodes smaller than a pixel. It is what the nodes above cover, in four steps ([`FULL`]): full if any of
//! them is, since what is cut off a surface at the border of a cell covers little of its own disk.
//!
//! Stored in the alpha byte of a node's colour: `f` (2 bits) and the covered part of a disk as large as the node's size, in eighths of an
//! octave (6 bits). [`EXACT`] stands for what is drawn always, and does not stand for others: leaves of scans. [`FILLS`] stands for
//! what does, and is never thinned.
//!
//! Areas are what is seen along the normal; of a node without one the mean over all directions. That is half of a sheet's area, a quarter
//! of a closed surface's, whose other half is hidden (Cauchy). Leaves that hang together loosely hide each other as random ones do.

use std::f32::consts::PI;

use glam::Vec3;

use super::node::{NO_NODE, Node};

/// The byte of what is drawn always.
pub const EXACT: u8 = 255;
/// Of a scan's kernel as it is cut off, the part that its sample stands for: disks overlap.
pub const OWN: f32 = 0.5;
/// Of the pairs of leaves in a ball, those in different octants hide each other 1.75 times less than all do; and balls are about twice
/// as large as what leaves fill of them.
const BESIDE: f32 = 0.9;
/// The byte of what is never thinned and stands for several points of a scan or things of a crowd. They fill the pixels that they are
/// in, where disks of a mesh are drawn only at pixels whose centres they cover.
const FILLS: u8 = 254;
/// Codes of an octave, and how many there are; the last two of a full surface would be [`FILLS`] and [`EXACT`].
const STEPS: f32 = 8.0;
const CODES: u32 = 62;
/// Parts of a disk that the nodes above cover, from which on it counts as covered by [`AROUND`]. Of a whole surface a cell covers at
/// most 2/π of the circle around it, and of the disk that holds its leaves' disks less.
const FULL: [f32; 3] = [0.1, 0.2, 0.3];
/// What `f` is by its code.
pub const AROUND: [f32; 4] = [0.0, 0.5, 0.8, 1.0];
/// The code of what is never thinned.
pub const WHOLE: u8 = 3;

/// What leaves are leaves of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matter {
    /// A scan. Nothing tells sparse from badly sampled: below its root nothing is thinned.
    Points,
    /// A mesh that is the surface of solids.
    Closed,
    /// Any other mesh.
    Open,
    /// Roots of trees, whose areas are what is seen of them.
    Crowd,
}

impl Matter {
    /// The part of a leaf's area that is seen, on the average.
    pub fn share(self, normal: Vec3) -> f32 {
        match self {
            Matter::Points | Matter::Closed => 0.25,
            Matter::Crowd if normal == Vec3::ZERO => 1.0,
            Matter::Open | Matter::Crowd => 0.5,
        }
    }

    /// What is seen of several, on the average, in a ball of this radius.
    pub fn joined(self, areas: f32, radius: f32) -> f32 {
        let disk = PI * radius * radius;
        let joined = match self {
            Matter::Open if disk > 0.0 => BESIDE * disk * (1.0 - (-areas / (BESIDE * disk)).exp()),
            _ => areas,
        };
        joined.min(disk)
    }
}

/// The area that is seen of a node: along its normal, or else on the average.
pub fn seen(node: &Node) -> f32 {
    if node.normal == Vec3::ZERO {
        return node.mean;
    }
    node.flat.min(PI * node.radius * node.radius)
}

/// Which part of its disk a node covers at the most, from wherever it is seen: the code of `f` for those below it.
fn fullness(node: &Node) -> u8 {
    let disk = PI * node.radius * node.radius;
    let area = match (node.normal == Vec3::ZERO, node.matter) {
        (false, _) => node.flat,
        // A thin wall's two sides are one to look at.
        (true, Matter::Closed | Matter::Open | Matter::Points) => 0.5 * node.weight,
        // What is in front of a surface is no part of it.
        (true, Matter::Crowd) => 0.0,
    };
    FULL.iter().filter(|&&least| area >= least * disk).count() as u8
}

/// Of a node: the code of `f`, where that of its parent, which is known, is `parent`.
fn around(node: &Node, parent: Option<(&Node, u8)>) -> u8 {
    match (parent, node.matter) {
        (None, _) => 0,
        (Some(_), Matter::Points) => WHOLE,
        // What looks nowhere in a crowd is an object, or several, before others.
        (Some(_), Matter::Crowd) if node.normal == Vec3::ZERO => 0,
        (Some((parent, above)), _) => fullness(parent).max(above),
    }
}

/// Sets what lies around nodes, whose parents come behind them.
pub(super) fn look_around(nodes: &mut [Node]) {
    for at in (0..nodes.len()).rev() {
        let parent = match nodes[at].parent {
            NO_NODE => None,
            parent => nodes.get(parent as usize).map(|parent| (parent, parent.around)),
        };
        nodes[at].around = around(&nodes[at], parent);
    }
}

/// What is around a node of a scan.
pub fn around_point(is_root: bool) -> u8 {
    if is_root { 0 } else { WHOLE }
}

/// The byte of a node whose size, as it is coded, is `size`.
pub fn byte(node: &Node, size: f32) -> u8 {
    let is_thinned = size > 0.0 && !node.blank;
    if !is_thinned {
        return EXACT;
    }
    if matches!(node.matter, Matter::Points | Matter::Crowd) && node.around >= WHOLE {
        return FILLS;
    }
    let part = seen(node) / (PI * size * size);
    let code = (-part.log2() * STEPS).round().clamp(0.0, (CODES - 1) as f32) as u8;
    node.around.min(WHOLE) << 6 | code
}

/// The area that is seen of a node of this byte and size; `None` of [`EXACT`].
pub fn area(byte: u8, size: f32) -> Option<f32> {
    let part = (-f32::from(byte & 63) / STEPS).exp2();
    (byte != EXACT).then_some(part * PI * size * size)
}

/// How probable it is that a node is drawn of which `share` times what it is drawn as is seen, as shaders decide it.
pub fn probability(byte: u8, share: f32) -> f32 {
    let around = AROUND[usize::from(byte >> 6)];
    match byte >> 6 {
        0 => share.min(1.0),
        WHOLE => 1.0,
        _ => 1.0 - (1.0 - around).powf(share / around),
    }
}
