//! Sorts many elements by a key of 64 bits, such as their position along a curve.
//!
//! Elements are first distributed into buckets by the upper bits of their keys, then each bucket is sorted. Most comparisons
//! therefore happen in the processor's cache, and there is never a second copy of all entries. Keys are recomputed for every pass
//! instead of being kept: the peak is 16 bytes per element, and the returned order takes 4.

use std::ops::Range;

use rayon::prelude::*;

/// Bits of a key that choose a bucket.
const BUCKET_BITS: u32 = 16;
/// Below this number elements are sorted in one piece.
const FEW: usize = 1 << 16;
/// Buckets with more entries are sorted by all threads together.
const LARGE: usize = 1 << 20;
/// Maximum number of runs of buckets; each run is one pass over all elements.
const MOST_RUNS: usize = 8;

/// Key and index of an element.
type Entry = (u64, u32);

/// Returns the indices of `count` elements (at most 2³²) by ascending key, in a stable order, and the number of keys less than
/// `split`.
pub(super) fn by_key(
    count: usize,
    split: u64,
    key: impl Fn(usize) -> u64 + Sync,
) -> (Vec<u32>, usize) {
    let mut entries: Vec<Entry>;
    if count < FEW {
        entries = (0..count).into_par_iter().map(|index| (key(index), index as u32)).collect();
        entries.par_sort_unstable();
    } else {
        entries = vec![(0, 0); count];
        sort_in_buckets(&mut entries, &key);
    }
    let below = entries.partition_point(|&(key, _)| key < split);
    (entries.par_iter().map(|&(_, index)| index).collect(), below)
}

fn bucket_of(key: u64) -> usize {
    (key >> (u64::BITS - BUCKET_BITS)) as usize
}

fn sort_in_buckets(entries: &mut [Entry], key: &(impl Fn(usize) -> u64 + Sync)) {
    let count = entries.len();
    let counts = count_buckets(count, key);
    let runs = runs_of(&counts, count.div_ceil(rayon::current_num_threads().clamp(1, MOST_RUNS)));
    let mut rest = entries;
    let mut work = Vec::with_capacity(runs.len());
    for run in runs {
        let length = counts[run.clone()].iter().sum::<u32>() as usize;
        let (own, others) = rest.split_at_mut(length);
        work.push((run, own));
        rest = others;
    }
    work.into_par_iter().for_each(|(run, own)| {
        let first = run.start;
        let mut next: Vec<u32> = Vec::with_capacity(run.len());
        let mut at = 0;
        for &count in &counts[run.clone()] {
            next.push(at);
            at += count;
        }
        for index in 0..count {
            let key = key(index);
            if let Some(next) = bucket_of(key).checked_sub(first).and_then(|at| next.get_mut(at)) {
                own[*next as usize] = (key, index as u32);
                *next += 1;
            }
        }
        sort_each(own, &counts[run]);
    });
}

/// Counts the keys of each bucket.
fn count_buckets(count: usize, key: &(impl Fn(usize) -> u64 + Sync)) -> Vec<u32> {
    let buckets = 1usize << BUCKET_BITS;
    let part = count.div_ceil(rayon::current_num_threads()).max(FEW);
    let parts = (0..count.div_ceil(part)).into_par_iter().map(|number| {
        let mut counts = vec![0u32; buckets];
        for index in number * part..count.min((number + 1) * part) {
            counts[bucket_of(key(index))] += 1;
        }
        counts
    });
    let both = |mut a: Vec<u32>, b: Vec<u32>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    parts.reduce(|| vec![0; buckets], both)
}

/// Runs of buckets with about `size` entries each.
fn runs_of(counts: &[u32], size: usize) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let (mut first, mut held) = (0, 0usize);
    for (bucket, &count) in counts.iter().enumerate() {
        held += count as usize;
        if held >= size {
            runs.push(first..bucket + 1);
            (first, held) = (bucket + 1, 0);
        }
    }
    runs.push(first..counts.len());
    runs
}

/// Sorts the buckets of a run, which are stored consecutively.
fn sort_each(entries: &mut [Entry], counts: &[u32]) {
    let mut rest = entries;
    let mut buckets = Vec::new();
    for &count in counts {
        let (own, others) = rest.split_at_mut(count as usize);
        if count > 1 {
            buckets.push(own);
        }
        rest = others;
    }
    buckets.into_par_iter().for_each(|bucket| {
        if bucket.len() > LARGE {
            bucket.par_sort_unstable();
        } else {
            bucket.sort_unstable();
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::random::SplitMix64;

    fn check(count: usize, split: u64, key: impl Fn(usize) -> u64 + Sync) {
        let mut expected: Vec<Entry> = (0..count).map(|i| (key(i), i as u32)).collect();
        expected.sort();
        let below = expected.iter().filter(|(key, _)| *key < split).count();
        let (order, found) = by_key(count, split, &key);
        assert_eq!(found, below);
        assert!(order.iter().eq(expected.iter().map(|(_, index)| index)), "{count}");
    }

    #[test]
    fn elements_are_ordered_by_key_and_then_by_number() {
        let mut numbers = SplitMix64::new(7);
        let keys: Vec<u64> = (0..3 * FEW).map(|_| numbers.next_u64()).collect();
        for count in [0, 1, 2, 1000, FEW - 1, FEW, 3 * FEW] {
            // The keys spread over all buckets, over a few, or lie in one; many are equal.
            check(count, 1 << 63, |i| keys[i]);
            check(count, 1 << 63, |i| keys[i] & 0x8000_ffff_ffff_ffff);
            check(count, 500, |i| keys[i] >> 40);
            check(count, 3, |i| keys[i] >> 61);
        }
    }
}
