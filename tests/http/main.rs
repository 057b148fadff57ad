//! The real daemon over real sockets: frames, errors, uploads, load, start and stop.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

mod access;
mod accuracy;
mod admission;
mod balancer;
mod client;
mod cluster;
mod compare;
mod contract;
mod daemon;
mod errors;
mod examples;
mod frames;
mod hostile;
mod jobs;
mod leaving;
mod lifecycle;
mod load;
mod mjpeg;
mod monitoring;
mod naming;
mod patches;
mod picks;
mod provisional;
mod resolving;
mod schema;
mod servers;
mod soak;
mod stream;
mod stream_ends;
mod telemetry;
mod untaken;
mod uploads;
mod viewer;
