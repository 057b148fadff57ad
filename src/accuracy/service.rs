//! Surveys of a server's scenes: one at a time, in the background, with results that outlive the process.
//!
//! ```text
//! begin ─► running ─┬─► done: the results are kept, in memory and in the folder
//!                   ├─► failed or cancelled: earlier results stay
//!                   └─► the process ends: the next one goes on where this one stopped
//! ```
//!
//! Frames go to the engine as those of a job do, so that requests and streams come first. The folder has the results ([`mod@store`]) and the journals of the
//! survey that runs ([`unfinished`]). Results belong to one content of a scene on one adapter, drawn by one build: a tag of these
//! tells whether they are [stale](View::is_stale).
//!
//! The lock of the book is held for look-ups and changes alone, never while something is drawn, read or written.

mod store;
mod unfinished;
mod work;

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use self::store::Store;
use self::unfinished::Unfinished;
use self::work::Outcome;
use super::planning;
use super::poses::{UnknownCamera, of_cameras};
use super::truth::{Finer, PARTS};
use crate::engine::{Engine, EngineError, FrameRequest, Pose};
use crate::memory::Admission;
use crate::plan::{Output, Reconstruct, Settings};

pub use store::Kept;

/// Most pixels of a survey's frames.
pub const MOST_PIXELS: u64 = 1 << 20;
/// Most timed frames of a setting and pose.
pub const MOST_REPEATS: u32 = 100;
/// Most cameras of a survey.
pub const MOST_CAMERAS: usize = 16;
/// Most scenes whose results are kept; the oldest results go first.
const MOST_KEPT: usize = 64;
/// Host memory that a survey takes for each pixel of its frames: the images of a reference, and what the metrics compute.
const BYTES_PER_PIXEL: u64 = 768;

/// Scope of a survey.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wanted {
    /// Measure for the planner. `size` is that of the smallest frames, and the rest is the planner's.
    pub is_for_planner: bool,
    /// Few settings and one pose, unless cameras are named.
    pub is_quick: bool,
    /// Names of cameras; the scene's first ones where there are none.
    pub cameras: Vec<String>,
    pub size: [u32; 2],
    pub repeats: u32,
}

/// Why a survey does not begin.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    #[error(
        "the accuracy of scene `{scene}` is being measured; the server measures one scene at a time"
    )]
    Running { scene: String },
    #[error("the scene is empty, so there is nothing to compare")]
    Empty,
    #[error(transparent)]
    UnknownCamera(#[from] UnknownCamera),
    /// The frames, or the references that they need, are too large: `most` pixels and `side` a side can be asked for.
    #[error("frames of {width}x{height} are too large to measure")]
    TooLarge { width: u32, height: u32, most: u64, side: u32 },
    #[error(transparent)]
    Engine(#[from] EngineError),
}

/// Progress of a survey.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    pub done: u64,
    /// Number of steps; 0 before it is known.
    pub total: u64,
    /// The step at hand, in words.
    pub what: String,
}

/// Why a survey failed.
#[derive(Clone, Debug, PartialEq)]
pub enum Failure {
    SceneChanged,
    Other(String),
}

/// State of the latest survey of a scene.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    Running(Progress),
    Done,
    Failed(Failure),
    Cancelled,
}

/// State and results of the latest surveys of a scene.
#[derive(Clone, Debug)]
pub struct View {
    pub state: State,
    /// Whether the results are of another content of the scene, another adapter or another build; `None` without results.
    pub is_stale: Option<bool>,
    pub kept: Option<Arc<Kept>>,
}

/// Decision about the running survey.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    Wanted,
    Cancelled,
    /// Nothing is to be known of it.
    Forgotten,
}

struct Running {
    scene: String,
    progress: Progress,
    fate: Fate,
    stop: Arc<AtomicBool>,
}

