//! The accuracy of frames, above all compared with the oracle (floor 6).
//!
//! [`mod@reference`] draws reference frames of the engine's scenes, and [`metrics`] measures the difference of two frames.
//! [`mod@stability`] compares the shaders' computations of splats in f32 with f64, in cases that are numerically hard.
pub mod metrics;
pub mod reference;
pub mod stability;
