//! Checks that the outlines of splats stay accurate in f32 in numerically hard cases: `pointillist accuracy --stability`.
//!
//! [`cases`] draws random splats of each class. [`device`] runs the shaders' own `make_splat` on them on the adapter, with the
//! perspective and the exact filter, without low-pass. [`truth`] computes the exact results in f64 and bounds on the effect of
//! rounding. A row of the report has the worst errors of the edges of the box, the centre, the outline in 16 directions, all
//! clamped to ±2²⁰ px, and of the kernel coordinates on the outline. [`formulas`] has other formulas for the outline, on the CPU,
//! for comparison.

pub mod cases;
pub mod device;
pub mod formulas;
mod report;
pub mod truth;

use glam::{DVec2, Vec2};
use rayon::prelude::*;
use serde::Serialize;

use super::steady::Steadiness;
use crate::gpu::GpuError;
use crate::gpu::shader::ShaderError;
use crate::scene::random::SplitMix64;
use cases::{Case, Class, Lens};
use device::{Device, Filter, Found, Probe, Side};
use formulas::Outline;
use truth::{DIRECTIONS, GUARD_PX, TrueSide, Truth, direction, hold, is_bounded};

/// Largest side of an image.
const IMAGE_PX: f64 = 16_384.0;

/// Number of splats per dispatch.
const AT_ONCE: u32 = 4096;

/// Why the report cannot be made.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StabilityError {
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error(transparent)]
    Shader(#[from] ShaderError),
    #[error("the GPU was lost while it measured splats; run the command again")]
    Lost,
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stability {
    /// The adapter that ran the shaders.
    pub adapter: String,
    pub seed: u64,
    /// Number of splats per class.
    pub count: u32,
    /// Condition number above which the paper's inverse is discarded.
    pub condition_max: f32,
    pub rows: Vec<Row>,
    /// Whether every row holds.
    pub holds: bool,
    /// Random views of scenes.
    pub scenes: Vec<Steadiness>,
}

/// One class of splats.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Row {
    pub class: String,
    /// Splats entirely in front of the camera plane, which are those with an outline.
    pub regular: u32,
    /// Regular splats for which rounding leaves some error without a bound within ±2²⁰ px. That error is not judged.
    pub unbounded: u32,
    pub ours_box: Judged,
    pub ours_centre: Judged,
    pub ours_outline: Judged,
    /// Kernel coordinates of the exact filter at points of the true outline.
    pub ours_exact: Judged,
    /// Points of outlines that `ours_exact` judges.
    pub exact_judged: u32,
    /// Points of outlines that `ours_exact` leaves out, because the disk is thinner there than rounding can resolve.
    pub exact_unresolved: u32,
    pub dual_difference: Compared,
    pub dual_naive: Compared,
    pub paper: Compared,
    /// Splats that the paper discards by their condition number.
    pub paper_discarded: u32,
    /// Splats for which one of our numbers is NaN or infinite.
    pub ours_not_finite: u32,
    /// Splats on the wrong side of the camera plane, although rounding does not hide the right one.
    pub misclassified: u32,
    pub holds: bool,
}

/// Errors and their bounds, in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Judged {
    pub worst_px: f64,
    /// The largest bound of all splats.
    pub bound_px: f64,
    /// The largest ratio of a splat's error to its bound; up to 1 the bounds hold.
    pub worst_share: f64,
}

/// Errors of a formula that is only compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Compared {
    pub worst_px: f64,
    /// Error of edges of boxes within an image.
    pub box_in_image_px: f64,
    pub over_half_px: u32,
    pub not_finite: u32,
}

impl Judged {
    fn add(&mut self, error_px: f64, bound_px: f64) {
        self.worst_px = self.worst_px.max(error_px);
        self.bound_px = self.bound_px.max(bound_px);
        // An error of 0 is within a bound of 0. NaN is counted elsewhere, but must not hold here.
        let share = if error_px <= bound_px && bound_px == 0.0 { 0.0 } else { error_px / bound_px };
        self.worst_share = if share.is_nan() { f64::INFINITY } else { self.worst_share.max(share) };
    }

    fn join(self, other: Judged) -> Judged {
        Judged {
            worst_px: self.worst_px.max(other.worst_px),
            bound_px: self.bound_px.max(other.bound_px),
            worst_share: self.worst_share.max(other.worst_share),
        }
    }

    fn holds(&self) -> bool {
        self.worst_share <= 1.0
    }
}

