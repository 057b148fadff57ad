//! How far a frame is from another one, the oracle's above all (floor 6).
//!
//! [`mod@reference`] draws the scenes that the engine draws, [`metrics`] says how far apart two frames are.
//! [`mod@stability`] holds what shaders compute of splats in f32 against f64, where that is hard.
pub mod metrics;
pub mod reference;
pub mod stability;
