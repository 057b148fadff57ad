//! Fuzz targets: for everything that reads bytes from outside, one function that reads any bytes and checks what comes out.
//!
//! `make fuzz` runs them in libFuzzer (`tests/fuzz/`), and the unit tests over the corpus in `tests/fuzz/corpus` and over mutations of
//! it. No other build has this module. A target panics where a promise is broken: a reader must refuse bad bytes with an error, keep
//! no NaN and no infinity, reserve memory before it allocates it, and read back what it has written.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a target reports a fault by panicking")]

mod assets;
mod finite;
mod records;
mod scenes;
#[cfg(test)]
mod tests;

pub(crate) use self::assets::any_asset;
pub(crate) use self::finite::{assert_finite, assert_numbers};
use crate::assets::FORMATS;
use crate::{bake, http};

/// A function of a fuzz target.
pub(crate) type Run = fn(&[u8]);

/// The text that bytes are, if they are UTF-8.
pub(crate) fn text(data: &[u8]) -> Option<&str> {
    std::str::from_utf8(data).ok()
}

/// Something that reads bytes from outside.
pub struct Target {
    /// Name on the command line, and of the folder in the corpus.
    pub name: &'static str,
    run: Box<Read>,
}

type Read = dyn Fn(&[u8]) + Send + Sync;

impl Target {
    fn new(name: &'static str, run: impl Fn(&[u8]) + Send + Sync + 'static) -> Target {
        Target { name, run: Box::new(run) }
    }

    /// Reads an input.
    ///
    /// # Panics
    /// A promise is broken.
    pub fn run(&self, data: &[u8]) {
        (self.run)(data);
    }
}

/// All targets: one for each file extension of an asset, and those of the lists.
pub fn targets() -> Vec<Target> {
    let formats =
        FORMATS.iter().map(|&name| Target::new(name, move |data| assets::read_as(name, data)));
    let lists = [
        assets::TARGETS,
        scenes::TARGETS,
        records::TARGETS,
        http::FUZZ_TARGETS,
        bake::cache::FUZZ_TARGETS,
    ];
    let others = lists.into_iter().flatten().map(|&(name, run)| Target::new(name, run));
    formats.chain(others).collect()
}
