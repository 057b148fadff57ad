//! Preprocessing: assets → what the GPU holds (floor 2).
//!
//! - [`estimate_point_attributes`] gives points the normals and radii that they lack, from their
//!   nearest neighbours;
//! - [`estimate_kernels`] gives them kernels as well, whose disks leave no holes, in the same search;
//! - [`fill_colors`] gives them colours, from intensity or class;
//! - [`sample_mesh`] turns meshes into samples whose disks cover them and end at their sharp edges;
//! - [`rasterise_mesh`] turns them into many more, fast, whose disks cover them;
//! - [`detect_features`] finds sharp edges in points, and where their kernels end there;
//! - [`smooth_normals`] gives meshes vertex normals, splitting vertices at creases;
//! - [`csg`] combines sampled solids;
//! - [`assemble`] reads, samples and combines what a scene's assets are made of;
//! - [`prepare`] applies these as a file needs them, the same for the GPU and for the reference renderer;
//! - [`hybrid`] samples meshes for point trees, which keep the triangles for where they are the better;
//! - [`tree`] builds point trees, from which a frame takes the detail that it can show;
//! - [`external`] builds the point trees of files that do not fit into memory;
//! - [`estimate`] gives large clouds normals and kernels, a piece at a time, as it packs them;
//! - [`spacing`] tells how far apart packed samples lie;
//! - [`outline`] finds the few points of a geometry that decide which cameras show it whole;
//! - [`pack`] puts geometry into the records that the GPU reads;
//! - [`cache`] keeps what was baked in a folder.

pub mod assemble;
pub mod cache;
pub mod csg;
pub mod estimate;
pub mod external;
pub mod hybrid;
pub mod outline;
pub mod pack;
pub mod prepare;
pub mod spacing;
pub mod tree;
pub mod upright;

mod colors;
mod crease;
mod features;
mod kernels;
mod neighbors;
mod normals;
mod rasterise;
mod sample;

pub use colors::fill_colors;
pub use crease::smooth_normals;
pub use features::{FeatureOptions, detect_features};
pub use kernels::{CUTOFF, circle, estimate_kernels};
pub use normals::estimate_point_attributes;
pub use rasterise::{RasteriseOptions, RasterisedMesh, rasterise_mesh};
pub use sample::{SampleError, SampleOptions, expected_samples, sample_mesh};
