//! Reconstruction kernels and clip lines in 32 bits each.
//!
//! A kernel's axes lie in the tangent plane, so two lengths and an angle describe it in addition to the normal. Lengths are
//! stored as logarithms below the chunk's largest (11 bits, steps of 1/128 octave, 0 for none: an error of at most 0.27 % over 16
//! octaves). The angle is stored as a rational parameter (10 bits, 0.002 rad) against a frame that follows from the normal alone
//! (Duff et al. 2017, "Building an orthonormal basis, revisited"), decoded as in the shader. A clip line takes 16 bits for its
//! direction and 16 for its offset.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use crate::assets::{Clip, ClipLine, Kernel};

/// Codes per octave.
const STEPS: f32 = 128.0;
/// Largest code of a length.
const LENGTH_MASK: u32 = 0x7ff;
/// Number of values of the angle's parameter on either side of 0.
const ANGLE_STEPS: f32 = 511.0;
/// Offsets of clip lines are stored up to this many standard deviations.
pub(super) const OFFSET_RANGE: f32 = 8.0;
/// The word for a missing clip line: it keeps everything.
pub const NO_LINE: u32 = 0x8000;

/// The tangent frame that follows from a unit normal.
pub fn frame(n: Vec3) -> (Vec3, Vec3) {
    let s = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + s * n.x * n.x * a, s * b, -s * n.x), Vec3::new(b, s + n.y * n.y * a, -n.y))
}

/// Lengths of a kernel's axes; zero if not finite.
pub fn lengths(kernel: &Kernel) -> (f32, f32) {
    // The squares could underflow or overflow in f32.
    let length = |axis: Vec3| {
        Some(axis.as_dvec3().length() as f32).filter(|length| length.is_finite()).unwrap_or(0.0)
    };
    (length(kernel.u), length(kernel.v))
}

fn length_code(length: f32, base: f32) -> u32 {
    if !(length > 0.0 && base > 0.0) {
        return 0;
    }
    let below = (base / length).log2().max(0.0) * STEPS;
    1 + (below.round() as u32).min(LENGTH_MASK - 1)
}

/// The stored angle of a kernel's first axis against the normal's own frame: the tangent of half the angle.
fn angle_parameter(kernel: &Kernel, normal: Vec3) -> i32 {
    if normal == Vec3::ZERO || lengths(kernel).0 == 0.0 { 0 } else { turn(kernel, normal) }
}

/// Computes [`angle_parameter`] for a non-zero first axis and normal.
fn turn(kernel: &Kernel, normal: Vec3) -> i32 {
    let (t, b) = frame(normal);
    let (x, y) = (f64::from(kernel.u.dot(t)), f64::from(kernel.u.dot(b)));
    // Either a direction or its opposite lies within a quarter turn.
    let (x, y) = if x < 0.0 { (-x, -y) } else { (x, y) };
    let below = x + (x * x + y * y).sqrt();
    if below > 0.0 {
        ((y / below).clamp(-1.0, 1.0) * f64::from(ANGLE_STEPS)).round() as i32
    } else {
        0
    }
}

/// Encodes a kernel. The pair holds its axes' lengths ([`lengths`]); `normal` is the normal as the GPU decodes it, or zero;
/// `base` is the longest axis of the chunk in the units of `kernel`.
pub fn kernel_word(kernel: &Kernel, (u, v): (f32, f32), normal: Vec3, base: f32) -> u32 {
    let angle = if normal == Vec3::ZERO || u == 0.0 { 0 } else { turn(kernel, normal) };
    length_code(u, base) | length_code(v, base) << 11 | ((angle + ANGLE_STEPS as i32) as u32) << 22
}

/// The code of a kernel's longer axis, from its word: steps of 1/128 octave below the chunk's longest, from 1 on; `None` if it
/// has no extent.
pub fn longer_axis(word: u32) -> Option<u32> {
    [word & LENGTH_MASK, word >> 11 & LENGTH_MASK].into_iter().filter(|&code| code > 0).min()
}

