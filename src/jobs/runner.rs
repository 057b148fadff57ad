//! The threads that work on jobs. Each takes a phase of one job at a time, whichever is next by the book.
//!
//! | phase | work | stops |
//! |---|---|---|
//! | baking | waits for [`crate::engine::bake_service`], perhaps with others | at its next step, if nobody else waits |
//! | drawing | `film`: many frames are with the engine at once; jobs share the device as its clients | after the current frame |
//! | coding | codes the finished frames into a video | after the current frame |

use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::DVec3;

use super::JobError;
use super::book::{Failure, FailureKind, JobId, Made, Need, Outcome, Phase, Record, Video};
use super::hold::hold;
use super::live::{Live, Stage, Stop};
use super::remote::Order;
use super::spec::{FrameSpec, PathChoice, Spec};
use super::state::{End, JobsState, end_run};
use super::store::Place;
use crate::engine::{Client, Engine, EngineError, FrameRequest, Origin, RequestId};
use crate::film::shots::Shots;
use crate::film::video::{self, Coder, Reel, VideoError};
use crate::film::{self, Event, Film, FilmError, Keep, Record as FrameRecord, Wanted};
use crate::scene::{CameraPath, parse_path};

/// Interval at which an idle runner checks whether a missing scene has appeared.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Returns a function that says what a job lacks.
pub(super) fn need(engine: &Engine) -> impl Fn(&Spec) -> Need + '_ {
    |spec| {
        if engine.scene_mark(&spec.scene).is_none() {
            return Need::Missing(not_loaded(&spec.scene));
        }
        if engine.must_bake(&spec.request()) { Need::Bake } else { Need::Nothing }
    }
}

fn not_loaded(scene: &str) -> String {
    format!("scene `{scene}` is not loaded")
}

/// Runs a runner's thread until the server stops.
pub(super) fn run(shared: &JobsState) {
    while let Some((record, phase, live)) = next(shared) {
        let id = record.id;
        let made = record.made.clone();
        let mut run =
            Run { shared, live: &live, place: shared.store.place(id), record, made, drawn: 0 };
        let request_id = run.record.request_id.as_deref();
        tracing::info!(job = id, request_id, scene = run.record.spec.scene, ?phase, "job goes on");
        let outcome = catch_unwind(AssertUnwindSafe(|| run.run(phase))).unwrap_or_else(|_| {
            let detail = "the server failed while working on the job; its log has the cause";
            Outcome::Failed(failure(FailureKind::Internal, detail))
        });
        tracing::info!(job = id, ?phase, drawn = run.drawn, ?outcome, "job rests");
        let end = End { outcome, made: run.made, drawn: run.drawn };
        let_go(shared, id, &live, end);
    }
}

/// Waits for a job whose turn it is; `None` when the server stops.
fn next(shared: &JobsState) -> Option<(Record, Phase, Arc<Live>)> {
    let mut book = shared.book.lock();
    loop {
        if shared.stopping.load(Ordering::Relaxed) {
            return None;
        }
        let Some((id, phase)) = book.next(shared.now_ms(), need(&shared.engine)) else {
            shared.wake.wait_for(&mut book, LOOK_EVERY);
            continue;
        };
        let live = shared.live(id).ok()?;
        // Rearm under the lock, so that every later stop request applies to this run.
        live.rearm();
        if shared.stopping.load(Ordering::Relaxed) {
            live.stop(Stop::Paused);
        }
        // The record is not written to disk: the next process treats queued and running jobs alike.
        let record = book.get(id).ok()?.clone();
        live.changed();
        return Some((record, phase, live));
    }
}

/// Records how a run ended, and releases the job.
fn let_go(shared: &JobsState, id: JobId, live: &Live, end: End) {
    // Begin a new turn before watchers read the manifest again.
    shared.manifests.turn(id, live);
    *live.drawing.write() = None;
    shared.recount(id, live);
    let show = || {
        live.progress.lock().stage = Stage::None;
        // Notify under the book's lock, so that nobody sees the new state with the old version.
        live.changed();
    };
    let is_stored = end_run(&shared.store, &shared.book, id, end, || shared.now_ms(), show);
    if is_stored && shared.drop_unwanted(id) {
        shared.recount(id, live);
        live.changed();
    }
    shared.release(id, live.bytes());
    shared.wake.notify_all();
}

fn failure(kind: FailureKind, detail: impl Into<String>) -> Failure {
    Failure { kind, detail: detail.into() }
}

