//! Samples of a mesh's surface, whose disks cover it and end at its sharp edges (Zwicker 2004, §5).
//!
//! 1. *Spread.* Random places, evenly over the area, become samples in a fixed order unless the inner part of an earlier
//!    sample's disk covers them: neighbours keep their distance (dart throwing).
//! 2. *Fill.* Every triangle is halved along its longest edge until each piece lies **wholly** in one sample's disk: near its
//!    tangent plane, on the kept side of its clip lines, facing its way. A piece that is small and lies in none gets a
//!    sample of its own. So there are no holes, by construction, whatever the triangles' shapes.
//! 3. *Clip.* A disk that crosses a sharp edge or a border ends there ([`clip`]); a disk that would have to end at more than
//!    two lines is made smaller, down to a 16th, which bounds what juts out.
//! 4. *Colour.* Vertex colour, material and texture averaged over the disk ([`color`]).
//!
//! A cube, a bracket, a ball, a can, sheets and needles: 0 of 60 000 random places are open, 2.7 disks lie over one; there are
//! 3 to 8 % more samples than squares of the spacing (`tests`).
//!
//! Everything runs in one order on one thread: equal input gives equal samples.

mod clip;
pub(super) mod color;
mod edges;

use glam::{DVec3, Vec3};

use self::clip::choose;
use self::color::Colors;
use self::edges::{Edges, Sharp};
use super::crease::{WordMap, smooth_normals};
use super::kernels::{CUTOFF, circle};
use crate::assets::{Clip, Kernel, Material, Mesh, PointCloud, Texture};
use crate::scene::random::SplitMix64;

/// Options for sampling a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleOptions {
    /// About the distance between neighbouring samples, in mesh units: a sample stands for a square of this side. `None`
    /// gives about as many samples as there are vertices, but 20 000 at least and a million at most.
    pub spacing: Option<f64>,
    /// More are refused.
    pub max_samples: u64,
    /// Edges at which faces turn by more than this, in degrees, are sharp.
    pub crease_deg: f64,
}

impl Default for SampleOptions {
    fn default() -> Self {
        Self { spacing: None, max_samples: 1 << 24, crease_deg: 35.0 }
    }
}

/// Why a mesh was not sampled.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SampleError {
    #[error("sampling would give {count} samples or more, over the limit of {limit}")]
    TooMany { count: u64, limit: u64 },
    #[error("a spacing of {spacing} is no positive length")]
    Spacing { spacing: f64 },
}

/// Radius of a full disk over the spacing: such that a sample stands for about a square of the spacing.
const DISK: f64 = 0.92;
/// Places thrown for each sample expected, and the inner part of a disk that keeps others away.
const DARTS: f64 = 6.0;
const INNER: f64 = 0.8;
/// Pieces with a longer side (in disk radii) are halved before they get a sample.
const PIECE: f64 = 0.2;
/// The smallest disk, in full ones.
const SMALLEST: f64 = 1.0 / 16.0;
/// Height above a sample's tangent plane, in radii of its disk, up to which the disk stands for the surface.
pub(super) const HEIGHT: f64 = 0.2;
/// Cosine between a sample's normal and a face's, above which it may stand for it.
pub(super) const FACING: f64 = 0.5;
const LEAST_AUTOMATIC: f64 = 2e4;
const MOST_AUTOMATIC: f64 = 1e6;

