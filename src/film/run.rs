//! Draws the missing frames of a path. Several frames are with the engine at a time, so that small ones are drawn in batches.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bytes::Bytes;
use rayon::prelude::*;

use serde::{Deserialize, Serialize};

use super::FilmError;
use super::folder::Folder;
use super::manifest::{self, Header, Record, Records};
use super::shots::{Shots, file_name};
use super::survey::{self, Slot};
use crate::engine::{
    Client, Engine, EngineError, FrameRequest, FrameTicket, Origin, Pose, Receipt, Resolution,
    ResolvedFrame, SceneMark,
};
use crate::plan::planner::PlanReceipt;

/// Largest number of pixels with the engine at a time, for a film that is drawn alone.
pub const MOST_PIXELS: u64 = 1 << 26;
/// Number of frames that decide how a film's samples are drawn, and what is baked for it.
const ASKED: u64 = 64;
/// Largest number of drawn frames that wait to be written.
const UNWRITTEN: usize = 4;
/// Largest number of consecutive refusals by the engine before the run fails, and the longest pause after each.
const MOST_REFUSALS: u32 = 120;
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// A film and its folder.
pub struct Film<'a> {
    pub engine: &'a Engine,
    /// Scene, size, settings and format of every frame. Pose and deadline are ignored.
    pub request: FrameRequest,
    pub shots: Shots,
    /// The scene that the shots were made for. No other scene is drawn.
    pub mark: SceneMark,
    pub folder: &'a Path,
    /// The frames' share of the device, and the prefix of their ids. A run for a [`Client::Job`] waits for a full queue as long
    /// as it takes.
    pub origin: Origin,
    /// Largest number of pixels with the engine at a time: [`MOST_PIXELS`], or a share of it.
    pub most_pixels: u64,
    /// Draws the frames in place of the engine, which then only names them.
    pub elsewhere: Option<&'a Elsewhere<'a>>,
}

/// Draws frames on other machines. It gets the request that all frames share, and hands each frame over as soon as it is there.
pub type Elsewhere<'a> = dyn Fn(&FrameRequest, Vec<Wanted>, &AtomicBool, &mut Keep<'_>) -> Result<(), FilmError>
    + Sync
    + 'a;

/// Receives drawn frames.
pub type Keep<'a> = dyn FnMut(Drawn) -> Result<(), FilmError> + 'a;

/// A frame to draw, and the tag that it must have.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wanted {
    pub number: u64,
    pub tag: String,
}

/// A drawn frame.
pub struct Drawn {
    pub number: u64,
    pub tag: String,
    pub bytes: Bytes,
    /// The receipt tells what the frame has cost, if this process drew it.
    pub receipt: Option<Receipt>,
}

/// Progress of a run.
pub enum Event<'a> {
    /// Sent once, before anything is drawn: how many of the wanted frames are intact, and how many must be drawn. `records` has
    /// all intact frames, including ones that are not wanted. `planned` says how settings were chosen for the goal of all frames, if they have one.
    Surveyed { kept: u64, to_draw: u64, records: &'a Records, planned: Option<&'a PlanReceipt> },
    /// A frame's file is in place. The receipt is there if this process drew the frame.
    Drawn { record: &'a Arc<Record>, receipt: Option<&'a Receipt> },
}

/// The result of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Number of wanted frames that were intact.
    pub kept: u64,
    pub drawn: u64,
    /// Wanted frames that are missing, because the run was told to stop.
    pub missing: u64,
    /// Files of earlier runs that are not frames of this path with these settings. They are left alone.
    pub left_over: Vec<String>,
}

/// Returns the request of a wanted frame that must wait for a bake, if one of [`ASKED`] has to. Which frames are drawn from point trees depends on the
/// pose.
pub fn unbaked(engine: &Engine, request: &FrameRequest, shots: &Shots) -> Option<FrameRequest> {
    let wanted = shots.wanted();
    let step = wanted.clone().count().div_ceil(ASKED as usize).max(1);
    wanted
        .step_by(step)
        .map(|number| at_shot(request, shots, number))
        .find(|request| engine.must_bake(request))
}

