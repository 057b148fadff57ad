//! Polygons to triangles.
//!
//! Convex polygons become a fan. Others are cut by ear clipping (Meisters, "Polygons have ears", 1975)
//! in the plane of their Newell normal. A polygon that has no ears, because it crosses itself or is
//! degenerate, or one that exhausts its budget, ends as a fan: wrong in places, but finite and closed.

use glam::{DVec2, DVec3};

/// Corner tests that one polygon may take before the rest of it becomes a fan.
const BUDGET: u64 = 4_000_000;

/// Cuts polygons, keeping its scratch memory between them.
#[derive(Default)]
pub(crate) struct Triangulator {
    corners: Vec<u32>,
    flat: Vec<DVec2>,
    /// Positions in `corners` that are still part of the remaining polygon, in order.
    left: Vec<u32>,
    /// Polygons that no clipping could cut and that became fans.
    pub forced: u64,
}

impl Triangulator {
    /// Calls `emit` with triangles as positions **in `ring`**, same orientation as the ring.
    /// `position` gives a corner's coordinates; equal neighbours are skipped.
    pub fn cut(
        &mut self,
        ring: &[u32],
        position: impl Fn(u32) -> DVec3,
        mut emit: impl FnMut([u32; 3]),
    ) {
        if let [_, _, _] = ring {
            return emit([0, 1, 2]);
        }
        self.corners.clear();
        for (at, &vertex) in ring.iter().enumerate() {
            let previous = self.corners.last().map(|&last| ring[last as usize]);
            if previous != Some(vertex) {
                self.corners.push(at as u32);
            }
        }
        while self.corners.len() > 1 && ring[last(&self.corners)] == ring[self.corners[0] as usize] {
            self.corners.pop();
        }
        if self.corners.len() < 3 {
            return;
        }
        self.flatten(ring, position);
        if self.is_convex() {
            for pair in self.corners[1..].windows(2) {
                emit([self.corners[0], pair[0], pair[1]]);
            }
        } else {
            self.clip(&mut emit);
        }
    }

    /// Projects along the largest component of the Newell normal, counter-clockwise.
    fn flatten(&mut self, ring: &[u32], position: impl Fn(u32) -> DVec3) {
        let point = |at: &u32| position(ring[*at as usize]);
        let origin = point(&self.corners[0]);
        let mut normal = DVec3::ZERO;
        let mut previous = point(&self.corners[self.corners.len() - 1]) - origin;
        for corner in &self.corners {
            let current = point(corner) - origin;
            normal += previous.cross(current);
            previous = current;
        }
        let size = normal.abs();
        let (u, v, w) = if size.x >= size.y && size.x >= size.z {
            (1, 2, 0)
        } else if size.y >= size.z {
            (2, 0, 1)
        } else {
            (0, 1, 2)
        };
        let turn = if normal[w] < 0.0 { -1.0 } else { 1.0 };
        self.flat.clear();
        self.flat.extend(self.corners.iter().map(|corner| {
            let p = point(corner) - origin;
            DVec2::new(p[u] * turn, p[v])
        }));
    }

    /// Whether no corner turns right and the outline goes round once.
    fn is_convex(&self) -> bool {
        let n = self.flat.len();
        let mut reversals = 0;
        let mut rightwards = None;
        for i in 0..n {
            let (a, b, c) = (self.flat[i], self.flat[(i + 1) % n], self.flat[(i + 2) % n]);
            let turn = (b - a).perp_dot(c - b);
            if turn < 0.0 || !turn.is_finite() {
                return false;
            }
            let right = b.x > a.x || (b.x == a.x && b.y > a.y);
            if rightwards.is_some_and(|before| before != right) {
                reversals += 1;
            }
            rightwards = Some(right);
        }
        reversals <= 2
    }

    fn clip(&mut self, emit: &mut impl FnMut([u32; 3])) {
        self.left.clear();
        self.left.extend(0..self.corners.len() as u32);
        let mut budget = BUDGET;
        let mut at = 0;
        let mut misses = 0;
        while self.left.len() > 3 && misses < self.left.len() {
            let n = self.left.len();
            at %= n;
            let ear = [self.left[(at + n - 1) % n], self.left[at], self.left[(at + 1) % n]];
            budget = budget.saturating_sub(n as u64);
            if budget == 0 {
                break;
            }
            if self.is_ear(ear) {
                emit(ear.map(|i| self.corners[i as usize]));
                self.left.remove(at);
                // Cutting every second corner keeps the triangles of round outlines from being slivers.
                at += usize::from(n > 4);
                misses = 0;
            } else {
                at += 1;
                misses += 1;
            }
        }
        if self.left.len() > 3 {
            self.forced += 1;
        }
        for i in 1..self.left.len() - 1 {
            let fan = [self.left[0], self.left[i], self.left[i + 1]];
            emit(fan.map(|i| self.corners[i as usize]));
        }
    }

