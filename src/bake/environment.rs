//! Surroundings as shaders read them: one octahedral image for each roughness of surfaces that reflect them, one for light that is
//! scattered, and one for balls.
//!
//! A surface reflects its surroundings blurred. The blur is a kernel about the mirrored direction, that of GGX's distribution seen along the normal
//! (Karis 2013). Each texel of a blurred image is a sum over cells of the surroundings. Cells are small where the kernel changes within a short
//! distance, and large elsewhere (Barnes & Hut 1986): a cell counts where its light has its centre, so that a sun far from the kernel's middle
//! is not lost.

use std::f32::consts::PI;

use glam::{DMat3, DVec3, Vec2, Vec3};
use half::f16;
use rayon::prelude::*;

use crate::assets::{AssetError, EnvironmentImage, ReadOptions};
use crate::generate::studio::studio;
use crate::memory::Reservation;
use crate::scene::{Environment, EnvironmentSource};

/// Images for mirrors from [`LEAST_ROUGHNESS`] on; from one to the next, the square of the roughness doubles. As in `shared/environment_map`.
pub const MIRRORED: usize = 10;
/// The image of light that a Lambertian surface scatters, by its normal.
pub const SCATTERED: usize = MIRRORED;
/// The image of light that a Lambertian ball scatters, by the direction that it is seen from.
pub const BALL: usize = MIRRORED + 1;
/// All images.
pub const IMAGES: usize = MIRRORED + 2;
/// Roughness of the first image, which is not blurred; as in `shared/physical`.
pub const LEAST_ROUGHNESS: f32 = 0.045;

/// Texels along a side of an image.
const SMALLEST_SIDE: u32 = 32;
const LARGEST_SIDE: u32 = 2048;
/// Side of the image that would resolve the kernel of the least roughness.
const FINEST_SIDE: u32 = 1024;
/// Largest cell, as a share of the distance within which a kernel changes.
const CELL: f32 = 0.3;
/// Texels along a side of a block that shares a list of cells.
const BLOCK: usize = 8;
/// The distance within which wide kernels change, in radians.
const WIDE: f32 = 0.25;

/// The image of a scene's surroundings.
///
/// # Errors
/// Any error of [`EnvironmentImage::read`].
pub fn image_of(
    environment: &Environment,
    options: &ReadOptions,
) -> Result<EnvironmentImage, AssetError> {
    match &environment.image {
        EnvironmentSource::File(path) => EnvironmentImage::read(path, options),
        EnvironmentSource::Studio => Ok(studio()),
    }
}

/// Octahedral images of surroundings, by directions of the world.
#[derive(Debug)]
pub struct EnvironmentMap {
    /// Two words for each texel, three numbers of 16 bits; before them, where each image begins (counted in texels) and how long its side is, and the factor of
    /// all light. Images have a border of a texel on each side.
    pub texels: Vec<[u32; 2]>,
    /// Mean light over all directions, linear RGB.
    pub mean: [f32; 3],
    /// Pixels that nothing covers show it.
    pub shown: bool,
    /// The host memory that it holds.
    pub memory: Reservation,
}

impl EnvironmentMap {
    /// Bytes that are needed while the map of an image is made, the map's own among them.
    pub fn needed_bytes(image: &EnvironmentImage) -> u64 {
        let texels: u64 = sides(image).into_iter().map(|side| u64::from(side + 2).pow(2)).sum();
        let cells = u64::from(blurred_side(image)).pow(2) * 4 / 3 * size_of::<Cell>() as u64;
        cells + 2 * texels * 8
    }

    pub fn bytes(&self) -> u64 {
        self.texels.len() as u64 * 8
    }

    /// Blurs an image for every roughness.
    pub fn of(image: &EnvironmentImage, environment: &Environment) -> EnvironmentMap {
        let source = Source { image, environment };
        let cells = Cells::of(&source, blurred_side(image));
        let mean = cells.mean();
        let mut texels = vec![[0; 2]; IMAGES + 1];
        texels[IMAGES] = [(environment.strength as f32).to_bits(), 0];
        for (number, side) in sides(image).into_iter().enumerate() {
            let light = match number {
                0 => source.image(side),
                SCATTERED => cells.blurred(side, &Lambert),
                BALL => cells.blurred(side, &Ball),
                _ => {
                    let alpha = LEAST_ROUGHNESS.powi(2) * (number as f32).exp2();
                    cells.blurred(side, &Ggx { alpha })
                }
            };
            texels[number] = [texels.len() as u32, side];
            texels.extend(framed(side, &light));
        }
        EnvironmentMap {
            texels,
            mean: (mean * environment.strength as f32).to_array(),
            shown: environment.shown,
            memory: Reservation::default(),
        }
    }
}

