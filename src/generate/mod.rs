//! Deterministic procedural assets and scenes (floor 2).
//!
//! [`generate`] makes one of the [`Kind`]s from [`Parameters`]; [`write`] puts it on disk in the
//! format that the file's extension asks for. Equal parameters give equal bytes on every machine:
//! randomness comes from [`crate::scene::random`], trigonometry from [`numeric`], and parallel work is
//! split and merged by index.

mod error;
pub mod numeric;
pub mod town;
mod write;

pub use error::GenerateError;
pub use write::write;

use crate::assets::{Material, Mesh, PointCloud, Progress, Texture};

/// What can be generated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum Kind {
    /// Laser scan of a procedural town at UTM coordinates: points with colour, intensity, class
    Town,
}

/// What generators may be told; `None` is the kind's own default.
#[derive(Clone, Debug, Default)]
pub struct Parameters {
    pub seed: u64,
    /// Number of points, for point clouds.
    pub points: Option<u64>,
    /// Number of triangles to aim at, for meshes.
    pub triangles: Option<u64>,
    /// Edge or height in scene units, for kinds that have one.
    pub size: Option<f64>,
}

/// What a generator made.
#[derive(Clone, Debug)]
pub enum Generated {
    Points(PointCloud),
    Mesh(GeneratedMesh),
    Scene(GeneratedScene),
}

/// A mesh and how it looks.
#[derive(Clone, Debug, Default)]
pub struct GeneratedMesh {
    pub mesh: Mesh,
    pub material: Option<Material>,
    pub texture: Option<Texture>,
}

/// A scene file and the assets that it names, by file name.
#[derive(Clone, Debug)]
pub struct GeneratedScene {
    pub json: String,
    pub assets: Vec<(String, Generated)>,
}

/// A parameter's value, or the default, refused outside `low..=high`.
fn within<T: PartialOrd + Copy + std::fmt::Display>(
    parameter: &'static str,
    value: Option<T>,
    default: T,
    low: T,
    high: T,
) -> Result<T, GenerateError> {
    let value = value.unwrap_or(default);
    if value >= low && value <= high {
        Ok(value)
    } else {
        let reason = format!("{value} lies outside {low}..={high}");
        Err(GenerateError::Parameter { parameter, reason })
    }
}

/// Makes an asset.
///
/// # Errors
/// A parameter outside its range.
pub fn generate(
    kind: Kind,
    parameters: &Parameters,
    progress: &Progress,
) -> Result<Generated, GenerateError> {
    match kind {
        Kind::Town => {
            let town = town::TownParameters {
                size_m: within("size", parameters.size, 180.0, 40.0, 2_000.0)?,
                points: within("points", parameters.points, 8_000_000, 1, 1_000_000_000)? as usize,
                seed: parameters.seed,
            };
            Ok(Generated::Points(town::town(&town, progress)))
        }
    }
}
