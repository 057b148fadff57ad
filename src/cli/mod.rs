//! The command line (floor 8): one file per command.

pub mod accuracy;
pub mod bake;
mod cache;
mod frame;
pub mod generate;
pub mod inspect;
pub mod load;
mod local;
mod out;
pub mod panorama;
pub mod path;
pub mod pick;
#[cfg(test)]
mod reference;
pub mod render;
pub mod serve;
pub mod sign;
pub mod stereo;
pub mod tiles;
pub mod worker;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Exit codes of the process, as in docs/commands.md.
const EXIT_STATUS: &str = "Exit status:
  0  success; `serve`: stopped by a signal
  1  failed, with the reason on standard error
  2  the command line cannot be understood; nothing was done
  3  a threshold of `load` is broken
130  `load` was interrupted twice";

/// A headless render server for scenes of points, lines and triangles.
#[derive(Parser)]
#[command(name = "pointillist", version, about, after_help = EXIT_STATUS, after_long_help = EXIT_STATUS)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the server
    Serve(Box<serve::Given>),
    /// Draw frames of jobs for servers that share a NATS server
    Worker(Box<worker::WorkerArgs>),
    /// Draw one frame of a scene or of a single asset file, without a server
    Render(Box<render::RenderArgs>),
    /// Print what pixels of a frame show, as JSON: positions, distances, instances
    Pick(Box<pick::PickArgs>),
    /// Draw a camera path as numbered frames or a video; a second run draws the missing frames
    Path(Box<path::PathArgs>),
    /// Draw an image larger than a frame can be, as one PNG file or as tiles for a Deep Zoom viewer
    Tiles(Box<tiles::TilesArgs>),
    /// Draw all that an eye can see: an equirectangular image, or the six faces of a cube
    Panorama(Box<panorama::PanoramaArgs>),
    /// Draw what two eyes see as one image: side by side, one above the other, or for red and cyan glasses
    Stereo(Box<stereo::StereoArgs>),
    /// Report what a scene or asset contains, how much GPU memory it needs, and which passes would draw it
    Inspect(inspect::InspectArgs),
    /// Build the point trees that --lod spt draws, and store them in the cache
    Bake(bake::BakeArgs),
    /// Write a procedural asset or scene
    Generate(generate::GenerateArgs),
    /// Measure the error and the GPU time of a scene's settings, or compare the shaders with exact results on hard cases
    Accuracy(Box<accuracy::AccuracyArgs>),
    /// Measure a server's latency at given request rates, or find the rate at which it saturates
    Load(Box<load::LoadArgs>),
    /// Sign an address, so that whoever has it may read it until a time, without a key
    Sign(sign::SignArgs),
    /// Print the HTTP contract
    #[command(hide = true)]
    Openapi,
}

/// Parses the command line and runs the command. Returns the command's exit code.
///
/// # Errors
/// Any error of the command.
pub fn run() -> anyhow::Result<ExitCode> {
    match Cli::parse().command {
        Command::Serve(args) => serve::run(*args),
        Command::Worker(args) => worker::run(*args),
        Command::Render(args) => render::run(*args),
        Command::Pick(args) => pick::run(&args),
        Command::Path(args) => path::run(*args),
        Command::Tiles(args) => tiles::run(*args),
        Command::Panorama(args) => panorama::run(*args),
        Command::Stereo(args) => stereo::run(*args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Bake(args) => bake::run(&args),
        Command::Generate(args) => generate::run(args),
        Command::Accuracy(args) => accuracy::run(&args),
        Command::Load(args) => return load::run(&args),
        Command::Sign(args) => sign::run(&args),
        Command::Openapi => out::print(&crate::http::openapi_yaml()?),
    }?;
    Ok(ExitCode::SUCCESS)
}
