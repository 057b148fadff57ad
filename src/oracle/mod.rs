//! The reference renderer: samples, lines and triangles on the CPU in f64 (floor 2a).
//!
//! Written for clarity, never for speed, and sharing nothing with the GPU's passes but the scene
//! types, or it would share their mistakes. An image's error is its distance from this one's.
//!
//! 1. `visibility`: which sample or triangle each pixel shows. A sample covers the one pixel that it projects
//!    into. A triangle covers a pixel when the ray through the pixel's centre meets it, decided by exact predicates
//!    (`predicates`), so that neighbours neither overlap nor leave a gap and a triangle through
//!    the camera plane needs no clipping. The nearest wins; at equal depth the lower instance, then the lower index.
//!    Lines (`lines`) cover a pixel when that ray meets them.
//! 2. `blend`: where samples are drawn as splats instead (`splats`, and `footprint` for their shapes in the image), which
//!    pixels show them before the triangles, and the weighted means of those that make up the nearest surface.
//!    `paint` lays them over each other instead, where that is asked for.
//!    `pull_push` fills the gaps between samples of one pixel from coarser levels of the image (`patches`) instead, where that is asked for.
//! 3. `surface`: colour (`texture` included), normal and material where the ray meets the winner.
//! 4. `shade`: under lights and surroundings (`environment`), Phong's model, that of physical materials (`physical`), or the colour as it is. `tone` maps light to what can be shown. `shadow` finds out what share of a light a place sees, where lights cast shadows, and what share of its surroundings
//!    is open to ambient light. (`occlusion` estimates that from an image, as the renderer does.)
//! 5. `edl`: eye-dome lighting, where it is asked for.
//! 6. `fog`: what fog leaves of all that, and of the background, where the scene has some.
//! 7. `composite`: translucent triangles, lines and samples over all that, in the order of their depths. Depths, normals and ids are those of the nearest
//!    surface, translucent or not.
//!
//! Work is split by rows of the image; the order of primitives does not matter to the result, so that it
//! is the same on any number of threads.

mod blend;
pub mod color;
mod edl;
mod environment;
mod fog;
mod footprint;
mod lines;
pub mod occlusion;
mod paint;
mod patches;
mod physical;
mod predicates;
mod prepare;
mod pull_push;
mod shade;
mod shadow;
mod splats;
mod surface;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_blend;
#[cfg(test)]
mod tests_hard;
#[cfg(test)]
mod tests_shading;
#[cfg(test)]
mod tests_shadow;
#[cfg(test)]
mod tests_splats;
mod texture;
mod tone;
mod visibility;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use crate::assets::{Geometry, Material, Texture};
use crate::math::View;
use crate::scene::clipping::ClipRegion;
use crate::scene::recolor::Recolor;
use crate::scene::{
    AmbientOcclusion, Discs, EyeDome, Fog, Light, MaterialSpec, Painting, PullPush, Splats, Tone,
};

pub use environment::Surroundings;
pub use patches::{Level, Patch, Pyramid};

use blend::Blended;
use prepare::Prepared;
use visibility::{Hit, pixel_ray};

/// Geometry and lights of a frame.
#[derive(Clone, Debug, Default)]
pub struct OracleScene<'a> {
    pub items: Vec<OracleItem<'a>>,
    /// None leave every colour as it is.
    pub lights: &'a [Light],
    /// Whether lights that cast shadows do so; they shine through everything where this is false.
    pub shadows: bool,
    /// Linear RGB and straight alpha of pixels that nothing covers.
    pub background: [f32; 4],
    /// How samples are drawn as splats; `None` draws one pixel a sample.
    pub splats: Option<Splats>,
    /// How splats are painted over each other, where there are any; `None` for splats that hide what is behind them. Colours show painted
    /// splats, and other outputs what is behind.
    pub painted: Option<Painting>,
    /// How gaps between samples are filled; takes the place of `splats`.
    pub pull_push: Option<PullPush>,
    /// Discs that samples are drawn as where `splats` is `None`; `None` for points of one pixel.
    pub discs: Option<Discs>,
    /// Least width of lines, in pixels.
    pub least_line_px: f64,
    /// Value that colours surfaces in place of their own colours.
    pub recolor: Option<Recolor>,
    /// Region that the scene is clipped with.
    pub clip: Option<ClipRegion>,
    /// Eye-dome lighting, computed from the depths at the pixels' centres.
    pub edl: Option<EyeDome>,
    /// Surroundings that light everything, and that show where nothing else is if their [`Environment`](crate::scene::Environment) says so.
    pub surroundings: Option<Surroundings<'a>>,
    /// Fog that everything is seen through.
    pub fog: Option<Fog>,
    /// Ambient occlusion; none where splats are painted.
    pub occlusion: Option<AmbientOcclusion>,
    /// How light becomes colours.
    pub tone: Option<Tone>,
}

