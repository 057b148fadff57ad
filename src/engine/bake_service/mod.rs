//! The bake service: one queue of bakes for frames, streams, films and jobs.
//!
//! ```text
//! frame, stream, film, job ──► ticket ─┐
//!                              ticket ─┴─► roster (pure) ──► a thread a bake, few at a time ──► all tickets of it
//!                              dropped: the last one has the bake stop at its next step
//! ```
//!
//! There are two goals ([`Goal`]): normals and kernels of large clouds, which are not estimated when these are read, and point
//! trees, which need them. A second request for the same goal joins the running bake. A stopped bake keeps the assets that it had
//! finished and leaves the others as they were.

mod latch;
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

pub use self::latch::Latch;
use self::roster::{BakeId, Joined, Left, Roster};
use super::loaded::Loaded;
use super::watch::{Abandoned, STEPS, Watch};
use super::{EngineConfig, EngineError};
use crate::bake::cache::BakeCache;

/// Largest number of concurrent bakes. Each uses all cores for most of its time, and much memory.
const MOST: usize = 2;
/// Interval at which a blocking waiter checks whether it still has to wait.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The scene with what was baked.
type Reply = Result<Arc<Loaded>, EngineError>;

/// The data that a bake makes for a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Normals and kernels of all samples.
    Estimates,
    /// Point trees.
    Trees,
}

impl Goal {
    /// Returns a key that is unique among the bakes of all scenes.
    fn key(self, scene: &Loaded) -> u64 {
        scene.model.uid << 1 | u64::from(self == Goal::Trees)
    }
}

/// The owner of the scenes, which replaces a scene by its completed version.
pub trait Scenes: Send + Sync {
    /// Estimates what the samples of a scene lack, replaces the scene by the whole one, and returns that.
    fn make_whole(
        &self,
        scene: &Arc<Loaded>,
        watch: &Watch<'_>,
    ) -> Result<Result<Arc<Loaded>, EngineError>, Abandoned>;
}

/// One bake with waiters.
struct Bake {
    work: Work,
    waiting: Vec<oneshot::Sender<Reply>>,
}

/// State shared with a bake's thread.
#[derive(Clone)]
struct Work {
    scene: Arc<Loaded>,
    goal: Goal,
    stop: Arc<AtomicBool>,
    /// Progress in [`STEPS`].
    done: Arc<AtomicU32>,
}

struct State {
    roster: Roster,
    /// All bakes that the roster lists as wanted.
    bakes: HashMap<BakeId, Bake>,
}

/// All bakes of an engine.
pub struct BakeService {
    state: Mutex<State>,
    cache: Option<BakeCache>,
    /// Bakes do not begin while this is shut.
    latch: Option<Arc<Latch>>,
    scenes: OnceLock<Weak<dyn Scenes>>,
}

/// Waits for a bake: await it, or wait on a thread. Dropping it gives up waiting.
pub struct BakeTicket {
    bakes: Arc<BakeService>,
    id: BakeId,
    done: Arc<AtomicU32>,
    receiver: oneshot::Receiver<Reply>,
}

impl BakeService {
    pub fn new(config: &EngineConfig) -> Arc<BakeService> {
        let state = State { roster: Roster::new(MOST), bakes: HashMap::new() };
        Arc::new(BakeService {
            state: Mutex::new(state),
            cache: config.bake_cache.clone(),
            latch: config.bake_latch.clone(),
            scenes: OnceLock::new(),
        })
    }

    /// Sets the owner of the scenes. Only the first call has an effect.
    pub fn serve(&self, scenes: Weak<dyn Scenes>) {
        let _ = self.scenes.set(scenes);
    }

