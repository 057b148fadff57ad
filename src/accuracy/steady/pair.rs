//! Judges a frame by the frame of a view a small step aside.
//!
//! The step moves the edges of the image. An edge that moves across the centre of a pixel changes the pixel, so that the number of changed pixels has an
//! expected value: the motion, in pixels, summed over the pairs of neighbouring pixels that differ. A pixel that changes far from every edge is a fault, and so
//! are more changed pixels than that value explains. Where every pixel differs from the next, as in noise, only the number tells.

use glam::DVec2;

use super::super::temporal::SEEN;
use crate::math::View;

/// Probability with which a steady pair has more changed pixels than are allowed.
const CHANCE: f64 = 1e-8;
/// A frame and the colours of the one beside it, 4 bytes a pixel.
pub struct Pair<'a> {
    pub colors: [&'a [[u8; 4]]; 2],
    /// Depths of the first frame as `f32`, infinite where nothing is.
    pub depths: &'a [[u8; 4]],
    /// Normals of the first frame: n · 127 + 128 and 255, or zeros where no normal is known.
    pub normals: &'a [[u8; 4]],
    pub views: [&'a View; 2],
    /// Parts along each side of a pixel, whose mean the pixel shows.
    pub parts: u32,
    /// Rounding of places in the image, in pixels.
    pub rounding_px: DVec2,
    /// Pixels that an edge can lie away from what it changes: the error that the frames may have.
    pub error_px: usize,
}

/// The faults of a pair, and the number of changed pixels that its edges explain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Judgement {
    /// Pixels whose colours differ visibly: a channel by more than [`SEEN`].
    pub changed: usize,
    /// Number of them that the step explains.
    pub allowed: usize,
    /// Changed pixels that have no edge beside them, in either frame.
    pub away: usize,
    /// Depths that are NaN, negative or −∞.
    pub odd_depths: usize,
    /// Normals that are not of unit length.
    pub odd_normals: usize,
}

impl Judgement {
    pub fn is_steady(&self) -> bool {
        self.changed <= self.allowed && self.away == 0
    }

    pub fn is_finite(&self) -> bool {
        self.odd_depths == 0 && self.odd_normals == 0
    }
}

impl Pair<'_> {
    pub fn judge(&self) -> Judgement {
        let [first, second] = self.colors;
        let changed: Vec<usize> =
            (0..first.len()).filter(|&at| differ(first[at], second[at])).collect();
        let (beside_edges, crossings) = self.edges();
        // Columns and rows of parts are crossed as often as there are. Of 16 parts, one alone changes a pixel by 16 of 255 at most, which is not seen.
        let each = f64::from(self.parts.pow(2).min(4));
        let is_depth = |bytes: &&[u8; 4]| f32::from_le_bytes(**bytes) >= 0.0;
        Judgement {
            // A crossing changes the pixel that an edge leaves and the one that it enters.
            allowed: 2 * poisson_quantile(crossings * each),
            away: changed.iter().filter(|&&at| !beside_edges[at]).count(),
            changed: changed.len(),
            odd_depths: self.depths.len() - self.depths.iter().filter(is_depth).count(),
            odd_normals: self.normals.iter().filter(|normal| !is_normal(normal)).count(),
        }
    }

    /// Tells for each pixel whether an edge lies beside it, and how many crossings of edges and centres of pixels the step leads to on average.
    fn edges(&self) -> (Vec<bool>, f64) {
        let (width, height) = (self.views[0].width as usize, self.views[0].height as usize);
        let mut beside = vec![false; width * height];
        let mut crossings = 0.0;
        let mut see = |at: usize, other: usize, along: fn(DVec2) -> f64| {
            let edges = self.colors.map(|colors| differ(colors[at], colors[other]));
            if edges.contains(&true) {
                beside[at] = true;
                beside[other] = true;
                let depth = self.depth(at).min(self.depth(other));
                // The mean of both frames: what flickers makes edges in one of them.
                let count = edges.into_iter().map(|is_edge| if is_edge { 0.5 } else { 0.0 });
                crossings += count.sum::<f64>() * along(self.motion(at, depth));
            }
        };
        for at in 0..width * height {
            if at % width + 1 < width {
                see(at, at + 1, |motion| motion.x);
            }
            if at + width < width * height {
                see(at, at + width, |motion| motion.y);
            }
        }
        (widened(&beside, width, self.error_px.max(1)), crossings)
    }

    /// Depth of what a pixel shows; infinite where that is no positive number.
    fn depth(&self, at: usize) -> f64 {
        let depth = f64::from(f32::from_le_bytes(self.depths[at]));
        if depth > 0.0 && depth.is_finite() { depth } else { f64::INFINITY }
    }

    /// How far what a pixel shows at a depth moves along each axis, in pixels, with the rounding of its place.
    fn motion(&self, at: usize, depth: f64) -> DVec2 {
        let [view, beside] = self.views;
        let width = view.width as usize;
        let centre = DVec2::new((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        let depth = if depth.is_finite() { depth } else { 1.0 };
        let place = view.at_depth(view.ray(centre), depth);
        let world = view.eye + view.view_from_world.transpose() * place;
        let moved = beside.project(beside.to_view(world)).map_or(DVec2::ZERO, |px| px - centre);
        moved.abs() + self.rounding_px
    }
}

/// Whether two colours differ visibly.
fn differ(a: [u8; 4], b: [u8; 4]) -> bool {
    a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > SEEN)
}

