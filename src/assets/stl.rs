//! Reader for stl files.
