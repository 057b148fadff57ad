//! The painted splats of each tile.

pub use super::over_shares as record;
