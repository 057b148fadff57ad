//! Bytes of entries, whole, damaged and forged.

use std::io::Cursor;

use proptest::prelude::*;
use sha2::{Digest, Sha256};

use super::super::record::{CHUNK_WORDS, HEADER_WORDS, RECORD_WORDS};
use super::*;
use crate::bake::pack::{PackedMesh, PackedSamples};

const TRAILER: usize = 32;

fn read_bytes(bytes: &[u8]) -> Result<Vec<PackedGeometry>, Refusal> {
    entry::read(&mut Cursor::new(bytes), bytes.len() as u64, &KEY)
}

/// The length and the checksum as they should be.
pub(super) fn sealed(mut body: Vec<u8>) -> Vec<u8> {
    let bytes = (body.len() + TRAILER) as u64;
    body[48..56].copy_from_slice(&bytes.to_le_bytes());
    let hash = Sha256::digest(&body);
    body.extend(hash);
    body
}

pub(super) fn body(geometries: &[PackedGeometry]) -> Vec<u8> {
    let mut bytes = bytes_of(geometries);
    bytes.truncate(bytes.len() - TRAILER);
    bytes
}

pub(super) fn set_word(body: &mut [u8], word: usize, value: u32) {
    body[4 * word..4 * word + 4].copy_from_slice(&value.to_le_bytes());
}

#[test]
fn bytes_are_little_endian_words_in_the_order_that_the_module_says() {
    let all = small();
    let PackedGeometry::Samples(tree) = &all[0] else { panic!("samples") };
    let bytes = bytes_of(&all);
    assert_eq!(bytes[..12], *b"PTLSBAKE\x07\0\0\0");
    assert_eq!(bytes[12..16], [3, 0, 0, 0]);
    assert_eq!(bytes[16..48], KEY);
    assert_eq!(bytes[48..56], (bytes.len() as u64).to_le_bytes());
    assert_eq!(bytes[60..68], tree.grid.origin.x.to_le_bytes());
    let chunks = 4 * (HEADER_WORDS + 3 * RECORD_WORDS);
    assert_eq!(bytes[chunks..chunks + 4], tree.chunks[0].origin.x.to_le_bytes());
    let positions = chunks + 4 * CHUNK_WORDS * tree.chunks.len();
    assert_eq!(bytes[positions + 4..positions + 8], tree.positions[0][1].to_le_bytes());
}

#[test]
fn every_flipped_bit_is_refused() {
    let mut bytes = bytes_of(&small());
    assert!(read_bytes(&bytes).is_ok());
    for at in 0..bytes.len() {
        for flip in (0..8).map(|bit| 1 << bit).chain([0xff]) {
            bytes[at] ^= flip;
            let refusal = read_bytes(&bytes).unwrap_err();
            assert!(!matches!(refusal, Refusal::Io(_)), "byte {at}: {refusal}");
            bytes[at] ^= flip;
        }
    }
}

#[test]
fn every_other_length_is_refused() {
    let mut bytes = bytes_of(&small());
    for length in 0..bytes.len() {
        let refusal = read_bytes(&bytes[..length]).unwrap_err();
        assert!(matches!(refusal, Refusal::Length { .. }), "{length} bytes: {refusal}");
        // The file becomes shorter while it is read.
        let cut = entry::read(&mut Cursor::new(&bytes[..length]), bytes.len() as u64, &KEY);
        assert!(matches!(cut.unwrap_err(), Refusal::Length { .. }), "{length} bytes");
    }
    for more in 1..100 {
        bytes.push(0);
        assert!(matches!(read_bytes(&bytes).unwrap_err(), Refusal::Length { .. }), "{more} more");
    }
}

#[test]
fn versions_and_keys_are_told_before_the_checksum() {
    let mut bytes = bytes_of(&small());
    let other = FORMAT_VERSION + 1;
    set_word(&mut bytes, 2, other);
    assert!(
        matches!(read_bytes(&bytes).unwrap_err(), Refusal::Version { found } if found == other)
    );
    set_word(&mut bytes, 2, FORMAT_VERSION);
    set_word(&mut bytes, 4, 0);
    assert!(matches!(read_bytes(&bytes).unwrap_err(), Refusal::Key));
}

