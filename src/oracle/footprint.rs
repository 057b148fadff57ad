//! Kernels in the image: Gaussians in pixels, and the ways in which a disk becomes one.
//!
//! A [`Disk`] is a kernel's centre and tangents seen from the eye, in pixels relative to where the centre projects to:
//! the rows of the paper's mapping `M` (Zwicker et al. 2004, §4.1, equation 4), divided by the centre's depth and moved
//! so that the centre falls on the image's origin. Both leave the mapping what it is, and its numbers small.
//!
//! - [`Disk::affine`]: the derivative of the projection at the centre (Heckbert 1989).
//! - [`Disk::perspective`]: the cut-off's circle, as a conic, goes through `M⁻¹`; the ellipse that it becomes in the image
//!   is the Gaussian's contour at the same value (§4.3 and §4.4). Where `M` cannot be inverted for all practical
//!   purposes, because the disk is seen nearly edge-on or comes close to the camera plane, the conic's dual,
//!   which needs no inverse, gives the same ellipse.
//!
//! A [`Gaussian`] is kept by its principal axes. Widening it by the low-pass filter adds to both variances, so that no
//! matrix is inverted and thin ones lose nothing to cancellation.

use glam::{DMat2, DVec2, DVec3};

use crate::math::View;

/// The paper's inverse is used down to this ratio of the conic's determinant to its squared trace, where about
/// half of a double's digits are left.
const LEAST_DETERMINANT: f64 = 1e-8;

/// An elliptical Gaussian in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    pub centre_px: DVec2,
    /// Unit length.
    long_axis: DVec2,
    /// Along the long axis and across it, in square pixels.
    variances: [f64; 2],
}

impl Gaussian {
    /// From the variance matrix's entries `xx`, `xy`, `yy` and its determinant, which is not worked out from them because
    /// it may be far smaller than what it is the difference of.
    fn new(centre_px: DVec2, [xx, xy, yy]: [f64; 3], determinant: f64) -> Self {
        let greatest = 0.5 * (xx + yy + (xx - yy).hypot(2.0 * xy));
        let least = if greatest > 0.0 { determinant / greatest } else { 0.0 };
        let turn = 0.5 * (2.0 * xy).atan2(xx - yy);
        Self { centre_px, long_axis: DVec2::from_angle(turn), variances: [greatest, least] }
    }

    /// From the entries of the inverse of the variance matrix.
    fn from_inverse(centre_px: DVec2, [xx, xy, yy]: [f64; 3]) -> Self {
        let inverse = Self::new(centre_px, [xx, xy, yy], xx * yy - xy * xy);
        // The long axis becomes the short one, and the other way round.
        let [greatest, least] = inverse.variances;
        let variances = [1.0 / least, 1.0 / greatest];
        Self { long_axis: inverse.long_axis.perp(), variances, ..inverse }
    }

    /// Squared distance from the centre in standard deviations of this Gaussian widened by a low-pass filter.
    /// Not a number where a Gaussian without width is asked about its own axis.
    pub fn squared_distance(&self, from_centre_px: DVec2, lowpass_px: f64) -> f64 {
        let along = from_centre_px.dot(self.long_axis);
        let across = from_centre_px.dot(self.long_axis.perp());
        let [long, short] = self.variances.map(|variance| variance + lowpass_px * lowpass_px);
        along * along / long + across * across / short
    }

    /// The variance matrix, in square pixels.
    pub fn variance(&self) -> DMat2 {
        let (along, across) = (self.long_axis, self.long_axis.perp());
        let [long, short] = self.variances;
        let outer = |axis: DVec2| DMat2::from_cols(axis * axis.x, axis * axis.y);
        outer(along) * long + outer(across) * short
    }

    /// How much of its height the low-pass filter leaves, before any lower bound.
    pub fn amplitude(&self, lowpass_px: f64) -> f64 {
        let left = self.variances.map(|variance| variance / (variance + lowpass_px * lowpass_px));
        (left[0] * left[1]).sqrt()
    }

    /// Half the sides of the box around the contour at `cutoff` standard deviations.
    pub fn half_extent_px(&self, cutoff: f64, lowpass_px: f64) -> DVec2 {
        let [long, short] = self.variances.map(|variance| variance + lowpass_px * lowpass_px);
        let axis = self.long_axis;
        let across = axis.perp();
        let squares = axis * axis * long + across * across * short;
        DVec2::new(squares.x.sqrt(), squares.y.sqrt()) * cutoff
    }

    /// The low-pass filter's variance in standard deviations of the Gaussian, along its long axis and across it.
    pub fn lowpass_share(&self, lowpass_px: f64) -> [f64; 2] {
        self.variances.map(|variance| lowpass_px * lowpass_px / variance)
    }
}

/// A kernel as its mapping to the image, with the origin where its centre projects to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    pub centre_px: DVec2,
    /// Homogeneous: x and y in pixels, z in depths of the centre, which itself is (0, 0, 1).
    pub tangents: [DVec3; 2],
}

impl Disk {
    /// A kernel before the eye: `centre` and `tangents` have x to the right, y down and z, which is positive, forward. In a view of
    /// parallel rays the mapping is affine: its homogeneous parts are none.
    pub fn new(centre: DVec3, tangents: [DVec3; 2], view: &View) -> Disk {
        let View { focal_px, principal_px, .. } = *view;
        if view.is_orthographic() {
            let mapped = |tangent: DVec3| (tangent.truncate() * focal_px).extend(0.0);
            let centre_px = centre.truncate() * focal_px + principal_px;
            return Disk { centre_px, tangents: tangents.map(mapped) };
        }
        let direction = centre.truncate() / centre.z;
        let mapped = |tangent: DVec3| {
            ((tangent.truncate() - direction * tangent.z) * focal_px).extend(tangent.z) / centre.z
        };
        Disk { centre_px: direction * focal_px + principal_px, tangents: tangents.map(mapped) }
    }

