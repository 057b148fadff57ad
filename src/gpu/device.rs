//! Finds and opens an adapter.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::pipeline_store::{Kept, PipelineStore};

/// Range of the size of memory blocks on a CPU adapter.
const CPU_BLOCK_BYTES: std::ops::Range<u64> = 4 << 20..32 << 20;

/// Options that choose the adapter.
#[derive(Clone, Debug, Default)]
pub struct GpuOptions {
    /// Use the two-pass 32-bit visibility buffer even where 64-bit atomics exist.
    pub force_32_bit: bool,
    /// Whether large triangles go to the rasteriser; `None` for what was measured to be faster on this kind of adapter.
    pub rasterise: Option<bool>,
    /// Takes a software adapter for a GPU.
    pub like_a_gpu: bool,
    /// Part of the adapter's name, ignoring case. Also read from `POINTILLIST_ADAPTER`.
    pub adapter: Option<String>,
    /// Upper bound on the bytes of a binding, even if the adapter allows more.
    pub max_binding_bytes: Option<u64>,
    /// Folder in which compiled pipelines are kept between processes.
    pub pipeline_folder: Option<PathBuf>,
    /// Fingerprint of the sources of the pipelines. Files with another fingerprint are not read.
    pub pipeline_source: String,
}

#[derive(Debug, Clone, thiserror::Error)]
pub enum GpuError {
    #[error(
        "no Vulkan adapter was found{wanted}; on Debian or Ubuntu `apt-get install libvulkan1 mesa-vulkan-drivers` \
         brings one that runs on the CPU"
    )]
    NoAdapter { wanted: String },
    #[error("adapter {adapter} cannot be used: {reason}")]
    Unfit { adapter: String, reason: String },
}

/// An opened adapter.
pub struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    /// Name and driver, as in receipts.
    pub name: String,
    /// Whether 64-bit `atomicMax` works on storage buffers.
    pub atomics_64: bool,
    /// Whether 64-bit atomic sums work on storage buffers.
    pub atomic_sums_64: bool,
    /// Nanoseconds per timestamp tick; `None` if the adapter has no timestamps.
    pub timestamp_period_ns: Option<f32>,
    /// Whether timestamps can be written outside of passes.
    pub stamps_between_passes: bool,
    pub limits: wgpu::Limits,
    /// Whether this is a software adapter, whose GPU memory is host memory.
    pub is_cpu: bool,
    /// Whether this is a GPU with memory of its own.
    pub is_discrete: bool,
    /// Whether large triangles go to the rasteriser, which is slower on a CPU than walking them in compute.
    pub rasterises: bool,
    /// Whether shaders can use subgroup operations.
    pub subgroups: bool,
    /// The store of pipelines, and what was found in it.
    pub pipeline_store: Option<PipelineStore>,
    pub kept_pipelines: Kept,
    /// The cache of the driver's compiled code, if the driver offers one.
    pub pipeline_cache: Option<wgpu::PipelineCache>,
    lost: Arc<AtomicBool>,
}

/// 64-bit atomics that take the greater of two values.
const ATOMICS_64: wgpu::Features =
    wgpu::Features::SHADER_INT64.union(wgpu::Features::SHADER_INT64_ATOMIC_MIN_MAX);
/// 64-bit atomics that add and exchange.
const ATOMIC_SUMS_64: wgpu::Features =
    wgpu::Features::SHADER_INT64.union(wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS);