/// Side of the unblurred image: it has about two texels for each of the surroundings' image along the horizon.
fn full_side(image: &EnvironmentImage) -> u32 {
    image.width.next_power_of_two().clamp(SMALLEST_SIDE, LARGEST_SIDE)
}

fn blurred_side(image: &EnvironmentImage) -> u32 {
    full_side(image).min(FINEST_SIDE)
}

fn sides(image: &EnvironmentImage) -> [u32; IMAGES] {
    std::array::from_fn(|number| match number {
        0 => full_side(image),
        SCATTERED | BALL => SMALLEST_SIDE,
        _ => (FINEST_SIDE >> number).max(SMALLEST_SIDE).min(blurred_side(image)),
    })
}

/// The direction of a place of an octahedral image; -1 to 1 along both sides.
fn direction(at: Vec2) -> Vec3 {
    let z = 1.0 - at.x.abs() - at.y.abs();
    let fold = (-z).max(0.0);
    let v = Vec3::new(at.x - fold.copysign(at.x), at.y - fold.copysign(at.y), z);
    v / v.length()
}

/// The solid angle about a place for each unit of area there: the octahedron's face is seen under it.
fn solid_angle(at: Vec2) -> f32 {
    let z = 1.0 - at.x.abs() - at.y.abs();
    let folded = (-z).max(0.0);
    Vec3::new(at.x.abs() - folded, at.y.abs() - folded, z).length().powi(-3)
}

/// The middle of a texel.
fn middle(x: u32, y: u32, side: u32) -> Vec2 {
    (Vec2::new(x as f32, y as f32) + 0.5) * (2.0 / side as f32) - 1.0
}

/// An image with its border, which continues it beyond its edges: across an edge lies the other half of the same edge.
fn framed(side: u32, light: &[Vec3]) -> Vec<[u32; 2]> {
    let last = i64::from(side) - 1;
    let inside = |x: i64, y: i64| {
        let (x, y) = if (0..=last).contains(&x) { (x, y) } else { (x.clamp(0, last), last - y) };
        let (x, y) = if (0..=last).contains(&y) { (x, y) } else { (last - x, y.clamp(0, last)) };
        packed(light[(y * i64::from(side) + x) as usize])
    };
    let row = |y: i64| (-1..=last + 1).map(move |x| inside(x, y));
    (-1..=last + 1).flat_map(row).collect()
}

/// Three numbers of 16 bits, as `shared/halves` reads them. Light that is too bright for them is the brightest of them, and light below the least normal number none.
fn packed(light: Vec3) -> [u32; 2] {
    let half = |c: f32| match f16::from_f32(c.min(f16::MAX.to_f32())) {
        half if half < f16::MIN_POSITIVE => 0,
        half => u32::from(half.to_bits()),
    };
    let [r, g, b] = light.to_array().map(half);
    [r | g << 16, b]
}

/// An image of surroundings, and how it is turned.
struct Source<'a> {
    image: &'a EnvironmentImage,
    environment: &'a Environment,
}

impl Source<'_> {
    /// The mean light of each texel of an octahedral image.
    fn image(&self, side: u32) -> Vec<Vec3> {
        // So many places along a side of a texel that no pixel of the surroundings' image is passed over: texels are 3.4 / side wide at the horizon.
        let places = (1.07 * self.image.width as f32 / side as f32).ceil() as u32;
        let texel = |i: u32| {
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for place in 0..places * places {
                let x = i % side * places + place % places;
                let y = i / side * places + place / places;
                let at = middle(x, y, side * places);
                let weight = solid_angle(at);
                sum += self.at(direction(at)) * weight;
                weights += weight;
            }
            sum / weights
        };
        (0..side * side).into_par_iter().map(texel).collect()
    }

    /// The light of a direction, interpolated.
    fn at(&self, direction: Vec3) -> Vec3 {
        let turn: &DMat3 = &self.environment.image_from_world;
        let way = (*turn * direction.as_dvec3()).normalize_or(DVec3::Y);
        let (width, height) = (i64::from(self.image.width), i64::from(self.image.height));
        let turned = way.x.atan2(-way.z) / std::f64::consts::TAU + 0.5;
        let down = way.y.clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
        let (x, y) = (turned * width as f64 - 0.5, down * height as f64 - 0.5);
        let texel = |x: i64, y: i64| {
            let (x, y) = (x.rem_euclid(width), y.clamp(0, height - 1));
            Vec3::from_array(self.image.radiance[(y * width + x) as usize])
        };
        let (left, top) = (x.floor(), y.floor());
        let (right, low) = ((x - left) as f32, (y - top) as f32);
        let row = |y: i64| texel(left as i64, y).lerp(texel(left as i64 + 1, y), right);
        row(top as i64).lerp(row(top as i64 + 1), low)
    }
}

