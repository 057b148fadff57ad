//! Streaming clients: each sends the poses of a path when they are due, and acknowledges the frames that come.
//!
//! A stream has two tasks, so that a server that is slow to read does not delay the reading of frames: one task sends; the other
//! reads, and hands acknowledgements over. Poses are evenly spaced, and the poses of several streams are interleaved.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use futures::stream::SplitStream;
use futures::{SinkExt, StreamExt};
use parking_lot::Mutex;
use serde::Deserialize;
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use super::drive::Step;
use super::following::{Following, StreamPoint, StreamTally};
use super::poses::Poses;
use super::request::Connections;
use super::wire::{FrameAnswer, complaint, resource_path};
use crate::math::Camera;

/// Acknowledgements that may wait to be sent. A reader that is further ahead waits.
const ACKS: usize = 64;

/// Time in which a server has to answer a close.
const CLOSING: Duration = Duration::from_secs(2);

type Socket = WebSocketStream<TcpStream>;

/// The streams of one scene.
pub struct StreamClients {
    pub count: usize,
    pub poses_per_s: f64,
    pub prefix: String,
    pub scene: String,
    /// The path of each stream.
    pub poses: Vec<Poses>,
    /// Query parameters beside the pose.
    pub parameters: Vec<(String, String)>,
    /// Time in which a server has to open a stream, to read a message, and to send the first frame.
    pub timeout: Duration,
}

/// A text message from the server.
#[derive(Deserialize)]
struct Event {
    event: String,
    #[serde(default)]
    status: u16,
}

impl StreamClients {
    /// Runs all streams of a step, beside its requests.
    pub async fn run(
        self: Arc<Self>,
        connections: Arc<Connections>,
        step: Step,
        stop: Arc<AtomicBool>,
    ) -> StreamPoint {
        let tally = StreamTally::new(self.count, step.warmup, step.duration);
        let tally = Arc::new(Mutex::new(tally));
        let began = Instant::now();
        let streams = (0..self.count).map(|number| {
            let stream = OneStream {
                clients: self.clone(),
                number,
                step,
                began,
                stop: stop.clone(),
                tally: tally.clone(),
                following: Arc::default(),
            };
            tokio::spawn(stream.run(connections.clone()))
        });
        futures::future::join_all(streams.collect::<Vec<_>>()).await;
        tally.lock().point()
    }

    /// Gets one frame from a stream before the run begins, so that a refusal by the server shows early.
    ///
    /// # Errors
    /// Fails if the stream cannot be opened or gives no frame.
    pub async fn try_once(&self, connections: &Connections) -> anyhow::Result<()> {
        let Some(poses) = self.poses.first() else { return Ok(()) };
        // The server may have to build point trees first.
        let patience = self.timeout.max(Duration::from_secs(120));
        let tried = tokio::time::timeout(patience, self.first_frame(connections, poses));
        tried.await.unwrap_or_else(|_| bail!("no frame arrived on a stream within {patience:?}"))
    }

    async fn first_frame(&self, connections: &Connections, poses: &Poses) -> anyhow::Result<()> {
        let socket = self.open(connections, &poses.pose(u64::from(u32::MAX))).await;
        let mut socket = socket.map_err(anyhow::Error::msg).context("no stream")?;
        while let Some(message) = socket.next().await {
            match message.context("no frame on a stream")? {
                Message::Binary(_) => {
                    let _ = socket.close(None).await;
                    // The server frees the stream's place before it answers.
                    let answered = async { while let Some(Ok(_)) = socket.next().await {} };
                    let _ = tokio::time::timeout(CLOSING, answered).await;
                    return Ok(());
                }
                Message::Text(text) => {
                    if let Some(why) = problem_in(&text) {
                        bail!("{why}");
                    }
                }
                Message::Close(frame) => bail!("the stream was closed: {}", closed(frame)),
                _ => {}
            }
        }
        bail!("the stream ended before its first frame")
    }

    /// Opens a stream that shows `first`, within the timeout.
    async fn open(&self, connections: &Connections, first: &Camera) -> Result<Socket, String> {
        let opened = tokio::time::timeout(self.timeout, self.connect(connections, first));
        opened.await.unwrap_or_else(|_| Err(format!("no stream opened in {:?}", self.timeout)))
    }

    async fn connect(&self, connections: &Connections, first: &Camera) -> Result<Socket, String> {
        let path = resource_path(&self.prefix, &self.scene, "stream", first, &self.parameters);
        let stream = connections.connect().await?;
        let url = format!("ws://{}{path}", connections.authority());
        let mut request = url.into_client_request().map_err(|error| error.to_string())?;
        request.headers_mut().extend(connections.headers());
        match client_async(request, stream).await {
            Ok((socket, _)) => Ok(socket),
            Err(Error::Http(response)) => {
                let body = response.body().as_deref().unwrap_or_default();
                Err(complaint(response.status().as_u16(), body))
            }
            Err(error) => Err(error.to_string()),
        }
    }
}

/// The message of an event that reports a problem.
fn problem_in(text: &str) -> Option<String> {
    let event: Event = serde_json::from_str(text).ok()?;
    (event.event == "problem").then(|| complaint(event.status, text.as_bytes()))
}

fn closed(frame: Option<tokio_tungstenite::tungstenite::protocol::CloseFrame>) -> String {
    frame.map_or("without a word".to_owned(), |frame| format!("{} {}", frame.code, frame.reason))
}

