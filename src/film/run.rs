//! Draws what is missing of a path: several frames are with the engine at a time, so that small ones are drawn together.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rayon::prelude::*;

use super::FilmError;
use super::folder::Folder;
use super::manifest::{self, Header, Record, Records};
use super::shots::{Shots, file_name};
use super::survey::{self, Slot};
use crate::engine::{
    Client, EncodedFrame, Engine, EngineError, FrameRequest, FrameTicket, Origin, Pose, Receipt,
    Resolution, ResolvedFrame, SceneMark,
};
use crate::plan::Reconstruct;

/// Pixels of all frames that are with the engine at a time, of a film that is drawn alone.
pub const MOST_PIXELS: u64 = 1 << 26;
/// Frames that are asked how a film's samples are to be drawn.
const ASKED: u64 = 64;
/// Finished frames that wait to be written at most.
const UNWRITTEN: usize = 4;
/// Times in a row that the engine may put off before that is an error, and how long each of them lasts at most.
const MOST_REFUSALS: u32 = 120;
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// What is drawn, and where to.
pub struct Film<'a> {
    pub engine: &'a Engine,
    /// Scene, size, settings and format of every frame; the pose and the deadline are not looked at.
    pub request: FrameRequest,
    pub shots: Shots,
    /// The scene that the shots were made for: no other one is drawn.
    pub mark: SceneMark,
    pub folder: &'a Path,
    /// Whose turn on the device the frames take, and what they are named after. As [`Client::Job`], a full queue is waited for however
    /// long it is full.
    pub origin: Origin,
    /// Of all frames that are with the engine at a time: [`MOST_PIXELS`], or a share of them.
    pub most_pixels: u64,
}

/// What a run tells while it goes on.
pub enum Event<'a> {
    /// Once, before anything is drawn: of the frames asked for, how many are good as they are, and how many are to be drawn.
    /// `records` tells of all that are good, also of such as were not asked for.
    Surveyed { kept: u64, to_draw: u64, records: &'a Records },
    /// A frame is in its place.
    Drawn { record: &'a Arc<Record>, receipt: &'a Receipt },
}

/// What a run did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Of the frames asked for.
    pub kept: u64,
    pub drawn: u64,
    /// Frames that are asked for and not there, because the run was told to stop.
    pub missing: u64,
    /// Files of earlier runs that are no frames of this path with these settings. They are left as they are.
    pub left_over: Vec<String>,
}

