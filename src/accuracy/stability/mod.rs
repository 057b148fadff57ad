//! Whether the outline of a splat stays right in f32 where that is hard: `pointillist accuracy --stability`.
//!
//! [`cases`] draws splats class by class, [`formulas`] and [`crate::math::Disk`] say in f32 where their outlines lie,
//! [`truth`] knows it in f64 and bounds what rounding may cost. A row of the report holds the worst error of each formula, over
//! the edges of the box, the centre and the outline in 16 directions, all held within ±2²⁰ px.

pub mod cases;
pub mod formulas;
mod report;
pub mod truth;

use rayon::prelude::*;
use serde::Serialize;

use crate::math::{ImageDisk, Side};
use crate::scene::random::SplitMix64;
use cases::{Case, Class};
use formulas::Outline;
use truth::{Bounds, DIRECTIONS, TrueSide, Truth, direction, hold};

/// No image is larger.
const IMAGE_PX: f64 = 16_384.0;

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stability {
    pub seed: u64,
    /// Splats a class.
    pub count: u32,
    /// Where the paper's inverse is discarded.
    pub condition_max: f32,
    pub rows: Vec<Row>,
    /// Every row holds.
    pub holds: bool,
}

/// One class of splats.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Row {
    pub class: String,
    /// Splats wholly in front of the camera plane: those that have an outline.
    pub regular: u32,
    pub ours_box: Judged,
    /// Edges of boxes that an image can show: the true one is within [`IMAGE_PX`].
    pub ours_box_in_image_px: f64,
    pub ours_centre: Judged,
    pub ours_outline: Judged,
    /// Where our exact kernel coordinates put the outline.
    pub ours_exact: Judged,
    /// Points of outlines that `ours_exact` leaves out: the disk is thinner there than rounding can tell.
    pub exact_unresolved: u32,
    pub dual_difference: Compared,
    pub dual_naive: Compared,
    pub paper: Compared,
    /// Splats that the paper's condition number refuses.
    pub paper_discarded: u32,
    /// Splats of which one of our numbers is NaN or infinite.
    pub ours_not_finite: u32,
    /// Splats put on the wrong side of the camera plane though rounding does not hide the right one.
    pub misclassified: u32,
    pub holds: bool,
}

/// Errors with a bound for each, all in px.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Judged {
    pub worst_px: f64,
    /// The largest bound of any splat.
    pub bound_px: f64,
    /// The largest error over its own splat's bound: it holds up to 1.
    pub worst_share: f64,
}

/// Errors of a formula that we do not use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Compared {
    pub worst_px: f64,
    /// Edges of boxes that an image can show.
    pub box_in_image_px: f64,
    pub over_half_px: u32,
    pub not_finite: u32,
}

impl Judged {
    fn add(&mut self, error_px: f64, bound_px: f64) {
        self.worst_px = self.worst_px.max(error_px);
        self.bound_px = self.bound_px.max(bound_px);
        // An error of 0 is within a bound of 0; NaN is counted elsewhere, and its share must not hold.
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

/// How far an outline is from the truth, in px.
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

/// Judges `count` splats of every class. Equal seeds give equal reports.
pub fn stability(seed: u64, count: u32) -> Stability {
    let classes = cases::classes();
    let row = |(index, class): (usize, &Class)| {
        let mut random = SplitMix64::stream(seed, index as u64);
        let mut row = Row { class: class.name(), ..Row::default() };
        for _ in 0..count {
            row.add(&class.draw(&mut random));
        }
        row.holds = row.verdict();
        row
    };
    let rows: Vec<Row> = classes.par_iter().enumerate().map(row).collect();
    let holds = rows.iter().all(|row| row.holds);
    Stability { seed, count, condition_max: formulas::CONDITION_MAX, rows, holds }
}

impl Row {
    fn verdict(&self) -> bool {
        let judged = [self.ours_box, self.ours_centre, self.ours_outline, self.ours_exact];
        judged.iter().all(Judged::holds) && self.ours_not_finite == 0 && self.misclassified == 0
    }

    /// Our three judgements of the conic as one.
    fn ours(&self) -> Judged {
        self.ours_box.join(self.ours_centre).join(self.ours_outline)
    }

    fn add(&mut self, case: &Case) {
        let Case { disk, cutoff, lens } = case;
        let expected = truth::truth(disk, *cutoff, lens);
        let found = disk.seen(*cutoff, lens);
        let right = matches!(
            (&expected, &found),
            (TrueSide::Regular(_), Side::Regular(_))
                | (TrueSide::Crosses, Side::Crosses)
                | (TrueSide::Behind, Side::Behind)
                | (TrueSide::Close, _)
        );
        self.misclassified += u32::from(!right);
        let (TrueSide::Regular(truth), Side::Regular(image)) = (expected, found) else { return };
        self.regular += 1;
        self.add_ours(&image, &truth);
        self.dual_difference.add(&formulas::dual_difference(disk, *cutoff, lens), &truth);
        self.dual_naive.add(&formulas::dual_naive(disk, *cutoff, lens), &truth);
        match formulas::paper(disk, *cutoff, lens) {
            Some(outline) => self.paper.add(&outline, &truth),
            None => self.paper_discarded += 1,
        }
    }

    fn add_ours(&mut self, image: &ImageDisk, truth: &Truth) {
        let conic = image.conic();
        let outline = Outline::from(&conic);
        let scalars = [conic.root_det_px2, image.gap];
        let finite = scalars.iter().chain(&conic.variance_px2).all(|v| v.is_finite());
        let mut finite = finite && outline.is_finite();
        let (errors, bounds): (Errors, Bounds) = (Errors::of(&outline, truth), truth.bounds());
        self.ours_box.add(errors.box_px, bounds.box_px);
        self.ours_box_in_image_px = self.ours_box_in_image_px.max(errors.box_in_image_px);
        self.ours_centre.add(errors.centre_px, bounds.centre_px);
        self.ours_outline.add(errors.outline_px, bounds.outline_px);
        for i in 0..DIRECTIONS {
            // On the outline, at f32 coordinates as pixels have; only where an image can have pixels.
            let pixel = (truth.projected + truth.seen(direction(i))).as_vec2();
            if pixel.abs().max_element() > crate::math::GUARD_PX {
                continue;
            }
            let kernel = image.kernel_at(pixel);
            finite &= kernel.is_none_or(|k| k.is_finite());
            match kernel.and_then(|kernel| truth.kernel_error(pixel, kernel.as_dvec2())) {
                Some((error, bound)) => self.ours_exact.add(error, bound),
                None => self.exact_unresolved += 1,
            }
        }
        self.ours_not_finite += u32::from(!finite);
    }
}

#[cfg(test)]
mod tests;
