//! Reader for obj files.
