//! The hash of the program's sources, which the tag of every frame contains.
#![allow(clippy::unwrap_used, reason = "a test that unwraps says where it failed")]

use std::fs;
use std::path::Path;

#[path = "../build.rs"]
#[allow(dead_code, reason = "cargo runs `main`")]
mod script;

fn package() -> tempfile::TempDir {
    let package = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("src/lib.rs", "mod a;"),
        ("src/a/b.rs", "//! b"),
        ("shaders/shade/shade.wgsl", "fn shade() {}"),
        ("Cargo.lock", "version = 4"),
        ("Cargo.toml", "[package]"),
    ] {
        write(package.path(), name, text);
    }
    package
}

fn write(package: &Path, name: &str, text: &str) {
    let file = package.join(name);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, text).unwrap();
}

#[test]
fn this_program_has_the_hash_of_its_sources() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let digest = script::digest(package).unwrap();
    assert!(pointillist::BUILD.starts_with(&format!("{digest} ")), "{}", pointillist::BUILD);
}

#[test]
fn folders_ages_and_hidden_files_do_not_count() {
    let (one, other) = (package(), package());
    let expected = script::digest(one.path()).unwrap();
    for name in ["src/.lib.rs.swp", "target/debug/a", "docs/a.md", ".git/HEAD"] {
        write(other.path(), name, "text");
    }
    assert_eq!(script::digest(other.path()).unwrap(), expected);
}

#[test]
fn every_source_counts() {
    let changes = [
        ("src/lib.rs", "mod b;"),
        ("src/a/b.rs", "//! c"),
        ("src/a/c.rs", ""),
        ("shaders/shade/shade.wgsl", "fn shade() { }"),
        ("shaders/b.wgsl", ""),
        ("Cargo.lock", "version = 5"),
        ("Cargo.toml", "[package]\n"),
    ];
    let mut found = vec![script::digest(package().path()).unwrap()];
    for (name, text) in changes {
        let changed = package();
        write(changed.path(), name, text);
        found.push(script::digest(changed.path()).unwrap());
    }
    // A renamed file changes the hash.
    let renamed = package();
    fs::rename(renamed.path().join("src/a/b.rs"), renamed.path().join("src/b.rs")).unwrap();
    found.push(script::digest(renamed.path()).unwrap());
    let count = found.len();
    found.sort_unstable();
    found.dedup();
    assert_eq!(found.len(), count);
}
