//! `pointillist inspect`: shows what a scene contains and what it would cost to draw.

use anyhow::Result;
use clap::Args;
use comfy_table::{Table, presets};
use serde::Serialize;

use super::local::{ID, SceneArgs, progress_bar, show_baking};
use super::out;
use super::render::contents;
use crate::encode::ImageFormat;
use crate::engine::{BakedAsset, FrameRequest, Pose, SceneInfo};
use crate::plan::{FramePlan, Output, Settings, Wait};
use crate::scene::fields::SceneField;

/// Options of `pointillist inspect`.
#[derive(Args, Clone, Debug)]
pub struct InspectArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Report the point trees of --lod spt as well; trees that are not in the cache are built
    #[arg(long)]
    tree: bool,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

/// The report in JSON.
#[derive(Serialize)]
struct Inspection {
    #[serde(flatten)]
    scene: SceneInfo,
    adapter: String,
    gpu_budget_bytes: u64,
    /// The passes and effects of a colour frame, with the reason for each one that is skipped.
    plan: FramePlan,
    /// Estimated share of each asset's sampled surface that splats leave uncovered, 0 to 1; `null` where there is no such surface.
    uncovered: Vec<Option<f64>>,
    /// With --tree: the trees of each asset that has something to draw.
    #[serde(skip_serializing_if = "Option::is_none")]
    trees: Option<Vec<BakedAsset>>,
}

/// Loads the scene and prints the report.
///
/// # Errors
/// The scene is refused, or there is no GPU adapter, on which the plan depends.
pub fn run(args: &InspectArgs) -> Result<()> {
    super::local::init_log();
    args.scene.check_up()?;
    let (engine, mut scene) = args.scene.load()?;
    scene.id.clone_from(&scene.name);
    let request = FrameRequest {
        scene: ID.to_owned(),
        pose: Pose::FIT,
        width: 1024,
        height: 1024,
        // Kernels tell what splats leave uncovered.
        settings: Settings { wait: Wait::Whole, ..Settings::default() },
        output: Output::Color,
        format: ImageFormat::Png,
        quality: 90,
        deadline: None,
    };
    let bar = progress_bar();
    bar.set_message("estimating normals and kernels");
    let frame = engine.resolve_blocking(request)?;
    bar.finish_and_clear();
    let trees = args.tree.then(|| {
        let bar = progress_bar();
        let baked = engine.bake_all(ID, |event| show_baking(&bar, &event));
        bar.finish_and_clear();
        baked
    });
    let told = Inspection {
        scene,
        adapter: engine.adapter(),
        gpu_budget_bytes: engine.limits().gpu_budget_bytes,
        plan: frame.plan().clone(),
        uncovered: engine.uncovered_shares(ID)?,
        trees: trees.transpose()?,
    };
    if args.json {
        out::print(&(serde_json::to_string_pretty(&told)? + "\n"))
    } else {
        out::print(&text(&told))
    }
}

fn table() -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table
}

/// The axis in words if it is one, else the vector.
fn direction(up: [f64; 3]) -> String {
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let others = (0..3).filter(|&other| other != axis).all(|other| up[other] == 0.0);
        if others && up[axis] != 0.0 {
            return format!("{}{name}", if up[axis] > 0.0 { '+' } else { '-' });
        }
    }
    format!("{up:?}")
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

fn percent(share: f64) -> String {
    // Fewer places are looked at than would tell less from nothing.
    if share < 5e-5 { "< 0.01 %".to_owned() } else { format!("{:.2} %", 100.0 * share) }
}

fn text(told: &Inspection) -> String {
    let (facts, assets) = (facts(told), assets(told));
    let fields = match &told.scene.fields[..] {
        [] => String::new(),
        found => format!("{}\n\n", fields(found)),
    };
    let mut passes = table();
    passes.set_header(["pass or effect", "runs"]);
    let plan = &told.plan;
    let names = plan.passes.iter().map(|planned| (planned.pass.name().to_owned(), planned.skipped));
    let effects = plan.specialisations.iter();
    let effects = effects.map(|planned| (planned.specialisation.name(), planned.skipped));
    for (name, skipped) in names.chain(effects) {
        passes.add_row([name, skipped.map_or("yes".to_owned(), |why| format!("no: {why}"))]);
    }
    let trees: String = told.trees.iter().flatten().map(tree_text).collect();
    format!("{facts}\n\n{assets}\n\n{fields}{passes}\n{trees}")
}

