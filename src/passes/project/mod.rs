//! Everything into one visibility buffer. Without 64-bit atomics each pass runs twice, for depths and for ids.

pub mod project_samples;
pub mod project_triangles;
pub mod rasterise_triangles;
pub mod walk_triangles;
