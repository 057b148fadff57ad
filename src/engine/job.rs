//! One frame on its way: who waits for it, and until when.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::queue::{Client, Waiting};
use super::receipt::CameraReceipt;
use super::{EncodedFrame, EngineError, FrameRequest};
use crate::math::View;
use crate::plan::{FramePlan, MaxError, Reconstruct};
use crate::residency::model::{Extent, SceneModel};
use crate::scene::{Blend, Splats};

/// Leaves room for 68 splats of full weight over a pixel.
const SINGLE_PASS_WEIGHT: f32 = 15.0;

pub type Reply = Result<Arc<EncodedFrame>, EngineError>;

/// A request, resolved: everything that can be wrong with it has been looked at.
#[derive(Clone)]
pub struct Resolved {
    pub model: Arc<SceneModel>,
    pub view: View,
    pub camera: CameraReceipt,
    pub extent: Extent,
    pub drawing: Drawing,
    /// For splats that a single pass has no room for.
    pub in_three_passes: Option<Drawing>,
    /// What may be wrong by how many pixels, in a scene of point trees.
    pub max_error: MaxError,
    /// Equal for requests whose frames are equal to the byte.
    pub key: String,
}

/// One way to draw a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    pub plan: FramePlan,
    pub reconstruct: Reconstruct,
    /// Why it is not the way that was asked for.
    pub instead_because: Option<&'static str>,
    /// How samples are drawn, if not as points.
    pub splats: Option<Splats>,
}

/// A frame that somebody waits for.
pub struct Job {
    pub resolved: Resolved,
    pub request: FrameRequest,
    pub enqueued: Instant,
    waiters: Mutex<Waiters>,
    attempts: AtomicU32,
    redraws: AtomicU32,
    alone: AtomicBool,
    /// Halvings of what splats weigh.
    halvings: AtomicU32,
    /// The first way to draw it had no room for what lies over one pixel.
    too_full: AtomicBool,
}

struct Waiters {
    /// With who it is that waits.
    senders: Vec<(Client, oneshot::Sender<Reply>)>,
    /// The latest that anybody would still take it; `None`: any time.
    deadline: Option<Instant>,
    answered: bool,
}

impl Job {
    pub fn new(
        client: Client,
        resolved: Resolved,
        request: FrameRequest,
    ) -> (Arc<Job>, oneshot::Receiver<Reply>) {
        let (sender, receiver) = oneshot::channel();
        let senders = vec![(client, sender)];
        let waiters = Waiters { senders, deadline: request.deadline, answered: false };
        let job = Job {
            resolved,
            request,
            enqueued: Instant::now(),
            waiters: Mutex::new(waiters),
            attempts: AtomicU32::new(0),
            redraws: AtomicU32::new(0),
            alone: AtomicBool::new(false),
            halvings: AtomicU32::new(0),
            too_full: AtomicBool::new(false),
        };
        (Arc::new(job), receiver)
    }

    /// One more waits for the same frame; `None` when it has been answered already.
    pub fn join(
        &self,
        client: Client,
        deadline: Option<Instant>,
    ) -> Option<oneshot::Receiver<Reply>> {
        let mut waiters = self.waiters.lock();
        if waiters.answered {
            return None;
        }
        let (sender, receiver) = oneshot::channel();
        waiters.senders.push((client, sender));
        waiters.deadline = waiters.deadline.zip(deadline).map(|(a, b)| a.max(b));
        Some(receiver)
    }

    /// Somebody else than `client` who waits for it.
    pub fn waiter_beside(&self, client: Client) -> Option<Client> {
        let waiters = self.waiters.lock();
        let live = waiters.senders.iter().filter(|(_, sender)| !sender.is_closed());
        live.map(|(other, _)| *other).find(|other| *other != client)
    }

    /// Answers everybody. The first to have asked gets the frame as it is; the others' receipts say that they shared it.
    pub fn answer(&self, reply: Reply) {
        let senders = {
            let mut waiters = self.waiters.lock();
            waiters.answered = true;
            std::mem::take(&mut waiters.senders)
        };
        let shared = (senders.len() > 1).then(|| {
            reply.as_ref().map_err(Clone::clone).map(|frame| {
                let mut frame = EncodedFrame::clone(frame);
                frame.receipt.coalesced = true;
                Arc::new(frame)
            })
        });
        let mut first = Some(reply);
        for (_, sender) in senders {
            let reply = first.take().or_else(|| shared.clone());
            if let Some(reply) = reply {
                // A receiver that is gone has cancelled.
                let _ = sender.send(reply);
            }
        }
    }

    /// Jobs with equal keys can be drawn by the same dispatches; `None`: none with this one.
    pub fn group_key(&self) -> Option<impl PartialEq + use<>> {
        let FrameRequest { output, width, height, .. } = self.request;
        let drawing = self.drawing().clone();
        let halvings = self.halvings.load(Ordering::Relaxed);
        let key = (self.resolved.model.uid, drawing, halvings, output, width, height);
        // What one frame lists of point trees another cannot use.
        (!self.is_alone() && !self.resolved.model.trees).then_some(key)
    }

    /// Counts a redraw for want of room in a list; false when there have been more than growing lists explain.
    pub fn may_redraw(&self) -> bool {
        self.redraws.fetch_add(1, Ordering::Relaxed) < 8
    }

    /// How it is drawn now.
    pub fn drawing(&self) -> &Drawing {
        let other = self.resolved.in_three_passes.as_ref();
        other.filter(|_| self.too_full.load(Ordering::Relaxed)).unwrap_or(&self.resolved.drawing)
    }

    fn is_single_pass(&self) -> bool {
        self.drawing().splats.is_some_and(|splats| splats.blend == Blend::Interleaved)
    }

    /// What a splat weighs in whole numbers where its kernel is 1: 15 bits, unless too many overlap; 4 in a single pass.
    pub fn weight_one(&self) -> f32 {
        if self.is_single_pass() {
            return SINGLE_PASS_WEIGHT;
        }
        (1u32 << 15 >> self.halvings.load(Ordering::Relaxed)) as f32
    }

    /// The sums of a pixel have overflowed: from now on splats weigh a 32nd of what they did, or take three passes.
    pub fn lighten(&self) {
        if self.is_single_pass() {
            self.too_full.store(true, Ordering::Relaxed);
            return;
        }
        let _ = self.halvings.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |halvings| {
            Some((halvings + 5).min(15))
        });
    }

    /// From now on no dispatch draws it together with other frames.
    pub fn set_alone(&self) {
        self.alone.store(true, Ordering::Relaxed);
    }

    pub fn is_alone(&self) -> bool {
        self.alone.load(Ordering::Relaxed)
    }

    /// Counts a device lost under it; false when there have been too many.
    pub fn try_again(&self) -> bool {
        self.attempts.fetch_add(1, Ordering::Relaxed) < 3
    }
}

impl Waiting for Arc<Job> {
    fn is_abandoned(&self) -> bool {
        self.waiters.lock().senders.iter().all(|(_, sender)| sender.is_closed())
    }

    fn deadline(&self) -> Option<Instant> {
        self.waiters.lock().deadline
    }

    fn pixels(&self) -> u64 {
        u64::from(self.request.width) * u64::from(self.request.height)
    }
}