#[derive(Default)]
struct Book {
    running: Option<Running>,
    /// How the latest survey of a scene ended, where it left no results. The latest is the last.
    ended: VecDeque<(String, State)>,
    kept: BTreeMap<String, Arc<Kept>>,
    is_closed: bool,
}

struct Shared {
    engine: Engine,
    store: Store,
    unfinished: Unfinished,
    book: Mutex<Book>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// All surveys of a server; clones share them.
#[derive(Clone)]
pub struct Surveys(Arc<Shared>);

impl Surveys {
    /// Surveys with the results that earlier processes kept in the folder. Without a folder, results end with the process.
    pub fn open(engine: Engine, folder: Option<PathBuf>) -> Surveys {
        let unfinished = Unfinished::new(folder.as_deref());
        let store = Store::new(folder);
        let mut kept = store.read();
        // The newest ones.
        kept.drain(..kept.len().saturating_sub(MOST_KEPT));
        let kept = kept.into_iter().map(|kept| (kept.scene.clone(), Arc::new(kept))).collect();
        let book = Mutex::new(Book { kept, ..Book::default() });
        Surveys(Arc::new(Shared { engine, store, unfinished, book, thread: Mutex::default() }))
    }

    /// Begins a survey of a scene.
    ///
    /// # Errors
    /// Another survey is running, or this one cannot be drawn.
    pub fn begin(&self, scene: &str, wanted: Wanted) -> Result<(), Refusal> {
        let shared = &self.0;
        let info = shared.engine.scene(scene)?;
        if info.bounds.is_none() {
            return Err(Refusal::Empty);
        }
        of_cameras(&info.cameras, &wanted.cameras)?;
        let times = if wanted.is_for_planner { planning::MOST_TIMES } else { 1 };
        let largest = wanted.size.map(|side| side.saturating_mul(times));
        let pixels: u64 = largest.iter().map(|&side| u64::from(side)).product();
        let limits = shared.engine.limits();
        if pixels > MOST_PIXELS || Finer::new(largest, &limits).is_none() {
            let [width, height] = wanted.size;
            let parts = u64::from(PARTS.pow(2));
            let most = MOST_PIXELS.min(limits.max_pixels / parts) / u64::from(times.pow(2));
            let side = limits.max_side / (PARTS * times);
            return Err(Refusal::TooLarge { width, height, most, side });
        }
        let admission = shared.engine.admission();
        let needed = pixels * BYTES_PER_PIXEL;
        admission.grow("the measurement", needed).map_err(EngineError::from)?;

        let stop = Arc::new(AtomicBool::new(false));
        // Taken first, so that the thread of an earlier survey has left the book.
        let mut thread = shared.thread.lock();
        {
            let mut book = shared.book.lock();
            if book.is_closed {
                return Err(EngineError::ShuttingDown.into());
            }
            if let Some(running) = &book.running {
                return Err(Refusal::Running { scene: running.scene.clone() });
            }
            book.running = Some(Running {
                scene: scene.to_owned(),
                progress: Progress::default(),
                fate: Fate::Wanted,
                stop: stop.clone(),
            });
        }
        let (worker, name) = (shared.clone(), scene.to_owned());
        let work = move || worker.work(&name, &wanted, &stop, &admission);
        let begun = std::thread::Builder::new().name("accuracy".into()).spawn(work);
        match begun {
            Ok(begun) => *thread = Some(begun),
            Err(error) => {
                shared.book.lock().running = None;
                return Err(EngineError::Internal(format!("no thread: {error}")).into());
            }
        }
        Ok(())
    }

    /// Goes on with the survey that an earlier process did not end, if there is one. Called once, when scenes are loaded. Blocks for as long as [`Surveys::begin`].
    pub fn resume(&self) {
        let Some((scene, wanted)) = self.0.unfinished.left_over() else { return };
        match self.begin(&scene, wanted) {
            Ok(()) => tracing::info!(scene, "going on with an accuracy measurement"),
            // A client was faster.
            Err(Refusal::Running { .. }) => {}
            Err(Refusal::Engine(EngineError::ShuttingDown)) => {}
            Err(refusal) => {
                tracing::warn!(scene, %refusal, "cannot go on with an accuracy measurement");
                self.0.unfinished.remove_of(&scene);
            }
        }
    }