impl Compared {
    fn add(&mut self, outline: &Outline, truth: &Truth) {
        if !outline.is_finite() {
            self.not_finite += 1;
            return;
        }
        let errors = Errors::of(outline, truth);
        let worst = errors.box_px.max(errors.centre_px).max(errors.outline_px);
        self.worst_px = self.worst_px.max(worst);
        self.box_in_image_px = self.box_in_image_px.max(errors.box_in_image_px);
        self.over_half_px += u32::from(worst > 0.5);
    }
}

/// Distances of an outline from the true one, in pixels.
struct Errors {
    box_px: f64,
    box_in_image_px: f64,
    centre_px: f64,
    outline_px: f64,
}

impl Errors {
    fn of(outline: &Outline, truth: &Truth) -> Errors {
        let far = |a: f64, b: f64| (hold(a) - hold(b)).abs();
        let both =
            |a: glam::Vec2, b: glam::DVec2| far(f64::from(a.x), b.x).max(far(f64::from(a.y), b.y));
        let [low, high] = truth.corners();
        let in_image =
            |a: f32, b: f64| if b.abs() <= IMAGE_PX { far(f64::from(a), b) } else { 0.0 };
        let corner = |a: glam::Vec2, b: glam::DVec2| in_image(a.x, b.x).max(in_image(a.y, b.y));
        let support = |i: usize| {
            let d = direction(i);
            far(outline.support(d), truth.support(d))
        };
        Errors {
            box_px: both(outline.min, low).max(both(outline.max, high)),
            box_in_image_px: corner(outline.min, low).max(corner(outline.max, high)),
            centre_px: both(outline.centre, truth.centre()),
            outline_px: (0..DIRECTIONS).map(support).fold(0.0, f64::max),
        }
    }
}

/// Judges `count` splats of every class. Equal seeds give equal reports on equal adapters.
///
/// # Errors
/// There is no adapter, or it is lost.
pub fn stability(seed: u64, count: u32) -> Result<Stability, StabilityError> {
    let device = Device::open()?;
    let mut rows = Vec::new();
    for (index, class) in cases::classes().iter().enumerate() {
        let mut random = SplitMix64::stream(seed, index as u64);
        let mut row = Row { class: class.name(), ..Row::default() };
        let mut left = count;
        while left > 0 {
            let some = left.min(AT_ONCE);
            row.add_class(class, some, &mut random, &device)?;
            left -= some;
        }
        row.holds = row.verdict();
        rows.push(row);
    }
    let holds = rows.iter().all(|row| row.holds);
    let adapter = device.adapter().to_owned();
    Ok(Stability {
        adapter,
        seed,
        count,
        condition_max: formulas::CONDITION_MAX,
        rows,
        holds,
        scenes: Vec::new(),
    })
}

/// The points at which kernel coordinates are compared: on the splat's outline, rounded to f32 as pixel coordinates are.
fn points_px(truth: &TrueSide) -> [Vec2; DIRECTIONS] {
    std::array::from_fn(|i| match truth {
        TrueSide::Regular(truth) => (truth.projected + truth.seen(direction(i))).as_vec2(),
        _ => Vec2::ZERO,
    })
}

/// The error of an edge of a pixel box. `pixel` is the first pixel whose centre is in the box, or the first one behind the box.
/// The pixel `own` of the disk's centre belongs to the box in any case.
fn edge_error_px(pixel: i32, truth_px: f64, own: f64, is_low: bool) -> f64 {
    let (pixel, last) = (f64::from(pixel), IMAGE_PX - 1.0);
    let (edge, truth_px) = match is_low {
        true => (pixel, truth_px.clamp(0.0, last + 1.0)),
        false => (pixel + 1.0, truth_px.clamp(0.0, last + 1.0)),
    };
    // The true edge lies within half a pixel of `edge`. At the own pixel, only a box that is too small is an error.
    let outside = if is_low { edge - truth_px } else { truth_px - edge };
    match pixel == own {
        true => outside - 0.5,
        false => outside.abs() - 0.5,
    }
    .max(0.0)
}

impl Row {
    fn verdict(&self) -> bool {
        let judged = [self.ours_box, self.ours_centre, self.ours_outline, self.ours_exact];
        judged.iter().all(Judged::holds) && self.ours_not_finite == 0 && self.misclassified == 0
    }

    /// Joins the three judgements of our conic.
    fn ours(&self) -> Judged {
        self.ours_box.join(self.ours_centre).join(self.ours_outline)
    }

