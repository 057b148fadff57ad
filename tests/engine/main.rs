//! Tests of the engine on a real adapter: equal requests give equal bytes whatever else is drawn, scenes come and go within the
//! budget, a lost device is replaced, the queue is fair, and no input of a caller causes a panic or a hang.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

mod baking;
mod changes;
mod closed;
mod coverage;
mod crowds;
mod detail;
mod determinism;
mod estimates;
mod extremes;
mod framing;
mod hard_scenes;
mod hidden;
mod large_triangles;
mod lens;
mod limits;
mod lines;
mod loss;
mod memory;
mod paging;
mod parts;
mod picks;
mod pipelines;
mod planner;
mod plans;
mod queueing;
mod rounds;
mod sheets;
mod side_files;
mod splats_hard;
mod stereo;
mod studio;
mod tags;
mod trees;
mod views;
