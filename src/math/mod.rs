//! Transforms, cameras, curves, bounds and frusta in f64 (floor 0).

mod bounds;
mod camera;
pub mod framing;
mod lens;
pub mod spline;
mod tube;

pub use bounds::Bounds;
pub use camera::{
    Camera, CameraError, FARTHEST, FOV_RANGE_DEG, Lens, ORTHO_HEIGHT_RANGE, Projection, Sensor,
    SensorView, View,
};
pub use lens::{Exposure, MOST_EXPOSURES, exposures};
pub use tube::{Entry, Tube};
