//! The accuracy of frames, above all compared with the oracle (floor 6), and what it costs in time.
//!
//! [`mod@reference`] draws reference frames of the engine's scenes, and [`metrics`] measures the difference of two frames.
//! [`mod@stability`] compares the shaders' computations of splats in f32 with f64, in cases that are numerically hard.
//!
//! A survey measures the error and the GPU time of every combination of settings that trades one for the other:
//! ```text
//! declarations ─► sweep ─► survey ─► journal ─► results ─► report
//!   plan/settings  order    draws     a line a   fronts     JSON, Markdown,
//!                           with the  finished   (pure)     SVG, HTML (pure)
//!                           engine    frame
//! ```
//! [`truth`] holds the frame that errors are measured against, [`mod@difference`] the errors of one image, [`temporal`] what flickers from frame to frame
//! of a camera path, and [`service`] the surveys of a server.
//! [`cost`] compares the reports of several scenes: what one more decibel costs in each.
//! [`planning`] measures many settings at many poses for the planner ([`crate::plan::planner`]).
pub mod cost;
mod date;
pub mod difference;
pub mod enlarge;
pub mod journal;
pub mod metrics;
pub mod planning;
pub mod poses;
pub mod reference;
pub mod report;
pub mod results;
pub mod service;
pub mod stability;
pub mod steady;
pub mod survey;
pub mod sweep;
pub mod temporal;
pub mod truth;

pub use date::date;
