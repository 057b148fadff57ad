//! Temporary files of records.
//!
//! The files lie beside the result. On Unix they have no name where the system allows it, and on Windows the system deletes them
//! with the last handle, so they disappear however the process ends. Their total size is counted and bounded.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::Pod;

/// Size of the write buffer in bytes.
const BLOCK_BYTES: usize = 64 << 10;

/// A folder for temporary files, with a limit on their total size.
#[derive(Clone)]
pub struct Spill {
    folder: PathBuf,
    room: Arc<Room>,
}

struct Room {
    used: AtomicU64,
    most: AtomicU64,
    limit: u64,
}

impl Room {
    fn take(&self, bytes: u64) -> io::Result<()> {
        let used = self.used.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if used <= self.limit {
            self.most.fetch_max(used, Ordering::Relaxed);
            return Ok(());
        }
        self.used.fetch_sub(bytes, Ordering::Relaxed);
        let limit = self.limit.div_ceil(1 << 20);
        let reason = format!("temporary files would take more than the {limit} MiB they may");
        Err(io::Error::new(io::ErrorKind::StorageFull, reason))
    }
}

impl Spill {
    /// `limit` is the maximum total size of all files, in bytes.
    pub fn new(folder: &Path, limit: u64) -> Spill {
        let room = Room { used: AtomicU64::new(0), most: AtomicU64::new(0), limit };
        Spill { folder: folder.to_owned(), room: Arc::new(room) }
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The peak total size, in bytes.
    pub fn most_bytes(&self) -> u64 {
        self.room.most.load(Ordering::Relaxed)
    }

    /// Creates a file.
    ///
    /// # Errors
    /// Fails if the folder cannot be written.
    pub fn file<R: Pod>(&self) -> io::Result<SpillFile<R>> {
        Ok(SpillFile {
            file: tempfile::tempfile_in(&self.folder)?,
            block: Vec::new(),
            written: 0,
            room: self.room.clone(),
            records: PhantomData,
        })
    }
}

/// A file of records: written sequentially, read at any position.
pub struct SpillFile<R> {
    file: File,
    /// Records not written yet.
    block: Vec<R>,
    /// Number of records in the file.
    written: u64,
    room: Arc<Room>,
    records: PhantomData<R>,
}

impl<R: Pod> SpillFile<R> {
    const BYTES: u64 = size_of::<R>() as u64;

    pub fn count(&self) -> u64 {
        self.written + self.block.len() as u64
    }

    pub fn push(&mut self, record: R) -> io::Result<()> {
        self.block.push(record);
        if self.block.len() * size_of::<R>() >= BLOCK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Appends a few records, which later calls write.
    pub fn extend_buffered(&mut self, records: &[R]) -> io::Result<()> {
        records.iter().try_for_each(|&record| self.push(record))
    }

    pub fn extend(&mut self, records: &[R]) -> io::Result<()> {
        self.flush()?;
        self.room.take(records.len() as u64 * Self::BYTES)?;
        self.file.seek(SeekFrom::Start(self.written * Self::BYTES))?;
        self.file.write_all(bytemuck::cast_slice(records))?;
        self.written += records.len() as u64;
        Ok(())
    }

    /// Writes the buffered records; reads do not see them before.
    pub fn flush(&mut self) -> io::Result<()> {
        if self.block.is_empty() {
            return Ok(());
        }
        let mut block = std::mem::take(&mut self.block);
        self.extend(&block)?;
        block.clear();
        self.block = block;
        Ok(())
    }

    /// Overwrites a record that has been flushed.
    pub fn put(&mut self, at: u64, record: &R) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(at * Self::BYTES))?;
        self.file.write_all(bytemuck::bytes_of(record))
    }

    /// Reads the records from `first` on.
    pub fn read(&self, first: u64, into: &mut [R]) -> io::Result<()> {
        let mut file = &self.file;
        file.seek(SeekFrom::Start(first * Self::BYTES))?;
        file.read_exact(bytemuck::cast_slice_mut(into))
    }

    /// Reads a whole range into memory.
    pub fn load(&self, range: Range<u64>) -> io::Result<Vec<R>> {
        let mut records = vec![R::zeroed(); (range.end - range.start) as usize];
        self.read(range.start, &mut records)?;
        Ok(records)
    }

    /// Iterates over a range, with this many bytes in memory at a time.
    pub fn walk(&self, range: Range<u64>, bytes: usize) -> Walk<'_, R> {
        let count = (bytes / size_of::<R>()).max(1);
        Walk { file: self, range, block: Vec::new(), at: 0, count }
    }

    /// Iterates over all records, a block at a time.
    pub fn each_block(&self, mut take: impl FnMut(&[R]) -> io::Result<()>) -> io::Result<()> {
        let count = (BLOCK_BYTES / size_of::<R>()).max(1) as u64;
        let mut block = vec![R::zeroed(); count.min(self.written) as usize];
        let mut first = 0;
        while first < self.written {
            let part = &mut block[..count.min(self.written - first) as usize];
            self.read(first, part)?;
            take(part)?;
            first += part.len() as u64;
        }
        Ok(())
    }
}

impl<R> Drop for SpillFile<R> {
    fn drop(&mut self) {
        let bytes = self.written * size_of::<R>() as u64;
        self.room.used.fetch_sub(bytes, Ordering::Relaxed);
    }
}

/// Iterator over the records of a file.
pub struct Walk<'a, R> {
    file: &'a SpillFile<R>,
    range: Range<u64>,
    block: Vec<R>,
    at: usize,
    count: usize,
}

impl<R: Pod> Walk<'_, R> {
    pub fn next(&mut self) -> io::Result<Option<R>> {
        if self.at == self.block.len() {
            let count = (self.range.end - self.range.start).min(self.count as u64);
            if count == 0 {
                return Ok(None);
            }
            self.block.resize(count as usize, R::zeroed());
            self.file.read(self.range.start, &mut self.block)?;
            self.range.start += count;
            self.at = 0;
        }
        self.at += 1;
        Ok(self.block.get(self.at - 1).copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_and_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let spill = Spill::new(folder.path(), 1 << 20);
        let mut file = spill.file::<u64>().unwrap();
        for i in 0..50_000 {
            file.push(i).unwrap();
        }
        assert_eq!(file.count(), 50_000);
        file.flush().unwrap();
        file.put(7, &99).unwrap();
        assert_eq!(file.load(5..9).unwrap(), [5, 6, 99, 8]);
        let (mut walk, mut found) = (file.walk(10..49_990, 1000), Vec::new());
        while let Some(record) = walk.next().unwrap() {
            found.push(record);
        }
        assert!(found.into_iter().eq(10..49_990));
        let mut sum = 0;
        file.each_block(|block| {
            sum += block.iter().sum::<u64>();
            Ok(())
        })
        .unwrap();
        assert_eq!(sum, (0..50_000).sum::<u64>() + 92);
        // The file has no name or is hidden, so no other process finds it.
        #[cfg(unix)]
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert_eq!(spill.most_bytes(), 400_000);
        let mut other = spill.file::<u64>().unwrap();
        let error = other.extend(&vec![0; 100_000]).unwrap_err().to_string();
        assert!(error.contains("1 MiB"), "{error}");
        drop((file, other));
        spill.file::<u64>().unwrap().extend(&vec![0; 100_000]).unwrap();
    }
}
