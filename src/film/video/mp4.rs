//! Reads the tables of an MP4 file (ISO/IEC 14496-12), as far as needed to check that it has all frames.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Boxes that contain boxes, on the way to the tables.
const CONTAINERS: [&[u8; 4]; 5] = [b"moov", b"trak", b"mdia", b"minf", b"stbl"];
/// Longest table that is read.
const MOST_TABLE_BYTES: u64 = 64 << 20;

/// Summary of the tables of a file with one video track.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Number of samples. Each sample is a frame.
    pub frames: u64,
    /// Units of time per second of the track.
    pub timescale: u32,
    /// Duration of the track in those units.
    pub duration: u64,
    /// Duration of all samples by their time table, in those units, and the number of samples in it.
    pub timed: (u64, u64),
    /// Size of the track in pixels.
    pub width: u32,
    pub height: u32,
    /// Sizes of the samples in bytes, in order.
    pub sizes: Vec<u32>,
    /// Position of the first sample in the file.
    pub first_at: u64,
}

impl Summary {
    /// Reads a file's tables; `None` if they are missing or contradict each other.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> io::Result<Option<Summary>> {
        let mut file = File::open(path)?;
        let end = file.metadata()?.len();
        let mut summary = Summary::default();
        let whole = walk(&mut file, 0, end, &mut summary)?;
        let fits = summary.timescale > 0 && summary.sizes.len() as u64 == summary.frames;
        Ok((whole && fits && summary.timed.1 == summary.frames).then_some(summary))
    }

    pub fn duration_s(&self) -> f64 {
        self.duration as f64 / f64::from(self.timescale)
    }
}

/// Walks the boxes between two positions. Returns false if the boxes do not fill the range.
fn walk(file: &mut File, mut at: u64, end: u64, summary: &mut Summary) -> io::Result<bool> {
    while at < end {
        if end - at < 8 {
            return Ok(false);
        }
        file.seek(SeekFrom::Start(at))?;
        let head: [u8; 8] = read(file)?;
        let name = [head[4], head[5], head[6], head[7]];
        let (body, size) = match u32_at(&head, 0) {
            1 if end - at >= 16 => (at + 16, u64::from_be_bytes(read(file)?)),
            0 => (at + 8, end - at),
            size => (at + 8, u64::from(size)),
        };
        let Some(next) = at.checked_add(size).filter(|&next| next <= end && next >= body) else {
            return Ok(false);
        };
        if CONTAINERS.contains(&&name) {
            if !walk(file, body, next, summary)? {
                return Ok(false);
            }
        } else if matches!(&name, b"mdhd" | b"tkhd" | b"stsz" | b"stts" | b"stco" | b"co64") {
            if next - body > MOST_TABLE_BYTES {
                return Ok(false);
            }
            let mut table = vec![0; (next - body) as usize];
            file.seek(SeekFrom::Start(body))?;
            file.read_exact(&mut table)?;
            if note(&name, &table, summary).is_none() {
                return Ok(false);
            }
        }
        at = next;
    }
    Ok(true)
}

fn read<const N: usize>(file: &mut File) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// A big-endian number; 0 if the bytes are too short.
fn u32_at(bytes: &[u8], at: usize) -> u32 {
    get(bytes, at).unwrap_or(0)
}

fn get(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_be_bytes(four.try_into().ok()?))
}

fn get_u64(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from(get(bytes, at)?) << 32 | u64::from(get(bytes, at + 4)?))
}

/// Reads a table; `None` if it is cut off.
fn note(name: &[u8; 4], table: &[u8], summary: &mut Summary) -> Option<()> {
    let is_long = *table.first()? == 1;
    match name {
        b"mdhd" if is_long => {
            (summary.timescale, summary.duration) = (get(table, 20)?, get_u64(table, 24)?)
        }
        b"mdhd" => {
            (summary.timescale, summary.duration) = (get(table, 12)?, u64::from(get(table, 16)?))
        }
        b"tkhd" => {
            let sides = table.len().checked_sub(8)?;
            (summary.width, summary.height) =
                (get(table, sides)? >> 16, get(table, sides + 4)? >> 16);
        }
        b"stsz" => {
            let (each, count) = (get(table, 4)?, get(table, 8)?);
            summary.frames = u64::from(count);
            if each != 0 && count as usize > table.len() {
                // All samples have the same size. This is not expected of a video.
                return None;
            }
            let sizes = (0..count as usize)
                .map(|i| if each == 0 { get(table, 12 + 4 * i) } else { Some(each) });
            summary.sizes = sizes.collect::<Option<_>>()?;
        }
        b"stts" => {
            for entry in 0..get(table, 4)? as usize {
                let (count, delta) =
                    (u64::from(get(table, 8 + 8 * entry)?), u64::from(get(table, 12 + 8 * entry)?));
                summary.timed.0 = summary.timed.0.checked_add(count.checked_mul(delta)?)?;
                summary.timed.1 = summary.timed.1.checked_add(count)?;
            }
        }
        b"co64" => summary.first_at = get_u64(table, 8)?,
        _ => summary.first_at = u64::from(get(table, 8)?),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn boxed(name: &[u8; 4], body: &[u8]) -> Vec<u8> {
        [&(body.len() as u32 + 8).to_be_bytes(), &name[..], body].concat()
    }

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_be_bytes()).collect()
    }

    /// A file of three samples of 10, 20 and 30 bytes, a third of a second each.
    fn file() -> Vec<u8> {
        let stbl = [
            boxed(b"stsz", &words(&[0, 0, 3, 10, 20, 30])),
            boxed(b"stts", &words(&[0, 2, 1, 30_000, 2, 30_000])),
            boxed(b"stco", &words(&[0, 1, 8])),
        ]
        .concat();
        let mdia = [
            boxed(b"mdhd", &words(&[0, 0, 0, 90_000, 90_000, 0])),
            boxed(b"minf", &boxed(b"stbl", &stbl)),
        ]
        .concat();
        let tkhd = [words(&[0; 19]), words(&[64 << 16, 48 << 16])].concat();
        let trak = [boxed(b"tkhd", &tkhd), boxed(b"mdia", &mdia)].concat();
        [boxed(b"mdat", &[7; 60]), boxed(b"moov", &boxed(b"trak", &trak))].concat()
    }

    fn summary(bytes: &[u8]) -> Option<Summary> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        // A cut within a box's head is a read error, which counts as no summary here.
        Summary::read(file.path()).ok().flatten()
    }

    #[test]
    fn tables_are_read() {
        let found = summary(&file()).unwrap();
        assert_eq!((found.frames, found.timed, found.first_at), (3, (90_000, 3), 8));
        assert_eq!(
            (found.width, found.height, found.sizes.as_slice()),
            (64, 48, &[10, 20, 30][..])
        );
        assert_eq!(found.duration_s(), 1.0);
        assert!(summary(b"").is_none() && summary(b"hello, world").is_none());
    }

    proptest! {
        #[test]
        fn damage_never_panics(at in 0usize..400, byte in any::<u8>(), length in 0usize..400) {
            let mut bytes = file();
            let at = at % bytes.len();
            bytes[at] = byte;
            bytes.truncate(length.max(1));
            let _ = summary(&bytes);
        }
    }
}
