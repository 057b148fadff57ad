//! The outline of a disk in the image, in f32, from operations that a shader has, with a guard for each extreme.
//!
//! A splat is a disk with centre `p` and tangents `t_u`, `t_v` in camera space (x right, y down, z forward, the eye at
//! 0), cut off where `u² + v² = F²`. Its outline on screen is an ellipse as long as it does not reach the
//! camera plane. Zwicker, Räsänen, Botsch, Dachsbacher and Pauly, *Perspective Accurate Splatting* (Graphics
//! Interface 2004), find it in section 4.3 through the inverse of `M = [t_u; t_v; p]`, which does not exist for a disk
//! seen edge-on. Here nothing is inverted, and what would cancel in floating point is cancelled on paper.
//!
//! Everything is divided by `p.z` and taken relative to the projected centre `P`. What is left of the disk are three vectors
//! over the two tangents:
//!
//! ```text
//! α = f_x·F·(t.x − t.z·p.x/p.z)/p.z     how far the rim reaches in x, in px     (a of the dual conic, sheared)
//! ε = f_y·F·(t.y − t.z·p.y/p.z)/p.z     how far it reaches in y, in px          (e of the dual conic, sheared)
//! β = F·t.z/p.z                         how far it reaches in depth, relative   (b of the dual conic)
//! g = 1 − |β|²                          the gap to the camera plane: −C*₃₃/p.z²
//! ```
//! A point `σ` of the unit disk is seen at `P + (α·σ, ε·σ)/(1 + β·σ)`. From the dual conic `C* = [α;ε;β][α;ε;β]ᵀ − e₃e₃ᵀ`:
//!
//! ```text
//! centre     c − P = −(α·β, ε·β)/g                              (equation 7)
//! box        x − P: roots of g·x² + 2(α·β)x − |α|² = 0          (equation 8)
//! shape      F²·V = (α·ε + (α·β)(ε·β)/g)/g, element by element   (Q''' of equation 11, inverted)
//! ```
//! All sums under the roots have terms of one sign, so that nothing under a root turns negative; `V = K·Kᵀ` with
//! `K = [α;ε]·(I + ββᵀ/(√g(1+√g)))/√g/F`, because that matrix squared is `(I + ββᵀ/g)/g`. The columns of `F·K` are
//! two conjugate radii of the outline, and `det V = (α×ε)²/(F⁴·g³)`, which is `f_x²·f_y²·D²/|C*₃₃|³` with
//! `D = p·(t_u×t_v)`.
//!
//! WGSL leaves overflow, infinities and NaN undefined, so none is ever made: a power of two brings the largest coordinate
//! near 1, [`Side::Crosses`] takes what is too close to the camera plane, and what would still be too long shrinks
//! as a whole.

use glam::{Vec2, Vec3, vec2};

/// Disks whose gap is not above this go the way of those that cross: the rounding errors of `g` are up to 7·2⁻²⁴.
pub const GAP_MIN: f32 = power_of_two(-20);

/// Depths of the centre below this part of the largest coordinate go that way, too: `p.x/p.z` stays finite.
pub const DEPTH_MIN: f32 = power_of_two(-60);

/// Lengths on screen are held within this many pixels, so that their squares over `GAP_MIN` squared are finite. At this
/// size a rounding error is 2¹⁶ px: nothing is known of such an outline but that it is large.
pub const LENGTH_MAX_PX: f32 = power_of_two(40);

/// Boxes are held within this many pixels of the image's origin.
pub const GUARD_PX: f32 = power_of_two(20);

/// Kernel coordinates from this many cutoffs on are none.
const KERNEL_MAX: f32 = power_of_two(30);

const fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((127 + exponent) as u32) << 23)
}

/// The part of a camera that the image of a disk depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Pixels for a tangent of 1, positive.
    pub focal_px: Vec2,
    /// Where the viewing direction meets the image.
    pub principal_px: Vec2,
}

/// A disk in camera space. Its tangents are as long as its kernel's standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    pub centre: Vec3,
    pub tangents: [Vec3; 2],
}

/// How a disk lies to the camera plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Side {
    /// Wholly in front of it.
    Regular(ImageDisk),
    /// It reaches the plane, or comes so close that rounding hides on which side it ends.
    Crosses,
    /// Wholly behind it.
    Behind,
}

/// A regular disk as the image sees it, relative to its projected centre (`α`, `ε`, `β`, `g` of the module's description).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageDisk {
    /// Where the disk's centre is seen. Not the middle of the outline.
    pub projected_px: Vec2,
    /// α
    pub reach_x_px: Vec2,
    /// ε
    pub reach_y_px: Vec2,
    /// β, shorter than 1
    pub reach_z: Vec2,
    /// g, above [`GAP_MIN`]
    pub gap: f32,
    /// F
    pub cutoff: f32,
}

/// The outline of a regular disk: an ellipse, possibly of no width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageConic {
    pub centre_px: Vec2,
    /// Conjugate radii: the outline is `centre + cos·radii[0] + sin·radii[1]`.
    pub radii_px: [Vec2; 2],
    /// `V_xx`, `V_xy`, `V_yy` in px²; the outline is at `F²`.
    pub variance_px2: [f32; 3],
    /// `sqrt(det V)` in px², from the exact identity and not from the elements, which cancel.
    pub root_det_px2: f32,
    /// The corners of the smallest box around the outline, held within [`GUARD_PX`].
    pub min_px: Vec2,
    pub max_px: Vec2,
}

/// Held within the guard (WGSL's `clamp`).
fn hold(v: Vec2) -> Vec2 {
    v.min(Vec2::splat(GUARD_PX)).max(Vec2::splat(-GUARD_PX))
}

