//! The reference frame of a pose: what errors of other frames are measured against.
//!
//! The engine draws it at full detail, with samples as splats and triangles as triangles, at 4 × 4 times the pixels. Where the frame limit
//! has room, each of those pixels is antialiased once more. Colours are means in linear light, coverage is the mean of alpha, the depth of
//! a pixel is the median of its parts', and its normal their direction together. [`Truth::of_oracle`] takes a frame of the f64 oracle
//! instead.
//!
//! A truth is kept as one gzip file: four planes of `width · height` pixels, row by row, little-endian. They are colours (RGBA8), coverage
//! (a byte), depths (f32) and normals (RGBA8).

use std::io::{Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use rayon::prelude::*;

use super::difference::Shot;
use super::metrics::normals_from_rgba8;
use crate::engine::{FrameRequest, Limits};
use crate::oracle::OracleFrame;
use crate::plan::{Output, Settings};
use crate::scene::color::{linear_from_srgb, srgb_from_linear};

/// Pixels of a reference along each side of a frame's pixel.
pub const PARTS: u32 = 4;

/// A reference frame. All slices have `width · height` pixels, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    pub width: u32,
    pub height: u32,
    /// sRGB, opaque.
    pub color: Vec<[u8; 4]>,
    /// Whether at least half of the pixel shows the scene; of the oracle, whether the pixel's centre does.
    pub covered: Vec<bool>,
    /// Distance along the viewing axis in scene units; infinite where nothing is.
    pub depth: Vec<f32>,
    /// World-space normals as `n · 127 + 128`; all zero where there is none.
    pub normal: Vec<[u8; 4]>,
}

/// The images of one pose at [`PARTS`] times the width and height.
pub struct Wide {
    pub color: Vec<[u8; 4]>,
    /// Colours over a transparent background.
    pub coverage: Vec<[u8; 4]>,
    pub depth: Vec<f32>,
    pub normal: Vec<[u8; 4]>,
}

/// The colour over black, opaque: what a viewer without transparency shows.
pub fn opaque(pixel: [u8; 4]) -> [u8; 4] {
    if pixel[3] == 255 {
        return pixel;
    }
    let [r, g, b] = linear(pixel).map(srgb8);
    [r, g, b, 255]
}

/// Whether a pixel drawn over a transparent background shows the scene at least by half.
pub fn is_covered(pixel: [u8; 4]) -> bool {
    pixel[3] >= 128
}

/// Linear light, times alpha.
fn linear([r, g, b, a]: [u8; 4]) -> [f64; 3] {
    let alpha = f64::from(a) / 255.0;
    [r, g, b].map(|byte| linear_from_srgb(f64::from(byte) / 255.0) * alpha)
}

fn srgb8(linear: f64) -> u8 {
    (255.0 * srgb_from_linear(linear.clamp(0.0, 1.0))).round() as u8
}

/// How the engine draws the reference of a frame: at [`PARTS`] times the width and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finer {
    pub width: u32,
    pub height: u32,
    /// Limits of frames.
    pixels: u64,
    side: u32,
}

impl Finer {
    /// The size of the reference for frames of this size; `None` where it is beyond the limits of frames.
    pub fn new([width, height]: [u32; 2], limits: &Limits) -> Option<Finer> {
        let [width, height] = [width, height].map(|side| side.saturating_mul(PARTS));
        let (pixels, side) = (limits.max_pixels, limits.max_side);
        let fits = u64::from(width) * u64::from(height) <= pixels && width.max(height) <= side;
        fits.then_some(Finer { width, height, pixels, side })
    }

    /// Parts along each side of one of the reference's own pixels, which the limits of frames decide.
    pub fn parts(&self) -> u32 {
        Settings::exact()
            .antialiased_within([self.width, self.height], self.pixels, self.side)
            .parts()
    }

    /// An image of the reference. `own` is a frame at full detail, and `decided` are the settings that it resolves to.
    pub fn request(
        &self,
        own: &FrameRequest,
        decided: &Settings,
        output: Output,
        transparent: bool,
    ) -> FrameRequest {
        let (width, height) = (self.width, self.height);
        let exact = Settings { wait: own.settings.wait, ..decided.finer(PARTS, transparent) };
        let settings = match output {
            Output::Color => exact.antialiased_within([width, height], self.pixels, self.side),
            _ => exact,
        };
        FrameRequest { width, height, settings, output, ..own.clone() }
    }
}

