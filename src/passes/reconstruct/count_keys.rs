//! How many keys of painted splats have each value of a digit.

pub use super::over_shares as record;
