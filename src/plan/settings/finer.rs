//! Settings of reference frames, which have several pixels for each pixel of another frame.

use serde_json::Value;

use super::{Antialias, Background, Given, Reconstruct, Settings, ShadowPx, declared};

impl Given {
    /// Settings of a reference for frames with these: [`Settings::exact`] in all that trades accuracy for time, and these in the rest.
    pub fn exact(&self) -> Settings {
        let mut given = *self;
        for setting in declared().iter().filter(|setting| setting.trades.is_some()) {
            // Nothing is wrong with `null`.
            let _ = given.set(setting.name, Value::Null);
        }
        let settings = Settings::from(given).without_goal().decided(Reconstruct::Splats);
        // Settings that went only with those that were removed are removed, too.
        let shadow_px = Settings::exact().shadow_px;
        Settings { shadow_px, ..Settings::from(settings.applied()) }
    }
}

impl Settings {
    /// Full detail with samples as splats and the largest shadow maps, and no pixel averaged.
    #[must_use]
    pub fn exact() -> Settings {
        Settings { shadow_px: ShadowPx::Side4096, ..Settings::drawn_as(Reconstruct::Splats) }
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
            ..self.of_part_times(parts)
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
    }

    /// A reference of clamped lengths would show another effect.
    #[test]
    fn references_draw_the_largest_lengths_in_full() {
        let mut given = Given::default();
        for (name, value) in [("edl", "on"), ("edl_radius_px", "16"), ("line_width_px", "64")] {
            given.set_text(name, value).unwrap();
        }
        let finer = given.resolve().unwrap().finer(crate::accuracy::truth::PARTS, false);
        // As settings of a frame, which are read from those that affect it.
        let drawn = Settings::from(finer.applied());
        assert_eq!((drawn.edl_radius_px.get(), drawn.least_line_px()), (64.0, 256.0));
        // Requests are held to their range.
        let mut wide = given;
        wide.edl_radius_px = Some(16.5);
        assert_eq!(wide.resolve().unwrap_err().setting, "edl_radius_px");
    }

    #[test]
    fn references_keep_what_trades_nothing() {
        let mut given = Given::default();
        for (name, value) in
            [("reconstruct", "points"), ("budget_ms", "9"), ("antialias", "16x"), ("edl", "on")]
        {
            given.set_text(name, value).unwrap();
        }
        let edl = Settings::from(given).edl;
        assert_eq!(given.exact(), Settings { edl, ..Settings::exact() });
        assert_eq!(Given::default().exact(), Settings::exact());
    }

    #[test]
    fn antialiasing_keeps_within_the_limits() {
        let parts =
            |pixels, side| Settings::exact().antialiased_within([8, 4], pixels, side).parts();
        assert_eq!((parts(128, 16), parts(127, 16), parts(128, 15)), (2, 1, 1));
    }
}
