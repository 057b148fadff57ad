//! The passes of a frame and how they are recorded (floor 4).
//!
//! `plan/table.rs` lists them in order, with the path of each pass's shader, which is that of its module here as well.
//!
//! Frames of one scene, size and output go through the passes together: a dispatch counts the views in z, and each view has
//! its share of every buffer.
//!
//! A visibility buffer filled by 64-bit atomics in compute draws points an order of magnitude faster than a rasteriser
//! (Schütz, Kerbl, Wimmer 2021, "Rendering point clouds with compute shaders"); triangles of a few pixels go the same way.
//! Without 64-bit atomics, two passes over 32-bit words decide first the depth, then the id.

mod bindings;
mod frame;
mod levels;
mod lines;
mod pipelines;
mod prime;
mod project;
mod reconstruct;
mod record;
mod recorder;
mod resolve;
mod samples;
mod scratch;
mod select;
pub mod shaders;
mod slabs;
mod uniforms;

pub use frame::{FrameTask, frame_record, srgb8};
pub use levels::Levels;
pub use pipelines::{Pipelines, Variant, common, read_variants, write_variants};
pub use prime::Prime;
pub use record::record;
pub use recorder::{Context, PassSpan};
pub use scratch::{LAYERS_BYTES, PATCH_BYTES, Scratch};
pub use slabs::Slabs;
pub use uniforms::{GroupUniforms, Uniforms};

/// Longest side, in pixels, of a triangle's box up to which a single thread walks it. Measured with
/// `cargo bench --bench triangles` on lavapipe: over grids of equal triangles a thread beats walk_triangles by a third at
/// 32 px and by a tenth at 64, and the rasteriser tenfold; where only a few triangles are seen, eight threads for each are
/// better.
pub const SMALL_TRIANGLE_PX: u32 = 32;

/// Longest side, in pixels, of a splat's box up to which a single thread walks it.
pub const SMALL_SPLAT_PX: u32 = 32;
