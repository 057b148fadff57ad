//! Pixels before they are encoded.

use crate::plan::Output;

/// The pixels of a frame, top row first.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameImage {
    /// sRGB with straight alpha.
    Color { width: u32, height: u32, rgba: Vec<[u8; 4]> },
    /// Distance along the viewing axis in scene units; `f32::INFINITY` where nothing is.
    Depth { width: u32, height: u32, depth: Vec<f32> },
    /// Unit vectors as `n · 127 + 128` a byte, alpha 255; all zero where nothing or no normal is.
    Normal { width: u32, height: u32, rgba: Vec<[u8; 4]> },
    /// Instance number plus one (in the order of [`crate::scene::Scene::instances`] with each
    /// asset's placements expanded), 0 where nothing is.
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

    /// Which of a frame's images this is.
    pub fn output(&self) -> Output {
        match self {
            FrameImage::Color { .. } => Output::Color,
            FrameImage::Depth { .. } => Output::Depth,
            FrameImage::Normal { .. } => Output::Normal,
            FrameImage::Id { .. } => Output::Id,
        }
    }

    /// How many pixels are stored; `width · height` in a sound image.
    pub fn pixels(&self) -> usize {
        match self {
            FrameImage::Color { rgba, .. } | FrameImage::Normal { rgba, .. } => rgba.len(),
            FrameImage::Depth { depth, .. } => depth.len(),
            FrameImage::Id { id, .. } => id.len(),
        }
    }
}
