//! One frame in the engine, with its waiters and deadline.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::queue::{Client, Granted, Waiting};
use super::resolved::{Drawing, ResolvedFrame};
use super::trace::{FrameSpans, Origin, RequestId};
use super::{EncodedFrame, EngineError, FrameRequest};

/// Weight of a splat in a single pass; leaves room for 32 splats of full weight over a pixel.
const FUZZY_WEIGHT: f32 = 255.0;
/// The weight where more splats overlap: 130 fit.
const LIGHT_FUZZY_WEIGHT: f32 = 63.0;

pub type Reply = Result<Arc<EncodedFrame>, EngineError>;

/// A frame that somebody waits for.
pub struct FrameJob {
    pub frame: Arc<ResolvedFrame>,
    pub enqueued: Instant,
    /// Id of the first request that asked for this frame.
    pub request_id: RequestId,
    /// Span of all work for this frame.
    pub span: tracing::Span,
    /// Estimated device time.
    pub cost_ns: u64,
    turn: Mutex<Turn>,
    waiters: Mutex<Waiters>,
    attempts: AtomicU32,
    redraws: AtomicU32,
    alone: AtomicBool,
    /// Number of reductions of the splats' weights.
    halvings: AtomicU32,
    /// Whether the first way to draw the frame overflowed, at some pixel or in the list of painted splats.
    too_full: AtomicBool,
}

/// The frame's place in the queue, and what it was charged.
struct Turn {
    /// Client in whose lane it waits or waited.
    lane: Client,
    /// Client and amount charged for it, from when it is taken until the charge is settled.
    charged: Option<(Client, u64)>,
    /// Span of its time in the queue, until it is taken.
    queue_span: Option<tracing::Span>,
}

struct Waiter {
    origin: Origin,
    sender: oneshot::Sender<Reply>,
}

struct Waiters {
    senders: Vec<Waiter>,
    /// Latest time at which any waiter would still take the frame; `None` for any time.
    deadline: Option<Instant>,
    answered: bool,
}

impl FrameJob {
    /// `cost_ns` is the estimated device time.
    pub fn new(
        origin: Origin,
        resolved: Arc<ResolvedFrame>,
        cost_ns: u64,
    ) -> (Arc<FrameJob>, oneshot::Receiver<Reply>) {
        let (sender, receiver) = oneshot::channel();
        let FrameSpans { frame, queue } = FrameSpans::open(&origin, &resolved.request, cost_ns);
        let job = FrameJob {
            enqueued: Instant::now(),
            request_id: origin.request_id.clone(),
            span: frame,
            cost_ns,
            turn: Mutex::new(Turn { lane: origin.client, charged: None, queue_span: Some(queue) }),
            waiters: Mutex::new(Waiters {
                senders: vec![Waiter { origin, sender }],
                deadline: resolved.request.deadline,
                answered: false,
            }),
            attempts: AtomicU32::new(0),
            redraws: AtomicU32::new(0),
            alone: AtomicBool::new(false),
            halvings: AtomicU32::new(0),
            too_full: AtomicBool::new(false),
            frame: resolved,
        };
        (Arc::new(job), receiver)
    }

    /// Returns whether the frame is drawn in several parts.
    pub fn is_long(&self) -> bool {
        !self.frame.exposures.is_empty()
    }

    /// Returns the client in whose lane the frame waits or waited.
    pub fn lane(&self) -> Client {
        self.turn.lock().lane
    }

    pub fn set_lane(&self, client: Client) {
        self.turn.lock().lane = client;
    }

    /// Records that drawing begins.
    pub fn taken(&self, client: Client, charged_ns: u64) {
        let mut turn = self.turn.lock();
        turn.queue_span = None;
        turn.charged = Some((client, charged_ns));
    }

    /// Returns the client and the amount charged for the frame while it is drawn.
    pub fn charged(&self) -> Option<(Client, u64)> {
        self.turn.lock().charged
    }

    /// Takes the charge back out when drawing ends.
    pub fn settle(&self) -> Option<(Client, u64)> {
        self.turn.lock().charged.take()
    }

    /// Prepares the frame for waiting again.
    pub fn granted(self: Arc<Self>) -> Granted<Arc<FrameJob>> {
        let (client, cost_ns) = self.settle().unwrap_or((self.lane(), self.cost_ns));
        let queue = FrameSpans::queue(&self.span, &self.request_id, self.cost_ns);
        self.turn.lock().queue_span = Some(queue);
        Granted { client, cost_ns, job: self }
    }