/// Samples the surface of a mesh, whose parts refer to `materials`, and these to `textures`.
///
/// Each sample has a position, a unit normal (interpolated from the vertices, or the face's where those disagree with it
/// by more than the crease angle), a colour, a radius and a circular kernel whose disk at [`CUTOFF`] has that radius, and
/// its clip lines. Every point of every triangle lies in some sample's disk, within a fifth of its radius of the
/// tangent plane, and is kept by its lines. What a material's alpha cut-off removes is left out; triangles without area
/// and those whose vertices do not exist are, too.
///
/// # Errors
/// More samples than `max_samples`, or a spacing that is no positive number.
pub fn sample_mesh(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    options: &SampleOptions,
) -> Result<PointCloud, SampleError> {
    let faces = faces_of(mesh);
    let area: f64 = faces.iter().map(|face| face.area).sum();
    let most = MOST_AUTOMATIC.min(0.5 * options.max_samples as f64).max(1.0);
    let wanted = (mesh.positions.len() as f64).max(LEAST_AUTOMATIC).min(most);
    let spacing = options.spacing.unwrap_or_else(|| (area / wanted).sqrt());
    if faces.is_empty() {
        return Ok(PointCloud::default());
    }
    if !(spacing > 0.0 && spacing.is_finite()) {
        return Err(SampleError::Spacing { spacing });
    }
    let too_many = |count: f64| SampleError::TooMany {
        count: count.min(u64::MAX as f64) as u64,
        limit: options.max_samples,
    };
    let count = area / (spacing * spacing);
    if count.is_nan() || count > options.max_samples as f64 {
        return Err(too_many(count));
    }
    let radius = spacing * DISK;
    let crease_cosine = options.crease_deg.clamp(0.0, 180.0).to_radians().cos();
    let edges =
        Edges::of(mesh, &faces, crease_cosine, radius, options.max_samples).map_err(too_many)?;
    let smoothed = mesh.normals.is_none().then(|| {
        let mut copy = mesh.clone();
        smooth_normals(&mut copy, options.crease_deg);
        copy
    });
    let shape = smoothed.as_ref().unwrap_or(mesh);
    let mut sampler = Sampler {
        shape,
        faces: &faces,
        edges,
        crease_cosine,
        radius,
        limit: options.max_samples,
        samples: Vec::new(),
        heads: WordMap::default(),
        near: Vec::new(),
    };
    sampler.spread(area)?;
    sampler.fill()?;
    let colors = Colors::of(mesh, materials, textures);
    Ok(cloud_of(&sampler.samples, &faces, &colors))
}

/// Samples that [`sample_mesh`] is about to take of a mesh, more or less; 0 where it refuses the options.
pub fn expected_samples(mesh: &Mesh, options: &SampleOptions) -> u64 {
    let area: f64 = faces_of(mesh).iter().map(|face| face.area).sum();
    let count = match options.spacing {
        Some(spacing) => area / (spacing * spacing),
        None => (mesh.positions.len() as f64).clamp(LEAST_AUTOMATIC, MOST_AUTOMATIC),
    };
    if count <= options.max_samples as f64 { count as u64 } else { 0 }
}

/// A triangle with an area.
#[derive(Clone, Copy, Debug)]
struct Face {
    triangle: u32,
    corners: [DVec3; 3],
    normal: DVec3,
    area: f64,
}

fn faces_of(mesh: &Mesh) -> Vec<Face> {
    let face = |(triangle, indices): (u32, &[u32; 3])| {
        let corner = |i: usize| mesh.positions.get(indices[i] as usize).filter(|p| p.is_finite());
        let corners = [*corner(0)?, *corner(1)?, *corner(2)?];
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let normal = cross.try_normalize()?;
        Some(Face { triangle, corners, normal, area: 0.5 * cross.length() })
    };
    (0..u32::MAX).zip(&mesh.triangles).filter_map(face).collect()
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    position: DVec3,
    normal: DVec3,
    radius: f64,
    kernel: Kernel,
    clip: Clip,
    face: u32,
    /// The next sample in the same cell.
    next: u32,
}

const NONE: u32 = u32::MAX;

