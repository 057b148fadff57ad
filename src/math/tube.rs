//! A ray against a tube: the balls whose centre and radius vary linearly along a segment.

use glam::DVec3;

/// A segment of a tube: everything within `r(t)` of `a + t (b − a)` for a `t` in 0..=1, where `r` goes from `radii[0]` to `radii[1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tube {
    pub ends: [DVec3; 2],
    pub radii: [f64; 2],
}

/// Where a ray enters a tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Along the ray, in lengths of its direction; negative behind its origin.
    pub at: f64,
    /// Where along the segment the centre of the touched ball is, in 0..=1.
    pub share: f64,
    /// Unit length, outwards.
    pub normal: DVec3,
}

impl Tube {
    /// The first point of the whole line `origin + at · way` in the tube; `None` where they do not meet, and for radii of zero.
    ///
    /// On the surface between the balls at the ends, a point at axial coordinate `y` and distance `ρ` from the axis has
    /// `ρ cos α + y sin α = r₀` with `sin α = (r₀ − r₁) / L`: the common tangent of both circles in a plane through the axis.
    pub fn enter(&self, origin: DVec3, way: DVec3) -> Option<Entry> {
        let length = way.length();
        if !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let dir = way / length;
        let [a, b] = self.ends;
        let [ra, rb] = self.radii;
        // From the point of the ray that is nearest to the segment's middle, so that a distant origin costs no digits.
        let from = (a.midpoint(b) - origin).dot(dir);
        let start = origin + dir * from;
        let mut best: Option<(f64, f64)> = None;
        let mut offer = |at: f64, share: f64| {
            if at.is_finite() && best.is_none_or(|(least, _)| at < least) {
                best = Some((at, share));
            }
        };
        for (centre, radius, share) in [(a, ra, 0.0), (b, rb, 1.0)] {
            let to = start - centre;
            let along = to.dot(dir);
            let beside = (to - dir * along).length();
            if radius > 0.0 && beside <= radius {
                offer(-along - ((radius - beside) * (radius + beside)).sqrt(), share);
            }
        }
        let axis = b - a;
        let span = axis.length();
        let sine = (ra - rb) / span;
        if sine.abs() < 1.0 {
            let axis = axis / span;
            let cosine = ((1.0 - sine) * (1.0 + sine)).sqrt();
            let to = start - a;
            let (y, c) = (to.dot(axis), dir.dot(axis));
            let beside = to - axis * y;
            let across = dir - axis * c;
            let left = ra - y * sine;
            // cos²α |beside + u across|² = (left − u c sin α)²
            let second = cosine * cosine * across.length_squared() - (c * sine).powi(2);
            let half = cosine * cosine * beside.dot(across) + left * c * sine;
            let none = (cosine * beside.length() - left) * (cosine * beside.length() + left);
            for at in roots(second, half, none) {
                let (y, left) = (y + at * c, ra - (y + at * c) * sine);
                // The ball that touches here has its centre so far along the axis.
                let foot = (y - left * sine / (cosine * cosine)) / span;
                if left > 0.0 && (0.0..=1.0).contains(&foot) {
                    offer(at, foot);
                }
            }
        }
        let (at, share) = best?;
        let centre = a + (b - a) * share;
        let normal = (start + dir * at - centre).try_normalize()?;
        Some(Entry { at: (at + from) / length, share, normal })
    }

    /// The point of the segment that is nearest to a line, as a share in 0..=1.
    pub fn nearest_share(&self, origin: DVec3, way: DVec3) -> f64 {
        let [a, b] = self.ends;
        let dir = way.normalize_or_zero();
        let across = |v: DVec3| v - dir * v.dot(dir);
        let (axis, to) = (across(b - a), across(origin - a));
        let square = axis.length_squared();
        if square > 0.0 { (to.dot(axis) / square).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// The roots of `second · u² + 2 half · u + none`, without cancellation.
fn roots(second: f64, half: f64, none: f64) -> impl Iterator<Item = f64> {
    let square = half * half - second * none;
    let sum = -(half + square.max(0.0).sqrt().copysign(half));
    [sum / second, none / sum].into_iter().filter(move |root| square >= 0.0 && root.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How far a place is outside of a tube, from many balls along it.
    fn outside(tube: &Tube, place: DVec3) -> f64 {
        (0..=4000)
            .map(|i| {
                let share = f64::from(i) / 4000.0;
                let centre = tube.ends[0].lerp(tube.ends[1], share);
                let [ra, rb] = tube.radii;
                place.distance(centre) - (ra + (rb - ra) * share)
            })
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn rays_enter_at_the_surface_of_all_balls() {
        // Knuth's MMIX generator.
        let mut state = 7u64;
        let mut number = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let (mut hits, mut misses) = (0, 0);
        for round in 0..3000 {
            let mut place = || DVec3::new(number(), number(), number()) * 2.0 - 1.0;
            let (a, mut b, way, beside) = (place(), place(), place(), place());
            let mut radii = [number() * 0.5, number() * 0.5];
            match round % 6 {
                0 => b = a,
                1 => radii = [0.3, 0.3],
                2 => radii = [0.0, 0.4],
                // End-on, from either side.
                3 => b = a + way * number(),
                4 => b = a - way * number(),
                _ => {}
            }
            let tube = Tube { ends: [a, b], radii };
            let origin = a.midpoint(b) + beside * 0.4 - way * 20.0 / way.length();
            let Some(entry) = tube.enter(origin, way) else {
                let nearest = (0..400)
                    .map(|i| origin + way / way.length() * (17.0 + f64::from(i) * 0.015))
                    .map(|place| outside(&tube, place));
                assert!(nearest.fold(f64::INFINITY, f64::min) > -2e-4, "{tube:?}");
                misses += 1;
                continue;
            };
            hits += 1;
            let at = origin + way * entry.at;
            assert!(outside(&tube, at).abs() < 1e-6, "{} {tube:?}", outside(&tube, at));
            let before = (1..60).map(|i| at - way / way.length() * f64::from(i) * 0.05);
            for place in before {
                assert!(outside(&tube, place) > -1e-6, "an earlier entry: {tube:?}");
            }
            assert!((entry.normal.length() - 1.0).abs() < 1e-12);
            assert!(outside(&tube, at + entry.normal * 0.01) > 0.0099);
        }
        assert!(hits > 500 && misses > 200, "{hits} {misses}");
    }
}
