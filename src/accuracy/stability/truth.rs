//! The exact results in f64, and bounds on their rounding errors in f32.
//!
//! The inputs are the f32 numbers themselves. Products of two of them are therefore exact in f64, and differences `t.x·p.z −
//! t.z·p.x` are exact to the last bit, however much cancels. The remaining cancellations (`α×ε` of a disk seen nearly edge-on, `1
//! − |β|²` of one that nearly crosses) lose digits by the same factor in f64 as in f32, and every bound below has that factor.
//! The truth's own error therefore relates to the bound as 2⁻⁵³ to 2⁻²⁴. Double-double numbers would change no printed digit. A
//! test compares all of this with 720 points of the rim.

use glam::{DVec2, Vec2, dvec2};

use super::cases::{Disk, Lens};

/// Outlines are compared within this distance of the image's origin, in pixels.
pub const GUARD_PX: f64 = (1 << 20) as f64;
/// The largest error of a clamped number.
const WIDTH_PX: f64 = 2.0 * GUARD_PX;

/// Whether an error may exceed a bound.
pub fn is_bounded(bound_px: f64) -> bool {
    bound_px < WIDTH_PX
}

/// Disks whose gap to the camera plane, relative to their depth, is at most this may count as crossing it. The value is twice the
/// `GAP` in `shared/splat`, below which `make_splat` treats splats as crossing.
const CLOSE: f64 = 1.0 / (1 << 17) as f64;

/// The unit roundoff of f32.
const U: f64 = f32::EPSILON as f64 / 2.0;

/// Roundings that the bounds allow in front of each first-order term. By the standard model (Higham, *Accuracy and Stability of
/// Numerical Algorithms*, section 2.2), `α` takes 4 roundings, `g` 7, and later products and sums at most 3 more. 8 covers each
/// term and the neglected second-order terms.
const STEPS: f64 = 8.0;

/// Number of directions in which outlines are compared.
pub const DIRECTIONS: usize = 16;

/// Unit vector number `i` of the [`DIRECTIONS`].
pub fn direction(i: usize) -> DVec2 {
    DVec2::from_angle(i as f64 * std::f64::consts::TAU / DIRECTIONS as f64)
}

/// The true position of a disk relative to the camera plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrueSide {
    Regular(Truth),
    Crosses,
    Behind,
    /// Too close to the border between the others for f32 to decide. Either answer is right.
    Close,
}

/// The image of a regular disk in f64. Everything is divided by the centre's depth `p.z` and relative to its image `P`:
///
/// ```text
/// x = f_x·F·(t.x − t.z·p.x/p.z)/p.z     how far the rim reaches in x, in px, over both tangents
/// y = f_y·F·(t.y − t.z·p.y/p.z)/p.z     how far it reaches in y, in px
/// z = F·t.z/p.z                         how far it reaches in depth, relative
/// gap = 1 − |z|²
/// ```
/// The point `σ` of the unit disk is seen at `P + (x·σ, y·σ)/(1 + z·σ)`. The outline's centre, box and shape are those of the
/// dual conic (Zwicker, Räsänen, Botsch, Dachsbacher and Pauly, *Perspective Accurate Splatting*, Graphics Interface 2004,
/// equations 7, 8 and 11).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    pub projected: DVec2,
    pub x: DVec2,
    pub y: DVec2,
    pub z: DVec2,
    pub gap: f64,
    focal_tan: DVec2,
    principal: DVec2,
    cutoff: f64,
}

/// Bounds on the errors of one disk, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    pub box_px: f64,
    pub centre_px: f64,
    pub outline_px: f64,
}