/// One geometry at one place.
#[derive(Clone, Copy, Debug)]
pub struct OracleItem<'a> {
    pub geometry: &'a Geometry,
    pub world_from_geometry: DAffine3,
    /// Materials of the mesh's parts; a part without material has [`Material::default`].
    pub materials: &'a [Material],
    /// Textures of the materials.
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
    /// Distance along the viewing axis at the pixel's centre (a sample's own distance, the mean of splats); infinite where
    /// nothing is.
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
/// a sample still covers its whole pixel, and the low-pass filter of splats keeps its size in pixels. Depth, normal and id
/// are those of the pixel's centre whatever n is.
pub fn render(scene: &OracleScene<'_>, view: &View, supersample: u32) -> OracleFrame {
    let prepared = Prepared::new(scene, view);
    let shown = self::shown(&prepared, view, 1, false);
    let opaque = prepared.has_translucent().then(|| self::shown(&prepared, view, 1, true));
    let color = colors(&prepared, view, supersample.max(1), opaque.as_deref().unwrap_or(&shown));
    let width = view.width as usize;
    let normal = shown.par_iter().enumerate().map(|(i, shown)| match shown {
        Shown::Nothing => DVec3::ZERO,
        Shown::Hit(hit) => surface::at(&prepared, view, hit, i % width, i / width).normal_world,
        Shown::Splats(blended) => blended.normal_world,
    });
    let id = |shown: &Shown| match shown {
        Shown::Nothing => 0,
        Shown::Hit(hit) => prepared.instance(hit) + 1,
        Shown::Splats(blended) => blended.instance + 1,
    };
    OracleFrame {
        width: view.width,
        height: view.height,
        normal: normal.collect(),
        depth: shown.iter().map(Shown::depth).collect(),
        id: shown.iter().map(id).collect(),
        color,
    }
}

/// Makes the levels of a view that pull-push reconstructs surfaces from, so that a renderer's can be compared with them one by one. Each step
/// starts from the levels that are `given`, or else from the oracle's own. `None` without [`OracleScene::pull_push`].
pub fn pyramid(scene: &OracleScene<'_>, view: &View, given: Option<&Pyramid>) -> Option<Pyramid> {
    let settings = scene.pull_push.as_ref()?;
    let prepared = &Prepared::new(scene, view);
    let hits = visibility::resolve(prepared, view, 1, false);
    Some(patches::Steps { prepared, view, settings }.pyramid(&hits, given))
}

/// The hit or the blended splats of a pixel.
#[derive(Clone, Copy, Debug)]
enum Shown {
    Nothing,
    /// A triangle, or a sample of one pixel.
    Hit(Hit),
    Splats(Blended),
}

impl Shown {
    fn hit(&self) -> Option<Hit> {
        match self {
            Shown::Hit(hit) => Some(*hit),
            Shown::Nothing | Shown::Splats(_) => None,
        }
    }

    fn depth(&self) -> f64 {
        match self {
            Shown::Nothing => f64::INFINITY,
            Shown::Hit(hit) => hit.depth,
            Shown::Splats(blended) => blended.depth,
        }
    }
}

