// Threads that take a chunk of samples. Each loads what the chunk's samples have in common: on CPU adapters that is a scalar access
// each, and few threads are better.
override LANES: u32 = 64u;
