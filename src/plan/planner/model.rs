//! Predictions from measured frames: a linear model of the time, and errors of similar poses.
//!
//! The time of a setting is a sum of parts that grow with the pixels, the covered pixels, the elements and their area, each with a factor that is not
//! negative (Lawson and Hanson 1974). The factors are fitted to relative errors. What the sum leaves over at similar poses corrects it. The error
//! of a setting is the mean of its decibels at similar poses, per covered pixel. How far predictions of measured poses are off, when each is
//! left out in turn, gives the margins.

use serde::{Deserialize, Serialize};

use super::ground::{Ground, Load};

/// Parts of a time.
const PARTS: usize = 7;
/// Rounds of the coordinate descent that fits the factors. Some parts nearly grow together, so that it needs many.
const ROUNDS: usize = 20_000;
/// Rounds after one of the poses is left out: the factors begin at those of all poses.
const MORE_ROUNDS: usize = 1000;
/// Bandwidth of likeness, in octaves: a pose this far away counts for 1/e of one that is equal.
const LIKE: f64 = 0.7;
/// Weight of what is known of no similar pose: predictions far from all measurements are those of the sum alone.
const PRIOR: f64 = 0.3;
/// Share of the poses whose time a frame that is meant to fit a budget does not exceed.
const KEPT_SHARE: f64 = 0.95;
/// What is added to the largest error found among measured poses: others may be worse.
const CAUTION_DB: f64 = 0.5;
/// Mean squared error of equal frames: they have 99 dB.
const LEAST_MSE: f64 = 65025.0 / 7.943_282_347e9;
/// Least number of measured poses from which anything is predicted.
pub const LEAST_POSES: usize = 8;

/// A measured frame: mean squared error of its bytes, and time in ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub mse: f64,
    pub ms: f64,
}

/// What the level of detail, the antialiasing and the size of a setting mean for its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Accepted error of `lod=spt`, in pixels of the frame as it is shown; `None` at full detail.
    pub error_px: Option<f64>,
    /// Drawn pixels, for each pixel that is shown.
    pub parts: f64,
}

/// The fitted model of one setting.
#[derive(Clone, Debug)]
pub struct Model {
    effort: Effort,
    factors: [f64; PARTS],
    /// Ground, logarithm of time over the sum, and decibels per covered pixel of each measured pose.
    known: Vec<(Ground, f64, f64)>,
    /// Logarithm of the time's margin, and the decibels' margin.
    margin_log: f64,
    margin_db: f64,
}

/// A predicted frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    pub ms: f64,
    /// Time that 95 of 100 measured poses keep.
    pub most_ms: f64,
    pub psnr_db: f64,
    /// Decibels that all measured poses keep.
    pub least_psnr_db: f64,
}

impl Prediction {
    /// The longer time and the larger error of two frames.
    #[must_use]
    pub fn worse(self, other: Prediction) -> Prediction {
        Prediction {
            ms: self.ms.max(other.ms),
            most_ms: self.most_ms.max(other.most_ms),
            psnr_db: self.psnr_db.min(other.psnr_db),
            least_psnr_db: self.least_psnr_db.min(other.least_psnr_db),
        }
    }
}

impl Model {
    /// Fits the measured frames of a setting. `None` for fewer than [`LEAST_POSES`].
    pub fn fit(effort: Effort, points: &[(Ground, Point)]) -> Option<Model> {
        let usable = |(_, point): &&(Ground, Point)| {
            point.ms > 0.0 && point.ms.is_finite() && point.mse >= 0.0 && point.mse.is_finite()
        };
        let points: Vec<&(Ground, Point)> = points.iter().filter(usable).collect();
        if points.len() < LEAST_POSES {
            return None;
        }
        let rows: Vec<[f64; PARTS]> = points
            .iter()
            .map(|(ground, point)| parts(ground, effort).map(|part| part / point.ms))
            .collect();
        let factors = nonnegative(&rows, [0.0; PARTS], ROUNDS);
        let known = points
            .iter()
            .map(|(ground, point)| {
                let db = decibels(point.mse / ground.covered.max(LEAST_COVERED));
                (ground.clone(), (point.ms / sum(&factors, ground, effort)).ln(), db)
            })
            .collect();
        let mut model = Model { effort, factors, known, margin_log: 0.0, margin_db: 0.0 };
        let (mut late, mut worse): (Vec<f64>, Vec<f64>) = (0..model.known.len())
            .map(|index| {
                // As if the pose had not been measured.
                let others: Vec<[f64; PARTS]> = rows
                    .iter()
                    .enumerate()
                    .filter(|(at, _)| *at != index)
                    .map(|(_, row)| *row)
                    .collect();
                let own = nonnegative(&others, factors, MORE_ROUNDS);
                let (ground, log, db) = &model.known[index];
                let (mean_log, mean_db) = model.means(ground, Some(index));
                let moved = (sum(&factors, ground, effort) / sum(&own, ground, effort)).ln();
                (log + moved - mean_log, mean_db - db)
            })
            .unzip();
        late.sort_unstable_by(f64::total_cmp);
        worse.sort_unstable_by(f64::total_cmp);
        let at = ((late.len() as f64 * KEPT_SHARE).ceil() as usize).clamp(1, late.len()) - 1;
        model.margin_log = late[at].max(0.0);
        model.margin_db = worse.last().copied().unwrap_or(0.0).max(0.0) + CAUTION_DB;
        Some(model)
    }

