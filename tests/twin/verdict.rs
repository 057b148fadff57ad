//! Decides whether two frames show the same image.
//!
//! Corners are rounded to a grid of 1/256 pixel, and positions are packed and projected in f32. Pixels whose centre is within a
//! few thousandths of a pixel of an edge may therefore go to either side. Such a pixel is *explained* if the oracle itself shows
//! the frame's value there when the image is shifted by 1/256 pixel. Everything else must agree in every pixel, whatever the
//! signal-to-noise ratio.
//!
//! A few pixels at edges cannot be explained in this way: tips of slivers, which no shift happens to hit, and silhouettes of
//! closed surfaces, where the centre is outside by less than the grid and the far side, extended to it, appears in front of the
//! near one. These are counted separately: [`Tolerance::at_edges`].
//!
//! One difference is a matter of definition. The oracle turns a sample's normal towards the eye along the ray to the sample, the
//! engine along the ray to its pixel's centre. Where these disagree, a normal may point the other way.

use glam::{DVec2, DVec3};
use pointillist::accuracy::metrics;
use pointillist::accuracy::reference::{self, Reference};
use pointillist::encode::{FrameImage, png};
use pointillist::math::View;
use pointillist::oracle::OracleFrame;
use pointillist::plan::Output;

use super::stage::{Frames, folder};

/// Limits of a comparison.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Smallest PSNR of the colours in dB.
    pub psnr: f64,
    /// Accept less than `psnr` if the oracle's own image changes more when it is shifted by 1/512 pixel each way, the most that
    /// the grid moves a corner. Triangles far smaller than a pixel turn any rounding into noise.
    pub unless_noise: bool,
    /// Number of pixels that differ without explanation, away from edges.
    pub unexplained: usize,
    /// As `unexplained`, for pixels at edges: the oracle shows several surfaces around them.
    pub at_edges: usize,
    /// Number of holes inside and leaks outside of silhouettes.
    pub stray: u64,
    /// Largest difference of a colour byte in an agreeing pixel.
    pub color: u8,
    /// Largest difference of a normal's byte in an agreeing pixel.
    pub normal: u8,
    /// Largest relative depth error in an agreeing pixel.
    pub depth: f64,
    /// Shift in pixels that can explain a difference; 0 saves the eight frames that the shifts take.
    pub shift_px: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self {
            psnr: 45.0,
            unless_noise: false,
            unexplained: 0,
            at_edges: 4,
            stray: 0,
            color: 3,
            normal: 2,
            depth: 1e-5,
            shift_px: 1.0 / 256.0,
        }
    }
}

impl Tolerance {
    /// For frames of samples: if two samples are closer in depth than f32's rounding, either may be visible. The lighting of one
    /// seen edge-on depends on a tiny angle.
    pub fn samples() -> Self {
        Self { unexplained: 4, at_edges: 12, ..Self::default() }
    }
}

/// The oracle's four images.
struct Twin {
    color: Vec<[u8; 4]>,
    depth: Vec<f64>,
    normal: Vec<[u8; 4]>,
    id: Vec<u32>,
}

impl Twin {
    fn of(frame: OracleFrame) -> Twin {
        let FrameImage::Normal { rgba, .. } = reference::image(&frame, Output::Normal) else {
            unreachable!("normals were asked for")
        };
        Twin { color: frame.to_rgba8(), depth: frame.depth, normal: rgba, id: frame.id }
    }
}

/// The range of the oracle's values at a pixel under several shifts.
#[derive(Clone, Debug)]
struct Range {
    color: [[u8; 2]; 4],
    depth: [f64; 2],
    normal: [[u8; 2]; 4],
    ids: Vec<u32>,
}

impl Range {
    fn at(twin: &Twin, i: usize) -> Range {
        Range {
            color: twin.color[i].map(|byte| [byte; 2]),
            depth: [twin.depth[i]; 2],
            normal: twin.normal[i].map(|byte| [byte; 2]),
            ids: vec![twin.id[i]],
        }
    }

    fn join(&mut self, twin: &Twin, i: usize) {
        for channel in 0..4 {
            for (range, byte) in [
                (&mut self.color[channel], twin.color[i][channel]),
                (&mut self.normal[channel], twin.normal[i][channel]),
            ] {
                *range = [range[0].min(byte), range[1].max(byte)];
            }
        }
        self.depth = [self.depth[0].min(twin.depth[i]), self.depth[1].max(twin.depth[i])];
        self.ids.push(twin.id[i]);
    }