    /// Returns what is known of a scene; `None` if it was never measured. Blocks for as long as resolving a frame takes.
    pub fn view(&self, scene: &str) -> Option<View> {
        let (state, kept) = {
            let book = self.0.book.lock();
            let kept = book.kept.get(scene).cloned();
            let running = book.running.as_ref().filter(|running| running.scene == scene);
            let state = match running {
                Some(Running { progress, fate: Fate::Wanted, .. }) => {
                    State::Running(progress.clone())
                }
                Some(Running { fate: Fate::Cancelled, .. }) => State::Cancelled,
                _ => match book.ended.iter().find(|(ended, _)| ended == scene) {
                    Some((_, state)) => state.clone(),
                    None if kept.is_some() => State::Done,
                    None => return None,
                },
            };
            (state, kept)
        };
        let tag = kept.as_ref().and_then(|_| tag(&self.0.engine, scene).ok());
        let is_stale = kept.as_ref().map(|kept| tag.as_ref() != Some(&kept.tag));
        Some(View { state, is_stale, kept })
    }

    /// Cancels the running survey of a scene; it ends after the frame at hand. Earlier results stay.
    pub fn cancel(&self, scene: &str) {
        if !self.0.end(scene, Fate::Cancelled) {
            self.0.unfinished.remove_of(scene);
        }
    }

    /// Cancels the running survey of a scene, and removes its results. Returns whether there was anything.
    pub fn forget(&self, scene: &str) -> bool {
        let was_running = self.0.end(scene, Fate::Forgotten);
        if !was_running {
            self.0.unfinished.remove_of(scene);
        }
        let mut book = self.0.book.lock();
        let had_ended = book.forget_end(scene);
        let had_results = book.kept.remove(scene).is_some();
        drop(book);
        if had_results {
            self.0.store.remove(scene);
        }
        was_running || had_ended || had_results
    }

    /// Makes the running survey end after the frame at hand, and lets no other begin. Does not wait.
    pub fn close(&self) {
        let mut book = self.0.book.lock();
        book.is_closed = true;
        if let Some(running) = &book.running {
            running.stop.store(true, Ordering::Relaxed);
        }
    }

    /// Waits until no survey runs any more, after [`Surveys::close`]. Blocks.
    pub fn wait(&self) {
        if let Some(thread) = self.0.thread.lock().take() {
            // A thread that panicked has logged it.
            let _ = thread.join();
        }
    }
}

impl Book {
    /// Notes how the latest survey of a scene ended. Of too many, the oldest is forgotten.
    fn end(&mut self, scene: &str, state: State) {
        self.forget_end(scene);
        self.ended.push_back((scene.to_owned(), state));
        if self.ended.len() > MOST_KEPT {
            self.ended.pop_front();
        }
    }

    /// Forgets how the latest survey of a scene ended. Returns whether it was known.
    fn forget_end(&mut self, scene: &str) -> bool {
        let before = self.ended.len();
        self.ended.retain(|(ended, _)| ended != scene);
        self.ended.len() < before
    }
}

impl Shared {
    fn is_wanted(&self) -> bool {
        let book = self.book.lock();
        book.running.as_ref().is_some_and(|running| running.fate == Fate::Wanted)
    }

    /// Ends the running survey if it is that of a scene. Returns whether it was.
    fn end(&self, scene: &str, fate: Fate) -> bool {
        let mut book = self.book.lock();
        let Some(running) = book.running.as_mut().filter(|running| running.scene == scene) else {
            return false;
        };
        let was_known = running.fate != Fate::Forgotten;
        if was_known {
            running.fate = fate;
        }
        running.stop.store(true, Ordering::Relaxed);
        was_known
    }

