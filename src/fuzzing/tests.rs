//! Every target over its corpus, and over mutations of it that are the same in each run.

use std::fs;
use std::path::{Path, PathBuf};

use super::*;
use crate::scene::random::SplitMix64;

/// Largest file of the corpus, in bytes.
const MOST_FILE_BYTES: u64 = 4 << 10;
/// Largest size of all files of the corpus together.
const MOST_BYTES: u64 = 600 << 10;
/// Mutations that each target reads.
const MUTATIONS: usize = 400;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus")
}

/// The inputs of a target, by their names.
fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = folder().join(target);
    let entries = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{folder:?}: {error}"));
    let read = |entry: std::io::Result<fs::DirEntry>| {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        (name, fs::read(path).unwrap())
    };
    let mut files: Vec<(String, Vec<u8>)> = entries.map(read).collect();
    files.sort();
    files
}

/// Changes an input in a few places.
fn mutated(random: &mut SplitMix64, files: &[(String, Vec<u8>)]) -> Vec<u8> {
    const BYTES: [u8; 12] = *b"\0\x01\x7f\x80\xff 09-.\n\"";
    const WORDS: [&str; 10] = [
        "-1",
        "0",
        "4294967296",
        "18446744073709551615",
        "1e999",
        "NaN",
        "inf",
        "-0.0",
        "{}",
        "[]",
    ];
    let mut below = |count: usize| (random.next_u64() % count.max(1) as u64) as usize;
    let mut bytes = files[below(files.len())].1.clone();
    for _ in 0..=below(4) {
        let at = below(bytes.len());
        let end = (at + 1 + below(16)).min(bytes.len());
        match below(8) {
            _ if bytes.is_empty() => bytes.push(BYTES[below(BYTES.len())]),
            0 => bytes[at] ^= 1 << below(8),
            1 => bytes[at] = BYTES[below(BYTES.len())],
            2 => bytes.insert(at, BYTES[below(BYTES.len())]),
            3 => drop(bytes.drain(at..end)),
            4 => bytes.truncate(at),
            5 => {
                let part = bytes[at..end].to_vec();
                let to = below(bytes.len());
                bytes.splice(to..to, part);
            }
            6 => drop(bytes.splice(at..end, WORDS[below(WORDS.len())].bytes())),
            _ => {
                let other = &files[below(files.len())].1;
                let from = below(other.len());
                bytes.splice(at.., other[from..].iter().copied());
            }
        }
    }
    bytes.truncate(4 * MOST_FILE_BYTES as usize);
    bytes
}

/// Runs a target, and says which input it fails on.
fn run(target: &Target, what: &str, data: &[u8]) {
    let run = std::panic::AssertUnwindSafe(|| target.run(data));
    if let Err(panic) = std::panic::catch_unwind(run) {
        let file = std::env::temp_dir().join(format!("pointillist-fuzz-{}", target.name));
        let kept = fs::write(&file, data).map(|()| file);
        eprintln!("target {}, {what}; the input: {kept:?}", target.name);
        std::panic::resume_unwind(panic);
    }
}

/// Entries of the cache change with its version, so they are made of files: `UPDATE=1` writes them anew.
#[test]
fn the_corpus_has_entries_of_the_cache() {
    let folder = folder().join("bake-cache");
    if std::env::var_os("UPDATE").is_some() {
        let files: Vec<Vec<u8>> = ["ply", "xyz", "stl", "swc", "obj"]
            .into_iter()
            .flat_map(|target| corpus(target).into_iter().map(|(_, data)| data))
            .collect();
        let mut entries = crate::bake::cache::fuzz_entries(files.iter().map(Vec::as_slice));
        entries.retain(|entry| entry.len() as u64 <= MOST_FILE_BYTES);
        entries.sort_by_key(Vec::len);
        entries.dedup();
        let step = entries.len().div_ceil(12).max(1);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        for (number, entry) in entries.iter().step_by(step).enumerate() {
            fs::write(folder.join(format!("entry-{number}")), entry).unwrap();
        }
    }
    assert!(corpus("bake-cache").len() > 3, "UPDATE=1 writes entries");
}

#[test]
fn every_target_withstands_its_corpus_and_mutations_of_it() {
    for target in targets() {
        let files = corpus(target.name);
        for (name, data) in &files {
            run(&target, name, data);
        }
        let mut random = SplitMix64::new(0x5eed);
        for number in 0..MUTATIONS {
            run(&target, &format!("mutation {number}"), &mutated(&mut random, &files));
        }
    }
}

/// A target without an input that its reader accepts tests little.
#[test]
fn every_format_has_an_input_that_is_read() {
    for format in FORMATS {
        let here = tempfile::tempdir().unwrap();
        let path = here.path().join(format!("a.{format}"));
        let is_read = corpus(format).iter().any(|(_, data)| {
            fs::write(&path, data).unwrap();
            crate::assets::goes_by_extension(data, &format!("a.{format}"))
                && crate::assets::read(&path, &crate::assets::ReadOptions::default()).is_ok()
        });
        assert!(is_read, "tests/fuzz/corpus/{format} has no file that can be read");
    }
}

#[test]
fn the_corpus_is_small_and_belongs_to_targets() {
    let targets = targets();
    let mut bytes = 0;
    for entry in fs::read_dir(folder()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(targets.iter().any(|target| target.name == name), "there is no target `{name}`");
        for (file, data) in corpus(&name) {
            let length = data.len() as u64;
            assert!(length <= MOST_FILE_BYTES, "{name}/{file} has {length} bytes");
            bytes += length;
        }
    }
    assert!(bytes <= MOST_BYTES, "the corpus has {bytes} bytes");
    let mut names: Vec<&str> = targets.iter().map(|target| target.name).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "two targets have one name");
}