    fn add_class(
        &mut self,
        class: &Class,
        count: u32,
        random: &mut SplitMix64,
        device: &Device,
    ) -> Result<(), StabilityError> {
        let cases: Vec<Case> = (0..count).map(|_| class.draw(random)).collect();
        let with_truth = |case: Case| {
            let disk = case.disk.through(&case.lens);
            let truth = truth::truth(&disk, case.cutoff, &Lens::UNIT);
            let probe = Probe::new(&disk, case.cutoff, &case.lens, points_px(&truth));
            (truth, probe)
        };
        let (truths, probes): (Vec<TrueSide>, Vec<Probe>) =
            cases.par_iter().copied().map(with_truth).unzip();
        let perspective = device.measure(Filter::Perspective, &probes)?;
        let exact = device.measure(Filter::Exact, &probes)?;
        for (number, case) in cases.iter().enumerate() {
            let found = [&perspective[number], &exact[number]];
            self.add(case, &truths[number], &probes[number], found);
        }
        Ok(())
    }

    fn add(&mut self, case: &Case, truth: &TrueSide, probe: &Probe, found: [&Found; 2]) {
        let right = found.iter().all(|found| match (truth, found.side()) {
            (TrueSide::Regular(_), Side::Regular)
            | (TrueSide::Crosses, Side::Crosses)
            | (TrueSide::Behind, Side::Unseen)
            | (TrueSide::Close, _) => true,
            // A disk seen edge-on covers nothing.
            (TrueSide::Crosses, Side::Unseen) => probe.is_flat(),
            _ => false,
        });
        self.misclassified += u32::from(!right);
        let (TrueSide::Regular(truth), Side::Regular) = (truth, found[0].side()) else { return };
        self.regular += 1;
        self.add_ours(case, truth, probe, found);
        let Case { disk, cutoff, lens } = case;
        if let TrueSide::Regular(truth) = truth::truth(disk, *cutoff, lens) {
            self.dual_difference.add(&formulas::dual_difference(disk, *cutoff, lens), &truth);
            self.dual_naive.add(&formulas::dual_naive(disk, *cutoff, lens), &truth);
            match formulas::paper(disk, *cutoff, lens) {
                Some(outline) => self.paper.add(&outline, &truth),
                None => self.paper_discarded += 1,
            }
        }
    }

    fn add_ours(&mut self, case: &Case, truth: &Truth, probe: &Probe, found: [&Found; 2]) {
        let [perspective, exact] = found;
        let bounds = truth.bounds();
        let all = [bounds.box_px, bounds.centre_px, bounds.outline_px];
        self.unbounded += u32::from(!all.into_iter().all(is_bounded));
        let add = |judged: &mut Judged, error_px: f64, bound_px: f64| {
            if is_bounded(bound_px) {
                judged.add(error_px, bound_px);
            }
        };
        let far = |a: f64, b: f64| (hold(a) - hold(b)).abs();
        let largest = |a: DVec2, b: DVec2| far(a.x, b.x).max(far(a.y, b.y));
        let (own, [low, high]) = (perspective.centre_px.floor().as_dvec2(), truth.corners());
        for axis in 0..2 {
            let edges = [
                edge_error_px(perspective.low[axis], low[axis], own[axis], true),
                edge_error_px(perspective.high[axis], high[axis], own[axis], false),
            ];
            edges.into_iter().for_each(|error| add(&mut self.ours_box, error, bounds.box_px));
        }
        let ellipse = perspective.ellipse(case.cutoff);
        let centre = ellipse.map_or(truth.centre(), |ellipse| ellipse.centre);
        add(&mut self.ours_centre, largest(centre, truth.centre()), bounds.centre_px);
        for d in (0..DIRECTIONS).map(direction) {
            let support = ellipse.map_or(f64::INFINITY, |ellipse| ellipse.support(d));
            add(&mut self.ours_outline, far(support, truth.support(d)), bounds.outline_px);
        }
        for (number, &pixel) in probe.points_px().iter().enumerate() {
            // Images have pixels only within this range.
            if f64::from(pixel.abs().max_element()) > GUARD_PX {
                continue;
            }
            match truth.kernel_error(pixel, exact.kernel(number)) {
                Some((error, bound)) => {
                    self.exact_judged += 1;
                    self.ours_exact.add(error, bound);
                }
                None => self.exact_unresolved += 1,
            }
        }
        self.ours_not_finite += u32::from(!perspective.is_finite() || !exact.is_finite());
    }
}

#[cfg(test)]
mod tests;
