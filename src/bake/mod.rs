//! Preprocessing: assets → what the GPU holds (floor 2).
//!
//! - [`estimate_point_attributes`] gives points the normals and radii that they lack, from their
//!   nearest neighbours;
//! - [`fill_colors`] gives them colours, from intensity or class;
//! - [`smooth_normals`] gives meshes vertex normals, splitting vertices at creases;
//! - [`csg`] combines sampled solids;
//! - [`assemble`] reads, samples and combines what a scene's assets are made of;
//! - [`prepare`] applies these as a file needs them, the same for the GPU and for the reference renderer;
//! - [`pack`] puts geometry into the records that the GPU reads.

pub mod assemble;
pub mod csg;
pub mod features;
pub mod pack;
pub mod prepare;
pub mod sample;

mod colors;
mod crease;
mod neighbors;
mod normals;

pub use colors::fill_colors;
pub use crease::smooth_normals;
pub use normals::estimate_point_attributes;