/// Words of a table's record: kind, grid 9, chunks, lengths.
#[test]
fn a_table_with_a_right_checksum_is_refused_before_anything_is_allocated_for_it() {
    let body = body(&small());
    let record = HEADER_WORDS;
    let cases = [
        // Geometries, with room for none of them, or for some.
        (3, u32::MAX),
        (3, 4),
        (3, 2),
        (record, 2),
        (record, 1),
        (record + 10, u32::MAX),
        (record + 11, u32::MAX),
        (record + 15, 1 << 31),
        // A mesh has no third array, samples have no sixth.
        (record + 16, 1),
        (record + 2 * RECORD_WORDS + 13, 1),
    ];
    for (word, value) in cases {
        let mut body = body.clone();
        set_word(&mut body, word, value);
        let refusal = read_bytes(&sealed(body)).unwrap_err();
        assert!(matches!(refusal, Refusal::Table), "{word} = {value}: {refusal}");
    }
}

/// Refusal of a small tree, samples or mesh with one change.
fn refused(change: impl Fn(&mut Vec<PackedGeometry>)) -> &'static str {
    let mut all = small();
    change(&mut all);
    let folder = tempfile::tempdir().unwrap();
    let error = BakeCache::new(folder.path(), u64::MAX).store(&KEY, &all).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    assert!(names(folder.path()).is_empty());
    match Entry::of(&all).err().unwrap() {
        Refusal::Invalid { what, .. } => what,
        other => panic!("{other}"),
    }
}

fn refused_samples(change: impl Fn(&mut PackedSamples)) -> &'static str {
    refused(|all| match &mut all[0] {
        PackedGeometry::Samples(samples) => change(samples),
        _ => panic!("samples"),
    })
}

#[test]
fn geometries_that_shaders_would_go_astray_in_are_refused() {
    let grid = |change: fn(&mut PackedSamples)| refused_samples(change);
    assert!(grid(|s| s.grid.origin.y = f64::NAN).contains("origin"));
    assert!(grid(|s| s.grid.step = f64::INFINITY).contains("step"));
    assert!(grid(|s| s.grid.step = 0.0).contains("step"));
    assert!(grid(|s| s.grid.reach = -1).contains("reaches"));
    let samples = grid;
    assert!(samples(|s| s.attributes.truncate(2)).contains("attributes"));
    assert!(samples(|s| s.kernels.push(0)).contains("kernels"));
    assert!(samples(|s| s.nodes.truncate(1)).contains("nodes"));
    assert!(samples(|s| s.clips.push([0; 2])).contains("no chunk begins"));
    let more = |s: &mut PackedSamples| s.clips.resize(s.positions.len() + 1, [0; 2]);
    assert!(samples(more).contains("more clip lines"));
    assert!(samples(|s| s.chunks[0].shift = 32).contains("steps"));
    assert!(samples(|s| s.chunks[0].count = 0).contains("count"));
    assert!(samples(|s| s.chunks[0].count = 1025).contains("count"));
    assert!(samples(|s| s.chunks[0].count += 1).contains("not behind"));
    assert!(samples(|s| s.chunks[0].first = 1).contains("not behind"));
    assert!(samples(|s| s.chunks.last_mut().unwrap().count += 1).contains("ends behind"));
    assert!(samples(|s| s.chunks.truncate(1)).contains("do not hold"));
    assert!(samples(|s| s.chunks[0].extent.x = -1).contains("box"));
    let far = samples(|s| {
        s.chunks[0].origin.z = 1;
        s.chunks[0].extent.z = i32::MAX;
    });
    assert!(far.contains("box"));
    assert!(samples(|s| s.chunks[0].range.base = f32::NAN).contains("lengths"));
    assert!(samples(|s| s.chunks[0].kernel_base = -1.0).contains("lengths"));
    let mesh = |change: fn(&mut PackedMesh)| {
        refused(|all| match &mut all[2] {
            PackedGeometry::Triangles(mesh) => change(mesh),
            _ => panic!("a mesh"),
        })
    };
    assert!(mesh(|m| m.chunks[0].vertex_count = 1025).contains("too many"));
    assert!(mesh(|m| m.chunks[0].vertex_first = 1).contains("not the next"));
    assert!(mesh(|m| m.vertices.truncate(3)).contains("all vertices"));
    assert!(mesh(|m| m.triangles[1] = 4 << 10).contains("not in its chunk"));
    assert!(mesh(|m| m.triangles[1] |= 1 << 30).contains("not in its chunk"));
    assert!(mesh(|m| m.triangles.truncate(1)).contains("ends behind"));
}

