//! How far a frame is from another one, the oracle's above all (floor 6).
pub mod metrics;
