//! Twin tests: compare the engine's frame with the oracle's, drawn from the same files.
//!
//! `stage` has the engines (with and without 64-bit atomics) and the scenes of the tests, `files` writes their assets, and
//! `verdict` compares frames. Needs a Vulkan adapter, such as Mesa's lavapipe.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

mod antialias;
mod clip_boxes;
mod color_by;
mod counts;
mod effects;
mod environment;
mod fields;
mod files;
mod fog;
mod fuzzy;
mod golden;
mod instances;
mod lens;
mod lights;
mod lines;
mod materials;
mod occlusion;
mod orthographic;
mod painted;
mod physical;
mod point_size;
mod precision;
mod pull_push;
mod pyramid;
mod random;
mod real;
mod samples;
mod scenes;
mod shadows;
mod splats;
mod splats_figures;
mod stage;
mod translucent;
mod trees;
mod triangles;
mod verdict;
