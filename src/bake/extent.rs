//! Boxes of single precision.

/// A box, given by its lower and upper corners.
#[derive(Clone, Copy)]
pub(super) struct Extent(pub [[f32; 3]; 2]);

impl Extent {
    pub const EMPTY: Extent = Extent([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]);

    pub fn with(self, Extent([low, high]): Extent) -> Extent {
        let [min, max] = self.0;
        Extent([
            std::array::from_fn(|axis| min[axis].min(low[axis])),
            std::array::from_fn(|axis| max[axis].max(high[axis])),
        ])
    }

    pub fn is_place(&self) -> bool {
        self.0[0] == self.0[1]
    }

    /// Squared distance; infinite if one of the boxes is empty.
    pub fn distance_squared(&self, other: &Extent) -> f32 {
        let ([min, max], [low, high]) = (self.0, other.0);
        (0..3).fold(0.0, |sum, axis| {
            let gap = (min[axis] - high[axis]).max(low[axis] - max[axis]).max(0.0);
            sum + gap * gap
        })
    }
}
