//! Configuration of the engine.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;

use super::queue::BATCH_NS;
use super::{EncodeHook, Latch, PrimeConfig};
use crate::assets::ReadOptions;
use crate::bake::cache::BakeCache;
use crate::memory::{self, HostMemory};
use crate::scene::SceneLimits;

/// Default of [`EngineConfig::job_share`].
pub const DEFAULT_JOB_SHARE: f64 = 0.1;

/// Is given the words of all levels of pull-push of frames that were drawn together: after pull and after push, those of the four buffers of
/// patches one behind the other.
pub type LevelsHook = Arc<dyn Fn(&[u32]) + Send + Sync>;

/// Number of points whose neighbours are found in a tenth of a second: below it, waiting costs less than drawing a second
/// picture.
pub const ESTIMATE_AT_ONCE: usize = 200_000;

/// Upper bound of the time step of a file system's clock.
const SETTLED_AFTER: Duration = Duration::from_secs(2);

/// Configuration of the engine.
#[derive(Clone)]
pub struct EngineConfig {
    /// Scenes and the files they name are read below this folder only.
    pub root: PathBuf,
    /// Bytes of scene data that may stay on the GPU; `None`: three quarters of what the adapter can bind, at most 4 GiB.
    pub gpu_budget_bytes: Option<u64>,
    /// Host memory for loaded scenes, loading and baking.
    pub memory: HostMemory,
    /// Memory that the default limits follow, in bytes; see [`DefaultLimits`].
    pub memory_bytes: u64,
    /// Jobs that may wait; more are refused with [`super::EngineError::Busy`].
    pub queue_capacity: usize,
    /// Largest estimated device time of waiting frames; more is refused likewise.
    pub queue_time: Duration,
    /// Minimum share of the device's time for frames of jobs ([`super::Client::Job`]); above 0, below 1.
    pub job_share: f64,
    /// Largest number of frames recorded into one submission.
    pub max_batch: usize,
    /// For tests: largest estimated device time of a submission of several frames.
    #[doc(hidden)]
    pub batch_time: Duration,
    /// Frames of jobs that are encoded at a time. Requests and streams have a thread more each.
    pub encoder_threads: usize,
    /// For tests: is called before each frame is encoded.
    #[doc(hidden)]
    pub encode_hook: Option<EncodeHook>,
    /// Width · height of one frame.
    pub max_pixels: u64,
    /// Longest side of a frame.
    pub max_side: u32,
    /// Frames with `lod=spt` are drawn at full detail where [`crate::plan::detail`] finds that no slower. The program sets this; tests
    /// of point trees do not.
    pub may_draw_in_full: bool,
    /// Never use 64-bit atomics, even where the adapter has them.
    pub force_32_bit: bool,
    /// Largest number of bytes that a shader binds at once; `None`: as many as the adapter can. Less means smaller pages.
    pub max_binding_bytes: Option<u64>,
    /// For measurements: boxes of triangles with a longer side than this go to the rasteriser; `None`: the measured best.
    #[doc(hidden)]
    pub small_triangle_px: Option<u32>,
    /// For tests and measurements: draws chunks that are hidden behind others, too.
    #[doc(hidden)]
    pub draw_hidden: bool,
    /// For measurements: boxes of splats with a longer side than this go to walk_splats; `None`: the measured best.
    #[doc(hidden)]
    pub small_splat_px: Option<u32>,
    /// For tests: largest area of the boxes of a frame's large triangles, in units of 4096 pixels; `None`: about ten seconds'
    /// work.
    #[doc(hidden)]
    pub large_units_limit: Option<u32>,
    /// For tests: launches passes as on a GPU even if the adapter is a CPU.
    #[doc(hidden)]
    pub like_a_gpu: bool,
    /// For measurements and tests: whether large triangles go to the rasteriser; `None`: the measured best.
    #[doc(hidden)]
    pub rasterise: Option<bool>,
    /// For tests: is called when a patch has listed the instances anew, before the scene is exchanged.
    #[doc(hidden)]
    pub patch_hook: Option<Arc<dyn Fn() + Send + Sync>>,
    /// For tests: is called when frames of pull-push have landed, before they are encoded.
    #[doc(hidden)]
    pub levels_hook: Option<LevelsHook>,
    /// Clouds of so many points get the normals and kernels that they lack when they are read, larger ones when a frame needs them.
    pub estimate_at_once: usize,
    /// For tests: bakes do not begin while this is shut.
    #[doc(hidden)]
    pub bake_latch: Option<Arc<Latch>>,
    /// For tests: is called whenever a request is resolved.
    #[doc(hidden)]
    pub resolve_hook: Option<Arc<dyn Fn() + Send + Sync>>,
    /// For tests: files that changed more recently than this are not kept packed.
    #[doc(hidden)]
    pub settled_after: Duration,
    /// Cache of point trees and large clouds between processes; `None`: they are built and read anew.
    pub bake_cache: Option<BakeCache>,
    /// Pipelines that are built before frames need them; `None`: none.
    pub prime: Option<PrimeConfig>,
    /// Up direction of bare asset files, instead of a guess.
    pub up: Option<DVec3>,
    pub read: ReadOptions,
    pub scene: SceneLimits,
}

