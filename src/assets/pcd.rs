//! Reader for pcd files.