impl Gpu {
    /// Opens the most capable adapter: a discrete GPU before an integrated one, and both before a software adapter.
    ///
    /// # Errors
    /// There is no adapter, none has the given name, or the adapter has too few storage bindings for the passes.
    pub fn open(options: &GpuOptions) -> Result<Gpu, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::PRIMARY;
        // Our own scan pass writes indirect arguments, and validating them would cost a pass for each.
        descriptor.flags = wgpu::InstanceFlags::empty();
        let instance = wgpu::Instance::new(descriptor);
        let wanted = options
            .adapter
            .clone()
            .or_else(|| std::env::var("POINTILLIST_ADAPTER").ok())
            .map(|name| name.to_lowercase());
        let mut adapters: Vec<_> =
            pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY))
                .into_iter()
                .filter(|adapter| {
                    wanted.as_ref().is_none_or(|part| {
                        describe(&adapter.get_info()).to_lowercase().contains(part)
                    })
                })
                .collect();
        adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        let Some(adapter) = adapters.into_iter().next() else {
            let wanted =
                wanted.map(|part| format!(" with `{part}` in its name")).unwrap_or_default();
            return Err(GpuError::NoAdapter { wanted });
        };
        Self::open_adapter(&adapter, options)
    }

    fn open_adapter(adapter: &wgpu::Adapter, options: &GpuOptions) -> Result<Gpu, GpuError> {
        let info = adapter.get_info();
        let name = describe(&info);
        let unfit = |reason: String| GpuError::Unfit { adapter: name.clone(), reason };
        let mut limits = adapter.limits();
        if let Some(bytes) = options.max_binding_bytes {
            limits.max_storage_buffer_binding_size =
                limits.max_storage_buffer_binding_size.min(bytes);
        }
        if limits.max_storage_buffers_per_shader_stage < 16 {
            return Err(unfit(format!(
                "{} storage buffers a shader stage, 16 are needed",
                limits.max_storage_buffers_per_shader_stage
            )));
        }
        let features = wanted_features(adapter.features(), options.force_32_bit);
        let is_cpu = info.device_type == wgpu::DeviceType::Cpu && !options.like_a_gpu;
        let has_integers = features.contains(wgpu::Features::SHADER_INT64);
        let rasterises = options.rasterise.unwrap_or(!is_cpu) || !has_integers;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("pointillist"),
            required_features: features,
            required_limits: limits.clone(),
            memory_hints: memory_hints(is_cpu),
            ..Default::default()
        }))
        .map_err(|error| unfit(error.to_string()))?;
        let lost = Arc::new(AtomicBool::new(false));
        let flag = lost.clone();
        device.set_device_lost_callback(move |reason, message| {
            if !matches!(reason, wgpu::DeviceLostReason::Destroyed) {
                tracing::error!(?reason, message, "the GPU was lost");
            }
            flag.store(true, Ordering::SeqCst);
        });
        let pipeline_store = options.pipeline_folder.as_ref().map(|folder| {
            let driver = format!("{:?} {} {}", info.backend, info.vendor, info.device);
            PipelineStore::new(folder, &[&name, &driver, &options.pipeline_source])
        });
        let kept_pipelines =
            pipeline_store.as_ref().and_then(PipelineStore::load).unwrap_or_default();
        let caches = features.contains(wgpu::Features::PIPELINE_CACHE) && pipeline_store.is_some();
        let pipeline_cache = caches.then(|| pipeline_cache(&device, &kept_pipelines.driver));
        let timestamp_period_ns = features
            .contains(wgpu::Features::TIMESTAMP_QUERY)
            .then(|| queue.get_timestamp_period());
        Ok(Gpu {
            device,
            queue,
            name,
            atomics_64: features.contains(ATOMICS_64),
            atomic_sums_64: features.contains(ATOMIC_SUMS_64),
            timestamp_period_ns,
            stamps_between_passes: features
                .contains(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS),
            limits,
            is_cpu,
            is_discrete: info.device_type == wgpu::DeviceType::DiscreteGpu,
            rasterises,
            subgroups: features.contains(wgpu::Features::SUBGROUP),
            pipeline_store,
            kept_pipelines,
            pipeline_cache,
            lost,
        })
    }

    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::SeqCst)
    }

    /// The largest buffer in bytes that a shader can bind as a whole.
    pub fn max_binding_bytes(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)
    }
}

/// Chooses among the features that an adapter offers. The 32-bit path stands for the poorest adapters, which have no subgroups either.
fn wanted_features(offered: wgpu::Features, force_32_bit: bool) -> wgpu::Features {
    let mut features = offered
        & (wgpu::Features::SHADER_INT64
            | wgpu::Features::TIMESTAMP_QUERY
            | wgpu::Features::PIPELINE_CACHE);
    if features.contains(wgpu::Features::TIMESTAMP_QUERY) {
        features |= offered & wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
    }
    if !force_32_bit {
        for wanted in [ATOMICS_64, ATOMIC_SUMS_64, wgpu::Features::SUBGROUP] {
            if offered.contains(wanted) {
                features |= wanted;
            }
        }
    }
    features
}

fn pipeline_cache(device: &wgpu::Device, kept: &[u8]) -> wgpu::PipelineCache {
    let descriptor = wgpu::PipelineCacheDescriptor {
        label: Some("pipelines"),
        data: (!kept.is_empty()).then_some(kept),
        // Data of another driver gives an empty cache.
        fallback: true,
    };
    #[allow(unsafe_code, reason = "the driver is handed the bytes that it gave an earlier process")]
    // SAFETY: the bytes are what `PipelineCache::get_data` returned. Their SHA-256 was right, they were in a file named after
    // this adapter and driver, and wgpu compares the header that it wrote in front of them.
    unsafe {
        device.create_pipeline_cache(&descriptor)
    }
}

/// On a CPU adapter GPU memory is host memory, which returns to the system in whole blocks, so blocks are small.
fn memory_hints(is_cpu: bool) -> wgpu::MemoryHints {
    if is_cpu {
        wgpu::MemoryHints::Manual { suballocated_device_memory_block_size: CPU_BLOCK_BYTES }
    } else {
        wgpu::MemoryHints::Performance
    }
}

fn describe(info: &wgpu::AdapterInfo) -> String {
    if info.driver_info.is_empty() {
        info.name.clone()
    } else {
        format!("{} [{}]", info.name, info.driver_info)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_of_cpu_adapters_comes_in_small_blocks() {
        use wgpu::MemoryHints::{Manual, Performance};
        assert!(matches!(
            memory_hints(true),
            Manual { suballocated_device_memory_block_size } if suballocated_device_memory_block_size.end <= 32 << 20
        ));
        assert!(matches!(memory_hints(false), Performance));
    }
}
