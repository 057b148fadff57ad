//! Draws what is missing of a path: several frames are with the engine at a time, so that small ones are drawn together.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rayon::prelude::*;

use super::FilmError;
use super::folder::Folder;
use super::manifest::{self, Header, Record};
use super::shots::{Shots, file_name};
use super::survey::{self, Slot};
use crate::engine::{
    Client, EncodedFrame, Engine, EngineError, FrameRequest, FrameTicket, Origin, Pose, Receipt,
};

/// Pixels of all frames that are with the engine at a time, of a film that is drawn alone.
pub const MOST_PIXELS: u64 = 1 << 26;
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
    Surveyed { kept: u64, to_draw: u64, records: &'a BTreeMap<u64, Record> },
    /// A frame is in its place.
    Drawn { record: &'a Record, receipt: &'a Receipt },
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

/// Draws all frames that are asked for and not there already. When `stop` becomes true it ends after the frame that it waits for.
///
/// However it ends, the folder holds whole frames and a manifest of them, and another run goes on from there.
///
/// # Errors
/// A request that the engine refuses, a folder that cannot be written or is another process's, an engine that ends.
pub fn run(
    film: &Film<'_>,
    stop: &AtomicBool,
    mut tell: impl FnMut(Event<'_>) + Send,
) -> Result<Report, FilmError> {
    let scene = film.engine.scene(&film.request.scene)?;
    // Refused before a folder is made for it.
    film.slot(*film.shots.wanted().start())?;
    let mut folder = Folder::open(film.folder)?;
    let records = folder.records()?;
    let slots = film.slots(&records)?;
    let promising = survey::promising(&slots, &records);
    let intact = promising.into_par_iter().filter(|record| folder.is_intact(record)).collect();
    let mut found = survey::survey(film.shots.wanted(), &slots, &records, intact);
    found.left_over.retain(|file| folder.holds(file));
    let asked = film.shots.wanted().count() as u64;
    let to_draw = found.draw.len() as u64;
    tell(Event::Surveyed { kept: asked - to_draw, to_draw, records: &found.kept });

    let header = film.header(&scene.name);
    let mut finished = found.kept;
    folder.begin(&header, finished.values())?;
    let queue = found.draw.iter().filter_map(|number| slots.get(number)).collect();
    let drawing = Drawing {
        film,
        revision: scene.revision,
        queue,
        flight: VecDeque::new(),
        window: film.window(),
        refusals: 0,
        stop,
    };
    let ended = draw(drawing, |slot, frame| {
        let record = slot.record(&frame);
        folder.put(&record.file, &frame.bytes)?;
        folder.note(&record)?;
        tell(Event::Drawn { record: &record, receipt: &frame.receipt });
        finished.insert(record.frame, record);
        Ok(())
    });
    // Also after an error, so that the next run finds what there is; but that error is the one to tell of.
    let written = folder.begin(&header, finished.values());
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
fn draw<'a>(
    mut drawing: Drawing<'a>,
    mut keep: impl FnMut(&Slot, Arc<EncodedFrame>) -> Result<(), FilmError> + Send,
) -> Result<(), FilmError> {
    std::thread::scope(|scope| {
        let (sender, receiver) = flume::bounded::<(&'a Slot, Arc<EncodedFrame>)>(UNWRITTEN);
        let writer =
            scope.spawn(move || receiver.iter().try_for_each(|(slot, frame)| keep(slot, frame)));
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

    fn slot(&self, number: u64) -> Result<Slot, FilmError> {
        let tag = self.engine.etag(&self.request(number))?;
        Ok(Slot {
            number,
            t: self.shots.shot(number).t,
            file: file_name(number, self.request.format),
            tag: tag.trim_matches('"').to_owned(),
        })
    }

    /// Frames as they are to be: those that are asked for, and those of the path that a record tells of.
    fn slots(&self, records: &BTreeMap<u64, Record>) -> Result<BTreeMap<u64, Slot>, FilmError> {
        let recorded = records.keys().copied().filter(|&number| number < self.shots.count());
        self.shots.wanted().chain(recorded).map(|number| Ok((number, self.slot(number)?))).collect()
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

impl Slot {
    fn record(&self, frame: &EncodedFrame) -> Record {
        Record {
            frame: self.number,
            t: self.t,
            file: self.file.clone(),
            bytes: frame.bytes.len() as u64,
            sha256: manifest::checksum(&frame.bytes),
            tag: self.tag.clone(),
        }
    }
}

/// Frames on their way.
struct Drawing<'a> {
    film: &'a Film<'a>,
    /// Of the scene when tags were made.
    revision: u64,
    /// Not sent yet.
    queue: VecDeque<&'a Slot>,
    flight: VecDeque<(&'a Slot, FrameTicket)>,
    /// See [`Film::window`].
    window: (usize, usize),
    /// Times in a row that the engine put off.
    refusals: u32,
    stop: &'a AtomicBool,
}

impl<'a> Drawing<'a> {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The next frame, and keeps the engine busy meanwhile; `None` after the last, and when told to stop while the engine puts off.
    fn next(&mut self) -> Result<Option<(&'a Slot, Arc<EncodedFrame>)>, FilmError> {
        while !self.is_stopped() {
            self.send()?;
            // Whatever is left to send was sent, or waits for those in flight.
            let Some((slot, ticket)) = self.flight.pop_front() else { return Ok(None) };
            let frame = slot.number;
            self.check_scene(frame)?;
            match ticket.wait() {
                Ok(drawn) if drawn.receipt.revision != self.revision => {
                    return Err(FilmError::SceneChanged { frame });
                }
                Ok(drawn) => {
                    self.refusals = 0;
                    return Ok(Some((slot, drawn)));
                }
                Err(error) => {
                    self.queue.push_front(slot);
                    self.put_off(frame, error)?;
                }
            }
        }
        Ok(None)
    }

    /// Frames that are on their way show what the scene was: after an edit none of them is worth waiting for.
    fn check_scene(&self, frame: u64) -> Result<(), FilmError> {
        let id = &self.film.request.scene;
        match self.film.engine.scene_mark(id) {
            Some(mark) if mark.revision == self.revision => Ok(()),
            Some(_) => Err(FilmError::SceneChanged { frame }),
            None => {
                let error = EngineError::UnknownScene { id: id.clone() };
                Err(FilmError::Frame { frame, error })
            }
        }
    }

    /// Sends frames to the engine, where it has few of them.
    fn send(&mut self) -> Result<(), FilmError> {
        let (most, few) = self.window;
        if self.flight.len() > few {
            return Ok(());
        }
        while self.flight.len() < most
            && !self.is_stopped()
            && let Some(slot) = self.queue.pop_front()
        {
            let origin = self.film.origin(slot.number);
            match self.film.engine.submit_for(origin, self.film.request(slot.number)) {
                Ok(ticket) => self.flight.push_back((slot, ticket)),
                Err(error) => {
                    self.queue.push_front(slot);
                    // Others fill its queue. Those of ours that are in it make room when they are drawn.
                    if !self.flight.is_empty() && matches!(error, EngineError::Busy { .. }) {
                        break;
                    }
                    self.put_off(slot.number, error)?;
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
