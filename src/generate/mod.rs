//! Deterministic procedural assets and scenes (floor 2).
//!
//! [`generate`] makes an asset of one of the [`Kind`]s from [`Parameters`]. [`write()`] writes it to disk in the format of the
//! file's extension. Equal parameters give equal bytes on every machine: random numbers come from [`crate::scene::random`],
//! trigonometry from [`numeric`], and parallel work is split and merged by index.

mod error;
pub mod glasshouse;
mod hard;
mod isosurface;
pub mod lines;
pub mod materials;
pub mod numeric;
pub mod part;
pub mod plain;
pub mod relief;
pub mod scenes;
pub mod studio;
#[cfg(test)]
mod tests;
pub mod textured;
pub mod town;
pub mod trees;
mod write;

pub use error::GenerateError;
pub use trees::Form;
pub use write::write;

use glasshouse::Hour;

use crate::assets::{EnvironmentImage, Material, Mesh, PointCloud, Polylines, Progress, Texture};

/// Kinds of assets and scenes that can be generated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum Kind {
    /// Laser scan of a procedural town at UTM coordinates: points with colour, intensity, class
    Town,
    /// Sculpted solid with fine relief: a watertight mesh with normals and colours
    Relief,
    /// The solid of `relief` as a dense point cloud with normals and colours
    Statue,
    /// Painted amphora: a mesh with a 512² texture
    Textured,
    /// Level ground with a fine checker: a textured mesh, or points
    Checkerboard,
    /// Scene of 40 × 40 assemblies through nested prototypes
    Plaza,
    /// Machined part, made of sampled solids: a block with bores and a rounded slot
    CsgPart,
    /// Folder of small scenes of splats that are hard to draw
    Hard,
    /// Tree with vertex colours: of few triangles, or with `--count` or `--form` of many leaves
    Tree,
    /// Scene of ten trees of many leaves, as triangles or as lines
    Grove,
    /// Scene of a greenhouse: translucent panes, plants behind them, and balls of glass
    Glasshouse,
    /// The same greenhouse at night, with a lamp in it
    GlasshouseNight,
    /// Scene of balls of plastic, metal, varnish and embers, and of a lantern with maps
    Materials,
    /// Neurons with tapering branches: lines with radii, colours and types
    Neurons,
    /// Streamlines in bundles, as of a brain's white matter: lines
    Tracts,
    /// Cube about the origin
    Cube,
    /// Sphere about the origin
    Sphere,
}

impl Parameters {
    /// Parameters for about so many points or triangles, whichever the kind is made of.
    pub fn of_size(kind: Kind, count: u64) -> Parameters {
        let of = |name| kind.parameters().contains(&name).then_some(count);
        Parameters { points: of("points"), triangles: of("triangles"), ..Parameters::default() }
    }
}

impl Kind {
    /// Names of the parameters that the kind has beside the seed.
    fn parameters(self) -> &'static [&'static str] {
        match self {
            Kind::Town | Kind::Statue | Kind::Checkerboard | Kind::CsgPart => &["points", "size"],
            Kind::Relief | Kind::Textured | Kind::Sphere => &["triangles", "size"],
            Kind::Plaza | Kind::Cube | Kind::Glasshouse | Kind::GlasshouseNight => &["size"],
            Kind::Hard | Kind::Materials => &[],
            Kind::Tree | Kind::Grove => &["triangles", "size", "count", "form"],
            Kind::Neurons | Kind::Tracts => &["count", "size"],
        }
    }
}

/// Refuses parameters that the kind does not have.
fn check(kind: Kind, parameters: &Parameters) -> Result<(), GenerateError> {
    // All of them: a new field does not compile before it stands here.
    let Parameters { seed: _, points, triangles, size, count, form } = parameters;
    let given = [
        ("points", points.is_some()),
        ("triangles", triangles.is_some()),
        ("size", size.is_some()),
        ("count", count.is_some()),
        ("form", form.is_some()),
    ];
    let known = kind.parameters();
    let is_unknown = |(name, is_given): &(&str, bool)| *is_given && !known.contains(name);
    let Some((parameter, _)) = given.into_iter().find(is_unknown) else { return Ok(()) };
    let accepted: Vec<String> =
        known.iter().chain(&["seed"]).map(|name| format!("--{name}")).collect();
    let reason = format!("this kind has no such option; it has {}", accepted.join(", "));
    Err(GenerateError::Parameter { parameter, reason })
}