/// A kernel about a direction; `chord` is the squared distance of a direction from it on the unit sphere.
trait Kernel: Sync {
    fn value(&self, chord: f32) -> f32;
    /// Distance in radians within which the kernel changes in its middle.
    fn width(&self) -> f32;
}

/// GGX's distribution of the half vector, and the cosine of the light, for an eye along the normal.
struct Ggx {
    alpha: f32,
}

impl Kernel for Ggx {
    fn value(&self, chord: f32) -> f32 {
        // The squared sine of half the angle.
        let half = 0.25 * chord;
        let spread = half + (1.0 - half) * self.alpha * self.alpha;
        (1.0 - 0.5 * chord).max(0.0) / (spread * spread)
    }

    fn width(&self) -> f32 {
        (2.0 * self.alpha).min(WIDE)
    }
}

struct Lambert;

impl Kernel for Lambert {
    fn value(&self, chord: f32) -> f32 {
        (1.0 - 0.5 * chord).max(0.0)
    }

    fn width(&self) -> f32 {
        WIDE
    }
}

/// The phase function of a Lambertian ball (Schönberg 1929).
struct Ball;

impl Kernel for Ball {
    fn value(&self, chord: f32) -> f32 {
        let cosine = (1.0 - 0.5 * chord).clamp(-1.0, 1.0);
        (1.0 - cosine * cosine).sqrt() + (PI - cosine.acos()) * cosine
    }

    fn width(&self) -> f32 {
        WIDE
    }
}

/// A part of the sphere of directions.
#[derive(Clone, Copy)]
struct Cell {
    light: Vec3,
    solid_angle: f32,
    /// The mean of its directions, of unit length.
    middle: Vec3,
    /// The same weighted by brightness.
    centre: Vec3,
}

/// Cells of an octahedral image: all in one, then each of them in four, and so on.
struct Cells {
    levels: Vec<Vec<Cell>>,
}

impl Cells {
    fn of(source: &Source<'_>, side: u32) -> Cells {
        let light = source.image(side);
        let finest = |i: u32| {
            let at = middle(i % side, i / side, side);
            let own = direction(at);
            Cell {
                light: light[i as usize],
                solid_angle: solid_angle(at) * (2.0 / side as f32).powi(2),
                middle: own,
                centre: own,
            }
        };
        let mut levels = vec![(0..side * side).into_par_iter().map(finest).collect::<Vec<Cell>>()];
        let mut fine = side;
        while fine > 1 {
            let children = &levels[levels.len() - 1];
            let coarse = fine / 2;
            let parent = |i: u32| {
                let first = (i / coarse * 2 * fine + i % coarse * 2) as usize;
                let four = [first, first + 1, first + fine as usize, first + fine as usize + 1];
                Cell::of(four.map(|child| children[child]))
            };
            let parents = (0..coarse * coarse).into_par_iter().map(parent).collect();
            levels.push(parents);
            fine = coarse;
        }
        levels.reverse();
        Cells { levels }
    }

    fn mean(&self) -> Vec3 {
        self.levels[0][0].light
    }

    /// An image of all light, weighted by a kernel about each texel's direction. A block of texels shares its list of cells.
    fn blurred(&self, side: u32, kernel: &impl Kernel) -> Vec<Vec3> {
        let across = side / BLOCK as u32;
        let blocks: Vec<Vec<Vec3>> = (0..across * across)
            .into_par_iter()
            .map(|block| {
                let [left, top] = [block % across, block / across].map(|at| at * BLOCK as u32);
                let row = |y: u32| -> [Vec3; BLOCK] {
                    std::array::from_fn(|x| direction(middle(left + x as u32, top + y, side)))
                };
                let rows: Vec<[Vec3; BLOCK]> = (0..BLOCK as u32).map(row).collect();
                let cells = self.list(rows.as_flattened(), kernel);
                rows.iter().flat_map(|ways| blurred_row(ways, &cells, kernel)).collect()
            })
            .collect();
        let texel = |i: u32| {
            let [(block_x, x), (block_y, y)] =
                [i % side, i / side].map(|at| (at / BLOCK as u32, at % BLOCK as u32));
            blocks[(block_y * across + block_x) as usize][(y * BLOCK as u32 + x) as usize]
        };
        (0..side * side).map(texel).collect()
    }

