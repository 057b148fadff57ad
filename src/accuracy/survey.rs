//! Draws what a survey measures, with the engine, and writes every finished measurement to the journal.
//!
//! 1. The reference of each pose is drawn, or read from the folder of the report.
//! 2. Each row is drawn once at each pose: colours, coverage, depths and normals are compared with the reference. This frame is also the
//!    discarded warm-up, in which the driver compiles shaders.
//! 3. The frames that are timed are drawn in random order over all poses and rows.
//!
//! Rows whose frames the program draws alike are drawn once; the others name that row and the receipt's reason.
//!
//! Frames of a camera path are compared with those before them ([`Survey::run_along`]).
//!
//! A survey without a folder keeps no frames, and draws the reference of a pose anew when it is needed.

mod along;
mod compare;
mod known;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

pub use self::along::{MOST_FRAMES, Path as AlongPath};

use self::compare::notes;
use self::known::Known;
use super::journal::{Identity, Journal, JournalError, PoseRecord, Record, write_whole};
use super::metrics::SizeMismatch;
use super::poses::{UnknownCamera, around, of_cameras};
use super::reference::Reference;
use super::sweep::{Row, order, owners, slug, steps};
use super::truth::{Finer, PARTS, Truth, Wide, floats, is_covered, quads};
use crate::encode::{EncodeError, FrameImage, ImageFormat, encode};
use crate::engine::receipt::PassReceipt;
use crate::engine::{Client, EncodedFrame, Engine, EngineError, FrameRequest, Pose, SceneInfo};
use crate::math::{Camera, CameraError, Lens};
use crate::plan::{Given, Output, Pass, Settings};

/// Folder of the frames in a report, and of the references within it.
pub const FRAMES: &str = "frames";

/// Why a survey ended early.
#[derive(Debug, thiserror::Error)]
pub enum SurveyError {
    #[error(transparent)]
    Journal(#[from] JournalError),
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    Size(#[from] SizeMismatch),
    #[error(transparent)]
    UnknownCamera(#[from] UnknownCamera),
    #[error("{file}: {error}", file = file.display())]
    Io { file: PathBuf, error: std::io::Error },
    #[error("{0} has no GPU timestamps, so frames cannot be timed on it")]
    NoTimestamps(String),
    #[error(
        "a frame of {width}x{height} needs a reference of {wide}x{high} pixels, and the limits are {pixels} pixels and {side} a side; give a smaller --size"
    )]
    TooLarge { width: u32, height: u32, wide: u32, high: u32, pixels: u64, side: u32 },
    #[error(
        "pose {0} shows nothing of the scene, so there is nothing to compare; choose other cameras"
    )]
    Blank(String),
    #[error("the survey was told to stop")]
    Stopped,
}

/// A pose with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedPose {
    pub name: String,
    /// Folder of its frames in [`FRAMES`].
    pub folder: String,
    pub camera: Camera,
}

impl NamedPose {
    /// The pose with this number and name in a survey; the number keeps folders of similar names apart.
    pub fn new(number: usize, name: &str, camera: Camera) -> NamedPose {
        let folder = format!("{}-{}", number + 1, slug(name)).trim_end_matches('-').to_owned();
        NamedPose { name: name.to_owned(), folder, camera }
    }

    /// The pose as the journal has it.
    pub fn record(&self) -> PoseRecord {
        let Camera { eye, target, up, lens } = self.camera;
        PoseRecord {
            name: self.name.clone(),
            folder: self.folder.clone(),
            eye: eye.into(),
            target: target.into(),
            up: up.into(),
            fov_deg: lens.fov_deg(),
            ortho_height: lens.ortho_height(),
        }
    }
}

/// Longest pause before a frame that the engine could not take is tried again.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// What a survey is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A comparison of all outputs, without what only some settings have.
    Report,
    /// Predictions for frames as requests have them: colours alone, with everything that belongs to them.
    Planner,
}

/// What a survey draws.
pub struct Survey<'a> {
    pub engine: &'a Engine,
    /// Client whose share of the device the frames take.
    pub client: Client,
    /// Id of the scene in the engine.
    pub scene: &'a str,
    pub poses: Vec<NamedPose>,
    pub rows: Vec<Row>,
    pub size: [u32; 2],
    pub repeats: u32,
    pub seed: u64,
    /// The f64 oracle's scene, where its frames are the references.
    pub oracle: Option<&'a Reference>,
    /// Folder of the report, where there is one.
    pub folder: Option<&'a Path>,
    pub purpose: Purpose,
    /// Ends the survey after the frame at hand.
    pub stop: &'a AtomicBool,
}

