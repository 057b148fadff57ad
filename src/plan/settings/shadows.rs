//! Settings of shadows.

use super::Settings;
use crate::plan::SceneFacts;
use crate::words::words;

words! {
    /// Whether lights cast shadows.
    pub enum Shadows {
        /// Those of the scene's lights that have `"shadows": true`
        #[default]
        On,
        /// None
        Off,
    }

    /// Side of a shadow map in pixels.
    pub enum ShadowPx {
        /// A sixteenth of the default's pixels
        #[serde(rename = "512")]
        #[value(name = "512")]
        Side512,
        /// A quarter of the default's pixels
        #[serde(rename = "1024")]
        #[value(name = "1024")]
        Side1024,
        /// Shadows of a scene that fills the frame have edges as exact as a pixel
        #[default]
        #[serde(rename = "2048")]
        #[value(name = "2048")]
        Side2048,
        /// Four times the default's pixels
        #[serde(rename = "4096")]
        #[value(name = "4096")]
        Side4096,
    }
}

impl ShadowPx {
    pub fn get(self) -> u32 {
        match self {
            ShadowPx::Side512 => 512,
            ShadowPx::Side1024 => 1024,
            ShadowPx::Side2048 => 2048,
            ShadowPx::Side4096 => 4096,
        }
    }

    /// The largest size up to this one at which `maps` maps have at most `pixels` pixels; the smallest size where none has.
    fn within(self, maps: u32, pixels: u64) -> ShadowPx {
        let sizes = [self, ShadowPx::Side2048, ShadowPx::Side1024, ShadowPx::Side512];
        let fits = |size: &ShadowPx| {
            let side = u64::from(size.get());
            size.get() <= self.get() && u64::from(maps) * side * side <= pixels
        };
        sizes.into_iter().find(fits).unwrap_or(ShadowPx::Side512)
    }
}

impl Settings {
    /// The settings with shadow maps of a size that a frame of at most `pixels` pixels may have.
    #[must_use]
    pub fn with_shadow_maps_within(&self, scene: &SceneFacts, pixels: u64) -> Settings {
        let shadow_px = self.shadow_px.within(scene.casting_lights, pixels);
        Settings { shadow_px, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_no_more_pixels_than_a_frame() {
        let sides = |asked, maps, pixels| {
            let settings = Settings { shadow_px: asked, ..Settings::default() };
            let scene = SceneFacts { casting_lights: maps, ..SceneFacts::default() };
            settings.with_shadow_maps_within(&scene, pixels).shadow_px.get()
        };
        assert_eq!(sides(ShadowPx::default(), 1, 1 << 22), 2048);
        assert_eq!(sides(ShadowPx::default(), 1, (1 << 22) - 1), 1024);
        assert_eq!(sides(ShadowPx::default(), 4, 1 << 22), 1024);
        assert_eq!(sides(ShadowPx::Side4096, 4, 1 << 24), 2048);
        assert_eq!(sides(ShadowPx::Side512, 1, 1 << 24), 512);
        assert_eq!(sides(ShadowPx::Side4096, 4, 1), 512);
    }
}
