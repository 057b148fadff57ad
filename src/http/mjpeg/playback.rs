//! A playback: a film that is drawn while it is shown, and not stored. It waits until a frame is due, draws it, and copes
//! with a busy engine.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::timeline::{Next, Timeline};
use crate::engine::{
    Client, EncodedFrame, EngineError, FrameRequest, FrameTicket, LatestSlot, Origin, Pose,
    RequestId, Resolution, SceneMark,
};
use crate::http::App;
use crate::http::access::signed::Caps;
use crate::http::frame::{resolve, wait};
use crate::http::limits::{LONGEST_PAUSE, Standing};
use crate::http::problem::{Kind, Problem};
use crate::http::stream::Place;
use crate::scene::PathSampler;

/// Interval at which an unchanged picture is sent again, so that no proxy takes the connection for dead.
const REPEAT: Duration = Duration::from_secs(15);

/// The path or the view that a playback shows.
pub enum Show {
    Path {
        timeline: Timeline,
        fps: f64,
        start_s: f64,
        sampler: PathSampler,
    },
    /// One view, drawn again when the scene has changed, at least `least` after the last drawing.
    View {
        least: Duration,
    },
}

/// A film that is being shown.
pub struct Playback {
    app: Arc<App>,
    slot: LatestSlot,
    /// Name of the request; the names of the frames derive from it.
    name: RequestId,
    client: Client,
    caps: Caps,
    request: FrameRequest,
    show: Show,
    mark: Option<SceneMark>,
    changes: watch::Receiver<u64>,
    draining: watch::Receiver<bool>,
    /// When tick 0, or the view, was first shown.
    began: Instant,
    /// The tick that is shown; for a view, the number of redraws.
    shown: u64,
    last: Option<Arc<EncodedFrame>>,
    /// The place among the streams.
    _place: Place,
}

/// Why there are no more frames.
enum End {
    /// The path, the scene or the server has ended.
    Over,
    Failed(EngineError),
}

impl Playback {
    /// # Errors
    /// Fails when the number of streams has reached its limit.
    pub fn new(
        app: Arc<App>,
        origin: Origin,
        caps: Caps,
        request: FrameRequest,
        show: Show,
        mark: Option<SceneMark>,
    ) -> Result<Playback, Problem> {
        let place = Place::take(&app, origin.client).ok_or_else(|| {
            Problem::new(Kind::Busy, "too many streams are open")
                .accepted(
                    "fewer streams at a time: see `max_streams` and `max_streams_per_client` of GET /v1/limits",
                )
                .retry_after(Duration::from_secs(1))
        })?;
        Ok(Playback {
            slot: app.engine.latest_slot(origin.client),
            name: origin.request_id,
            client: origin.client,
            caps,
            request,
            show,
            mark,
            changes: app.engine.changes(),
            draining: app.streams.draining(),
            began: Instant::now(),
            shown: 0,
            last: None,
            _place: place,
            app,
        })
    }

    /// Draws the first frame; time counts from its arrival.
    pub async fn first(&mut self) -> Result<Arc<EncodedFrame>, Problem> {
        let request = self.wanted(0);
        let frame = resolve(&self.app, request).await?;
        self.app.check_caps(&self.caps, &frame)?;
        let ticket = self.slot.ask(self.name_of(0), frame)?;
        let frame = wait(&self.app, ticket, None).await?;
        self.began = Instant::now();
        self.sent(&frame);
        Ok(frame)
    }

    /// Returns the request for a tick.
    fn wanted(&self, tick: u64) -> FrameRequest {
        let mut request = self.request.clone();
        if let Show::Path { timeline, fps, start_s, sampler } = &self.show {
            let t = start_s + timeline.frame(tick) as f64 / fps;
            request.pose = Pose::Camera(sampler.at(t));
        }
        request
    }

    /// Returns the frame's number on the path; for a view, the number of redraws.
    pub fn frame_number(&self) -> u64 {
        self.number_at(self.shown)
    }

    fn number_at(&self, tick: u64) -> u64 {
        match &self.show {
            Show::Path { timeline, .. } => timeline.frame(tick),
            Show::View { .. } => tick,
        }
    }

