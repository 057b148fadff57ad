//! Fuzz targets of entries, and of what is packed of a file.

use std::io::Cursor;

use sha2::{Digest, Sha256};

use super::entry::{self, Entry};
use super::record::{HEADER_WORDS, TRAILER_BYTES};
use crate::assets::Geometry;
use crate::bake::pack::{PackedGeometry, pack_lines, pack_mesh, pack_samples};
use crate::bake::tree::build_tree;
use crate::fuzzing::{Run, any_asset};

pub const TARGETS: &[(&str, Run)] = &[("bake-cache", read), ("packed", pack)];

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

/// Packs what a file of any format holds, and makes point trees of its points. What is packed can be kept and drawn.
fn pack(data: &[u8]) {
    each_packed(data, |packed| {
        let refusal = Entry::of(&[packed]).err();
        assert!(refusal.is_none(), "what is packed cannot be kept: {refusal:?}");
    });
}

/// Calls `use_packed` with what is packed of a file of any format, and with the point trees of its points.
fn each_packed(data: &[u8], mut use_packed: impl FnMut(PackedGeometry)) {
    let Some(asset) = any_asset(data) else { return };
    for geometry in &asset.geometries {
        let packed = match geometry {
            Geometry::Points(cloud) => {
                if let Ok(tree) = build_tree(cloud, None) {
                    use_packed(PackedGeometry::Samples(tree));
                }
                pack_samples(cloud).map(PackedGeometry::Samples)
            }
            Geometry::Mesh(mesh) => {
                pack_mesh(mesh, &asset.materials).map(PackedGeometry::Triangles)
            }
            Geometry::Lines(lines) => pack_lines(lines).map(PackedGeometry::Lines),
        };
        if let Ok(packed) = packed {
            use_packed(packed);
        }
    }
}

/// Returns entries, as [`read`] takes them, of what is packed of files.
#[cfg(test)]
pub fn entries<'a>(files: impl Iterator<Item = &'a [u8]>) -> Vec<Vec<u8>> {
    let mut entries = Vec::new();
    for data in files {
        each_packed(data, |packed| {
            let mut bytes = Vec::new();
            Entry::of(&[packed]).unwrap().write(&mut bytes, &KEY).unwrap();
            bytes.truncate(bytes.len() - TRAILER_BYTES as usize);
            entries.push(bytes);
        });
    }
    entries
}
