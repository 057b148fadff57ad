//! The task of one stream, which handles events from its client, the engine and the clock in turn.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{Message, WebSocket};
use futures::StreamExt;
use futures::stream::SplitStream;
use tokio::sync::watch;

use super::allowance::Allowance;
use super::moving::{Made, Plan, Wanted, still_request, wanted};
use super::pacing::Pacer;
use super::places::Place;
use super::pose_schedule::PoseSchedule;
use super::preparation::Preparation;
use super::send_queue::SendQueue;
use super::wire::{Close, Event, FrameHeader, Incoming, MAX_MESSAGE_BYTES, PoseMessage, Quality};
use crate::engine::{
    BakeTicket, Client, EncodedFrame, EngineError, FrameTicket, LatestSlot, RequestId, Resolution,
    ResolvedFrame, SceneMark,
};
use crate::http::access::signed::Caps;
use crate::http::limits::{LONGEST_PAUSE, Standing};
use crate::http::params::FrameParams;
use crate::http::problem::{Kind, Problem};
use crate::http::{App, Caller};
use crate::plan::planner::Moving;

/// Largest number of outstanding frames: one being drawn, one waiting.
const MOST_ASKED: usize = 2;
/// Largest number of messages that are read before other events get a turn.
const MOST_IN_A_ROW: usize = 64;

pub struct Session {
    app: Arc<App>,
    id: String,
    /// Name of the connection.
    name: RequestId,
    client: Client,
    caps: Caps,
    mark: Option<SceneMark>,
    source: SplitStream<WebSocket>,
    send_queue: SendQueue,
    slot: LatestSlot,
    /// Values of parameters that a pose leaves out.
    settings: FrameParams,
    schedule: PoseSchedule<FrameParams>,
    pacer: Pacer,
    asked: VecDeque<Asked>,
    frames: u64,
    baking: Option<BakeTicket>,
    /// The bake that planned frames of the moving pose need; others are drawn meanwhile, and after it has failed.
    preparing: Preparation<BakeTicket, Option<SceneMark>>,
    /// Setting that the last planned frame was drawn with.
    held: Option<String>,
    /// Whether moving frames of this pose may be planned: none was refused.
    may_plan: bool,
    /// The engine accepts nothing before this time.
    retry_at: Option<Instant>,
    heard_at: Instant,
    allowance: Allowance,
    messages_in_a_row: usize,
    /// Whether the client was told that acknowledgements are missing.
    has_reminded: bool,
    changes: watch::Receiver<u64>,
    draining: watch::Receiver<bool>,
    counted_overtaken: u64,
}

/// A frame that the engine has promised.
struct Asked {
    ticket: FrameTicket,
    seq: u64,
    quality: Quality,
    scale: f64,
    made: Made,
    at: Instant,
}

/// An event that a session waits for.
enum Happening {
    Message(Option<Result<Message, axum::Error>>),
    Frame(Result<Arc<EncodedFrame>, EngineError>),
    Baked(Result<(), EngineError>),
    ScenesChanged,
    Draining,
    WriterEnded,
    /// A timer has fired, or the send queue has room again.
    Turn,
}

/// How a stream ends.
enum End {
    /// The server closes it with a code.
    Close(Close),
    /// The server closes it with a code, and incoming messages cannot be read any more.
    CloseUnread(Close),
    /// The client has closed it.
    Closed,
    /// The connection is gone.
    Gone,
}

impl Session {
    pub fn start(
        app: Arc<App>,
        id: String,
        name: RequestId,
        Caller(client, caps): Caller,
        socket: WebSocket,
    ) -> Self {
        let (sink, source) = socket.split();
        Self {
            mark: None,
            source,
            send_queue: SendQueue::start(sink),
            slot: app.engine.latest_slot(client),
            settings: FrameParams::default(),
            schedule: PoseSchedule::new(),
            pacer: Pacer::new(),
            asked: VecDeque::new(),
            frames: 0,
            baking: None,
            preparing: Preparation::Idle,
            held: None,
            may_plan: true,
            retry_at: None,
            heard_at: Instant::now(),
            allowance: Allowance::new(Instant::now()),
            messages_in_a_row: 0,
            has_reminded: false,
            changes: app.engine.changes(),
            draining: app.streams.draining(),
            counted_overtaken: 0,
            app,
            id,
            name,
            client,
            caps,
        }
    }