/// Looks up a job's path as its scene has it now.
///
/// # Errors
/// The scene is missing or has no path of that name, or the text is not a path.
pub fn find_path(
    engine: &Engine,
    scene: &str,
    choice: &PathChoice,
) -> Result<CameraPath, EngineError> {
    match choice {
        PathChoice::Named(name) => engine.camera_path(scene, name),
        PathChoice::Inline(text) => {
            let up = DVec3::from_array(engine.scene(scene)?.up);
            parse_path(text, "path", up).map_err(|error| EngineError::Scene(Arc::new(error)))
        }
    }
}

/// Cuts a job's path into shots.
///
/// # Errors
/// As [`find_path`], or the path does not have the range.
pub fn find_shots(engine: &Engine, spec: &Spec) -> Result<Shots, FilmError> {
    let path = find_path(engine, &spec.scene, &spec.path)?;
    Shots::new(&path, spec.fps, spec.from, spec.to)
}

/// Returns a function that has frames drawn in other processes, if there are such and they can draw the scene.
fn draw_elsewhere<'a>(
    shared: &'a JobsState,
    live: &'a Live,
    record: &'a Record,
) -> Option<Box<film::Elsewhere<'a>>> {
    let remote = shared.remote.get()?;
    let Some(files) = shared.engine.scene_files(&record.spec.scene) else {
        tracing::info!(job = record.id, "the scene was patched, so this process draws it");
        return None;
    };
    let tell = |waits_for: Option<String>| {
        let mut progress = live.progress.lock();
        if progress.waits_for != waits_for {
            progress.waits_for = waits_for;
            drop(progress);
            live.changed();
        }
    };
    Some(Box::new(
        move |request: &FrameRequest,
              frames: Vec<Wanted>,
              stop: &AtomicBool,
              keep: &mut Keep<'_>| {
            let spec = Spec { frame: FrameSpec::new(request), ..record.spec.clone() };
            let (engine, job) = (&shared.engine, record.id);
            let is_pause = &|| live.why() == Some(Stop::Paused);
            let order = Order { engine, job, spec, files: files.clone(), frames, is_pause };
            remote.draw(order, stop, keep, &tell)
        },
    ))
}

/// One run of a job.
struct Run<'a> {
    shared: &'a JobsState,
    live: &'a Live,
    place: Place,
    record: Record,
    made: Made,
    drawn: u64,
}

