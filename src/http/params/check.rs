//! Enforces the parts of the contract's schemas that depend on a single parameter.

use super::{FrameParams, choice};
use crate::engine::EngineError;
use crate::http::problem::Problem;
use crate::math::{FARTHEST, FOV_RANGE_DEG, ORTHO_HEIGHT_RANGE};
use crate::plan::Wait;
use crate::scene::Up;

/// Longest name of a camera, a path or a node in a request.
pub const MAX_NAME_CHARS: usize = 256;
/// Quality of lossy formats.
pub const QUALITY_RANGE: [u8; 2] = [1, 100];
/// Longest deadline, in milliseconds.
pub const MAX_DEADLINE_MS: f64 = 3_600_000.0;

impl FrameParams {
    /// Refuses values that no frame can have, without looking at other parameters or at a scene.
    ///
    /// # Errors
    /// Names the parameter and the accepted values.
    pub fn check(&self) -> Result<(), Problem> {
        let refused = |name: &str, reason: String, accepted: String| {
            Err(Problem::parameter(name, reason, accepted))
        };
        let length = self.camera.as_ref().map(|name| name.chars().count());
        if length.is_some_and(|length| length == 0 || length > MAX_NAME_CHARS) {
            let reason = "has no usable length".to_owned();
            return refused("camera", reason, format!("1 to {MAX_NAME_CHARS} characters"));
        }
        for (name, vector) in [
            ("eye", self.eye),
            ("target", self.target),
            ("up", self.up.map(|Up(up)| up.to_array())),
        ] {
            let is_far = |number: &f64| number.is_nan() || number.abs() > FARTHEST;
            if let Some(number) = vector.iter().flatten().find(|number| is_far(number)) {
                let accepted = format!("numbers from {:e} to {FARTHEST:e}", -FARTHEST);
                return refused(name, format!("{number:e} is out of range"), accepted);
            }
        }
        let [least, most] = FOV_RANGE_DEG;
        if let Some(fov) = self.fov.filter(|fov| !(least..=most).contains(fov)) {
            return refused(
                "fov",
                match fov.abs() < 1e6 {
                    true => format!("{fov} is out of range"),
                    false => format!("{fov:e} is out of range"),
                },
                format!("{least} to {most} degrees"),
            );
        }
        let [least, most] = ORTHO_HEIGHT_RANGE;
        if let Some(height) = self.ortho_height.filter(|height| !(least..=most).contains(height)) {
            return refused(
                "ortho_height",
                format!("{height:e} is out of range"),
                format!("{least:e} to {most:e} scene units"),
            );
        }
        for (name, side) in [("w", self.w), ("h", self.h)] {
            // The engine checks the largest side, because it depends on the adapter.
            if side == Some(0) {
                let accepted = "a whole number of pixels, at least 1".to_owned();
                return refused(name, "must not be 0".to_owned(), accepted);
            }
        }
        let [least, most] = QUALITY_RANGE;
        if let Some(quality) = self.quality.filter(|quality| !(least..=most).contains(quality)) {
            return refused(
                "quality",
                format!("{quality} is out of range"),
                format!("{least} to {most}"),
            );
        }
        if let Some(ms) = self.deadline_ms.filter(|ms| !(*ms > 0.0 && *ms <= MAX_DEADLINE_MS)) {
            let accepted = format!("milliseconds above 0, at most {MAX_DEADLINE_MS}");
            return refused("deadline_ms", format!("{ms} is out of range"), accepted);
        }
        self.check_words()
    }

    /// Refuses sizes beyond the longest side of a frame.
    pub fn check_sides(&self, longest: u32) -> Result<(), Problem> {
        let sides = [("w", "pixels in w", self.w), ("h", "pixels in h", self.h)];
        for (parameter, what, side) in sides {
            if let Some(side) = side.filter(|side| *side > longest) {
                let (found, limit) = (u64::from(side), u64::from(longest));
                let parameter = Some(parameter);
                return Err(EngineError::OverLimit { what, found, limit, parameter }.into());
            }
        }
        Ok(())
    }

    fn check_words(&self) -> Result<(), Problem> {
        self.format()?;
        self.output()?;
        choice::<Wait>("wait", self.wait.as_deref())?;
        Ok(self.settings.check()?)
    }
}
