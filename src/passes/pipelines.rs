//! Pipelines, built when a frame first needs them.

use std::collections::HashMap;
use std::rc::Rc;

use super::shaders::{self, Choices};
use crate::gpu::Gpu;
use crate::gpu::pipeline::{ComputePipeline, RasterPipeline};
use crate::gpu::shader::ShaderError;

/// What distinguishes pipelines of one pass.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Variant {
    root: &'static str,
    choices: Choices,
    constants: Constants,
}

/// Values of a module's overrides, by name; booleans are 0 or 1.
pub type Constants = Vec<(&'static str, u32)>;

fn values(constants: &Constants) -> Vec<(&'static str, f64)> {
    constants.iter().map(|&(name, value)| (name, f64::from(value))).collect()
}

/// Every pipeline built so far.
#[derive(Default)]
pub struct Pipelines {
    compute: HashMap<Variant, Rc<ComputePipeline>>,
    raster: HashMap<Variant, Rc<RasterPipeline>>,
}

impl Pipelines {
    /// The pipeline of a compute pass; `root` is its file below `shaders/`, whose last part names the entry point.
    pub fn compute(
        &mut self,
        gpu: &Gpu,
        root: &'static str,
        choices: Choices,
        constants: Constants,
    ) -> Result<Rc<ComputePipeline>, ShaderError> {
        let values = values(&constants);
        let variant = Variant { root, choices, constants };
        if let Some(pipeline) = self.compute.get(&variant) {
            return Ok(pipeline.clone());
        }
        let name = root.rsplit('/').next().unwrap_or(root);
        let composed = shaders::composed(root, &choices)?;
        let pipeline = Rc::new(ComputePipeline::new(gpu, name, &composed, &values)?);
        self.compute.insert(variant, pipeline.clone());
        Ok(pipeline)
    }

    /// The rasteriser's pipeline.
    pub fn raster(
        &mut self,
        gpu: &Gpu,
        choices: Choices,
        constants: Constants,
    ) -> Result<Rc<RasterPipeline>, ShaderError> {
        let root = "project/rasterise_triangles";
        let values = values(&constants);
        let variant = Variant { root, choices, constants };
        if let Some(pipeline) = self.raster.get(&variant) {
            return Ok(pipeline.clone());
        }
        let composed = shaders::composed(root, &choices)?;
        let pipeline =
            Rc::new(RasterPipeline::new(gpu, "rasterise_triangles", &composed, &values)?);
        self.raster.insert(variant, pipeline.clone());
        Ok(pipeline)
    }
}
