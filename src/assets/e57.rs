//! Reader for e57 files.