/// Classifies `disk`, and computes its image if it is regular.
pub fn truth(disk: &Disk, cutoff: f32, lens: &Lens) -> TrueSide {
    let (p, [u, v]) = (disk.centre.as_dvec3(), disk.tangents.map(|t| t.as_dvec3()));
    let cutoff = f64::from(cutoff);
    let z = dvec2(u.z, v.z) * cutoff / p.z;
    let gap = 1.0 - z.length_squared();
    let largest = p.abs().max(u.abs()).max(v.abs()).max_element();
    if largest > 0.0 && p.z != 0.0 && (gap.abs() <= CLOSE || p.z.abs() < largest * 1e-17) {
        return TrueSide::Close;
    }
    if p.z == 0.0 || gap <= 0.0 {
        return TrueSide::Crosses;
    }
    if p.z < 0.0 {
        return TrueSide::Behind;
    }
    let (focal, principal) = (lens.focal_px.as_dvec2(), lens.principal_px.as_dvec2());
    let reach =
        |a: f64, b: f64, at: f64, focal: f64| (a * p.z - b * at) / p.z / p.z * (focal * cutoff);
    let focal_tan = dvec2(p.x, p.y) / p.z * focal;
    TrueSide::Regular(Truth {
        projected: focal_tan + principal,
        x: dvec2(reach(u.x, u.z, p.x, focal.x), reach(v.x, v.z, p.x, focal.x)),
        y: dvec2(reach(u.y, u.z, p.y, focal.y), reach(v.y, v.z, p.y, focal.y)),
        z,
        gap,
        focal_tan,
        principal,
        cutoff,
    })
}

/// Clamps to the guard, including infinities. NaN stays.
pub fn hold(px: f64) -> f64 {
    let guard = GUARD_PX;
    if px > guard {
        guard
    } else if px < -guard {
        -guard
    } else {
        px
    }
}

impl Truth {
    /// How far the outline extends from the projected centre in direction `d`, both ways: `[−h(−d), h(d)]` with the support
    /// function `h`. The smaller end is computed from the product of the roots.
    pub fn extent(&self, d: DVec2) -> [f64; 2] {
        let reach = self.x * d.x + self.y * d.y;
        let slant = reach.dot(self.z);
        let square = reach.length_squared();
        let sum = slant.abs() + (square * self.gap + slant * slant).sqrt();
        if sum == 0.0 {
            return [0.0; 2];
        }
        let (far, near) = (sum / self.gap, square / sum);
        if slant > 0.0 { [-far, near] } else { [-near, far] }
    }

    /// The corners of the box, not clamped to the guard.
    pub fn corners(&self) -> [DVec2; 2] {
        let ([x0, x1], [y0, y1]) = (self.extent(DVec2::X), self.extent(DVec2::Y));
        [self.projected + dvec2(x0, y0), self.projected + dvec2(x1, y1)]
    }

    pub fn centre(&self) -> DVec2 {
        self.projected + self.off_centre()
    }

    fn off_centre(&self) -> DVec2 {
        -dvec2(self.x.dot(self.z), self.y.dot(self.z)) / self.gap
    }

    /// The outline's support function: the largest `d·x` on it.
    pub fn support(&self, d: DVec2) -> f64 {
        self.projected.dot(d) + self.extent(d)[1]
    }

    /// Image of the point `σ` of the unit disk, relative to the projected centre.
    pub fn seen(&self, sigma: DVec2) -> DVec2 {
        dvec2(self.x.dot(sigma), self.y.dot(sigma)) / (1.0 + self.z.dot(sigma))
    }

    /// The area `α×ε`.
    pub fn area(&self) -> f64 {
        self.x.perp_dot(self.y)
    }

    /// The matrix `V` in px²: xx, xy, yy.
    pub fn variance(&self) -> [f64; 3] {
        let element = |a: DVec2, b: DVec2| {
            (a.dot(b) + a.dot(self.z) * b.dot(self.z) / self.gap)
                / self.gap
                / (self.cutoff * self.cutoff)
        };
        [element(self.x, self.x), element(self.x, self.y), element(self.y, self.y)]
    }