/// Hits of the pixels of a frame, or of its `fineness` × `fineness` sub-pixels. `opaque`: without what is translucent.
fn shown(prepared: &Prepared<'_>, view: &View, fineness: u32, opaque: bool) -> Vec<Shown> {
    let hits = visibility::resolve(prepared, view, fineness, opaque);
    let or_hit = |hit: Option<Hit>| hit.map_or(Shown::Nothing, Shown::Hit);
    let fine_view = view.finer(fineness);
    if let Some(settings) = &prepared.scene.pull_push {
        let pulled = pull_push::pulled(prepared, &fine_view, settings, &hits);
        let shown = |(pulled, hit): (Option<Blended>, Option<Hit>)| {
            pulled.map_or_else(|| or_hit(hit), Shown::Splats)
        };
        return pulled.into_iter().zip(hits).map(shown).collect();
    }
    let Some(splats) = &prepared.scene.splats else {
        return hits.into_iter().map(or_hit).collect();
    };
    if prepared.scene.painted.is_some() {
        return hits.into_iter().map(or_hit).collect();
    }
    let settings = splats::Settings::new(splats, fineness);
    let blended = blend::splatted(prepared, &fine_view, &settings, &hits, opaque);
    let shown = |(blended, hit): (Option<Blended>, Option<Hit>)| {
        blended.map_or_else(|| or_hit(hit), Shown::Splats)
    };
    blended.into_iter().zip(hits).map(shown).collect()
}

/// The colour of every pixel, as the mean of `fineness` × `fineness` sub-pixels. `centres`: what is opaque at the pixels' centres.
fn colors(prepared: &Prepared<'_>, view: &View, fineness: u32, centres: &[Shown]) -> Vec<[f64; 4]> {
    let fine = (fineness > 1).then(|| self::shown(prepared, view, fineness, true));
    let shown = fine.as_deref().unwrap_or(centres);
    let fine_view = view.finer(fineness);
    let factors = edl_factors(prepared, view, centres);
    let (width, fine_width) = (view.width as usize, fine_view.width as usize);
    let n = fineness as usize;
    let background = prepared.scene.background.map(f64::from);
    let color = |(i, shown): (usize, &Shown)| {
        let (x, y) = (i % fine_width, i / fine_width);
        let color = match shown {
            Shown::Nothing => {
                let ray = pixel_ray(&fine_view, x, y);
                let background = behind(prepared, &fine_view, ray).unwrap_or(background);
                let through = |fog: &Fog| fog::background(fog, &fine_view, background, ray);
                return prepared.scene.fog.as_ref().map_or(background, through);
            }
            Shown::Hit(hit) => shaded(prepared, &fine_view, hit, x, y).color,
            Shown::Splats(blended) => blended.color,
        };
        let factor = factors.get(y / n * width + x / n).copied().unwrap_or(1.0);
        let color = color.map(|channel| channel * factor);
        opaque(foggy(prepared, &fine_view, color, shown.depth(), (x, y)))
    };
    let mut fine: Vec<[f64; 4]> = shown.par_iter().enumerate().map(color).collect();
    if let (Some(each), Some(splats)) = (prepared.scene.painted, &prepared.scene.splats) {
        let settings = splats::Settings::new(splats, fineness).painted();
        let hits: Vec<Option<Hit>> = shown.iter().map(Shown::hit).collect();
        paint::paint(prepared, &fine_view, (&settings, each), &hits, &mut fine);
    }
    if prepared.has_translucent() {
        let layers = visibility::layers(prepared, view, fineness);
        let transmits = prepared.transmits();
        let pixels = fine.par_iter_mut().zip(shown).zip(&layers).enumerate();
        pixels.for_each(|(i, ((color, shown), layers))| {
            let (x, y) = (i % fine_width, i / fine_width);
            composite(prepared, &fine_view, color, (shown, transmits), layers, (x, y));
        });
    }
    if n > 1 { box_filter(&fine, view, n) } else { fine }
}

/// The surroundings along the ray of a pixel, where they are the background.
fn behind(prepared: &Prepared<'_>, view: &View, ray: DVec3) -> Option<[f64; 4]> {
    let surroundings = prepared.scene.surroundings.filter(|own| own.environment.shown)?;
    let light = surroundings.light(view.view_from_world.transpose() * view.towards(ray));
    let toned = |tone: &Tone| tone::mapped(light, tone);
    Some(opaque(prepared.scene.tone.as_ref().map_or(light, toned)))
}

fn opaque([r, g, b]: [f64; 3]) -> [f64; 4] {
    [r, g, b, 1.0]
}

/// A pixel's colour as it is seen through fog from a depth.
fn foggy(
    prepared: &Prepared<'_>,
    view: &View,
    color: [f64; 3],
    depth: f64,
    (x, y): (usize, usize),
) -> [f64; 3] {
    let Some(fog) = &prepared.scene.fog else { return color };
    fog::seen_through(fog, view, color, view.at_depth(pixel_ray(view, x, y), depth))
}

