//! Centripetal Catmull–Rom curves (P. J. Barry, R. N. Goldman, *A Recursive Evaluation Algorithm for a Class of Catmull-Rom
//! Splines*, SIGGRAPH 1988, with the knots of E. Catmull and R. Rom's α = ½).
//!
//! The distance of neighbouring knots is the square root of the distance of their points. Only with this choice no part of the
//! curve between two points has a cusp or crosses itself, however unevenly the points are spaced (C. Yuksel, S. Schaefer, J.
//! Keyser, *Parameterization and Applications of Catmull-Rom Curves*, Computer-Aided Design 43, 2011). The curve is evaluated in
//! Hermite form, from tangents at the points, because differences of neighbours keep their digits at large coordinates.

use glam::DVec3;

/// Distance of the knots of two points: the square root of the points' distance.
pub fn knot_interval(a: DVec3, b: DVec3) -> f64 {
    a.distance(b).sqrt()
}

/// Derivatives of the curve through `points` with respect to its knots, one per point. Neighbours must not coincide. Beyond its
/// ends the curve continues as if the neighbour of the end were mirrored there. A single point has no direction, so its
/// derivative is zero.
pub fn tangents(points: &[DVec3]) -> Vec<DVec3> {
    let slope = |i: usize| (points[i + 1] - points[i]) / knot_interval(points[i], points[i + 1]);
    let last = points.len().saturating_sub(1);
    (0..points.len())
        .map(|i| match i {
            _ if last == 0 => DVec3::ZERO,
            0 => slope(0),
            _ if i == last => slope(i - 1),
            _ => {
                let before = knot_interval(points[i - 1], points[i]);
                let after = knot_interval(points[i], points[i + 1]);
                let across = (points[i + 1] - points[i - 1]) / (before + after);
                slope(i - 1) - across + slope(i)
            }
        })
        .collect()
}

/// The cubic from `a` at `u = 0` to `b` at `u = 1`, with these derivatives with respect to `u` at its ends.
pub fn hermite(a: DVec3, b: DVec3, slope_a: DVec3, slope_b: DVec3, u: f64) -> DVec3 {
    let v = 1.0 - u;
    a + (b - a) * (u * u * (3.0 - 2.0 * u)) + slope_a * (u * v * v) - slope_b * (u * u * v)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A part of the curve, between the second and the third point, by Barry and Goldman's pyramid.
    fn pyramid(p: [DVec3; 4], alpha: f64, u: f64) -> DVec3 {
        let mut t = [0.0; 4];
        for i in 0..3 {
            t[i + 1] = t[i] + p[i].distance(p[i + 1]).powf(alpha);
        }
        let at = t[1] + u * (t[2] - t[1]);
        let mix = |a: DVec3, b: DVec3, from: f64, to: f64| {
            a * ((to - at) / (to - from)) + b * ((at - from) / (to - from))
        };
        let a: [DVec3; 3] = std::array::from_fn(|i| mix(p[i], p[i + 1], t[i], t[i + 1]));
        let b: [DVec3; 2] = std::array::from_fn(|i| mix(a[i], a[i + 1], t[i], t[i + 2]));
        mix(b[0], b[1], t[1], t[2])
    }

    fn curve(p: [DVec3; 4], u: f64) -> DVec3 {
        let m = tangents(&p);
        let interval = knot_interval(p[1], p[2]);
        hermite(p[1], p[2], m[1] * interval, m[2] * interval, u)
    }

    /// Whether a polyline in the plane z = 0 crosses itself.
    fn crosses_itself(line: &[DVec3]) -> bool {
        let side = |a: DVec3, b: DVec3, c: DVec3| (b - a).cross(c - a).z;
        let parts: Vec<_> = line.windows(2).map(|pair| (pair[0], pair[1])).collect();
        parts.iter().enumerate().any(|(i, &(a, b))| {
            parts[i + 1..].iter().skip(1).any(|&(c, d)| {
                side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
            })
        })
    }

    /// Cosine of the sharpest turn of a polyline.
    fn sharpest_turn(line: &[DVec3]) -> f64 {
        let steps: Vec<DVec3> =
            line.windows(2).filter_map(|w| (w[1] - w[0]).try_normalize()).collect();
        steps.windows(2).map(|pair| pair[0].dot(pair[1])).fold(1.0, f64::min)
    }

    fn sampled(of: impl Fn(f64) -> DVec3) -> Vec<DVec3> {
        (0..=4000).map(|i| of(f64::from(i) / 4000.0)).collect()
    }

    /// A short part between two long ones: evenly spaced knots give a loop, square roots do not.
    #[test]
    fn no_loop_where_even_knots_make_one() {
        let p = [(-9.0, -6.0), (0.0, 0.0), (1.0, 0.0), (10.0, -6.0)];
        let p = p.map(|(x, y)| DVec3::new(x, y, 0.0));
        let even = sampled(|u| pyramid(p, 0.0, u));
        assert!(crosses_itself(&even), "the case is too easy");
        let centripetal = sampled(|u| curve(p, u));
        assert!(!crosses_itself(&centripetal));
        assert!(sharpest_turn(&centripetal) > 0.999, "{}", sharpest_turn(&centripetal));
    }

    fn coordinate() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-100.0..100.0f64).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn hermite_form_is_the_pyramid(p in prop::array::uniform4(coordinate()), u in 0.0..=1.0f64) {
            prop_assume!(p.windows(2).all(|pair| pair[0].distance(pair[1]) > 1e-3));
            let (found, expected) = (curve(p, u), pyramid(p, 0.5, u));
            prop_assert!(found.distance(expected) < 1e-8, "{found} {expected}");
        }

        #[test]
        fn never_a_cusp_or_a_loop_between_two_points(p in prop::array::uniform4(prop::array::uniform2(-10.0..10.0f64))) {
            let p = p.map(|[x, y]| DVec3::new(x, y, 0.0));
            prop_assume!(p.windows(2).all(|pair| pair[0].distance(pair[1]) > 0.05));
            prop_assert!(!crosses_itself(&(0..=200).map(|i| curve(p, f64::from(i) / 200.0)).collect::<Vec<_>>()));
        }
    }
}