    /// Adds a waiter for the same frame; `None` when the frame has been answered already.
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

    /// Returns a live waiter other than `client`.
    pub fn waiter_beside(&self, client: Client) -> Option<Client> {
        let waiters = self.waiters.lock();
        let live = waiters.senders.iter().filter(|waiter| !waiter.sender.is_closed());
        live.map(|waiter| waiter.origin.client).find(|other| *other != client)
    }

    /// Answers all waiters. The first one gets the frame as it is; the others' receipts say that they shared it.
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

    /// Returns a key that is equal for jobs that the same dispatches can draw; `None` if no other job can share them. The key holds
    /// everything but the view that a task takes from its first job.
    pub fn group_key(&self) -> Option<impl PartialEq + use<>> {
        let FrameRequest { output, width, height, .. } = self.frame.request;
        let drawing = self.drawing().clone();
        let halvings = self.halvings.load(Ordering::Relaxed);
        let key = (self.frame.model.uid, drawing, halvings, output, width, height);
        // Exposures of one frame are drawn together, but with those of no other frame.
        (self.shares_dispatches() && self.frame.exposures.is_empty()).then_some(key)
    }

    /// Whether the same dispatches can draw several views of the scene with these settings.
    pub fn shares_dispatches(&self) -> bool {
        // Frames of point trees cannot share their lists of nodes, nor painted ones their lists of splats, and picks read back something
        // else.
        let has_lists = self.frame.model.trees || self.drawing().reconstruction.painted().is_some();
        !self.is_alone() && !has_lists && self.frame.picks.is_empty()
    }

    /// Counts a redraw because a list was full; false after more redraws than growing lists explain.
    pub fn may_redraw(&self) -> bool {
        self.redraws.fetch_add(1, Ordering::Relaxed) < 12
    }

    /// Returns the current way to draw the frame.
    pub fn drawing(&self) -> &Drawing {
        let other = self.frame.in_three_passes.as_ref();
        other.filter(|_| self.too_full.load(Ordering::Relaxed)).unwrap_or(&self.frame.drawing)
    }

    fn is_fuzzy(&self) -> bool {
        self.drawing().reconstruction.fuzzy().is_some()
    }

    /// Returns the integer weight of a splat where its kernel is 1: 15 bits, unless too many overlap; 8 bits in a single pass.
    pub fn weight_one(&self) -> f32 {
        let halvings = self.halvings.load(Ordering::Relaxed);
        match (self.is_fuzzy(), halvings) {
            (true, 0) => FUZZY_WEIGHT,
            (true, _) => LIGHT_FUZZY_WEIGHT,
            (false, halvings) => (1u32 << 15 >> halvings) as f32,
        }
    }

    /// Handles overflowing sums of a pixel: from now on splats weigh a 32nd of before. In a single pass they weigh a quarter; if that is
    /// still too much, the frame takes three passes.
    pub fn lighten(&self) {
        if self.is_fuzzy() {
            let again = self.halvings.fetch_xor(1, Ordering::Relaxed) != 0;
            self.too_full.store(again, Ordering::Relaxed);
            return;
        }
        let _ = self.halvings.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |halvings| {
            Some((halvings + 5).min(15))
        });
    }

    /// Draws the frame in three passes from now on, if its way of drawing has another for that.
    pub fn take_three_passes(&self) {
        self.too_full.store(true, Ordering::Relaxed);
    }

    /// Draws the frame alone from now on, in no shared dispatch.
    pub fn set_alone(&self) {
        self.alone.store(true, Ordering::Relaxed);
    }

    pub fn is_alone(&self) -> bool {
        self.alone.load(Ordering::Relaxed)
    }

    /// Counts a loss of the device during this frame; false after too many.
    pub fn try_again(&self) -> bool {
        self.attempts.fetch_add(1, Ordering::Relaxed) < 3
    }
}

impl Waiting for Arc<FrameJob> {
    fn is_abandoned(&self) -> bool {
        self.waiters.lock().senders.iter().all(|waiter| waiter.sender.is_closed())
    }

    fn deadline(&self) -> Option<Instant> {
        self.waiters.lock().deadline
    }

    fn pixels(&self) -> u64 {
        u64::from(self.frame.request.width) * u64::from(self.frame.request.height)
    }
}
