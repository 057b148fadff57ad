//! Preprocessing: assets → what the GPU holds (floor 2).
//!
//! - [`estimate_point_attributes`] gives points the normals and radii that they lack, from their
//!   nearest neighbours;
//! - [`estimate_kernels`] gives them kernels as well, whose disks leave no holes, in the same search;
//! - [`fill_colors`] gives them colours, from intensity or class;
//! - [`mesh_lines`] turns leaves and branches of meshes into lines;
//! - [`sample_mesh`] turns meshes into samples whose disks cover them and end at their sharp edges;
//! - [`rasterise_mesh`] turns meshes into many more samples, faster, whose disks cover them;
//! - [`detect_features`] finds sharp edges in points, and where their kernels end there;
//! - [`smooth_normals`] gives meshes vertex normals, splitting vertices at creases;
//! - [`csg`] combines sampled solids;
//! - [`assemble`] reads, samples and combines the files of a scene's assets;
//! - [`prepare`] applies these steps as a file needs them, for the GPU and for the reference renderer alike;
//! - [`hybrid`] samples meshes for point trees, which keep the triangles where triangles are better;
//! - [`line_levels`] simplifies and thins out lines, from which a frame selects in the same way;
//! - [`tree`] builds point trees, from which a frame selects its level of detail;
//! - [`external`] builds the point trees of files that do not fit into memory;
//! - [`estimate`] estimates normals and kernels of large clouds piece by piece while packing them;
//! - [`environment`] blurs images of surroundings for surfaces of every roughness;
//! - [`spacing`] measures the distance between packed samples;
//! - [`outline`] finds the few points of a geometry that decide which cameras show all of it;
//! - [`pack`] encodes geometry in the records that the GPU reads;
//! - [`cache`] keeps baked geometries in a folder.

pub mod assemble;
pub mod cache;
pub mod csg;
pub mod environment;
pub mod estimate;
pub mod external;
pub mod hybrid;
pub mod line_levels;
mod mesh_lines;
pub mod outline;
pub mod pack;
pub mod prepare;
pub mod spacing;
pub mod tree;
pub mod uncovered;
pub mod upright;

mod attributes;
mod colors;
mod crease;
mod extent;
mod features;
mod groups;
mod kernels;
mod neighbors;
mod normals;
mod rasterise;
mod sample;

pub use attributes::{estimate_kernels, estimate_point_attributes};
pub use colors::fill_colors;
pub use crease::smooth_normals;
pub use features::{FeatureOptions, detect_features};
pub use kernels::{CUTOFF, circle};
pub use rasterise::{RasteriseOptions, RasterisedMesh, rasterise_mesh};
pub use sample::{SampleError, SampleOptions, expected_samples, sample_mesh};
