// Number of threads that take a chunk of samples. Each thread loads the chunk's common values; on CPU adapters each such
// load is a scalar access, so that fewer threads are faster.
override LANES: u32 = 64u;
