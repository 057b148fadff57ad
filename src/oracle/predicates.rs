//! Signs of determinants, exact.
//!
//! Coverage is decided by the side of an edge's plane on which a ray passes. Rounded, three such answers
//! may contradict each other around a vertex, and a pixel is covered twice or not at all. Here a floating-point
//! filter answers nearly always; what it cannot decide is summed without rounding as a multi-term expansion
//! (Shewchuk, *Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997, section 2).
//! A ray that meets an edge is moved by an infinitesimal (ε, ε², ε³) (Edelsbrunner and Mücke, *Simulation of
//! Simplicity*, 1990), the same for all triangles, so that exactly one of two neighbours has it.

use std::cmp::Ordering;

use glam::DVec3;

/// The sign of `a · (b × c)`: −1, 0 or 1. Exact while no product of three coordinates under- or overflows.
pub fn volume_sign(a: DVec3, b: DVec3, c: DVec3) -> i8 {
    let determinant = a.dot(b.cross(c));
    let (m, n, o) = (a.abs(), b.abs(), c.abs());
    let magnitude = m.x * (n.y * o.z + n.z * o.y)
        + m.y * (n.z * o.x + n.x * o.z)
        + m.z * (n.x * o.y + n.y * o.x);
    // Five rounded operations on the way of each product: 5·2⁻⁵³ · magnitude, and some air.
    if determinant.abs() > 8.0 * f64::EPSILON * magnitude {
        return sign(determinant);
    }
    let mut sum = Expansion::default();
    for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        sum.add_product(a[i], b[j], c[k]);
        sum.add_product(-a[i], b[k], c[j]);
    }
    sum.sign()
}

/// The side of the plane through the eye and the edge from `a` to `b` on which `ray` passes, never 0 but for an edge that
/// points at the eye. `edge_sign(ray, b, a) == -edge_sign(ray, a, b)`.
pub fn edge_sign(ray: DVec3, a: DVec3, b: DVec3) -> i8 {
    match volume_sign(ray, a, b) {
        0 => {
            let components = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| minor_sign(a, b, i, j));
            components.into_iter().find(|&sign| sign != 0).unwrap_or(0)
        }
        sign => sign,
    }
}

/// The sign of `a[i] · b[j] − b[i] · a[j]`, exact: rounding keeps order, and so do the rounding errors
/// of equal products.
fn minor_sign(a: DVec3, b: DVec3, i: usize, j: usize) -> i8 {
    let (first, first_rest) = two_product(a[i], b[j]);
    let (second, second_rest) = two_product(b[i], a[j]);
    let order = first.partial_cmp(&second).unwrap_or(Ordering::Equal);
    match order.then(first_rest.partial_cmp(&second_rest).unwrap_or(Ordering::Equal)) {
        Ordering::Less => -1,
        Ordering::Equal => 0,
        Ordering::Greater => 1,
    }
}

fn sign(value: f64) -> i8 {
    i8::from(value > 0.0) - i8::from(value < 0.0)
}

/// `x + y` as a rounded sum and its error.
fn two_sum(x: f64, y: f64) -> (f64, f64) {
    let sum = x + y;
    let y_virtual = sum - x;
    let x_virtual = sum - y_virtual;
    (sum, (x - x_virtual) + (y - y_virtual))
}

/// `x · y` as a rounded product and its error.
fn two_product(x: f64, y: f64) -> (f64, f64) {
    let product = x * y;
    (product, x.mul_add(y, -product))
}

/// A sum without rounding: non-overlapping terms, the smallest first.
#[derive(Default)]
struct Expansion(Vec<f64>);

impl Expansion {
    fn add(&mut self, value: f64) {
        let mut carry = value;
        for term in &mut self.0 {
            (carry, *term) = two_sum(*term, carry);
        }
        self.0.push(carry);
        self.0.retain(|&term| term != 0.0);
    }

    fn add_product(&mut self, x: f64, y: f64, z: f64) {
        let (high, low) = two_product(x, y);
        for factor in [low, high] {
            let (product, rest) = two_product(factor, z);
            self.add(rest);
            self.add(product);
        }
    }

    /// The largest term outweighs the rest.
    fn sign(&self) -> i8 {
        self.0.last().map_or(0, |&term| sign(term))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The determinant of integer vectors, in integers.
    fn exact(a: [i64; 3], b: [i64; 3], c: [i64; 3]) -> i128 {
        let [a, b, c] = [a, b, c].map(|v| v.map(i128::from));
        a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }

    fn vector(v: [i64; 3]) -> DVec3 {
        DVec3::from(v.map(|x| x as f64))
    }

    proptest! {
        #[test]
        fn nearly_coplanar_vectors_have_the_exact_sign(
            a in prop::array::uniform3(-(1i64 << 40)..1 << 40),
            b in prop::array::uniform3(-(1i64 << 40)..1 << 40),
            off in prop::array::uniform3(-1i64..=1),
        ) {
            // c = a + b up to one unit: the rounded determinant is mostly noise.
            let c = std::array::from_fn(|i| a[i] + b[i] + off[i]);
            let expected = exact(a, b, c).signum() as i8;
            prop_assert_eq!(volume_sign(vector(a), vector(b), vector(c)), expected);
        }

        #[test]
        fn edges_are_antisymmetric_and_decided(
            ray in prop::array::uniform3(-4i64..4),
            a in prop::array::uniform3(-4i64..4),
            b in prop::array::uniform3(-4i64..4),
        ) {
            let (ray, a, b) = (vector(ray), vector(a), vector(b));
            let side = edge_sign(ray, a, b);
            prop_assert_eq!(edge_sign(ray, b, a), -side);
            prop_assert_eq!(side == 0, a.cross(b) == DVec3::ZERO);
        }
    }

    #[test]
    fn what_rounding_hides_is_seen() {
        let tiny = 2f64.powi(-51);
        let a = DVec3::ONE;
        let b = DVec3::new(1.0, 1.0 + tiny, 1.0 - tiny);
        assert_eq!(volume_sign(a, b, a + b), 0);
        let off = DVec3::Z * tiny / 2.0;
        assert_eq!(volume_sign(a, b, a + b + off), 1);
        assert_eq!(volume_sign(a, b, a + b - off), -1);
        assert_eq!([(0, 1), (0, 2), (1, 1)].map(|(i, j)| minor_sign(a, b, i, j)), [1, -1, 0]);
    }
}
