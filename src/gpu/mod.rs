//! The device and everything around it; knows no scene (floor 2b).
//!
//! [`Gpu`] is an opened adapter. [`shader`] composes WGSL from fragments. [`pipeline`] builds pipelines whose bind group layouts
//! are reflected from the shader. [`pipeline_store`] keeps compiled pipelines on disk. [`buffer`] has growing and sub-allocated
//! buffers. [`timing`] writes timestamps for each pass. [`readback`] is the ring of buffers through which pixels come back.

pub mod bind;
pub mod buffer;
mod device;
pub mod pipeline;
pub mod pipeline_store;
pub mod readback;
pub mod shader;
pub mod timing;

pub use device::{Gpu, GpuError, GpuOptions};
