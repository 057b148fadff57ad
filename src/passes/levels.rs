//! Levels of the pyramid that pull-push makes of an image (Marroquim et al. 2008, §3).

/// Bytes of a patch in each buffer of pull-push.
const PATCH_BYTES: u64 = 8;

/// Sizes of the levels, the image first; a pixel of a level stands for 2 × 2 of the level before it. A rim of one pixel surrounds each
/// level, for samples beside the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Levels(Vec<(u32, u32)>);

impl Levels {
    /// The levels of an image, down to one pixel; at least one beside the image.
    pub fn of((width, height): (u32, u32)) -> Levels {
        let mut sizes = vec![(width.max(1), height.max(1))];
        let mut size = sizes[0];
        loop {
            size = (size.0.div_ceil(2), size.1.div_ceil(2));
            sizes.push(size);
            if size == (1, 1) {
                return Levels(sizes);
            }
        }
    }

    /// Number of levels, at least two.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Width and height of a level, without its rim.
    pub fn size(&self, level: usize) -> (u32, u32) {
        self.0.get(level).copied().unwrap_or((1, 1))
    }

    /// Pixels of all levels before one, with their rims.
    pub fn first(&self, level: usize) -> u64 {
        let sizes = self.0.iter().take(level);
        sizes.map(|&(width, height)| (u64::from(width) + 2) * (u64::from(height) + 2)).sum()
    }

    /// Pixels of all levels, with their rims.
    pub fn pixels(&self) -> u64 {
        self.first(self.count())
    }

    /// Bytes of all levels in each of the buffers of pull-push.
    pub fn bytes(&self) -> u64 {
        self.pixels() * PATCH_BYTES
    }

    /// The words of `LevelUse` in `shared/patches` for each level that has a coarser one.
    pub fn records(&self) -> impl Iterator<Item = [u32; 4]> + '_ {
        let total = self.pixels() as u32;
        (0..self.count().saturating_sub(1)).map(move |level| {
            [level as u32, self.first(level) as u32, self.first(level + 1) as u32, total]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_of_any_size_end_with_one_pixel() {
        let levels = Levels::of((5, 3));
        let sizes: Vec<(u32, u32)> = (0..levels.count()).map(|level| levels.size(level)).collect();
        assert_eq!(sizes, [(5, 3), (3, 2), (2, 1), (1, 1)]);
        let rims = [35, 20, 12, 9];
        assert_eq!(levels.pixels(), rims.iter().sum::<u64>());
        let records: Vec<[u32; 4]> = levels.records().collect();
        assert_eq!(records, [[0, 0, 35, 76], [1, 35, 55, 76], [2, 55, 67, 76]]);
        assert_eq!(Levels::of((1, 1)).records().count(), 1);
        assert_eq!(Levels::of((1, 8192)).count(), 14);
    }
}