/// Pixels of a frame, unless less memory is there, and those that any memory has room for.
const MOST_PIXELS: u64 = 1 << 24;
const FEWEST_PIXELS: u64 = 1 << 20;
/// Bytes that buffers of a frame have for each pixel at most, of a frame of blended splats.
const FRAME_PIXEL_BYTES: u64 = 64;
/// Least default budget of a CPU adapter, in bytes.
const LEAST_CPU_BYTES: u64 = 64 << 20;

/// Limits where none are given. They follow the memory for loaded scenes, because a CPU adapter's buffers are host memory too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DefaultLimits {
    /// Width · height of a frame, whose buffers take a third of the memory at most.
    pub max_pixels: u64,
    /// Bytes of scene data on a CPU adapter: a quarter of the memory.
    pub cpu_adapter_bytes: u64,
}

impl DefaultLimits {
    /// The limits of a process whose loaded scenes may take this many bytes.
    pub fn of(memory_bytes: u64) -> DefaultLimits {
        let pixels = memory_bytes / 3 / FRAME_PIXEL_BYTES;
        DefaultLimits {
            max_pixels: pixels.clamp(FEWEST_PIXELS, MOST_PIXELS),
            cpu_adapter_bytes: (memory_bytes / 4).max(LEAST_CPU_BYTES),
        }
    }
}

impl EngineConfig {
    /// Returns the defaults for scenes below `root`, in half of the memory of the machine.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self::within(root, memory::default_budget())
    }

    /// Returns the defaults for scenes below `root`, with limits for this many bytes of memory.
    pub fn within(root: impl Into<PathBuf>, memory_bytes: u64) -> Self {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        Self {
            root: root.into(),
            gpu_budget_bytes: None,
            memory: HostMemory::unlimited(),
            memory_bytes,
            queue_capacity: 256,
            queue_time: Duration::from_secs(30),
            job_share: DEFAULT_JOB_SHARE,
            max_batch: 16,
            batch_time: Duration::from_nanos(BATCH_NS),
            encoder_threads: cores.clamp(1, 8),
            encode_hook: None,
            max_pixels: DefaultLimits::of(memory_bytes).max_pixels,
            max_side: 8192,
            may_draw_in_full: false,
            force_32_bit: false,
            max_binding_bytes: None,
            small_triangle_px: None,
            draw_hidden: false,
            small_splat_px: None,
            like_a_gpu: false,
            rasterise: None,
            large_units_limit: None,
            estimate_at_once: ESTIMATE_AT_ONCE,
            patch_hook: None,
            levels_hook: None,
            bake_latch: None,
            resolve_hook: None,
            settled_after: SETTLED_AFTER,
            bake_cache: None,
            prime: None,
            read: ReadOptions::default(),
            up: None,
            scene: SceneLimits::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_follow_the_memory() {
        let limits = |mib: u64| DefaultLimits::of(mib << 20);
        assert_eq!(limits(1 << 20).max_pixels, 1 << 24);
        assert_eq!(limits(1024).max_pixels, (1 << 30) / 192);
        assert_eq!(limits(1024).cpu_adapter_bytes, 256 << 20);
        assert_eq!(limits(1), DefaultLimits { max_pixels: 1 << 20, cpu_adapter_bytes: 64 << 20 });
        assert_eq!(EngineConfig::within("/", 1 << 30).max_pixels, limits(1024).max_pixels);
    }
}
