//! Assets → what the GPU holds (floor 2).

pub mod pack;
