//! Checks the invariants of packed geometry that passes and shaders rely on: every index is within its array.

use crate::bake::pack::{CHUNK, Grid, NodeRange, PackedChunk, PackedGeometry, holds};

/// # Errors
/// Returns the first violation.
pub(super) fn check(geometry: &PackedGeometry) -> Result<(), &'static str> {
    check_frame(geometry.grid(), geometry.chunks(), geometry.len() as u64)?;
    geometry.check()
}

/// Checks grid and chunks of a geometry with `count` elements.
pub(super) fn check_frame(
    grid: &Grid,
    chunks: &[PackedChunk],
    count: u64,
) -> Result<(), &'static str> {
    check_grid(grid)?;
    check_chunks(chunks, count)
}

fn check_grid(grid: &Grid) -> Result<(), &'static str> {
    holds(grid.origin.is_finite(), "its grid's origin is not finite")?;
    holds(grid.step.is_finite() && grid.step > 0.0, "its grid's step is not a length")?;
    holds(grid.reach >= 0, "its grid reaches nowhere")
}

/// Checks that chunks are consecutive and hold all `count` elements.
fn check_chunks(chunks: &[PackedChunk], count: u64) -> Result<(), &'static str> {
    holds(u32::try_from(count).is_ok(), "there are too many elements")?;
    let mut next = 0u64;
    for chunk in chunks {
        holds((1..=CHUNK).contains(&(chunk.count as usize)), "a chunk's count is out of range")?;
        holds(u64::from(chunk.first) == next, "a chunk is not behind the one before")?;
        next += u64::from(chunk.count);
        holds(next <= count, "a chunk ends behind the last element")?;
        let ends = chunk.origin.checked_add(chunk.extent).is_some();
        holds(ends && chunk.extent.min_element() >= 0, "a chunk's box is out of range")?;
        holds(chunk.shift < u32::BITS, "a chunk's steps are out of range")?;
        let NodeRange { base, error_parent, size_parent, error_least, size_least, delta_most } =
            chunk.range;
        let lengths = [
            chunk.kernel_base,
            base,
            error_parent,
            size_parent,
            error_least,
            size_least,
            delta_most,
        ];
        let are_lengths = lengths.iter().all(|&length| length.is_finite() && length >= 0.0);
        holds(are_lengths, "a chunk's lengths are not")?;
    }
    holds(next == count, "chunks do not hold all elements")
}
