//! Errors by viewing angle: the split error mode (Dachsbacher et al. 2003, §3.4, §3.7).
//!
//! A node's error is `e = √(lift² + spread²)`. An eye that looks along the normal sees the spread, and an eye in the disk's plane
//! sees the lift. At an angle `α` between view and normal the paper takes `lift · sin α + spread · cos α`. The cosine
//! foreshortens a spread towards the eye, but not a sideways spread. Within a surface, neighbours cover a sideways spread; at the
//! border of a surface nothing does. Therefore the cosine counts as at least [`SIDEWAYS`], and a border is off by at most
//! `1 / SIDEWAYS` times the accepted error. A bound that also holds sideways would be `e` for nearly all nodes.
//!
//! A node has few bits to spare. The spread is most of `e` for nearly all nodes, so it is taken as equal to `e`, and one number
//! remains to be stored, the *tilt* `a`:
//!
//! ```text
//! seen(α) = e · min(1, a · sin α + max(cos α, SIDEWAYS))
//! ```
//!
//! `a` is coded in half octaves from 1/256 on ([`code_of`]); the last code means infinite, an error that is independent of the
//! angle. The parts of the error that do not depend on the angle (colour contrast and what leaves stand for) make `a` larger.
//!
//! A child is drawn where its parent may not be accepted. That test uses the parent's normal and position, which the child does
//! not store. If the child took the parent's error for less than the parent does, there would be a gap. The child stores a bound
//! instead: a tilt for the parent relative to the child's normal ([`seen_from`]). With `θ` between the normals and `β` between
//! the child's normal and the direction to the parent,
//!
//! ```text
//! sin α ≤ sin β + sin θ cos β      max(cos α, S) ≤ max(cos β, S) + sin θ sin β
//! ```
//!
//! and with `a' ≥ a + 1.5 sin θ`, `a' ≥ a + (1 + 0.58 a) sin θ` the sum is below `a' sin β + max(cos β, S)` wherever that is
//! below 1: there `tan β/2 > a'`, so that `cot β < 1/(2a')`. From the way to the parent to the child's own it is a turn of at
//! most `δ/r`, which [`share_seen`] adds to both terms when a node is looked at.

use super::node::Node;
use glam::Vec3;

/// The least cosine that scales the spread.
pub const SIDEWAYS: f32 = 0.5;
/// Cosine passed for nodes whose error is the same from all directions.
pub const UNTILTED: f32 = 2.0;
/// Code of an infinite tilt: the error is the same from all directions.
pub(super) const ALIKE: u32 = 15;
/// Codes per octave, and the number of octaves below 1 at which the codes begin.
const STEPS: f32 = 2.0;
const OCTAVES: f32 = 8.0;
/// Rounding error of sines in shaders, and of stored normals.
pub(super) const SLACK: f32 = 0.004;
const NORMAL_SLACK: f32 = 3e-4;

/// The tilt of a code; infinite for [`ALIKE`].
fn decode(code: u32) -> f32 {
    if code >= ALIKE { f32::INFINITY } else { (code as f32 / STEPS - OCTAVES).exp2() }
}

/// The smallest code whose tilt is at least `tilt`.
fn code_of(tilt: f32) -> u32 {
    (0..ALIKE).find(|&code| decode(code) >= tilt).unwrap_or(ALIKE)
}

/// The code of a node's own tilt.
pub(super) fn of_node(node: &Node) -> u32 {
    let is_disk = node.level > 0 && node.normal != Vec3::ZERO && node.error > 0.0;
    if !is_disk || node.alike {
        return ALIKE;
    }
    // The angle-independent part exceeds the rest most at the angle where the cosine reaches its lower bound.
    let least_sine = (1.0 - SIDEWAYS * SIDEWAYS).sqrt();
    let even = (node.even / node.error - SIDEWAYS) / least_sine;
    code_of(1.0001 * (node.lift / node.error).max(even))
}

/// The code of the parent's tilt that a child with this normal stores.
pub(super) fn seen_from(parent: &Node, normal: Vec3) -> u32 {
    let own = of_node(parent);
    if own == ALIKE || normal == Vec3::ZERO {
        return ALIKE;
    }
    let sine = parent.normal.cross(normal).length() + NORMAL_SLACK;
    let own = decode(own);
    code_of(own + sine * (1.0 + 0.58 * own).max(1.5))
}

