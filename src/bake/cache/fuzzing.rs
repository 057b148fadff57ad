//! Fuzz target of entries.

use std::io::Cursor;

use sha2::{Digest, Sha256};

use super::entry::{self, Entry};
use super::record::{HEADER_WORDS, TRAILER_BYTES};
use crate::bake::pack::PackedGeometry;
use crate::fuzzing::Run;

pub const TARGETS: &[(&str, Run)] = &[("bake-cache", read)];

const KEY: [u8; 32] = [0xa5; 32];

/// Reads an entry whose key, length and checksum are forged, so that all other checks see any bytes.
fn read(data: &[u8]) {
    let mut bytes = data.to_vec();
    if bytes.len() < 4 * HEADER_WORDS {
        return;
    }
    let length = bytes.len() as u64 + TRAILER_BYTES;
    bytes[16..48].copy_from_slice(&KEY);
    bytes[48..56].copy_from_slice(&length.to_le_bytes());
    bytes.extend(Sha256::digest(&bytes));
    let source = || Cursor::new(&bytes);
    let figures = entry::figures(&mut source(), length, &KEY);
    if let Ok(geometries) = entry::read(&mut source(), length, &KEY) {
        let mut again = Vec::new();
        let entry = Entry::of(&geometries);
        let written = entry.map(|entry| entry.write(&mut again, &KEY));
        assert!(matches!(written, Ok(Ok(()))), "what was read cannot be written");
        assert_eq!(again, bytes, "what was read is written otherwise");
        let is_tree = matches!(&geometries[..], [PackedGeometry::Samples(_)]);
        assert_eq!(figures.is_ok(), is_tree, "figures are those of one tree");
    }
}
