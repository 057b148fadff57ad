//! Decides how many frames may be in flight, and how good they are while the pose moves. Pure: the caller passes the time.
//!
//! A frame passes two stages: the engine draws and encodes it; the link carries it, and the client decodes and acknowledges it.
//! The time of a frame in each stage is the time that it adds to the frame before, and at most the time that it takes by itself:
//!
//! ```text
//! engine   from when it was asked for, or the frame before was finished, whichever is later
//! link     the lesser of: since the acknowledgement before; from sending to acknowledgement, less the distance
//! ```
//!
//! The distance is the round trip of a ping sent while nothing else is in flight. The shortest time of a frame would not do: it
//! holds the transfer of the frame's own bytes, which a slow link would make look like distance. Before the first pong there is
//! no distance.
//!
//! The slower stage decides the size of moving frames: as many pixels as would meet [`TARGET`]; a slow link first lowers the
//! quality of JPEGs. Where the engine allows less than a quarter of the pixels, the accepted error grows in proportion, up to
//! [`MOST_COARSE`] times, because the cost of small frames of point trees depends on their detail and no longer on pixels. (The
//! plaza, drawn on a CPU, in shares of the cost at 640 × 480: 0.54 at 320 × 240, 0.39 at 160 × 120, and at that size 0.21 at
//! twice and 0.09 at four times the error.)
//!
//! Where the frames of the scene were measured, the planner chooses size and settings of moving frames instead: the most exact ones that are predicted to be drawn within
//! [`Pace::draw_ms`]. That is what the [stage] of the engine leaves of [`TARGET`].
//!
//! The window holds as many frames as fill the link at that pace and no more, so that a pose never waits behind pictures in
//! flight. A client that does not acknowledge gets one window of frames, which is one frame at first. The window is limited in
//! frames, and in bytes that the link was measured to carry in [`AHEAD`].

mod stage;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use stage::Stage;

/// Time per frame at which moving frames aim.
pub const TARGET: Duration = Duration::from_millis(33);
/// Smallest and largest number of frames in flight.
pub const MIN_WINDOW: usize = 2;
pub const MAX_WINDOW: usize = 8;
/// Longest time that the link may need for all bytes in flight, if they are more than one frame.
const AHEAD: Duration = Duration::from_millis(500);
/// Limit on bytes in flight before the link was measured: one frame, unless it is small.
const FIRST_BYTES: u64 = 16 << 10;
/// Smallest limit on bytes in flight.
const LEAST_BYTES: u64 = 8 << 10;
/// Smaller frames are not used to measure the link's rate.
const TELLING_BYTES: u64 = 2 << 10;
/// Smallest share of the requested pixels; a smaller picture is of no use.
const LEAST_PIXELS: f64 = 1.0 / 16.0;
/// Share of the requested pixels below which frames are coarser than requested.
const COARSE_PIXELS: f64 = 0.25;
/// Largest factor of the accepted error.
const MOST_COARSE: f64 = 4.0;
/// A client that has acknowledged no frame for this long, while the next one waits for that, may not know that it must.
const PATIENCE: Duration = Duration::from_secs(5);
const BEST_JPEG: f64 = 80.0;
const WORST_JPEG: f64 = 40.0;
/// Interval between measurements of the distance: network paths change.
const PING_PERIOD: Duration = Duration::from_secs(5);

/// Parameters of moving frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Factor of width and height.
    pub scale: f64,
    /// Factor of the accepted error, 1 or more.
    pub coarseness: f64,
    pub jpeg_quality: u8,
    /// Largest factor of width and height that the link allows.
    pub link_scale: f64,
    /// Longest predicted GPU time of a frame, in milliseconds.
    pub draw_ms: f64,
}

