//! External merge sort: runs that fit into memory are sorted and written, then merged as they are read.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::ops::Range;

use bytemuck::Pod;
use rayon::prelude::*;

use super::spill::{Spill, SpillFile, Walk};

/// Minimum number of bytes of a run that are read at once.
const LEAST_BLOCK: usize = 16 << 10;

/// A record sorted by a key; keys are unique.
pub trait Sortable: Pod + Send + Sync {
    type Key: Ord + Copy + Send;

    fn key(&self) -> Self::Key;
}

/// Collects records in any order.
pub struct Sorter<R> {
    spill: Spill,
    records: Vec<R>,
    capacity: usize,
    runs: Runs<R>,
    merge_bytes: usize,
}

/// Sorted ranges of one file; `None` if all records are in memory.
type Runs<R> = Option<(SpillFile<R>, Vec<Range<u64>>)>;

impl<R: Sortable> Sorter<R> {
    /// `sort_bytes` is the memory for incoming records, `merge_bytes` the memory for reading.
    pub fn new(spill: &Spill, sort_bytes: usize, merge_bytes: usize) -> Sorter<R> {
        let capacity = (sort_bytes / size_of::<R>()).max(16);
        Sorter { spill: spill.clone(), records: Vec::new(), capacity, runs: None, merge_bytes }
    }

    pub fn push(&mut self, record: R) -> io::Result<()> {
        if self.records.len() == self.capacity {
            self.write_run()?;
        }
        if self.records.capacity() == 0 {
            self.records.reserve_exact(self.capacity);
        }
        self.records.push(record);
        Ok(())
    }

    fn write_run(&mut self) -> io::Result<()> {
        self.records.par_sort_unstable_by_key(R::key);
        let (file, runs) = match &mut self.runs {
            Some(runs) => runs,
            none => none.insert((self.spill.file()?, Vec::new())),
        };
        let first = file.count();
        file.extend(&self.records)?;
        runs.push(first..file.count());
        self.records.clear();
        Ok(())
    }

    pub fn finish(mut self) -> io::Result<Sorted<R>> {
        if self.runs.is_none() {
            self.records.par_sort_unstable_by_key(R::key);
            self.records.shrink_to_fit();
        } else if !self.records.is_empty() {
            self.write_run()?;
            self.records = Vec::new();
        }
        let Sorter { spill, records, mut runs, merge_bytes, .. } = self;
        let most = (merge_bytes / LEAST_BLOCK).max(2);
        while let Some((file, ranges)) = &runs
            && ranges.len() > most
        {
            let (mut merged, mut longer) = (spill.file()?, Vec::new());
            for ranges in ranges.chunks(most) {
                let first = merged.count();
                let mut merge = Merge::of_runs(file, ranges, merge_bytes)?;
                while let Some(record) = merge.next()? {
                    merged.push(record)?;
                }
                merged.flush()?;
                longer.push(first..merged.count());
            }
            runs = Some((merged, longer));
        }
        Ok(Sorted { records, runs, merge_bytes })
    }
}

/// Sorted records.
pub struct Sorted<R> {
    records: Vec<R>,
    runs: Runs<R>,
    merge_bytes: usize,
}

impl<R: Sortable> Sorted<R> {
    pub fn len(&self) -> u64 {
        self.runs.as_ref().map_or(self.records.len() as u64, |(file, _)| file.count())
    }

    /// Starts reading at the first record; may be called repeatedly.
    pub fn walk(&self) -> io::Result<Merge<'_, R>> {
        match &self.runs {
            Some((file, ranges)) => Merge::of_runs(file, ranges, self.merge_bytes),
            None => {
                Ok(Merge { memory: self.records.iter(), runs: Vec::new(), next: BinaryHeap::new() })
            }
        }
    }
}

/// Iterates over records in order.
pub struct Merge<'a, R: Sortable> {
    memory: std::slice::Iter<'a, R>,
    runs: Vec<(Walk<'a, R>, R)>,
    next: BinaryHeap<Reverse<(R::Key, usize)>>,
}

impl<'a, R: Sortable> Merge<'a, R> {
    fn of_runs(file: &'a SpillFile<R>, ranges: &[Range<u64>], bytes: usize) -> io::Result<Self> {
        let (mut runs, mut next) = (Vec::with_capacity(ranges.len()), BinaryHeap::new());
        for range in ranges {
            let mut walk = file.walk(range.clone(), bytes / ranges.len());
            if let Some(first) = walk.next()? {
                next.push(Reverse((first.key(), runs.len())));
                runs.push((walk, first));
            }
        }
        Ok(Merge { memory: [].iter(), runs, next })
    }

    pub fn next(&mut self) -> io::Result<Option<R>> {
        let Some(mut top) = self.next.peek_mut() else { return Ok(self.memory.next().copied()) };
        let Reverse((_, run)) = *top;
        let (walk, record) = &mut self.runs[run];
        let found = *record;
        match walk.next()? {
            Some(behind) => {
                *record = behind;
                *top = Reverse((behind.key(), run));
            }
            None => {
                std::collections::binary_heap::PeekMut::pop(top);
            }
        }
        Ok(Some(found))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    impl Sortable for [u32; 2] {
        type Key = [u32; 2];

        fn key(&self) -> [u32; 2] {
            *self
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn records_come_out_in_order(
            values in prop::collection::vec(0u32..500, 0..3000),
            sort_bytes in 1usize..9000,
            merge_bytes in 1usize..100_000,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let spill = Spill::new(folder.path(), u64::MAX);
            let mut sorter = Sorter::new(&spill, sort_bytes, merge_bytes);
            let mut expected: Vec<[u32; 2]> =
                values.iter().enumerate().map(|(i, &value)| [value, i as u32]).collect();
            expected.iter().for_each(|&record| sorter.push(record).unwrap());
            expected.sort_unstable();
            let sorted = sorter.finish().unwrap();
            prop_assert_eq!(sorted.len(), expected.len() as u64);
            for _ in 0..2 {
                let (mut merge, mut found) = (sorted.walk().unwrap(), Vec::new());
                while let Some(record) = merge.next().unwrap() {
                    found.push(record);
                }
                prop_assert_eq!(&found, &expected);
            }
        }
    }
}
