//! The server's side: queues a job's frames as runs and collects them from the store.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{FutureExt, StreamExt, TryStreamExt, stream};
use parking_lot::Mutex;
use sha2::{Digest, Sha256};
use tokio::runtime::Handle;
use tokio::sync::OnceCell;

use super::broker::{Address, Broker, BrokerError};
use super::bundle::{Hashes, pack};
use super::cleaning::clean_daily;
use super::desk::Desk;
use super::messages::{BEATS, Beat, FilmOrder, Note, Run, notes};
use super::pacing::{LOST_AFTER, Listings, MOST_NOTES, READS, TICK};
use super::roster::Roster;
use super::store::{Store, StoreError};
use super::{Said, kind_of, stopped};
use crate::engine::{Engine, RequestId};
use crate::film::manifest::digits;
use crate::film::{Drawn, FilmError, Keep};
use crate::jobs::{Load, Order, Queued, Remote};

/// Time after which a job says that no worker can draw it.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause after the broker has failed.
const PAUSE: Duration = Duration::from_millis(500);
/// Interval at which queued runs are counted.
const COUNT_EVERY: Duration = Duration::from_secs(2);
/// Interval at which a film's order is stored again, so that a cleaning between two others finds it changed.
const RENEW: Duration = Duration::from_secs(12 * 3600);
/// Time limit of the removal of a film that is over.
const CLEAR: Duration = Duration::from_secs(60);
/// Number of frames set aside at which a film is given up, before all its frames have killed workers.
const MOST_ASIDE: usize = 8;
/// Largest beat, in bytes.
const MOST_BEAT: usize = 1024;

/// Draws frames of jobs by worker processes; clones share it.
#[derive(Clone)]
pub struct Farm {
    shared: Arc<Shared>,
}

struct Shared {
    broker: Broker,
    store: Store,
    runtime: Handle,
    /// Lasting name of this server.
    name: String,
    /// Hash of what decides the pixels of this server's frames.
    identity: String,
    /// Known when the store has been reached.
    kind: OnceCell<String>,
    address: String,
    adapter: String,
    roster: Mutex<Roster>,
    /// `None` while the broker or the store does not answer.
    queued: Mutex<Option<Queued>>,
    set_aside: AtomicU64,
    /// Frames that were queued or tried again.
    retried: AtomicU64,
    /// Films that share the workers now.
    films: AtomicU64,
    hashes: Arc<Hashes>,
}

