//! `pointillist pick`: prints which elements the pixels of a frame show, without a server.

use clap::Args;

use super::frame::{DrawArgs, PoseArgs};
use super::local::SceneArgs;
use super::out;
use crate::engine::Client;
use crate::engine::pick::request_of;

/// Options of `pointillist pick`.
#[derive(Args, Clone, Debug)]
pub struct PickArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Columns of the pixels, from 0 at the left, separated by commas
    #[arg(long, value_name = "N", required = true, value_delimiter = ',')]
    x: Vec<u32>,
    /// Rows of the pixels, from 0 at the top, one for each column
    #[arg(long, value_name = "N", required = true, value_delimiter = ',')]
    y: Vec<u32>,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    draw: DrawArgs,
}

/// Prints the picks of the given pixels.
///
/// # Errors
/// The scene, the pose or a pixel is refused, or there is no GPU.
pub fn run(args: &PickArgs) -> anyhow::Result<()> {
    super::local::init_log();
    if args.x.len() != args.y.len() {
        let (columns, rows) = (args.x.len(), args.y.len());
        anyhow::bail!("--x has {columns} numbers and --y has {rows}; give one of each for a pixel");
    }
    let pixels = args.x.iter().zip(&args.y).map(|(&x, &y)| [x, y]).collect();
    let request = args.draw.request(args.pose.pose(args.scene.up()))?;
    let (engine, _) = args.scene.load()?;
    let frame = engine.resolve_blocking(request_of(request))?;
    let (ticket, picker) = engine.pick(Client::Unnamed, &frame, pixels)?;
    let picks = picker.read(&*ticket.wait()?)?;
    out::print(&format!("{}\n", serde_json::to_string_pretty(&picks)?))
}
