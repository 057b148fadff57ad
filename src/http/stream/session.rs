//! One stream's task: what comes from its client, from the engine and from the clock, one after the other.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{Message, WebSocket};
use futures::StreamExt;
use futures::stream::SplitStream;
use tokio::sync::watch;

use super::course::Course;
use super::outbox::Outbox;
use super::pacing::Pacer;
use super::places::Place;
use super::wire::{Close, Event, FrameHeader, Incoming, MAX_MESSAGE_BYTES, PoseMessage, Quality};
use crate::encode::ImageFormat;
use crate::engine::{
    BakeTicket, Client, EncodedFrame, EngineError, FrameRequest, FrameTicket, RequestId, SceneMark,
    Seat,
};
use crate::http::App;
use crate::http::params::FrameParams;
use crate::http::problem::{Kind, Problem};
use crate::plan::Output;

/// Frames asked for and not come: one being drawn, one waiting.
const MOST_ASKED: usize = 2;
/// No side of a moving frame is made shorter than this.
const LEAST_SIDE: u32 = 64;

pub struct Session {
    app: Arc<App>,
    id: String,
    /// What the connection is called.
    name: RequestId,
    mark: Option<SceneMark>,
    source: SplitStream<WebSocket>,
    outbox: Outbox,
    seat: Seat,
    /// What a pose leaves out.
    settings: FrameParams,
    course: Course<FrameParams>,
    pacer: Pacer,
    asked: VecDeque<Asked>,
    frames: u64,
    baking: Option<BakeTicket>,
    /// The engine takes nothing before.
    retry_at: Option<Instant>,
    heard_at: Instant,
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
    format: ImageFormat,
    jpeg_quality: Option<u8>,
    at: Instant,
}

/// What a session waits for.
enum Happening {
    Message(Option<Result<Message, axum::Error>>),
    Frame(Result<Arc<EncodedFrame>, EngineError>),
    Baked(Result<(), EngineError>),
    ScenesChanged,
    Draining,
    WriterEnded,
    /// A timer, or room where there was none.
    Turn,
}