/// Draws all frames that are asked for and not there already. When `stop` becomes true it ends after the frame that it waits for; before
/// anything is drawn, at once, and then without a word of what is there.
///
/// However it ends, the folder holds whole frames and a manifest of them, and another run goes on from there.
///
/// # Errors
/// A request that the engine refuses, a folder that cannot be written or is another process's, a scene that is changed, removed or
/// exchanged meanwhile, an engine that ends.
pub fn run(
    film: &Film<'_>,
    stop: &AtomicBool,
    mut tell: impl FnMut(Event<'_>) + Send,
) -> Result<Report, FilmError> {
    let scene = film.engine.scene(&film.request.scene)?;
    let film = &film.decided()?;
    let first = *film.shots.wanted().start();
    let asked = film.shots.wanted().count() as u64;
    film.engine.bake(&film.request(first))?;
    // Refused before a folder is made for it.
    film.slot(first)?;
    let mut folder = Folder::open(film.folder)?;
    let records = folder.records()?;
    let intact = film.intact(&records, &folder, stop)?;
    if stop.load(Ordering::Relaxed) {
        // Not all were looked at: the manifest stays as it is.
        return Ok(Report { missing: asked, ..Report::default() });
    }
    film.check_scene(first)?;
    let file_of = |number| file_name(number, film.request.format);
    let mut found = survey::survey(film.shots.wanted(), file_of, &records, intact);
    drop(records);
    found.left_over.retain(|file| folder.holds(file));
    let to_draw = found.draw.len() as u64;
    tell(Event::Surveyed { kept: asked - to_draw, to_draw, records: &found.kept });

    let header = film.header(&scene.name);
    let mut finished = found.kept;
    folder.begin(&header, finished.values().map(AsRef::as_ref))?;
    let drawing = Drawing {
        film,
        queue: found.draw.into(),
        flight: VecDeque::new(),
        window: film.window(),
        refusals: 0,
        stop,
    };
    let ended = draw(drawing, |drawn| {
        let record = Arc::new(film.record(&drawn));
        folder.put(&record.file, &drawn.frame.bytes)?;
        folder.note(&record)?;
        tell(Event::Drawn { record: &record, receipt: &drawn.frame.receipt });
        finished.insert(record.frame, record);
        Ok(())
    });
    // Also after an error, so that the next run finds what there is; but that error is the one to tell of.
    let written = folder.begin(&header, finished.values().map(AsRef::as_ref));
    ended.and(written)?;
    let there = film.shots.wanted().filter(|number| finished.contains_key(number)).count() as u64;
    Ok(Report {
        kept: asked - to_draw,
        drawn: there + to_draw - asked,
        missing: asked - there,
        left_over: found.left_over,
    })
}

/// Draws on this thread and has another one `keep` what is drawn, because bringing a small frame to the disk takes as long as drawing
/// it.
fn draw(
    mut drawing: Drawing<'_>,
    mut keep: impl FnMut(Drawn) -> Result<(), FilmError> + Send,
) -> Result<(), FilmError> {
    std::thread::scope(|scope| {
        let (sender, receiver) = flume::bounded::<Drawn>(UNWRITTEN);
        let writer = scope.spawn(move || receiver.iter().try_for_each(&mut keep));
        let mut drawn = Ok(());
        while !drawing.is_stopped() {
            match drawing.next() {
                Ok(Some(frame)) => {
                    // Nobody listens any more where a frame could not be written.
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

impl Film<'_> {
    /// The film with one way to draw samples, where that is left open: a film that changed it midway would flicker. Where any frame
    /// needs splats, all have them. Frames of the whole path are asked, so that runs over parts of it agree.
    fn decided(&self) -> Result<Film<'_>, FilmError> {
        let mut request = self.request.clone();
        if request.settings.reconstruct == Reconstruct::Auto {
            let step = self.shots.count().div_ceil(ASKED).max(1) as usize;
            let mut drawn_as = Reconstruct::Points;
            for number in (0..self.shots.count()).step_by(step) {
                drawn_as = self.engine.resolve_blocking(self.request(number))?.reconstruct();
                if drawn_as != Reconstruct::Points {
                    break;
                }
            }
            request.settings.reconstruct = drawn_as;
        }
        Ok(Film { request, shots: self.shots.clone(), origin: self.origin.clone(), ..*self })
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
        let pose = Pose::Camera(self.shots.shot(number).camera);
        FrameRequest { pose, deadline: None, ..self.request.clone() }
    }

    /// Resolves a frame. A scene that has to be baked once more is another one.
    fn resolve(&self, number: u64) -> Result<Arc<ResolvedFrame>, FilmError> {
        match self.engine.resolve(self.request(number))? {
            Resolution::Ready(frame) => Ok(frame),
            Resolution::NeedsBake(_) => Err(FilmError::SceneChanged { frame: number }),
        }
    }

    /// A frame as it is to be.
    fn slot(&self, number: u64) -> Result<Slot, FilmError> {
        let tag = plain(self.resolve(number)?.etag());
        let file = file_name(number, self.request.format);
        Ok(Slot { number, t: self.shots.shot(number).t, file, tag })
    }

    /// Records of frames of the path that are as they are to be, with their files. Some are missing once `stop` is true.
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

    fn record(&self, drawn: &Drawn) -> Record {
        let Drawn { number, tag, frame } = drawn;
        Record {
            frame: *number,
            t: self.shots.shot(*number).t,
            file: file_name(*number, self.request.format),
            bytes: frame.bytes.len() as u64,
            sha256: manifest::checksum(&frame.bytes),
            tag: tag.clone(),
        }
    }

    /// Holds the scene against what it was. No mark comes again: while it is the same, nothing was drawn of another scene.
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

    /// Frames that are with the engine at most, and with how many left more are sent: half of them at a time, so that the engine
    /// finds many to draw together.
    fn window(&self) -> (usize, usize) {
        let limits = self.engine.limits();
        let pixels = u64::from(self.request.width) * u64::from(self.request.height);
        window(self.most_pixels / pixels.max(1), limits.max_batch, limits.queue_capacity)
    }

    fn origin(&self, number: u64) -> Origin {
        Origin { client: self.origin.client, request_id: self.origin.request_id.part(number) }
    }
}

/// See [`Film::window`]: of frames of which so many have room.
fn window(room: u64, max_batch: usize, queue_capacity: usize) -> (usize, usize) {
    let most = room.min(2 * max_batch as u64) as usize;
    let most = most.min(queue_capacity).max(2);
    (most, most / 2)
}

/// A tag without its quotes.
fn plain(tag: &str) -> String {
    tag.trim_matches('"').to_owned()
}

/// A frame that was sent.
struct Sent {
    number: u64,
    frame: Arc<ResolvedFrame>,
    ticket: FrameTicket,
}

/// A frame that has come.
struct Drawn {
    number: u64,
    tag: String,
    frame: Arc<EncodedFrame>,
}

/// Frames on their way.
struct Drawing<'a> {
    film: &'a Film<'a>,
    /// Numbers of those that were not sent yet.
    queue: VecDeque<u64>,
    flight: VecDeque<Sent>,
    /// See [`Film::window`].
    window: (usize, usize),
    /// Times in a row that the engine put off.
    refusals: u32,
    stop: &'a AtomicBool,
}

impl Drawing<'_> {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The next frame, and keeps the engine busy meanwhile; `None` after the last, and when told to stop while the engine puts off.
    fn next(&mut self) -> Result<Option<Drawn>, FilmError> {
        while !self.is_stopped() {
            self.send()?;
            // Whatever is left to send was sent, or waits for those in flight.
            let Some(Sent { number, frame, ticket }) = self.flight.pop_front() else {
                return Ok(None);
            };
            // What was sent shows the scene as it was by then: after a change none of it is worth waiting for.
            self.film.check_scene(number)?;
            match ticket.wait() {
                Ok(drawn) => {
                    self.refusals = 0;
                    let tag = plain(frame.etag());
                    return Ok(Some(Drawn { number, tag, frame: drawn }));
                }
                Err(error) => {
                    self.queue.push_front(number);
                    self.put_off(number, error)?;
                }
            }
        }
        Ok(None)
    }

    /// Sends frames to the engine, where it has few of them.
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
                    // Others fill its queue. Those of ours that are in it make room when they are drawn.
                    if !self.flight.is_empty() && matches!(error, EngineError::Busy { .. }) {
                        break;
                    }
                    self.put_off(number, error)?;
                }
            }
        }
        Ok(())
    }

    /// Waits a while, where the engine may draw the frame later.
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
}
