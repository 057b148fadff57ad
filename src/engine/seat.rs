//! A place in the queue for a client that wants only the newest frame: its request can be replaced until the render thread takes
//! it.
//!
//! ```text
//! ask ──▶ waits ──taken──▶ is drawn ──▶ reply
//!           │ replace: the newer one has the old one's turn, the old one is answered `Overtaken`
//! ```

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use super::job::Job;
use super::queue::Client;
use super::resolved::ResolvedFrame;
use super::trace::{Origin, RequestId};
use super::{Engine, EngineError, FrameTicket};

/// The place of one stream, which shares the device with all other clients.
pub struct Seat {
    engine: Engine,
    client: Client,
    /// The last job. Weak, so that an idle seat does not keep a removed scene alive.
    last: Weak<Job>,
}

impl Seat {
    pub(super) fn new(engine: &Engine, of: Client) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let of = match of {
            Client::Caller(of) | Client::Stream { of, .. } => of,
            // It belongs to no caller and is a client of its own.
            Client::Unnamed | Client::Job(_) => number,
        };
        let client = Client::Stream { of, number };
        engine.shared().open_streams.fetch_add(1, Ordering::Relaxed);
        Self { engine: engine.clone(), client, last: Weak::new() }
    }

    /// Queues a frame behind earlier frames of this seat.
    ///
    /// # Errors
    /// As [`Engine::queue`].
    pub fn ask(
        &mut self,
        request_id: RequestId,
        frame: Arc<ResolvedFrame>,
    ) -> Result<FrameTicket, EngineError> {
        let origin = Origin { client: self.client, request_id };
        let (job, receiver) = self.engine.shared().enqueue(origin, frame)?;
        self.last = Arc::downgrade(&job);
        Ok(FrameTicket { receiver })
    }

    /// Returns the last frame if it can be replaced.
    fn replaceable(&self) -> Option<Arc<Job>> {
        let last = self.last.upgrade()?;
        self.engine.shared().is_waiting(self.client, &last).then_some(last)
    }

    /// Returns whether the last frame waits in the queue, so that [`Seat::replace`] would replace it.
    pub fn has_replaceable(&self) -> bool {
        self.replaceable().is_some()
    }

    /// Replaces the last frame, whose ticket then fails; `None` when that frame is being drawn already, or shares a frame
    /// that another client asked for first.
    ///
    /// # Errors
    /// As [`Engine::queue`]; the last frame then goes on waiting.
    pub fn replace(
        &mut self,
        request_id: RequestId,
        frame: &Arc<ResolvedFrame>,
    ) -> Result<Option<FrameTicket>, EngineError> {
        let Some(last) = self.replaceable() else { return Ok(None) };
        let origin = Origin { client: self.client, request_id };
        let shared = self.engine.shared();
        let Some((job, receiver)) = shared.replace(origin, &last, frame.clone())? else {
            return Ok(None);
        };
        self.last = Arc::downgrade(&job);
        Ok(Some(FrameTicket { receiver }))
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.engine.shared().open_streams.fetch_sub(1, Ordering::Relaxed);
    }
}
