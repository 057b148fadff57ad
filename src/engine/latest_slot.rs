//! A place in the queue for a client that wants only the newest frame: its request can be replaced until the render thread takes
//! it.
//!
//! ```text
//! ask ──▶ waits ──taken──▶ is drawn ──▶ reply
//!           │ replace: the newer one has the old one's turn, the old one is answered `Overtaken`
//! ```

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use super::frame_job::FrameJob;
use super::queue::Client;
use super::resolved::ResolvedFrame;
use super::trace::{Origin, RequestId};
use super::{Engine, EngineError, FrameTicket};

/// The place of one stream, which shares the device with all other clients.
pub struct LatestSlot {
    engine: Engine,
    client: Client,
    /// The last job. Weak, so that an idle slot does not keep a removed scene alive.
    last: Weak<FrameJob>,
}

impl LatestSlot {
    pub(super) fn new(engine: &Engine, of: Client) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let of = match of {
            Client::Caller(of) | Client::Stream { of, .. } => of,
            // It belongs to no caller and is a client of its own.
            Client::Unnamed | Client::Job(_) => number,
        };
        let client = Client::Stream { of, number };
        engine.state().open_streams.fetch_add(1, Ordering::Relaxed);
        Self { engine: engine.clone(), client, last: Weak::new() }
    }

    /// Queues a frame behind earlier frames of this slot.
    ///
    /// # Errors
    /// As [`Engine::queue`].
    pub fn ask(
        &mut self,
        request_id: RequestId,
        frame: Arc<ResolvedFrame>,
    ) -> Result<FrameTicket, EngineError> {
        let origin = Origin { client: self.client, request_id };
        let (job, receiver) = self.engine.state().enqueue(origin, frame)?;
        self.last = Arc::downgrade(&job);
        Ok(FrameTicket { receiver })
    }

    /// Returns the last frame if it can be replaced.
    fn replaceable(&self) -> Option<Arc<FrameJob>> {
        let last = self.last.upgrade()?;
        self.engine.state().is_waiting(self.client, &last).then_some(last)
    }

    /// Returns whether the last frame waits in the queue, so that [`LatestSlot::replace`] would replace it.
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
        let state = self.engine.state();
        let Some((job, receiver)) = state.replace(origin, &last, frame.clone())? else {
            return Ok(None);
        };
        self.last = Arc::downgrade(&job);
        Ok(Some(FrameTicket { receiver }))
    }
}

impl Drop for LatestSlot {
    fn drop(&mut self) {
        self.engine.state().open_streams.fetch_sub(1, Ordering::Relaxed);
    }
}