/// How a stream ends.
enum End {
    /// By the server, with a code.
    Close(Close),
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
        client: Client,
        socket: WebSocket,
    ) -> Self {
        let (sink, source) = socket.split();
        Self {
            mark: None,
            source,
            outbox: Outbox::start(sink),
            seat: app.engine.seat(client),
            settings: FrameParams::default(),
            course: Course::new(),
            pacer: Pacer::new(),
            asked: VecDeque::new(),
            frames: 0,
            baking: None,
            retry_at: None,
            heard_at: Instant::now(),
            changes: app.engine.changes(),
            draining: app.streams.draining(),
            counted_overtaken: 0,
            app,
            id,
            name,
        }
    }

    /// Runs until either side ends it, with `first` for a pose if it is given.
    pub async fn run(mut self, first: Option<FrameParams>, place: Place) {
        let end = match self.begin(first) {
            Ok(()) => self.serve().await,
            Err(end) => end,
        };
        self.count_overtaken();
        let Session { outbox, source, seat, asked, baking, .. } = self;
        // Cancels what waits, before the close is waited for.
        drop((asked, seat, baking));
        match end {
            End::Close(close) => outbox.close(close, source).await,
            End::Closed | End::Gone => outbox.closed(source).await,
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

    /// Waits for the next thing to happen.
    async fn next(&mut self) -> Happening {
        let deadline = self.wake_at(Instant::now());
        let may_read = self.outbox.may_read();
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
        // Messages before frames: a pose that has come already is newer than what is finished.
        tokio::select! {
            biased;
            _ = self.draining.wait_for(|draining| *draining) => Happening::Draining,
            _ = self.changes.changed() => Happening::ScenesChanged,
            message = self.source.next(), if may_read => Happening::Message(message),
            frame = front => Happening::Frame(frame),
            result = baked => Happening::Baked(result),
            () = self.outbox.ended() => Happening::WriterEnded,
            () = tokio::time::sleep_until(deadline.into()) => Happening::Turn,
            () = self.outbox.room(), if !may_read => Happening::Turn,
        }
    }

    /// When something is due though nothing happens.
    fn wake_at(&self, now: Instant) -> Instant {
        let idle = self.heard_at + self.app.settings.streams.idle;
        let late = self.asked.front().map(|asked| asked.at + self.app.settings.frame_timeout);
        let retry = self.retry_at.filter(|_| self.course.wanted(now).is_some());
        [self.course.wake_at(now), late, retry].into_iter().flatten().fold(idle, Instant::min)
    }

    fn handle(&mut self, happening: Happening) -> Result<(), End> {
        match happening {
            Happening::Message(None | Some(Err(_))) | Happening::WriterEnded => Err(End::Gone),
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
        if now >= self.heard_at + self.app.settings.streams.idle {
            return Err(End::Close(Close::Idle));
        }
        Ok(())
    }

    fn message(&mut self, message: Message) -> Result<(), End> {
        // An answer to a ping says that the client's library is there, which is not the client.
        if !matches!(message, Message::Pong(_)) {
            self.heard_at = Instant::now();
        }
        let text = match message {
            Message::Text(text) if text.len() > MAX_MESSAGE_BYTES => {
                return Err(End::Close(Close::TooLarge));
            }
            Message::Text(text) => text,
            Message::Binary(_) => return Err(End::Close(Close::NotText)),
            Message::Close(_) => return Err(End::Closed),
            Message::Pong(_) => {
                self.pacer.ponged(Instant::now());
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

    /// Takes a pose, or says what is wrong with it and leaves all as it is.
    fn pose(&mut self, message: PoseMessage) -> Result<(), End> {
        let PoseMessage { seq, moving, reset, params } = message;
        let params = if reset { params } else { params.or(&self.settings) };
        let checked = still_request(&self.id, &params).and_then(|request| {
            // What has to be baked is looked at when it has been.
            if !self.app.engine.must_bake(&request) {
                self.app.engine.etag(&request)?;
            }
            Ok(())
        });
        match checked {
            // Of a scene that is gone the session is about to hear.
            Err(problem) if problem.kind == Kind::UnknownScene => Ok(()),
            Err(problem) => self.tell(&Event::Problem { seq: Some(seq), problem }),
            Ok(()) => {
                self.settings = params.clone();
                self.course.set(seq, params, moving, Instant::now());
                Ok(())
            }
        }
    }

    /// Asks the engine for what is wanted, in place of what waits there, if there is room for it.
    fn ask(&mut self) -> Result<(), End> {
        let now = Instant::now();
        if self.baking.is_some() || self.retry_at.is_some_and(|at| at > now) {
            return Ok(());
        }
        let Some((seq, params, quality)) = self.course.wanted(now) else { return Ok(()) };
        let Wanted { request, quality, scale } = match wanted(
            &self.id,
            params,
            quality,
            self.pacer.scale(),
            self.pacer.jpeg_quality(),
        ) {
            Ok(wanted) => wanted,
            Err(problem) => {
                self.course.give_up();
                return self.tell(&Event::Problem { seq: Some(seq), problem });
            }
        };
        match self.app.engine.begin_bake(&request) {
            Ok(None) => {}
            Ok(baking) => {
                self.baking = baking;
                return Ok(());
            }
            Err(error) => return self.failed(Some(seq), error),
        }
        let (format, jpeg_quality) = (request.format, jpeg_quality(&request));
        let ticket = match self.place(request) {
            Ok(Some(ticket)) => ticket,
            Ok(None) => return Ok(()),
            Err(error) => return self.failed(Some(seq), error),
        };
        self.course.asked(quality);
        self.asked.push_back(Asked { ticket, seq, quality, scale, format, jpeg_quality, at: now });
        Ok(())
    }

    /// Queues a request; `None` when that has to wait for frames or acknowledgements.
    fn place(&mut self, request: FrameRequest) -> Result<Option<FrameTicket>, EngineError> {
        let number = self.frames + self.asked.len() as u64;
        if !self.asked.is_empty()
            && let Some(ticket) = self.seat.replace_as(self.name.part(number), request.clone())?
        {
            if let Some(old) = self.asked.pop_back() {
                self.course.replaced(old.seq);
            }
            return Ok(Some(ticket));
        }
        let asked = self.asked.len();
        let has_room = asked < MOST_ASKED
            && self.pacer.may_ask(asked)
            && self.outbox.has_room_for_frames(asked + 1);
        if !has_room {
            return Ok(None);
        }
        self.seat.ask_as(self.name.part(number + 1), request).map(Some)
    }

    /// Sends what the engine has finished.
    fn frame(&mut self, reply: Result<Arc<EncodedFrame>, EngineError>) -> Result<(), End> {
        let Some(asked) = self.asked.pop_front() else { return Ok(()) };
        let frame = match reply {
            Ok(frame) => frame,
            Err(error) => return self.failed(Some(asked.seq), error),
        };
        let now = Instant::now();
        let share = (asked.quality == Quality::Moving).then_some(asked.scale * asked.scale);
        self.pacer.drawn(asked.at, now, share);
        self.frames += 1;
        let camera = &frame.receipt.camera;
        let header = FrameHeader {
            frame: self.frames,
            seq: asked.seq,
            revision: frame.receipt.revision,
            quality: asked.quality,
            scale: asked.scale,
            format: asked.format,
            jpeg_quality: asked.jpeg_quality,
            width: camera.width,
            height: camera.height,
            content_type: frame.content_type,
            bytes: frame.bytes.len(),
            overtaken: self.course.overtaken(),
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

    /// What an error of the engine means for the stream.
    fn failed(&mut self, seq: Option<u64>, error: EngineError) -> Result<(), End> {
        const LEAST_PAUSE: Duration = Duration::from_millis(5);
        match error {
            EngineError::Busy { retry_after } | EngineError::DeviceLost { retry_after } => {
                let pause = retry_after.clamp(LEAST_PAUSE, Duration::from_secs(1));
                self.retry_at = Some(Instant::now() + pause);
                // Also where it was lost with a frame of it under way.
                self.course.again();
                Ok(())
            }
            EngineError::ShuttingDown => Err(End::Close(Close::GoingAway)),
            EngineError::UnknownScene { .. } => self.look_at_scene(),
            EngineError::Overtaken => Ok(()),
            error => {
                self.course.give_up();
                self.tell(&Event::Problem { seq, problem: error.into() })?;
                match self.app.engine.readiness() {
                    crate::engine::Readiness::Failed => Err(End::Close(Close::Failed)),
                    _ => Ok(()),
                }
            }
        }
    }

    /// Tells of a scene that is not what it was, and has the pose drawn again.
    fn look_at_scene(&mut self) -> Result<(), End> {
        let mark = self.app.engine.scene_mark(&self.id);
        if mark == self.mark && mark.is_some() {
            return Ok(());
        }
        self.mark = mark;
        let scene = self.id.clone();
        let Some(SceneMark { revision, .. }) = mark else {
            self.tell(&Event::Deleted { scene: &scene })?;
            return Err(End::Close(Close::Deleted));
        };
        self.course.again();
        self.tell(&Event::Scene { scene: &scene, revision })
    }

    fn tell(&mut self, event: &Event<'_>) -> Result<(), End> {
        self.push(event.message())
    }

    fn push(&mut self, message: Message) -> Result<(), End> {
        if self.outbox.push(message) { Ok(()) } else { Err(End::Gone) }
    }

    fn count_overtaken(&mut self) {
        let overtaken = self.course.overtaken();
        self.app.metrics.poses_overtaken.inc_by(overtaken - self.counted_overtaken);
        self.counted_overtaken = overtaken;
    }
}

/// A frame as it will be asked for.
struct Wanted {
    request: FrameRequest,
    quality: Quality,
    scale: f64,
}

/// The frame that a pose asks for. Colours come as JPEG where no format is given.
fn still_request(id: &str, params: &FrameParams) -> Result<FrameRequest, Problem> {
    let format = match (params.format()?, params.output()?) {
        (Some(format), _) => format,
        (None, Output::Color) => ImageFormat::Jpeg,
        (None, _) => ImageFormat::Png,
    };
    params.request(id, format, Instant::now())
}

/// A frame of the given quality. Where a moving one comes out as good as was asked for, it is called still.
fn wanted(
    id: &str,
    params: &FrameParams,
    quality: Quality,
    scale: f64,
    jpeg_quality: u8,
) -> Result<Wanted, Problem> {
    let still = still_request(id, params)?;
    if quality == Quality::Still {
        return Ok(Wanted { request: still, quality, scale: 1.0 });
    }
    let scale =
        scale.max(f64::from(LEAST_SIDE) / f64::from(still.width.min(still.height))).min(1.0);
    let side = |full: u32| ((f64::from(full) * scale).round() as u32).clamp(1, full);
    let smaller =
        FrameParams { w: Some(side(still.width)), h: Some(side(still.height)), ..params.clone() };
    let mut request = still_request(id, &smaller)?;
    // Who asked for what a browser shows can show a JPEG; of other formats nothing is known.
    let shown = matches!(request.format, ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Webp);
    if shown && request.output == Output::Color {
        let most = if request.format == ImageFormat::Jpeg { request.quality } else { 100 };
        request.format = ImageFormat::Jpeg;
        request.quality = jpeg_quality.min(most);
    }
    let as_asked = (request.width, request.height, request.format, self::jpeg_quality(&request))
        == (still.width, still.height, still.format, self::jpeg_quality(&still));
    let quality = if as_asked { Quality::Still } else { Quality::Moving };
    Ok(Wanted { request, quality, scale })
}

fn jpeg_quality(request: &FrameRequest) -> Option<u8> {
    (request.format == ImageFormat::Jpeg).then_some(request.quality)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn params(query: &str) -> FrameParams {
        FrameParams::from_query(Some(query)).unwrap()
    }

    fn moving(query: &str, scale: f64) -> Wanted {
        wanted("s", &params(query), Quality::Moving, scale, 60).unwrap()
    }

    #[test]
    fn moving_frames_are_smaller_and_jpeg_where_a_browser_could_show_them() {
        let seen = moving("w=800&h=600&format=png", 0.5).request;
        assert_eq!(
            (seen.width, seen.height, seen.format, seen.quality),
            (400, 300, ImageFormat::Jpeg, 60)
        );
        let raw = moving("w=800&h=600&format=raw", 0.5).request;
        assert_eq!((raw.width, raw.format), (400, ImageFormat::Raw));
        let depth = moving("w=800&h=600&output=depth", 0.5).request;
        assert_eq!((depth.width, depth.format), (400, ImageFormat::Png));
        assert_eq!(
            moving("w=800&h=600&quality=30", 0.5).request.quality,
            30,
            "no better than asked"
        );
    }

    #[test]
    fn small_frames_stay_visible() {
        let seen = moving("w=100&h=80", 0.25);
        assert_eq!((seen.request.width, seen.request.height), (80, 64));
        assert_eq!(moving("w=20&h=10", 0.25).request.height, 10);
    }

    #[test]
    fn what_is_as_good_as_asked_is_still() {
        assert_eq!(moving("w=64&h=64&format=raw", 0.25).quality, Quality::Still);
        assert_eq!(moving("w=64&h=64&quality=50", 1.0).quality, Quality::Still);
        assert_eq!(moving("w=64&h=64&quality=90", 1.0).quality, Quality::Moving);
        assert_eq!(moving("w=64&h=64&format=png", 1.0).quality, Quality::Moving);
    }
}
