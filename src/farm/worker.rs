//! The worker's side: pulls runs, draws their frames and stores them.
//!
//! A worker draws one run at a time. While it does, it tells the broker every few seconds that it lives; a worker that is killed stops
//! doing so, and the broker delivers the run to another one. A run may therefore be begun several times, and even be drawn by two workers at once:
//! a worker that begins a run again asks the store for its frames first, and equal frames have equal names.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use async_nats::jetstream::{AckKind, Message};
use futures::{StreamExt, TryStreamExt, stream};
use parking_lot::Mutex;
use sha2::{Digest, Sha256};

use super::broker::{Address, Broker, BrokerError, pull};
use super::bundle::unpack;
use super::messages::{Beat, Bundle, FilmOrder, Note, Run, beats, notes};
use super::pacing::{
    ACK_WAIT, BEAT, PROGRESS, STORES, Streak, UNSTORED, Verdict, judge, may_be_stored,
};
use super::store::{Store, StoreError};
use super::tries::Tries;
use super::{Said, kind_of, out_of_time, stopped};
use crate::engine::{Client, Engine, EngineError, RequestId};
use crate::film::manifest::digits;
use crate::film::{self, Drawn, Film, FilmError, Wanted};
use crate::jobs::find_shots;

/// Pause after the broker has failed, and while there is no consumer yet.
const PAUSE: Duration = Duration::from_millis(500);
/// Delay before a run that failed is delivered again.
const AGAIN: Duration = Duration::from_secs(1);
/// Time after which a worker without a queue says so.
const QUIET: Duration = Duration::from_secs(10);
/// Time without a finished frame after which a worker stops telling the broker that it lives. Baking a large scene takes long.
const STUCK: Duration = Duration::from_secs(1800);
/// Time for which a worker listens for beats of others. Each worker beats every second.
const LISTEN: Duration = Duration::from_secs(3);

/// A worker process.
pub struct Worker {
    broker: Broker,
    store: Store,
    engine: Engine,
    /// Known when the store has a mark.
    kind: OnceLock<String>,
    name: String,
    /// The engine's root. Each scene has its own folder there.
    folder: PathBuf,
    /// The key of each loaded scene, by id; see [`scene_key`].
    scenes: tokio::sync::Mutex<HashMap<String, String>>,
    state: Mutex<State>,
    streak: Mutex<Streak>,
}

/// The worker's activity.
struct State {
    busy: Option<(String, u64)>,
    /// The worker pulls no run, because it failed at several.
    is_paused: bool,
    /// When the worker began to wait, or finished its latest frame.
    since: Instant,
}

/// Reason for another try of a run.
struct Failure {
    why: String,
    /// The worker is at fault, and another one may succeed.
    is_own: bool,
}

impl From<String> for Failure {
    fn from(why: String) -> Failure {
        Failure { why, is_own: false }
    }
}

impl Failure {
    fn of_drawing(error: &FilmError) -> Failure {
        let is_own = match error {
            FilmError::Engine(error) | FilmError::Frame { error, .. } => matches!(
                error,
                EngineError::DeviceLost { .. }
                    | EngineError::OutOfGpuMemory { .. }
                    | EngineError::Interrupted(_)
                    | EngineError::NoGpu(_)
                    | EngineError::Internal(_)
            ),
            FilmError::Io { .. } => true,
            _ => false,
        };
        Failure { why: text(error), is_own }
    }
}

/// How work on a run ended, where it needs no other try.
enum Ended {
    /// All frames are in the store, or have been given up or passed on.
    Done,
    /// The film is over.
    Over,
}

impl Worker {
    /// Prepares a worker. The engine's root is `folder`, which the worker fills with scenes.
    ///
    /// # Errors
    /// The broker's address cannot be used.
    pub async fn new(
        address: &Address,
        store: Store,
        engine: Engine,
        folder: &Path,
    ) -> Result<Worker, BrokerError> {
        let name = format!("{}-{}", std::process::id(), RequestId::fresh());
        let broker = Broker::connect(address, &format!("pointillist worker {name}")).await?;
        Ok(Worker {
            broker,
            store,
            kind: OnceLock::new(),
            engine,
            name,
            folder: folder.to_owned(),
            scenes: tokio::sync::Mutex::default(),
            state: Mutex::new(State { busy: None, is_paused: false, since: Instant::now() }),
            streak: Mutex::default(),
        })
    }