    /// Waits for a goal of a scene, together with all others who wait for it.
    pub fn join(self: &Arc<BakeService>, scene: Arc<Loaded>, goal: Goal) -> BakeTicket {
        let (sender, receiver) = oneshot::channel();
        let mut state = self.state.lock();
        let (id, done) = match state.roster.join(goal.key(&scene)) {
            Joined::Shared(id) => {
                let done = state.bakes.get_mut(&id).map(|bake| {
                    // Senders whose tickets were dropped would pile up during a long bake.
                    bake.waiting.retain(|waiting| !waiting.is_closed());
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

    /// Starts waiting bakes while there is room.
    fn begin(self: &Arc<BakeService>) {
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

    /// Answers all waiters.
    fn finish(&self, id: BakeId, reply: Reply) {
        let mut state = self.state.lock();
        let bake = if state.roster.finished(id) { state.bakes.remove(&id) } else { None };
        drop(state);
        for sender in bake.into_iter().flat_map(|bake| bake.waiting) {
            // A waiter that has gone needs no answer.
            let _ = sender.send(reply.clone());
        }
    }

    fn leave(self: &Arc<BakeService>, id: BakeId) {
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

    /// Ends the bakes of all revisions of a deleted scene. Those who wait for them get `error`.
    pub fn cancel(&self, load: u64, error: &EngineError) {
        let cancelled: Vec<Bake> = {
            let mut state = self.state.lock();
            let State { roster, bakes } = &mut *state;
            bakes
                .extract_if(|_, bake| bake.work.scene.load() == load)
                .map(|(id, bake)| {
                    roster.cancel(id);
                    bake
                })
                .collect()
        };
        for Bake { work, waiting } in cancelled {
            work.stop.store(true, Ordering::Relaxed);
            for sender in waiting {
                // A waiter that has gone needs no answer.
                let _ = sender.send(Err(error.clone()));
            }
        }
    }

    /// Returns the progress of a scene's estimates while somebody waits for them or for point trees, which need them.
    pub fn estimating(&self, scene: &Loaded) -> Option<f64> {
        let state = self.state.lock();
        let works = state.bakes.values().map(|bake| &bake.work);
        let own = works.filter(|work| work.scene.model.uid == scene.model.uid);
        own.map(Work::estimated).reduce(f64::max)
    }

    /// Returns the number of tickets of bakes that have not ended.
    pub fn waiters(&self) -> usize {
        let state = self.state.lock();
        let waiting = state.bakes.values().flat_map(|bake| &bake.waiting);
        waiting.filter(|sender| !sender.is_closed()).count()
    }

    /// Returns the number of running bakes, including those that are stopping.
    pub fn running(&self) -> usize {
        self.state.lock().roster.running()
    }
}

/// Share of the estimates in the time of estimating and building trees.
const ESTIMATING: f64 = 0.3;

impl Work {
    /// Returns the progress of the estimates, from 0 to 1.
    fn estimated(&self) -> f64 {
        let done = f64::from(self.done.load(Ordering::Relaxed)) / STEPS;
        match self.goal {
            Goal::Estimates => done,
            Goal::Trees => (done / ESTIMATING).min(1.0),
        }
    }

    fn run(&self, bakes: &BakeService) -> Reply {
        let watch = Watch::new(&self.stop, &self.done);
        match catch_unwind(AssertUnwindSafe(|| self.work(bakes, &watch))) {
            Ok(Ok(reply)) => reply,
            // Nobody waits for this answer.
            Ok(Err(Abandoned)) => Err(EngineError::Internal("baking was given up".into())),
            Err(_) => Err(EngineError::Internal("baking panicked; the log says how".into())),
        }
    }

    fn work(&self, bakes: &BakeService, watch: &Watch<'_>) -> Result<Reply, Abandoned> {
        if let Some(latch) = &bakes.latch {
            latch.pass(watch)?;
        }
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
            return Ok(Ok(scene));
        }
        let trees = scene.bake_trees(bakes.cache.as_ref(), &watch.part(begin, 1.0 - begin))?;
        Ok(trees.map(|_| scene))
    }
}

impl BakeTicket {
    /// Returns the progress, from 0 to 1.
    pub fn progress(&self) -> f64 {
        f64::from(self.done.load(Ordering::Relaxed)) / STEPS
    }

    /// Returns the result once, if the bake has ended.
    pub fn outcome(&mut self) -> Option<Result<(), EngineError>> {
        Some(self.receiver.try_recv().ok()?.map(drop))
    }

    /// Blocks until the bake ends; not for threads that run async tasks.
    ///
    /// # Errors
    /// A geometry that no tree can be built of.
    pub fn wait(self) -> Result<(), EngineError> {
        self.wait_for_scene().map(drop)
    }

    /// Does the work of [`BakeTicket::wait`] and returns the scene with what was baked.
    pub(super) fn wait_for_scene(mut self) -> Reply {
        let (_, closed) = oneshot::channel();
        let receiver = std::mem::replace(&mut self.receiver, closed);
        receiver.blocking_recv().unwrap_or(Err(EngineError::ShuttingDown))
    }

    /// Waits for the bake and returns the scene with what was baked.
    pub(super) async fn scene(mut self) -> Reply {
        (&mut self.receiver).await.unwrap_or(Err(EngineError::ShuttingDown))
    }

    /// Waits like [`BakeTicket::wait`] while `is_wanted`, called with the progress, returns true; `None` when it returned false.
    pub fn wait_while(
        &mut self,
        mut is_wanted: impl FnMut(f64) -> bool,
    ) -> Option<Result<(), EngineError>> {
        use oneshot::error::TryRecvError;
        while is_wanted(self.progress()) {
            match self.receiver.try_recv() {
                Ok(reply) => return Some(reply.map(drop)),
                Err(TryRecvError::Empty) => std::thread::sleep(LOOK_EVERY),
                Err(TryRecvError::Closed) => return Some(Err(EngineError::ShuttingDown)),
            }
        }
        None
    }
}

impl std::future::Future for BakeTicket {
    type Output = Result<(), EngineError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let polled = Pin::new(&mut self.receiver).poll(context);
        polled.map(|reply| reply.unwrap_or(Err(EngineError::ShuttingDown)).map(drop))
    }
}

impl Drop for BakeTicket {
    fn drop(&mut self) {
        self.bakes.leave(self.id);
    }
}