/// Parameters of generators; `None` is the kind's default.
#[derive(Clone, Debug, Default)]
pub struct Parameters {
    pub seed: u64,
    /// Number of points of a point cloud; for a machined part, the target number of samples.
    pub points: Option<u64>,
    /// Target number of triangles of a mesh.
    pub triangles: Option<u64>,
    /// Edge or height in scene units; for a plaza, the number of assemblies along each edge.
    pub size: Option<f64>,
    /// Number of neurons, of streamlines, or of a tree's leaves.
    pub count: Option<u64>,
    /// Triangles or lines, for trees.
    pub form: Option<Form>,
}

/// The result of a generator.
#[derive(Clone, Debug)]
pub enum Generated {
    Points(PointCloud),
    Mesh(GeneratedMesh),
    Lines(Polylines),
    Plant(Box<trees::Plant>),
    Scene(GeneratedScene),
    Surroundings(EnvironmentImage),
    /// The scenes of a folder, by name.
    Scenes(Vec<(String, GeneratedScene)>),
}

/// A mesh with its material and texture.
#[derive(Clone, Debug, Default)]
pub struct GeneratedMesh {
    pub mesh: Mesh,
    pub material: Option<Material>,
    pub texture: Option<Texture>,
    pub maps: Vec<GeneratedMap>,
}

/// A map of a material beside that of its colour.
#[derive(Clone, Debug)]
pub struct GeneratedMap {
    /// MTL's statement.
    pub statement: &'static str,
    pub texture: Texture,
}

/// The text of a scene file, and the assets that it names by file name.
#[derive(Clone, Debug)]
pub struct GeneratedScene {
    pub json: String,
    pub assets: Vec<(String, Generated)>,
}

/// Returns the parameter's value or the default; fails outside `low..=high`.
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

/// Makes an asset: points, a mesh or lines, the scene of `plaza` or `csg-part`, or all scenes of `hard`.
///
/// # Errors
/// A parameter is outside its range.
pub fn generate(
    kind: Kind,
    parameters: &Parameters,
    progress: &Progress,
) -> Result<Generated, GenerateError> {
    check(kind, parameters)?;
    let Parameters { seed, points, triangles, size, count, form } = *parameters;
    let length = |default: f64| within("size", size, default, 1e-3, 1e6);
    let corners = |default: u64| within("triangles", triangles, default, 100, 20_000_000);
    let samples = |default: u64| within("points", points, default, 1, 1_000_000_000);
    Ok(match kind {
        Kind::Town => {
            let size_m = town_size(size)?;
            let points = samples(8_000_000)? as usize;
            let parameters = town::TownParameters { size_m, points, seed };
            Generated::Points(town::town(&parameters, progress))
        }
        Kind::Relief => {
            let count = within("triangles", triangles, 400_000, 2_000, 20_000_000)? as usize;
            let parameters = relief::ReliefParameters { height: length(2.0)?, count, seed };
            Generated::Mesh(relief::relief(&parameters, progress))
        }
        Kind::Statue => {
            let count = samples(5_000_000)? as usize;
            let parameters = relief::ReliefParameters { height: length(2.0)?, count, seed };
            Generated::Points(relief::statue(&parameters, progress))
        }
        Kind::Textured => {
            Generated::Mesh(textured::amphora(length(AMPHORA_HEIGHT)?, corners(12_000)?, seed))
        }
        Kind::Checkerboard if points.is_some() => {
            Generated::Points(textured::checker_points(length(10.0)?, samples(1_000_000)? as usize))
        }
        Kind::Checkerboard => Generated::Mesh(textured::checker_mesh(length(10.0)?)),
        Kind::Plaza => Generated::Scene(scenes::plaza("plaza", plaza_count(size)?, seed, progress)),
        Kind::CsgPart => Generated::Scene(machined_part("csg-part", parameters)?),
        Kind::Hard => Generated::Scenes(hard::corpus()),
        Kind::Tree if form.is_none() && count.is_none() => {
            Generated::Mesh(plain::tree(length(6.0)?, corners(8_000)?, seed))
        }
        Kind::Tree => tree(parameters, progress)?,
        Kind::Grove => Generated::Scene(grove("grove", parameters, progress)?),
        Kind::Glasshouse => Generated::Scene(greenhouse("glasshouse", parameters, Hour::Noon)?),
        Kind::GlasshouseNight => {
            Generated::Scene(greenhouse("glasshouse-night", parameters, Hour::Night)?)
        }
        Kind::Materials => Generated::Scene(materials::materials("materials")),
        Kind::Neurons => {
            let count = within("count", count, 20, 1, 1_000_000)? as usize;
            Generated::Lines(lines::neurons(count, length(1000.0)?, seed, progress))
        }
        Kind::Tracts => {
            let count = within("count", count, 10_000, 1, 20_000_000)? as usize;
            Generated::Lines(lines::tracts(count, length(150.0)?, seed, progress))
        }
        Kind::Cube => Generated::Mesh(plain::cube(length(1.0)?)),
        Kind::Sphere => Generated::Mesh(plain::sphere(length(1.0)?, corners(4_000)?)),
    })
}

