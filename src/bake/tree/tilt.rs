//! Errors by the angle that a node is seen at: the split error mode (Dachsbacher et al. 2003, §3.4, §3.7).
//!
//! Of a node's error `e = √(lift² + spread²)` an eye that looks along the normal sees the spread, and one in the plane the lift. At an
//! angle `α` between view and normal the paper takes `lift · sin α + spread · cos α`. The second term is what a spread towards the eye is
//! foreshortened to; one sideways is not. Within a surface the neighbours lie there, where it ends nothing does. So the cosine
//! counts as no less than [`SIDEWAYS`], and an end is at most `1 / SIDEWAYS` times as far off as was accepted. A bound that holds
//! sideways too is `e` for nearly all nodes.
//!
//! A node has little room: since the spread is most of `e` for nearly all, it is taken for all of it, and what is left to know is one
//! number, the *tilt* `a`:
//!
//! ```text
//! seen(α) = e · min(1, a · sin α + max(cos α, SIDEWAYS))
//! ```
//!
//! in half octaves from 1/256 on ([`code_of`]), or without an end: the same from all sides. What is the same from all sides in part,
//! contrast of colours and what leaves stand for, makes `a` larger.
//!
//! A child is drawn where its parent may not be accepted, by the parent's own normal and place, which it does not know; where it
//! took the parent's error for less than the parent does, there would be a gap. It holds a bound instead: a tilt for the parent
//! against the child's normal ([`seen_from`]). With `θ` between the normals and `β` between the child's normal and the way to
//! the parent,
//!
//! ```text
//! sin α ≤ sin β + sin θ cos β      max(cos α, S) ≤ max(cos β, S) + sin θ sin β
//! ```
//!
//! and with `a' ≥ a + 1.5 sin θ`, `a' ≥ a + (1 + 0.58 a) sin θ` the sum is below `a' sin β + max(cos β, S)` wherever that is below 1: there
//! `tan β/2 > a'`, so that `cot β < 1/(2a')`. From the way to the parent to the child's own it is a turn of at most `δ/r`, which
//! [`share_seen`] adds to both terms when a node is looked at.

use super::node::Node;
use glam::Vec3;

/// The least cosine that a spread counts with.
pub const SIDEWAYS: f32 = 0.5;
/// A cosine for nodes whose errors are the same from all sides.
pub const UNTILTED: f32 = 2.0;
/// Without an end.
pub(super) const ALIKE: u32 = 15;
/// Codes of an octave, and the octaves that they begin below 1.
const STEPS: f32 = 2.0;
const OCTAVES: f32 = 8.0;
/// What a shader may lose of sines, and stored normals of directions.
pub(super) const SLACK: f32 = 0.004;
const NORMAL_SLACK: f32 = 3e-4;

/// The tilt of a code; infinite for [`ALIKE`].
fn decode(code: u32) -> f32 {
    if code >= ALIKE { f32::INFINITY } else { (code as f32 / STEPS - OCTAVES).exp2() }
}

/// The least code that stands for no less than `tilt`.
fn code_of(tilt: f32) -> u32 {
    (0..ALIKE).find(|&code| decode(code) >= tilt).unwrap_or(ALIKE)
}

/// A node's own code.
pub(super) fn of_node(node: &Node) -> u32 {
    let is_disk = node.level > 0 && node.normal != Vec3::ZERO && node.error > 0.0;
    if !is_disk || node.alike {
        return ALIKE;
    }
    // What is the same from all sides is the most above the rest where the cosine ends to count.
    let least_sine = (1.0 - SIDEWAYS * SIDEWAYS).sqrt();
    let even = (node.even / node.error - SIDEWAYS) / least_sine;
    code_of(1.0001 * (node.lift / node.error).max(even))
}

/// The code that a child of this normal has of its parent.
pub(super) fn seen_from(parent: &Node, normal: Vec3) -> u32 {
    let own = of_node(parent);
    if own == ALIKE || normal == Vec3::ZERO {
        return ALIKE;
    }
    let sine = parent.normal.cross(normal).length() + NORMAL_SLACK;
    let own = decode(own);
    code_of(own + sine * (1.0 + 0.58 * own).max(1.5))
}

/// Which part of a node's error is seen at an angle of this cosine, or at most at one that is `turn` away from it (in radians).
pub fn share_seen(code: u32, cosine: f32, turn: f32) -> f32 {
    if code == ALIKE {
        return 1.0;
    }
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (decode(code) * (sine + turn) + cosine.max(SIDEWAYS) + turn).min(1.0)
}

/// A node's code and its parent's, of its words.
pub(super) fn of_words([error, size]: [u32; 2]) -> [u32; 2] {
    [error >> 26 & 15, error >> 30 | size >> 30 << 2]
}

/// What the two words say of a node's own tilt and of its parent's.
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
            super::super::coverage::Matter::Open,
        );
        let error = lift.hypot(spread).max(even);
        Node { lift, spread, even, error, level: 1, ..leaf }
    }

    proptest! {
        /// The coded share is no less than what the formula says.
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

        /// Whatever the eye and the normals, a child takes its parent's error for no less than the parent does.
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
            // The parent in the origin, the child beside it.
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