    /// Runs until either side ends the stream; `first`, if given, is the first pose.
    pub async fn run(mut self, first: Option<FrameParams>, place: Place) {
        let end = match self.begin(first) {
            Ok(()) => self.serve().await,
            Err(end) => end,
        };
        self.count_overtaken();
        let Session { send_queue, source, slot, asked, baking, preparing, .. } = self;
        // This cancels waiting requests before the wait for the close.
        drop((asked, slot, baking, preparing));
        match end {
            End::Close(close) => send_queue.close(close, source).await,
            End::CloseUnread(close) => send_queue.close_unread(close, source).await,
            End::Closed | End::Gone => send_queue.closed(source).await,
        }
        drop(place);
    }

    fn begin(&mut self, first: Option<FrameParams>) -> Result<(), End> {
        self.look_at_scene()?;
        if let Some(params) = first {
            self.pose(PoseMessage { seq: 0, moving: None, reset: false, params })?;
        }
        Ok(())
    }

    async fn serve(&mut self) -> End {
        loop {
            let stepped = match self.ask() {
                Ok(()) => {
                    let happening = self.next().await;
                    self.handle(happening)
                }
                Err(end) => Err(end),
            };
            self.count_overtaken();
            if let Err(end) = stepped {
                return end;
            }
        }
    }

    /// Waits for the next event.
    async fn next(&mut self) -> Happening {
        let deadline = self.wake_at(Instant::now());
        let may_read = self.send_queue.may_read();
        let front = async {
            match self.asked.front_mut() {
                Some(asked) => (&mut asked.ticket).await,
                None => std::future::pending().await,
            }
        };
        let baked = async {
            match &mut self.baking {
                Some(baking) => baking.await,
                None => std::future::pending().await,
            }
        };
        let message = async {
            match may_read {
                true => Happening::Message(self.source.next().await),
                false => std::future::pending().await,
            }
        };
        let other = async {
            tokio::select! {
                biased;
                _ = self.draining.wait_for(|draining| *draining) => Happening::Draining,
                _ = self.changes.changed() => Happening::ScenesChanged,
                frame = front => Happening::Frame(frame),
                result = baked => Happening::Baked(result),
                () = self.send_queue.ended() => Happening::WriterEnded,
                () = tokio::time::sleep_until(deadline.into()) => Happening::Turn,
                () = self.send_queue.room(), if !may_read => Happening::Turn,
            }
        };
        // Messages go before frames, because a pose that has arrived is newer than a finished frame. The limit makes sure that a
        // client that sends without a pause still gets its frames, and that its timers run.
        let happening = if self.messages_in_a_row < MOST_IN_A_ROW {
            tokio::select! { biased; happening = message => happening, happening = other => happening }
        } else {
            tokio::select! { biased; happening = other => happening, happening = message => happening }
        };
        self.messages_in_a_row = match happening {
            Happening::Message(_) => self.messages_in_a_row + 1,
            _ => 0,
        };
        happening
    }

    /// Returns the time of the next timer.
    fn wake_at(&self, now: Instant) -> Instant {
        let idle = self.heard_at + self.app.rules().bounds.streams.idle;
        let late = self.asked.front().map(|asked| asked.at + self.app.settings.frame_timeout);
        let retry = self.retry_at.filter(|_| self.schedule.wanted(now).is_some());
        let reminder = self.reminder(now).map(|(_, at)| at);
        let timers = [self.schedule.wake_at(now), late, retry, reminder];
        timers.into_iter().flatten().fold(idle, Instant::min)
    }

    /// Returns the frame whose acknowledgement is missing, and when the client is reminded of it.
    fn reminder(&self, now: Instant) -> Option<(u64, Instant)> {
        let waits = !self.has_reminded
            && self.asked.is_empty()
            && self.baking.is_none()
            && self.schedule.wanted(now).is_some()
            && !self.pacer.may_ask(0);
        if waits { self.pacer.unacknowledged() } else { None }
    }

