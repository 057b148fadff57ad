//! Keys of painted splats in the order of a digit.

pub use super::over_shares as record;
