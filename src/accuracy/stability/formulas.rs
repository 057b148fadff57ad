//! Alternative formulas in plain f32, for comparison with the shaders'. They differ in where they suffer from cancellation.

use glam::{DVec2, Mat3, Vec2, Vec3, dvec2, vec2};

use super::cases::{Disk, Lens};

/// The paper's inverse is not used where `‖M‖·‖M⁻¹‖` (Frobenius) is above this. The paper gives no number (section 6: "above
/// a threshold"); at 10⁶ an inverse in f32 keeps one decimal digit.
pub const CONDITION_MAX: f32 = 1e6;

/// An outline as a formula gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    pub centre: Vec2,
    pub min: Vec2,
    pub max: Vec2,
    /// `F²·V`: xx, xy, yy.
    variance: [f32; 3],
}

impl Outline {
    /// The support function in direction `d`, evaluated in f64 so that only the formula's result is judged.
    pub fn support(&self, d: DVec2) -> f64 {
        let [xx, xy, yy] = self.variance.map(f64::from);
        let square = dvec2(xx * d.x + xy * d.y, xy * d.x + yy * d.y).dot(d);
        // Rounding may make a thin ellipse's matrix indefinite; NaN passes through this comparison.
        let square = if square < 0.0 { 0.0 } else { square };
        self.centre.as_dvec2().dot(d) + square.sqrt()
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.variance.iter().all(|v| v.is_finite())
            && self.centre.is_finite()
            && self.min.is_finite()
            && self.max.is_finite()
    }

    /// Builds the outline from the centre and `F²·V` in units of the image plane at depth 1.
    fn of_variance(centre: Vec2, variance: [f32; 3], lens: &Lens) -> Outline {
        let (focal, [xx, xy, yy]) = (lens.focal_px, variance);
        let centre = centre * focal + lens.principal_px;
        let (xx, xy, yy) = (xx * focal.x * focal.x, xy * focal.x * focal.y, yy * focal.y * focal.y);
        // There is no guard against a negative number: a shader's square root of it is NaN, which the report counts.
        let half = vec2(xx.sqrt(), yy.sqrt());
        Outline { centre, min: centre - half, max: centre + half, variance: [xx, xy, yy] }
    }
}

/// The dual conic with `|a·p.z − b·p.x|² − F²·(a×b)²` over `C*₃₃²`. Its large terms cancel algebraically, but it is still a
/// difference, and its centre comes from the elements of `C*`.
pub fn dual_difference(disk: &Disk, cutoff: f32, lens: &Lens) -> Outline {
    let (p, [u, v], square) = (disk.centre, disk.tangents, cutoff * cutoff);
    let (a, e, b) = (vec2(u.x, v.x), vec2(u.y, v.y), vec2(u.z, v.z));
    let c33 = square * b.dot(b) - p.z * p.z;
    let (across, down) = (a * p.z - b * p.x, e * p.z - b * p.y);
    let (ab, eb) = (a.perp_dot(b), e.perp_dot(b));
    let element = |value: f32| square * value / (c33 * c33);
    let centre = vec2(square * a.dot(b) - p.x * p.z, square * e.dot(b) - p.y * p.z) / c33;
    let variance = [
        element(across.dot(across) - square * ab * ab),
        element(across.dot(down) - square * ab * eb),
        element(down.dot(down) - square * eb * eb),
    ];
    Outline::of_variance(centre, variance, lens)
}

/// The dual conic formed directly, with `V` from its elements.
pub fn dual_naive(disk: &Disk, cutoff: f32, lens: &Lens) -> Outline {
    let (p, [u, v], square) = (disk.centre, disk.tangents, cutoff * cutoff);
    let element = |i: usize, j: usize| square * (u[i] * u[j] + v[i] * v[j]) - p[i] * p[j];
    let c33 = element(2, 2);
    let c = vec2(element(0, 2), element(1, 2)) / c33;
    let variance = [
        c.x * c.x - element(0, 0) / c33,
        c.x * c.y - element(0, 1) / c33,
        c.y * c.y - element(1, 1) / c33,
    ];
    Outline::of_variance(c, variance, lens)
}

/// The paper's own formulas, sections 4.3 and 4.4: `Q' = M⁻¹·diag(1, 1, −F²)·M⁻¹ᵀ`, its centre by equation 7, its shape by
/// equation 11. `None` where the paper discards the splat: the condition number is above [`CONDITION_MAX`], or the conic is not
/// an ellipse.
pub fn paper(disk: &Disk, cutoff: f32, lens: &Lens) -> Option<Outline> {
    let [u, v] = disk.tangents;
    let p = disk.centre;
    // The rows of M are u, v and p. The columns of its inverse are their cross products over the determinant.
    let (vp, pu, uv) = (v.cross(p), p.cross(u), u.cross(v));
    let det = u.dot(vp);
    let inverse = Mat3::from_cols(vp / det, pu / det, uv / det);
    let norm = |columns: [Vec3; 3]| columns.iter().map(|c| c.dot(*c)).sum::<f32>().sqrt();
    let [i, j, k] = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
    let condition = norm([u, v, p]) * norm([i, j, k]);
    // Written so that NaN, which a determinant of zero gives, counts as above the threshold.
    if !matches!(condition.partial_cmp(&CONDITION_MAX), Some(std::cmp::Ordering::Less)) {
        return None;
    }
    let square = cutoff * cutoff;
    let element = |r: usize, c: usize| i[r] * i[c] + j[r] * j[c] - square * k[r] * k[c];
    let (a, b, c) = (element(0, 0), element(0, 1), element(1, 1));
    let (d, e, f) = (element(0, 2), element(1, 2), -element(2, 2));
    let discriminant = a * c - b * b;
    if discriminant <= 0.0 {
        return None;
    }
    let centre = vec2(b * e - c * d, b * d - a * e) / discriminant;
    let scale = (f - d * centre.x - e * centre.y) / discriminant;
    Some(Outline::of_variance(centre, [c * scale, -b * scale, a * scale], lens))
}
