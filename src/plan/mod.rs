//! Which passes a frame needs and why, as pure functions of scene, view and limits (floor 3).
mod settings;

pub use settings::{Lod, Output, Reconstruct, Settings};