    /// Works until `stop` becomes true. A run that is not finished then goes back to the queue.
    pub async fn run(self: Arc<Self>, stop: Arc<AtomicBool>) {
        let beating = tokio::spawn(self.clone().beat());
        let kind = tokio::select! {
            kind = self.reach_store() => kind,
            () = stopped(&stop) => String::new(),
        };
        let mut consumer = None;
        let waiting = Instant::now();
        let said = Said::default();
        while !stop.load(Ordering::Relaxed) {
            let known = match &consumer {
                Some(known) => known,
                None => match self.broker.consumer(&kind).await {
                    Ok(found) => consumer.insert(found),
                    Err(error) => {
                        tracing::debug!(%error, "no server has prepared the queue yet");
                        if waiting.elapsed() >= QUIET
                            && self.broker.is_connected()
                            && said.is_due("waits")
                        {
                            tracing::info!(
                                adapter = self.engine.adapter(),
                                version = crate::VERSION,
                                "no server with this adapter, this build and this store has ordered a film yet"
                            );
                        }
                        tokio::time::sleep(PAUSE).await;
                        continue;
                    }
                },
            };
            let pulled = tokio::select! {
                pulled = pull(known) => pulled,
                () = stopped(&stop) => break,
            };
            match pulled {
                Ok(Some(message)) => {
                    self.work(&message, &stop).await;
                    tokio::select! {
                        () = self.pause() => {}
                        () = stopped(&stop) => break,
                    }
                }
                Ok(None) => {}
                Err(error) => {
                    tracing::debug!(%error, "the broker gives no run");
                    consumer = None;
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
        beating.abort();
        self.broker.flush().await;
    }

    /// Waits if the worker fails at run after run, so that other workers get the runs. A worker that fails at once is nearly always idle,
    /// and would get every run again.
    async fn pause(&self) {
        let Some((failures, pause)) = self.streak.lock().pause() else { return };
        tracing::warn!(
            "the worker failed at {failures} runs in a row and pulls no run for {} seconds; check its temporary folder, host memory and GPU",
            pause.as_secs()
        );
        self.state.lock().is_paused = true;
        tokio::time::sleep(pause).await;
        self.state.lock().is_paused = false;
    }

    /// Waits until a server has marked the store, and returns the worker's kind.
    async fn reach_store(&self) -> String {
        let said = Said::default();
        loop {
            let text = match self.store.find().await {
                Ok(Some(mark)) => {
                    let kind = kind_of(&self.engine.identity(), mark);
                    return self.kind.get_or_init(|| kind).clone();
                }
                Ok(None) => format!(
                    "--store {}: no server has used it yet, or it is not the servers' store; is it mounted?",
                    self.store.name()
                ),
                Err(error) => error.to_string(),
            };
            if said.is_due(&text) {
                tracing::warn!("the worker waits: {text}");
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    async fn beat(self: Arc<Self>) {
        let mut interval = tokio::time::interval(BEAT);
        loop {
            interval.tick().await;
            let (busy, is_paused, since) = {
                let state = self.state.lock();
                (state.busy.clone(), state.is_paused, state.since)
            };
            let idle_ms = if busy.is_some() { 0 } else { since.elapsed().as_millis() as u64 };
            let identity = self.engine.identity();
            let kind = self.kind.get().cloned().unwrap_or_else(|| kind_of(&identity, "unmarked"));
            let subject = beats(&kind);
            let beat = Beat {
                worker: self.name.clone(),
                kind,
                identity,
                adapter: self.engine.adapter(),
                version: crate::VERSION.to_owned(),
                busy,
                idle_ms,
                is_paused,
            };
            self.broker.tell(subject, &beat).await;
        }
    }

    fn known_kind(&self) -> &str {
        self.kind.get().map(String::as_str).unwrap_or_default()
    }

    fn set_busy(&self, busy: Option<(String, u64)>) {
        *self.state.lock() = State { busy, is_paused: false, since: Instant::now() };
    }

    /// Works on the run of a message, and answers the message.
    async fn work(&self, message: &Message, stop: &Arc<AtomicBool>) {
        let run = serde_json::from_slice::<Run>(&message.payload);
        let Some(run) = run.ok().filter(Run::is_sound) else {
            tracing::error!(
                "discarded a malformed run from the queue; another version of the program may have queued it"
            );
            self.answer(message, AckKind::Term).await;
            return;
        };
        self.set_busy(Some((run.film.clone(), run.id)));
        let ended = tokio::select! {
            ended = self.attempt(&run, stop) => ended,
            // This ends only with the process or when the run is stuck.
            () = self.report_progress(message) => {
                Err(format!("no frame was finished for {} seconds", STUCK.as_secs()).into())
            }
            // A thread that is stuck in the driver never looks at `stop`.
            () = out_of_time(stop) => Err("the worker stops".to_owned().into()),
        };
        self.clear_up(&run).await;
        match ended {
            Ok(Ended::Done) => self.answer(message, AckKind::Ack).await,
            Ok(Ended::Over) => self.answer(message, AckKind::Term).await,
            Err(_) if stop.load(Ordering::Relaxed) => {
                self.answer(message, AckKind::Nak(None)).await;
            }
            Err(Failure { why: reason, .. }) => {
                tracing::warn!(film = run.film, run = run.id, reason, "a run failed");
                let frames = run.frames.len() as u64;
                self.tell(&run, &Note::Failed { run: run.id, frames, reason }).await;
                self.answer(message, AckKind::Nak(Some(AGAIN))).await;
            }
        }
        self.set_busy(None);
    }

    /// Removes what the run has stored after the server removed its film.
    async fn clear_up(&self, run: &Run) {
        let film = &run.film;
        let removed: Result<(), StoreError> = async {
            let left = self.store.leftovers(film).await?;
            self.store.remove_leftovers(film, left).await
        }
        .await;
        if let Err(error) = removed {
            tracing::warn!(film, %error, "cannot remove the files of an ended film from the store");
        }
    }

    async fn tell(&self, run: &Run, note: &Note) {
        self.broker.tell(notes(&run.film), note).await;
    }

    /// Answers a message. If the answer is lost, the broker delivers the run again, and its frames are found in the store.
    async fn answer(&self, message: &Message, kind: AckKind) {
        let answered = message.double_ack_with(kind);
        match tokio::time::timeout(ACK_WAIT, answered).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::debug!(%error, "the broker did not confirm"),
            Err(_) => tracing::debug!("the broker did not confirm in time"),
        }
    }

    /// Tells the broker that the run is being worked on, until no frame is finished for long.
    async fn report_progress(&self, message: &Message) {
        while self.state.lock().since.elapsed() < STUCK {
            tokio::time::sleep(PROGRESS).await;
            if let Err(error) = message.ack_with(AckKind::Progress).await {
                tracing::debug!(%error, "the broker does not learn of progress");
            }
        }
    }

    /// Works on a run. The error is a reason for another try.
    async fn attempt(&self, run: &Run, stop: &Arc<AtomicBool>) -> Result<Ended, Failure> {
        // Where the store's file system is gone, the film is not over.
        self.store.check().await.map_err(text)?;
        let order = self.store.order(&run.film).await.map_err(text)?;
        let Some(order) = order else { return Ok(Ended::Over) };
        let (before, _) = self.change_tries(run, |tries| tries.begin(&self.name)).await?;
        match judge(before.begun(), before.deaths(), run.frames.len()) {
            Verdict::Draw => {}
            Verdict::Split => {
                tracing::warn!(
                    film = run.film,
                    run = run.id,
                    "a run was not finished; it is split"
                );
                for one in run.split() {
                    self.broker.queue(self.known_kind(), &one).await.map_err(text)?;
                }
                return Ok(Ended::Done);
            }
            Verdict::SetAside => {
                let deaths = before.deaths();
                let why = format!("it was begun {deaths} times, and each time its worker ended");
                self.set_aside(run, &why).await?;
                return Ok(Ended::Done);
            }
        }
        let drawn = self.draw(run, before.begun(), order, stop).await;
        let gone = if drawn.is_err() { self.store.check().await.err() } else { None };
        let is_stopping = stop.load(Ordering::Relaxed);
        if is_stopping || gone.is_some() {
            // The try does not count: the worker was told to stop, or the store is not there.
            let _ = self.change_tries(run, |tries| tries.take_back(&self.name)).await;
        }
        match (drawn, gone) {
            _ if is_stopping => Err("the worker stops".to_owned().into()),
            (Ok(()), _) => Ok(Ended::Done),
            (Err(_), Some(gone)) => Err(gone.to_string().into()),
            (Err(failure), None) => {
                if failure.is_own {
                    self.streak.lock().fail();
                }
                let (_, tries) = self.change_tries(run, |tries| tries.fail(&self.name)).await?;
                if run.frames.len() == 1 && self.is_hopeless(&tries).await {
                    self.set_aside(run, &failure.why).await?;
                    return Ok(Ended::Done);
                }
                Err(failure)
            }
        }
    }

    /// Changes the tries of a run, and returns them as they were before and as they are now.
    async fn change_tries(
        &self,
        run: &Run,
        change: impl FnOnce(&mut Tries),
    ) -> Result<(Tries, Tries), String> {
        self.store.change_tries(&run.film, &run.key(), change).await.map_err(text)
    }

    /// Returns whether a frame at which this worker has just failed is given up.
    async fn is_hopeless(&self, tries: &Tries) -> bool {
        tries.is_hopeless(false) || tries.is_hopeless(true) && self.is_alone().await
    }

    /// Listens for beats of other workers of this kind, and returns whether there are none.
    async fn is_alone(&self) -> bool {
        let Ok(mut heard) = self.broker.hear(&beats(self.known_kind())).await else { return false };
        let own = &self.name;
        let hear_other = async {
            while let Some(message) = heard.next().await {
                let beat = serde_json::from_slice::<Beat>(&message.payload);
                if beat.is_ok_and(|beat| beat.worker != *own) {
                    return;
                }
            }
        };
        // Without a connection, no beat says anything.
        tokio::time::timeout(LISTEN, hear_other).await.is_err() && self.broker.is_connected()
    }

    async fn set_aside(&self, run: &Run, why: &str) -> Result<(), String> {
        for Wanted { number, .. } in &run.frames {
            tracing::error!(film = run.film, frame = number, why, "a frame is set aside");
            self.store.set_aside(&run.film, *number, why).await.map_err(text)?;
            self.tell(run, &Note::SetAside { run: run.id, frame: *number }).await;
        }
        Ok(())
    }

    /// Draws the frames of a run that are not in the store, and stores them. The run was begun `begun` times before.
    async fn draw(
        &self,
        run: &Run,
        begun: u64,
        order: FilmOrder,
        stop: &Arc<AtomicBool>,
    ) -> Result<(), Failure> {
        let film = &run.film;
        let look = |frame: Wanted| async move {
            Ok::<_, StoreError>((self.store.has_frame(film, &frame.tag).await?, frame))
        };
        let found: Vec<(bool, Wanted)> = if may_be_stored(begun, run.frames.len()) {
            let found = stream::iter(run.frames.clone()).map(look).buffered(STORES);
            found.try_collect().await.map_err(text)?
        } else {
            run.frames.iter().map(|frame| (false, frame.clone())).collect()
        };
        let (there, missing): (Vec<_>, Vec<_>) = found.into_iter().partition(|(there, _)| *there);
        for (_, frame) in there {
            // The worker before may have died before it said so.
            self.tell(run, &Note::Drawn { run: run.id, frame: frame.number }).await;
        }
        let missing: Vec<Wanted> = missing.into_iter().map(|(_, frame)| frame).collect();
        if missing.is_empty() {
            return Ok(());
        }
        let opened = tokio::select! {
            opened = self.open_scene(&order) => opened,
            // The load goes on until the process ends.
            () = stopped(stop) => Err("the worker stops".to_owned()),
        };
        opened.map_err(|why| Failure { why, is_own: true })?;
        die_at(&missing);
        let began = Instant::now();
        let drawn = missing.len() as u64;
        let (sender, receiver) = flume::bounded::<Drawn>(UNSTORED);
        let (engine, stop) = (self.engine.clone(), stop.clone());
        let origin = RequestId::parse(&format!("film-{film}"));
        let drawing = tokio::task::spawn_blocking(move || {
            let spec = &order.spec;
            let shots = find_shots(&engine, spec)?;
            if !film::bake(&engine, &spec.request(), &shots, &stop)? {
                return Err(FilmError::Elsewhere("the worker stops".to_owned()));
            }
            let unknown = || EngineError::UnknownScene { id: spec.scene.clone() };
            let mark = engine.scene_mark(&spec.scene).ok_or_else(unknown)?;
            let origin = crate::engine::Origin {
                client: Client::Unnamed,
                request_id: origin.unwrap_or_else(RequestId::fresh),
            };
            let film = Film {
                engine: &engine,
                request: spec.request(),
                shots,
                mark,
                folder: Path::new(""),
                origin,
                most_pixels: film::MOST_PIXELS,
                elsewhere: None,
            };
            film::draw_wanted(&film, &missing, &stop, |drawn| {
                let gone = |_| FilmError::Elsewhere("the store takes no more frames".to_owned());
                sender.send(drawn).map_err(gone)
            })
        });
        let put = |drawn: Drawn| async move {
            self.store.put_frame(film, &drawn.tag, &drawn.bytes).await.map_err(text)?;
            self.state.lock().since = Instant::now();
            self.tell(run, &Note::Drawn { run: run.id, frame: drawn.number }).await;
            Ok::<(), String>(())
        };
        let stored = receiver.into_stream().map(put).buffer_unordered(STORES);
        let stored = stored.try_for_each(|()| async { Ok(()) }).await;
        let drawing = drawing.await.map_err(text)?;
        // A frame that could not be stored ends the drawing as well, and is the reason.
        stored?;
        drawing.map_err(|error| Failure::of_drawing(&error))?;
        self.streak.lock().end();
        let elapsed_ns = began.elapsed().as_nanos() as u64;
        self.tell(run, &Note::Finished { run: run.id, drawn, elapsed_ns }).await;
        Ok(())
    }

    /// Loads the scene of a film, unless it is loaded.
    async fn open_scene(&self, order: &FilmOrder) -> Result<(), String> {
        let id = &order.spec.scene;
        let key = scene_key(id, &order.scene)?;
        let mut scenes = self.scenes.lock().await;
        if scenes.get(id) == Some(&key) {
            return Ok(());
        }
        self.forget(&mut scenes, |other| other == id).await;
        let folder = self.folder.join(&key);
        let mut loaded = self.load(order, &folder).await;
        if loaded.is_err() && !scenes.is_empty() {
            // The scenes of other films may take the memory, or the disk.
            let _ = tokio::fs::remove_dir_all(&folder).await;
            self.forget(&mut scenes, |_| true).await;
            loaded = self.load(order, &folder).await;
        }
        if let Err(error) = loaded {
            let _ = tokio::fs::remove_dir_all(&folder).await;
            return Err(error);
        }
        scenes.insert(id.clone(), key);
        Ok(())
    }

    /// Copies a film's scene into a folder, and loads it.
    async fn load(&self, order: &FilmOrder, folder: &Path) -> Result<(), String> {
        let source = unpack(&self.store, &order.scene, folder).await.map_err(text)?;
        let (engine, id) = (self.engine.clone(), order.spec.scene.clone());
        let load = move || {
            // A load that took too long may have ended meanwhile.
            let _ = engine.remove(&id);
            engine.load_within(&id, &source, &engine.admission()).map(drop)
        };
        tokio::task::spawn_blocking(load).await.map_err(text)?.map_err(text)
    }

    /// Removes loaded scenes and their files.
    async fn forget(&self, scenes: &mut HashMap<String, String>, which: impl Fn(&String) -> bool) {
        let gone: Vec<String> = scenes.keys().filter(|id| which(id)).cloned().collect();
        for id in gone {
            let _ = self.engine.remove(&id);
            if let Some(key) = scenes.remove(&id) {
                let _ = tokio::fs::remove_dir_all(self.folder.join(key)).await;
            }
        }
    }
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

/// Hashes a scene's id and what the scene is made of. The hash is the name of the scene's folder: scenes of equal files have two, so that
/// one can be removed without the other.
fn scene_key(id: &str, bundle: &Bundle) -> Result<String, String> {
    let text = serde_json::to_vec(&(id, bundle)).map_err(text)?;
    Ok(digits(&Sha256::digest(text)[..16]))
}

/// Ends the process if it is about to draw the frame that `POINTILLIST_WORKER_DIES_AT` names, so that tests have a frame that kills workers.
/// Release builds do not ask for the variable.
fn die_at(frames: &[Wanted]) {
    if !cfg!(debug_assertions) {
        return;
    }
    let deadly = std::env::var("POINTILLIST_WORKER_DIES_AT").ok();
    let deadly = deadly.and_then(|number| number.parse::<u64>().ok());
    if deadly.is_some_and(|number| frames.iter().any(|frame| frame.number == number)) {
        std::process::abort();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_equal_files_have_folders_of_their_own() {
        let bundle = Bundle { main: "a.ply".to_owned(), base: None, up: None, files: Vec::new() };
        let other = Bundle { main: "b.ply".to_owned(), ..bundle.clone() };
        let keys = [("a", &bundle), ("b", &bundle), ("a", &other)]
            .map(|(id, bundle)| scene_key(id, bundle).unwrap());
        assert!(keys[0] != keys[1] && keys[0] != keys[2]);
        assert_eq!(scene_key("a", &bundle).unwrap(), keys[0]);
    }
}
