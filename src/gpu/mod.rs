//! The device and what surrounds it; knows no scene (floor 2b).
//!
//! [`Gpu`] is one adapter opened; [`shader`] composes WGSL from fragments; [`pipeline`] builds pipelines whose bind
//! group layouts are reflected from the shader; [`pipeline_store`] keeps what is compiled on disk; [`buffer`] holds growing and sub-allocated buffers; [`timing`] writes
//! a pair of timestamps a pass; [`readback`] is the ring through which pixels come back.

pub mod bind;
pub mod buffer;
mod device;
pub mod pipeline;
pub mod pipeline_store;
pub mod readback;
pub mod shader;
pub mod timing;

pub use device::{Gpu, GpuError, GpuOptions};
