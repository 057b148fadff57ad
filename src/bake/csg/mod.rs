//! Constructive solid geometry of sampled solids (Zwicker et al. 2004, §5; Pauly et al. 2003).
//!
//! In: point clouds in one frame whose normals look outward and whose kernels cover the surface. Out: one cloud, made of the
//! operands' own samples. Each is held against the other solid's surface:
//!
//! - far from it, an inside/outside test keeps or drops it ([`surface`]);
//! - where its disk reaches the other surface, it is cut by a clip line, the intersection of its tangent plane with the other
//!   surface's ([`cut`]). A sample whose centre is dropped stays as long as part of its disk is on the right side, so
//!   that both surfaces are covered up to the curve in which they meet.
//!
//! Normals of what is subtracted are turned over. Where two faces coincide, one of them stays or none, as regularised set
//! operations have it (Requicha 1977). More than two operands are folded from left to right.

mod cut;
mod place;
mod surface;
#[cfg(test)]
mod tests;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

pub use self::place::transformed;
use self::surface::Surface;
use crate::assets::{Clip, Kernel, NEUTRAL, PointCloud};
use crate::memory::{Admission, Interrupt};
use crate::scene::CsgOperation;

/// Cut-off radius of kernels of sampled surfaces, in standard deviations.
const CUTOFF: f64 = crate::bake::CUTOFF as f64;

/// Bytes of a sample while two solids are combined: its copy, and its entry in the search tree.
const PAIR_BYTES: u64 = 384;

/// Why operands cannot be combined. `operand` counts from 0.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CsgError {
    #[error("there is nothing to combine")]
    NoOperands,
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
    #[error("operand {operand} has no samples")]
    Empty { operand: usize },
    #[error("operand {operand} has no normals, which tell its inside from its outside")]
    NoNormals { operand: usize },
    #[error("operand {operand} has no kernels, which tell how far its samples reach")]
    NoKernels { operand: usize },
}

impl CsgError {
    /// The operand at fault.
    pub fn operand(&self) -> Option<usize> {
        match *self {
            CsgError::NoOperands | CsgError::Interrupted(_) => None,
            CsgError::Empty { operand }
            | CsgError::NoNormals { operand }
            | CsgError::NoKernels { operand } => Some(operand),
        }
    }
}

/// Combines solids from left to right; a difference takes all others from the first.
///
/// The result has positions, normals, kernels and clips, and colours where any operand has some. It may be empty: solids
/// that do not meet have no intersection.
///
/// # Errors
/// See [`CsgError`].
pub fn combine(
    operation: CsgOperation,
    operands: &[PointCloud],
    admission: &Admission,
) -> Result<PointCloud, CsgError> {
    for (operand, cloud) in operands.iter().enumerate() {
        check(operand, cloud)?;
    }
    let colored = operands.iter().any(|cloud| cloud.colors.is_some());
    let mut solids = operands.iter().map(samples_of);
    let mut result = solids.next().ok_or(CsgError::NoOperands)?;
    for other in solids {
        let held = admission.held();
        admission.grow("combining solids", (result.len() + other.len()) as u64 * PAIR_BYTES)?;
        result = pair(operation, &result, &other, admission);
        admission.shrink_to(held);
        admission.check()?;
    }
    Ok(to_cloud(result, colored))
}

fn check(operand: usize, cloud: &PointCloud) -> Result<(), CsgError> {
    let count = cloud.positions.len();
    if count == 0 {
        return Err(CsgError::Empty { operand });
    }
    let has_normals = |normals: &Vec<Vec3>| {
        normals.len() == count && normals.iter().any(|normal| *normal != Vec3::ZERO)
    };
    if !cloud.normals.as_ref().is_some_and(has_normals) {
        return Err(CsgError::NoNormals { operand });
    }
    if cloud.kernels.as_ref().is_none_or(|kernels| kernels.len() != count) {
        return Err(CsgError::NoKernels { operand });
    }
    Ok(())
}

