//! accuracy.
