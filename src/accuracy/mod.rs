//! How far a frame is from another one, the oracle's above all (floor 6).
//!
//! [`reference`] draws the scenes that the engine draws, [`metrics`] says how far apart two frames are.
pub mod metrics;
pub mod reference;