/// The power of two that brings `largest` (not negative) into `[1, 4)`, or as near as one normal factor can.
fn scale_to_one(largest: f32) -> f32 {
    let exponent = ((largest.to_bits() >> 23) & 255).clamp(1, 253);
    f32::from_bits((254 - exponent) << 23)
}

impl Disk {
    /// Sees the disk through `lens`, cut off at `cutoff` (F, positive and sane). Any finite disk gives finite numbers.
    pub fn seen(&self, cutoff: f32, lens: &Lens) -> Side {
        let [u, v] = self.tangents;
        let largest = self.centre.abs().max(u.abs()).max(v.abs()).max_element();
        // The image does not depend on a common factor, and one that is a power of two rounds nothing.
        let scale = scale_to_one(largest);
        let (p, u, v) = (self.centre * scale, u * scale, v * scale);
        let depth = p.z.abs();
        let deep = cutoff * u.z.abs().max(v.z.abs());
        if depth < DEPTH_MIN || deep >= depth {
            return Side::Crosses;
        }
        let per_depth = cutoff / p.z;
        let reach_z = vec2(u.z * per_depth, v.z * per_depth);
        let gap = 1.0 - reach_z.dot(reach_z);
        if gap <= GAP_MIN {
            return Side::Crosses;
        }
        if p.z < 0.0 {
            return Side::Behind;
        }
        let (x, y, focal) = (p.x / p.z, p.y / p.z, lens.focal_px);
        let reach_x = vec2(u.x - u.z * x, v.x - v.z * x) * (focal.x * per_depth);
        let reach_y = vec2(u.y - u.z * y, v.y - v.z * y) * (focal.y * per_depth);
        let offset = vec2(x, y) * focal;
        // What is too long shrinks as a whole, towards the principal point: a disk that covers the image still does, while
        // components held one by one would make a line of it.
        let longest = offset.abs().max(reach_x.abs()).max(reach_y.abs()).max_element();
        let shrink = LENGTH_MAX_PX / longest.max(LENGTH_MAX_PX);
        Side::Regular(ImageDisk {
            projected_px: offset * shrink + lens.principal_px,
            reach_x_px: reach_x * shrink,
            reach_y_px: reach_y * shrink,
            reach_z,
            gap,
            cutoff,
        })
    }
}

/// Both ends, relative to the projected centre, of a disk's extent along a direction in which it reaches `reach`:
/// the root of larger size by the usual formula, the other from their product, which is `−|reach|²/g`. The usual formula
/// would take the difference of two large numbers for it where the disk nearly reaches the camera plane.
fn extent(reach: Vec2, reach_z: Vec2, gap: f32) -> [f32; 2] {
    let (slant, square) = (reach.dot(reach_z), reach.dot(reach));
    let root = (square * gap + slant * slant).sqrt();
    let sum = slant.abs() + root;
    // Squares of less than 2⁻⁶³ px vanish: so does the disk.
    if sum <= 0.0 {
        return [0.0; 2];
    }
    let (far, near) = (sum / gap, square / sum);
    if slant > 0.0 { [-far, near] } else { [-near, far] }
}

impl ImageDisk {
    /// Centre, box, shape and determinant.
    pub fn conic(&self) -> ImageConic {
        let (x, y, z) = (self.reach_x_px, self.reach_y_px, self.reach_z);
        let (root_gap, cutoff) = (self.gap.sqrt(), self.cutoff);
        let (slant_x, slant_y) = (x.dot(z), y.dot(z));
        let stretch = 1.0 / (root_gap * (1.0 + root_gap));
        let radius = |i: usize| {
            let along = z[i] * stretch;
            vec2(x[i] + slant_x * along, y[i] + slant_y * along) / root_gap
        };
        let radii = [radius(0), radius(1)];
        let (k, l) = (radii[0] / cutoff, radii[1] / cutoff);
        let ([x_min, x_max], [y_min, y_max]) = (extent(x, z, self.gap), extent(y, z, self.gap));
        let area = x.x * y.y - x.y * y.x;
        ImageConic {
            centre_px: self.projected_px - vec2(slant_x, slant_y) / self.gap,
            radii_px: radii,
            variance_px2: [k.x * k.x + l.x * l.x, k.x * k.y + l.x * l.y, k.y * k.y + l.y * l.y],
            root_det_px2: area.abs() / (cutoff * cutoff) / (self.gap * root_gap),
            min_px: hold(self.projected_px + vec2(x_min, y_min)),
            max_px: hold(self.projected_px + vec2(x_max, y_max)),
        }
    }

    /// The exact kernel coordinates `(s, t)` of what is seen at a pixel, from `[α;ε]σ = d(1 + β·σ)` by Cramer's rule with
    /// `d` the way from the projected centre. `None` where they are beyond 2³⁰·F, as everywhere on a disk seen exactly
    /// edge-on: no pixel is covered there.
    pub fn kernel_at(&self, pixel_px: Vec2) -> Option<Vec2> {
        let d = pixel_px - self.projected_px;
        let (x, y, z) = (self.reach_x_px, self.reach_y_px, self.reach_z);
        let s = d.x * y.y - d.y * x.y;
        let t = d.y * x.x - d.x * y.x;
        // N: proportional to r·n, linear over the image.
        let facing =
            (x.x * y.y - x.y * y.x) + d.x * (z.y * y.x - z.x * y.y) + d.y * (z.x * x.y - z.y * x.x);
        // Compared before the division, which could overflow.
        if s.abs().max(t.abs()) >= facing.abs() * KERNEL_MAX {
            return None;
        }
        Some(vec2(s, t) / facing * self.cutoff)
    }
}

#[cfg(test)]
#[path = "conic_tests.rs"]
mod tests;
