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
mod fog;
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
mod shadow;
mod slabs;
mod spread;
mod uniforms;
mod windows;

pub use frame::{FrameTask, Round, frame_record, srgb8};
pub use levels::Levels;
pub use pipelines::{Pipelines, Variant, common, read_variants, write_variants};
pub use prime::Prime;
pub use record::record;
pub use recorder::{Context, LevelCopies, PassSpan};
pub use scratch::{EXPOSED_BYTES, PAINTED_BYTES, SLABS_BYTES, Scratch};
pub use shadow::{MAP_WEIGHT, MapKey, ShadowMaps, Shadows};
pub use slabs::Slabs;
pub use uniforms::{GroupUniforms, Uniforms};
pub use windows::{LAYERS, most_pixels as window_pixels};

/// Longest side, in pixels, of a triangle's box up to which a single thread walks it. Measured with
/// `cargo bench --bench triangles` on lavapipe: over grids of equal triangles a thread beats walk_triangles by a third at
/// 32 px and by a tenth at 64, and the rasteriser tenfold; where only a few triangles are seen, eight threads for each are
/// better. A GPU has more threads than a frame has large triangles: there a thread is 3.7 times as fast as the rasteriser at 8 px,
/// the rasteriser as fast at 16 and 3.5 times as fast at 32 (H100).
pub fn small_triangle_px(is_cpu: bool) -> u32 {
    if is_cpu { 32 } else { 16 }
}

/// Longest side, in pixels, of a splat's box up to which a single thread walks it. Limits of lines follow from it. On a GPU, 7500
/// splats of some 20 px took 11 ms with 32, 2.0 ms with 8 and with 16; ten trees of ribbons 4.5, 4.2 and 4.4 ms (H100, frames
/// equal bit for bit). With 4, frames of small splats take half as long again.
pub fn small_splat_px(is_cpu: bool) -> u32 {
    if is_cpu { 32 } else { 8 }
}
