//! How much of the way between two keys has been made at a time.
//!
//! The way from a key to the next is a cubic of time. Its slope at either end is what the ease says: nothing where the camera
//! starts from rest or comes to rest, and with [`Ease::Smooth`] what lets the camera's velocity go over from one part of the path to
//! the next without a jump, though the keys' times are not in proportion to what lies between them. That slope is the weighted
//! harmonic mean of the speeds before and after (F. N. Fritsch, J. Butland, *A Method for Constructing Local Monotone Piecewise Cubic
//! Interpolants*, SIAM J. Sci. Stat. Comput. 5, 1984): the camera never turns back, and stops where it pauses.
//!
//! Speeds are compared in what the position depends on: knots of the curve, or lengths of straight lines. Where the camera stays in
//! its place and turns, they are angles; where it goes over from one to the other it comes to rest.

use super::Ease;

/// The part between two keys.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    pub duration_s: f64,
    /// The way's length, in what positions depend on linearly; `None` where the camera stays in its place.
    pub length: Option<f64>,
    /// Between the orientations, in radians.
    pub angle: f64,
    /// How it begins and ends.
    pub ease: Ease,
}

/// A cubic of time from 0 to 1, or a wait for the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Way {
    Cubic { slope_first: f64, slope_last: f64 },
    Hold,
}

/// Slopes up to this at both ends keep a cubic from turning back (C. de Boor, B. Swartz, 1977).
const STEEPEST: f64 = 3.0;

impl Part {
    /// How much there is to do, in the measure that `other` has; `None` where theirs differ or nothing is to be done.
    fn amount_beside(&self, other: &Part) -> Option<f64> {
        let amount = match (self.length, other.length) {
            (Some(length), Some(_)) => length,
            (None, None) => self.angle,
            _ => return None,
        };
        (amount > 1e-12).then_some(amount)
    }

    /// Slopes at both ends, of one who does not look at the neighbours.
    fn own_slopes(&self) -> Option<[f64; 2]> {
        match self.ease {
            Ease::Smooth => None,
            Ease::Linear => Some([1.0, 1.0]),
            Ease::In => Some([0.0, 2.0]),
            Ease::Out => Some([2.0, 0.0]),
            Ease::InOut | Ease::Hold => Some([0.0, 0.0]),
        }
    }
}

impl Way {
    /// The way of a path's part `index`.
    pub fn of(parts: &[Part], index: usize) -> Way {
        let part = &parts[index];
        if part.ease == Ease::Hold {
            return Way::Hold;
        }
        if let Some([slope_first, slope_last]) = part.own_slopes() {
            return Way::Cubic { slope_first, slope_last };
        }
        let before = index.checked_sub(1).map(|i| &parts[i]);
        Way::Cubic {
            slope_first: before.map_or(1.0, |other| beside(part, other, 1)),
            slope_last: parts.get(index + 1).map_or(1.0, |other| beside(part, other, 0)),
        }
    }

    /// How much of the way has been made after `elapsed` of its time; both between 0 and 1.
    pub fn made(self, elapsed: f64) -> f64 {
        let Way::Cubic { slope_first, slope_last } = self else {
            return if elapsed < 1.0 { 0.0 } else { 1.0 };
        };
        let (u, v) = (elapsed, 1.0 - elapsed);
        (u * u * (3.0 - 2.0 * u) + slope_first * u * v * v - slope_last * u * u * v).clamp(0.0, 1.0)
    }
}

