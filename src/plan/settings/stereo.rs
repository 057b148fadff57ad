//! Settings of the images of a stereo pair.

use super::{FocusDistance, Settings};

impl Settings {
    /// Names of the settings, for errors.
    pub const EYE: &str = "eye_offset";
    pub const STEREO: &str = "stereo_distance";

    /// Shift of the eye to the right in scene units; `None` where there is none.
    pub fn eye_shift(&self) -> Option<f64> {
        self.eye_offset.get()
    }

    /// Distance along the viewing axis, in scene units, of what both images show in the same place, where it is given.
    pub fn stereo_at(&self) -> Option<f64> {
        self.stereo_distance.get()
    }

    /// The settings with the eye shifted to the right.
    #[must_use]
    pub fn shifted(&self, offset: f64) -> Settings {
        Settings { eye_offset: offset.into(), ..*self }
    }

    /// The settings of an image that shows what is `distance` away where an unshifted eye sees it, or at the nearest distance that a setting may have.
    #[must_use]
    pub fn stereo_from(&self, distance: f64) -> Settings {
        Settings { stereo_distance: FocusDistance::nearest(distance), ..*self }
    }
}
