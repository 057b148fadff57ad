//! Axis-aligned boxes.

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// An axis-aligned box, possibly empty (`min > max`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    pub min: DVec3,
    pub max: DVec3,
}

impl Default for Bounds {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Bounds {
    /// The empty box, which is the neutral element of [`Bounds::union`].
    pub const EMPTY: Bounds = Bounds { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The smallest box around `points`.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for point in points {
            bounds.add(point);
        }
        bounds
    }

    /// As [`Bounds::of`], in parallel on all threads.
    pub fn of_all(points: &[DVec3]) -> Bounds {
        const PART: usize = 1 << 16;
        let boxes: Vec<Bounds> =
            points.par_chunks(PART).map(|part| Bounds::of(part.iter().copied())).collect();
        boxes.into_iter().fold(Bounds::EMPTY, Bounds::union)
    }

    pub fn is_empty(&self) -> bool {
        !(self.min.x <= self.max.x && self.min.y <= self.max.y && self.min.z <= self.max.z)
    }

    pub fn add(&mut self, point: DVec3) {
        self.min = self.min.min(point);
        self.max = self.max.max(point);
    }

    pub fn union(self, other: Bounds) -> Bounds {
        Bounds { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The middle; the origin for an empty box.
    pub fn centre(&self) -> DVec3 {
        if self.is_empty() { DVec3::ZERO } else { self.min * 0.5 + self.max * 0.5 }
    }

    /// The edge lengths; zero for an empty box.
    pub fn extent(&self) -> DVec3 {
        if self.is_empty() { DVec3::ZERO } else { self.max - self.min }
    }

    /// The box enlarged by `margin` on every side. An empty box stays empty.
    pub fn grown(&self, margin: f64) -> Bounds {
        if self.is_empty() {
            return *self;
        }
        Bounds { min: self.min - margin, max: self.max + margin }
    }

    /// The eight corners. Those of an empty box are at the origin.
    pub fn corners(&self) -> [DVec3; 8] {
        let (centre, half) = (self.centre(), self.extent() * 0.5);
        std::array::from_fn(|corner| {
            let side = |axis: usize| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            centre + half * DVec3::new(side(0), side(1), side(2))
        })
    }

    /// The bounding box of this box's image under an affine map.
    pub fn transformed(&self, map: &DAffine3) -> Bounds {
        if self.is_empty() {
            return Bounds::EMPTY;
        }
        let centre = map.transform_point3(self.centre());
        let half = self.extent() * 0.5;
        let m = map.matrix3;
        let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        Bounds { min: centre - reach, max: centre + reach }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_is_neutral() {
        let unit = Bounds::of([DVec3::ZERO, DVec3::ONE]);
        assert_eq!(Bounds::EMPTY.union(unit), unit);
        assert!(Bounds::EMPTY.is_empty());
        assert!(!unit.is_empty());
        assert_eq!(Bounds::EMPTY.extent(), DVec3::ZERO);
    }

    #[test]
    fn transformed_holds_every_corner() {
        let bounds = Bounds::of([DVec3::new(-1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 9.0)]);
        let map =
            DAffine3::from_rotation_y(0.7) * DAffine3::from_translation(DVec3::new(1e6, 2.0, -3.0));
        let image = bounds.transformed(&map);
        assert_eq!(Bounds::of(bounds.corners()), bounds);
        for corner in bounds.corners() {
            let p = map.transform_point3(corner);
            assert!((p.cmpge(image.min - 1e-6) & p.cmple(image.max + 1e-6)).all());
        }
    }
}
