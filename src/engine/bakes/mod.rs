//! Baking for those who wait: one service for all who draw, whoever they are.
//!
//! ```text
//! frame, stream, film, job ──► ticket ─┐
//!                              ticket ─┴─► roster (pure) ──► a thread a bake, few at a time ──► all tickets of it
//!                              dropped: the last one has the bake stop at its next step
//! ```
//!
//! There are two things to wait for ([`Goal`]): normals and kernels of large clouds, which are not estimated when these are read, and
//! point trees, which need them. A second request for the same goal joins the running bake. A bake that is stopped has left nothing
//! unfinished behind: assets that it had finished are kept, the others are as they were.

mod roster;

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::task::{Context, Poll};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::oneshot;

use self::roster::{BakeId, Joined, Left, Roster};
use super::EngineError;
use super::library::Loaded;
use crate::bake::cache::BakeCache;

/// Bakes at a time. Each uses all cores for most of its time, and much memory.
const MOST: usize = 2;
/// Progress is told in such parts of the whole.
const STEPS: f64 = 1000.0;
/// How often who waits on a thread looks whether it still has to.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// What those who bake are asked, and what they tell.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    stop: Option<&'a AtomicBool>,
    done: Option<&'a AtomicU32>,
    /// The part of the whole that is being done: where it begins, and how much it is.
    part: [f64; 2],
}

/// What was being baked is wanted no more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Abandoned;

impl<'a> Watch<'a> {
    /// Nobody's: never stopped.
    pub const NONE: Watch<'static> = Watch { stop: None, done: None, part: [0.0, 1.0] };

    fn new(stop: &'a AtomicBool, done: &'a AtomicU32) -> Watch<'a> {
        Watch { stop: Some(stop), done: Some(done), part: [0.0, 1.0] }
    }

    /// Of a part of the work: from `first` to `first + size`, of 1.
    pub fn part(&self, first: f64, size: f64) -> Watch<'a> {
        let [begin, whole] = self.part;
        Watch { part: [begin + first * whole, size * whole], ..*self }
    }

    /// # Errors
    /// The work is to end here.
    pub fn check(&self) -> Result<(), Abandoned> {
        match self.stop {
            Some(stop) if stop.load(Ordering::Relaxed) => Err(Abandoned),
            _ => Ok(()),
        }
    }

    /// So much of this part is done, of 1.
    pub fn tell(&self, done: f64) {
        if let Some(told) = self.done {
            let [begin, size] = self.part;
            let steps = (begin + done.clamp(0.0, 1.0) * size) * STEPS;
            told.fetch_max(steps as u32, Ordering::Relaxed);
        }
    }

    /// For those who cannot be told otherwise.
    pub fn stop_flag(&self) -> Option<&'a AtomicBool> {
        self.stop
    }
}

type Reply = Result<(), EngineError>;

/// What is made of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Normals and kernels of all samples.
    Estimates,
    /// Point trees.
    Trees,
}

impl Goal {
    /// Tells the bakes of all scenes apart.
    fn key(self, scene: &Loaded) -> u64 {
        scene.model.uid << 1 | u64::from(self == Goal::Trees)
    }
}

/// Where scenes are whose samples have got what they lacked.
pub trait Scenes: Send + Sync {
    /// Estimates what the samples of a scene lack, and puts the whole scene in its place. Gives it back.
    fn make_whole(
        &self,
        scene: &Arc<Loaded>,
        watch: &Watch<'_>,
    ) -> Result<Result<Arc<Loaded>, EngineError>, Abandoned>;
}

/// One bake that somebody waits for.
struct Bake {
    work: Work,
    waiting: Vec<oneshot::Sender<Reply>>,
}

/// What a bake's thread has of it.
#[derive(Clone)]
struct Work {
    scene: Arc<Loaded>,
    goal: Goal,
    stop: Arc<AtomicBool>,
    /// In [`STEPS`].
    done: Arc<AtomicU32>,
}

struct State {
    roster: Roster,
    /// All that the roster knows as wanted.
    bakes: HashMap<BakeId, Bake>,
}

/// All bakes of an engine.
pub struct Bakes {
    state: Mutex<State>,
    cache: Option<BakeCache>,
    scenes: OnceLock<Weak<dyn Scenes>>,
}

/// A bake that somebody waits for. Await it, or wait on a thread; dropping it gives it up.
pub struct BakeTicket {
    bakes: Arc<Bakes>,
    id: BakeId,
    done: Arc<AtomicU32>,
    receiver: oneshot::Receiver<Reply>,
}

impl Bakes {
    pub fn new(cache: Option<BakeCache>) -> Arc<Bakes> {
        let state = State { roster: Roster::new(MOST), bakes: HashMap::new() };
        Arc::new(Bakes { state: Mutex::new(state), cache, scenes: OnceLock::new() })
    }

    /// Names those who keep the scenes. Only the first call counts.
    pub fn serve(&self, scenes: Weak<dyn Scenes>) {
        let _ = self.scenes.set(scenes);
    }

    /// Waits for what is made of a scene, with all others who do.
    pub fn join(self: &Arc<Bakes>, scene: Arc<Loaded>, goal: Goal) -> BakeTicket {
        let (sender, receiver) = oneshot::channel();
        let mut state = self.state.lock();
        let (id, done) = match state.roster.join(goal.key(&scene)) {
            Joined::Shared(id) => {
                let done = state.bakes.get_mut(&id).map(|bake| {
                    bake.waiting.push(sender);
                    bake.work.done.clone()
                });
                (id, done.unwrap_or_default())
            }
            Joined::New(id) => {
                let done = Arc::<AtomicU32>::default();
                let work = Work { scene, goal, stop: Arc::default(), done: done.clone() };
                state.bakes.insert(id, Bake { work, waiting: vec![sender] });
                (id, done)
            }
        };
        drop(state);
        self.begin();
        BakeTicket { bakes: self.clone(), id, done, receiver }
    }