impl Run<'_> {
    fn run(&mut self, phase: Phase) -> Outcome {
        let worked = match phase {
            Phase::Baking => self.bake(),
            Phase::Drawing => self.draw(),
            Phase::Coding => self.code(),
        };
        worked.unwrap_or_else(|outcome| outcome)
    }

    fn bake(&mut self) -> Result<Outcome, Outcome> {
        let (live, spec) = (self.live, &self.record.spec);
        let engine = &self.shared.engine;
        let shots = find_shots(engine, spec).map_err(|error| self.film_failed(error))?;
        let request = film::unbaked(engine, &spec.request(), &shots);
        let Some(request) = request else { return Ok(Outcome::Next(Phase::Drawing)) };
        let ticket = engine.begin_bake(&request);
        let ticket = ticket.map_err(|error| self.film_failed(error.into()))?;
        let Some(mut ticket) = ticket else { return Ok(Outcome::Next(Phase::Drawing)) };
        live.progress.lock().begin(Stage::Baking);
        let mut told = -1.0;
        let baked = ticket.wait_while(|done| {
            if done != told {
                told = done;
                live.progress.lock().baked = done;
                live.changed();
            }
            !live.stop.load(Ordering::Relaxed)
        });
        match baked {
            None => Err(self.stopped()),
            Some(Err(error)) => Err(self.film_failed(error.into())),
            Some(Ok(())) => Ok(Outcome::Next(Phase::Drawing)),
        }
    }

    /// Draws missing frames.
    fn draw(&mut self) -> Result<Outcome, Outcome> {
        self.shared.manifests.turn(self.record.id, self.live);
        let before = self.made.clone();
        (self.made.manifest_sha256, self.made.video) = (None, None);
        if self.is_whole_video(&before) {
            self.made = before;
            return Ok(Outcome::Done);
        }
        let reel = self.film()?;
        let manifest = self.place.manifest();
        let digest = File::open(&manifest).and_then(film::manifest::digest);
        let (_, sum) = digest.map_err(|error| self.storage(&manifest, &error))?;
        self.made.manifest_sha256 = Some(sum);
        if !self.record.spec.want.video {
            return Ok(Outcome::Done);
        }
        // Equal frames give an equal video, which may already exist.
        if self.made.manifest_sha256 == before.manifest_sha256 && self.has_video(&before) {
            self.made.video = before.video;
            return Ok(Outcome::Done);
        }
        *self.live.reel.lock() = Some(reel);
        Ok(Outcome::Next(Phase::Coding))
    }

    /// Returns whether the job wants only a video and has it already.
    fn is_whole_video(&self, made: &Made) -> bool {
        !self.record.spec.want.frames && self.has_video(made)
    }

    /// Returns whether the video of an earlier run is intact.
    fn has_video(&self, made: &Made) -> bool {
        made.video.as_ref().is_some_and(|video| {
            let found = File::open(self.place.video()).and_then(film::manifest::digest);
            found.is_ok_and(|found| found == (video.bytes, video.sha256.clone()))
        })
    }

    /// Draws missing frames, and returns the reel of the video.
    fn film(&mut self) -> Result<Reel, Outcome> {
        let (shared, live) = (self.shared, self.live);
        let spec = &self.record.spec;
        self.place
            .prepare(&self.record)
            .map_err(|error| self.storage(&self.place.frames(), &error))?;
        let request = spec.request();
        // Take the mark before looking up the path, because the path belongs to this scene.
        let mark = shared.engine.scene_mark(&spec.scene);
        let mark = mark.ok_or_else(|| Outcome::Waits(not_loaded(&spec.scene)))?;
        let shots = find_shots(&shared.engine, spec).map_err(|error| self.film_failed(error))?;
        let reel = Reel::new(&request, &shots, spec.want.bitrate_kbps);
        (self.made.total, self.made.fps) = (Some(reel.frames), Some(reel.fps));
        shared.check_quota().map_err(|error| full(&error))?;
        if film::unbaked(&shared.engine, &request, &shots).is_some() {
            // The scene was edited since it was baked, or another frame needs something else.
            return Err(Outcome::Next(Phase::Baking));
        }

        // Sizes of existing files. A frame that replaces a file gives back the file's bytes.
        let mut sizes: HashMap<String, u64> = self.place.sizes().into_iter().collect();
        let folder = self.place.frames();
        let most_pixels = film::MOST_PIXELS / shared.config.limits.slots.drawing.max(1) as u64;
        let origin = self.origin();
        let engine = &shared.engine;
        let remote = draw_elsewhere(shared, live, &self.record);
        let elsewhere = remote.as_deref();
        let folder = &folder;
        let film = Film { engine, request, shots, mark, folder, origin, most_pixels, elsewhere };
        let mut drawn = 0;
        let report = film::run(&film, &live.stop, |event| match event {
            Event::Surveyed { kept, to_draw, records, .. } => {
                let mut progress = live.progress.lock();
                (progress.done, progress.total, progress.drawn) = (kept, Some(kept + to_draw), 0);
                progress.coded = 0;
                progress.begin(Stage::Frames);
                drop(progress);
                let wanted = film.shots.wanted();
                let there = records.range(wanted).map(|(number, record)| (*number, record.clone()));
                *live.drawing.write() = Some(there.collect());
                live.changed();
            }
            Event::Drawn { record, .. } => {
                drawn += 1;
                let before = sizes.remove(&record.file).unwrap_or(0);
                self.frame_drawn(record, before, drawn);
            }
        });
        self.drawn = drawn;
        self.made.done = live.progress.lock().done;
        let report = report.map_err(|error| self.film_failed(error))?;
        if report.missing > 0 {
            return Err(self.stopped());
        }
        Ok(reel)
    }

    /// Returns the origin of the job's frames, whose ids are `job-7/0` and so on for job 7.
    fn origin(&self) -> Origin {
        let id = self.record.id;
        let name = RequestId::parse(&format!("job-{id}")).unwrap_or_else(RequestId::fresh);
        Origin { client: Client::Job(id), request_id: name }
    }

    /// Records a frame whose file replaced a file of `before` bytes.
    fn frame_drawn(&self, record: &Arc<FrameRecord>, before: u64, drawn: u64) {
        let (shared, live) = (self.shared, self.live);
        shared.drawn.fetch_add(1, Ordering::Relaxed);
        let used = shared.grow(live, record.bytes, before);
        if let Some(frames) = &mut *live.drawing.write() {
            frames.insert(record.frame, record.clone());
        }
        let mut progress = live.progress.lock();
        (progress.done, progress.drawn) = (progress.done + 1, drawn);
        progress.step(Instant::now());
        drop(progress);
        live.changed();
        if used > shared.config.most_bytes {
            live.stop(Stop::Full);
        }
    }

    /// Codes the video.
    fn code(&mut self) -> Result<Outcome, Outcome> {
        let (shared, live) = (self.shared, self.live);
        let Some(reel) = live.reel.lock().take() else {
            return Ok(Outcome::Next(Phase::Drawing));
        };
        let (used, limit) = (shared.used.load(Ordering::Relaxed), shared.config.most_bytes);
        let expected = reel.expected_bytes();
        if used.saturating_add(expected) > limit {
            let detail = format!(
                "job storage is full: {used} of {limit} bytes used, and the video needs about {expected} more"
            );
            return Err(Outcome::Failed(failure(FailureKind::DiskQuota, detail)));
        }
        let file = self.place.video();
        let before = std::fs::metadata(&file).map_or(0, |found| found.len());
        live.progress.lock().begin(Stage::Video);
        let folder = self.place.frames();
        let frames = film::records(&folder).map_err(|error| self.film_failed(error))?;
        let first = self.record.spec.from.unwrap_or(0);
        let frames = frames.range(first..first + reel.frames).map(|(_, record)| record.as_ref());
        let coder = Coder::find().map_err(|error| self.video_failed(error))?;
        let coded = video::encode(&coder, &reel, &folder, frames, &file, &live.stop, |coded| {
            let mut progress = live.progress.lock();
            progress.coded = coded;
            progress.step(Instant::now());
            drop(progress);
            live.changed();
            hold(coded, &live.stop);
        });
        coded.map_err(|error| self.video_failed(error))?;
        let digest = File::open(&file).and_then(film::manifest::digest);
        let (bytes, sha256) = digest.map_err(|error| self.storage(&file, &error))?;
        shared.grow(live, bytes, before);
        self.made.video = Some(Video { bytes, sha256 });
        Ok(Outcome::Done)
    }

    /// Returns the outcome of a run that was told to stop.
    fn stopped(&self) -> Outcome {
        match self.live.why() {
            Some(Stop::Full) => {
                let (used, limit) =
                    (self.shared.used.load(Ordering::Relaxed), self.shared.config.most_bytes);
                full(&JobError::Full { used, limit })
            }
            // The state of a cancelled job already says so.
            Some(Stop::Cancelled | Stop::Paused) | None => Outcome::Paused,
        }
    }

    fn film_failed(&self, error: FilmError) -> Outcome {
        let kind = match &error {
            FilmError::Engine(inner) | FilmError::Frame { error: inner, .. } => match inner {
                EngineError::UnknownScene { id } => return Outcome::Waits(not_loaded(id)),
                EngineError::ShuttingDown => return Outcome::Paused,
                EngineError::BadParameter { .. }
                | EngineError::OverLimit { .. }
                | EngineError::OutOfGpuMemory { .. }
                | EngineError::OverBinding { .. }
                | EngineError::Asset(_)
                | EngineError::Scene(_) => FailureKind::Refused,
                _ => FailureKind::Engine,
            },
            FilmError::Path(_) | FilmError::BadRange { .. } => FailureKind::Refused,
            FilmError::SceneChanged { .. } => {
                let detail = format!("{error}; resume the job to draw all frames of the new scene");
                return Outcome::Failed(failure(FailureKind::SceneChanged, detail));
            }
            FilmError::Io { file, error } => return self.storage(file, error),
            FilmError::OtherTag { .. } | FilmError::Elsewhere(_) => FailureKind::Engine,
            FilmError::Foreign { .. } | FilmError::Locked { .. } => FailureKind::Storage,
        };
        Outcome::Failed(failure(kind, self.outward(&error.to_string())))
    }

    fn video_failed(&self, error: VideoError) -> Outcome {
        match error {
            VideoError::Stopped => self.stopped(),
            VideoError::Io { file, error } => self.storage(&file, &error),
            error => Outcome::Failed(failure(FailureKind::Video, self.outward(&error.to_string()))),
        }
    }

    fn storage(&self, file: &Path, error: &io::Error) -> Outcome {
        let detail = self.outward(&format!("{}: {error}", file.display()));
        tracing::error!(job = self.record.id, file = %file.display(), %error, "cannot read or write a file of a job");
        Outcome::Failed(failure(FailureKind::Storage, detail))
    }

    /// Removes the name of the state folder, which clients must not see.
    fn outward(&self, text: &str) -> String {
        let prefix =
            format!("{}{}", self.shared.store.folder().display(), std::path::MAIN_SEPARATOR);
        text.replace(&prefix, "")
    }
}

fn full(error: &JobError) -> Outcome {
    let detail = format!("{error}, then resume this job");
    Outcome::Failed(failure(FailureKind::DiskQuota, detail))
}

impl JobsState {
    /// Records that a job's file of `bytes` bytes replaced one of `before` bytes. Returns the bytes of all jobs.
    fn grow(&self, live: &Live, bytes: u64, before: u64) -> u64 {
        live.bytes.fetch_add(bytes, Ordering::Relaxed);
        live.bytes.fetch_sub(before, Ordering::Relaxed);
        self.used.fetch_add(bytes, Ordering::Relaxed) + bytes - self.used_less(before)
    }

    fn used_less(&self, before: u64) -> u64 {
        self.used.fetch_sub(before, Ordering::Relaxed);
        before
    }
}
