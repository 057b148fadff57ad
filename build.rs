//! Hashes everything that the program is made of into `POINTILLIST_BUILD`, which is part of the tag of every frame.

use std::io;
use std::path::{Path, PathBuf};

/// Files and folders, relative to the package, that decide what the program draws.
const SOURCES: [&str; 4] = ["src", "shaders", "Cargo.lock", "Cargo.toml"];
/// Settings of the compiler that may change how numbers are rounded, as its version may.
const SETTINGS: [&str; 3] = ["TARGET", "CARGO_CFG_TARGET_FEATURE", "OPT_LEVEL"];

fn main() -> io::Result<()> {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from).unwrap_or_default();
    let mut build = digest(&package)?;
    for name in SETTINGS {
        build += " ";
        build += &std::env::var(name).unwrap_or_default();
    }
    build += " ";
    build += &compiler()?;
    for name in SOURCES {
        println!("cargo::rerun-if-changed={name}");
    }
    println!("cargo::rustc-env=POINTILLIST_BUILD={build}");
    Ok(())
}

/// Hashes what the compiler says of its version.
fn compiler() -> io::Result<String> {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let told = std::process::Command::new(rustc).arg("-vV").output()?;
    let mut hash = Fnv(START);
    hash.add(&told.stdout);
    Ok(format!("{:032x}", hash.0))
}

/// Hashes the names and contents of all source files below `package`. Neither the folder's own path nor a file's age counts.
///
/// # Errors
/// A file that cannot be read.
pub fn digest(package: &Path) -> io::Result<String> {
    let mut files = Vec::new();
    for name in SOURCES {
        list(package, name.to_owned(), &mut files)?;
    }
    files.sort_unstable();
    let mut hash = Fnv(START);
    for name in files {
        hash.add(name.as_bytes());
        hash.add(&std::fs::read(package.join(&name))?);
    }
    Ok(format!("{:032x}", hash.0))
}

/// Lists the files at `name`, with `/` in their names on every system. Hidden files, which editors leave, are skipped.
fn list(package: &Path, name: String, files: &mut Vec<String>) -> io::Result<()> {
    let path = package.join(&name);
    if !path.is_dir() {
        files.push(name);
        return Ok(());
    }
    for entry in std::fs::read_dir(path)? {
        let own = entry?.file_name();
        let own = own.to_str().ok_or_else(|| io::Error::other(format!("{own:?} is not UTF-8")))?;
        if !own.starts_with('.') {
            list(package, format!("{name}/{own}"), files)?;
        }
    }
    Ok(())
}

const START: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;

/// FNV-1a with 128 bits. Sources are no adversaries, and a build script needs no further crate for it.
struct Fnv(u128);

impl Fnv {
    /// Adds some bytes after their number, so that no two sequences of parts look alike.
    fn add(&mut self, bytes: &[u8]) {
        for byte in (bytes.len() as u64).to_le_bytes().iter().chain(bytes) {
            self.0 = (self.0 ^ u128::from(*byte)).wrapping_mul((1 << 88) + 0x13b);
        }
    }
}