/// Averages the colours and the coverage of images that are `parts` times as wide and as high: opaque sRGB in linear light, and whether at
/// least half of the pixel shows the scene.
pub fn averaged(
    [width, height]: [u32; 2],
    parts: u32,
    color: &[[u8; 4]],
    coverage: &[[u8; 4]],
) -> (Vec<[u8; 4]>, Vec<bool>) {
    let count = f64::from(parts * parts);
    let pixel = |i: usize| {
        let (mut sum, mut alpha) = ([0.0; 3], 0.0);
        for at in places(i, width as usize, parts as usize) {
            let part = linear(color[at]);
            (0..3).for_each(|channel| sum[channel] += part[channel]);
            alpha += f64::from(coverage[at][3]) / 255.0;
        }
        let [r, g, b] = sum.map(|channel| srgb8(channel / count));
        ([r, g, b, 255], alpha >= 0.5 * count)
    };
    (0..width as usize * height as usize).into_par_iter().map(pixel).unzip()
}

/// Places of a pixel's parts in an image that is `parts` times as wide.
fn places(pixel: usize, columns: usize, parts: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (pixel % columns * parts, pixel / columns * parts);
    (0..parts * parts).map(move |part| (y + part / parts) * columns * parts + x + part % parts)
}

impl Truth {
    /// Averages images that are `parts` times as wide and as high.
    pub fn of_wide(width: u32, height: u32, parts: u32, wide: &Wide) -> Truth {
        let (color, covered) = averaged([width, height], parts, &wide.color, &wide.coverage);
        let pixel = |(i, &is_covered): (usize, &bool)| {
            let (mut normal, mut depths) = (DVec3::ZERO, Vec::new());
            for at in places(i, width as usize, parts as usize) {
                normal += normals_from_rgba8(&[wide.normal[at]])[0];
                depths.extend(Some(wide.depth[at]).filter(|depth| depth.is_finite()));
            }
            depths.sort_unstable_by(f32::total_cmp);
            let median = depths.get(depths.len().saturating_sub(1) / 2).copied();
            let depth = median.filter(|_| is_covered).unwrap_or(f32::INFINITY);
            (depth, if is_covered { bytes(normal) } else { [0; 4] })
        };
        let (depth, normal) = covered.par_iter().enumerate().map(pixel).unzip();
        Truth { width, height, color, covered, depth, normal }
    }

    /// Averages colours and coverage alone; there are no depths and normals.
    pub fn of_colors(size: [u32; 2], parts: u32, color: &[[u8; 4]], coverage: &[[u8; 4]]) -> Truth {
        let (color, covered) = averaged(size, parts, color, coverage);
        let [width, height] = size;
        Truth { width, height, color, covered, depth: Vec::new(), normal: Vec::new() }
    }

