//! Checks the invariants of packed geometry that passes and shaders rely on: every index is within its array.

use crate::bake::pack::{
    CHUNK, Grid, NodeRange, PackedChunk, PackedGeometry, PackedMesh, PackedSamples, TRIANGLES,
};

/// # Errors
/// Returns the first violation.
pub(super) fn check(geometry: &PackedGeometry) -> Result<(), &'static str> {
    check_grid(geometry.grid())?;
    match geometry {
        PackedGeometry::Samples(samples) => check_samples(samples),
        PackedGeometry::Mesh(mesh) => check_mesh(mesh),
    }
}

fn holds(condition: bool, otherwise: &'static str) -> Result<(), &'static str> {
    if condition { Ok(()) } else { Err(otherwise) }
}

fn check_grid(grid: &Grid) -> Result<(), &'static str> {
    holds(grid.origin.is_finite(), "its grid's origin is not finite")?;
    holds(grid.step.is_finite() && grid.step > 0.0, "its grid's step is not a length")?;
    holds(grid.reach >= 0, "its grid reaches nowhere")
}

/// Checks a point tree without clip lines whose samples, nodes and attributes lie in files, `count` of each.
pub(super) fn check_spilled(
    grid: &Grid,
    chunks: &[PackedChunk],
    count: u64,
) -> Result<(), &'static str> {
    check_grid(grid)?;
    check_chunks(chunks, count as usize)?;
    holds(chunks.iter().all(|chunk| chunk.shift < u32::BITS), "a chunk's steps are out of range")
}

fn check_samples(samples: &PackedSamples) -> Result<(), &'static str> {
    let count = samples.positions.len();
    holds(samples.attributes.len() == count, "there are not as many attributes as positions")?;
    holds(samples.kernels.len() == count, "there are not as many kernels as positions")?;
    let nodes = samples.nodes.len();
    holds(nodes == 0 || nodes == count, "there are not as many nodes as positions")?;
    let clipped_first = samples.clipped_first as usize;
    holds(
        clipped_first.checked_add(samples.clips.len()) == Some(count),
        "there are not as many clip lines as clipped samples",
    )?;
    check_chunks(&samples.chunks, count)?;
    holds(
        clipped_first == count || samples.chunks.iter().any(|c| c.first as usize == clipped_first),
        "no chunk begins with the first clipped sample",
    )?;
    let shifts = samples.chunks.iter().all(|chunk| chunk.shift < u32::BITS);
    holds(shifts, "a chunk's steps are out of range")
}

fn check_mesh(mesh: &PackedMesh) -> Result<(), &'static str> {
    check_chunks(&mesh.chunks, mesh.triangles.len())?;
    let mut vertices = 0u64;
    for chunk in &mesh.chunks {
        holds(chunk.shift == TRIANGLES, "a chunk is not of triangles")?;
        holds(chunk.vertex_count as usize <= CHUNK, "a chunk has too many vertices")?;
        holds(u64::from(chunk.vertex_first) == vertices, "a chunk's vertices are not the next")?;
        vertices += u64::from(chunk.vertex_count);
        let triangles = &mesh.triangles[chunk.first as usize..][..chunk.count as usize];
        // The last index needs no mask: no bits lie above it.
        let is_inside = |word: &u32| {
            [word & 0x3ff, word >> 10 & 0x3ff, word >> 20].iter().all(|&v| v < chunk.vertex_count)
        };
        holds(triangles.iter().all(is_inside), "a triangle's vertex is not in its chunk")?;
    }
    holds(vertices == mesh.vertices.len() as u64, "chunks do not have all vertices")?;
    holds(u32::try_from(vertices).is_ok(), "there are too many vertices")
}

/// Checks that chunks are consecutive and hold all `count` samples or triangles.
fn check_chunks(chunks: &[PackedChunk], count: usize) -> Result<(), &'static str> {
    holds(u32::try_from(count).is_ok(), "there are too many samples or triangles")?;
    let mut next = 0u64;
    for chunk in chunks {
        holds((1..=CHUNK).contains(&(chunk.count as usize)), "a chunk's count is out of range")?;
        holds(u64::from(chunk.first) == next, "a chunk is not behind the one before")?;
        next += u64::from(chunk.count);
        holds(next <= count as u64, "a chunk ends behind the last sample or triangle")?;
        let ends = chunk.origin.checked_add(chunk.extent).is_some();
        holds(ends && chunk.extent.min_element() >= 0, "a chunk's box is out of range")?;
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
    holds(next == count as u64, "chunks do not hold all samples or triangles")
}