    fn name_of(&self, tick: u64) -> RequestId {
        self.name.part(self.number_at(tick))
    }

    fn sent(&mut self, frame: &Arc<EncodedFrame>) {
        self.app.metrics.frame(frame);
        self.app.metrics.stream_frames.inc();
        self.last = Some(frame.clone());
    }

    /// Returns the next frame when it is due.
    pub async fn next(&mut self) -> Option<Arc<EncodedFrame>> {
        loop {
            match self.app.standing(self.client, &self.caps) {
                Standing::Good => break,
                // A film whose key has no GPU time left stands still until it has.
                Standing::Spent(wait) => {
                    let pause = wait.min(LONGEST_PAUSE);
                    self.pause(self.began.elapsed() + pause).await.ok()?;
                }
                Standing::Gone => return None,
            }
        }
        let result = match self.show {
            Show::Path { timeline, .. } => self.next_of_path(timeline).await,
            Show::View { least } => self.next_of_view(least).await,
        };
        match result {
            Ok(frame) => {
                self.sent(&frame);
                Some(frame)
            }
            Err(End::Over) => None,
            Err(End::Failed(error)) => {
                tracing::warn!(scene = self.request.scene, %error, "a playback failed");
                None
            }
        }
    }

    async fn next_of_path(&mut self, timeline: Timeline) -> Result<Arc<EncodedFrame>, End> {
        loop {
            match timeline.next(self.shown, self.began.elapsed()) {
                Next::End => return Err(End::Over),
                Next::WaitUntil(due) => self.pause(due).await?,
                Next::Draw(tick) => {
                    let (tick, frame) = self.draw(tick, Some(timeline)).await?;
                    self.shown = tick;
                    return Ok(frame);
                }
            }
        }
    }

    /// Waits until `due` after the beginning.
    async fn pause(&mut self, due: Duration) -> Result<(), End> {
        let Some(until) = self.began.checked_add(due) else { return Err(End::Over) };
        tokio::select! {
            _ = self.draining.wait_for(|draining| *draining) => Err(End::Over),
            () = tokio::time::sleep_until(until.into()) => Ok(()),
        }
    }

    async fn next_of_view(&mut self, least: Duration) -> Result<Arc<EncodedFrame>, End> {
        let shown_at = Instant::now();
        loop {
            let mark = self.app.engine.scene_mark(&self.request.scene);
            if mark.is_none() {
                return Err(End::Over);
            }
            if mark != self.mark {
                self.mark = mark;
                let due = shown_at.saturating_duration_since(self.began) + least;
                self.pause(due).await?;
                let (_, frame) = self.draw(0, None).await?;
                self.shown += 1;
                return Ok(frame);
            }
            tokio::select! {
                biased;
                _ = self.draining.wait_for(|draining| *draining) => return Err(End::Over),
                _ = self.changes.changed() => {}
                () = tokio::time::sleep_until((shown_at + REPEAT).into()) => {
                    if let Some(last) = &self.last {
                        return Ok(last.clone());
                    }
                }
            }
        }
    }

    /// Draws a tick, or a later one if that becomes due while the request waits at the engine.
    async fn draw(
        &mut self,
        mut tick: u64,
        timeline: Option<Timeline>,
    ) -> Result<(u64, Arc<EncodedFrame>), End> {
        let mut ticket = self.ask(tick).await?;
        let mut late_at = Instant::now() + self.app.settings.frame_timeout;
        loop {
            let next = timeline.map(|timeline| timeline.next(tick, self.began.elapsed()));
            if let Some(Next::Draw(newer)) = next
                && self.slot.has_replaceable()
                && let Some(newer_ticket) = replaced(self.replace(newer))?
            {
                (ticket, tick) = (newer_ticket, newer);
            }
            let due = match next {
                Some(Next::WaitUntil(due)) => self.began.checked_add(due),
                // The engine already draws the old request; the newer one follows.
                _ => None,
            };
            let wake_at = due.map_or(late_at, |due| due.min(late_at));
            let reply = tokio::select! {
                biased;
                _ = self.draining.wait_for(|draining| *draining) => return Err(End::Over),
                reply = &mut ticket => Some(reply),
                () = tokio::time::sleep_until(wake_at.into()) => None,
            };
            match reply {
                Some(Ok(frame)) => return Ok((tick, frame)),
                Some(Err(error)) => {
                    self.recover(error).await?;
                    ticket = self.ask(tick).await?;
                }
                None if Instant::now() >= late_at => {
                    // Dropping a ticket cancels its waiting request.
                    ticket = self.ask(tick).await?;
                    late_at = Instant::now() + self.app.settings.frame_timeout;
                }
                None => {}
            }
        }
    }

