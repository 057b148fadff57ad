//! Voronoi cells in a plane.

use glam::Vec2;

use super::super::neighbors::MAX_NEIGHBORS;

/// The part of a square about the origin that is nearer to the origin than to any of some places: a convex polygon of at most `MOST`
/// corners.
pub(in crate::bake) struct Cell<const MOST: usize = NEAR> {
    corners: [Vec2; MOST],
    count: usize,
}

/// A wall cuts off at least one corner and adds two.
const NEAR: usize = 5 + MAX_NEIGHBORS;

impl<const MOST: usize> Cell<MOST> {
    /// `half`: half the side of the square.
    pub(in crate::bake) fn square(half: f32) -> Self {
        let mut cell = Cell { corners: [Vec2::ZERO; MOST], count: 4 };
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        cell.corners.iter_mut().zip(square).for_each(|(c, at)| *c = Vec2::from(at) * half);
        cell
    }

    /// `half`: half the side of the square; `same`: squared distance up to which a place is the origin.
    pub(in crate::bake) fn of(places: &[Vec2], half: f32, same: f32) -> Self {
        let mut cell = Cell::square(half);
        let mut extent = f32::INFINITY;
        for place in places {
            let d = place.length_squared();
            // The wall of a place twice as far as every corner, or farther, touches none.
            if d > same && d < 4.0 * extent {
                cell.clip(*place, 0.5 * d);
                extent = cell.corners().iter().map(|c| c.length_squared()).fold(0.0, f32::max);
            }
        }
        cell
    }

    pub(in crate::bake) fn corners(&self) -> &[Vec2] {
        &self.corners[..self.count]
    }

    pub(in crate::bake) fn extent(&self) -> f32 {
        self.corners().iter().map(|corner| corner.length()).fold(0.0, f32::max)
    }

    /// Keeps what lies where `place · normal < bound`; returns whether there was anything else.
    pub(in crate::bake) fn clip(&mut self, normal: Vec2, bound: f32) -> bool {
        let mut kept = [Vec2::ZERO; MOST];
        let mut count = 0;
        let mut put = |corner: Vec2| {
            if let Some(slot) = kept.get_mut(count) {
                *slot = corner;
                count += 1;
            }
        };
        let Some(mut last) = self.corners().last().copied() else { return false };
        let mut last_side = last.dot(normal) - bound;
        let mut is_cut = false;
        for &corner in self.corners() {
            let side = corner.dot(normal) - bound;
            if (side < 0.0) != (last_side < 0.0) {
                put(last + (corner - last) * (last_side / (last_side - side)));
            }
            if side < 0.0 {
                put(corner);
            } else {
                is_cut = true;
            }
            (last, last_side) = (corner, side);
        }
        (self.corners, self.count) = (kept, count);
        is_cut
    }
}
