//! The stage of the engine for planned frames: how long they take beside their predicted GPU time. Pure.

use std::time::Duration;

/// Decay of the weights: what is left of a frame's weight after each later one.
const KEPT: f64 = 0.9;
/// Standard deviation of predicted times, in milliseconds, at which the fitted factor is halfway from 1 to that of least squares.
const TELLING_MS: f64 = 3.0;
/// Range of the factor.
const FACTORS: [f64; 2] = [0.5, 8.0];
/// Least share of the target that frames are predicted to take: the frames of others may take the rest.
const LEAST: f64 = 0.125;
/// Share of the target before the first frame.
const FIRST: f64 = 0.5;

/// A line through predicted and taken times of the last frames, by weighted least squares: a fixed time for what surrounds the drawing, and a factor
/// by which predictions are off.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stage {
    /// Sums of the weights, of predicted and of taken times in milliseconds, of the predicted ones' squares and of the products.
    weight: f64,
    predicted: f64,
    taken: f64,
    squares: f64,
    products: f64,
}

impl Stage {
    /// Takes a frame into account that added `took` to the time of the frame before.
    pub fn see(&mut self, predicted_ms: f64, took: Duration) {
        let took_ms = 1e3 * took.as_secs_f64();
        let add = |sum: &mut f64, value: f64| *sum = KEPT * *sum + value;
        add(&mut self.weight, 1.0);
        add(&mut self.predicted, predicted_ms);
        add(&mut self.taken, took_ms);
        add(&mut self.squares, predicted_ms * predicted_ms);
        add(&mut self.products, predicted_ms * took_ms);
    }

    /// The longest predicted GPU time of frames that come within the target, in milliseconds.
    pub fn draw_ms(&self, target: Duration) -> f64 {
        let target_ms = 1e3 * target.as_secs_f64();
        if self.weight == 0.0 {
            return FIRST * target_ms;
        }
        rounded(self.fitted_ms(target_ms))
    }

    fn fitted_ms(&self, target_ms: f64) -> f64 {
        let (predicted, taken) = (self.predicted / self.weight, self.taken / self.weight);
        let variance = (self.squares / self.weight - predicted * predicted).max(0.0);
        let covariance = self.products / self.weight - predicted * taken;
        // Equal predictions tell no factor: then it is 1.
        let doubt = TELLING_MS * TELLING_MS;
        let [least, most] = FACTORS;
        let factor = ((covariance + doubt) / (variance + doubt)).clamp(least, most);
        let fixed = (taken - factor * predicted).max(0.0);
        ((target_ms - fixed) / factor).clamp(LEAST * target_ms, target_ms / least)
    }
}

/// Rounds down to eighths of an octave, so that streams of one scene ask for equal frames.
fn rounded(ms: f64) -> f64 {
    ((8.0 * ms.log2()).floor() / 8.0).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: Duration = Duration::from_millis(33);

    /// The time that the last of many frames took, each as near below its budget as the predicted times allow.
    fn settled(predicted: &[f64], takes: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut stage = Stage::default();
        let frames = (0..100).map(|_| {
            let budget = stage.draw_ms(TARGET);
            let fits = predicted.iter().copied().filter(|ms| *ms <= budget);
            let ms = fits.fold(predicted[0], f64::max);
            stage.see(ms, Duration::from_secs_f64(1e-3 * takes(ms)));
            takes(ms)
        });
        frames.collect::<Vec<f64>>().split_off(50)
    }

    #[test]
    fn frames_come_as_near_to_the_target_as_their_times_allow() {
        let fine: Vec<f64> = (1..200).map(|step| 0.5 * f64::from(step)).collect();
        for takes in [|ms: f64| ms + 6.0, |ms: f64| 2.0 * ms, |ms: f64| 0.5 * ms + 3.0] {
            let taken = settled(&fine, takes);
            let [least, most] = [f64::min, f64::max].map(|by| taken.iter().copied().fold(20.0, by));
            assert!(least >= 20.0 && most <= 36.0, "{taken:?}");
        }
        // Few settings to choose from: the best one stays.
        let few = settled(&[2.0, 20.0, 40.0], |ms| ms + 5.0);
        assert!(few.iter().all(|ms| *ms == 25.0), "{few:?}");
    }

    #[test]
    fn slow_engines_leave_a_little() {
        let taken = settled(&[1.0, 10.0], |ms| ms + 100.0);
        assert!(taken.iter().all(|ms| *ms == 101.0), "{taken:?}");
        let mut stage = Stage::default();
        assert_eq!(stage.draw_ms(TARGET), 16.5);
        stage.see(0.0, Duration::ZERO);
        assert!(stage.draw_ms(TARGET).is_finite());
    }
}
