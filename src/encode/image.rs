//! Images before encoding.

use crate::plan::Output;

/// The pixels of a frame, top row first.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameImage {
    /// sRGB with straight alpha.
    Color { width: u32, height: u32, rgba: Vec<[u8; 4]> },
    /// Distance along the viewing axis in scene units; `f32::INFINITY` where there is nothing.
    Depth { width: u32, height: u32, depth: Vec<f32> },
    /// Unit vectors as `n · 127 + 128` per byte, with alpha 255; all zero where there is nothing or no normal.
    Normal { width: u32, height: u32, rgba: Vec<[u8; 4]> },
    /// Instance number plus one (in the order of [`crate::scene::Scene::instances`], with each asset's placements expanded); 0
    /// where there is nothing.
    Id { width: u32, height: u32, id: Vec<u32> },
}

impl FrameImage {
    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        match *self {
            FrameImage::Color { width, height, .. }
            | FrameImage::Depth { width, height, .. }
            | FrameImage::Normal { width, height, .. }
            | FrameImage::Id { width, height, .. } => (width, height),
        }
    }

    /// The output that this image is.
    pub fn output(&self) -> Output {
        match self {
            FrameImage::Color { .. } => Output::Color,
            FrameImage::Depth { .. } => Output::Depth,
            FrameImage::Normal { .. } => Output::Normal,
            FrameImage::Id { .. } => Output::Id,
        }
    }

    /// Whether all pixels are `background`, an sRGB colour with straight alpha.
    pub fn is_blank(&self, background: [u8; 4]) -> bool {
        // Check the lower half first: content is usually in the middle.
        fn all<T>(pixels: &[T], blank: impl Fn(&T) -> bool) -> bool {
            let (above, below) = pixels.split_at(pixels.len() / 2);
            below.iter().all(&blank) && above.iter().all(&blank)
        }
        match self {
            FrameImage::Color { rgba, .. } => all(rgba, |&pixel| pixel == background),
            FrameImage::Depth { depth, .. } => all(depth, |&depth| depth == f32::INFINITY),
            FrameImage::Normal { rgba, .. } => all(rgba, |&pixel| pixel == [0; 4]),
            FrameImage::Id { id, .. } => all(id, |&id| id == 0),
        }
    }

    /// The number of stored pixels, which is `width · height` in a valid image.
    pub fn pixels(&self) -> usize {
        match self {
            FrameImage::Color { rgba, .. } | FrameImage::Normal { rgba, .. } => rgba.len(),
            FrameImage::Depth { depth, .. } => depth.len(),
            FrameImage::Id { id, .. } => id.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pixel_is_enough_to_see_something() {
        let (width, height) = (3, 3);
        for seen in [None, Some(0), Some(4), Some(8)] {
            let image = |blank: u32, other: u32| {
                (0..9).map(move |i| if Some(i) == seen { other } else { blank })
            };
            let rgba = |blank: [u8; 4]| {
                let words = image(u32::from_le_bytes(blank), 7);
                words.map(u32::to_le_bytes).collect::<Vec<[u8; 4]>>()
            };
            let depth = image(f32::INFINITY.to_bits(), 7).map(f32::from_bits).collect();
            let images = [
                FrameImage::Color { width, height, rgba: rgba([9, 8, 7, 255]) },
                FrameImage::Normal { width, height, rgba: rgba([0; 4]) },
                FrameImage::Depth { width, height, depth },
                FrameImage::Id { width, height, id: image(0, 7).collect() },
            ];
            for image in images {
                assert_eq!(image.is_blank([9, 8, 7, 255]), seen.is_none(), "{image:?}");
            }
        }
    }
}