impl Sample {
    /// Tells whether the scaled disk stands for the whole of a piece of a face.
    fn covers<const N: usize>(&self, piece: [DVec3; N], normal: DVec3, scale: f64) -> bool {
        if self.normal.dot(normal) < FACING {
            return false;
        }
        let reach = self.radius * scale;
        let mut at = [glam::Vec2::ZERO; N];
        let deviation = f64::from(CUTOFF) / self.radius;
        for (at, point) in at.iter_mut().zip(piece) {
            let d = point - self.position;
            let height = d.dot(self.normal);
            if d.length_squared() - height * height > reach * reach
                || height.abs() > HEIGHT * self.radius
            {
                return false;
            }
            let unit = |axis: Vec3| d.dot(axis.as_dvec3().normalize_or_zero()) * deviation;
            *at = glam::DVec2::new(unit(self.kernel.u), unit(self.kernel.v)).as_vec2();
        }
        let mut sides = self.clip.lines.iter().flatten().map(|line| {
            // Rounding of points on the line itself.
            at.iter().all(|at| line.normal.dot(*at) >= line.offset - 1e-6)
        });
        if self.clip.either { sides.any(|kept| kept) } else { sides.all(|kept| kept) }
    }
}

struct Sampler<'a> {
    shape: &'a Mesh,
    faces: &'a [Face],
    edges: Edges,
    crease_cosine: f64,
    radius: f64,
    limit: u64,
    samples: Vec<Sample>,
    /// The latest sample of each cell as large as a full disk's radius.
    heads: WordMap<(i32, i32, i32), u32>,
    /// Reused between samples.
    near: Vec<Sharp>,
}

impl Sampler<'_> {
    fn cell(&self, point: DVec3) -> glam::IVec3 {
        ((point - self.faces[0].corners[0]) / self.radius).floor().as_ivec3()
    }

    /// Tells whether an earlier sample stands for the whole of a piece.
    fn is_covered<const N: usize>(&self, piece: [DVec3; N], normal: DVec3, scale: f64) -> bool {
        // A disk that covers a piece is centred within a radius of its first corner, nearly: its plane may be a little off.
        let cell = self.cell(piece.iter().sum::<DVec3>() / N as f64);
        for index in 0..27 {
            let step = glam::IVec3::new(index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1);
            let at = cell.saturating_add(step);
            let mut next = self.heads.get(&(at.x, at.y, at.z)).copied().unwrap_or(NONE);
            while let Some(sample) = self.samples.get(next as usize) {
                if sample.covers(piece, normal, scale) {
                    return true;
                }
                next = sample.next;
            }
        }
        false
    }

    /// Places darts, spread over all faces by area.
    fn spread(&mut self, area: f64) -> Result<(), SampleError> {
        let per_area = DARTS / (self.radius * self.radius);
        let mut random = SplitMix64::new(0x5a3e);
        let mut darts: Vec<(u32, [f32; 2])> = Vec::with_capacity((area * per_area) as usize + 1);
        // The remainder of a face's share carries over to the next face, so small faces also get samples.
        let mut due = 0.5;
        for (face, index) in self.faces.iter().zip(0u32..) {
            due += face.area * per_area;
            while due >= 1.0 {
                due -= 1.0;
                let (a, b) = (random.unit(), random.unit());
                let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                darts.push((index, [a as f32, b as f32]));
            }
        }
        for last in (1..darts.len()).rev() {
            darts.swap(last, random.index(last + 1));
        }
        for (face, [a, b]) in darts {
            let Face { corners: [o, p, q], normal, .. } = self.faces[face as usize];
            let point = o + (p - o) * f64::from(a) + (q - o) * f64::from(b);
            if !self.is_covered([point], normal, INNER) {
                self.place(point, face)?;
            }
        }
        Ok(())
    }

    /// Covers what the darts left open.
    fn fill(&mut self) -> Result<(), SampleError> {
        let mut pieces: Vec<[DVec3; 3]> = Vec::new();
        for (face, index) in self.faces.iter().zip(0u32..) {
            pieces.push(face.corners);
            while let Some(piece) = pieces.pop() {
                let [a, b, c] = piece;
                let sides = [b.distance(c), c.distance(a), a.distance(b)];
                let longest = sides[0].max(sides[1]).max(sides[2]);
                if longest <= 2.0 * self.radius && self.is_covered(piece, face.normal, 1.0) {
                    continue;
                }
                if longest <= PIECE * self.radius {
                    self.place((a + b + c) / 3.0, index)?;
                    let own = self.samples.last();
                    if own.is_some_and(|own| own.covers(piece, face.normal, 1.0))
                        || longest <= 0.25 * SMALLEST * self.radius
                    {
                        continue;
                    }
                }
                // Halve the longest side; the first of equal ones.
                let [a, b, c] = match sides.iter().position(|&side| side == longest) {
                    Some(0) => [a, b, c],
                    Some(1) => [b, c, a],
                    _ => [c, a, b],
                };
                let middle = 0.5 * (b + c);
                pieces.extend([[a, b, middle], [a, middle, c]]);
            }
        }
        Ok(())
    }

    fn place(&mut self, position: DVec3, face: u32) -> Result<(), SampleError> {
        let count = self.samples.len() as u64 + 1;
        if count > self.limit.min(u64::from(NONE)) {
            return Err(SampleError::TooMany { count, limit: self.limit });
        }
        let normal = self.normal(position, face as usize);
        self.edges.near(position, normal, self.radius, &mut self.near);
        let smallest = SMALLEST * self.radius;
        let mut radius = self.radius;
        let clip = loop {
            let last = radius <= smallest;
            match choose(&self.near, radius, last) {
                Some(clip) => break clip,
                None => radius = (radius * 0.7).max(smallest),
            }
        };
        let kernel = circle(normal.as_vec3(), (radius / f64::from(CUTOFF)) as f32);
        let clip = clip::in_kernel(&clip, radius / f64::from(CUTOFF));
        let cell = self.cell(position);
        let here = self.samples.len() as u32;
        let next = self.heads.insert((cell.x, cell.y, cell.z), here).unwrap_or(NONE);
        self.samples.push(Sample { position, normal, radius, kernel, clip, face, next });
        Ok(())
    }

    /// The normal of a place on a face.
    fn normal(&self, position: DVec3, face: usize) -> DVec3 {
        let face = &self.faces[face];
        let Some(normals) = &self.shape.normals else { return face.normal };
        let corners = self.shape.triangles[face.triangle as usize];
        let mut sum = DVec3::ZERO;
        for (weight, corner) in barycentric(face, position).into_iter().zip(corners) {
            let normal = normals.get(corner as usize).copied().unwrap_or(Vec3::ZERO).as_dvec3();
            // A little slack: facets at just the crease angle are smooth.
            if normal.dot(face.normal) < self.crease_cosine - 1e-3 {
                return face.normal;
            }
            sum += normal * weight;
        }
        sum.try_normalize().unwrap_or(face.normal)
    }
}