/// Progress of a survey.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event<'a> {
    /// Number of the step that begins now, from 1.
    pub done: u64,
    pub total: u64,
    /// The step, in words.
    pub what: &'a str,
}

/// File of an image of a row at a pose, relative to the report: the frame, or with `-flip` its FLIP map.
pub fn frame_file(folder: &str, slug_of_row: &str, suffix: &str) -> String {
    format!("{FRAMES}/{folder}/{slug_of_row}{suffix}.png")
}

/// Slug of the reference among the rows of a pose.
pub const REFERENCE: &str = "reference";

impl Survey<'_> {
    /// Finds the poses: cameras of the scene, by their names or the first ones, or views around a scene without cameras. With `first_only`, one
    /// pose unless cameras are named.
    ///
    /// # Errors
    /// A name that is not among the scene's cameras, or the engine fails.
    pub fn find_poses(
        &mut self,
        info: &SceneInfo,
        names: &[String],
        first_only: bool,
    ) -> Result<(), SurveyError> {
        self.poses = if info.cameras.is_empty() && names.is_empty() {
            around(&self.default_view()?)
        } else {
            of_cameras(&info.cameras, names)?
        };
        if first_only && names.is_empty() {
            self.poses.truncate(1);
        }
        Ok(())
    }

    /// The camera of the scene's default view.
    ///
    /// # Errors
    /// The engine fails.
    pub fn default_view(&self) -> Result<Camera, SurveyError> {
        let seen = self.draw(self.request_at(Pose::FIT))?.receipt.camera.clone();
        let lens = Lens::given(seen.fov_deg, seen.ortho_height);
        let lens = lens.unwrap_or(Lens::Perspective { fov_deg: 40.0 });
        let [eye, target, up] = [seen.eye, seen.target, seen.up].map(glam::DVec3::from);
        Ok(Camera { eye, target, up, lens })
    }

    /// Leaves out the poses from which nothing is seen, and returns their names.
    ///
    /// # Errors
    /// The engine fails.
    pub fn leave_out_blank(&mut self) -> Result<Vec<String>, SurveyError> {
        let mut blank = Vec::new();
        for pose in &self.poses {
            let settings = self.complete(Settings::exact()).finer(1, true);
            let frame =
                self.draw(self.request(Pose::Camera(pose.camera), settings, Output::Color))?;
            if !quads(&frame.bytes).into_iter().any(is_covered) {
                blank.push(pose.name.clone());
            }
        }
        self.poses.retain(|pose| !blank.contains(&pose.name));
        Ok(blank)
    }

    /// What the survey measures, for the journal. `scene` is the scene's name in the report.
    ///
    /// # Errors
    /// The engine refuses the scene's first frame, or the size is beyond a limit.
    pub fn identity(&self, scene: &str) -> Result<Identity, SurveyError> {
        let reference = self.reference_in_words()?;
        let first = self.poses.first().map_or(Pose::FIT, |pose| Pose::Camera(pose.camera));
        let tag = self.engine.resolve_blocking(self.request_at(first))?.etag().to_owned();
        let [width, height] = self.size;
        Ok(Identity {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            adapter: self.engine.adapter(),
            scene: scene.to_owned(),
            tag,
            width,
            height,
            repeats: self.repeats,
            seed: self.seed,
            reference,
            poses: self.poses.iter().map(NamedPose::record).collect(),
            rows: self.rows.iter().map(|row| row.label.clone()).collect(),
            path: None,
        })
    }

    /// A frame at a pose, as the program draws it when nothing is chosen.
    pub fn request_at(&self, pose: Pose) -> FrameRequest {
        self.request(pose, self.complete(Settings::default()), Output::Color)
    }

    /// Frames of all rows at the first pose, and of the reference: what they need can be baked before.
    pub fn requests(&self) -> Vec<FrameRequest> {
        let Some(first) = self.poses.first() else { return Vec::new() };
        let exact = self.request(
            Pose::Camera(first.camera),
            self.complete(Settings::exact()),
            Output::Color,
        );
        let rows = self.rows.iter().map(|row| self.row_request(first.camera, row));
        // A row that is refused needs nothing.
        rows.chain([exact]).filter(|request| self.engine.must_bake(request)).collect()
    }

    fn request(&self, pose: Pose, settings: Settings, output: Output) -> FrameRequest {
        FrameRequest {
            scene: self.scene.to_owned(),
            pose,
            width: self.size[0],
            height: self.size[1],
            settings,
            output,
            format: ImageFormat::Raw,
            quality: 100,
            deadline: None,
        }
    }

    /// Settings with which a frame waits for everything that it needs.
    fn complete(&self, settings: Settings) -> Settings {
        match self.purpose {
            Purpose::Report => settings.comparable().complete(),
            Purpose::Planner => settings.complete(),
        }
    }

    /// Draws a frame. While the engine has no room for it or has lost its device, the survey waits.
    pub fn draw(&self, request: FrameRequest) -> Result<Arc<EncodedFrame>, SurveyError> {
        loop {
            let drawn = self.engine.submit_for(self.client, request.clone());
            match drawn.and_then(crate::engine::FrameTicket::wait) {
                Err(
                    EngineError::Busy { retry_after } | EngineError::DeviceLost { retry_after },
                ) => {
                    if self.stop.load(Ordering::Relaxed) {
                        return Err(SurveyError::Stopped);
                    }
                    std::thread::sleep(retry_after.min(LONGEST_PAUSE));
                }
                other => return Ok(other?),
            }
        }
    }

    /// How references are drawn.
    fn finer(&self) -> Result<Finer, SurveyError> {
        let limits = self.engine.limits();
        Finer::new(self.size, &limits).ok_or_else(|| {
            let [width, height] = self.size;
            let [wide, high] = self.size.map(|side| side.saturating_mul(PARTS));
            let (pixels, side) = (limits.max_pixels, limits.max_side);
            SurveyError::TooLarge { width, height, wide, high, pixels, side }
        })
    }

    fn reference_in_words(&self) -> Result<String, SurveyError> {
        if self.oracle.is_some() {
            return Ok(format!(
                "the f64 oracle on the CPU: every sample as a splat, every triangle and line, {PARTS} × {PARTS} parts a pixel, averaged in linear light"
            ));
        }
        let wide = self.finer()?;
        let (parts, Finer { width, height, .. }) = (wide.parts(), wide);
        let finer = if parts > 1 {
            format!(", each of them the mean of {parts} × {parts} parts")
        } else {
            String::new()
        };
        Ok(format!(
            "full detail at {PARTS} × {PARTS} times the pixels ({width}x{height}){finer}, averaged in linear light; samples as splats, meshes as triangles, drawn by the engine"
        ))
    }

    /// Draws the reference from a camera.
    ///
    /// # Errors
    /// The engine fails, or the size is beyond a limit.
    pub fn truth(&self, camera: Camera) -> Result<Truth, SurveyError> {
        let [width, height] = self.size;
        if let Some(oracle) = self.oracle {
            let view = camera.view(width, height)?;
            let splats = oracle.description().splats;
            return Ok(Truth::of_oracle(&oracle.frame_with(&view, PARTS, Some(&splats))));
        }
        let (finer, own, decided) = self.reference_request(camera)?;
        let draw =
            |output, transparent| self.draw(finer.request(&own, &decided, output, transparent));
        let color = quads(&draw(Output::Color, false)?.bytes);
        let coverage = quads(&draw(Output::Color, true)?.bytes);
        if self.purpose == Purpose::Planner {
            return Ok(Truth::of_colors(self.size, PARTS, &color, &coverage));
        }
        let depth = floats(&draw(Output::Depth, false)?.bytes);
        let normal = quads(&draw(Output::Normal, false)?.bytes);
        let wide = Wide { color, coverage, depth, normal };
        Ok(Truth::of_wide(width, height, PARTS, &wide))
    }

    /// What the reference from a camera is made of: its size, a frame at full detail, and the settings that this frame resolves to.
    fn reference_request(
        &self,
        camera: Camera,
    ) -> Result<(Finer, FrameRequest, Settings), SurveyError> {
        let settings = self.complete(Settings::exact());
        let own = self.request(Pose::Camera(camera), settings, Output::Color);
        let decided = *self.engine.resolve_blocking(own.clone())?.settings();
        Ok((self.finer()?, own, self.complete(decided)))
    }

    /// The reference of a pose, from the folder if it is there. `key` is that of the survey.
    fn kept_truth(&self, pose: &NamedPose, key: u64) -> Result<Truth, SurveyError> {
        let png = self.file(pose, REFERENCE, "");
        let file = png.as_ref().map(|png| png.with_extension(format!("{key:016x}.gz")));
        let [width, height] = self.size;
        if let (Some(png), Some(file)) = (&png, &file)
            && let Some(truth) = Truth::read(file, width, height).filter(|_| png.exists())
        {
            return Ok(truth);
        }
        let truth = self.truth(pose.camera)?;
        if truth.covered_pixels() == 0 {
            return Err(SurveyError::Blank(pose.name.clone()));
        }
        if let (Some(png), Some(file)) = (png, file) {
            self.write_png(&png, truth.color.clone())?;
            truth.write(&file).map_err(|error| SurveyError::Io { file, error })?;
        }
        Ok(truth)
    }

    /// Path of an image of a pose; `None` without a folder.
    fn file(&self, pose: &NamedPose, slug_of_row: &str, suffix: &str) -> Option<PathBuf> {
        Some(self.folder?.join(frame_file(&pose.folder, slug_of_row, suffix)))
    }

    fn write_png(&self, file: &Path, rgba: Vec<[u8; 4]>) -> Result<(), SurveyError> {
        let [width, height] = self.size;
        let png = encode(&FrameImage::Color { width, height, rgba }, ImageFormat::Png, 100)?;
        let failed = |error| SurveyError::Io { file: file.to_owned(), error };
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        write_whole(file, &png.bytes).map_err(failed)
    }

    /// Draws what the journal lacks, and returns whether everything is there.
    ///
    /// # Errors
    /// The engine fails, a file cannot be written, or the adapter has no timestamps.
    pub fn run(
        &self,
        journal: &mut Journal,
        tell: impl FnMut(Event<'_>),
    ) -> Result<bool, SurveyError> {
        match self.draw_missing(journal, tell) {
            Ok(()) => Ok(true),
            Err(SurveyError::Stopped) => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn check_stop(&self) -> Result<(), SurveyError> {
        if self.stop.load(Ordering::Relaxed) { Err(SurveyError::Stopped) } else { Ok(()) }
    }

    fn draw_missing(
        &self,
        journal: &mut Journal,
        mut tell: impl FnMut(Event<'_>),
    ) -> Result<(), SurveyError> {
        let mut known = Known::of(&journal.records);
        let key = journal.key;
        let owners_at = |pose: &NamedPose| self.owners(pose.camera, &self.rows);
        let planned = self.poses.iter().map(|pose| self.check_stop().map(|()| owners_at(pose)));
        let planned: Vec<_> = planned.collect::<Result<_, SurveyError>>()?;
        let steps_of = |owners: &[Option<usize>]| steps(owners, self.repeats);
        let mut total: u64 = planned.iter().map(|(_, owners)| steps_of(owners)).sum();
        let mut done = 0;
        let mut warm = HashSet::new();
        for ((pose_number, pose), (drawn, owners)) in self.poses.iter().enumerate().zip(&planned) {
            let mut truth = None;
            if self.file(pose, REFERENCE, "").is_some_and(|file| !file.exists()) {
                truth = Some(self.kept_truth(pose, key)?);
            }
            let is_missing = |row: &Row| !known.has(&pose.name, &row.label);
            if self.purpose == Purpose::Planner && self.rows.iter().any(is_missing) {
                truth = match self.kept_truth(pose, key) {
                    // At another size, something was seen.
                    Err(SurveyError::Blank(_)) => {
                        total -= steps_of(owners);
                        continue;
                    }
                    truth => Some(truth?),
                };
            }
            for (row_number, row) in self.rows.iter().enumerate() {
                self.check_stop()?;
                done += 1;
                let frame = self.file(pose, &row.slug(), "");
                let is_lost = owners[row_number] == Some(row_number)
                    && frame.is_some_and(|frame| !frame.exists());
                if known.has(&pose.name, &row.label) && !is_lost {
                    continue;
                }
                tell(Event { done, total, what: &format!("{}, {}", pose.name, row.label) });
                let (name, label) = (pose.name.clone(), row.label.clone());
                let record = match (&drawn[row_number], owners[row_number]) {
                    (Err(why), _) => Record::Refused { pose: name, row: label, why: why.clone() },
                    (Ok(_), Some(owner)) if owner != row_number => {
                        let notes = notes(&self.draw(self.row_request(pose.camera, row))?.receipt);
                        let same_as = self.rows[owner].label.clone();
                        Record::Same { pose: name, row: label, same_as, notes }
                    }
                    (Ok(_), _) => {
                        let truth = match &truth {
                            Some(truth) => truth,
                            None => truth.insert(self.kept_truth(pose, key)?),
                        };
                        warm.insert((pose_number, row_number));
                        self.compare(pose, row, truth)?
                    }
                };
                known.see(&record);
                journal.add(record)?;
            }
        }
        let subjects = known.subjects(&self.poses, &self.rows);
        let draws = order(&subjects, self.repeats, self.seed);
        // Frames that turned out to be drawn as those of other rows are not timed.
        let total = done + draws.len() as u64;
        for draw in draws {
            self.check_stop()?;
            done += 1;
            let (pose, row) = (&self.poses[draw.pose], &self.rows[draw.row]);
            if known.is_timed(pose, row, &draw) {
                continue;
            }
            tell(Event { done, total, what: &format!("timing {}, {}", pose.name, row.label) });
            if warm.insert((draw.pose, draw.row)) {
                self.draw(self.row_request(pose.camera, row))?;
            }
            let receipt = self.draw_timed(pose.camera, row)?.receipt.clone();
            let ns = receipt.gpu_share_ns();
            let gpu_ms = ns.ok_or(SurveyError::NoTimestamps(receipt.adapter))? as f64 / 1e6;
            let (pose, row) = (pose.name.clone(), row.label.clone());
            journal.add(Record::Time { pose, row, repeat: draw.repeat, gpu_ms })?;
        }
        Ok(())
    }

    /// What each row is drawn with from a camera, or why it is refused, and the row that stands for all that are drawn alike.
    fn owners(
        &self,
        camera: Camera,
        rows: &[Row],
    ) -> (Vec<Result<Given, String>>, Vec<Option<usize>>) {
        let drawn: Vec<Result<Given, String>> = rows
            .iter()
            .map(|row| match self.engine.resolve_blocking(self.row_request(camera, row)) {
                Ok(frame) => Ok(*frame.applied()),
                Err(error) => Err(error.to_string()),
            })
            .collect();
        let pairs: Vec<_> =
            rows.iter().zip(&drawn).map(|(row, drawn)| (row, drawn.as_ref().ok())).collect();
        let owners = owners(&pairs);
        (drawn, owners)
    }

    /// Draws a frame to be timed. The planner predicts times of frames at new poses, which draw their shadow maps. The report has times of frames that
    /// use the maps of an earlier frame.
    fn draw_timed(&self, camera: Camera, row: &Row) -> Result<Arc<EncodedFrame>, SurveyError> {
        let request = self.row_request(camera, row);
        match self.purpose {
            Purpose::Planner => {
                let settings = Settings { draws_maps: true, ..request.settings };
                self.draw(FrameRequest { settings, ..request })
            }
            Purpose::Report => {
                let frame = self.draw(request.clone())?;
                let is_map = |pass: &PassReceipt| pass.ran && pass.name == Pass::ShadowMap.name();
                // The earlier frame's maps had been dropped.
                if frame.receipt.passes.iter().any(is_map) { self.draw(request) } else { Ok(frame) }
            }
        }
    }

    fn row_request(&self, camera: Camera, row: &Row) -> FrameRequest {
        let settings = self.complete(Settings::from(row.given));
        let [width, height] = row.drawn_size(self.size);
        let request = self.request(Pose::Camera(camera), settings, Output::Color);
        FrameRequest { width, height, ..request }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_have_the_names_of_pose_and_row() {
        assert_eq!(
            frame_file("1-above", "splats-full", "-flip"),
            "frames/1-above/splats-full-flip.png"
        );
    }
}
