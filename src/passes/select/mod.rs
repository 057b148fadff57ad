//! Which chunks are seen, and the map from each to the image.

pub mod clear;
pub mod compact;
pub mod cull;
pub mod place;
pub mod scan;