/// A sample with everything that the operations need, in f64.
#[derive(Clone, Copy, Debug)]
struct Sample {
    position: DVec3,
    normal: DVec3,
    u: DVec3,
    v: DVec3,
    clip: Clip,
    color: [u8; 4],
}

impl Sample {
    /// Radius of its disk.
    fn radius(&self) -> f64 {
        CUTOFF * self.u.length().max(self.v.length())
    }

    /// The place with the kernel coordinates `at`.
    fn place(&self, at: Vec2) -> DVec3 {
        self.position + self.u * f64::from(at.x) + self.v * f64::from(at.y)
    }

    /// Returns the same surface seen from its other side. `u × v` still points along the normal.
    fn flipped(mut self) -> Self {
        self.normal = -self.normal;
        self.v = -self.v;
        self.clip.lines.iter_mut().flatten().for_each(|line| line.normal.y = -line.normal.y);
        self
    }
}

/// Samples with finite positions and a normal; others belong to no surface.
fn samples_of(cloud: &PointCloud) -> Vec<Sample> {
    let sample = |index: usize| {
        let normal = cloud.normals.as_ref()?.get(index)?.as_dvec3().try_normalize()?;
        let Kernel { u, v } = *cloud.kernels.as_ref()?.get(index)?;
        let position = *cloud.positions.get(index)?;
        let usable = position.is_finite() && u.is_finite() && v.is_finite();
        usable.then(|| Sample {
            position,
            normal,
            u: u.as_dvec3(),
            v: v.as_dvec3(),
            clip: cloud.clips.as_ref().and_then(|c| c.get(index)).copied().unwrap_or(Clip::NONE),
            color: cloud.colors.as_ref().and_then(|c| c.get(index)).copied().unwrap_or(NEUTRAL),
        })
    };
    (0..cloud.positions.len()).filter_map(sample).collect()
}

fn to_cloud(samples: Vec<Sample>, colored: bool) -> PointCloud {
    let kernel = |s: &Sample| Kernel { u: s.u.as_vec3(), v: s.v.as_vec3() };
    PointCloud {
        positions: samples.iter().map(|s| s.position).collect(),
        colors: colored.then(|| samples.iter().map(|s| s.color).collect()),
        normals: Some(samples.iter().map(|s| s.normal.as_vec3()).collect()),
        kernels: Some(samples.iter().map(kernel).collect()),
        clips: Some(samples.iter().map(|s| s.clip).collect()),
        ..PointCloud::default()
    }
}

/// Which part of one operand's surface belongs to the result.
#[derive(Clone, Copy, Debug)]
struct Rule {
    /// The part inside the other solid rather than the part outside.
    keep_inside: bool,
    /// Faces that coincide with a face of the other solid stay: those that look the same way, and those that look the opposite
    /// way.
    keep_same: bool,
    keep_opposite: bool,
}

impl Rule {
    fn of(operation: CsgOperation, is_first: bool) -> Rule {
        let (union, difference) =
            (operation == CsgOperation::Union, operation == CsgOperation::Difference);
        Rule {
            keep_inside: if is_first { !union && !difference } else { !union },
            keep_same: is_first && !difference,
            keep_opposite: is_first && difference,
        }
    }
}

fn pair(
    operation: CsgOperation,
    first: &[Sample],
    second: &[Sample],
    admission: &Admission,
) -> Vec<Sample> {
    let (first_surface, second_surface) = (Surface::new(first), Surface::new(second));
    let keep = |samples: &[Sample], other: &Surface, rule: Rule| -> Vec<Sample> {
        let keep =
            |sample| if admission.is_cancelled() { None } else { cut::keep(sample, other, rule) };
        samples.par_iter().filter_map(keep).collect()
    };
    let mut result = keep(first, &second_surface, Rule::of(operation, true));
    let other = keep(second, &first_surface, Rule::of(operation, false));
    let turn = operation == CsgOperation::Difference;
    result.extend(other.into_iter().map(|s| if turn { s.flipped() } else { s }));
    result
}
