//! Sums of splats that one thread walks.

pub use super::scatter as record;
