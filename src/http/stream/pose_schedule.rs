//! Decides which pose to draw next, and how well. Pure: the caller passes the time.
//!
//! ```text
//! set ──▶ new ──▶ moving frame asked for ──REST, nothing newer──▶ still frame asked for
//!          └─── moving: false, or nothing newer for REST ────────────▲
//! again (the scene changed): back to new
//! ```

use std::time::{Duration, Instant};

use super::wire::Quality;

/// A pose is at rest when none has followed for this long.
pub const REST: Duration = Duration::from_millis(200);

/// The newest pose and the state of its frames. `P` describes the pose.
#[derive(Debug)]
pub struct PoseSchedule<P> {
    aim: Option<Aim<P>>,
    /// Number of poses that a newer one replaced before any frame of them was requested.
    overtaken: u64,
}

#[derive(Debug)]
struct Aim<P> {
    seq: u64,
    pose: P,
    arrived: Instant,
    may_move: bool,
    /// Quality of the best frame requested so far.
    asked: Option<Quality>,
}

impl<P> PoseSchedule<P> {
    pub fn new() -> Self {
        Self { aim: None, overtaken: 0 }
    }

    /// Sets a newer pose. The previous pose counts as overtaken if no frame of it was requested.
    pub fn set(&mut self, seq: u64, pose: P, moving: Option<bool>, now: Instant) {
        if self.aim.as_ref().is_some_and(|aim| aim.asked.is_none()) {
            self.overtaken += 1;
        }
        let may_move = moving != Some(false);
        self.aim = Some(Aim { seq, pose, arrived: now, may_move, asked: None });
    }

    /// Returns the pose to request now, and its quality.
    pub fn wanted(&self, now: Instant) -> Option<(u64, &P, Quality)> {
        let aim = self.aim.as_ref()?;
        let may_move = aim.may_move && now < aim.arrived + REST;
        let quality = match (aim.asked, may_move) {
            (None, true) => Quality::Moving,
            (None | Some(Quality::Moving), false) => Quality::Still,
            _ => return None,
        };
        Some((aim.seq, &aim.pose, quality))
    }

    /// Returns the time when a frame will be wanted even if no message arrives.
    pub fn wake_at(&self, now: Instant) -> Option<Instant> {
        let aim = self.aim.as_ref()?;
        let rests = aim.arrived + REST;
        (aim.may_move && aim.asked != Some(Quality::Still) && rests > now).then_some(rests)
    }

    /// Records that the wanted frame was requested. After `Still`, nothing better follows.
    pub fn asked(&mut self, quality: Quality) {
        if let Some(aim) = &mut self.aim {
            aim.asked = Some(quality);
        }
    }

    /// Records that a requested frame of pose `seq` will not come, because a newer request replaced it.
    pub fn replaced(&mut self, seq: u64) {
        if self.aim.as_ref().is_none_or(|aim| aim.seq != seq) {
            self.overtaken += 1;
        }
    }

    /// Has the pose drawn once more.
    pub fn again(&mut self) {
        if let Some(aim) = &mut self.aim {
            aim.asked = None;
        }
    }

    /// Drops the pose, which cannot be drawn.
    pub fn give_up(&mut self) {
        self.aim = None;
    }

    pub fn overtaken(&self) -> u64 {
        self.overtaken
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn moving_then_still() {
        let start = Instant::now();
        let mut schedule = PoseSchedule::new();
        assert!(schedule.wanted(start).is_none());
        schedule.set(1, 'a', None, start);
        assert_eq!(schedule.wanted(start), Some((1, &'a', Quality::Moving)));
        schedule.asked(Quality::Moving);
        assert!(schedule.wanted(start + 10 * MS).is_none());
        assert_eq!(schedule.wake_at(start + 10 * MS), Some(start + REST));
        assert_eq!(schedule.wanted(start + REST), Some((1, &'a', Quality::Still)));
        schedule.asked(Quality::Still);
        assert!(schedule.wanted(start + 9 * REST).is_none());
        assert!(schedule.wake_at(start + 9 * REST).is_none());
        schedule.again();
        assert_eq!(schedule.wanted(start + 9 * REST), Some((1, &'a', Quality::Still)));
    }

    #[test]
    fn what_is_said_to_rest_is_drawn_well_at_once() {
        let start = Instant::now();
        let mut schedule = PoseSchedule::new();
        schedule.set(1, (), Some(false), start);
        assert_eq!(schedule.wanted(start).map(|wanted| wanted.2), Some(Quality::Still));
        assert!(schedule.wake_at(start).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, rng_seed: RngSeed::Fixed(0x51ea_0002), ..ProptestConfig::default() })]
        /// For every order of poses and requests: no pose older than the newest is requested, each pose is requested at most once
        /// moving and once still, the last one ends still, and each pose is either drawn or counted as overtaken.
        #[test]
        fn the_newest_pose_wins(steps in prop::collection::vec((0u64..150, 0u8..6), 1..120)) {
            let mut now = Instant::now();
            let mut schedule = PoseSchedule::new();
            let mut newest = 0;
            let mut asked: Vec<(u64, Quality)> = Vec::new();
            for (ms, what) in steps {
                now += Duration::from_millis(ms);
                match what {
                    0..3 => {
                        newest += 1;
                        let moving = [None, Some(true), Some(false)][usize::from(what)];
                        schedule.set(newest, (), moving, now);
                    }
                    _ => if let Some((seq, (), quality)) = schedule.wanted(now) {
                        prop_assert_eq!(seq, newest);
                        prop_assert!(!asked.contains(&(seq, quality)));
                        asked.push((seq, quality));
                        schedule.asked(quality);
                    }
                }
            }
            while schedule.wanted(now).is_some() || schedule.wake_at(now).is_some() {
                if let Some((seq, (), quality)) = schedule.wanted(now) {
                    asked.push((seq, quality));
                    schedule.asked(quality);
                }
                now = schedule.wake_at(now).unwrap_or(now);
            }
            let mut drawn: Vec<u64> = asked.iter().map(|asked| asked.0).collect();
            drawn.dedup();
            prop_assert_eq!(drawn.len() as u64 + schedule.overtaken(), newest);
            if newest > 0 {
                prop_assert_eq!(asked.last(), Some(&(newest, Quality::Still)));
            }
        }
    }
}