/// What a hit shows.
struct Shaded {
    /// Under all lights.
    color: [f64; 3],
    alpha: f64,
    /// Share of the light from behind that passes what alpha leaves of the surface.
    passing: [f64; 3],
}

fn shaded(prepared: &Prepared<'_>, view: &View, hit: &Hit, x: usize, y: usize) -> Shaded {
    let mut surface = surface::at(prepared, view, hit, x, y);
    surface.recolor(prepared.scene.recolor.as_ref(), view, prepared.instance(hit));
    if !prepared.is_translucent(hit) {
        surface.open = prepared.ambient_share(&surface);
    }
    let is_lit = !prepared.scene.lights.is_empty() || prepared.scene.surroundings.is_some();
    let has_normal = is_lit && surface.normal_world != DVec3::ZERO;
    let to_eye = (-surface.way).try_normalize().unwrap_or(DVec3::ZERO);
    let facing = has_normal.then(|| surface.normal_world.dot(to_eye));
    let passing = |channel: usize| {
        let reflection = surface.details.reflection;
        reflection.map_or(0.0, |own| own.passing(surface.albedo[channel], channel, facing))
    };
    Shaded {
        color: shade::shade(&surface, prepared, view.eye),
        alpha: surface.alpha.clamp(0.0, 1.0),
        passing: std::array::from_fn(passing),
    }
}

/// Factors of eye-dome lighting, from the depths of what is opaque at the pixels' centres; none where it is off.
fn edl_factors(prepared: &Prepared<'_>, view: &View, centres: &[Shown]) -> Vec<f64> {
    let Some(edl) = &prepared.scene.edl else { return Vec::new() };
    let depth: Vec<f64> = centres.iter().map(Shown::depth).collect();
    let size = (view.width as usize, view.height as usize);
    let height = f64::from(view.height) / view.focal_px.y;
    let height = view.is_orthographic().then_some(height);
    let factor = |i| edl::factor(edl, height, &depth, size, (i % size.0, i / size.0));
    (0..depth.len()).into_par_iter().map(factor).collect()
}

/// Lays the translucent hits of a pixel before what is shown over its colour (Porter & Duff 1984, *over*), each channel by what it hides of that
/// channel. The colour below them is that of an image: clamped to 0..=1. `transmits`: some surface of the scene lets light pass, and highlights that
/// are brighter than what such surfaces hide make the pixel hide more.
fn composite(
    prepared: &Prepared<'_>,
    view: &View,
    color: &mut [f64; 4],
    (shown, transmits): (&Shown, bool),
    layers: &[Hit],
    (x, y): (usize, usize),
) {
    let is_before = |layer: &&Hit| match shown {
        Shown::Nothing => true,
        Shown::Hit(hit) => visibility::order(prepared, layer, hit).is_lt(),
        Shown::Splats(blended) => layer.depth < blended.depth,
    };
    let (mut sum, mut left) = ([0.0; 3], [1.0; 3]);
    for layer in layers.iter().filter(is_before) {
        let Shaded { color, alpha, passing } = shaded(prepared, view, layer, x, y);
        let foggy = |color| foggy(prepared, view, color, layer.depth, (x, y));
        // Fog before the surface counts once: what passes has met it behind the surface, too.
        let (own, fog) = (foggy(color), foggy([0.0; 3]));
        for channel in 0..3 {
            let passes = alpha * passing[channel];
            sum[channel] += left[channel] * (alpha * own[channel] - passes * fog[channel]);
            left[channel] *= 1.0 - alpha + passes;
        }
    }
    let hidden = 1.0 - left.iter().sum::<f64>() / 3.0;
    if hidden <= 0.0 && sum.iter().all(|&light| light <= 0.0) {
        return;
    }
    let below = color[3].clamp(0.0, 1.0);
    for channel in 0..3 {
        sum[channel] += below * left[channel] * color[channel].clamp(0.0, 1.0);
    }
    let mut alpha = hidden + below * (1.0 - hidden);
    if transmits {
        alpha = sum.into_iter().fold(alpha, f64::max).min(1.0);
    }
    let [r, g, b] = sum.map(|channel| channel / alpha);
    *color = [r, g, b, alpha];
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
