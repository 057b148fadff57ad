//! Boxes around points of the tree.

use super::Item;

/// A box in tree coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aabb {
    pub min: [f32; 3],
    pub max: [f32; 3],
}

impl Aabb {
    pub const EMPTY: Aabb = Aabb { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    pub fn of(items: &[Item]) -> Self {
        items.iter().fold(Self::EMPTY, |bounds, item| Self {
            min: std::array::from_fn(|axis| bounds.min[axis].min(item.position[axis])),
            max: std::array::from_fn(|axis| bounds.max[axis].max(item.position[axis])),
        })
    }

    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    /// All of it is one place.
    pub fn is_place(&self) -> bool {
        self.min == self.max
    }

    pub fn longest_axis(&self) -> usize {
        let extent: [f32; 3] = std::array::from_fn(|axis| self.max[axis] - self.min[axis]);
        let longer = if extent[1] > extent[0] { 1 } else { 0 };
        if extent[2] > extent[longer] { 2 } else { longer }
    }

    /// Squared distance between two boxes.
    pub fn distance_squared(&self, other: &Self) -> f32 {
        (0..3).fold(0.0, |sum, axis| {
            let gap = (other.min[axis] - self.max[axis]).max(self.min[axis] - other.max[axis]);
            sum + gap.max(0.0) * gap.max(0.0)
        })
    }

    pub fn point(position: [f32; 3]) -> Self {
        Self { min: position, max: position }
    }

    pub fn centre(&self) -> [f32; 3] {
        std::array::from_fn(|axis| 0.5 * (self.min[axis] + self.max[axis]))
    }
}
