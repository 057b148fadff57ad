//! cli.
pub mod generate;