fn at_shot(request: &FrameRequest, shots: &Shots, number: u64) -> FrameRequest {
    let camera = shots.shot(number).camera;
    let pose = match request.settings.open_share() {
        Some(share) => {
            let exposed = shots.while_open(number, share, request.settings.exposures());
            Pose::Moving { camera, exposed: exposed.into() }
        }
        None => Pose::Camera(camera),
    };
    FrameRequest { pose, deadline: None, ..request.clone() }
}

/// Draws all wanted frames that are missing. When `stop` becomes true, the run ends after the frame that it waits for. If nothing
/// has been drawn yet, it ends at once and reports nothing.
///
/// However the run ends, the folder holds complete frames and their manifest, and another run can continue.
///
/// # Errors
/// The engine refuses a request or has ended; the folder cannot be written, or another process draws into it; the scene was
/// changed, removed or replaced meanwhile.
pub fn run(
    film: &Film<'_>,
    stop: &AtomicBool,
    mut tell: impl FnMut(Event<'_>) + Send,
) -> Result<Report, FilmError> {
    let scene = film.engine.scene(&film.request.scene)?;
    let (film, planned) = film.decided()?;
    let film = &film;
    let first = *film.shots.wanted().start();
    let asked = film.shots.wanted().count() as u64;
    if !bake(film.engine, &film.request, &film.shots, stop)? {
        return Ok(Report { missing: asked, ..Report::default() });
    }
    // Fail before the folder is created.
    film.slot(first)?;
    let mut folder = Folder::open(film.folder)?;
    let records = folder.records()?;
    let intact = film.intact(&records, &folder, stop)?;
    if stop.load(Ordering::Relaxed) {
        // Some records were not checked, so the manifest stays as it is.
        return Ok(Report { missing: asked, ..Report::default() });
    }
    film.check_scene(first)?;
    let file_of = |number| file_name(number, film.request.format);
    let mut found = survey::survey(film.shots.wanted(), file_of, &records, intact);
    drop(records);
    found.left_over.retain(|file| folder.holds(file));
    let to_draw = found.draw.len() as u64;
    let (kept, planned) = (asked - to_draw, planned.as_ref());
    tell(Event::Surveyed { kept, to_draw, records: &found.kept, planned });

    let header = film.header(&scene.name);
    let mut finished = found.kept;
    folder.begin(&header, finished.values().map(AsRef::as_ref))?;
    let mut keep = |drawn: Drawn| -> Result<(), FilmError> {
        let record = Arc::new(film.record(&drawn));
        folder.put(&record.file, &drawn.bytes)?;
        folder.note(&record)?;
        tell(Event::Drawn { record: &record, receipt: drawn.receipt.as_ref() });
        finished.insert(record.frame, record);
        Ok(())
    };
    let ended = match film.elsewhere {
        Some(draw) => film
            .wanted(&found.draw, stop)
            .and_then(|wanted| draw(&film.request, wanted, stop, &mut keep)),
        None => draw(film.drawing(found.draw, stop), keep),
    };
    // Also after an error, so that the next run finds the finished frames. The error of the drawing takes precedence.
    let written = folder.begin(&header, finished.values().map(AsRef::as_ref));
    ended.and(written)?;
    let there = film.shots.wanted().filter(|number| finished.contains_key(number)).count() as u64;
    Ok(Report {
        kept,
        drawn: there + to_draw - asked,
        missing: asked - there,
        left_over: found.left_over,
    })
}

/// Bakes what the frames need, and waits for it. This changes the scene's mark, so a film takes the mark afterwards. When `stop` becomes true, the
/// wait ends and this returns false. The bake then goes on only if others wait for it.
///
/// # Errors
/// The scene is gone or cannot be baked.
pub fn bake(
    engine: &Engine,
    request: &FrameRequest,
    shots: &Shots,
    stop: &AtomicBool,
) -> Result<bool, FilmError> {
    while let Some(request) = unbaked(engine, request, shots) {
        let Some(mut ticket) = engine.begin_bake(&request)? else { continue };
        match ticket.wait_while(|_| !stop.load(Ordering::Relaxed)) {
            Some(baked) => baked?,
            None => return Ok(false),
        }
    }
    Ok(true)
}

/// Draws frames whose tags are known, for a film that another process runs. `keep` gets them on another thread.
///
/// # Errors
/// As [`run`]; [`FilmError::OtherTag`] before a frame is drawn that would show something else.
pub fn draw_wanted(
    film: &Film<'_>,
    wanted: &[Wanted],
    stop: &AtomicBool,
    mut keep: impl FnMut(Drawn) -> Result<(), FilmError> + Send,
) -> Result<(), FilmError> {
    let tags: HashMap<u64, &str> =
        wanted.iter().map(|frame| (frame.number, frame.tag.as_str())).collect();
    let check = |number, tag: &str| match tags.get(&number) {
        Some(wanted) if *wanted == tag => Ok(()),
        _ => Err(FilmError::OtherTag { frame: number }),
    };
    if let Some(first) = wanted.first() {
        check(first.number, &film.slot(first.number)?.tag)?;
    }
    let numbers = wanted.iter().map(|frame| frame.number).collect();
    draw(film.drawing(numbers, stop), |drawn| {
        check(drawn.number, &drawn.tag)?;
        keep(drawn)
    })
}

/// Draws on this thread and calls `keep` on another one, because writing a small frame to disk takes as long as drawing it.
fn draw(
    mut drawing: Drawing<'_>,
    keep: impl FnMut(Drawn) -> Result<(), FilmError> + Send,
) -> Result<(), FilmError> {
    std::thread::scope(|scope| {
        let (sender, receiver) = flume::bounded::<Drawn>(UNWRITTEN);
        let writer = scope.spawn(move || hand_over(&receiver, keep));
        let mut drawn = Ok(());
        while !drawing.is_stopped() {
            match drawing.next() {
                Ok(Some(frame)) => {
                    // The receiver is gone if a frame could not be written.
                    if sender.send(frame).is_err() {
                        break;
                    }
                }
                Ok(None) => break,
                Err(error) => {
                    drawn = Err(error);
                    break;
                }
            }
        }
        drop(sender);
        let written = writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        written.and(drawn)
    })
}

/// Calls `keep` with the frames until one cannot be kept, and then with those that are drawn and wait. A smaller frame may still fit on the disk, and
/// nothing is lost by trying.
///
/// # Errors
/// The first error of `keep`.
fn hand_over(
    drawn: &flume::Receiver<Drawn>,
    mut keep: impl FnMut(Drawn) -> Result<(), FilmError>,
) -> Result<(), FilmError> {
    let kept = drawn.iter().try_for_each(&mut keep);
    if kept.is_err() {
        // A bounded number, since the drawing goes on until the receiver is gone.
        for frame in drawn.try_iter().take(UNWRITTEN) {
            let _ = keep(frame);
        }
    }
    kept
}

impl Film<'_> {
    /// Decides how samples are drawn, if that is left open: a film that changed it midway would flicker. Settings for a goal are chosen for all frames
    /// together, and the second value says how. If any frame needs splats, all frames get them. Frames of the whole path are asked, so that runs over
    /// parts of the path agree.
    fn decided(&self) -> Result<(Film<'_>, Option<PlanReceipt>), FilmError> {
        let (mut request, mut planned) = (self.request.clone(), None);
        let step = self.shots.count().div_ceil(ASKED).max(1) as usize;
        let asked = || (0..self.shots.count()).step_by(step).map(|number| self.request(number));
        if request.settings.goal().is_some() {
            let chosen = self.engine.settings_for_all(&asked().collect::<Vec<_>>())?;
            if let Some((settings, plan)) = chosen {
                (request.settings, planned) = (settings, Some(plan));
            }
        }
        if request.settings.leaves_drawing_open() {
            for one in asked() {
                let one = FrameRequest { settings: request.settings, ..one };
                let frame = self.engine.resolve_blocking(one)?;
                request.settings = request.settings.drawn_like(frame.settings());
                if !request.settings.draws_points() {
                    break;
                }
            }
        }
        let film =
            Film { request, shots: self.shots.clone(), origin: self.origin.clone(), ..*self };
        Ok((film, planned))
    }

    fn header(&self, scene: &str) -> Header {
        Header {
            manifest: manifest::VERSION,
            scene: scene.to_owned(),
            fps: self.shots.fps(),
            frames: self.shots.count(),
            width: self.request.width,
            height: self.request.height,
            output: self.request.output,
            format: self.request.format,
        }
    }

    fn request(&self, number: u64) -> FrameRequest {
        at_shot(&self.request, &self.shots, number)
    }

    /// Resolves a frame. Only a frame between those that [`unbaked`] looks at, or one of a scene that was changed, can need a bake here.
    fn resolve(&self, number: u64) -> Result<Arc<ResolvedFrame>, FilmError> {
        match self.engine.resolve(self.request(number))? {
            Resolution::Ready(frame) => Ok(frame),
            Resolution::NeedsBake(unbaked) => {
                self.check_scene(number)?;
                Ok(unbaked.bake_blocking()?)
            }
        }
    }

    /// Describes a frame as it should be now.
    fn slot(&self, number: u64) -> Result<Slot, FilmError> {
        let tag = plain(self.resolve(number)?.etag());
        let file = file_name(number, self.request.format);
        Ok(Slot { number, t: self.shots.shot(number).t, file, tag })
    }

    /// Checks the recorded frames of the path, and returns the records that match. Some are missing if `stop` becomes true.
    fn intact(
        &self,
        records: &Records,
        folder: &Folder,
        stop: &AtomicBool,
    ) -> Result<Vec<Arc<Record>>, FilmError> {
        let recorded: Vec<&Arc<Record>> =
            records.range(..self.shots.count()).map(|(_, record)| record).collect();
        let look = |record: &Arc<Record>| {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let promising = survey::promising(&self.slot(record.frame)?, record);
            Ok(promising.filter(|record| folder.is_intact(record)))
        };
        recorded.into_par_iter().filter_map(|record| look(record).transpose()).collect()
    }

    /// Names frames, until `stop` becomes true.
    fn wanted(&self, numbers: &[u64], stop: &AtomicBool) -> Result<Vec<Wanted>, FilmError> {
        let wanted = numbers.par_iter().filter(|_| !stop.load(Ordering::Relaxed));
        let wanted = wanted.map(|&number| Ok(Wanted { number, tag: self.slot(number)?.tag }));
        wanted.collect()
    }

    fn drawing<'a>(&'a self, numbers: Vec<u64>, stop: &'a AtomicBool) -> Drawing<'a> {
        Drawing {
            film: self,
            queue: numbers.into(),
            flight: VecDeque::new(),
            window: self.window(),
            refusals: 0,
            stop,
        }
    }

    fn record(&self, drawn: &Drawn) -> Record {
        let Drawn { number, tag, bytes, .. } = drawn;
        Record {
            frame: *number,
            t: self.shots.shot(*number).t,
            file: file_name(*number, self.request.format),
            bytes: bytes.len() as u64,
            sha256: manifest::checksum(bytes),
            tag: tag.clone(),
        }
    }

    /// Checks that the scene is still the same. Marks are never reused, so an equal mark means that no other scene was drawn.
    fn check_scene(&self, frame: u64) -> Result<(), FilmError> {
        let id = &self.request.scene;
        match self.engine.scene_mark(id) {
            Some(now) if now == self.mark => Ok(()),
            Some(_) => Err(FilmError::SceneChanged { frame }),
            None => {
                let error = EngineError::UnknownScene { id: id.clone() };
                Err(FilmError::Frame { frame, error })
            }
        }
    }

    /// The largest number of frames with the engine, and the number below which more are sent: half of it, so that the engine can
    /// draw many in one batch.
    fn window(&self) -> (usize, usize) {
        let limits = self.engine.limits();
        let pixels = u64::from(self.request.width) * u64::from(self.request.height);
        window(self.most_pixels / pixels.max(1), limits.max_batch, limits.queue_capacity)
    }

    fn origin(&self, number: u64) -> Origin {
        Origin { client: self.origin.client, request_id: self.origin.request_id.part(number) }
    }
}

