//! Settings of reference frames, which have several pixels for each pixel of another frame.

use super::{Antialias, Background, Reconstruct, Settings};

impl Settings {
    /// Full detail with samples as splats, and no pixel averaged.
    #[must_use]
    pub fn exact() -> Settings {
        Settings::drawn_as(Reconstruct::Splats)
    }

    /// The settings for a frame with `parts` pixels along each side of one of this frame's: lengths in pixels are multiplied. With
    /// `transparent`, the background is.
    #[must_use]
    pub fn finer(&self, parts: u32, transparent: bool) -> Settings {
        let scale = parts as f32;
        let background = if transparent { Some(Background::TRANSPARENT) } else { self.background };
        Settings {
            line_width_px: self.line_width_px.times(scale),
            edl_radius_px: self.edl_radius_px.times(scale),
            background,
            ..*self
        }
    }

    /// The settings with 2 × 2 parts a pixel, if a frame of `size` then has at most `pixels` parts and `side` a side, or else without
    /// antialiasing.
    #[must_use]
    pub fn antialiased_within(&self, size: [u32; 2], pixels: u64, side: u32) -> Settings {
        let finer = Settings { antialias: Antialias::Parts4, ..*self };
        let [width, height] = size.map(|side| u64::from(side) * u64::from(finer.parts()));
        let fits = width * height <= pixels && width.max(height) <= u64::from(side);
        if fits { finer } else { Settings { antialias: Antialias::Off, ..*self } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Lod, SceneFacts};

    #[test]
    fn lengths_in_pixels_grow_with_the_frame() {
        let sparse = SceneFacts { sparse_lines: true, ..SceneFacts::default() };
        let exact = Settings::exact().with_line_width_decided(&sparse);
        assert_eq!((exact.lod, exact.parts(), exact.least_line_px()), (Lod::Full, 1, 1.0));
        let finer = exact.finer(4, true);
        assert_eq!(finer.least_line_px(), 4.0);
        assert_eq!(finer.edl_radius_px.get(), 4.0 * exact.edl_radius_px.get());
        assert_eq!(finer.background.map(Background::linear), Some([0.0; 4]));
        assert_eq!(exact.finer(1, false), exact);
        // The largest radius stays the largest.
        assert_eq!(exact.finer(100, false).edl_radius_px.get(), 16.0);
    }

    #[test]
    fn antialiasing_keeps_within_the_limits() {
        let parts =
            |pixels, side| Settings::exact().antialiased_within([8, 4], pixels, side).parts();
        assert_eq!((parts(128, 16), parts(127, 16), parts(128, 15)), (2, 1, 1));
    }
}