    fn holds(&self, view: &View, frames: &Frames, i: usize, tolerance: &Tolerance) -> bool {
        let within = |ranges: &[[u8; 2]; 4], bytes: [u8; 4], slack: u8| {
            ranges.iter().zip(bytes).all(|(range, byte)| {
                (range[0].saturating_sub(slack)..=range[1].saturating_add(slack)).contains(&byte)
            })
        };
        let depth = f64::from(frames.depth[i]);
        let [near, far] = self.depth;
        self.ids.contains(&frames.id[i])
            && within(&self.color, frames.color[i], tolerance.color)
            && (within(&self.normal, frames.normal[i], tolerance.normal)
                || is_grazing(view, i, frames.normal[i])
                    && within(&self.normal, opposite(frames.normal[i]), tolerance.normal))
            && depth >= near * (1.0 - tolerance.depth)
            && depth <= far * (1.0 + tolerance.depth)
    }
}

fn opposite([x, y, z, known]: [u8; 4]) -> [u8; 4] {
    let [x, y, z] = [x, y, z].map(|byte| 0u8.wrapping_sub(byte));
    [x, y, z, known]
}

/// Whether a normal is perpendicular to the ray through a pixel, within the pixel's size and the rounding to bytes.
fn is_grazing(view: &View, i: usize, normal: [u8; 4]) -> bool {
    let (x, y) = (i % view.width as usize, i / view.width as usize);
    let ray = view.ray(DVec2::new(x as f64, y as f64) + 0.5);
    let way = view.towards(ray);
    let way: DVec3 = view.view_from_world.transpose() * (way / way.length());
    let normal = metrics::normals_from_rgba8(&[normal])[0];
    let pixel = if view.is_orthographic() { 0.0 } else { 0.8 / view.focal_px.min_element() };
    normal.dot(way).abs() < pixel + 0.007
}

/// Pixels that differ from the oracle's without being explained by a shift.
fn unexplained(
    reference: &Reference,
    view: &View,
    frames: &Frames,
    twin: &Twin,
    tolerance: &Tolerance,
) -> Vec<usize> {
    let agrees = |i: &usize| Range::at(twin, *i).holds(view, frames, *i, tolerance);
    let mut open: Vec<usize> = (0..twin.id.len()).filter(|i| !agrees(i)).collect();
    let mut ranges: Vec<Range> = open.iter().map(|&i| Range::at(twin, i)).collect();
    for eighth in 0..8 {
        if open.is_empty() || tolerance.shift_px == 0.0 {
            break;
        }
        let (sin, cos) = (f64::from(eighth) * std::f64::consts::FRAC_PI_4).sin_cos();
        let shift = DVec2::new(cos, sin) * tolerance.shift_px;
        let shifted = View { principal_px: view.principal_px + shift, ..*view };
        let shifted = Twin::of(reference.frame(&shifted, 1));
        let keep: Vec<bool> = open
            .iter()
            .zip(&mut ranges)
            .map(|(&i, range)| {
                range.join(&shifted, i);
                !range.holds(view, frames, i, tolerance)
            })
            .collect();
        let mut kept = keep.iter();
        open.retain(|_| *kept.next().unwrap());
        let mut kept = keep.iter();
        ranges.retain(|_| *kept.next().unwrap());
    }
    open
}

/// Whether the 3 × 3 pixels around a pixel show more than one smooth surface.
fn is_edge(twin: &Twin, view: &View, i: usize) -> bool {
    let (width, height) = (view.width as usize, view.height as usize);
    let near = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    near(i / width, height).flat_map(|y| near(i % width, width).map(move |x| y * width + x)).any(
        |k| {
            let ratio = twin.depth[k] / twin.depth[i];
            let turned =
                (0..3).any(|axis| twin.normal[k][axis].abs_diff(twin.normal[i][axis]) > 16);
            twin.id[k] != twin.id[i] || !(0.98..1.02).contains(&ratio) || turned
        },
    )
}