    /// Has the request of a newer tick take the place of the one that waits; `None` where that one is drawn instead.
    fn replace(&mut self, newer: u64) -> Result<Option<FrameTicket>, EngineError> {
        let Resolution::Ready(frame) = self.app.engine.resolve(self.wanted(newer))? else {
            return Ok(None);
        };
        if self.app.check_caps(&self.caps, &frame).is_err() {
            return Ok(None);
        }
        let name = self.name_of(newer);
        self.slot.replace(name, &frame)
    }

    /// Queues a tick's request; waits for a place in the queue and for baking.
    async fn ask(&mut self, tick: u64) -> Result<FrameTicket, End> {
        loop {
            let frame = match self.app.engine.resolve(self.wanted(tick)) {
                Ok(Resolution::Ready(frame)) => frame,
                Ok(Resolution::NeedsBake(unbaked)) => tokio::select! {
                    _ = self.draining.wait_for(|draining| *draining) => return Err(End::Over),
                    baked = unbaked.bake() => match baked {
                        Ok(frame) => frame,
                        Err(EngineError::UnknownScene { .. }) => return Err(End::Over),
                        Err(error) => return Err(End::Failed(error)),
                    },
                },
                Err(error) => {
                    self.recover(error).await?;
                    continue;
                }
            };
            if self.app.check_caps(&self.caps, &frame).is_err() {
                return Err(End::Over);
            }
            match self.slot.ask(self.name_of(tick), frame) {
                Ok(ticket) => return Ok(ticket),
                Err(error) => self.recover(error).await?,
            }
        }
    }

    /// Handles an error by waiting, where waiting helps.
    async fn recover(&mut self, error: EngineError) -> Result<(), End> {
        const LEAST_PAUSE: Duration = Duration::from_millis(5);
        match error {
            EngineError::Busy { retry_after } | EngineError::DeviceLost { retry_after } => {
                let pause = retry_after.clamp(LEAST_PAUSE, Duration::from_secs(1));
                self.pause(self.began.elapsed() + pause).await
            }
            EngineError::UnknownScene { .. } | EngineError::ShuttingDown => Err(End::Over),
            error => Err(End::Failed(error)),
        }
    }
}

/// Decides what follows from an attempt to replace a request. Where it failed for a while, as when the device is lost, the old request
/// still waits and is drawn.
fn replaced(attempt: Result<Option<FrameTicket>, EngineError>) -> Result<Option<FrameTicket>, End> {
    match attempt {
        Ok(ticket) => Ok(ticket),
        Err(EngineError::Busy { .. } | EngineError::DeviceLost { .. }) => Ok(None),
        Err(EngineError::UnknownScene { .. } | EngineError::ShuttingDown) => Err(End::Over),
        Err(error) => Err(End::Failed(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_device_ends_no_film() {
        let retry_after = Duration::from_secs(1);
        for passing in [EngineError::DeviceLost { retry_after }, EngineError::Busy { retry_after }]
        {
            assert!(matches!(replaced(Err(passing)), Ok(None)));
        }
        let unknown = EngineError::UnknownScene { id: "town".to_owned() };
        assert!(matches!(replaced(Err(unknown)), Err(End::Over)));
        assert!(matches!(replaced(Err(EngineError::ShuttingDown)), Err(End::Over)));
        let failed = EngineError::Internal("no".to_owned());
        assert!(matches!(replaced(Err(failed)), Err(End::Failed(_))));
    }
}