/// Slope of a smooth part at the key that it shares with `other`, whose end `end` is there.
fn beside(part: &Part, other: &Part, end: usize) -> f64 {
    let (Some(own), Some(theirs)) = (part.amount_beside(other), other.amount_beside(part)) else {
        return 0.0;
    };
    let (h, h_other) = (part.duration_s, other.duration_s);
    // Their speed, where one is what makes the whole of this part in its time.
    let speed = theirs / h_other * h / own;
    let slope = match other.own_slopes() {
        Some(slopes) => slopes[end] * speed,
        None => {
            let (weight, weight_other) = (2.0 * h_other + h, 2.0 * h + h_other);
            (weight + weight_other) / (weight + weight_other / speed)
        }
    };
    slope.min(STEEPEST)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const EASES: [Ease; 6] =
        [Ease::Smooth, Ease::Linear, Ease::In, Ease::Out, Ease::InOut, Ease::Hold];

    fn part() -> impl Strategy<Value = Part> {
        let length = prop_oneof![Just(None), (1e-3..1e3f64).prop_map(Some)];
        let angle = prop_oneof![Just(0.0), 0.0..3.2f64];
        (1e-3..1e3f64, length, angle, prop::sample::select(&EASES[..]))
            .prop_map(|(duration_s, length, angle, ease)| Part { duration_s, length, angle, ease })
    }

    #[test]
    fn eases_at_half_time() {
        let at = |ease, elapsed: f64| {
            Way::of(&[Part { duration_s: 2.0, length: Some(1.0), angle: 0.0, ease }], 0)
                .made(elapsed)
        };
        for (ease, half) in EASES.into_iter().zip([0.5, 0.5, 0.25, 0.75, 0.5, 0.0]) {
            assert_eq!((at(ease, 0.0), at(ease, 0.5), at(ease, 1.0)), (0.0, half, 1.0), "{ease:?}");
        }
        assert!((at(Ease::In, 0.3) - 0.09).abs() < 1e-15);
        assert!((at(Ease::Out, 0.3) - 0.51).abs() < 1e-15);
        assert!((at(Ease::InOut, 0.25) - 0.15625).abs() < 1e-15);
        assert!((at(Ease::Linear, 0.37) - 0.37).abs() < 1e-15);
    }

    #[test]
    fn even_keys_are_passed_evenly() {
        let part = Part { duration_s: 0.5, length: Some(3.0), angle: 0.1, ease: Ease::Smooth };
        let parts = [part; 3];
        for index in 0..3 {
            assert_eq!(Way::of(&parts, index), Way::Cubic { slope_first: 1.0, slope_last: 1.0 });
        }
        // The length of a turn on the spot.
        let parts = parts.map(|part| Part { length: None, ..part });
        assert_eq!(Way::of(&parts, 1), Way::Cubic { slope_first: 1.0, slope_last: 1.0 });
    }

    #[test]
    fn a_pause_is_come_to_rest_for() {
        let moves = Part { duration_s: 1.0, length: Some(2.0), angle: 0.3, ease: Ease::Smooth };
        let pause = Part { length: None, angle: 0.0, ..moves };
        let parts = [moves, pause, moves];
        assert_eq!(Way::of(&parts, 0), Way::Cubic { slope_first: 1.0, slope_last: 0.0 });
        assert_eq!(Way::of(&parts, 1), Way::Cubic { slope_first: 0.0, slope_last: 0.0 });
        assert_eq!(Way::of(&parts, 2), Way::Cubic { slope_first: 0.0, slope_last: 1.0 });
    }

    proptest! {
        #[test]
        fn nobody_turns_back(parts in prop::collection::vec(part(), 1..6)) {
            for index in 0..parts.len() {
                let way = Way::of(&parts, index);
                prop_assert_eq!((way.made(0.0), way.made(1.0)), (0.0, 1.0));
                let mut last = 0.0;
                for step in 0..=100 {
                    let made = way.made(f64::from(step) / 100.0);
                    prop_assert!(made >= last - 1e-12, "{made} after {last}: {way:?}");
                    last = made;
                }
            }
        }

        /// Both sides of a key between two smooth parts have the same speed.
        #[test]
        fn smooth_parts_meet_at_one_speed(mut a in part(), mut b in part()) {
            (a.ease, b.ease) = (Ease::Smooth, Ease::Smooth);
            let amounts = match (a.length, b.length) {
                (Some(a), Some(b)) => [a, b],
                (None, None) => [a.angle, b.angle],
                _ => [1.0, 1.0],
            };
            let parts = [a, b];
            let (Way::Cubic { slope_last, .. }, Way::Cubic { slope_first, .. }) = (Way::of(&parts, 0), Way::of(&parts, 1)) else {
                return Err(TestCaseError::fail("a smooth part that holds"));
            };
            let arrives = slope_last * amounts[0] / a.duration_s;
            let leaves = slope_first * amounts[1] / b.duration_s;
            prop_assert!((arrives - leaves).abs() <= 1e-9 * (arrives + leaves), "{arrives} {leaves}");
        }
    }
}
