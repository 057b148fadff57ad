//! The ZIP archive of a TRX file, read through the `zip` crate.
//!
//! The crate makes room for as many entries as the end of an archive declares, up to a 46th of what lies before. The directory's
//! size is therefore measured and bounded first ([`directory_bytes`]). An entry is believed as far as its compressed bytes can hold
//! what it declares, and is read in blocks; the crate ends with an error where more bytes come than are declared, or where their
//! checksum (CRC-32) is wrong.

use std::io::{Error, ErrorKind, Read, Seek, SeekFrom};

use zip::read::{ArchiveOffset, Config};
use zip::{CompressionMethod, ZipArchive};

use super::super::input::DEFLATE_RATIO;
use super::super::{AssetError, ReadOptions};

/// Bytes that are decoded at a time: a whole number of rows of one or three numbers of any type.
pub(super) const BLOCK_BYTES: usize = 48 << 12;
/// The end of an archive lies in so many last bytes: a record with a comment of up to 64 KiB.
const TAIL_BYTES: u64 = 66 << 10;
/// Larger directories are refused; one of 100,000 groups has 10 MB.
const MAX_DIRECTORY_BYTES: u64 = 16 << 20;
/// Bytes of memory for a byte of the directory: an entry has 46 and its name, and takes about 400 and its name.
const DIRECTORY_RATIO: u64 = 16;
/// Characters of an entry's name that errors show.
const SHOWN_CHARACTERS: usize = 80;

/// An archive, of which entries are read one after the other.
pub(super) struct Archive<'a, R> {
    zip: ZipArchive<R>,
    file: &'a str,
    options: &'a ReadOptions,
    /// Bytes of the entries that are to be read, and of what was read.
    total: u64,
    done: u64,
}

/// An entry, as the directory declares it.
#[derive(Debug)]
pub(super) struct Entry {
    index: usize,
    pub path: String,
    /// The path as errors show it.
    pub place: String,
    /// Bytes after decompression.
    pub bytes: u64,
    pub is_stored: bool,
}

impl<'a, R: Read + Seek> Archive<'a, R> {
    /// Reads the directory.
    ///
    /// # Errors
    /// The file is no ZIP archive, or its directory is damaged, too large, or has two entries of a name.
    pub fn open(
        mut reader: R,
        file: &'a str,
        options: &'a ReadOptions,
    ) -> Result<Self, AssetError> {
        let fail = |reason: String| AssetError::malformed(file, "ZIP directory", reason);
        let bytes = directory_bytes(&mut reader).map_err(|source| AssetError::io(file, source))?;
        if bytes > MAX_DIRECTORY_BYTES {
            let reason = format!("has {bytes} bytes; up to {MAX_DIRECTORY_BYTES} are read");
            return Err(fail(reason));
        }
        options.admission.grow(file, DIRECTORY_RATIO * bytes)?;
        let config = Config { archive_offset: ArchiveOffset::Known(0) };
        let zip = ZipArchive::with_config(config, reader)
            .map_err(|error| damaged(file, "ZIP directory", error))?;
        if zip.has_duplicate_names() {
            return Err(fail("two entries have the same name; names must differ".to_owned()));
        }
        Ok(Self { zip, file, options, total: 0, done: 0 })
    }

    /// The entries that are files.
    ///
    /// # Errors
    /// An entry is encrypted, compressed by another method than deflate, or declares more than it can hold.
    pub fn entries(&mut self) -> Result<Vec<Entry>, AssetError> {
        let file = self.file;
        let mut entries = Vec::new();
        for index in 0..self.zip.len() {
            let entry = self.zip.by_index_data(index);
            let entry = entry.map_err(|error| damaged(file, "ZIP directory", error))?;
            let path = entry.name().map_err(|error| damaged(file, "ZIP directory", error))?;
            if entry.is_dir() {
                continue;
            }
            let place: String =
                path.chars().take(SHOWN_CHARACTERS).flat_map(char::escape_debug).collect();
            let fail = |reason: String| Err(AssetError::malformed(file, &*place, reason));
            if entry.encrypted() {
                return fail("is encrypted; entries without a password are accepted".to_owned());
            }
            let (bytes, packed) = (entry.size(), entry.compressed_size());
            let most = match entry.compression() {
                CompressionMethod::Stored => packed,
                CompressionMethod::Deflated => packed.saturating_mul(DEFLATE_RATIO),
                method => {
                    let reason =
                        format!("has compression {method}; accepted are stored and deflated");
                    return fail(reason);
                }
            };
            if bytes > most {
                let reason = format!("declares {bytes} bytes, but its data hold at most {most}");
                return fail(reason);
            }
            let is_stored = entry.compression() == CompressionMethod::Stored;
            let path = path.into_owned();
            entries.push(Entry { index, path, place, bytes, is_stored });
        }
        Ok(entries)
    }