/// Reason for the end of a film.
#[derive(Debug, thiserror::Error)]
enum Trouble {
    #[error(transparent)]
    Broker(#[from] BrokerError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Farm {
    /// Prepares a farm whose tasks run on `runtime`. `name` is this server's for good.
    ///
    /// # Errors
    /// The broker's address cannot be used. A broker that is not there is no error.
    pub fn new(
        address: &Address,
        store: Store,
        name: String,
        engine: &Engine,
        runtime: &Handle,
    ) -> Result<Farm, BrokerError> {
        let client_name = format!("pointillist server {name}");
        let broker = runtime.block_on(Broker::connect(address, &client_name))?;
        let (identity, adapter) = (engine.identity(), engine.adapter());
        let address = address.without_secrets();
        let roster = Mutex::new(Roster::default());
        let queued = Mutex::default();
        let [set_aside, retried, films] = [(); 3].map(|()| AtomicU64::new(0));
        let hashes = Arc::<Hashes>::default();
        let runtime = runtime.clone();
        let shared = Shared {
            broker,
            store,
            runtime,
            name,
            identity,
            kind: OnceCell::new(),
            address,
            adapter,
            roster,
            queued,
            set_aside,
            retried,
            films,
            hashes,
        };
        let farm = Farm { shared: Arc::new(shared) };
        farm.shared.runtime.spawn(hear_beats(farm.shared.clone()));
        farm.shared.runtime.spawn(count_queued(farm.shared.clone()));
        farm.shared.runtime.spawn(clean_daily(farm.shared.store.clone()));
        Ok(farm)
    }
}

/// Keeps the roster for as long as the process lives.
async fn hear_beats(shared: Arc<Shared>) {
    loop {
        if let Ok(mut beats) = shared.broker.hear(BEATS).await {
            while let Some(message) = beats.next().await {
                if message.payload.len() <= MOST_BEAT
                    && let Ok(beat) = serde_json::from_slice::<Beat>(&message.payload)
                {
                    shared.roster.lock().hear(beat, Instant::now());
                }
            }
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Counts queued runs now and then, for as long as the process lives.
async fn count_queued(shared: Arc<Shared>) {
    let said = Said::default();
    loop {
        let queued = match shared.kind().await {
            Ok(kind) => shared.broker.queued(kind).await.ok(),
            Err(error) => {
                if said.is_due(&error.to_string()) {
                    tracing::warn!(%error, "films wait for the store");
                }
                None
            }
        };
        *shared.queued.lock() = queued;
        tokio::time::sleep(COUNT_EVERY).await;
    }
}

impl Remote for Farm {
    fn load(&self) -> Load {
        let now = Instant::now();
        let is_connected = self.shared.broker.is_connected();
        // The count may be older than the end of the connection.
        let queued = *self.shared.queued.lock();
        let queued = queued.filter(|_| is_connected);
        let set_aside = self.shared.set_aside.load(Ordering::Relaxed);
        let retried = self.shared.retried.load(Ordering::Relaxed);
        let roster = self.shared.roster.lock();
        let (kind, identity) = (self.shared.known_kind(), &self.shared.identity);
        let (workers, paused_workers) = (roster.of_kind(kind, now), roster.paused(kind, now));
        let other_workers = roster.others(kind, identity, now).into_values().sum();
        Load { is_connected, workers, paused_workers, other_workers, queued, set_aside, retried }
    }

    fn draw(
        &self,
        order: Order<'_>,
        stop: &AtomicBool,
        keep: &mut Keep<'_>,
        tell: &dyn Fn(Option<String>),
    ) -> Result<(), FilmError> {
        let shared = &self.shared;
        shared.runtime.block_on(async {
            let kind = tokio::select! {
                kind = shared.reach_store(tell) => kind,
                () = stopped(stop) => return Ok(()),
            };
            tell(Some("the scene's files are being stored for workers".to_owned()));
            let root = order.engine.root();
            let packed = pack(&root, &order.files, &shared.hashes, &shared.store);
            let scene = tokio::select! {
                packed = packed => packed.map_err(|error| FilmError::Elsewhere(error.to_string()))?,
                () = stopped(stop) => return Ok(()),
            };
            let film_order = FilmOrder { spec: order.spec, scene };
            let text = serde_json::to_vec(&film_order);
            let text = text.map_err(|error| FilmError::Elsewhere(error.to_string()))?;
            let film = shared.film_name(kind, order.job, &text);
            let desk = Desk::new(&film, RequestId::fresh().to_string(), order.frames);
            let collection = Collection {
                shared,
                kind,
                film: film.clone(),
                order: text,
                desk,
                listings: Listings::default(),
                is_purged: false,
                aside: BTreeMap::new(),
                unqueued: None,
                obstacle: None,
                trouble: None,
                said: Said::default(),
                began: Instant::now(),
            };
            let sharing = Sharing::begin(&shared.films);
            let collected = tokio::select! {
                collected = collection.collect(keep, tell) => Some(collected),
                () = stopped(stop) => None,
            };
            drop(sharing);
            let is_over = collected.is_some() || !(order.is_pause)();
            let cleared = async {
                let purged = shared.broker.purge(kind, &film).await;
                if is_over {
                    // The frames are in the job's folder. A worker that still draws some finds no order and stops.
                    shared.store.remove(&film).await?;
                }
                Ok::<(), Trouble>(purged?)
            };
            match tokio::time::timeout(CLEAR, cleared).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::warn!(film, %error, "cannot remove an ended film's runs from the queue or its files from the store"),
                Err(_) => tracing::warn!(film, "clearing up after a film takes too long"),
            }
            collected.unwrap_or(Ok(()))
        })
    }
}

impl Shared {
    /// Returns the kind of this server's workers.
    ///
    /// # Errors
    /// The store cannot be reached.
    async fn kind(&self) -> Result<&str, StoreError> {
        let found = || async { Ok(kind_of(&self.identity, self.store.claim().await?)) };
        Ok(self.kind.get_or_try_init(found).await?)
    }

    /// Returns the kind, which no worker has before the store has been reached.
    fn known_kind(&self) -> &str {
        self.kind.get().map(String::as_str).unwrap_or_default()
    }

    /// Waits for the store, and returns the kind.
    async fn reach_store(&self, tell: &dyn Fn(Option<String>)) -> &str {
        loop {
            let reached = async {
                let kind = self.kind().await?;
                self.store.check().await?;
                Ok::<&str, StoreError>(kind)
            };
            match reached.await {
                Ok(kind) => return kind,
                Err(error) => tell(Some(error.to_string())),
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Names a film: by this server, the job, and everything that its frames share. After a kill, the next process finds the frames again.
    fn film_name(&self, kind: &str, job: u64, order: &[u8]) -> String {
        let mut hasher = Sha256::new_with_prefix(format!("{} {job} {kind} ", self.name));
        hasher.update(order);
        digits(&hasher.finalize()[..16])
    }
}

/// Counts a film among those that share the workers, until it is dropped.
struct Sharing<'a>(&'a AtomicU64);

impl<'a> Sharing<'a> {
    fn begin(films: &'a AtomicU64) -> Sharing<'a> {
        films.fetch_add(1, Ordering::Relaxed);
        Sharing(films)
    }
}

impl Drop for Sharing<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A film whose frames are being collected.
struct Collection<'a> {
    shared: &'a Shared,
    kind: &'a str,
    film: String,
    order: Vec<u8>,
    desk: Desk,
    listings: Listings,
    /// The runs of an earlier process are removed from the queue.
    is_purged: bool,
    /// Why frames are set aside.
    aside: BTreeMap<u64, String>,
    /// A run that the broker has not confirmed.
    unqueued: Option<Run>,
    /// The latest failure of the broker or the store, until both work.
    obstacle: Option<String>,
    /// The latest failure of a worker, until a frame arrives.
    trouble: Option<String>,
    said: Said,
    began: Instant,
}

impl Collection<'_> {
    async fn collect(
        mut self,
        keep: &mut Keep<'_>,
        tell: &dyn Fn(Option<String>),
    ) -> Result<(), FilmError> {
        let mut prepared: Option<Instant> = None;
        let mut heard = None;
        while !self.desk.is_clear() && self.aside.len() < MOST_ASIDE {
            // At first, the store may have frames of an earlier process.
            if self.listings.is_due(Instant::now()) {
                match self.look(keep).await? {
                    Ok(()) => self.listings.listed(Instant::now()),
                    Err(error) => self.failed(&error.into()).await,
                }
            }
            if prepared.is_none_or(|at| at.elapsed() >= RENEW) {
                match self.prepare().await {
                    Ok(notes) => (prepared, heard) = (Some(Instant::now()), Some(notes)),
                    Err(error) => self.failed(&error).await,
                }
            } else if let Err(error) = self.queue().await {
                // A broker that lost its files needs the stream again.
                prepared = None;
                self.failed(&error).await;
            } else {
                self.obstacle = None;
            }
            tell(self.waits_for());
            let Some(notes) = &mut heard else { continue };
            let first = tokio::time::timeout(TICK, notes.next()).await;
            let mut arrived = Vec::new();
            if let Ok(Some(message)) = first {
                self.listings.hear(Instant::now());
                self.hear(&message.payload, &mut arrived);
                while arrived.len() < MOST_NOTES
                    && let Some(Some(message)) = notes.next().now_or_never()
                {
                    self.hear(&message.payload, &mut arrived);
                }
            } else if matches!(first, Ok(None)) {
                prepared = None;
            }
            if let Err(error) = self.take(arrived, keep).await? {
                self.failed(&error.into()).await;
            }
            self.look_for_lost().await;
        }
        match self.aside.into_iter().next() {
            None => Ok(()),
            Some((frame, why)) => {
                Err(FilmError::Elsewhere(format!("frame {frame} is set aside: {why}")))
            }
        }
    }

    async fn failed(&mut self, trouble: &Trouble) {
        let text = trouble.to_string();
        if self.said.is_due(&text) {
            tracing::warn!(film = self.film, error = text, "a film waits");
        }
        self.obstacle = Some(text);
        tokio::time::sleep(PAUSE).await;
    }

    /// Stores what workers need. The first time, removes runs of an earlier process: later runs in the queue are those of this process,
    /// which the desk counts as queued. Returns the film's notes.
    async fn prepare(&mut self) -> Result<async_nats::Subscriber, Trouble> {
        let (Shared { broker, store, .. }, kind) = (self.shared, self.kind);
        store.put_order(&self.film, self.order.clone()).await?;
        broker.prepare(kind).await?;
        let heard = broker.hear(&notes(&self.film)).await?;
        if !self.is_purged {
            broker.purge(kind, &self.film).await?;
            self.is_purged = true;
        }
        Ok(heard)
    }

    /// Queues runs, as many as workers need.
    async fn queue(&mut self) -> Result<(), Trouble> {
        let (Shared { broker, roster, films, .. }, kind) = (self.shared, self.kind);
        loop {
            let workers = roster.lock().of_kind(kind, Instant::now());
            let films = films.load(Ordering::Relaxed);
            let next = || self.desk.next(workers, films, Instant::now());
            let Some(run) = self.unqueued.take().or_else(next) else { return Ok(()) };
            if let Err(error) = broker.queue(kind, &run).await {
                // It may be queued all the same; the broker then drops the second one.
                self.unqueued = Some(run);
                return Err(error.into());
            }
        }
    }

    /// Takes a note, and collects the numbers of frames that have arrived.
    fn hear(&mut self, note: &[u8], arrived: &mut Vec<u64>) {
        let Ok(note) = serde_json::from_slice::<Note>(note) else { return };
        match note {
            Note::Drawn { run, frame } | Note::SetAside { run, frame } => {
                self.desk.seen(&[run], Instant::now());
                arrived.push(frame);
            }
            Note::Finished { run, drawn, elapsed_ns } => {
                self.desk.seen(&[run], Instant::now());
                self.desk.measured(drawn, Duration::from_nanos(elapsed_ns));
            }
            Note::Failed { run, frames, reason } => {
                tracing::warn!(film = self.film, run, reason, "a run is tried again");
                let frames = frames.min(self.desk.left_of(run));
                self.shared.retried.fetch_add(frames, Ordering::Relaxed);
                self.desk.seen(&[run], Instant::now());
                self.trouble = Some(reason);
            }
        }
    }

    /// Takes everything that is in the store.
    async fn look(&mut self, keep: &mut Keep<'_>) -> Result<Result<(), StoreError>, FilmError> {
        let listing = match self.shared.store.list(&self.film).await {
            Ok(listing) => listing,
            Err(error) => return Ok(Err(error)),
        };
        let numbers = self.desk.numbers(&listing.frames);
        self.take([numbers, listing.aside].concat(), keep).await
    }

    /// Takes frames from the store. The outer error is that of `keep`.
    async fn take(
        &mut self,
        numbers: Vec<u64>,
        keep: &mut Keep<'_>,
    ) -> Result<Result<(), StoreError>, FilmError> {
        let Shared { store, .. } = self.shared;
        let film = &self.film;
        let wanted: Vec<(u64, String)> = numbers
            .into_iter()
            .filter_map(|number| Some((number, self.desk.tag(number)?)))
            .collect();
        let mut reads = stream::iter(wanted)
            .map(|(number, tag)| async move {
                let image = store.frame(film, &tag).await?;
                let why = match image {
                    None => store.why_aside(film, number).await?,
                    Some(_) => None,
                };
                Ok::<Read, StoreError>((number, tag, image, why))
            })
            .buffer_unordered(READS);
        loop {
            let (number, tag, image, why) = match reads.try_next().await {
                Ok(Some(read)) => read,
                Ok(None) => return Ok(Ok(())),
                Err(error) => return Ok(Err(error)),
            };
            if image.is_none() && why.is_none() || !self.desk.close(number) {
                continue;
            }
            match image {
                Some(bytes) => {
                    self.trouble = None;
                    keep(Drawn { number, tag, bytes, receipt: None })?;
                }
                None => {
                    tracing::error!(film, frame = number, ?why, "a frame is set aside");
                    self.shared.set_aside.fetch_add(1, Ordering::Relaxed);
                    self.aside.insert(number, why.unwrap_or_default());
                }
            }
        }
    }

    /// Queues runs again that no worker seems to have.
    async fn look_for_lost(&mut self) {
        let now = Instant::now();
        let (runs, has_idle) = {
            let roster = self.shared.roster.lock();
            (roster.runs_of(&self.film, now), roster.has_idle(self.kind, now))
        };
        self.desk.seen(&runs, now);
        self.listings.see(&runs);
        let lost = self.desk.take_back(has_idle, now);
        if lost > 0 {
            tracing::warn!(
                film = self.film,
                frames = lost,
                "no worker has these runs; they are queued again"
            );
            self.shared.retried.fetch_add(lost, Ordering::Relaxed);
            match self.shared.broker.mend(self.kind).await {
                Ok(true) => {
                    tracing::warn!(
                        "the NATS server skipped queued runs; the server recreated the consumer"
                    )
                }
                Ok(false) => {}
                Err(error) => {
                    tracing::warn!(%error, "cannot check whether the NATS server skips runs")
                }
            }
            // Workers drop runs of a film without an order.
            if let Err(error) = self.shared.store.put_order(&self.film, self.order.clone()).await {
                self.failed(&error.into()).await;
            }
        }
    }

    /// Says what the film waits for.
    fn waits_for(&self) -> Option<String> {
        if !self.shared.broker.is_connected() {
            return Some(format!("the NATS server {}, which does not answer", self.shared.address));
        }
        if let Some(why) = self.obstacle.as_ref().or(self.trouble.as_ref()) {
            return Some(why.clone());
        }
        let now = Instant::now();
        let roster = self.shared.roster.lock();
        let missed = self.desk.missed(roster.has_idle(self.kind, now), now);
        if missed > 0 {
            let seconds = LOST_AFTER.as_secs();
            return Some(format!(
                "runs that no worker gets from the queue ({missed}); the server queues them again after {seconds} seconds without a sign of them"
            ));
        }
        if self.began.elapsed() < PATIENCE || roster.of_kind(self.kind, now) > 0 {
            return None;
        }
        let (adapter, version) = (&self.shared.adapter, crate::VERSION);
        let wanted =
            format!("a worker with the adapter {adapter} and this build of version {version}");
        let others = roster.others(self.kind, &self.shared.identity, now);
        let seen: Vec<String> =
            others.into_iter().map(|(what, count)| format!("{count} {what}")).collect();
        Some(match &seen[..] {
            [] => format!("{wanted}; there are no workers"),
            seen => format!("{wanted}; there are only others: {}", seen.join("; ")),
        })
    }
}

/// A frame's number and tag, its image, or why it is set aside.
type Read = (u64, String, Option<Bytes>, Option<String>);
