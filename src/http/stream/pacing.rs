//! How many frames may be on their way, and how good they are while the pose moves. Pure: it is told the time.
//!
//! Two stages lie between a pose and its picture: the engine draws and encodes, the link carries and the client decodes, then
//! acknowledges. For each the time of a frame in it is measured as what it adds to the frame before, and at most what it takes by
//! itself:
//!
//! ```text
//! engine   from when it was asked for, or the frame before was finished, whichever is later
//! link     the lesser of: since the acknowledgement before; from sending to acknowledgement, less the distance
//! ```
//!
//! The distance is what a ping takes that goes out while nothing else is on its way; the least that a frame took would hold the
//! time of its own bytes, and on a slow link be mistaken for distance. Until a client has answered a ping there is none.
//!
//! The slower stage decides the size of moving frames, by pixels that would meet [`TARGET`]; a slow link lowers the quality of JPEGs
//! first. Where the engine leaves them less than a quarter of the pixels, moving frames may be wrong by more of their own, in proportion,
//! up to [`MOST_COARSE`] times: below that, point trees cost by their detail and no longer by pixels. (The plaza, drawn on a CPU, in shares of
//! what 640 × 480 takes: 0.54 at 320 × 240, 0.39 at 160 × 120, and of that size 0.21 at twice and 0.09 at four times the error.)
//!
//! The window is what fills the link at that pace and no more, so that a pose never waits behind pictures that are under
//! way; a client that does not acknowledge gets a window's worth of frames, which is one at first, and no more. It is in frames, and in bytes of what the
//! link was measured to carry in [`AHEAD`].

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// The pace that moving frames are made for.
pub const TARGET: Duration = Duration::from_millis(33);
/// Frames on their way, at least and at most.
pub const MIN_WINDOW: usize = 2;
pub const MAX_WINDOW: usize = 8;
/// What is on its way takes the link this long at most, if it is more than one frame.
const AHEAD: Duration = Duration::from_millis(500);
/// The same in bytes, before the link was measured: one frame, unless it is small.
const FIRST_BYTES: u64 = 16 << 10;
/// And at least.
const LEAST_BYTES: u64 = 8 << 10;
/// Frames of fewer bytes say nothing of the link's rate.
const TELLING_BYTES: u64 = 2 << 10;
/// Least share of the pixels asked for; below it a picture is of no use.
const LEAST_PIXELS: f64 = 1.0 / 16.0;
/// Share of the pixels asked for below which frames are coarser than asked for.
const COARSE_PIXELS: f64 = 0.25;
/// Most that an accepted error is multiplied with.
const MOST_COARSE: f64 = 4.0;
/// A client that has not acknowledged a frame for so long, while the next one waits for that, may not know that it has to.
const PATIENCE: Duration = Duration::from_secs(5);
const BEST_JPEG: f64 = 80.0;
const WORST_JPEG: f64 = 40.0;
/// A distance is measured anew after this long: paths change.
const PING_PERIOD: Duration = Duration::from_secs(5);

/// How moving frames are to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// What width and height are multiplied with.
    pub scale: f64,
    /// What an accepted error is multiplied with, 1 or more.
    pub coarseness: f64,
    pub jpeg_quality: u8,
}

/// A frame that has not been acknowledged.
#[derive(Clone, Copy, Debug)]
struct Sent {
    number: u64,
    bytes: u64,
    at: Instant,
    /// Of the pixels asked for, if it is a moving frame.
    share: Option<f64>,
}

#[derive(Debug)]
pub struct Pacer {
    unacked: VecDeque<Sent>,
    last_sent: u64,
    last_drawn_at: Option<Instant>,
    last_acked_at: Option<Instant>,
    distance: Option<Duration>,
    /// When the last ping went out, and whether it has been answered.
    pinged_at: Option<Instant>,
    is_answered: bool,
    /// What a moving frame takes of the link, averaged.
    link: Option<Duration>,
    /// What the last frame took of it.
    last_took: Option<Duration>,
    bytes_per_second: Option<f64>,
    /// Share of the pixels that each stage allows.
    drawn_pixels: f64,
    link_pixels: f64,
    jpeg_quality: f64,
}

impl Pacer {
    pub fn new() -> Self {
        Self {
            unacked: VecDeque::new(),
            last_sent: 0,
            last_drawn_at: None,
            last_acked_at: None,
            distance: None,
            pinged_at: None,
            is_answered: true,
            link: None,
            last_took: None,
            bytes_per_second: None,
            // Carefully at first: the first frame is to be there at once.
            drawn_pixels: 0.25,
            link_pixels: 0.25,
            jpeg_quality: 70.0,
        }
    }

    /// Whether one more frame may be asked for while `asked` are and have not come.
    pub fn may_ask(&self, asked: usize) -> bool {
        let on_the_way = self.unacked.len() + asked;
        let bytes: u64 = self.unacked.iter().map(|sent| sent.bytes).sum();
        // The first frame is alone: what the link takes for it is not known.
        let is_known = self.last_acked_at.is_some();
        on_the_way == 0 || (is_known && on_the_way < self.window() && bytes <= self.window_bytes())
    }

    /// Frames that may be asked for or on their way.
    pub fn window(&self) -> usize {
        let pace = self.link.unwrap_or(TARGET).max(TARGET);
        let fill = self.distance.unwrap_or_default().as_secs_f64() / pace.as_secs_f64();
        // Where the link is quick, one more waits at the engine while another is drawn, and a third is being acknowledged.
        let is_quick = self.last_took.is_some_and(|took| took < TARGET / 2);
        (MIN_WINDOW + usize::from(is_quick) + fill as usize).min(MAX_WINDOW)
    }

