//! Coverage: the part of its disk that a node's leaves cover. It sets the probability that a node smaller than its drawn
//! footprint is drawn.
//!
//! A drawn node covers a pixel or more, however small its leaves are. To make a set of such nodes cover as much of the image as
//! their leaves do, each node is drawn with the probability that it has to cover a pixel. Each node compares that probability
//! with a fixed random number of its own, so nodes appear one by one as the eye comes nearer (continuous thinning, Coconu & Hege
//! 2002). With `A` the area of the leaves in the image, `D` the area that the node is drawn as, and `f` the fraction of the image
//! around it that its surface covers,
//!
//! ```text
//! p = 1 − (1 − f)^(A / (f D))        A / D where f = 0, 1 where f = 1
//! ```
//!
//! `f D / A` nodes lie over a pixel, and all of them leave it empty in `1 − f` of cases. Without `f`, surfaces would have holes
//! where they are cut into nodes smaller than a pixel. `f` is the coverage of the node's ancestors in four steps ([`FULL`]). It
//! is full if any ancestor is full, because a piece cut off a surface at the border of a cell covers little of its own disk.
//!
//! The alpha byte of a node's colour stores `f` (2 bits) and the covered part of a disk as large as the node's size, in eighths
//! of an octave (6 bits). [`EXACT`] marks leaves of scans, which are always drawn and stand for no other sample. [`FILLS`] marks
//! nodes that stand for others and are never thinned.
//!
//! Areas are projected along the normal; a node without a normal has the mean over all directions. The mean is half of a sheet's
//! area and a quarter of a closed surface's, whose other half is hidden (Cauchy). Loosely connected leaves hide each other as
//! random leaves do.

use std::f32::consts::PI;

use glam::Vec3;

use super::node::{Matter, NO_NODE, Node, WHOLE};

/// Coverage byte of nodes that are always drawn.
pub const EXACT: u8 = 255;
/// Leaves of a ball in different octants hide each other 1.75 times less than all pairs of leaves do, and balls are about twice
/// as large as the part that leaves fill.
const BESIDE: f32 = 0.9;
/// Coverage byte of nodes that stand for several points of a scan or things of a crowd and are never thinned. They fill the
/// pixels that they are in, while disks of a mesh are drawn only at pixels whose centres they cover.
pub const FILLS: u8 = 254;
/// Codes per octave, and the number of codes; the last two codes of a full surface would collide with [`FILLS`] and [`EXACT`].
const STEPS: f32 = 8.0;
const CODES: u32 = 62;
/// Thresholds of the covered part of an ancestor's disk for the steps of [`AROUND`]. A cell of a whole surface covers at most 2/π
/// of the circle around it, and less of the disk that holds its leaves' disks.
const FULL: [f32; 3] = [0.1, 0.2, 0.3];
/// `f` by its code.
pub const AROUND: [f32; 4] = [0.0, 0.5, 0.8, 1.0];
impl Matter {
    /// The visible fraction of a leaf's area, averaged over all directions.
    pub fn share(self, normal: Vec3) -> f32 {
        match self {
            Matter::Points | Matter::Closed => 0.25,
            Matter::Instances if normal == Vec3::ZERO => 1.0,
            Matter::Open | Matter::Instances => 0.5,
        }
    }

    /// The visible area of several leaves in a ball of this radius, averaged over all directions.
    pub fn joined(self, areas: f32, radius: f32) -> f32 {
        let disk = PI * radius * radius;
        let joined = match self {
            Matter::Open if disk > 0.0 => BESIDE * disk * (1.0 - (-areas / (BESIDE * disk)).exp()),
            _ => areas,
        };
        joined.min(disk)
    }
}

/// The code of `f` for the nodes below `node`, from the largest part of its disk that it covers from any direction.
fn fullness(node: &Node) -> u8 {
    let disk = PI * node.radius * node.radius;
    let area = match (node.normal == Vec3::ZERO, node.matter) {
        (false, _) => node.flat,
        // The two sides of a thin wall look like one.
        (true, Matter::Closed | Matter::Open | Matter::Points) => 0.5 * node.weight,
        // Objects in front of a surface are not part of the surface.
        (true, Matter::Instances) => 0.0,
    };
    FULL.iter().filter(|&&least| area >= least * disk).count() as u8
}

/// The code of `f` of a node; `parent` is its parent with the parent's code.
fn around(node: &Node, parent: Option<(&Node, u8)>) -> u8 {
    match (parent, node.matter) {
        (None, _) => 0,
        (Some(_), Matter::Points) => WHOLE,
        // A node of a crowd without a normal is an object, or several, in front of others.
        (Some(_), Matter::Instances) if node.normal == Vec3::ZERO => 0,
        (Some((parent, above)), _) => fullness(parent).max(above),
    }
}

/// Sets the code of `f` of all nodes. Parents come after their children in the list.
pub(super) fn look_around(nodes: &mut [Node]) {
    for at in (0..nodes.len()).rev() {
        let parent = match nodes[at].parent {
            NO_NODE => None,
            parent => nodes.get(parent as usize).map(|parent| (parent, parent.around)),
        };
        nodes[at].around = around(&nodes[at], parent);
    }
}

/// The code of `f` of a scan's node.
pub fn around_point(is_root: bool) -> u8 {
    if is_root { 0 } else { WHOLE }
}

/// The coverage byte of a node; `size` is its size as coded.
pub fn byte(node: &Node, size: f32) -> u8 {
    let is_thinned = size > 0.0 && !node.blank;
    if !is_thinned {
        return EXACT;
    }
    if matches!(node.matter, Matter::Points | Matter::Instances) && node.around >= WHOLE {
        return FILLS;
    }
    let part = node.seen() / (PI * size * size);
    let code = (-part.log2() * STEPS).round().clamp(0.0, (CODES - 1) as f32) as u8;
    node.around.min(WHOLE) << 6 | code
}

/// The visible area of a node with this byte and size; `None` for [`EXACT`].
pub fn area(byte: u8, size: f32) -> Option<f32> {
    let part = (-f32::from(byte & 63) / STEPS).exp2();
    (byte != EXACT).then_some(part * PI * size * size)
}

/// The probability that a node is drawn, by the same formula as the shaders. `share` is the visible area divided by the drawn
/// area.
pub fn probability(byte: u8, share: f32) -> f32 {
    let around = AROUND[usize::from(byte >> 6)];
    match byte >> 6 {
        0 => share.min(1.0),
        WHOLE => 1.0,
        _ => 1.0 - (1.0 - around).powf(share / around),
    }
}