/// A frame that has not been acknowledged.
#[derive(Clone, Copy, Debug)]
struct Sent {
    number: u64,
    bytes: u64,
    at: Instant,
    /// Share of the requested pixels, if it is a moving frame.
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
    /// Average time of a moving frame on the link.
    link: Option<Duration>,
    /// Time of the last frame on the link.
    last_took: Option<Duration>,
    bytes_per_second: Option<f64>,
    /// Shares of the pixels that each stage allows.
    drawn_pixels: f64,
    link_pixels: f64,
    jpeg_quality: f64,
    stage: Stage,
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
            // Start small: the first frame should be there at once.
            drawn_pixels: 0.25,
            link_pixels: 0.25,
            jpeg_quality: 70.0,
            stage: Stage::default(),
        }
    }

    /// Returns whether one more frame may be requested while `asked` requested frames are outstanding.
    pub fn may_ask(&self, asked: usize) -> bool {
        let on_the_way = self.unacked.len() + asked;
        let bytes: u64 = self.unacked.iter().map(|sent| sent.bytes).sum();
        // The first frame goes alone, because its time on the link is unknown.
        let is_known = self.last_acked_at.is_some();
        on_the_way == 0 || (is_known && on_the_way < self.window() && bytes <= self.window_bytes())
    }

    /// Returns the number of frames that may be requested or in flight.
    pub fn window(&self) -> usize {
        let pace = self.link.unwrap_or(TARGET).max(TARGET);
        let fill = self.distance.unwrap_or_default().as_secs_f64() / pace.as_secs_f64();
        // On a quick link one frame waits at the engine, one is drawn, and a third is being acknowledged.
        let is_quick = self.last_took.is_some_and(|took| took < TARGET / 2);
        (MIN_WINDOW + usize::from(is_quick) + fill as usize).min(MAX_WINDOW)
    }

    fn window_bytes(&self) -> u64 {
        match self.bytes_per_second {
            Some(rate) => ((rate * AHEAD.as_secs_f64()) as u64).max(LEAST_BYTES),
            None => FIRST_BYTES,
        }
    }

    /// Returns the parameters of the next moving frames.
    pub fn pace(&self) -> Pace {
        Pace {
            scale: self.drawn_pixels.min(self.link_pixels).sqrt(),
            // Only fewer pixels help a slow link. The steps are few because frame costs are known by their errors.
            coarseness: quarter_octave((COARSE_PIXELS / self.drawn_pixels).clamp(1.0, MOST_COARSE)),
            jpeg_quality: self.jpeg_quality.round() as u8,
            link_scale: self.link_pixels.sqrt(),
            draw_ms: self.stage.draw_ms(TARGET),
        }
    }

    /// Returns the oldest unacknowledged frame, and the time after which its acknowledgement counts as missing. A client that has
    /// acknowledged before knows how, and may be on a slow link, so it gets more time.
    pub fn unacknowledged(&self) -> Option<(u64, Instant)> {
        let patience = if self.last_acked_at.is_none() { PATIENCE } else { PATIENCE * 4 };
        self.unacked.front().map(|sent| (sent.number, sent.at + patience))
    }

    /// Records a frame from the engine; a moving frame had `share` of the requested pixels, and a planned one a predicted GPU time.
    pub fn drawn(
        &mut self,
        asked: Instant,
        done: Instant,
        share: Option<f64>,
        predicted_ms: Option<f64>,
    ) {
        let began = self.last_drawn_at.map_or(asked, |last| last.max(asked));
        self.last_drawn_at = Some(done);
        if let Some(share) = share {
            let took = done.saturating_duration_since(began);
            if let Some(predicted_ms) = predicted_ms {
                self.stage.see(predicted_ms, took);
            }
            self.drawn_pixels = toward(self.drawn_pixels, share, took, self.drawn_pixels);
        }
    }

    /// Returns whether a ping should go out before the next frame, and records it as sent.
    pub fn ping(&mut self, now: Instant) -> bool {
        let is_due =
            self.pinged_at.is_none_or(|at| now.saturating_duration_since(at) >= PING_PERIOD);
        let goes = is_due && self.unacked.is_empty();
        if goes {
            (self.pinged_at, self.is_answered) = (Some(now), false);
        }
        goes
    }

    /// Records the answer to the last ping.
    pub fn ponged(&mut self, now: Instant) {
        if let Some(at) = self.pinged_at.filter(|_| !self.is_answered) {
            self.is_answered = true;
            self.distance = Some(now.saturating_duration_since(at));
        }
    }

    /// Records a frame handed to the socket; numbers increase.
    pub fn sent(&mut self, number: u64, bytes: u64, now: Instant, share: Option<f64>) {
        self.last_sent = number;
        self.unacked.push_back(Sent { number, bytes, at: now, share });
    }

    /// Records that the client has frame `number` and all before it.
    ///
    /// # Errors
    /// The last number sent, when `number` is beyond it.
    pub fn acked(&mut self, number: u64, now: Instant) -> Result<(), u64> {
        if number > self.last_sent {
            return Err(self.last_sent);
        }
        while let Some(sent) = self.unacked.front().copied().filter(|sent| sent.number <= number) {
            self.unacked.pop_front();
            // The arrival time of a frame that is acknowledged along with a later one is unknown.
            if sent.number == number {
                self.arrived(sent, now);
            }
        }
        Ok(())
    }

    fn arrived(&mut self, sent: Sent, now: Instant) {
        let took = now.saturating_duration_since(sent.at);
        // The distance is at most this frame's round trip.
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
        // Planned frames have few sizes: a share between two of them must be able to grow.
        self.link_pixels = toward(self.link_pixels, share, took, self.link_pixels);
    }
}

/// Rounds to quarter octaves.
fn quarter_octave(factor: f64) -> f64 {
    ((4.0 * factor.log2()).round() / 4.0).exp2()
}

/// Moves a share of pixels toward the share that would take [`TARGET`], given that `pixels` took `took`. Growth goes in small
/// steps from `from`, because larger frames have not been measured.
fn toward(share: f64, pixels: f64, took: Duration, from: f64) -> f64 {
    let ratio = TARGET.as_secs_f64() / took.as_secs_f64().max(1e-4);
    let aim = (pixels * ratio).clamp(0.25 * pixels, 1.5 * from.max(pixels));
    (share.powf(0.6) * aim.clamp(LEAST_PIXELS, 1.0).powf(0.4)).clamp(LEAST_PIXELS, 1.0)
}

#[cfg(test)]
mod tests;