/// Compares a frame with the oracle's, and panics if they differ too much.
pub fn judge(
    name: &str,
    reference: &Reference,
    view: &View,
    frames: &Frames,
    tolerance: &Tolerance,
) {
    let twin = Twin::of(reference.frame(view, 1));
    let psnr = metrics::psnr(&twin.color, &frames.color).unwrap();
    let (expected, found) = (metrics::covered_by_id(&twin.id), metrics::covered_by_id(&frames.id));
    let coverage = metrics::coverage(&expected, &found, view.width, view.height).unwrap();
    let depth = metrics::depth_error(&twin.depth, &frames.depth).unwrap();
    let differs = (0..twin.id.len()).filter(|&i| twin.id[i] != frames.id[i]).count();
    let unexplained = unexplained(reference, view, frames, &twin, tolerance);
    let (edges, inside): (Vec<usize>, Vec<usize>) =
        unexplained.iter().partition(|&&i| is_edge(&twin, view, i));
    let report = format!(
        "{name}: PSNR {psnr:.1} dB, {} covered, {} holes ({} inside), {} leaks ({} outside), \
         {differs} ids differ, depth p99 {:.1e} max {:.1e}, {} unexplained \
         and {} at edges",
        coverage.covered_reference,
        coverage.holes,
        coverage.holes_inside,
        coverage.leaks,
        coverage.leaks_outside,
        depth.map_or(0.0, |spread| spread.p99),
        depth.map_or(0.0, |spread| spread.max),
        inside.len(),
        edges.len(),
    );
    println!("{report}");
    let noise = || {
        let shift = DVec2::splat(1.0 / 512.0);
        let shifted = View { principal_px: view.principal_px + shift, ..*view };
        let shifted = reference.frame(&shifted, 1).to_rgba8();
        metrics::psnr(&twin.color, &shifted).unwrap()
    };
    let sound = (psnr >= tolerance.psnr || tolerance.unless_noise && psnr >= noise())
        && inside.len() <= tolerance.unexplained
        && edges.len() <= tolerance.at_edges
        && coverage.holes_inside + coverage.leaks_outside <= tolerance.stray
        && covers_agree(&frames.id, &frames.depth);
    if !sound {
        let places: Vec<String> =
            inside.iter().chain(&edges).take(8).map(|&i| describe(&twin, frames, i)).collect();
        let files = picture_failure(name, frames, &twin, &unexplained);
        panic!("{report}\n{}\nsee {files}", places.join("\n"));
    }
}

/// Whether ids and depths cover the same pixels.
fn covers_agree(id: &[u32], depth: &[f32]) -> bool {
    id.iter().zip(depth).all(|(&id, depth)| (id != 0) == depth.is_finite())
}

fn describe(twin: &Twin, frames: &Frames, i: usize) -> String {
    let (x, y) = (i % frames.width as usize, i / frames.width as usize);
    format!(
        "({x}, {y}): id {} {}, depth {} {}, color {:?} {:?}, normal {:?} {:?} (oracle, frame)",
        twin.id[i],
        frames.id[i],
        twin.depth[i],
        frames.depth[i],
        twin.color[i],
        frames.color[i],
        twin.normal[i],
        frames.normal[i]
    )
}

/// Writes both images, their difference (amplified eight times) and the unexplained pixels (white), and returns where.
fn picture_failure(name: &str, frames: &Frames, twin: &Twin, unexplained: &[usize]) -> String {
    let difference = twin.color.iter().zip(&frames.color).map(|(a, b)| {
        let [r, g, b, _] = std::array::from_fn(|k| a[k].abs_diff(b[k]).saturating_mul(8));
        [r, g, b, 255]
    });
    let mut marked = vec![[0, 0, 0, 255]; twin.id.len()];
    for &i in unexplained {
        marked[i] = [255; 4];
    }
    let pictures = [
        ("frame", frames.color.clone()),
        ("oracle", twin.color.clone()),
        ("difference", difference.collect()),
        ("unexplained", marked),
    ];
    for (what, rgba) in pictures {
        save(&format!("{name}-{what}"), frames.width, frames.height, rgba);
    }
    folder().join(format!("failed/{name}-*.png")).display().to_string()
}

/// Saves an image beside those of failures.
pub fn save(name: &str, width: u32, height: u32, rgba: Vec<[u8; 4]>) {
    let folder = folder().join("failed");
    std::fs::create_dir_all(&folder).unwrap();
    let encoded = png::encode(&FrameImage::Color { width, height, rgba }).unwrap();
    std::fs::write(folder.join(format!("{name}.png")), encoded.bytes).unwrap();
}
