//! The load generator (floor 7): measures a server's throughput and latency, and finds the rate at which it saturates.
//!
//! ```text
//!  schedule ──due times──► drive ──a task each──► request ──GET, pose from poses──► server
//!      ▲                     │ streams ──poses, acknowledgements over WebSockets──────►│
//!      │                     └──────── sample ◄── answer, receipt ◄───────────────────┘
//!      │                                 │
//!  knee ◄── point ◄── tally (histograms) ◄┘          report, plot ◄── points
//! ```
//!
//! It knows the server by its HTTP contract alone ([`wire`]). [`schedule`], [`poses`], [`histogram`], [`tally`], [`following`],
//! [`knee`], [`report`], [`thresholds`] and [`plot`] are pure. Clocks, tasks and sockets are in [`drive`], [`request`] and
//! [`streams`]. [`mod@run`] runs the steps one after another.

pub mod drive;
pub mod following;
pub mod histogram;
pub mod knee;
pub mod plot;
pub mod poses;
pub mod report;
pub mod request;
pub mod run;
pub mod schedule;
pub mod streams;
pub mod tally;
pub mod thresholds;
pub mod wire;