    /// Colours and coverage.
    pub fn shot(&self) -> Shot<'_> {
        Shot { color: &self.color, covered: &self.covered }
    }

    /// A frame of the oracle, whose colours are supersampled and whose other outputs are those of the pixels' centres.
    pub fn of_oracle(frame: &OracleFrame) -> Truth {
        Truth {
            width: frame.width,
            height: frame.height,
            color: frame.to_rgba8().into_iter().map(opaque).collect(),
            covered: frame.id.iter().map(|&id| id != 0).collect(),
            depth: frame.depth.iter().map(|&depth| depth as f32).collect(),
            normal: frame.normal.iter().map(|&normal| bytes(normal)).collect(),
        }
    }

    /// Number of pixels that show the scene.
    pub fn covered_pixels(&self) -> usize {
        self.covered.iter().filter(|covered| **covered).count()
    }

    /// Writes the truth to a file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, file: &Path) -> std::io::Result<()> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(self.color.as_flattened())?;
        encoder.write_all(&self.covered.iter().map(|&c| u8::from(c)).collect::<Vec<u8>>())?;
        let depths: Vec<[u8; 4]> = self.depth.iter().map(|depth| depth.to_le_bytes()).collect();
        encoder.write_all(depths.as_flattened())?;
        encoder.write_all(self.normal.as_flattened())?;
        super::journal::write_whole(file, &encoder.finish()?)
    }

    /// Reads a truth of this size; `None` where the file is missing, damaged or of another size.
    pub fn read(file: &Path, width: u32, height: u32) -> Option<Truth> {
        let pixels = width as usize * height as usize;
        let mut bytes = Vec::new();
        GzDecoder::new(std::fs::File::open(file).ok()?).read_to_end(&mut bytes).ok()?;
        if bytes.len() != pixels * 13 {
            return None;
        }
        let (color, rest) = bytes.split_at(4 * pixels);
        let (covered, rest) = rest.split_at(pixels);
        let (depth, normal) = rest.split_at(4 * pixels);
        Some(Truth {
            width,
            height,
            color: quads(color),
            covered: covered.iter().map(|&byte| byte != 0).collect(),
            depth: floats(depth),
            normal: quads(normal),
        })
    }
}

/// A raw image of four bytes a pixel.
pub fn quads(bytes: &[u8]) -> Vec<[u8; 4]> {
    bytes.as_chunks().0.to_vec()
}

/// A raw image of depths.
pub fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|&four| f32::from_le_bytes(four)).collect()
}

/// The direction of a vector as `n · 127 + 128`; all zero for the zero vector.
fn bytes(vector: DVec3) -> [u8; 4] {
    let byte = |component: f64| (component * 127.0 + 128.0).round() as u8;
    vector.try_normalize().map_or([0; 4], |n| [byte(n.x), byte(n.y), byte(n.z), 255])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wide() -> Wide {
        // Two pixels of 2 × 2 parts: the left one is white by half, the right one red and seen by a quarter.
        let (black, white, red) = ([0, 0, 0, 255], [255; 4], [255, 0, 0, 255]);
        Wide {
            color: vec![black, white, red, red, white, black, red, red],
            coverage: vec![[0; 4], white, red, [0; 4], white, [0; 4], [0; 4], [0; 4]],
            depth: vec![f32::INFINITY, 3.0, 1.0, f32::INFINITY, 2.0, 5.0, 9.0, 9.0],
            normal: vec![
                [0; 4],
                [128, 128, 255, 255],
                [0; 4],
                [0; 4],
                [128, 255, 128, 255],
                [0; 4],
                [0; 4],
                [0; 4],
            ],
        }
    }

    #[test]
    fn parts_are_averaged_in_linear_light() {
        let truth = Truth::of_wide(2, 1, 2, &wide());
        // Half of the light is byte 188, not 128.
        assert_eq!(truth.color, [[188, 188, 188, 255], [255, 0, 0, 255]]);
        assert_eq!(truth.covered, [true, false]);
        assert_eq!(truth.depth, [3.0, f32::INFINITY]);
        let [_, y, z, known] = truth.normal[0];
        assert_eq!((y, z, known), (218, 218, 255));
        assert_eq!(truth.normal[1], [0; 4]);
        assert_eq!(truth.covered_pixels(), 1);
    }

    #[test]
    fn a_truth_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("truth.gz");
        let truth = Truth::of_wide(2, 1, 2, &wide());
        truth.write(&file).unwrap();
        assert_eq!(Truth::read(&file, 2, 1), Some(truth));
        assert_eq!(Truth::read(&file, 1, 1), None);
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() - 9]).unwrap();
        assert_eq!(Truth::read(&file, 2, 1), None);
        assert_eq!(Truth::read(&folder.path().join("none"), 2, 1), None);
    }

    #[test]
    fn translucent_pixels_are_shown_over_black() {
        assert_eq!(opaque([9, 8, 7, 255]), [9, 8, 7, 255]);
        assert_eq!(opaque([255, 255, 255, 0]), [0, 0, 0, 255]);
        assert_eq!(opaque([255, 0, 0, 128])[0], 188);
        assert!(is_covered([0, 0, 0, 128]) && !is_covered([0, 0, 0, 127]));
    }
}