    fn window_bytes(&self) -> u64 {
        match self.bytes_per_second {
            Some(rate) => ((rate * AHEAD.as_secs_f64()) as u64).max(LEAST_BYTES),
            None => FIRST_BYTES,
        }
    }

    /// Of moving frames from now on.
    pub fn pace(&self) -> Pace {
        Pace {
            scale: self.drawn_pixels.min(self.link_pixels).sqrt(),
            // A slow link is helped by fewer pixels alone. In few steps: what frames cost is known by their errors.
            coarseness: quarter_octave((COARSE_PIXELS / self.drawn_pixels).clamp(1.0, MOST_COARSE)),
            jpeg_quality: self.jpeg_quality.round() as u8,
        }
    }

    /// The oldest frame that is not acknowledged, and when whoever waits for that may take it that nobody will do so. Who has acknowledged
    /// any knows how, and may be on a slow link.
    pub fn unacknowledged(&self) -> Option<(u64, Instant)> {
        let patience = if self.last_acked_at.is_none() { PATIENCE } else { PATIENCE * 4 };
        self.unacked.front().map(|sent| (sent.number, sent.at + patience))
    }

    /// A frame came from the engine; a moving one had `share` of the pixels asked for.
    pub fn drawn(&mut self, asked: Instant, done: Instant, share: Option<f64>) {
        let began = self.last_drawn_at.map_or(asked, |last| last.max(asked));
        self.last_drawn_at = Some(done);
        if let Some(share) = share {
            let took = done.saturating_duration_since(began);
            self.drawn_pixels = toward(self.drawn_pixels, share, took, self.drawn_pixels);
        }
    }

    /// Whether a ping should go out before the next frame; it then has.
    pub fn ping(&mut self, now: Instant) -> bool {
        let is_due =
            self.pinged_at.is_none_or(|at| now.saturating_duration_since(at) >= PING_PERIOD);
        let goes = is_due && self.unacked.is_empty();
        if goes {
            (self.pinged_at, self.is_answered) = (Some(now), false);
        }
        goes
    }

    /// The last ping was answered.
    pub fn ponged(&mut self, now: Instant) {
        if let Some(at) = self.pinged_at.filter(|_| !self.is_answered) {
            self.is_answered = true;
            self.distance = Some(now.saturating_duration_since(at));
        }
    }

    /// A frame was handed to the socket; numbers go up.
    pub fn sent(&mut self, number: u64, bytes: u64, now: Instant, share: Option<f64>) {
        self.last_sent = number;
        self.unacked.push_back(Sent { number, bytes, at: now, share });
    }

    /// The client has frame `number` and all before it.
    ///
    /// # Errors
    /// The last number there was, when `number` is beyond it.
    pub fn acked(&mut self, number: u64, now: Instant) -> Result<(), u64> {
        if number > self.last_sent {
            return Err(self.last_sent);
        }
        while let Some(sent) = self.unacked.front().copied().filter(|sent| sent.number <= number) {
            self.unacked.pop_front();
            // What is acknowledged along with a later frame came at a time that is not known.
            if sent.number == number {
                self.arrived(sent, now);
            }
        }
        Ok(())
    }

    fn arrived(&mut self, sent: Sent, now: Instant) {
        let took = now.saturating_duration_since(sent.at);
        // No farther than the way of something that went there and came back.
        self.distance = self.distance.map(|distance| distance.min(took));
        let own = took.saturating_sub(self.distance.unwrap_or_default());
        let since = self.last_acked_at.map(|last| now.saturating_duration_since(last));
        self.last_acked_at = Some(now);
        let took = since.map_or(own, |since| since.min(own));
        self.last_took = Some(took);
        if sent.bytes >= TELLING_BYTES {
            let rate = sent.bytes as f64 / took.max(Duration::from_millis(1)).as_secs_f64();
            self.bytes_per_second =
                Some(self.bytes_per_second.map_or(rate, |old| 0.7 * old + 0.3 * rate));
        }
        let Some(share) = sent.share else { return };
        self.link = Some(self.link.map_or(took, |old| old.mul_f64(0.7) + took.mul_f64(0.3)));
        if took > TARGET && self.jpeg_quality > WORST_JPEG {
            self.jpeg_quality = (self.jpeg_quality - 10.0).max(WORST_JPEG);
            if took < TARGET * 2 {
                return;
            }
        }
        if took < TARGET / 2 {
            self.jpeg_quality = (self.jpeg_quality + 2.0).min(BEST_JPEG);
        }
        self.link_pixels = toward(self.link_pixels, share, took, share);
    }
}

/// The nearest of four steps an octave.
fn quarter_octave(factor: f64) -> f64 {
    ((4.0 * factor.log2()).round() / 4.0).exp2()
}

/// Moves a share of pixels toward what would take [`TARGET`], if `pixels` took `took`. Growth goes by small steps from `from`, because what
/// there is no frame of is guessed.
fn toward(share: f64, pixels: f64, took: Duration, from: f64) -> f64 {
    let ratio = TARGET.as_secs_f64() / took.as_secs_f64().max(1e-4);
    let aim = (pixels * ratio).clamp(0.25 * pixels, 1.5 * from.max(pixels));
    (share.powf(0.6) * aim.clamp(LEAST_PIXELS, 1.0).powf(0.4)).clamp(LEAST_PIXELS, 1.0)
}

#[cfg(test)]
mod tests;
