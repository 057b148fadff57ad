//! Splats that one thread walks, blended and depth-tested at once.

pub use super::scatter as record;