/// The fraction of a node's error seen at an angle with this cosine, or the largest fraction at any angle within `turn` radians
/// of it.
pub fn share_seen(code: u32, cosine: f32, turn: f32) -> f32 {
    if code == ALIKE {
        return 1.0;
    }
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (decode(code) * (sine + turn) + cosine.max(SIDEWAYS) + turn).min(1.0)
}

/// Decodes a node's own tilt code and its parent's from the node's words.
pub(super) fn of_words([error, size]: [u32; 2]) -> [u32; 2] {
    [error >> 26 & 15, error >> 30 | size >> 30 << 2]
}

/// The bits that the two words store of a node's own tilt and of its parent's.
pub(super) fn bits(own: u32, parent: u32) -> [u32; 2] {
    [own << 26 | parent << 30, parent >> 2 << 30]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn codes_hold_what_they_stand_for() {
        for code in 0..ALIKE {
            assert_eq!(code_of(decode(code)), code);
            assert_eq!(code_of(decode(code) * 1.01), code + 1);
        }
        assert_eq!(code_of(0.0), 0);
        for (own, parent) in (0..16).flat_map(|own| (0..16).map(move |parent| (own, parent))) {
            let [error, size] = bits(own, parent);
            assert_eq!(of_words([error | 0x3ff_ffff, size | 0x3fff_ffff]), [own, parent]);
            assert_eq!((error & 0x3ff_ffff, size & 0x3fff_ffff), (0, 0));
        }
    }

    fn unit(v: [f32; 3]) -> Vec3 {
        Vec3::from(v).try_normalize().unwrap_or(Vec3::Z)
    }

    fn node(normal: Vec3, lift: f32, spread: f32, even: f32) -> Node {
        let stands = super::super::Measures::default();
        let kernel = crate::assets::Kernel::default();
        let leaf = Node::leaf(
            glam::DVec3::ZERO,
            normal,
            [0; 4],
            &kernel,
            false,
            stands,
            super::super::node::Matter::Open,
        );
        let error = lift.hypot(spread).max(even);
        Node { lift, spread, even, error, level: 1, ..leaf }
    }

    proptest! {
        /// The coded share is at least the exact share of the formula.
        #[test]
        fn shares_hold_lift_and_spread(
            lift in 0f32..1.0, spread in 0f32..1.0, even in 0f32..1.0, angle in 0f32..1.57,
        ) {
            let node = node(Vec3::Z, lift, spread, even);
            let (sine, cosine) = angle.sin_cos();
            let seen = (lift * sine + spread * cosine.max(SIDEWAYS)).min(lift.hypot(spread)).max(even);
            let share = share_seen(of_node(&node), cosine, 0.0);
            prop_assert!(node.error * share >= seen * 0.9999, "{share} {seen} {}", node.error);
            prop_assert!((SIDEWAYS..=1.0).contains(&share));
        }

        /// For any eye and normals, a child never underestimates its parent's error.
        #[test]
        fn children_do_not_think_too_little_of_their_parents(
            lift in 0f32..1.0,
            near in prop::array::uniform3(-1f32..1.0),
            off in prop::array::uniform3(-1f32..1.0),
            bend in -12f32..1.0,
            eye in prop::array::uniform3(-1f32..1.0),
            aside in prop::array::uniform3(-1f32..1.0),
            distance in -3f32..9.0,
        ) {
            let normal = unit(near);
            let parent = node(normal, lift * lift, 1.0, 0.0);
            let child = (normal + unit(off) * bend.exp2()).try_normalize().unwrap_or(normal);
            // The parent is at the origin, the child beside it.
            let (eye, place) = (unit(eye) * distance.exp2(), unit(aside));
            let cosine = |normal: Vec3, way: Vec3| (normal.dot(way) / way.length()).abs().min(1.0);
            let seen = share_seen(of_node(&parent), cosine(normal, eye), 0.0);
            let way = eye - place;
            prop_assume!(way.length() > 1e-3);
            let turn = 1.0 / way.length() + SLACK;
            let thought = share_seen(seen_from(&parent, child), cosine(child, way), turn);
            prop_assert!(thought >= seen, "{thought} {seen}");
        }
    }
}