/// The word of a circular kernel; the direction of its axes does not matter.
pub fn circle_word(radius: f32, base: f32) -> u32 {
    let code = length_code(radius, base);
    code | code << 11 | (ANGLE_STEPS as u32) << 22
}

/// The unit axes that the GPU gives a kernel.
fn stored_axes(kernel: &Kernel, normal: Vec3) -> (Vec3, Vec3) {
    let (t, b) = frame(normal);
    let p = angle_parameter(kernel, normal) as f32 / ANGLE_STEPS;
    let (cos, sin) = ((1.0 - p * p) / (1.0 + p * p), 2.0 * p / (1.0 + p * p));
    (cos * t + sin * b, cos * b - sin * t)
}

/// The kernel of a word, in the units of `base`.
pub(super) fn decode(word: u32, normal: Vec3, base: f32) -> Kernel {
    let length = |code: u32| {
        if code == 0 { 0.0 } else { base * ((1.0 - code as f32) / STEPS).exp2() }
    };
    let (t, b) = frame(normal);
    let p = ((word >> 22) as f32 - ANGLE_STEPS) / ANGLE_STEPS;
    let (cos, sin) = ((1.0 - p * p) / (1.0 + p * p), 2.0 * p / (1.0 + p * p));
    Kernel {
        u: (cos * t + sin * b) * length(word & LENGTH_MASK),
        v: (cos * b - sin * t) * length(word >> 11 & LENGTH_MASK),
    }
}

fn line_word(line: Option<ClipLine>, signs: Vec2) -> u32 {
    let Some(line) = line else { return NO_LINE };
    let normal = line.normal * signs;
    let angle = normal.y.atan2(normal.x);
    if !(angle.is_finite() && line.offset.is_finite()) {
        return NO_LINE;
    }
    let direction = ((angle / TAU * 65536.0).round() as i32 & 0xffff) as u32;
    // The smallest value is reserved for no line.
    let offset = (line.offset / OFFSET_RANGE).clamp(-1.0, 1.0) * 32767.0;
    direction << 16 | u32::from(offset.round() as i16 as u16)
}

