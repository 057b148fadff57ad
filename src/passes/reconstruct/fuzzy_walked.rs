//! Listed splats, blended and depth-tested at once.

pub use super::walk_listed as record;