    /// Means of the logarithms and of the decibels at poses like this one, without one of them.
    fn means(&self, ground: &Ground, without: Option<usize>) -> (f64, f64) {
        let (mut weights, mut log, mut db) = (0.0, 0.0, 0.0);
        let (mut near, mut nearest) = (f64::INFINITY, 0.0);
        for (index, (other, own_log, own_db)) in self.known.iter().enumerate() {
            if Some(index) == without {
                continue;
            }
            let distance2 = ground.distance2(other);
            let weight = (-distance2 / (LIKE * LIKE)).exp();
            weights += weight;
            log += weight * own_log;
            db += weight * own_db;
            if distance2 < near {
                (near, nearest) = (distance2, *own_db);
            }
        }
        // Far from all poses the nearest one alone tells the error.
        let far = PRIOR * 1e-2;
        (log / (weights + PRIOR), (db + far * nearest) / (weights + far))
    }

    /// Predicts a frame. `pace` is how many times longer than measured frames take now.
    pub fn predict(&self, ground: &Ground, pace: f64) -> Prediction {
        let (log, db) = self.means(ground, None);
        let ms = sum(&self.factors, ground, self.effort) * log.exp() * pace;
        let psnr_db = db + decibels(ground.covered.max(LEAST_COVERED)) - decibels(1.0);
        Prediction {
            ms,
            most_ms: ms * self.margin_log.exp(),
            psnr_db,
            least_psnr_db: psnr_db - self.margin_db,
        }
    }
}

/// Smallest covered share by which errors are divided.
const LEAST_COVERED: f64 = 1e-3;

fn decibels(mse: f64) -> f64 {
    10.0 * (65025.0 / mse.max(LEAST_MSE)).log10()
}

/// The parts of a frame's time, each of which has a factor.
fn parts(ground: &Ground, effort: Effort) -> [f64; PARTS] {
    let Load { samples, triangles, segments, area } = ground.load(effort.error_px);
    let drawn = ground.pixels * effort.parts;
    [1.0, drawn, drawn * ground.covered, samples, triangles, segments, area * effort.parts]
}

fn sum(factors: &[f64; PARTS], ground: &Ground, effort: Effort) -> f64 {
    let parts = parts(ground, effort);
    let sum: f64 = factors.iter().zip(parts).map(|(factor, part)| factor * part).sum();
    sum.max(f64::MIN_POSITIVE)
}

/// The factors that are not negative and bring the rows nearest to 1, by least squares (coordinate descent).
fn nonnegative(rows: &[[f64; PARTS]], start: [f64; PARTS], rounds: usize) -> [f64; PARTS] {
    let all: [usize; PARTS] = std::array::from_fn(|column| column);
    // Columns of unit length, so that none is lost to rounding.
    let lengths = all.map(|column| rows.iter().map(|row| row[column].powi(2)).sum::<f64>().sqrt());
    let unit =
        |row: &[f64; PARTS], column: usize| row[column] / lengths[column].max(f64::MIN_POSITIVE);
    let wanted = all.map(|column| rows.iter().map(|row| unit(row, column)).sum::<f64>());
    let products = all.map(|column| {
        all.map(|other| rows.iter().map(|row| unit(row, column) * unit(row, other)).sum::<f64>())
    });
    let mut factors = all.map(|column| start[column] * lengths[column]);
    for _ in 0..rounds {
        for column in all {
            let found: f64 =
                all.iter().map(|&other| factors[other] * products[column][other]).sum();
            factors[column] = f64::max(factors[column] + wanted[column] - found, 0.0);
        }
    }
    all.map(|column| if lengths[column] > 0.0 { factors[column] / lengths[column] } else { 0.0 })
}
