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
use super::resolve::resolve;
use super::trace::{Origin, RequestId};
use super::{Engine, EngineError, FrameRequest, FrameTicket};

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

    /// Queues a request behind earlier requests of this seat.
    ///
    /// # Errors
    /// As [`Engine::submit`].
    pub fn ask(&mut self, request: FrameRequest) -> Result<FrameTicket, EngineError> {
        self.ask_as(RequestId::fresh(), request)
    }

    /// Queues a request as [`Seat::ask`] does, under the given id.
    ///
    /// # Errors
    /// As [`Engine::submit`].
    pub fn ask_as(
        &mut self,
        request_id: RequestId,
        request: FrameRequest,
    ) -> Result<FrameTicket, EngineError> {
        let shared = self.engine.shared();
        let resolved = resolve(shared, &request)?;
        let origin = Origin { client: self.client, request_id };
        let (job, receiver) = shared.enqueue(origin, resolved, request)?;
        self.last = Arc::downgrade(&job);
        Ok(FrameTicket { receiver })
    }

    /// Replaces the last request, whose ticket then fails; `None` when that request is being drawn already, or shares a frame
    /// that another client asked for first.
    ///
    /// # Errors
    /// Any error of the request; the last request then goes on waiting.
    pub fn replace(&mut self, request: FrameRequest) -> Result<Option<FrameTicket>, EngineError> {
        self.replace_as(RequestId::fresh(), request)
    }

    /// Replaces the last request as [`Seat::replace`] does, under the given id.
    ///
    /// # Errors
    /// As [`Seat::replace`].
    pub fn replace_as(
        &mut self,
        request_id: RequestId,
        request: FrameRequest,
    ) -> Result<Option<FrameTicket>, EngineError> {
        let Some(last) = self.last.upgrade() else { return Ok(None) };
        let shared = self.engine.shared();
        if !shared.is_waiting(self.client, &last) {
            return Ok(None);
        }
        let resolved = resolve(shared, &request)?;
        let origin = Origin { client: self.client, request_id };
        let Some((job, receiver)) = shared.replace(origin, &last, resolved, request)? else {
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