    fn handle(&mut self, happening: Happening) -> Result<(), End> {
        match happening {
            Happening::Message(None) | Happening::WriterEnded => Err(End::Gone),
            Happening::Message(Some(Err(error))) => {
                Err(Close::of_fault(error).map_or(End::Gone, End::CloseUnread))
            }
            Happening::Message(Some(Ok(message))) => self.message(message),
            Happening::Frame(reply) => self.frame(reply),
            Happening::Baked(result) => {
                self.baking = None;
                result.map_or_else(|error| self.failed(None, error), Ok)
            }
            Happening::ScenesChanged => self.look_at_scene(),
            Happening::Draining => Err(End::Close(Close::GoingAway)),
            Happening::Turn => self.turn(Instant::now()),
        }
    }

    fn turn(&mut self, now: Instant) -> Result<(), End> {
        if self.retry_at.is_some_and(|at| at <= now) {
            self.retry_at = None;
        }
        let limit = self.app.settings.frame_timeout;
        if self.asked.front().is_some_and(|asked| asked.at + limit <= now) {
            let seq = self.asked.pop_front().map(|asked| asked.seq);
            let text = format!("no frame within {} seconds", limit.as_secs());
            self.tell(&Event::Problem { seq, problem: Problem::new(Kind::FrameTimeout, text) })?;
        }
        if let Some((frame, _)) = self.reminder(now).filter(|(_, at)| *at <= now) {
            self.has_reminded = true;
            let reason =
                format!("missing: the next frame waits until frame {frame} is acknowledged");
            let accepted =
                format!("{{\"ack\": {frame}}} once it is decoded, and so of every frame");
            let problem = Problem::parameter("ack", reason, accepted);
            self.tell(&Event::Problem { seq: None, problem })?;
        }
        if now >= self.heard_at + self.app.rules().bounds.streams.idle {
            return Err(End::Close(Close::Idle));
        }
        Ok(())
    }

    fn message(&mut self, message: Message) -> Result<(), End> {
        let now = Instant::now();
        if !self.allowance.take(now) {
            // The close reads on briefly and discards what arrives: a client that is blocked in sending would never see the
            // reason.
            return Err(End::Close(Close::Flood));
        }
        // A pong comes from the client's library and does not show that the client itself is alive.
        if !matches!(message, Message::Pong(_)) {
            self.heard_at = now;
        }
        let text = match message {
            Message::Text(text) if text.len() > MAX_MESSAGE_BYTES => {
                return Err(End::Close(Close::TooLarge));
            }
            Message::Text(text) => text,
            Message::Binary(_) => return Err(End::Close(Close::NotText)),
            Message::Close(_) => return Err(End::Closed),
            Message::Pong(_) => {
                self.pacer.ponged(now);
                return Ok(());
            }
            Message::Ping(_) => return Ok(()),
        };
        match Incoming::read(&text) {
            Ok(incoming) => self.incoming(incoming),
            Err(problem) => self.tell(&Event::Problem { seq: None, problem }),
        }
    }

    fn incoming(&mut self, incoming: Incoming) -> Result<(), End> {
        if let Some(number) = incoming.ack
            && let Err(last) = self.pacer.acked(number, Instant::now())
        {
            let problem =
                Problem::parameter("ack", "no such frame was sent", format!("at most {last}"));
            self.tell(&Event::Problem { seq: None, problem })?;
        }
        if let Some(ping) = incoming.ping {
            self.tell(&Event::Pong { ping })?;
        }
        incoming.pose.map_or(Ok(()), |pose| self.pose(pose))
    }

    /// Accepts a pose, or reports what is wrong with it and changes nothing.
    fn pose(&mut self, message: PoseMessage) -> Result<(), End> {
        let PoseMessage { seq, moving, reset, params } = message;
        let params = if reset { params } else { params.or(&self.settings) };
        let checked = still_request(&self.id, &params)
            .and_then(|request| self.app.engine.check(&request).map_err(Problem::from));
        match checked {
            // The session is about to be told that the scene is gone.
            Err(problem) if problem.kind == Kind::UnknownScene => Ok(()),
            Err(problem) => self.tell(&Event::Problem { seq: Some(seq), problem }),
            Ok(()) => {
                self.settings = params.clone();
                self.may_plan = true;
                self.schedule.set(seq, params, moving, Instant::now());
                Ok(())
            }
        }
    }

