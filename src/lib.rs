//! Pointillist: a headless render server for scenes of points and triangles.
//!
//! One request's journey, top to bottom; a module imports only from the floors below it:
//!
//! 1. [`cli`] parses a command line, [`http`] translates a request into a job;
//! 2. [`engine`] admits, coalesces and batches jobs, and alone owns the device; [`film`] has it draw a camera path, frame by frame, and
//!    [`jobs`] such films that nobody waits for;
//! 3. [`encode`] turns pixels into PNG, JPEG, WebP, QOI, EXR, PFM or raw bytes;
//! 4. [`passes`] records the passes that [`plan`] found necessary;
//! 5. [`residency`] holds what [`bake`] made of the [`assets`] that a [`scene`] names in GPU memory;
//! 6. [`gpu`] submits, times and reads back;
//! 7. [`oracle`] renders the same scene in f64 on the CPU, [`accuracy`] compares the two.
//!
//! With a message broker, [`farm`] has the frames of such films drawn by worker processes.
//!
//! From outside, [`load`] asks a server for more and more frames until it no longer keeps up.
//!
//! [`capacity`] simulates clusters and loads that are larger than the machines at hand.
//!
//! The answer carries a receipt ([`engine::receipt`]): what was understood, which passes ran, which
//! were skipped and why, and what each of them cost.

pub mod accuracy;
pub mod assets;
pub mod bake;
pub mod capacity;
pub mod cli;
pub mod encode;
pub mod engine;
pub mod farm;
pub mod film;
#[cfg(any(test, fuzzing))]
#[doc(hidden)]
pub mod fuzzing;
pub mod generate;
pub mod gpu;
pub mod http;
pub mod jobs;
mod json;
pub mod load;
mod lock;
mod markup;
pub mod math;
pub mod memory;
pub mod oracle;
pub mod passes;
pub mod plan;
pub mod residency;
pub mod scene;
mod spelling;
mod words;

/// The version that `--version` and reports name.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Hash of everything that this program was built from, then the target and its features (`build.rs`). Programs that may draw
/// different pixels have different builds.
pub const BUILD: &str = env!("POINTILLIST_BUILD");
