//! `pointillist generate`: procedural assets and scenes.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};

use super::out;
use crate::assets::Progress;
use crate::generate::{Form, Generated, Kind, Parameters, generate, generate_scene, write};

/// Deterministic procedural assets and scenes, for demos, tests and benches.
///
/// Equal options give equal bytes on every machine.
#[derive(Clone, Debug, clap::Args)]
pub struct GenerateArgs {
    /// Asset or scene to generate
    #[arg(value_enum)]
    pub kind: Kind,
    /// File to write. Points: .ply, .las, .laz; meshes: .ply, .obj (with .mtl and .png); lines: .vtk,
    /// .tck (without radii and colours); trees of lines: .vtk, with two files beside it; whole scenes with
    /// their assets beside them: .json; many scenes: a folder
    #[arg(short, long, alias = "output", value_name = "FILE")]
    pub out: PathBuf,
    /// Seed of the random parts of towns, reliefs, trees, groves, glasshouses, neurons and tracts
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Number of points, for point clouds; for a machined part, samples to aim at
    #[arg(long, value_name = "N")]
    pub points: Option<u64>,
    /// Number of triangles to aim at, for meshes
    #[arg(long, value_name = "N")]
    pub triangles: Option<u64>,
    /// Edge or height in scene units (metres; micrometres for neurons, millimetres for tracts); for a
    /// plaza, assemblies along each edge; for a grove, the height of a tree
    #[arg(long, value_name = "LENGTH")]
    pub size: Option<f64>,
    /// Number of neurons, of streamlines, or of the leaves of a tree (100,000 with --form)
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// How trees of many leaves are put out
    #[arg(long, value_enum, value_name = "FORM")]
    pub form: Option<Form>,
}

/// Generates an asset or scene and writes it, with a progress bar on a terminal.
///
/// # Errors
/// Parameters are out of range, the extension does not fit, or a file cannot be written.
pub fn run(args: GenerateArgs) -> anyhow::Result<()> {
    let begin = Instant::now();
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} % · {eta} left") {
        bar.set_style(style);
    }
    bar.set_message("generating");
    let progress = {
        let bar = bar.clone();
        Progress::new(move |fraction| bar.set_position((fraction * 1000.0) as u64))
    };
    let parameters = Parameters {
        seed: args.seed,
        points: args.points,
        triangles: args.triangles,
        size: args.size,
        count: args.count,
        form: args.form,
    };
    let is_scene = args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let generated = if is_scene {
        let name = args.out.file_stem().map(|s| s.to_string_lossy()).unwrap_or_default();
        Generated::Scene(generate_scene(args.kind, &name, &parameters, &progress)?)
    } else {
        generate(args.kind, &parameters, &progress)?
    };
    bar.finish_and_clear();
    let contents = describe(&generated);
    let files = write(&generated, &args.out)?;
    let bytes = files
        .iter()
        .map(|file| std::fs::metadata(file).map(|m| m.len()))
        .sum::<std::io::Result<u64>>()
        .with_context(|| format!("reading back {}", args.out.display()))?;
    let seconds = begin.elapsed().as_secs_f64();
    let names: String = files.iter().map(|file| format!("  {}\n", file.display())).collect();
    out::print(&format!("{contents} in {seconds:.1} s, {:.1} MB:\n{names}", bytes as f64 / 1e6))
}

fn describe(generated: &Generated) -> String {
    match generated {
        Generated::Points(cloud) => format!("{} points", cloud.positions.len()),
        Generated::Mesh(mesh) => format!(
            "{} triangles, {} vertices",
            mesh.mesh.triangles.len(),
            mesh.mesh.positions.len()
        ),
        Generated::Lines(lines) => format!(
            "{} strands, {} vertices",
            lines.strands.len().saturating_sub(1),
            lines.positions.len()
        ),
        Generated::Plant(plant) => format!(
            "{} leaves, {} branches, a trunk of {} triangles",
            plant.leaves.strands.len().saturating_sub(1),
            plant.branches.strands.len().saturating_sub(1),
            plant.trunk.mesh.triangles.len()
        ),
        Generated::Surroundings(image) => format!("{} × {} pixels", image.width, image.height),
        Generated::Scenes(scenes) => format!("{} scenes", scenes.len()),
        Generated::Scene(scene) => match scene.assets.len() {
            1 => "a scene with 1 asset".to_owned(),
            assets => format!("a scene with {assets} assets"),
        },
    }
}
