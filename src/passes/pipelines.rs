//! Pipelines, built when a frame first needs them.

use std::collections::HashMap;
use std::rc::Rc;

use super::shaders::{self, Visibility};
use crate::gpu::Gpu;
use crate::gpu::pipeline::{ComputePipeline, RasterPipeline};
use crate::gpu::shader::ShaderError;

/// What distinguishes pipelines of one pass.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Variant {
    name: &'static str,
    visibility: Option<Visibility>,
    alpha_cut: bool,
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
    /// The pipeline of a pass that leaves the visibility buffer alone; `root` is its file below `shaders/`, `name` its
    /// entry point.
    pub fn plain(
        &mut self,
        gpu: &Gpu,
        root: &str,
        name: &'static str,
        constants: Constants,
    ) -> Result<Rc<ComputePipeline>, ShaderError> {
        let values = values(&constants);
        let variant = Variant { name, visibility: None, alpha_cut: false, constants };
        if let Some(pipeline) = self.compute.get(&variant) {
            return Ok(pipeline.clone());
        }
        let pipeline = Rc::new(ComputePipeline::new(
            gpu,
            name,
            &shaders::plain(root, gpu.subgroups)?,
            &values,
        )?);
        self.compute.insert(variant, pipeline.clone());
        Ok(pipeline)
    }

    /// The pipeline of a pass that writes the visibility buffer.
    pub fn visible(
        &mut self,
        gpu: &Gpu,
        root: &str,
        name: &'static str,
        visibility: Visibility,
        alpha_cut: bool,
        constants: Constants,
    ) -> Result<Rc<ComputePipeline>, ShaderError> {
        let values = values(&constants);
        let variant = Variant { name, visibility: Some(visibility), alpha_cut, constants };
        if let Some(pipeline) = self.compute.get(&variant) {
            return Ok(pipeline.clone());
        }
        let composed = shaders::visible(root, visibility, alpha_cut)?;
        let pipeline = Rc::new(ComputePipeline::new(gpu, name, &composed, &values)?);
        self.compute.insert(variant, pipeline.clone());
        Ok(pipeline)
    }

    /// The rasteriser's pipeline.
    pub fn raster(
        &mut self,
        gpu: &Gpu,
        visibility: Visibility,
        alpha_cut: bool,
        constants: Constants,
    ) -> Result<Rc<RasterPipeline>, ShaderError> {
        let name = "rasterise_triangles";
        let values = values(&constants);
        let variant = Variant { name, visibility: Some(visibility), alpha_cut, constants };
        if let Some(pipeline) = self.raster.get(&variant) {
            return Ok(pipeline.clone());
        }
        let composed = shaders::visible("project/rasterise_triangles", visibility, alpha_cut)?;
        let pipeline = Rc::new(RasterPipeline::new(gpu, name, &composed, &values)?);
        self.raster.insert(variant, pipeline.clone());
        Ok(pipeline)
    }
}