    /// Requests the wanted frame if there is room, in place of a request that still waits.
    fn ask(&mut self) -> Result<(), End> {
        let now = Instant::now();
        let standing = self.app.standing(self.client, &self.caps);
        if standing == Standing::Gone {
            return Err(End::Close(Close::NotAllowed));
        }
        if self.baking.is_some() || self.retry_at.is_some_and(|at| at > now) {
            return Ok(());
        }
        let Some((seq, params, quality)) = self.schedule.wanted(now) else { return Ok(()) };
        if let Standing::Spent(wait) = standing {
            self.retry_at = Some(now + wait.min(LONGEST_PAUSE));
            return Ok(());
        }
        if !self.has_replaceable() && !self.has_room() {
            return Ok(());
        }
        self.preparing.update(self.mark, |bake| Some(bake.outcome()?.is_ok()));
        let Wanted { request, quality, scale, planned } = match self.wanted(params, quality) {
            Ok(wanted) => wanted,
            Err(problem) => {
                self.schedule.give_up();
                return self.tell(&Event::Problem { seq: Some(seq), problem });
            }
        };
        let is_planned = planned.is_some();
        let resolved = self.app.engine.resolve_planned(request, planned);
        let resolved = resolved.and_then(|resolution| match resolution {
            Resolution::Ready(frame) => Ok(Some(frame)),
            Resolution::NeedsBake(unbaked) => {
                match is_planned {
                    // While the bake runs, the frame is drawn with settings that need none.
                    true if self.preparing.is_idle() => {
                        let bake = unbaked.begin()?;
                        self.preparing = Preparation::Baking { bake, mark: self.mark };
                    }
                    true => self.may_plan = false,
                    false => self.baking = Some(unbaked.begin()?),
                }
                Ok(None)
            }
        });
        let frame = match resolved {
            Ok(Some(frame)) => frame,
            Ok(None) if is_planned => return self.ask(),
            Ok(None) => return Ok(()),
            Err(_) if is_planned => return self.ask_unplanned(),
            Err(error) => return self.failed(Some(seq), error),
        };
        if let Err(problem) = self.app.check_caps(&self.caps, &frame) {
            if is_planned {
                return self.ask_unplanned();
            }
            self.schedule.give_up();
            return self.tell(&Event::Problem { seq: Some(seq), problem });
        }
        let made = Made::of(&frame.request);
        let ticket = match self.place(frame) {
            Ok(Some(ticket)) => ticket,
            Ok(None) => return Ok(()),
            Err(error) => return self.failed(Some(seq), error),
        };
        self.schedule.asked(quality);
        self.asked.push_back(Asked { ticket, seq, quality, scale, made, at: now });
        Ok(())
    }

    /// Requests the frame without the planner, whose choice was refused.
    fn ask_unplanned(&mut self) -> Result<(), End> {
        self.may_plan = false;
        self.ask()
    }