    fn tell(&self, progress: Progress) {
        if let Some(running) = &mut self.book.lock().running {
            running.progress = progress;
        }
    }

    /// Surveys a scene and keeps the results.
    fn work(&self, scene: &str, wanted: &Wanted, stop: &AtomicBool, admission: &Admission) {
        tracing::info!(scene, ?wanted, "measuring accuracy");
        self.unfinished.start(scene, wanted);
        let measuring = AssertUnwindSafe(|| self.measure(scene, wanted, stop));
        let measured = catch_unwind(measuring).unwrap_or_else(|_| {
            let detail = "the measurement ended by a defect of the program";
            Err(State::Failed(Failure::Other(detail.to_owned())))
        });
        admission.shrink_to(0);
        // Written before the survey counts as ended: whoever sees it done finds the file.
        let is_wanted = self.is_wanted();
        let is_closed = self.book.lock().is_closed;
        let goes_on = is_wanted && is_closed && matches!(measured, Err(State::Cancelled));
        let (state, kept) = match measured {
            Ok(Outcome::Results(kept)) => (State::Done, Some(Arc::new(kept))),
            Ok(Outcome::Planner(measured, mark)) => {
                let is_same = || self.engine.scene_mark(scene) == mark;
                let learned =
                    self.engine.learn_if(scene, measured, || is_same() && self.is_wanted());
                match learned {
                    Ok(Some(_)) => (State::Done, None),
                    _ if !is_same() => (State::Failed(Failure::SceneChanged), None),
                    _ => (State::Cancelled, None),
                }
            }
            Err(state) => (state, None),
        };
        tracing::info!(scene, ?state, "accuracy measured");
        let kept = kept.filter(|_| is_wanted);
        if let Some(kept) = &kept {
            self.store.write(kept);
        }
        // Before the survey leaves the book, so that the next one finds the folder empty.
        match goes_on {
            true => self.unfinished.pause(),
            false => self.unfinished.remove(),
        }
        let mut book = self.book.lock();
        let fate = book.running.take().map_or(Fate::Forgotten, |running| running.fate);
        let mut left_over = Vec::new();
        match (fate, kept) {
            (Fate::Wanted, Some(kept)) => {
                book.forget_end(scene);
                book.kept.insert(scene.to_owned(), kept);
                let oldest = book.kept.values().min_by_key(|kept| kept.since_ms);
                let oldest = oldest.map(|kept| kept.scene.clone());
                if let Some(oldest) = oldest.filter(|_| book.kept.len() > MOST_KEPT) {
                    book.kept.remove(&oldest);
                    left_over.push(oldest);
                }
            }
            (Fate::Wanted, None) => book.end(scene, state),
            // A cancellation that came once the planner had the measurements was too late.
            (Fate::Cancelled, None) if state == State::Done => book.end(scene, state),
            (Fate::Cancelled, kept) => {
                book.end(scene, State::Cancelled);
                // The file of earlier results was replaced meanwhile.
                if kept.is_some()
                    && let Some(earlier) = book.kept.get(scene).cloned()
                {
                    self.store.write(&earlier);
                }
            }
            (Fate::Forgotten, _) => left_over.push(scene.to_owned()),
        }
        drop(book);
        left_over.iter().for_each(|scene| self.store.remove(scene));
    }
}

/// A tag of the scene's content, the adapter and the build. Resolves a small frame that needs no bake.
fn tag(engine: &Engine, scene: &str) -> Result<String, EngineError> {
    let request = FrameRequest {
        scene: scene.to_owned(),
        pose: Pose::FIT,
        width: 64,
        height: 64,
        settings: Settings::drawn_as(Reconstruct::Points),
        output: Output::Color,
        format: crate::encode::ImageFormat::Raw,
        quality: 100,
        deadline: None,
    };
    Ok(engine.resolve_blocking(request)?.etag().to_owned())
}
