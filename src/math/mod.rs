//! Transforms, cameras, bounds and frusta in f64 (floor 0).

mod bounds;
mod camera;

pub use bounds::Bounds;
pub use camera::{Camera, CameraError, View};
