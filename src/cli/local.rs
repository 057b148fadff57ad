//! An engine for a single scene, as `render` and `inspect` need it, and parts that `bake` shares with them.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::Context;
use glam::DVec3;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::cache::CacheArgs;
use super::out::say;
use crate::assets::Progress;
use crate::bake::prepare::is_scene_file;
use crate::engine::{BakeEvent, Engine, EngineConfig, SceneInfo};
use crate::scene::Up;

/// The scene, the folder of its files, and the cache of its point trees.
#[derive(clap::Args, Clone, Debug)]
pub struct SceneFile {
    /// Scene file (.json), or one file of points, lines or triangles
    #[arg(value_name = "SCENE_OR_ASSET")]
    pub scene: PathBuf,
    /// Folder that the scene's files must lie in [default: the scene's own]
    #[arg(long, value_name = "FOLDER")]
    pub root: Option<PathBuf>,
    #[command(flatten)]
    pub cache: CacheArgs,
}

/// The scene, and limits on GPU memory and frame size.
#[derive(clap::Args, Clone, Debug)]
pub struct SceneArgs {
    #[command(flatten)]
    pub file: SceneFile,
    #[command(flatten)]
    pub limits: LimitArgs,
}

/// Limits on GPU memory and frame size, and the up direction of assets.
#[derive(clap::Args, Clone, Debug)]
pub struct LimitArgs {
    /// Maximum scene data kept on the GPU, in MiB
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..))]
    gpu_budget_mib: Option<u64>,
    /// Maximum width times height of a frame; the adapter may allow less [default: 16777216, or what a sixth of the memory has room for]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    max_pixels: Option<u64>,
    /// Maximum width and height of a frame, in pixels [default: 8192]
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..))]
    max_side: Option<u32>,
    /// Up direction: x, y, z, -x, -y, -z or X,Y,Z [default: from the scene file, or guessed for an asset]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Do not use 64-bit atomics, even if the adapter has them
    #[arg(long, hide = true)]
    force_32_bit: bool,
}

/// Id of the only scene.
pub const ID: &str = "scene";

impl SceneFile {
    /// The scene's absolute path, and an engine's configuration for it. Reading the scene advances `bar`.
    ///
    /// # Errors
    /// The file does not exist, or a setting of the cache cannot be used.
    pub fn config(&self, bar: &ProgressBar) -> anyhow::Result<(PathBuf, EngineConfig)> {
        let path = self
            .scene
            .canonicalize()
            .with_context(|| format!("cannot open {}", self.scene.display()))?;
        let folder = path.parent().unwrap_or(Path::new("/")).to_path_buf();
        let mut config = EngineConfig::new(self.root.clone().unwrap_or(folder));
        config.bake_cache = self.cache.open()?;
        config.may_draw_in_full = true;
        let shown = bar.clone();
        config.read.progress = Progress::new(move |fraction| {
            shown.set_position((fraction * 1000.0) as u64);
            if fraction >= 1.0 {
                shown.set_message("preparing");
            }
        });
        Ok((path, config))
    }
}

impl SceneArgs {
    /// The up direction that was given.
    pub fn up(&self) -> Option<DVec3> {
        self.limits.up.map(|Up(up)| up)
    }

    /// Refuses `--up` with a scene file, because its cameras and paths may depend on its own up direction.
    ///
    /// # Errors
    /// The scene is a scene file, and `--up` is given.
    pub fn check_up(&self) -> anyhow::Result<()> {
        if self.limits.up.is_some() && is_scene_file(&self.file.scene) {
            anyhow::bail!(
                "--up applies to point and triangle files only; set `up` in the scene file"
            );
        }
        Ok(())
    }

    /// Starts an engine and loads the scene into it, with a progress bar on a terminal.
    ///
    /// # Errors
    /// There is no GPU adapter, or the scene is refused.
    pub fn load(&self) -> anyhow::Result<(Engine, SceneInfo)> {
        let bar = progress_bar();
        let (path, mut config) = self.file.config(&bar)?;
        config.gpu_budget_bytes = self.limits.gpu_budget_mib.map(|mib| mib.saturating_mul(1 << 20));
        config.force_32_bit = self.limits.force_32_bit;
        config.max_pixels = self.limits.max_pixels.unwrap_or(config.max_pixels);
        config.max_side = self.limits.max_side.unwrap_or(config.max_side);
        config.up = self.up();
        let engine = Engine::start(config)?;
        let loaded = engine.load(ID, &path);
        bar.finish_and_clear();
        Ok((engine, loaded?))
    }

    /// Loads the scene, and writes its warnings to standard error.
    ///
    /// # Errors
    /// As [`SceneArgs::load`].
    pub fn load_and_warn(&self) -> anyhow::Result<(Engine, SceneInfo)> {
        let (engine, info) = self.load()?;
        for warning in &info.warnings {
            say!("warning: {warning}");
        }
        Ok((engine, info))
    }
}

/// A progress bar with 1000 steps on standard error, hidden where that is no terminal.
pub fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(1000);
    if !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} % · {eta} left") {
        bar.set_style(style);
    }
    bar.set_message("reading");
    bar
}

/// Shows the progress of baking.
pub fn show_baking(bar: &ProgressBar, event: &BakeEvent) {
    match event {
        BakeEvent::Started { asset, done, total } => {
            bar.set_length(*total);
            bar.set_position(*done);
            bar.set_message(format!("baking {asset}"));
        }
        BakeEvent::Phase { phase, done } => {
            // This part has as many steps as reading.
            bar.set_length(1000);
            bar.set_position((done * 1000.0) as u64);
            bar.set_message(phase.name());
        }
        BakeEvent::Finished(asset) => bar.inc(asset.samples + asset.triangles),
    }
}

/// Logs errors of the library to standard error, or what `POINTILLIST_LOG` asks for.
pub fn init_log() {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_from_env("POINTILLIST_LOG")
        .unwrap_or_else(|_| EnvFilter::new("warn,wgpu_core=error,wgpu_hal=error,naga=error"));
    // Fails only if there is a subscriber already, which is as good.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        .with_target(false)
        .try_init();
}
