//! Splits points into pieces that are in memory one at a time: neighbouring cells of the curve, up to a number of points.
//!
//! The curve jumps, so the box of an arbitrary stretch could hold half of all points. The boxes of a piece's cells hold few
//! points of other pieces.

use std::io;
use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use super::super::extent::Extent;
use super::spill::SpillFile;

/// Levels of the curve's cells.
const LEVELS: u32 = 21;

/// A point's position, for the neighbour search.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Place {
    pub(super) at: [f32; 3],
    /// Place in the file.
    pub(super) index: u32,
}

/// Points that are neighbours along the curve and in space.
pub(super) struct Piece {
    pub(super) range: Range<u64>,
    boxes: Vec<Extent>,
}

impl Piece {
    /// Squared distance of a position from the nearest of the piece's boxes.
    pub(super) fn distance_squared(&self, place: [f32; 3]) -> f32 {
        let place = Extent([place; 2]);
        self.boxes.iter().fold(f32::INFINITY, |least, own| least.min(own.distance_squared(&place)))
    }

    /// Squared distance between the boxes of two pieces.
    pub(super) fn gap_squared(&self, other: &Piece) -> f32 {
        let pairs = self.boxes.iter().flat_map(|a| other.boxes.iter().map(move |b| (a, b)));
        pairs.fold(f32::INFINITY, |least, (a, b)| least.min(a.distance_squared(b)))
    }
}

/// Cuts `count` points in ascending order of code into pieces of up to `most`.
pub(super) fn cut(
    count: u64,
    most: u64,
    code: impl Fn(u64) -> io::Result<u64>,
    places: &SpillFile<Place>,
) -> io::Result<Vec<Piece>> {
    let mut groups = Vec::new();
    split(0..count, LEVELS, most, &code, &mut groups)?;
    let mut pieces = Vec::with_capacity(groups.len());
    for cells in groups {
        let range = cells[0].start..cells[cells.len() - 1].end;
        let boxes: io::Result<Vec<Extent>> =
            cells.into_iter().map(|cell| box_of(cell, places)).collect();
        pieces.push(Piece { range, boxes: boxes? });
    }
    Ok(pieces)
}

/// Adds the groups of cells that a cell of a level is divided into.
fn split(
    range: Range<u64>,
    level: u32,
    most: u64,
    code: &impl Fn(u64) -> io::Result<u64>,
    groups: &mut Vec<Vec<Range<u64>>>,
) -> io::Result<()> {
    if range.end - range.start <= most {
        groups.push(vec![range]);
        return Ok(());
    }
    if level == 0 {
        // The codes are equal and cannot be split any further.
        let mut begin = range.start;
        while begin < range.end {
            let end = range.end.min(begin + most);
            let cell = begin..end;
            groups.push(vec![cell]);
            begin = end;
        }
        return Ok(());
    }
    let (mut group, mut held) = (Vec::new(), 0);
    let mut begin = range.start;
    while begin < range.end {
        let shift = 3 * (level - 1);
        let end = end_of(begin..range.end, code(begin)? >> shift, shift, code)?;
        let size = end - begin;
        if held + size > most && !group.is_empty() {
            groups.push(std::mem::take(&mut group));
            held = 0;
        }
        if size > most {
            split(begin..end, level - 1, most, code, groups)?;
        } else {
            group.push(begin..end);
            held += size;
        }
        begin = end;
    }
    groups.extend((!group.is_empty()).then_some(group));
    Ok(())
}

/// The end of the points of a cell.
fn end_of(
    range: Range<u64>,
    cell: u64,
    shift: u32,
    code: &impl Fn(u64) -> io::Result<u64>,
) -> io::Result<u64> {
    let (mut low, mut high) = (range.start, range.end);
    while low < high {
        let middle = low + (high - low) / 2;
        if code(middle)? >> shift > cell { high = middle } else { low = middle + 1 }
    }
    Ok(low)
}

fn box_of(range: Range<u64>, places: &SpillFile<Place>) -> io::Result<Extent> {
    let mut found = Extent::EMPTY;
    let mut walk = places.walk(range, 1 << 18);
    while let Some(Place { at, .. }) = walk.next()? {
        found = found.with(Extent([at; 2]));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::super::spill::Spill;
    use super::*;

    #[test]
    fn pieces_hold_all_points_once_and_lie_apart() {
        let folder = tempfile::tempdir().unwrap();
        let spill = Spill::new(folder.path(), u64::MAX);
        let mut places = spill.file().unwrap();
        // A square of 128 × 128 points along the curve; a thousand more share its last corner.
        let mut codes: Vec<(u64, [f32; 3])> = (0..128 * 128u32)
            .map(|i| {
                let at = glam::IVec3::new((i % 128) as i32, (i / 128) as i32, 0);
                (super::super::super::pack::morton(at * 512), at.as_vec3().to_array())
            })
            .collect();
        codes.sort_by_key(|&(code, _)| code);
        codes.extend(vec![codes[128 * 128 - 1]; 1000]);
        for (index, &(_, at)) in (0..).zip(&codes) {
            places.push(Place { at, index }).unwrap();
        }
        places.flush().unwrap();
        let count = codes.len() as u64;
        let pieces = cut(count, 300, |at| Ok(codes[at as usize].0), &places).unwrap();
        let mut next = 0;
        for piece in &pieces {
            assert_eq!(piece.range.start, next);
            assert!((1..=300).contains(&(piece.range.end - next)));
            for &(_, at) in &codes[piece.range.start as usize..piece.range.end as usize] {
                assert_eq!(piece.distance_squared(at), 0.0);
            }
            // The box of a stretch from the middle of the curve would hold all of them.
            let within = codes.iter().filter(|(_, at)| piece.distance_squared(*at) == 0.0).count();
            assert!(within <= 300 || codes[next as usize].1 == [127.0, 127.0, 0.0], "{within}");
            next = piece.range.end;
        }
        assert_eq!(next, count);
        assert!(pieces[0].gap_squared(&pieces[pieces.len() - 1]) > 1000.0);
    }
}