    /// The projection's derivative at the centre: pixels for each unit of the kernel's coordinates.
    pub fn jacobian(&self) -> DMat2 {
        let [u, v] = self.tangents;
        DMat2::from_cols(u.truncate(), v.truncate())
    }

    /// The kernel under the projection's derivative at its centre.
    pub fn affine(&self) -> Gaussian {
        let jacobian = self.jacobian();
        let variance = jacobian * jacobian.transpose();
        let entries = [variance.x_axis.x, variance.x_axis.y, variance.y_axis.y];
        Gaussian::new(self.centre_px, entries, jacobian.determinant().powi(2))
    }

    /// Whether the kernel up to `cutoff` stays before the camera plane by more than the share `margin` of its depth.
    pub fn is_before_camera_plane(&self, cutoff: f64, margin: f64) -> bool {
        let [u, v] = self.tangents;
        cutoff * u.z.hypot(v.z) < 1.0 - margin
    }

    /// The Gaussian whose contour at `cutoff` is the outline's exact projection, for a kernel before the camera plane.
    pub fn perspective(&self, cutoff: f64) -> Gaussian {
        self.perspective_by_inverse(cutoff).unwrap_or_else(|| self.perspective_by_dual(cutoff))
    }

    /// Section 4.3 as the paper has it; `None` where the numbers do not bear it.
    pub fn perspective_by_inverse(&self, cutoff: f64) -> Option<Gaussian> {
        let [u, v] = self.tangents;
        // Rows of M⁻¹. As vectors are rows in the paper, `x = u M` is a combination of M's rows, here columns to solve for.
        let rows = [DVec3::X, DVec3::Y, DVec3::Z].map(|unit| solve([u, v, DVec3::Z], unit));
        let [x, y, w] = [rows[0]?, rows[1]?, rows[2]?];
        // Q'ₕ = M⁻¹ Qₕ M⁻ᵀ with Qₕ = diag(1, 1, −F²).
        let conic = |m: DVec3, n: DVec3| m.x * n.x + m.y * n.y - cutoff * cutoff * m.z * n.z;
        let (a, b, c) = (conic(x, x), conic(x, y), conic(y, y));
        let (d, e, f) = (conic(x, w), conic(y, w), -conic(w, w));
        let determinant = a * c - b * b;
        // NaN does not pass either.
        let sound = determinant > LEAST_DETERMINANT * (a + c) * (a + c);
        // Equation 7, and the scale that takes equation 10 to the value F².
        let centre = DVec2::new(b * e - c * d, b * d - a * e) / determinant;
        let scale = cutoff * cutoff / (f - d * centre.x - e * centre.y);
        let gaussian =
            Gaussian::from_inverse(self.centre_px + centre, [a, b, c].map(|entry| entry * scale));
        (sound && scale > 0.0 && scale.is_finite()).then_some(gaussian)
    }

    /// The ellipse from the lines that touch it: `C* = F²(t_uᵀt_u + t_vᵀt_v) − pᵀp`, where p is (0, 0, 1).
    pub fn perspective_by_dual(&self, cutoff: f64) -> Gaussian {
        let [u, v] = self.tangents;
        let (a, b, c) = (DVec2::new(u.x, v.x), DVec2::new(u.y, v.y), DVec2::new(u.z, v.z));
        let square = cutoff * cutoff;
        let corner = square * c.length_squared() - 1.0;
        let entry = |m: DVec2, n: DVec2| {
            (m.dot(n) - square * m.perp_dot(c) * n.perp_dot(c)) / (corner * corner)
        };
        let centre = DVec2::new(a.dot(c), b.dot(c)) * (square / corner);
        let determinant = a.perp_dot(b).powi(2) / corner.abs().powi(3);
        Gaussian::new(self.centre_px + centre, [entry(a, a), entry(a, b), entry(b, b)], determinant)
    }
}

/// The factors with which three vectors add up to `sum`, by elimination with the largest pivots; `None` where they
/// lie in one plane.
pub fn solve(vectors: [DVec3; 3], sum: DVec3) -> Option<DVec3> {
    let row = |i: usize| [vectors[0][i], vectors[1][i], vectors[2][i], sum[i]];
    let mut rows = [row(0), row(1), row(2)];
    for column in 0..3 {
        let pivot = (column..3).fold(column, |best, i| {
            if rows[i][column].abs() > rows[best][column].abs() { i } else { best }
        });
        rows.swap(column, pivot);
        let head = rows[column];
        if head[column] == 0.0 {
            return None;
        }
        for row in rows.iter_mut().skip(column + 1) {
            let factor = row[column] / head[column];
            for (value, above) in row.iter_mut().zip(head) {
                *value -= factor * above;
            }
        }
    }
    let [a, b, c] = rows;
    let z = c[3] / c[2];
    let y = (b[3] - b[2] * z) / b[1];
    let x = (a[3] - a[2] * z - a[1] * y) / a[0];
    let found = DVec3::new(x, y, z);
    found.is_finite().then_some(found)
}
