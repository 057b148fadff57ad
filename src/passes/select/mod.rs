//! Which chunks are seen, and the map from each to the image.

pub mod clear;
pub mod compact;
pub mod cull;
pub mod cull_groups;
pub mod cull_hidden;
pub mod depth_pyramid;
pub mod environment_background;
pub mod fog_background;
pub mod launch_portions;
pub mod list_entries;
pub mod list_groups;
pub mod place;
pub mod scan;
pub mod select_chunks;