    /// Says which entries will be read.
    ///
    /// # Errors
    /// The compressed ones among them have more bytes than the options allow, or the stored ones more than the file has.
    pub fn expect<'e>(
        &mut self,
        entries: impl Iterator<Item = &'e Entry>,
    ) -> Result<(), AssetError> {
        let mut unpacked = 0u64;
        for entry in entries {
            self.total = self.total.saturating_add(entry.bytes);
            if !entry.is_stored {
                unpacked = unpacked.saturating_add(entry.bytes);
            } else if entry.bytes > self.zip.central_directory_start() {
                let reason = format!("declares {} bytes, more than the file has", entry.bytes);
                return Err(AssetError::malformed(self.file, &*entry.place, reason));
            }
        }
        let limit = self.options.max_decompressed_bytes;
        AssetError::check_limit(self.file, "decompressed bytes", unpacked, limit)
    }

    /// Hands out the bytes of an entry in blocks of [`BLOCK_BYTES`]; the last one may be shorter.
    ///
    /// # Errors
    /// The entry is damaged, the load was cancelled, or an error of `each`.
    pub fn blocks(
        &mut self,
        entry: &Entry,
        mut each: impl FnMut(&[u8]) -> Result<(), AssetError>,
    ) -> Result<(), AssetError> {
        let Self { zip, file, options, total, done } = self;
        let mut reader =
            zip.by_index(entry.index).map_err(|error| damaged(file, &entry.place, error))?;
        let mut block = Vec::with_capacity(BLOCK_BYTES);
        let mut got = 0;
        loop {
            options.admission.check()?;
            block.clear();
            let read = (&mut reader).take(BLOCK_BYTES as u64).read_to_end(&mut block);
            read.map_err(|error| damaged(file, &entry.place, error))?;
            // Only a read at the end checks the checksum.
            if block.is_empty() {
                break;
            }
            got += block.len() as u64;
            each(&block)?;
            options.progress.report(((*done + got) as f64 / *total as f64).min(1.0) as f32);
        }
        *done += got;
        if got == entry.bytes {
            return Ok(());
        }
        let reason = format!("ends after {got} of {} bytes", entry.bytes);
        Err(AssetError::malformed(file, &*entry.place, reason))
    }

    /// All bytes of an entry. Memory is reserved at once for an entry that is stored, otherwise as its bytes come.
    ///
    /// # Errors
    /// As [`Archive::blocks`], and there is no memory for them.
    pub fn read(&mut self, entry: &Entry) -> Result<Vec<u8>, AssetError> {
        let mut bytes = Vec::new();
        let mut meter = self.options.admission.meter(self.file);
        if entry.is_stored {
            meter.reach_exactly(entry.bytes)?;
            bytes.reserve_exact(usize::try_from(entry.bytes).unwrap_or(0));
        }
        self.blocks(entry, |block| {
            meter.reach((bytes.len() + block.len()) as u64)?;
            bytes.extend_from_slice(block);
            Ok(())
        })?;
        Ok(bytes)
    }
}

/// An error of the `zip` crate at `place`. What is wrong with the disk stays that.
fn damaged(file: &str, place: &str, error: impl Into<Error>) -> AssetError {
    use ErrorKind::{InvalidData, InvalidInput, NotFound, UnexpectedEof, Unsupported};
    let error = error.into();
    match error.kind() {
        InvalidData | InvalidInput | NotFound | UnexpectedEof | Unsupported => {
            AssetError::malformed(file, place, format!("is damaged or truncated: {error}"))
        }
        _ => AssetError::io(file, error),
    }
}

/// Bytes from the beginning of the directory to the end of the archive. Where several places could be either, it is the longest
/// such distance: the crate may choose any of them.
fn directory_bytes(reader: &mut (impl Read + Seek)) -> std::io::Result<u64> {
    let length = reader.seek(SeekFrom::End(0))?;
    let before = length.saturating_sub(TAIL_BYTES);
    let tail = bytes_at(reader, before, TAIL_BYTES)?;
    let mut longest = 0;
    for at in 0..tail.len() {
        if !tail[at..].starts_with(b"PK\x05\x06") {
            continue;
        }
        let end = before + at as u64;
        let mut starts = vec![whole(tail.get(at + 16..at + 20).unwrap_or_default())];
        // Before the end of a large archive (ZIP64) lies the place of another record.
        let locator = bytes_at(reader, end.saturating_sub(20), 20)?;
        if locator.starts_with(b"PK\x06\x07")
            && let Some(place) = locator.get(8..16)
        {
            let record = bytes_at(reader, whole(place), 56)?;
            starts.extend(record.get(48..56).map(whole));
        }
        for start in starts {
            if start < end && bytes_at(reader, start, 4)? == b"PK\x01\x02" {
                longest = longest.max(end - start);
            }
        }
    }
    Ok(longest)
}

fn bytes_at(reader: &mut (impl Read + Seek), at: u64, count: u64) -> std::io::Result<Vec<u8>> {
    // Systems refuse places above this.
    reader.seek(SeekFrom::Start(at.min(i64::MAX as u64)))?;
    let mut bytes = Vec::new();
    reader.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The unsigned number in these bytes, up to eight, the lowest first.
pub(super) fn whole(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
}
