//! How many painted splats reach into each tile.

pub use super::over_shares as record;