/// Weights of a face's corners at a place.
fn barycentric(face: &Face, at: DVec3) -> [f64; 3] {
    let [a, b, c] = face.corners;
    let double = (2.0 * face.area).max(f64::MIN_POSITIVE);
    let weight =
        |p: DVec3, q: DVec3| ((p - at).cross(q - at).dot(face.normal) / double).clamp(0.0, 1.0);
    let (u, v) = (weight(b, c), weight(c, a));
    [u, v, (1.0 - u - v).max(0.0)]
}

fn cloud_of(samples: &[Sample], faces: &[Face], colors: &Colors) -> PointCloud {
    let colored: Vec<(&Sample, [u8; 4])> = samples
        .iter()
        .filter_map(|sample| {
            let face = &faces[sample.face as usize];
            let weights = barycentric(face, sample.position);
            Some((sample, colors.at(face, weights, sample.position, sample.radius)?))
        })
        .collect();
    PointCloud {
        positions: colored.iter().map(|(sample, _)| sample.position).collect(),
        colors: Some(colored.iter().map(|&(_, color)| color).collect()),
        normals: Some(colored.iter().map(|(sample, _)| sample.normal.as_vec3()).collect()),
        radii: Some(colored.iter().map(|(sample, _)| sample.radius as f32).collect()),
        kernels: Some(colored.iter().map(|(sample, _)| sample.kernel).collect()),
        clips: Some(colored.iter().map(|(sample, _)| sample.clip).collect()),
        ..PointCloud::default()
    }
}

#[cfg(test)]
mod tests;
