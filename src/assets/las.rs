//! Reader for las files.