/// Computes [`Film::window`], where `room` is the number of frames that the limit on pixels allows.
fn window(room: u64, max_batch: usize, queue_capacity: usize) -> (usize, usize) {
    let most = room.min(2 * max_batch as u64) as usize;
    let most = most.min(queue_capacity).max(2);
    (most, most / 2)
}

/// Removes the quotes of an entity tag.
fn plain(tag: &str) -> String {
    tag.trim_matches('"').to_owned()
}

/// A frame that was sent to the engine.
struct Sent {
    number: u64,
    frame: Arc<ResolvedFrame>,
    ticket: FrameTicket,
}

/// The frames of a run.
struct Drawing<'a> {
    film: &'a Film<'a>,
    /// Numbers of the frames that were not sent yet.
    queue: VecDeque<u64>,
    flight: VecDeque<Sent>,
    /// See [`Film::window`].
    window: (usize, usize),
    /// Number of consecutive refusals by the engine.
    refusals: u32,
    stop: &'a AtomicBool,
}

impl Drawing<'_> {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Returns the next frame, and keeps the engine busy meanwhile. `None` after the last frame, and if told to stop.
    fn next(&mut self) -> Result<Option<Drawn>, FilmError> {
        while !self.is_stopped() {
            self.send()?;
            // All frames have been sent, or the remaining ones wait for those in flight.
            let Some(Sent { number, frame, ticket }) = self.flight.pop_front() else {
                return Ok(None);
            };
            // Frames in flight show the scene as it was when they were sent. After a change they are not worth waiting for.
            self.film.check_scene(number)?;
            match ticket.wait() {
                Ok(drawn) => {
                    self.refusals = 0;
                    let tag = plain(frame.etag());
                    let (bytes, receipt) = (drawn.bytes.clone(), Some(drawn.receipt.clone()));
                    return Ok(Some(Drawn { number, tag, bytes, receipt }));
                }
                Err(error) => {
                    self.queue.push_front(number);
                    self.put_off(number, error)?;
                }
            }
        }
        Ok(None)
    }

    /// Sends more frames to the engine when few are in flight.
    fn send(&mut self) -> Result<(), FilmError> {
        let (most, few) = self.window;
        if self.flight.len() > few {
            return Ok(());
        }
        while self.flight.len() < most
            && !self.is_stopped()
            && let Some(number) = self.queue.pop_front()
        {
            let origin = self.film.origin(number);
            let frame = self.film.resolve(number).map_err(|error| match error {
                FilmError::Engine(error) => FilmError::Frame { frame: number, error },
                other => other,
            })?;
            match self.film.engine.queue(origin, frame.clone()) {
                Ok(ticket) => self.flight.push_back(Sent { number, frame, ticket }),
                Err(error) => {
                    self.queue.push_front(number);
                    // The queue is full. Our own frames in it make room when they are drawn.
                    if !self.flight.is_empty() && matches!(error, EngineError::Busy { .. }) {
                        break;
                    }
                    self.put_off(number, error)?;
                }
            }
        }
        Ok(())
    }

    /// Pauses after a refusal, if the engine may draw the frame later.
    fn put_off(&mut self, frame: u64, error: EngineError) -> Result<(), FilmError> {
        let is_patient = matches!(self.film.origin.client, Client::Job(_));
        let counts = !(is_patient && matches!(error, EngineError::Busy { .. }));
        let (EngineError::Busy { retry_after } | EngineError::DeviceLost { retry_after }) = error
        else {
            return Err(FilmError::Frame { frame, error });
        };
        self.refusals += u32::from(counts);
        if self.refusals > MOST_REFUSALS {
            return Err(FilmError::Frame { frame, error });
        }
        std::thread::sleep(retry_after.min(LONGEST_PAUSE));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_frames_fill_batches_and_large_ones_stay_few() {
        assert_eq!(window(20_000, 16, 256), (32, 16));
        assert_eq!(window(4, 16, 256), (4, 2));
        assert_eq!(window(0, 16, 256), (2, 1));
        assert_eq!(window(20_000, 16, 8), (8, 4));
        assert_eq!(window(20_000, 16, 1), (2, 1));
    }

    #[test]
    fn drawn_frames_are_kept_although_one_of_them_cannot_be() {
        let (sender, receiver) = flume::bounded(UNWRITTEN);
        for number in 0..3 {
            let drawn = Drawn { number, tag: String::new(), bytes: Bytes::new(), receipt: None };
            assert!(sender.send(drawn).is_ok());
        }
        let mut kept = Vec::new();
        let written = hand_over(&receiver, |drawn| {
            if drawn.number == 1 {
                return Err(FilmError::OtherTag { frame: 1 });
            }
            kept.push(drawn.number);
            Ok(())
        });
        assert!(matches!(written, Err(FilmError::OtherTag { frame: 1 })));
        assert_eq!(kept, [0, 2]);
    }
}