/// Encodes clip lines in the coordinates of the stored kernel, whose axes may be reversed. Ascending words mean the intersection
/// of what the lines keep, descending words the union.
pub fn clip_words(clip: &Clip, kernel: &Kernel, normal: Vec3) -> [u32; 2] {
    let mut signs = Vec2::ONE;
    if normal != Vec3::ZERO {
        let (u, v) = stored_axes(kernel, normal);
        let sign = |cosine: f32| if cosine < 0.0 { -1.0 } else { 1.0 };
        signs = Vec2::new(sign(kernel.u.dot(u)), sign(kernel.v.dot(v)));
    }
    let [a, b] = clip.lines.map(|line| line_word(line, signs));
    let (low, high) = (a.min(b), a.max(b));
    if clip.either && a != NO_LINE && b != NO_LINE { [high, low] } else { [low, high] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn length_of(code: u32, base: f32) -> f32 {
        if code == 0 { 0.0 } else { base * ((1.0 - code as f32) / STEPS).exp2() }
    }

    /// Decodes a word as the shader does.
    fn decoded(word: u32, normal: Vec3, base: f32) -> Kernel {
        let (t, b) = frame(normal);
        let p = ((word >> 22) as f32 - ANGLE_STEPS) / ANGLE_STEPS;
        let (cos, sin) = ((1.0 - p * p) / (1.0 + p * p), 2.0 * p / (1.0 + p * p));
        Kernel {
            u: (cos * t + sin * b) * length_of(word & LENGTH_MASK, base),
            v: (cos * b - sin * t) * length_of(word >> 11 & LENGTH_MASK, base),
        }
    }

    fn word_of(kernel: &Kernel, normal: Vec3) -> u32 {
        kernel_word(kernel, lengths(kernel), normal, 1.0)
    }

    proptest! {
        #[test]
        fn kernels_survive_but_for_rounding(
            n in prop::array::uniform3(-1f32..1.0),
            angle in 0f32..TAU,
            long in 1e-3f32..1.0,
            ratio in 1e-3f32..1.0,
        ) {
            let Some(n) = Vec3::from(n).try_normalize() else { return Ok(()) };
            let (t, b) = frame(n);
            let direction = angle.cos() * t + angle.sin() * b;
            let kernel = Kernel { u: direction * long, v: n.cross(direction) * long * ratio };
            let found = decoded(word_of(&kernel, n), n, 1.0);
            let turned = if found.u.dot(kernel.u) < 0.0 { -1.0 } else { 1.0 };
            prop_assert!((found.u * turned - kernel.u).length() < 0.006 * long);
            // A shorter axis is stored with the shortest length.
            let stored = kernel.v * (length_of(LENGTH_MASK, 1.0) / (long * ratio)).max(1.0);
            prop_assert!((found.v * turned - stored).length() < 0.006 * stored.length());
        }

        #[test]
        fn lines_keep_their_side(
            angle in 0f32..TAU, line_angle in 0f32..TAU, offset in -3f32..3.0, flip in any::<bool>(),
        ) {
            let n = Vec3::new(0.3, -0.5, 0.7).normalize_or_zero();
            let (t, b) = frame(n);
            let u = angle.cos() * t + angle.sin() * b;
            let v = n.cross(u) * if flip { -1.0 } else { 1.0 };
            let kernel = Kernel { u, v: v * 0.5 };
            let normal = Vec2::new(line_angle.cos(), line_angle.sin());
            let clip = Clip { lines: [Some(ClipLine { normal, offset }), None], either: false };
            let [low, high] = clip_words(&clip, &kernel, n);
            prop_assert!(low <= high);
            let word = if low == NO_LINE { high } else { low };
            let stored = decoded(word_of(&kernel, n), n, 1.0);
            let direction = (word >> 16) as f32 / 65536.0 * TAU;
            let found = (word as u16 as i16) as f32 / 32767.0 * OFFSET_RANGE;
            // Checks a point on the line and one well inside.
            for (inside, at) in [(0.0, normal * offset), (1.0, normal * (offset + 1.0))] {
                let point = kernel.u * at.x + kernel.v * at.y;
                let s = point.dot(stored.u) / stored.u.length_squared();
                let t = point.dot(stored.v) / stored.v.length_squared();
                let side = direction.cos() * s + direction.sin() * t - found;
                prop_assert!((side - inside).abs() < 0.06, "{side} {inside}");
            }
        }
    }

    #[test]
    fn what_is_no_kernel_is_nothing() {
        let n = Vec3::Z;
        assert_eq!(word_of(&Kernel::default(), n) & 0x3f_ffff, 0);
        let broken = Kernel { u: Vec3::NAN, v: Vec3::X };
        assert_eq!(word_of(&broken, n) & LENGTH_MASK, 0);
        let flat = Kernel { u: Vec3::X, v: Vec3::ZERO };
        assert_eq!(word_of(&flat, n) & 0x3f_ffff, 1);
        let tiny = Kernel { u: Vec3::X, v: Vec3::Y * 1e-30 };
        assert_eq!(word_of(&tiny, n) >> 11 & LENGTH_MASK, LENGTH_MASK, "the shortest");
        assert_eq!(clip_words(&Clip::NONE, &flat, n), [NO_LINE; 2]);
    }

    #[test]
    fn two_lines_tell_both_from_either() {
        let line = |x: f32| Some(ClipLine { normal: Vec2::new(x, 0.0), offset: -0.5 });
        let kernel = Kernel { u: Vec3::X, v: Vec3::Y };
        for (lines, either) in [
            ([line(1.0), line(-1.0)], false),
            ([line(-1.0), line(1.0)], true),
            ([line(1.0), line(-1.0)], true),
        ] {
            let [first, second] = clip_words(&Clip { lines, either }, &kernel, Vec3::Z);
            assert_eq!(first > second, either);
        }
        let one = clip_words(&Clip { lines: [line(-1.0), None], either: true }, &kernel, Vec3::Z);
        assert!(one[0] < one[1]);
    }
}