fn facts(told: &Inspection) -> Table {
    let scene = &told.scene;
    let mut facts = table();
    facts.add_row(["scene", &scene.name]);
    facts.add_row([
        "contents",
        &contents([scene.samples, scene.triangles, scene.segments], scene.instances),
    ]);
    if let Some([low, high]) = scene.bounds {
        facts.add_row(["bounds", &format!("{low:?} to {high:?}")]);
    }
    facts.add_row([
        "GPU memory",
        &format!(
            "{} of {} on {}",
            megabytes(scene.gpu_bytes),
            megabytes(told.gpu_budget_bytes),
            told.adapter
        ),
    ]);
    facts.add_row(["up", &format!("{}: {}", direction(scene.up), scene.up_because)]);
    facts.add_row(["lights", &scene.lights.to_string()]);
    if !scene.cameras.is_empty() {
        let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
        facts.add_row(["cameras", &names.join(", ")]);
    }
    if !scene.paths.is_empty() {
        facts.add_row(["paths", &scene.paths.join(", ")]);
    }
    for warning in &scene.warnings {
        facts.add_row(["warning", warning]);
    }
    facts
}

fn assets(told: &Inspection) -> Table {
    let mut assets = table();
    assets.set_header([
        "asset",
        "format",
        "samples",
        "triangles",
        "segments",
        "colours",
        "normals",
        "uncovered",
    ]);
    for (asset, uncovered) in told.scene.assets.iter().zip(&told.uncovered) {
        // The normals of lines follow from their shape.
        let only_lines = asset.segments > 0 && asset.samples == 0 && asset.triangles == 0;
        let normals = match (asset.has_normals, asset.normals_estimated) {
            _ if only_lines => "—",
            (true, true) => "file, rest estimated",
            (true, false) => "file",
            (false, _) => "estimated",
        };
        assets.add_row([
            asset.name.clone(),
            asset.format.to_owned(),
            asset.samples.to_string(),
            asset.triangles.to_string(),
            asset.segments.to_string(),
            match (asset.has_colors, asset.shows_intensity) {
                (true, true) => "file, rest from intensity",
                (true, false) => "file",
                (false, true) => "from intensity",
                (false, false) => "none",
            }
            .to_owned(),
            normals.to_owned(),
            uncovered.map_or("—".to_owned(), percent),
        ]);
    }
    assets
}

fn fields(fields: &[SceneField]) -> Table {
    let mut table = table();
    table.set_header(["field", "least", "most", "1st to 99th percentile"]);
    for field in fields {
        let [low, high] = field.shown;
        table.add_row([
            field.name.clone(),
            field.least.to_string(),
            field.most.to_string(),
            format!("{low} to {high}"),
        ]);
    }
    table
}

/// The figures of an asset's point trees.
fn tree_text(asset: &BakedAsset) -> String {
    let tree = &asset.tree;
    let mut facts = table();
    facts.add_row(["point trees of", &asset.name]);
    facts.add_row(["leaves", &tree.leaves.to_string()]);
    facts.add_row(["inner nodes", &tree.inner.to_string()]);
    facts.add_row(["chunks", &tree.chunks.to_string()]);
    let by_leaf = tree.bytes as f64 / tree.leaves.max(1) as f64;
    facts.add_row(["bytes", &format!("{}, {by_leaf:.1} a leaf", megabytes(tree.bytes))]);
    if asset.triangles_beside > 0 {
        let (count, bytes) = (asset.triangles_beside, megabytes(asset.triangle_bytes));
        facts.add_row(["triangles beside", &format!("{count}, {bytes}")]);
    }
    let mut levels = table();
    levels.set_header(["level above the leaves", "nodes"]);
    for (level, nodes) in tree.levels.iter().enumerate() {
        levels.add_row([level.to_string(), nodes.to_string()]);
    }
    let mut errors = table();
    errors.set_header(["error, in units of the asset, at most", "nodes"]);
    let (exact, octaves) = tree.errors.split_last().unwrap_or((&0, &[]));
    for (octave, &nodes) in octaves.iter().enumerate().filter(|(_, nodes)| **nodes > 0) {
        let most = f64::from(tree.base) * (-(octave as f64)).exp2();
        errors.add_row([format!("{most:.3e}"), nodes.to_string()]);
    }
    errors.add_row(["none".to_owned(), exact.to_string()]);
    format!("\n{facts}\n\n{levels}\n\n{errors}\n")
}
