//! The queue of outgoing messages and the task that writes them, so that a session reads on while a large frame is sent.
//!
//! The queue is bounded: a session requests frames only while few are unwritten ([`SendQueue::has_room_for_frames`]), and reads only
//! while there is room for the replies to what it reads ([`SendQueue::may_read`]).

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use futures::stream::{SplitSink, SplitStream};
use futures::{SinkExt, StreamExt};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::wire::Close;

/// Capacity of the queue; `KEPT` of its places are reserved for replies to messages that were read.
const PLACES: usize = 32;
const KEPT: usize = 16;
/// Largest number of finished frames that are not written: one being written and one behind it.
const MOST_FRAMES: usize = 2;
/// Time for a client to answer a close.
const CLOSING: Duration = Duration::from_secs(2);
/// Time for a close to arrive when no answer is awaited: ending a connection with unread bytes resets it.
const ARRIVING: Duration = Duration::from_millis(500);

pub struct SendQueue {
    sender: mpsc::Sender<Message>,
    unwritten_frames: Arc<AtomicUsize>,
    writer: JoinHandle<()>,
}

impl SendQueue {
    pub fn start(sink: SplitSink<WebSocket, Message>) -> Self {
        let (sender, receiver) = mpsc::channel(PLACES);
        let unwritten_frames = Arc::new(AtomicUsize::new(0));
        let writer = tokio::spawn(write(sink, receiver, unwritten_frames.clone()));
        Self { sender, unwritten_frames, writer }
    }

    /// Returns whether there will be room for `asked` more frames.
    pub fn has_room_for_frames(&self, asked: usize) -> bool {
        self.unwritten_frames.load(Ordering::Relaxed) + asked <= MOST_FRAMES
    }

    pub fn may_read(&self) -> bool {
        self.sender.capacity() >= KEPT
    }

    /// Waits until [`SendQueue::may_read`] is true.
    pub async fn room(&self) {
        // An error means that the writer ended, which `ended` reports.
        let _ = self.sender.reserve_many(KEPT).await;
    }

    /// Hands a message to the writer. Returns false if the stream is over.
    pub fn push(&self, message: Message) -> bool {
        if matches!(message, Message::Binary(_)) {
            self.unwritten_frames.fetch_add(1, Ordering::Relaxed);
        }
        self.sender.try_send(message).is_ok()
    }

    /// Waits until the writer has ended.
    pub async fn ended(&self) {
        self.sender.closed().await;
    }

    /// Writes waiting messages and then the close, and waits for the client's close; both for a limited time.
    pub async fn close(self, close: Close, source: SplitStream<WebSocket>) {
        let SendQueue { sender, mut writer, .. } = self;
        let closing = async {
            if sender.send(close.message()).await.is_ok() {
                drop(sender);
                let _ = (&mut writer).await;
            }
            drained(source).await;
        };
        let _ = tokio::time::timeout(CLOSING, closing).await;
        writer.abort();
    }

    /// Closes a stream whose client's messages cannot be read any more.
    pub async fn close_unread(self, close: Close, source: SplitStream<WebSocket>) {
        let SendQueue { sender, mut writer, .. } = self;
        let writing = async {
            if sender.send(close.message()).await.is_ok() {
                drop(sender);
                let _ = (&mut writer).await;
                tokio::time::sleep(ARRIVING).await;
            }
        };
        let _ = tokio::time::timeout(CLOSING, writing).await;
        writer.abort();
        drop(source);
    }

    /// Finishes the handshake of a close by the client; no more frames are sent.
    pub async fn closed(self, source: SplitStream<WebSocket>) {
        self.writer.abort();
        let _ = tokio::time::timeout(CLOSING, drained(source)).await;
    }
}

/// Reads to the end, which also sends the answer to a close.
async fn drained(mut source: SplitStream<WebSocket>) {
    while let Some(Ok(_)) = source.next().await {}
}

async fn write(
    mut sink: SplitSink<WebSocket, Message>,
    mut receiver: mpsc::Receiver<Message>,
    unwritten_frames: Arc<AtomicUsize>,
) {
    while let Some(message) = receiver.recv().await {
        let is_frame = matches!(message, Message::Binary(_));
        let is_last = matches!(message, Message::Close(_));
        if sink.send(message).await.is_err() || is_last {
            return;
        }
        if is_frame {
            unwritten_frames.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// Closes a socket before any message was sent.
pub async fn refuse(socket: WebSocket, close: Close) {
    let (sink, source) = socket.split();
    SendQueue::start(sink).close(close, source).await;
}
