//! Cuts a path into frames: their numbers, times, cameras and files. Pure.

use std::ops::RangeInclusive;

use super::FilmError;
use crate::encode::ImageFormat;
use crate::math::Camera;
use crate::scene::{CameraPath, PathSampler};

/// Largest number of frames of one path.
pub const MOST_FRAMES: u64 = 1_000_000;
/// Range of frames per second.
pub const FPS_RANGE: [f64; 2] = [0.001, 1000.0];

/// A path cut into frames.
#[derive(Clone, Debug)]
pub struct Shots {
    fps: f64,
    start_s: f64,
    sampler: PathSampler,
    count: u64,
    wanted: RangeInclusive<u64>,
}

/// One frame of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    pub number: u64,
    /// Time on the path, in seconds.
    pub t: f64,
    pub camera: Camera,
}

impl Shots {
    /// Cuts `path` into frames at `fps` frames per second (`None` for the path's own rate). The frames from `from` to `to`, both
    /// included, are wanted.
    ///
    /// # Errors
    /// The path cannot be followed, the range is not on the path, or there are more frames than [`MOST_FRAMES`].
    pub fn new(
        path: &CameraPath,
        fps: Option<f64>,
        from: Option<u64>,
        to: Option<u64>,
    ) -> Result<Shots, FilmError> {
        let bad = |parameter, reason: String| FilmError::BadRange { parameter, reason };
        let sampler = path.sampler().map_err(FilmError::Path)?;
        let fps = fps.unwrap_or(path.fps);
        let [least, most] = FPS_RANGE;
        if !(least..=most).contains(&fps) {
            return Err(bad("fps", format!("{fps} is out of range; accepted: {least} to {most}")));
        }
        let count = path.frame_count(fps);
        if count > MOST_FRAMES {
            let duration = path.duration_s();
            let reason = format!(
                "{duration} s at {fps} frames per second are {count} frames; at most {MOST_FRAMES} are possible"
            );
            return Err(bad("fps", reason));
        }
        let last = count - 1;
        let (from, to) = (from.unwrap_or(0), to.unwrap_or(last));
        if from > last {
            return Err(bad("from", format!("{from} is beyond the path's last frame, {last}")));
        }
        if to > last {
            return Err(bad("to", format!("{to} is beyond the path's last frame, {last}")));
        }
        if from > to {
            return Err(bad("from", format!("{from} is after the last requested frame, {to}")));
        }
        Ok(Shots { fps, start_s: path.frame_time_s(0, fps), sampler, count, wanted: from..=to })
    }

    /// The shots with the first `count` wanted frames alone.
    #[must_use]
    pub fn first(self, count: u64) -> Shots {
        let (first, last) = self.wanted.clone().into_inner();
        Shots { wanted: first..=last.min(first + count.saturating_sub(1)), ..self }
    }

    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// The number of frames of the whole path.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The numbers of the wanted frames.
    pub fn wanted(&self) -> RangeInclusive<u64> {
        self.wanted.clone()
    }

    /// The cameras of frame `number` at `count` times while the shutter is open, for a share of the time between two frames.
    pub fn while_open(&self, number: u64, open_share: f64, count: u32) -> Vec<Camera> {
        self.sampler.while_open(self.shot(number).t, open_share / self.fps, count)
    }

    /// Frame `number`: the camera `number / fps` seconds after the path's first key.
    pub fn shot(&self, number: u64) -> Shot {
        let t = self.start_s + number as f64 / self.fps;
        Shot { number, t, camera: self.sampler.at(t) }
    }
}

/// The file name of a frame, such as `frame-00042.png`.
pub fn file_name(number: u64, format: ImageFormat) -> String {
    format!("frame-{number:05}.{}", format.extension())
}

/// Whether [`file_name`] can give this name.
pub fn is_file_name(name: &str) -> bool {
    let Some((number, extension)) =
        name.strip_prefix("frame-").and_then(|rest| rest.split_once('.'))
    else {
        return false;
    };
    let plain =
        |text: &str, test: fn(&u8) -> bool| !text.is_empty() && text.bytes().all(|b| test(&b));
    plain(number, u8::is_ascii_digit) && plain(extension, u8::is_ascii_lowercase)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::parse_path;

    fn path() -> CameraPath {
        let text = r#"{ "fps": 10, "keys": [
            { "t": 2, "eye": [0, 0, 5], "target": [0, 0, 0] }, { "t": 4, "eye": [5, 0, 0], "target": [0, 0, 0] } ] }"#;
        parse_path(text, "p", DVec3::Y).unwrap()
    }

    #[test]
    fn frames_of_a_path() {
        let shots = Shots::new(&path(), None, None, None).unwrap();
        assert_eq!((shots.count(), shots.wanted()), (21, 0..=20));
        assert_eq!(shots.shot(0).camera, path().keys[0].camera);
        let last = shots.shot(20);
        assert_eq!((last.t, last.camera), (4.0, path().keys[1].camera));
        let part = Shots::new(&path(), Some(5.0), Some(3), Some(4)).unwrap();
        assert_eq!((part.count(), part.wanted(), part.fps()), (11, 3..=4, 5.0));
        assert_eq!(part.shot(5), Shot { number: 5, ..shots.shot(10) });
        assert_eq!(part.first(9).wanted(), 3..=4);
        assert_eq!(shots.first(9).wanted(), 0..=8);
    }

    #[test]
    fn frames_that_are_none_are_refused() {
        for (fps, from, to, expected) in [
            (None, Some(21), None, "from: 21 is beyond the path's last frame, 20"),
            (None, None, Some(21), "to: 21 is beyond the path's last frame, 20"),
            (None, Some(5), Some(4), "from: 5 is after"),
            (Some(0.0), None, None, "fps: 0 is out of range"),
            (Some(f64::NAN), None, None, "fps: NaN is out of range"),
        ] {
            let refused = Shots::new(&path(), fps, from, to).unwrap_err().to_string();
            assert!(refused.contains(expected), "{refused}");
        }
        let mut long = path();
        long.keys[1].t = 1e6;
        let refused = Shots::new(&long, None, None, None).unwrap_err().to_string();
        assert!(refused.contains("1000000 are possible"), "{refused}");
    }

    #[test]
    fn names_of_files() {
        assert_eq!(file_name(42, ImageFormat::Jpeg), "frame-00042.jpg");
        assert_eq!(file_name(123_456, ImageFormat::Png), "frame-123456.png");
        assert!(is_file_name("frame-00042.jpg") && is_file_name("frame-1.png"));
        for other in
            ["frame-.png", "frame-1", "frame-1.", "a.png", "frame-1.png/..", "../frame-1.png"]
        {
            assert!(!is_file_name(other), "{other}");
        }
    }
}
