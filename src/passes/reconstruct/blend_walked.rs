//! Sums of listed splats.

pub use super::walk_listed as record;
