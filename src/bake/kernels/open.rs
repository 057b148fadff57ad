//! Cells that the nearest neighbours leave open: at the rim of a gap in the sampling, and at the border of a surface.
//!
//! More neighbours tell which it is. Within their convex hull is the surface, and a gap in it is bridged up to the size that gaps have where
//! samples are spread at random. Beyond the hull there is nothing.

use glam::{Vec2, Vec3};

use super::super::neighbors::AROUND;
use super::cell::Cell;
use super::{TURN_X, TURN_Y};

/// A cell within the surface.
pub(super) struct OpenCell {
    cell: Cell<MOST>,
    /// All of the cell lies within the surface.
    pub(super) is_closed: bool,
}

/// Corners of a square, and one for each wall and each side of the hull.
const MOST: usize = 24 + 2 * AROUND;
/// The widest gap that is bridged: distance of its middle from the samples around it, in mean distances between samples. In a billion samples
/// that are spread at random the widest has 3.3.
const WIDEST: f32 = 3.3;
/// Radius that is covered of a cell with a wider gap, in the same distances.
const BRIDGED: f32 = 1.0;
/// Height of a place over its distance in the plane, up to which it is on the surface.
const RISE: f32 = 0.5;
/// Mean height of the places over their mean distance, from which on the sample at the origin lies beside the surface.
const BESIDE: f32 = 0.15;
/// Places beyond the hull's sides by this part of the farthest place count as within it.
const SLACK: f32 = 1e-3;

impl OpenCell {
    pub(super) fn corners(&self) -> &[Vec2] {
        self.cell.corners()
    }

    /// The cell of the origin in the plane of two unit vectors; `None` where the places around it are no surface.
    pub(super) fn of(around: &[Vec3], [a, b]: [Vec3; 2], normal: Vec3) -> Option<OpenCell> {
        let flat = |q: &Vec3| Vec2::new(q.dot(a), q.dot(b));
        let farthest = around.iter().fold(0.0f32, |far, q| far.max(flat(q).length()));
        let mut cell = Cell::<MOST>::square(2.0 * farthest);
        let mut on_surface = [Vec2::ZERO; AROUND + 1];
        let (mut count, mut heights, mut distances) = (1, 0.0, 0.0);
        for q in around.iter().take(AROUND) {
            let (at, height) = (flat(q), q.dot(normal));
            // Where the plane between the origin and the place meets the tangent plane.
            cell.clip(at, 0.5 * q.length_squared());
            if height.abs() <= RISE * at.length() {
                on_surface[count] = at;
                count += 1;
                heights += height;
                distances += at.length();
            }
        }
        if heights.abs() > BESIDE * distances {
            return None;
        }
        let hull = Hull::of(&mut on_surface[..count]);
        let sides = hull.corners().iter().zip(hull.corners().iter().cycle().skip(1));
        let mut area = 0.0;
        let mut is_closed = true;
        for (from, to) in sides {
            area += 0.5 * from.perp_dot(*to);
            let outward = -(to - from).perp();
            let bound = from.dot(outward) + SLACK * farthest * outward.length();
            is_closed &= !cell.clip(outward, bound);
        }
        let spacing = (area / count as f32).sqrt();
        if spacing <= 0.0 || spacing.is_nan() || cell.corners().len() < 3 {
            return None;
        }
        if cell.extent() > WIDEST * spacing {
            is_closed = false;
            for (x, y) in TURN_X.iter().zip(TURN_Y) {
                for side in [Vec2::new(*x, y), -Vec2::new(*x, y)] {
                    cell.clip(side, BRIDGED * spacing);
                }
            }
        }
        Some(OpenCell { cell, is_closed })
    }
}

/// The convex hull of places in a plane.
struct Hull {
    corners: [Vec2; AROUND + 2],
    count: usize,
}

impl Hull {
    /// Finds the corners, counterclockwise (Andrew 1979); sorts the places, of which there are at most `AROUND` and the origin.
    fn of(places: &mut [Vec2]) -> Hull {
        places.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let mut hull = Hull { corners: [Vec2::ZERO; AROUND + 2], count: 0 };
        places.iter().for_each(|place| hull.put(*place, 0));
        let below = hull.count;
        places.iter().rev().skip(1).for_each(|place| hull.put(*place, below - 1));
        // The first place has come once more.
        hull.count = hull.count.saturating_sub(1);
        hull
    }

    /// Appends a place, in place of those that it leaves within the hull; the first `least` and one more stay.
    fn put(&mut self, place: Vec2, least: usize) {
        while self.count >= least + 2 {
            let [before, last] = [self.corners[self.count - 2], self.corners[self.count - 1]];
            if (last - before).perp_dot(place - before) > 0.0 {
                break;
            }
            self.count -= 1;
        }
        if let Some(slot) = self.corners.get_mut(self.count) {
            *slot = place;
            self.count += 1;
        }
    }

    fn corners(&self) -> &[Vec2] {
        &self.corners[..self.count]
    }
}
