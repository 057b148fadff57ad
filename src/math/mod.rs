//! Transforms, cameras, curves, bounds and frusta in f64, and the outlines of splats in f32 (floor 0).

mod bounds;
mod camera;
pub mod conic;
pub mod framing;
pub mod spline;

pub use bounds::Bounds;
pub use camera::{Camera, CameraError, FARTHEST, FOV_RANGE_DEG, Sensor, SensorView, View};
pub use conic::{Disk, GAP_MIN, GUARD_PX, ImageConic, ImageDisk, Lens, Side};