    fn is_ear(&self, ear: [u32; 3]) -> bool {
        let [a, b, c] = ear.map(|i| self.flat[i as usize]);
        let area = (b - a).perp_dot(c - a);
        if area <= 0.0 || !area.is_finite() {
            // A spike or a straight corner may go when nothing lies on the cut.
            return area == 0.0 && (b - a).dot(c - b) >= 0.0;
        }
        self.left.iter().all(|&i| {
            let p = self.flat[i as usize];
            if ear.contains(&i) || p == a || p == b || p == c {
                return true;
            }
            let outside = |from: DVec2, to: DVec2| (to - from).perp_dot(p - from) < 0.0;
            outside(a, b) || outside(b, c) || outside(c, a)
        })
    }
}

fn last(corners: &[u32]) -> usize {
    corners[corners.len() - 1] as usize
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn cut(points: &[DVec3]) -> (Vec<[u32; 3]>, u64) {
        let ring: Vec<u32> = (0..points.len() as u32).collect();
        let mut triangles = Vec::new();
        let mut triangulator = Triangulator::default();
        triangulator.cut(&ring, |i| points[i as usize], |t| triangles.push(t));
        (triangles, triangulator.forced)
    }

    fn areas(points: &[DVec3], triangles: &[[u32; 3]]) -> (DVec3, f64) {
        let mut sum = DVec3::ZERO;
        let mut total = 0.0;
        for t in triangles {
            let [a, b, c] = t.map(|i| points[i as usize]);
            let area = (b - a).cross(c - a) * 0.5;
            sum += area;
            total += area.length();
        }
        (sum, total)
    }

    #[test]
    fn a_concave_quad_is_cut_along_its_inner_diagonal() {
        let p = |x: f64, y: f64| DVec3::new(x, y, 2.0);
        for turn in 0..4 {
            let mut points = vec![p(0.0, 0.0), p(2.0, 0.0), p(0.5, 0.5), p(0.0, 2.0)];
            points.rotate_left(turn);
            let (triangles, forced) = cut(&points);
            let (sum, total) = areas(&points, &triangles);
            assert_eq!((triangles.len(), forced), (2, 0));
            assert!((sum.z - 1.0).abs() < 1e-12 && (total - 1.0).abs() < 1e-12, "{sum} {total}");
        }
    }

    #[test]
    fn repeated_corners_vanish() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::ONE];
        let mut triangles = Vec::new();
        Triangulator::default().cut(
            &[0, 0, 1, 2, 2, 0],
            |i| points[i as usize],
            |t| triangles.push(t),
        );
        assert_eq!(triangles.len(), 1);
        Triangulator::default().cut(&[0, 1, 0, 1], |i| points[i as usize], |_| {});
    }

    #[test]
    fn hopeless_polygons_end() {
        let nan = vec![DVec3::NAN; 50];
        assert_eq!(cut(&nan).0.len(), 48);
        let bow = [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::X, DVec3::Y];
        assert_eq!(cut(&bow).0.len(), 2);
        let star: Vec<DVec3> = (0..20_001)
            .map(|i| {
                let a = f64::from(i) * 2.0 * std::f64::consts::TAU / 20_001.0;
                DVec3::new(a.cos(), a.sin(), 0.0)
            })
            .collect();
        assert_eq!(cut(&star).0.len(), 19_999);
    }

    proptest! {
        /// Star-shaped outlines, however spiky, are covered exactly once.
        #[test]
        fn covers_exactly_once(radii in prop::collection::vec(0.1f64..3.0, 4..40), tilt in 0.0f64..6.0) {
            let n = radii.len() as f64;
            let rotation = glam::DMat3::from_rotation_x(tilt) * glam::DMat3::from_rotation_y(tilt * 0.7);
            let points: Vec<DVec3> = radii.iter().enumerate().map(|(i, r)| {
                let a = i as f64 / n * std::f64::consts::TAU;
                rotation * DVec3::new(a.cos() * r, a.sin() * r, 0.0) + DVec3::splat(1000.0)
            }).collect();
            let (triangles, forced) = cut(&points);
            let (sum, total) = areas(&points, &triangles);
            prop_assert_eq!(forced, 0);
            prop_assert_eq!(triangles.len(), points.len() - 2);
            prop_assert!((sum.length() - total).abs() < 1e-6, "{} {}", sum.length(), total);
        }
    }
}