struct OneStream {
    clients: Arc<StreamClients>,
    number: usize,
    step: Step,
    began: Instant,
    stop: Arc<AtomicBool>,
    tally: Arc<Mutex<StreamTally>>,
    following: Arc<Mutex<Following>>,
}

impl OneStream {
    /// Time at which pose `seq` is due. The poses of other streams lie between.
    fn due(&self, seq: u64) -> Duration {
        let offset = self.number as f64 / self.clients.count.max(1) as f64;
        Duration::from_secs_f64((seq as f64 + offset) / self.clients.poses_per_s)
    }

    fn pose(&self, seq: u64) -> Option<Camera> {
        // Pose 0 is the one in the stream's URL.
        self.clients.poses.get(self.number).map(|poses| poses.pose(seq + 1))
    }

    async fn run(self, connections: Arc<Connections>) {
        let Some(first) = self.clients.poses.get(self.number).map(|poses| poses.pose(0)) else {
            return;
        };
        let ended = match self.clients.open(&connections, &first).await {
            Ok(socket) => self.follow(socket).await,
            Err(why) => Err((0, why)),
        };
        if let Err((sent, why)) = ended {
            // Poses that would still have been due count as lost.
            let until = self.step.warmup + self.step.duration;
            let unsent = (sent..).map(|seq| (seq, self.due(seq)));
            let unsent = unsent.take_while(|(_, due)| *due < until);
            if !self.stop.load(Ordering::Relaxed) {
                let mut following = self.following.lock();
                unsent.for_each(|(seq, due)| following.due(seq + 1, due));
            }
            self.tally.lock().broken(why);
        }
        self.tally.lock().ended(&self.following.lock());
    }

    /// Sends every pose of the step and waits for the last one's frame. An error says how many poses were due, and why the stream
    /// broke.
    async fn follow(&self, socket: Socket) -> Result<(), (u64, String)> {
        let (mut sink, source) = socket.split();
        let (acks_in, mut acks) = mpsc::channel(ACKS);
        let mut reader = tokio::spawn(read(
            source,
            acks_in,
            self.tally.clone(),
            self.following.clone(),
            self.began,
        ));
        let until = self.step.warmup + self.step.duration;
        let give_up = self.began + until + self.step.timeout;
        let mut seq = 0;
        loop {
            let due = self.due(seq);
            let is_over = due >= until || self.stop.load(Ordering::Relaxed);
            if is_over && (self.following.lock().is_through() || Instant::now() >= give_up) {
                break;
            }
            let next =
                if is_over { Instant::now() + Duration::from_millis(20) } else { self.began + due };
            let message = tokio::select! {
                ended = &mut reader => {
                    let why = ended.unwrap_or_else(|error| error.to_string());
                    return Err((seq, why));
                }
                Some(ack) = acks.recv() => format!("{{\"ack\":{ack}}}"),
                () = tokio::time::sleep_until(next.into()) => {
                    if is_over {
                        continue;
                    }
                    seq += 1;
                    self.following.lock().due(seq, due);
                    self.tally.lock().sent(due, self.began.elapsed());
                    let is_last = self.due(seq) >= until;
                    let Some(pose) = self.pose(seq) else { break };
                    pose_message(seq, &pose, !is_last)
                }
            };
            let sent = sink.send(Message::text(message));
            match tokio::time::timeout(self.clients.timeout, sent).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => return Err((seq, error.to_string())),
                Err(_) => return Err((seq, "the server reads no poses".to_owned())),
            }
        }
        let _ = tokio::time::timeout(CLOSING, sink.close()).await;
        // The server frees the stream's place before it answers.
        let _ = tokio::time::timeout(CLOSING, &mut reader).await;
        reader.abort();
        Ok(())
    }
}

fn pose_message(seq: u64, pose: &Camera, moving: bool) -> String {
    let (lens, size) = pose.lens.parameter();
    serde_json::json!({
        "seq": seq,
        "eye": pose.eye.to_array(),
        "target": pose.target.to_array(),
        "up": pose.up.to_array(),
        lens: size,
        "moving": moving,
    })
    .to_string()
}

/// Reads frames until the stream ends, and returns why it ended.
async fn read(
    mut source: SplitStream<Socket>,
    acks: mpsc::Sender<u64>,
    tally: Arc<Mutex<StreamTally>>,
    following: Arc<Mutex<Following>>,
    began: Instant,
) -> String {
    loop {
        match source.next().await {
            Some(Ok(Message::Binary(bytes))) => {
                let at = began.elapsed();
                let Some(frame) = FrameAnswer::read(&bytes) else {
                    return "a frame's header cannot be read".to_owned();
                };
                tally.lock().frame(&mut following.lock(), &frame, bytes.len() as u64, at);
                if acks.send(frame.frame).await.is_err() {
                    return "the sender has ended".to_owned();
                }
            }
            Some(Ok(Message::Text(text))) => {
                if let Some(why) = problem_in(&text) {
                    tally.lock().problem(why);
                }
            }
            Some(Ok(Message::Close(frame))) => return format!("closed: {}", closed(frame)),
            Some(Ok(_)) => {}
            Some(Err(error)) => return error.to_string(),
            None => return "the connection ended".to_owned(),
        }
    }
}