/// Makes an asset of a kind as a scene called `name`: the JSON and its assets.
///
/// # Errors
/// A parameter is outside its range.
pub fn generate_scene(
    kind: Kind,
    name: &str,
    parameters: &Parameters,
    progress: &Progress,
) -> Result<GeneratedScene, GenerateError> {
    let usable = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.is_empty() || !name.chars().all(usable) {
        return Err(GenerateError::Parameter {
            parameter: "output",
            reason: format!("`{name}` names assets, too: use letters, digits, `-`, `_` and `.`"),
        });
    }
    if kind == Kind::Hard {
        return Err(GenerateError::Parameter {
            parameter: "output",
            reason: "`hard` makes many scenes: name a folder".to_owned(),
        });
    }
    check(kind, parameters)?;
    if kind == Kind::Plaza {
        let count = plaza_count(parameters.size)?;
        return Ok(scenes::plaza(name, count, parameters.seed, progress));
    }
    if kind == Kind::Glasshouse {
        return greenhouse(name, parameters, Hour::Noon);
    }
    if kind == Kind::GlasshouseNight {
        return greenhouse(name, parameters, Hour::Night);
    }
    if kind == Kind::Materials {
        return Ok(materials::materials(name));
    }
    if kind == Kind::CsgPart {
        return machined_part(name, parameters);
    }
    if kind == Kind::Grove {
        return grove(name, parameters, progress);
    }
    let asset = generate(kind, parameters, progress)?;
    Ok(match kind {
        Kind::Town => scenes::town(name, asset, town_size(parameters.size)?),
        Kind::Textured => scenes::amphora(name, asset, parameters.size.unwrap_or(AMPHORA_HEIGHT)),
        _ => scenes::solid(name, asset),
    })
}

/// Height of the amphora in metres.
const AMPHORA_HEIGHT: f64 = 0.6;

/// A tree of many leaves, in the form that is asked for.
fn tree(parameters: &Parameters, progress: &Progress) -> Result<Generated, GenerateError> {
    let height = within("size", parameters.size, 8.0, 1e-3, 1e6)?;
    // A number of triangles gives that of leaves where there is no other.
    let aimed = match parameters.triangles {
        Some(_) => {
            let triangles = within("triangles", parameters.triangles, 0, 100, 20_000_000)?;
            trees::TreeParameters::leaves_of(triangles)
        }
        None => 100_000,
    };
    let leaves = within("count", parameters.count, aimed, 1, 3_500_000)? as usize;
    let tree = trees::TreeParameters { height, leaves, seed: parameters.seed };
    Ok(match parameters.form {
        Some(Form::Lines) => Generated::Plant(Box::new(trees::lines(&tree, progress))),
        _ => Generated::Mesh(trees::triangles(&tree, progress)),
    })
}

fn grove(
    name: &str,
    parameters: &Parameters,
    progress: &Progress,
) -> Result<GeneratedScene, GenerateError> {
    let height = parameters.size.unwrap_or(8.0);
    Ok(scenes::grove(name, tree(parameters, progress)?, height))
}

fn greenhouse(
    name: &str,
    parameters: &Parameters,
    hour: Hour,
) -> Result<GeneratedScene, GenerateError> {
    let length = within("size", parameters.size, glasshouse::LENGTH, 1e-3, 1e6)?;
    Ok(glasshouse::glasshouse(name, length, parameters.seed, hour))
}

fn machined_part(name: &str, parameters: &Parameters) -> Result<GeneratedScene, GenerateError> {
    let length = within("size", parameters.size, 2.4, 1e-3, 1e6)?;
    let samples = within("points", parameters.points, 6_500, 500, 10_000_000)?;
    Ok(part::machined(name, length, samples))
}

fn town_size(size: Option<f64>) -> Result<f64, GenerateError> {
    within("size", size, 180.0, 40.0, 2_000.0)
}

/// Number of assemblies along each edge of the plaza.
fn plaza_count(size: Option<f64>) -> Result<u64, GenerateError> {
    Ok(within("size", size, 40.0, 1.0, 1_000.0)?.round() as u64)
}