    /// The cells that a kernel about any of these directions needs.
    fn list(&self, ways: &[Vec3], kernel: &impl Kernel) -> Vec<Cell> {
        let about = ways.iter().sum::<Vec3>().normalize_or(ways[0]);
        let radius = ways.iter().map(|way| way.distance(about)).fold(0.0, f32::max);
        let mut listed = Vec::new();
        let mut stack = vec![(0, 0u32, 0u32)];
        while let Some((level, x, y)) = stack.pop() {
            let side = 1u32 << level;
            let cell = &self.levels[level][(y * side + x) as usize];
            let size = cell.solid_angle.sqrt();
            let distance = about.distance(cell.middle) - radius - size;
            if size > CELL * kernel.width().max(distance) && level + 1 < self.levels.len() {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
                stack.extend(four.map(|(i, j)| (level + 1, 2 * x + i, 2 * y + j)));
            } else {
                listed.push(*cell);
            }
        }
        listed
    }
}

/// The mean of the light of cells about each direction of a row, weighted by a kernel. A loop over the row is one over lanes of a vector register.
fn blurred_row(ways: &[Vec3; BLOCK], cells: &[Cell], kernel: &impl Kernel) -> [Vec3; BLOCK] {
    let [x, y, z]: [[f32; BLOCK]; 3] = [
        std::array::from_fn(|i| ways[i].x),
        std::array::from_fn(|i| ways[i].y),
        std::array::from_fn(|i| ways[i].z),
    ];
    let mut sums = [[0.0; BLOCK]; 3];
    let mut weights = [0.0; BLOCK];
    for cell in cells {
        let light = cell.light * cell.solid_angle;
        let value = |i: usize, at: Vec3| {
            let (dx, dy, dz) = (x[i] - at.x, y[i] - at.y, z[i] - at.z);
            kernel.value(dx * dx + dy * dy + dz * dz)
        };
        for i in 0..BLOCK {
            weights[i] += cell.solid_angle * value(i, cell.middle);
            let weight = value(i, cell.centre);
            sums[0][i] += light.x * weight;
            sums[1][i] += light.y * weight;
            sums[2][i] += light.z * weight;
        }
    }
    std::array::from_fn(|i| Vec3::new(sums[0][i], sums[1][i], sums[2][i]) / weights[i])
}

