//! Finished frames, and tickets for those that are not finished yet.

use std::sync::Arc;

use bytes::Bytes;

use super::EngineError;
use super::receipt::Receipt;

/// A finished frame.
#[derive(Clone, Debug)]
pub struct EncodedFrame {
    pub bytes: Bytes,
    pub content_type: &'static str,
    pub receipt: Receipt,
}

/// A promised frame. Await it; dropping it cancels the job unless somebody else waits for the same frame
/// or it has been submitted already.
pub struct FrameTicket {
    pub(super) receiver: tokio::sync::oneshot::Receiver<Result<Arc<EncodedFrame>, EngineError>>,
}

impl FrameTicket {
    /// Blocks until the frame is there; not for threads that run async tasks.
    pub fn wait(self) -> Result<Arc<EncodedFrame>, EngineError> {
        self.receiver.blocking_recv().unwrap_or(Err(EngineError::ShuttingDown))
    }
}

impl std::future::Future for FrameTicket {
    type Output = Result<Arc<EncodedFrame>, EngineError>;

    fn poll(
        mut self: std::pin::Pin<&mut Self>,
        context: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Self::Output> {
        std::pin::Pin::new(&mut self.receiver)
            .poll(context)
            .map(|result| result.unwrap_or(Err(EngineError::ShuttingDown)))
    }
}