    /// Bounds on the errors in f32.
    ///
    /// The coordinates are rounded: `u·(|principal| + f|tan| + |d|)`. `α` is a difference of products of size `f·|tan|·|β|`, and
    /// an extent is a norm of `α` (a support function) that is at most `2/g` times it: `u·(|α| + f|tan||β|)·2/g`. `g` has an
    /// absolute error of `7u`, and `|∂d/∂g| ≤ |d|/g`. The centre and the radii are at most `|α|/g`. Near the camera plane large
    /// values of them cancel in the outline, which the box avoids.
    pub fn bounds(&self) -> Bounds {
        let reach = (self.x.length_squared() + self.y.length_squared()).sqrt();
        let place = self.principal.length() + self.focal_tan.length();
        let input = (reach + self.focal_tan.length() * self.z.length()) / self.gap;
        // An end beyond the guard is clamped to it, so the error is at most the guard's width.
        let far = DVec2::from(self.extent(DVec2::X)).abs().max_element();
        let far = far.max(DVec2::from(self.extent(DVec2::Y)).abs().max_element());
        let cap = |px: f64| if is_bounded(px) { px } else { WIDTH_PX };
        let (gap, off) = (self.gap, self.off_centre().length());
        Bounds {
            box_px: cap(STEPS * U * (place + 2.0 * input + far + far / gap)),
            centre_px: cap(STEPS * U * (place + input + off + off / gap)),
            outline_px: cap(STEPS * U * (place + 4.0 * input + 2.0 * reach / (gap * gap))),
        }
    }

    /// The distance on screen, in pixels, from a pixel to the image of the coordinates `kernel` that a formula gave for it, and a
    /// bound on this distance by a running error analysis of Cramer's rule. The distance on screen measures the effect of an
    /// error in `(s, t)` on an image, however thin the disk is. It is infinite if the formula gave none. `None` where rounding the pixel's own
    /// coordinates already moves a quarter of the disk's extent, as where the disk is thinner than 10⁻⁴ px.
    pub fn kernel_error(&self, pixel: Vec2, kernel: Option<DVec2>) -> Option<(f64, f64)> {
        let pixel = pixel.as_dvec2();
        let d = pixel - self.projected;
        let (x, y, z) = (self.x, self.y, self.z);
        let facing = x.perp_dot(y) + d.x * (z.y * y.x - z.x * y.y) + d.y * (z.x * x.y - z.y * x.x);
        let sigma = dvec2(d.x * y.y - d.y * x.y, d.y * x.x - d.x * y.x) / facing;
        let error = |reach: DVec2, tan: f64| (reach.abs() + tan.abs() * z.abs()) * 4.0 * U;
        let (dx, dy) = (error(x, self.focal_tan.x), error(y, self.focal_tan.y));
        let (ax, ay, az, ad) = (x.abs(), y.abs(), z.abs(), d.abs());
        // |a|·|b| + |b|·|a| over the crossed components, and the effect of their errors.
        let crossed = |a: DVec2, b: DVec2| a.x * b.y + a.y * b.x;
        let facing_error = crossed(dx, ay)
            + crossed(ax, dy)
            + ad.x * crossed(az, dy)
            + ad.y * crossed(az, dx)
            + 8.0 * U * (crossed(ax, ay) + ad.x * crossed(az, ay) + ad.y * crossed(az, ax));
        if facing_error * 4.0 >= facing.abs() {
            return None;
        }
        let numerator_error = dvec2(
            ad.x * dy.y + ad.y * dx.y + 3.0 * U * (ad.x * ay.y + ad.y * ax.y),
            ad.y * dx.x + ad.x * dy.x + 3.0 * U * (ad.y * ax.x + ad.x * ay.x),
        );
        let place = self.principal.length() + self.focal_tan.length() + d.length();
        let (shift, nearness) = (3.0 * U * place, 1.0 + z.dot(sigma));
        // The rows of the matrix of Cramer's rule. Its inverse times `nearness` is ∂σ/∂d.
        let (row_x, row_y) = ((x - z * d.x).abs(), (y - z * d.y).abs());
        let moved = dvec2(row_y.y + row_x.y, row_x.x + row_y.x) * (shift * nearness);
        let sigma_error = (numerator_error + moved + sigma.abs() * facing_error) / facing.abs();
        if sigma_error.max_element() * 4.0 >= 1.0 || az.dot(sigma_error) * 4.0 >= nearness {
            return None;
        }
        let thrown = dvec2(row_x.dot(numerator_error), row_y.dot(numerator_error)).length();
        // The denominator's error moves σ in proportion, and each numerator's error moves it independently.
        let relative = d.length() * (facing_error / facing.abs() + 4.0 * U);
        let bound = (relative + thrown / facing.abs()) / nearness + shift;
        // A factor of two for the neglected second order.
        let error = |kernel: DVec2| (self.seen(kernel / self.cutoff) - d).length();
        Some((kernel.map_or(f64::INFINITY, error), 2.0 * bound))
    }
}
