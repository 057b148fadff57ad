//! Reader for ptx files.
