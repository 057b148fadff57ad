//! Settings of depth of field and motion blur.

use super::{Accepted, Aperture, FocusDistance, Given, Output, SettingError, Settings, Shutter};
use crate::words::words;

words! {
    /// Number of exposures whose mean a frame is.
    pub enum BlurSamples {
        /// A draft, in which blur is a few shifted images
        #[serde(rename = "4")]
        #[value(name = "4")]
        Exposures4,
        /// For slight blur, of some 4 pixels
        #[serde(rename = "8")]
        #[value(name = "8")]
        Exposures8,
        /// For blur of some 8 pixels
        #[serde(rename = "16")]
        #[value(name = "16")]
        Exposures16,
        /// For blur of some 12 pixels
        #[default]
        #[serde(rename = "32")]
        #[value(name = "32")]
        Exposures32,
        /// For blur of some 20 pixels
        #[serde(rename = "64")]
        #[value(name = "64")]
        Exposures64,
        /// For blur of some 30 pixels
        #[serde(rename = "128")]
        #[value(name = "128")]
        Exposures128,
        /// For wide blur of small bright things
        #[serde(rename = "256")]
        #[value(name = "256")]
        Exposures256,
    }
}

impl BlurSamples {
    fn get(self) -> u32 {
        4 << self as u32
    }
}

impl Settings {
    /// Names of the settings, for errors.
    pub const LENS: &str = "aperture";
    pub const FOCUS: &str = "focus_distance";
    pub const SHUTTER: &str = "shutter";
    pub const EXPOSURES: &str = "blur_samples";

    /// Diameter of the lens in scene units; `None` for a pinhole.
    pub fn lens_diameter(&self) -> Option<f64> {
        self.aperture.get()
    }

    /// Distance along the viewing axis at which things are sharp, in scene units, where it is given.
    pub fn focus(&self) -> Option<f64> {
        self.focus_distance.get()
    }

    /// Share of the time between two frames for which the shutter is open; `None` for an instant.
    pub fn open_share(&self) -> Option<f64> {
        self.shutter.get()
    }

    /// Whether a frame is the mean of several exposures.
    pub fn is_blurred(&self) -> bool {
        self.lens_diameter().is_some() || self.open_share().is_some()
    }

    /// Number of exposures whose mean a frame is.
    pub fn exposures(&self) -> u32 {
        if self.is_blurred() { self.blur_samples.get() } else { 1 }
    }

    /// The settings of a frame of an output. Colours alone are blurred, and by motion only where the camera `moves` while the shutter is open.
    #[must_use]
    pub fn with_blur_decided(&self, output: Output, moves: bool) -> Settings {
        if output != Output::Color {
            return self.without_blur();
        }
        let shutter = if moves { self.shutter } else { Shutter::default() };
        let settings = Settings { shutter, ..*self };
        if settings.is_blurred() { settings } else { settings.without_blur() }
    }

    /// The settings of a sharp frame.
    #[must_use]
    pub fn without_blur(&self) -> Settings {
        let (aperture, shutter) = (Aperture::default(), Shutter::default());
        let (focus_distance, blur_samples) = (FocusDistance::default(), BlurSamples::default());
        Settings { aperture, shutter, focus_distance, blur_samples, ..*self }
    }

    /// The settings with the plane of focus at a distance, or at the nearest one that a setting may have.
    #[must_use]
    pub fn focused_at(&self, distance: f64) -> Settings {
        Settings { focus_distance: FocusDistance::nearest(distance), ..*self }
    }
}

impl Given {
    /// Refuses a number of exposures where nothing is blurred. No rule of a setting's needs says this, since an aperture or a shutter will do.
    pub(super) fn check_exposures(&self) -> Result<(), SettingError> {
        let is_default = self.blur_samples.unwrap_or_default() == BlurSamples::default();
        if is_default || Settings::from(*self).is_blurred() {
            return Ok(());
        }
        let reason = "nothing is blurred, because there is neither an aperture nor an open shutter";
        let accepted = "`32`, or another value together with an aperture or a shutter above 0";
        Err(SettingError {
            setting: Settings::EXPOSURES,
            reason: reason.to_owned(),
            accepted: Accepted::Values(accepted.to_owned()),
        })
    }

    /// Leaves out an inherited number of exposures where `own` settings have ended the blur.
    #[must_use]
    pub(super) fn without_idle_exposures(self, own: &Given) -> Given {
        let ends_blur = own.aperture.is_some() || own.shutter.is_some();
        let is_idle = ends_blur && own.blur_samples.is_none() && !Settings::from(self).is_blurred();
        if is_idle { Given { blur_samples: None, ..self } } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::MOST_EXPOSURES;
    use clap::ValueEnum;

    #[test]
    fn blur_needs_an_aperture_or_a_moving_camera() {
        let sharp = Settings::default();
        let lens = Settings { aperture: 0.5.into(), ..sharp };
        let moving = Settings { shutter: 0.5.into(), ..sharp };
        assert_eq!([sharp, lens, moving].map(|one| one.exposures()), [1, 32, 32]);
        assert_eq!(Settings { aperture: 0.0.into(), shutter: 0.0.into(), ..sharp }, sharp);
        assert_eq!(moving.with_blur_decided(Output::Color, false), sharp);
        assert_eq!(moving.with_blur_decided(Output::Color, true), moving);
        // The server checks settings again that it chose for a goal, so no number of exposures may be left over.
        let many = Settings { blur_samples: BlurSamples::Exposures64, ..moving };
        assert_eq!(many.with_blur_decided(Output::Color, false), sharp);
        assert_eq!(many.with_blur_decided(Output::Depth, true), sharp);
        assert_eq!(lens.with_blur_decided(Output::Color, false), lens);
        let focused = lens.focused_at(2.0);
        assert_eq!((focused.focus(), focused.without_blur()), (Some(2.0), sharp));
        assert_eq!(focused.with_blur_decided(Output::Depth, true), sharp);
        assert_eq!(lens.focused_at(1e30).focus(), Some(1e9));
    }

    #[test]
    fn numbers_of_exposures_are_those_of_their_names() {
        for value in BlurSamples::value_variants() {
            let name = value.to_possible_value().unwrap().get_name().to_owned();
            assert_eq!(name, value.get().to_string());
        }
        assert_eq!(BlurSamples::Exposures256.get(), MOST_EXPOSURES);
    }
}
