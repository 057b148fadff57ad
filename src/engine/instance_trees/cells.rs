//! Places of instances along a Morton curve, and the cells of its octree that hold a block of them.

use std::ops::Range;

use glam::DVec3;

use crate::bake::pack::spread;
use crate::math::Bounds;

/// Largest number of instances in a block, unless they are at one place.
pub const BLOCK: usize = 4096;
/// Levels of the octree: bits of a key's coordinate.
pub const LEVELS: u32 = 42;

/// An instance and its position. Equal keys are in the order of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    pub key: u128,
    pub run: u32,
    pub index: u32,
}

/// Returns the exponent of a cube about the origin that holds twice the box, so that small moves do not change the cube.
pub fn exponent(bounds: &Bounds) -> i32 {
    let most = bounds.min.abs().max(bounds.max.abs()).max_element();
    if most > 0.0 && most.is_finite() { most.log2().floor() as i32 + 2 } else { 0 }
}

/// Returns the place along a Morton curve through the cube from −2ᵉ to 2ᵉ; outside positions are clamped to its faces.
pub fn key(position: DVec3, exponent: i32) -> u128 {
    let side = f64::exp2(f64::from(LEVELS - 1));
    let cells = (position / f64::exp2(f64::from(exponent)) + 1.0) * side;
    let bits = cells.to_array().map(|cell| {
        let cell = (cell.max(0.0) as u64).min((1 << LEVELS) - 1);
        u128::from(spread(cell)) | u128::from(spread(cell >> 21)) << 63
    });
    bits[0] | bits[1] << 1 | bits[2] << 2
}

/// Returns the range of keys in a cell.
pub fn keys_of((first, depth): (u128, u32)) -> Range<u128> {
    first..first + (1 << (3 * (LEVELS - depth)))
}

pub type Cell = ((u128, u32), Range<usize>);

/// Returns the cells that hold at most [`BLOCK`] members and whose parents hold more, each with its members.
pub fn cells(members: &[Member]) -> Vec<Cell> {
    let mut found = Vec::new();
    let mut open = vec![((0u128, 0u32), 0..members.len())];
    while let Some((cell, range)) = open.pop() {
        if range.is_empty() {
            continue;
        }
        if range.len() <= BLOCK || cell.1 == LEVELS {
            found.push((cell, range));
            continue;
        }
        let depth = cell.1 + 1;
        let width = 1u128 << (3 * (LEVELS - depth));
        let mut end = range.end;
        // Push the last child first, so that the first is popped first.
        for child in (0..8).rev() {
            let first = cell.0 + width * child;
            let inside = &members[range.start..end];
            let begin = range.start + inside.partition_point(|member| member.key < first);
            open.push(((first, depth), begin..end));
            end = begin;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn keys_are_in_order_along_each_axis_and_end_at_the_faces() {
        let at = |x: f64| key(DVec3::new(x, 0.0, 0.0), 3);
        let places = [-f64::MAX, -8.0, -7.9, -1e-9, 0.0, 1e-9, 3.0, 7.999, 8.0, f64::MAX];
        assert!(places.windows(2).all(|pair| at(pair[0]) <= at(pair[1])));
        assert_eq!(at(-8.0), at(-f64::MAX));
        assert_eq!(at(8.0), at(f64::MAX));
        assert!(at(-1e-9) < at(1e-9));
        // The axes do not share bits.
        let corner = key(DVec3::splat(f64::MAX), 3);
        assert_eq!(corner, (1 << (3 * LEVELS)) - 1);
        assert!(keys_of((0, 0)).contains(&corner));
    }

    #[test]
    fn a_cube_is_twice_as_large_as_what_it_holds() {
        let of = |low: f64, high: f64| {
            exponent(&Bounds { min: DVec3::splat(low), max: DVec3::splat(high) })
        };
        assert_eq!(of(-1.0, 1.5), 2);
        assert_eq!(of(-3.0, 1.5), 3);
        assert_eq!(of(0.0, 0.0), 0);
        assert_eq!(exponent(&Bounds::EMPTY), 0);
        assert!(of(0.0, f64::MAX) > 1000);
        assert_eq!(key(DVec3::splat(1e300), of(0.0, f64::MAX)), key(DVec3::ZERO, 1026));
    }

    fn member(key: u128, index: u32) -> Member {
        Member { key, run: 0, index }
    }

    #[test]
    fn cells_split_where_they_hold_too_many() {
        // Members at one place form one block, however many they are.
        let same: Vec<Member> = (0..2 * BLOCK as u32).map(|index| member(77, index)).collect();
        let found = cells(&same);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].0, (77, LEVELS));
        // One member more than a block holds, one of them elsewhere.
        let mut apart = same[..BLOCK].to_vec();
        apart.push(member(1 << 125, 9));
        let found = cells(&apart);
        assert_eq!(found, [((0, 1), 0..BLOCK), ((1 << 125, 1), BLOCK..BLOCK + 1)]);
        assert!(cells(&[]).is_empty());
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

        /// A cell's members are in its range of keys, the cells together hold all members, and each parent holds too many.
        #[test]
        fn cells_are_a_partition(
            clusters in prop::collection::vec((0u128..1 << 126, 0u32..90, 1usize..3000), 1..8),
        ) {
            let mut members = Vec::new();
            for (number, &(base, bits, count)) in clusters.iter().enumerate() {
                for index in 0..count as u32 {
                    let spread = u128::from(index).wrapping_mul(0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c835) >> (128 - bits.max(1));
                    members.push(Member { key: (base ^ spread) % (1 << 126), run: number as u32, index });
                }
            }
            members.sort_unstable();
            let found = cells(&members);
            let mut next = 0;
            for ((first, depth), range) in &found {
                prop_assert_eq!(range.start, next);
                next = range.end;
                let keys = keys_of((*first, *depth));
                prop_assert!(members[range.clone()].iter().all(|member| keys.contains(&member.key)));
                prop_assert!(!range.is_empty() && (range.len() <= BLOCK || *depth == LEVELS));
                if *depth > 0 {
                    let width = keys_of((0, depth - 1)).end;
                    let parent = first / width * width..(first / width + 1) * width;
                    let inside = members.iter().filter(|member| parent.contains(&member.key)).count();
                    prop_assert!(inside > BLOCK);
                }
            }
            prop_assert_eq!(next, members.len());
        }
    }
}
