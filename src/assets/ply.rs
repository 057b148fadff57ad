//! Reader for ply files.
