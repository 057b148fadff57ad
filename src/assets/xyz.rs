//! Reader for xyz files.