    /// Builds a frame of the given quality, planned where the scene was measured.
    fn wanted(&self, params: &FrameParams, quality: Quality) -> Result<Wanted, Problem> {
        let plan: Plan<'_> = &|request, still, scales| {
            let moving = Moving { scales, held: self.held.as_deref(), still };
            // The frame that is not planned reports the errors of the request.
            self.app.engine.plan_moving(request, &moving, !self.preparing.is_idle()).ok()?
        };
        let is_measured = || matches!(self.app.engine.planner_size(&self.id), Ok(Some(_)));
        let may_plan = quality == Quality::Moving && self.may_plan && is_measured();
        wanted(&self.id, params, quality, self.pacer.pace(), may_plan.then_some(plan))
    }

    /// Returns whether a request would replace one that still waits.
    fn has_replaceable(&self) -> bool {
        !self.asked.is_empty() && self.slot.has_replaceable()
    }

    /// Returns whether another frame may be under way.
    fn has_room(&self) -> bool {
        let asked = self.asked.len();
        asked < MOST_ASKED
            && self.pacer.may_ask(asked)
            && self.send_queue.has_room_for_frames(asked + 1)
    }

    /// Queues a frame; returns `None` when it has to wait for frames or acknowledgements.
    fn place(&mut self, frame: Arc<ResolvedFrame>) -> Result<Option<FrameTicket>, EngineError> {
        let number = self.frames + self.asked.len() as u64;
        if !self.asked.is_empty()
            && let Some(ticket) = self.slot.replace(self.name.part(number), &frame)?
        {
            if let Some(old) = self.asked.pop_back() {
                self.schedule.replaced(old.seq);
            }
            return Ok(Some(ticket));
        }
        if !self.has_room() {
            return Ok(None);
        }
        self.slot.ask(self.name.part(number + 1), frame).map(Some)
    }

    /// Sends a frame that the engine has finished.
    fn frame(&mut self, reply: Result<Arc<EncodedFrame>, EngineError>) -> Result<(), End> {
        let Some(asked) = self.asked.pop_front() else { return Ok(()) };
        let frame = match reply {
            Ok(frame) => frame,
            Err(error) => return self.failed(Some(asked.seq), error),
        };
        let now = Instant::now();
        let share = (asked.quality == Quality::Moving).then_some(asked.scale * asked.scale);
        let planned = frame.receipt.planned.as_ref().and_then(|plan| plan.chosen.as_ref());
        let planned = planned.filter(|_| share.is_some());
        // A frame that another client had asked for took less time.
        let predicted_ms = planned.map(|chosen| chosen.ms).filter(|_| !frame.receipt.coalesced);
        self.pacer.drawn(asked.at, now, share, predicted_ms);
        self.held = planned.map(|chosen| chosen.setting.clone());
        self.frames += 1;
        let camera = &frame.receipt.camera;
        let header = FrameHeader {
            frame: self.frames,
            seq: asked.seq,
            revision: frame.receipt.revision,
            quality: asked.quality,
            scale: asked.scale,
            format: asked.made.format,
            jpeg_quality: asked.made.jpeg_quality,
            accepted_px: asked.made.accepted_px,
            width: camera.width,
            height: camera.height,
            content_type: frame.content_type,
            bytes: frame.bytes.len(),
            overtaken: self.schedule.overtaken(),
            receipt: &frame.receipt,
        };
        tracing::debug!(
            request_id = frame.receipt.request_id,
            frame = self.frames,
            seq = asked.seq,
            "frame sent",
        );
        let message = header.message(&frame.bytes);
        if self.pacer.ping(now) {
            self.push(Message::Ping(axum::body::Bytes::new()))?;
        }
        self.pacer.sent(self.frames, frame.bytes.len() as u64, now, share);
        self.app.metrics.frame(&frame);
        self.app.metrics.stream_frames.inc();
        self.push(message)
    }

    /// Handles an error of the engine.
    fn failed(&mut self, seq: Option<u64>, error: EngineError) -> Result<(), End> {
        const LEAST_PAUSE: Duration = Duration::from_millis(5);
        match error {
            EngineError::Busy { retry_after } | EngineError::DeviceLost { retry_after } => {
                let pause = retry_after.clamp(LEAST_PAUSE, Duration::from_secs(1));
                self.retry_at = Some(Instant::now() + pause);
                // This also applies when the device was lost with a frame in flight.
                self.schedule.again();
                Ok(())
            }
            EngineError::ShuttingDown => Err(End::Close(Close::GoingAway)),
            EngineError::UnknownScene { .. } => self.look_at_scene(),
            EngineError::Overtaken => Ok(()),
            error => {
                self.schedule.give_up();
                self.tell(&Event::Problem { seq, problem: error.into() })?;
                match self.app.engine.readiness() {
                    crate::engine::Readiness::Failed => Err(End::Close(Close::Failed)),
                    _ => Ok(()),
                }
            }
        }
    }

    /// Reports a changed scene and has the pose drawn again.
    fn look_at_scene(&mut self) -> Result<(), End> {
        let mark = self.app.engine.scene_mark(&self.id);
        if mark == self.mark && mark.is_some() {
            return Ok(());
        }
        self.mark = mark;
        self.held = None;
        let scene = self.id.clone();
        let Some(SceneMark { revision, .. }) = mark else {
            self.tell(&Event::Deleted { scene: &scene })?;
            return Err(End::Close(Close::Deleted));
        };
        self.schedule.again();
        self.tell(&Event::Scene { scene: &scene, revision })
    }

    fn tell(&mut self, event: &Event<'_>) -> Result<(), End> {
        self.push(event.message())
    }

    fn push(&mut self, message: Message) -> Result<(), End> {
        if self.send_queue.push(message) { Ok(()) } else { Err(End::Gone) }
    }

    fn count_overtaken(&mut self) {
        let overtaken = self.schedule.overtaken();
        self.app.metrics.poses_overtaken.inc_by(overtaken - self.counted_overtaken);
        self.counted_overtaken = overtaken;
    }
}
