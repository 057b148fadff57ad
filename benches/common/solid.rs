//! The solid whose surface statues sample, as the truth that frames of the samples are compared with.

use std::path::Path;

use anyhow::Context;
use pointillist::accuracy::metrics;
use pointillist::assets::{Geometry, ReadOptions, read};
use pointillist::bake::prepare::{AssetTraits, prepare_geometry};
use pointillist::generate::{Kind, Parameters};
use pointillist::math::Camera;
use pointillist::memory::Admission;
use pointillist::plan::{Output, Reconstruct, Settings};
use pointillist::scene::color::{linear_from_srgb, srgb_from_linear};

use super::drawing::Drawing;
use super::{files, median, pick};

/// Number of the truth's pixels along one of a frame's.
pub const FINE: usize = 4;

/// A mesh of many triangles.
pub struct Solid {
    drawing: Drawing,
    side: u32,
}

/// The truth of a pose, as a frame's pixels see it.
pub struct Truth {
    /// Averaged in linear light.
    pub color: Vec<[u8; 4]>,
    /// Averaged as bytes, as programs do that know no linear light.
    pub bytes: Vec<[u8; 4]>,
    /// The pixel and all its neighbours show the surface wholly.
    pub inside: Vec<bool>,
    /// Neither the pixel nor a neighbour shows the surface.
    pub outside: Vec<bool>,
}

/// File of the mesh of statues with this seed.
///
/// # Errors
/// It cannot be made.
pub fn mesh(seed: u64) -> anyhow::Result<std::path::PathBuf> {
    let triangles = pick(2_000_000, 20_000);
    let parameters = Parameters { seed, triangles: Some(triangles), ..Parameters::default() };
    files::generated(&format!("relief-seed{seed}-{triangles}.ply"), Kind::Relief, &parameters)
}

impl Solid {
    /// Opens the mesh, or a scene of it, for square frames of this side.
    ///
    /// # Errors
    /// No adapter, or a file that is refused.
    pub fn open(file: &Path, side: u32) -> anyhow::Result<Solid> {
        let fine = side * FINE as u32;
        let drawing = Drawing::open(file, side, |config| {
            config.max_pixels = config.max_pixels.max(u64::from(fine).pow(2));
            config.max_side = config.max_side.max(fine);
        })?;
        Ok(Solid { drawing, side })
    }

    /// Draws the truth of a pose.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn truth(&self, camera: Camera) -> anyhow::Result<Truth> {
        let (side, fine) = (self.side as usize, self.side * FINE as u32);
        let of = |output| {
            let settings = Settings::drawn_as(Reconstruct::Points);
            self.drawing.raw(camera, [fine; 2], settings, output)
        };
        let colors: Vec<[u8; 4]> = bytemuck::pod_collect_to_vec(&of(Output::Color)?.bytes);
        let depths: Vec<f32> = bytemuck::pod_collect_to_vec(&of(Output::Depth)?.bytes);
        let linear: [f64; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0));
        let count = (FINE * FINE) as f64;
        let under = |pixel: usize| {
            let (x, y) = (pixel % side * FINE, pixel / side * FINE);
            (0..FINE * FINE).map(move |i| (y + i / FINE) * side * FINE + x + i % FINE)
        };
        let mean = |pixel: usize, channel: usize| {
            let sum: f64 = under(pixel).map(|i| linear[usize::from(colors[i][channel])]).sum();
            (255.0 * srgb_from_linear(sum / count)).round() as u8
        };
        let mean_byte = |pixel: usize, channel: usize| {
            let sum: f64 = under(pixel).map(|i| f64::from(colors[i][channel])).sum();
            (sum / count).round() as u8
        };
        let pixels = || 0..side * side;
        let all: Vec<bool> =
            pixels().map(|i| under(i).all(|fine| depths[fine].is_finite())).collect();
        let none: Vec<bool> =
            pixels().map(|i| under(i).all(|fine| !depths[fine].is_finite())).collect();
        let shrunk = |mask: &[bool]| metrics::shrunk(mask, self.side, self.side, 1);
        Ok(Truth {
            color: pixels().map(|i| [mean(i, 0), mean(i, 1), mean(i, 2), 255]).collect(),
            bytes: pixels()
                .map(|i| [mean_byte(i, 0), mean_byte(i, 1), mean_byte(i, 2), 255])
                .collect(),
            inside: shrunk(&all)?,
            outside: shrunk(&none)?,
        })
    }
}

impl Truth {
    /// Numbers of holes and of leaks.
    pub fn faults(&self, covered: &[bool]) -> [u64; 2] {
        let count = |of: &[bool], is: bool| {
            of.iter().zip(covered).filter(|(of, covered)| **of && **covered == is).count() as u64
        };
        [count(&self.inside, false), count(&self.outside, true)]
    }
}

/// Twice the median standard deviation of the kernels that a cloud is given: the radius at which VTK's Gaussians cover what ours do.
///
/// # Errors
/// The file holds no cloud.
pub fn footprint(file: &Path) -> anyhow::Result<f64> {
    let mut asset = read(file, &ReadOptions::default())?;
    let geometry = asset.geometries.first_mut().context("an empty file")?;
    prepare_geometry(geometry, &mut AssetTraits::default(), &Admission::default())?;
    let Geometry::Points(cloud) = geometry else { anyhow::bail!("{}: no cloud", file.display()) };
    let kernels = cloud.kernels.iter().flatten();
    let lengths: Vec<f64> =
        kernels.map(|kernel| f64::from(kernel.u.length().max(kernel.v.length()))).collect();
    Ok(2.0 * median(&lengths))
}

/// Opaque pixels of a peer's PNG, from the top row on.
///
/// # Errors
/// The file cannot be read.
pub fn pixels_of_png(png: &Path) -> anyhow::Result<Vec<[u8; 4]>> {
    let image = image::open(png).with_context(|| png.display().to_string())?.to_rgb8();
    Ok(image.pixels().map(|&image::Rgb([r, g, b])| [r, g, b, 255]).collect())
}

/// Pixels that show anything before black.
pub fn covered(pixels: &[[u8; 4]]) -> Vec<bool> {
    pixels.iter().map(|[r, g, b, _]| (*r, *g, *b) != (0, 0, 0)).collect()
}