/// Whether a pixel of a picture of normals has a unit vector, within the rounding to bytes, or says that it knows none.
fn is_normal(bytes: &[u8; 4]) -> bool {
    let [x, y, z] = [bytes[0], bytes[1], bytes[2]].map(|byte| (f64::from(byte) - 128.0) / 127.0);
    let length = (x * x + y * y + z * z).sqrt();
    *bytes == [0; 4] || (bytes[3] == 255 && (length - 1.0).abs() < 0.01)
}

/// Marks every pixel of an image that has a marked one at most so many columns and rows away.
fn widened(marked: &[bool], width: usize, by: usize) -> Vec<bool> {
    let height = marked.len() / width;
    let near = |at: usize, end: usize| at.saturating_sub(by)..(at + by + 1).min(end);
    let is_near = |at: usize| {
        let (column, row) = (at % width, at / width);
        near(row, height).any(|row| near(column, width).any(|column| marked[row * width + column]))
    };
    (0..marked.len()).map(is_near).collect()
}

/// The least number that a Poisson variable of a mean exceeds with a probability of at most [`CHANCE`].
fn poisson_quantile(mean: f64) -> usize {
    // Logarithms, since the probability of 0 underflows at large means.
    let (mut log, mut count, mut rest) = (-mean, 0usize, 1.0 - (-mean).exp());
    while rest > CHANCE && (count as f64) < 2.0 * mean + 100.0 {
        count += 1;
        log += (mean / count as f64).ln();
        rest -= log.exp();
    }
    count
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::math::Camera;

    const SIZE: [u32; 2] = [16, 12];
    const DARK: [u8; 4] = [0, 0, 0, 255];
    const LIGHT: [u8; 4] = [200, 200, 200, 255];

    fn view(target_x: f64) -> View {
        let target = DVec3::new(target_x, 0.0, 0.0);
        let camera = Camera::perspective(DVec3::Z, target, 40.0);
        camera.view(SIZE[0], SIZE[1]).unwrap()
    }

    fn judge(colors: [&[[u8; 4]]; 2], error_px: usize) -> Judgement {
        let pixels = (SIZE[0] * SIZE[1]) as usize;
        let (depths, normals) = (vec![1.0f32.to_le_bytes(); pixels], vec![[0; 4]; pixels]);
        let views = [&view(0.0), &view(1e-4)];
        let rounding_px = DVec2::ZERO;
        Pair { colors, depths: &depths, normals: &normals, views, parts: 1, rounding_px, error_px }
            .judge()
    }

    fn columns(light_from: usize) -> Vec<[u8; 4]> {
        let width = SIZE[0] as usize;
        let pixels = width * SIZE[1] as usize;
        (0..pixels).map(|at| if at % width < light_from { DARK } else { LIGHT }).collect()
    }

    /// An edge may cross some centres of pixels. A change of as many pixels away from it is a fault, and so are too many changes.
    #[test]
    fn changes_are_explained_by_edges() {
        let first = columns(8);
        let calm = judge([&first, &first], 1);
        assert!(calm.is_steady() && calm.allowed > 0, "{calm:?}");
        let mut second = first.clone();
        second[3 * SIZE[0] as usize + 7] = LIGHT;
        let crossed = judge([&first, &second], 1);
        assert_eq!((crossed.changed, crossed.away), (1, 0));
        assert!(crossed.is_steady());
        // The whole edge moves by a pixel, although the step is a few thousandths of one.
        let jumped = judge([&first, &columns(7)], 1);
        assert_eq!((jumped.changed, jumped.away), (SIZE[1] as usize, 0));
        assert!(!jumped.is_steady(), "{jumped:?}");
        // The whole image changes, and no edge is near most of it.
        let blank = vec![DARK; first.len()];
        let flashed = judge([&blank, &vec![LIGHT; first.len()]], 1);
        assert_eq!((flashed.allowed, flashed.away), (0, first.len()));
    }

    /// An image that differs from pixel to pixel may change in more pixels than one with a single edge.
    #[test]
    fn more_edges_allow_more_changes() {
        let noise: Vec<[u8; 4]> = columns(0)
            .iter()
            .enumerate()
            .map(|(at, _)| if at % 3 == 0 { LIGHT } else { DARK })
            .collect();
        let one = columns(8);
        assert!(judge([&noise, &noise], 1).allowed > judge([&one, &one], 1).allowed);
    }

    #[test]
    fn normals_are_unit_vectors_or_unknown() {
        assert!(is_normal(&[0; 4]));
        assert!(is_normal(&[255, 128, 128, 255]));
        assert!(is_normal(&[201, 201, 201, 255]));
        for odd in [[128, 128, 128, 255], [255, 255, 128, 255], [255, 128, 128, 0], [0, 0, 0, 255]]
        {
            assert!(!is_normal(&odd), "{odd:?}");
        }
    }

    #[test]
    fn depths_are_numbers() {
        let (image, view) = (vec![DARK; 192], view(0.0));
        for (depth, odd) in
            [(f32::INFINITY, 0), (0.0, 0), (f32::NAN, 1), (-1.0, 1), (f32::NEG_INFINITY, 1)]
        {
            let mut depths = vec![1.0f32.to_le_bytes(); 192];
            depths[50] = depth.to_le_bytes();
            let colors = [&image[..]; 2];
            let pair = Pair {
                colors,
                depths: &depths,
                normals: &[],
                views: [&view; 2],
                parts: 1,
                rounding_px: DVec2::ZERO,
                error_px: 1,
            };
            assert_eq!(pair.judge().odd_depths, odd, "{depth}");
        }
    }

    /// The tail of the Poisson distribution beyond the quantile, summed term by term, is just below the chance.
    #[test]
    fn quantiles_of_poisson_numbers() {
        assert_eq!(poisson_quantile(0.0), 0);
        for mean in [0.01, 0.5, 7.0, 90.0, 2000.0] {
            let found = poisson_quantile(mean);
            let tail = |from: usize| -> f64 {
                let log = |n: usize| {
                    n as f64 * f64::ln(mean) - mean - (1..=n).map(|k| (k as f64).ln()).sum::<f64>()
                };
                (from..from + 400).map(|n| log(n).exp()).sum()
            };
            assert!(tail(found + 1) <= 1.1 * CHANCE, "{mean}: {found}");
            assert!(tail(found) > 0.9 * CHANCE, "{mean}: {found}");
        }
    }

    #[test]
    fn pixels_near_a_marked_one_are_found() {
        let mut marked = vec![false; 35];
        marked[2 * 7 + 5] = true;
        let near: Vec<usize> = widened(&marked, 7, 1)
            .iter()
            .enumerate()
            .filter(|(_, near)| **near)
            .map(|(at, _)| at)
            .collect();
        assert_eq!(near, [11, 12, 13, 18, 19, 20, 25, 26, 27]);
    }
}
