//! One frame on its way: who waits for it, and until when.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::queue::cost::CostKey;
use super::queue::{Client, Granted, Waiting};
use super::receipt::CameraReceipt;
use super::trace::{FrameSpans, Origin, RequestId};
use super::{EncodedFrame, EngineError, FrameRequest};
use crate::math::View;
use crate::plan::auto::Choice;
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
    /// Why the frame will be another one in a while, and how far that is.
    pub provisional: Option<String>,
    /// How samples are drawn where that was left open, and why.
    pub auto: Option<Choice>,
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
    /// Whoever asked first calls it so.
    pub request_id: RequestId,
    /// All that is done for it.
    pub span: tracing::Span,
    pub cost_key: CostKey,
    /// Device time, estimated.
    pub cost_ns: u64,
    /// Its time in the queue, until it is taken.
    queue_span: Mutex<Option<tracing::Span>>,
    /// In whose lane it waits or waited.
    lane: Mutex<Client>,
    /// What was charged for it, from when it is taken to when that is settled.
    charged: Mutex<Option<(Client, u64)>>,
    waiters: Mutex<Waiters>,
    attempts: AtomicU32,
    redraws: AtomicU32,
    alone: AtomicBool,
    /// Halvings of what splats weigh.
    halvings: AtomicU32,
    /// The first way to draw it had no room for what lies over one pixel.
    too_full: AtomicBool,
}

struct Waiter {
    origin: Origin,
    sender: oneshot::Sender<Reply>,
}

struct Waiters {
    senders: Vec<Waiter>,
    /// The latest that anybody would still take it; `None`: any time.
    deadline: Option<Instant>,
    answered: bool,
}

impl Job {
    /// `cost_ns`: device time that it is estimated to take.
    pub fn new(
        origin: Origin,
        resolved: Resolved,
        request: FrameRequest,
        (cost_key, cost_ns): (CostKey, u64),
    ) -> (Arc<Job>, oneshot::Receiver<Reply>) {
        let (sender, receiver) = oneshot::channel();
        let FrameSpans { frame, queue } = FrameSpans::open(&origin, &request, cost_ns);
        let job = Job {
            enqueued: Instant::now(),
            request_id: origin.request_id.clone(),
            span: frame,
            cost_key,
            cost_ns,
            queue_span: Mutex::new(Some(queue)),
            lane: Mutex::new(origin.client),
            charged: Mutex::new(None),
            waiters: Mutex::new(Waiters {
                senders: vec![Waiter { origin, sender }],
                deadline: request.deadline,
                answered: false,
            }),
            attempts: AtomicU32::new(0),
            redraws: AtomicU32::new(0),
            alone: AtomicBool::new(false),
            halvings: AtomicU32::new(0),
            too_full: AtomicBool::new(false),
            resolved,
            request,
        };
        (Arc::new(job), receiver)
    }

    /// In whose lane it waits or waited.
    pub fn lane(&self) -> Client {
        *self.lane.lock()
    }

    pub fn set_lane(&self, client: Client) {
        *self.lane.lock() = client;
    }

    /// It is being drawn from now on.
    pub fn taken(&self, client: Client, charged_ns: u64) {
        self.queue_span.lock().take();
        *self.charged.lock() = Some((client, charged_ns));
    }

    /// What was charged for it, and to whom, if it is under way.
    pub fn charged(&self) -> Option<(Client, u64)> {
        *self.charged.lock()
    }

    /// It is under way no more.
    pub fn settle(&self) -> Option<(Client, u64)> {
        self.charged.lock().take()
    }

    /// It waits again.
    pub fn granted(self: Arc<Self>) -> Granted<Arc<Job>> {
        let (client, cost_ns) = self.settle().unwrap_or((self.lane(), self.cost_ns));
        let queue = FrameSpans::queue(&self.span, &self.request_id, self.cost_ns);
        *self.queue_span.lock() = Some(queue);
        Granted { client, cost_ns, job: self }
    }

    /// One more waits for the same frame; `None` when it has been answered already.
    pub fn join(
        &self,
        origin: Origin,
        deadline: Option<Instant>,
    ) -> Option<oneshot::Receiver<Reply>> {
        let mut waiters = self.waiters.lock();
        if waiters.answered {
            return None;
        }
        let (sender, receiver) = oneshot::channel();
        tracing::debug!(
            parent: &self.span,
            request_id = %origin.request_id,
            shares = %self.request_id,
            "shares a frame that is under way",
        );
        waiters.senders.push(Waiter { origin, sender });
        waiters.deadline = waiters.deadline.zip(deadline).map(|(a, b)| a.max(b));
        Some(receiver)
    }

    /// Somebody else than `client` who waits for it.
    pub fn waiter_beside(&self, client: Client) -> Option<Client> {
        let waiters = self.waiters.lock();
        let live = waiters.senders.iter().filter(|waiter| !waiter.sender.is_closed());
        live.map(|waiter| waiter.origin.client).find(|other| *other != client)
    }

    /// Answers everybody. The first to have asked gets the frame as it is; the others' receipts say that they shared it.
    pub fn answer(&self, reply: Reply) {
        let senders = {
            let mut waiters = self.waiters.lock();
            waiters.answered = true;
            std::mem::take(&mut waiters.senders)
        };
        for (number, Waiter { origin, sender }) in senders.into_iter().enumerate() {
            let mut reply = reply.clone();
            if let (true, Ok(frame)) = (number > 0, &mut reply) {
                let receipt = &mut Arc::make_mut(frame).receipt;
                receipt.coalesced = true;
                receipt.request_id = origin.request_id.as_str().to_owned();
            }
            // A receiver that is gone has cancelled.
            let _ = sender.send(reply);
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
        self.waiters.lock().senders.iter().all(|waiter| waiter.sender.is_closed())
    }

    fn deadline(&self) -> Option<Instant> {
        self.waiters.lock().deadline
    }

    fn pixels(&self) -> u64 {
        u64::from(self.request.width) * u64::from(self.request.height)
    }
}
