//! The reference renderer: samples and triangles on the CPU in f64 (floor 2a).
//!
//! Written for clarity, never for speed, and sharing nothing with the GPU's passes but the scene
//! types, or it would share their mistakes. An image's error is its distance from this one's.
//!
//! 1. [`visibility`]: which sample or triangle each pixel shows. A sample covers the one pixel that it projects
//!    into. A triangle covers a pixel when the ray through the pixel's centre meets it, decided by exact predicates
//!    ([`predicates`]), so that neighbours neither overlap nor leave a gap and a triangle through
//!    the camera plane needs no clipping. The nearest wins; at equal depth the lower instance, then the lower index.
//! 2. [`surface`]: colour ([`texture`] included), normal and material where the ray meets the winner.
//! 3. [`shade`]: Phong, or the colour as it is.
//!
//! Work is split by rows of the image; the order of primitives does not matter to the result, so that it
//! is the same on any number of threads.

pub mod color;
mod predicates;
mod prepare;
mod shade;
mod surface;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_shading;
mod texture;
mod visibility;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use crate::assets::{Geometry, Material, Texture};
use crate::math::View;
use crate::scene::{Light, MaterialSpec};

use prepare::Prepared;
use visibility::Hit;

/// What is drawn, and under which lights.
#[derive(Clone, Debug, Default)]
pub struct OracleScene<'a> {
    pub items: Vec<OracleItem<'a>>,
    /// None leave every colour as it is.
    pub lights: &'a [Light],
    /// Linear RGB and straight alpha of pixels that nothing covers.
    pub background: [f32; 4],
}

/// One geometry at one place.
#[derive(Clone, Copy, Debug)]
pub struct OracleItem<'a> {
    pub geometry: &'a Geometry,
    pub world_from_geometry: DAffine3,
    /// What the mesh's parts refer to; a part without material has [`Material::default`].
    pub materials: &'a [Material],
    /// What the materials refer to.
    pub textures: &'a [Texture],
    /// Laid over the materials, and over the colours of samples.
    pub override_material: Option<&'a MaterialSpec>,
    /// Number of the instance, counted from 0.
    pub instance: u32,
}

/// A rendered frame; every vector holds `width · height` pixels, top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct OracleFrame {
    pub width: u32,
    pub height: u32,
    /// Linear RGB, not clamped, and straight alpha.
    pub color: Vec<[f64; 4]>,
    /// Distance along the viewing axis at the pixel's centre (a sample's own distance); infinite where nothing is.
    pub depth: Vec<f64>,
    /// World-space unit normals, turned towards the eye; zero where nothing or no normal is.
    pub normal: Vec<DVec3>,
    /// Instance plus one, 0 where nothing is.
    pub id: Vec<u32>,
}

impl OracleFrame {
    /// The colour, clamped to 0..=1 and encoded as sRGB with straight alpha, rounded to the nearest byte.
    pub fn to_rgba8(&self) -> Vec<[u8; 4]> {
        self.color
            .iter()
            .map(|&[r, g, b, a]| {
                let [r, g, b] = [r, g, b].map(color::srgb8_from_linear);
                [r, g, b, color::byte_from_unit(a)]
            })
            .collect()
    }
}

/// Renders a frame of `view.width` × `view.height` pixels.
///
/// `supersample` n > 1 gives each pixel's colour as the mean of n × n sub-pixels, each looking through its own centre;
/// a sample still covers its whole pixel. Depth, normal and id are those of the pixel's centre whatever n is.
pub fn render(scene: &OracleScene<'_>, view: &View, supersample: u32) -> OracleFrame {
    let prepared = Prepared::new(scene, view);
    let hits = visibility::resolve(&prepared, view, 1);
    let color = match supersample {
        0 | 1 => colors(&prepared, view, &hits),
        n => {
            let fine_hits = visibility::resolve(&prepared, view, n);
            let fine = colors(&prepared, &visibility::finer(view, n), &fine_hits);
            box_filter(&fine, view, n as usize)
        }
    };
    let width = view.width as usize;
    let normal = hits.par_iter().enumerate().map(|(i, hit)| match hit {
        Some(hit) => surface::at(&prepared, view, hit, i % width, i / width).normal_world,
        None => DVec3::ZERO,
    });
    OracleFrame {
        width: view.width,
        height: view.height,
        normal: normal.collect(),
        depth: hits.iter().map(|hit| hit.map_or(f64::INFINITY, |hit| hit.depth)).collect(),
        id: hits.iter().map(|hit| hit.map_or(0, |hit| prepared.instance(&hit) + 1)).collect(),
        color,
    }
}

fn colors(prepared: &Prepared<'_>, view: &View, hits: &[Option<Hit>]) -> Vec<[f64; 4]> {
    let width = view.width as usize;
    let background = prepared.scene.background.map(f64::from);
    let color = |(i, hit): (usize, &Option<Hit>)| match hit {
        Some(hit) => {
            let surface = surface::at(prepared, view, hit, i % width, i / width);
            let [r, g, b] = shade::shade(&surface, prepared.scene.lights, view.eye);
            [r, g, b, 1.0]
        }
        None => background,
    };
    hits.par_iter().enumerate().map(color).collect()
}

/// The mean of every n × n block; colours count as much as they cover (alpha).
fn box_filter(fine: &[[f64; 4]], view: &View, n: usize) -> Vec<[f64; 4]> {
    let (width, height) = (view.width as usize, view.height as usize);
    let mean = |pixel: usize| {
        let (x, y) = (pixel % width, pixel / width);
        let mut sum = [0.0; 4];
        for sub in 0..n * n {
            let [r, g, b, a] = fine[(y * n + sub / n) * width * n + x * n + sub % n];
            sum = [sum[0] + r * a, sum[1] + g * a, sum[2] + b * a, sum[3] + a];
        }
        let [r, g, b, a] = sum;
        if a > 0.0 { [r / a, g / a, b / a, a / (n * n) as f64] } else { [0.0; 4] }
    };
    (0..width * height).into_par_iter().map(mean).collect()
}
