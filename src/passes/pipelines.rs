//! Pipelines, built once for each variant of a pass: ahead of time by [`super::prime`], else when a frame first needs them. Variants
//! that differ by constants alone share a parsed shader.
//!
//! Frames and the thread that primes share the pipelines. Both may ask for a variant at once: the first builds it and the
//! other waits for it, so that no variant is built twice.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::shaders::{self, Choices};
use super::spread;
use crate::gpu::Gpu;
use crate::gpu::pipeline::{ComputePipeline, RasterPipeline, Shader};
use crate::gpu::shader::ShaderError;
use crate::plan::{Kind, Pass};

/// Variants that are remembered from one process to the next, the latest used ones.
const MOST_KEPT: usize = 256;

/// Everything that tells two pipelines apart.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize)]
pub struct Variant {
    root: &'static str,
    choices: Choices,
    constants: Vec<(Cow<'static, str>, u32)>,
}

/// A variant as a file has it; its names are checked before they are believed.
#[derive(Deserialize)]
struct ReadVariant {
    root: String,
    choices: Choices,
    constants: Vec<(Cow<'static, str>, u32)>,
}

/// Values of a module's overrides, by name; booleans are 0 or 1.
pub type Constants = Vec<(&'static str, u32)>;

/// Pipelines of one kind.
struct Slots<P>(Mutex<HashMap<Variant, Arc<Slot<P>>>>);

struct Slot<P> {
    built: OnceLock<Result<Arc<P>, ShaderError>>,
    /// A frame has asked for it.
    used: AtomicBool,
}

/// Parsed shaders, by root and choices.
type Shaders = HashMap<(&'static str, Choices), Arc<OnceLock<Result<Arc<Shader>, ShaderError>>>>;

/// Every pipeline built so far, and which of them frames have used.
#[derive(Default)]
pub struct Pipelines {
    shaders: Mutex<Shaders>,
    compute: Slots<ComputePipeline>,
    raster: Slots<RasterPipeline>,
    /// In the order of their first use.
    used: Mutex<Vec<Variant>>,
    late: AtomicU64,
}

impl<P> Default for Slots<P> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<P> Default for Slot<P> {
    fn default() -> Self {
        Self { built: OnceLock::new(), used: AtomicBool::new(false) }
    }
}

impl<P> Slots<P> {
    fn slot(&self, variant: &Variant) -> Arc<Slot<P>> {
        let mut slots = self.0.lock();
        if let Some(slot) = slots.get(variant) {
            return slot.clone();
        }
        slots.entry(variant.clone()).or_default().clone()
    }

    fn forget(&self, variant: &Variant) {
        self.0.lock().remove(variant);
    }
}

impl Variant {
    fn new(pass: Pass, choices: Choices, constants: Constants) -> Variant {
        let constants =
            constants.into_iter().map(|(name, value)| (Cow::Borrowed(name), value)).collect();
        Variant { root: pass.shader(), choices, constants }
    }

    fn is_raster(&self) -> bool {
        Pass::ALL.iter().any(|pass| pass.shader() == self.root && pass.kind() == Kind::Raster)
    }

    fn values(&self) -> Vec<(&str, f64)> {
        self.constants.iter().map(|(name, value)| (name.as_ref(), f64::from(*value))).collect()
    }

    /// The shader's own name, which is that of a compute pass's entry point.
    pub fn name(&self) -> &'static str {
        self.root.rsplit('/').next().unwrap_or(self.root)
    }
}

impl Pipelines {
    /// The shader of a variant, parsed once.
    fn shader(&self, gpu: &Gpu, variant: &Variant) -> Result<Arc<Shader>, ShaderError> {
        let slot = self.shaders.lock().entry((variant.root, variant.choices)).or_default().clone();
        let parse = || {
            let composed = shaders::composed(variant.root, &variant.choices)?;
            let stages = if variant.is_raster() {
                wgpu::ShaderStages::VERTEX_FRAGMENT
            } else {
                wgpu::ShaderStages::COMPUTE
            };
            Shader::new(gpu, variant.name(), &composed, stages).map(Arc::new)
        };
        slot.get_or_init(parse).clone()
    }

    fn forget_shader(&self, variant: &Variant) {
        self.shaders.lock().remove(&(variant.root, variant.choices));
    }

    /// Builds a pipeline of either kind.
    fn built<P>(
        &self,
        gpu: &Gpu,
        variant: &Variant,
        new: fn(&Gpu, &Shader, &[(&str, f64)]) -> P,
    ) -> Result<Arc<P>, ShaderError> {
        let shader = self.shader(gpu, variant)?;
        Ok(Arc::new(new(gpu, &shader, &variant.values())))
    }

    /// Returns the pipeline of a compute pass.
    ///
    /// # Errors
    /// A shader that does not compose or parse, which is a defect of this program.
    pub fn compute(
        &self,
        gpu: &Gpu,
        pass: Pass,
        choices: Choices,
        constants: Constants,
    ) -> Result<Arc<ComputePipeline>, ShaderError> {
        let variant = Variant::new(pass, choices, constants);
        let slot = self.compute.slot(&variant);
        self.note(&slot, &variant);
        slot.built.get_or_init(|| self.built(gpu, &variant, ComputePipeline::new)).clone()
    }

    /// Returns the pipeline of a pass through the rasteriser.
    ///
    /// # Errors
    /// As [`Pipelines::compute`].
    pub fn raster(
        &self,
        gpu: &Gpu,
        pass: Pass,
        choices: Choices,
        constants: Constants,
    ) -> Result<Arc<RasterPipeline>, ShaderError> {
        let variant = Variant::new(pass, choices, constants);
        let slot = self.raster.slot(&variant);
        self.note(&slot, &variant);
        slot.built.get_or_init(|| self.built(gpu, &variant, RasterPipeline::new)).clone()
    }

    /// Builds a variant ahead of time, with `check` around the building. Gives the pipeline where it is a compute pass and was
    /// not there before.
    ///
    /// # Errors
    /// The error of the shader or of `check`; the variant is forgotten then.
    pub(super) fn build(
        &self,
        gpu: &Gpu,
        variant: &Variant,
        check: impl FnOnce() -> Result<(), ShaderError>,
    ) -> Result<Option<Arc<ComputePipeline>>, ShaderError> {
        if variant.is_raster() {
            let slot = self.raster.slot(variant);
            let build = || {
                self.built(gpu, variant, RasterPipeline::new)
                    .and_then(|built| check().map(|()| built))
            };
            let built = slot.built.get_or_init(build).clone();
            return built.map(|_| None).inspect_err(|_| {
                self.raster.forget(variant);
                self.forget_shader(variant);
            });
        }
        let slot = self.compute.slot(variant);
        let mut is_new = false;
        let built = slot.built.get_or_init(|| {
            is_new = true;
            self.built(gpu, variant, ComputePipeline::new).and_then(|built| check().map(|()| built))
        });
        let built = built.clone().inspect_err(|_| {
            self.compute.forget(variant);
            self.forget_shader(variant);
        })?;
        Ok(is_new.then_some(built))
    }

    /// Counts pipelines that frames found missing, and notes what they use.
    fn note<P>(&self, slot: &Slot<P>, variant: &Variant) {
        if slot.used.swap(true, Ordering::Relaxed) {
            return;
        }
        if slot.built.get().is_none() {
            tracing::debug!(pass = variant.name(), "a frame builds a pipeline");
            self.late.fetch_add(1, Ordering::Relaxed);
        }
        self.used.lock().push(variant.clone());
    }

    /// Number of pipelines that frames had to build or to wait for.
    pub fn late(&self) -> u64 {
        self.late.load(Ordering::Relaxed)
    }

    /// Number of variants that frames have used.
    pub fn used(&self) -> usize {
        self.used.lock().len()
    }

    /// Variants worth building the next time: what frames have used, then what `earlier` processes did.
    pub fn remember(&self, earlier: &[Variant]) -> Vec<Variant> {
        let mut all = self.used.lock().clone();
        let rest: Vec<_> = earlier.iter().filter(|variant| !all.contains(variant)).collect();
        all.extend(rest.into_iter().cloned());
        all.truncate(MOST_KEPT);
        all
    }
}

/// Writes variants as JSON, one a line.
pub fn write_variants(variants: &[Variant]) -> String {
    let lines: Vec<String> =
        variants.iter().filter_map(|variant| serde_json::to_string(variant).ok()).collect();
    format!("[\n{}\n]\n", lines.join(",\n"))
}

/// Reads what [`write_variants`] wrote; variants of passes that are not there any more are left out.
pub fn read_variants(text: &[u8]) -> Vec<Variant> {
    let read: Vec<ReadVariant> = serde_json::from_slice(text).unwrap_or_default();
    let known = |read: ReadVariant| {
        let root = shaders::roots().into_iter().find(|root| *root == read.root)?;
        Some(Variant { root, choices: read.choices, constants: read.constants })
    };
    read.into_iter().filter_map(known).take(MOST_KEPT).collect()
}

/// Variants that the first frames of most scenes use, as a CPU adapter has them.
pub fn common(gpu: &Gpu) -> Vec<Variant> {
    let wide = gpu.atomics_64 && gpu.atomic_sums_64;
    let variants = if wide {
        read_variants(include_bytes!("common_pipelines.json"))
    } else {
        // Narrow adapters draw by other passes; what they use is remembered from their first frames.
        Vec::new()
    };
    let facts = (gpu.subgroups, gpu.is_cpu, gpu.rasterises);
    variants.into_iter().map(|variant| adapted(variant, facts)).collect()
}

/// A CPU adapter's variant as an adapter of other `(subgroups, is_cpu, rasterises)` has it.
fn adapted(variant: Variant, facts: (bool, bool, bool)) -> Variant {
    let (subgroups, is_cpu, rasterises) = facts;
    if rasterises && variant.root == Pass::WalkTriangles.shader() {
        // As `Recorder::raster` asks for it.
        let choices = Choices {
            visibility: variant.choices.visibility,
            alpha_cut: variant.choices.alpha_cut,
            ..Choices::default()
        };
        let constants = variant.constants.into_iter().filter(|(name, _)| name == "VIEWS").collect();
        let root = Pass::RasteriseTriangles.shader();
        return Variant { root, choices, constants };
    }
    let launched = |(name, value): (Cow<'static, str>, u32)| {
        let known = spread::overrides(is_cpu).into_iter().find(|(own, _)| *own == name);
        (name, known.map_or(value, |(_, value)| value))
    };
    Variant {
        choices: Choices { subgroups, ..variant.choices },
        constants: variant.constants.into_iter().map(launched).collect(),
        ..variant
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variant(pass: Pass, value: u32) -> Variant {
        Variant::new(pass, Choices::default(), vec![("VIEWS", 0), ("LANES", value)])
    }

    #[test]
    fn variants_are_read_as_they_were_written() {
        let written = [variant(Pass::Cull, 8), variant(Pass::WalkTriangles, 9)];
        let read = read_variants(write_variants(&written).as_bytes());
        assert_eq!(read, written);
        assert!(read_variants(b"[{}]").is_empty() && read_variants(b"\xff").is_empty());
        let unknown = write_variants(&written).replace("select/cull", "select/gone");
        assert_eq!(read_variants(unknown.as_bytes()), written[1..]);
    }

    #[test]
    fn what_frames_used_is_remembered_first() {
        let pipelines = Pipelines::default();
        let [a, b, c] = [1, 2, 3].map(|value| variant(Pass::Cull, value));
        for used in [&a, &b, &a] {
            pipelines.note(&pipelines.compute.slot(used), used);
        }
        assert_eq!((pipelines.late(), pipelines.used()), (2, 2));
        assert_eq!(pipelines.remember(&[c.clone(), b.clone()]), [a, b, c]);
        let many: Vec<Variant> = (0..1000).map(|value| variant(Pass::Scan, value)).collect();
        assert_eq!(pipelines.remember(&many).len(), MOST_KEPT);
    }

    #[test]
    fn common_variants_fit_other_adapters() {
        let cpu = read_variants(include_bytes!("common_pipelines.json"));
        assert!(cpu.len() > 20);
        for variant in &cpu {
            assert!(shaders::composed(variant.root, &variant.choices).is_ok(), "{variant:?}");
        }
        let gpu: Vec<Variant> =
            cpu.into_iter().map(|variant| adapted(variant, (false, false, true))).collect();
        assert!(gpu.iter().any(Variant::is_raster));
        assert!(gpu.iter().all(|variant| {
            let lanes =
                variant.constants.iter().all(|(name, value)| name != "LANES" || *value == 64);
            lanes && !variant.choices.subgroups && variant.name() != "walk_triangles"
        }));
    }
}
