//! Reader for off files.