/// Goes where passes and shaders go; panics where that leads to nothing.
fn walk(geometry: &PackedGeometry) -> u64 {
    let mut sum = 0;
    for chunk in geometry.chunks() {
        for at in chunk.first..chunk.first + chunk.count {
            let at = at as usize;
            sum += match geometry {
                PackedGeometry::Samples(samples) => {
                    let clipped = at.checked_sub(samples.clipped_first() as usize);
                    let clip = clipped.map_or([0; 2], |clip| samples.clips[clip]);
                    let node = samples.nodes.get(at).copied().unwrap_or_default();
                    let of = samples.positions[at][0] ^ samples.attributes[at][0] ^ clip[0];
                    u64::from(of ^ samples.kernels[at] ^ node[0]) + (1 << chunk.shift)
                }
                PackedGeometry::Triangles(mesh) => {
                    let run = &mesh.vertices[chunk.vertex_first as usize..]
                        [..chunk.vertex_count as usize];
                    let word = mesh.triangles[at];
                    let vertex = |place: u32| run[(word >> (10 * place) & 1023) as usize][0];
                    u64::from(vertex(0) ^ vertex(1) ^ vertex(2))
                }
                PackedGeometry::Lines(lines) => {
                    let ends = lines.ends(chunk, at).expect("both ends");
                    let (strand, _) = lines.strand_of(at).expect("a strand");
                    u64::from(ends[0].color ^ ends[1].color ^ strand)
                }
            };
        }
    }
    sum
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Whatever is in the body, it is refused or can be drawn.
    #[test]
    fn forged_bodies_are_refused_or_sound(
        changes in prop::collection::vec(
            (any::<prop::sample::Index>(), prop_oneof![
                Just(0u32), Just(1), Just(2), Just(u32::MAX), Just(1 << 31), Just(0x7fc0_0000), any::<u32>(), 0u32..2000,
            ]),
            0..4,
        ),
        near_table in any::<bool>(),
        length in prop_oneof![4 => Just(None), 1 => any::<prop::sample::Index>().prop_map(Some)],
        more in prop::collection::vec(any::<u8>(), 0..40),
    ) {
        let mut body = body(&small());
        let words = if near_table { 120 } else { body.len() / 4 };
        for (at, value) in changes {
            // Behind the key, or the number of geometries.
            let word = at.index(words - 13);
            set_word(&mut body, if word == 0 { 3 } else { 13 + word }, value);
        }
        if let Some(length) = length {
            body.truncate(56.max(length.index(body.len())));
            body.extend(more);
        }
        match read_bytes(&sealed(body)) {
            Ok(geometries) => {
                geometries.iter().map(walk).fold(0, u64::wrapping_add);
            }
            Err(refusal) => prop_assert!(
                matches!(refusal, Refusal::Table | Refusal::Invalid { .. }),
                "{}", refusal
            ),
        }
    }

    /// Whatever the bytes.
    #[test]
    fn noise_is_refused(bytes in prop::collection::vec(any::<u8>(), 0..300), magic in any::<bool>()) {
        let mut bytes = bytes;
        if magic && bytes.len() >= 56 {
            bytes[..48].copy_from_slice(&bytes_of(&[])[..48]);
        }
        prop_assert!(read_bytes(&bytes).is_err());
        if bytes.len() >= 56 {
            // A header of no geometries and nothing behind it is all that a checksum makes whole.
            let is_empty_entry = magic && bytes.len() == 56;
            prop_assert_eq!(read_bytes(&sealed(bytes)).is_ok(), is_empty_entry);
        }
    }
}