impl Cell {
    /// Of four that make it up.
    fn of(four: [Cell; 4]) -> Cell {
        let solid_angle: f32 = four.iter().map(|cell| cell.solid_angle).sum();
        let light: Vec3 = four.iter().map(|cell| cell.light * cell.solid_angle).sum();
        let middle: Vec3 = four.iter().map(|cell| cell.middle * cell.solid_angle).sum();
        let middle = middle.normalize_or(four[0].middle);
        let bright = |cell: &Cell| cell.centre * (cell.solid_angle * cell.light.element_sum());
        let centre: Vec3 = four.iter().map(bright).sum();
        Cell {
            light: light / solid_angle,
            solid_angle,
            middle,
            centre: centre.normalize_or(middle),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment() -> Environment {
        let image = EnvironmentSource::File("sky.hdr".into());
        Environment { image, strength: 1.0, image_from_world: DMat3::IDENTITY, shown: true }
    }

    /// A sky that is brighter above, with a sun of one texel.
    fn sunny() -> EnvironmentImage {
        let (width, height) = (64, 32);
        let mut radiance: Vec<[f32; 3]> =
            (0..width * height).map(|i| [1.0 - (i / width) as f32 / height as f32; 3]).collect();
        radiance[10 * width as usize + 21] = [4000.0, 3000.0, 2000.0];
        EnvironmentImage { width, height, radiance }
    }

    /// The texels of an image, by their directions.
    fn each<T: Send>(side: u32, texel: impl Fn(Vec3) -> T + Sync) -> Vec<T> {
        let at = |i: u32| texel(direction(middle(i % side, i / side, side)));
        (0..side * side).into_par_iter().map(at).collect()
    }

    fn unpacked([low, high]: [u32; 2]) -> [f32; 3] {
        [low as u16, (low >> 16) as u16, high as u16].map(|bits| f16::from_bits(bits).to_f32())
    }

    #[test]
    fn light_that_is_alike_everywhere_stays_so() {
        let image = EnvironmentImage { width: 16, height: 8, radiance: vec![[0.5, 1.0, 2.0]; 128] };
        let map = EnvironmentMap::of(&image, &environment());
        assert!((Vec3::from(map.mean) - Vec3::new(0.5, 1.0, 2.0)).abs().max_element() < 1e-5);
        for texel in &map.texels[IMAGES + 1..] {
            assert_eq!(unpacked(*texel), [0.5, 1.0, 2.0]);
        }
        assert_eq!(map.texels[..IMAGES].last().map(|last| last[1]), Some(SMALLEST_SIDE));
        assert!(map.bytes() <= EnvironmentMap::needed_bytes(&image));
    }

    /// Solid angles of all cells add up to the sphere, and each level has all the light.
    #[test]
    fn cells_have_all_directions_and_all_light() {
        let (image, own) = (sunny(), environment());
        let cells = Cells::of(&Source { image: &image, environment: &own }, 64);
        let light = |level: &[Cell]| -> Vec3 {
            level.iter().map(|cell| cell.light * cell.solid_angle).sum()
        };
        let all = light(&cells.levels[6]);
        for level in &cells.levels {
            let sphere: f32 = level.iter().map(|cell| cell.solid_angle).sum();
            assert!((sphere / (4.0 * PI) - 1.0).abs() < 1e-3, "{sphere}");
            assert!((light(level) - all).abs().max_element() < 1e-3 * all.x);
        }
    }

    /// The mean of the cells is that of the image, whose pixels have exact solid angles: also where all light is that of one pixel.
    #[test]
    fn small_suns_keep_their_light() {
        for (width, column, row) in
            [(64, 5, 9), (256, 100, 64), (2048, 256, 256), (2048, 1024, 511), (4096, 512, 1023)]
        {
            let height = width / 2;
            let mut radiance = vec![[0.0; 3]; (width * height) as usize];
            radiance[row * width as usize + column] = [1e6, 1e6, 1e6];
            let image = EnvironmentImage { width, height, radiance };
            let own = environment();
            let cells =
                Cells::of(&Source { image: &image, environment: &own }, blurred_side(&image));
            let edge = |row: usize| (std::f64::consts::PI * row as f64 / f64::from(height)).cos();
            let share = (edge(row) - edge(row + 1)) / (2.0 * f64::from(width));
            let found = f64::from(cells.mean().x) / (1e6 * share);
            assert!((found - 1.0).abs() < 0.12, "{width}, {column}, {row}: {found}");
        }
    }

    /// Large cells blur as the smallest ones do, also far from a sun that outshines everything.
    #[test]
    fn cells_blur_as_all_texels_do() {
        let (image, own) = (sunny(), environment());
        let cells = Cells::of(&Source { image: &image, environment: &own }, 64);
        fn exact(cells: &Cells, direction: Vec3, kernel: &impl Kernel) -> Vec3 {
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for cell in &cells.levels[6] {
                let weight =
                    cell.solid_angle * kernel.value(direction.distance_squared(cell.middle));
                sum += cell.light * weight;
                weights += weight;
            }
            sum / weights
        }
        fn check(cells: &Cells, kernel: &impl Kernel) {
            let side = 32;
            let found = cells.blurred(side, kernel);
            let all = each(side, |way| exact(cells, way, kernel));
            // At the horizon of a wide kernel, a part of a cell may be above it.
            let brightest = all.iter().map(|light| light.max_element()).fold(0.0, f32::max);
            for (found, all) in found.iter().zip(&all) {
                let apart = (found - all).abs().max_element();
                let bound = 0.03 * all.min_element() + 0.008 * brightest;
                assert!(apart < bound, "{}: {found} {all}", kernel.width());
            }
        }
        for alpha in [0.03, 0.2, 1.0] {
            check(&cells, &Ggx { alpha });
        }
        check(&cells, &Lambert);
        check(&cells, &Ball);
    }

    /// The border of an image continues it: beyond an edge come the texels of the same edge, in reverse.
    #[test]
    fn borders_continue_images() {
        let side = 4;
        let texels = framed(side, &each(side, |way| way + 1.5));
        let row = side as usize + 2;
        let at = |x: usize, y: usize| Vec3::from(unpacked(texels[y * row + x]));
        for i in 1..=side as usize {
            assert_eq!(at(0, i), at(1, row - 1 - i));
            assert_eq!(at(i, row - 1), at(row - 1 - i, row - 2));
        }
        assert_eq!(at(0, 0), at(row - 2, row - 2));
    }

    #[test]
    fn light_beyond_16_bits_is_the_brightest_or_none() {
        assert_eq!(unpacked(packed(Vec3::new(1e9, 1e-6, 1.0))), [65504.0, 0.0, 1.0]);
    }
}