    /// Begins what may begin.
    fn begin(self: &Arc<Bakes>) {
        loop {
            let mut state = self.state.lock();
            let Some(id) = state.roster.next() else { return };
            let Some(work) = state.bakes.get(&id).map(|bake| bake.work.clone()) else { continue };
            drop(state);
            let bakes = self.clone();
            let spawned = std::thread::Builder::new().name("bake".into()).spawn(move || {
                let reply = work.run(&bakes);
                bakes.finish(id, reply);
                bakes.begin();
            });
            if let Err(error) = spawned {
                self.finish(id, Err(EngineError::Internal(format!("baking: {error}"))));
            }
        }
    }

    /// Tells those who wait.
    fn finish(&self, id: BakeId, reply: Reply) {
        let mut state = self.state.lock();
        let bake = if state.roster.finished(id) { state.bakes.remove(&id) } else { None };
        drop(state);
        for sender in bake.into_iter().flat_map(|bake| bake.waiting) {
            // Who has gone meanwhile needs no answer.
            let _ = sender.send(reply.clone());
        }
    }

    fn leave(self: &Arc<Bakes>, id: BakeId) {
        let mut state = self.state.lock();
        if state.roster.leave(id) != Left::Nothing
            && let Some(bake) = state.bakes.remove(&id)
        {
            bake.work.stop.store(true, Ordering::Relaxed);
            tracing::info!(
                scene = bake.work.scene.info.id,
                "baking is given up: nobody waits for it"
            );
        }
    }

    /// How much of a scene's estimates is done, while somebody waits for these or for point trees, which need them.
    pub fn estimating(&self, scene: &Loaded) -> Option<f64> {
        let state = self.state.lock();
        let works = state.bakes.values().map(|bake| &bake.work);
        let own = works.filter(|work| work.scene.model.uid == scene.model.uid);
        own.map(Work::estimated).reduce(f64::max)
    }

    /// Bakes that are under way, also such as are stopping.
    pub fn running(&self) -> usize {
        self.state.lock().roster.running()
    }
}

/// Share of estimating in estimating and building trees.
const ESTIMATING: f64 = 0.3;

impl Work {
    /// How much of the estimates is done, of 1.
    fn estimated(&self) -> f64 {
        let done = f64::from(self.done.load(Ordering::Relaxed)) / STEPS;
        match self.goal {
            Goal::Estimates => done,
            Goal::Trees => (done / ESTIMATING).min(1.0),
        }
    }

    fn run(&self, bakes: &Bakes) -> Reply {
        let watch = Watch::new(&self.stop, &self.done);
        match catch_unwind(AssertUnwindSafe(|| self.work(bakes, &watch))) {
            Ok(Ok(reply)) => reply,
            // Nobody hears it.
            Ok(Err(Abandoned)) => Err(EngineError::Internal("baking was given up".into())),
            Err(_) => Err(EngineError::Internal("baking panicked; the log says how".into())),
        }
    }

    fn work(&self, bakes: &Bakes, watch: &Watch<'_>) -> Result<Reply, Abandoned> {
        let (mut scene, mut begin) = (self.scene.clone(), 0.0);
        if !scene.is_whole() {
            let share = if self.goal == Goal::Estimates { 1.0 } else { ESTIMATING };
            let Some(scenes) = bakes.scenes.get().and_then(Weak::upgrade) else {
                return Ok(Err(EngineError::ShuttingDown));
            };
            scene = match scenes.make_whole(&scene, &watch.part(begin, share))? {
                Ok(whole) => whole,
                Err(error) => return Ok(Err(error)),
            };
            begin = share;
        }
        if self.goal == Goal::Estimates {
            return Ok(Ok(()));
        }
        let trees = scene.trees_watched(bakes.cache.as_ref(), &watch.part(begin, 1.0 - begin))?;
        Ok(trees.map(drop))
    }
}

impl BakeTicket {
    /// How much is done, of 1.
    pub fn progress(&self) -> f64 {
        f64::from(self.done.load(Ordering::Relaxed)) / STEPS
    }

    /// How it has ended, if it has; told once.
    pub fn outcome(&mut self) -> Option<Reply> {
        self.receiver.try_recv().ok()
    }

    /// Waits on a thread that runs no async tasks.
    ///
    /// # Errors
    /// A geometry that no tree can be built of.
    pub fn wait(mut self) -> Reply {
        self.wait_while(|_| true).unwrap_or(Err(EngineError::ShuttingDown))
    }

    /// The same for as long as `is_wanted`, which is asked with the progress; `None` when it was not.
    pub fn wait_while(&mut self, mut is_wanted: impl FnMut(f64) -> bool) -> Option<Reply> {
        use oneshot::error::TryRecvError;
        while is_wanted(self.progress()) {
            match self.receiver.try_recv() {
                Ok(reply) => return Some(reply),
                Err(TryRecvError::Empty) => std::thread::sleep(LOOK_EVERY),
                Err(TryRecvError::Closed) => return Some(Err(EngineError::ShuttingDown)),
            }
        }
        None
    }
}

impl std::future::Future for BakeTicket {
    type Output = Reply;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Reply> {
        let polled = Pin::new(&mut self.receiver).poll(context);
        polled.map(|reply| reply.unwrap_or(Err(EngineError::ShuttingDown)))
    }
}

impl Drop for BakeTicket {
    fn drop(&mut self) {
        self.bakes.leave(self.id);
    }
}
