//! How work is spread over threads. A CPU has few of them, and each that loads a value which all of them need does so by itself; a GPU needs
//! thousands at once.

/// Rows of a band, and width and height of a square, that a workgroup paints; the square is that of `reconstruct/paint_splats`.
pub const PAINT_BAND: u32 = 32;
const PAINT_SQUARE: u32 = 16;
/// Tiles along each side of the image; as in `shared/painted`.
const TILES: u32 = 16;

/// Threads that take a chunk of samples.
pub fn lanes(is_cpu: bool) -> u32 {
    if is_cpu { 8 } else { 64 }
}

/// Overrides of shaders that differ between CPUs and GPUs: [`lanes`]; slots that a workgroup of 64 threads asks whether they are hidden; and
/// threads that share such a slot, one for each part of a chunk.
pub fn overrides(is_cpu: bool) -> [(&'static str, u32); 3] {
    let (asked, testers) = if is_cpu { (512, 1) } else { (4, 16) };
    [("LANES", lanes(is_cpu)), ("ASKED", asked), ("TESTERS", testers)]
}

/// Threads that sort painted splats, each a share of them.
pub fn sort_workers(is_cpu: bool) -> u32 {
    if is_cpu { 256 } else { 8192 }
}

/// Threads that add up the counts of one value of a digit.
pub fn summers(is_cpu: bool) -> u32 {
    if is_cpu { 64 } else { 256 }
}

/// Workgroups that paint a tile of an image of this size. On a CPU each takes a band of rows, on a GPU a square of pixels.
pub fn painters((width, height): (u32, u32), is_cpu: bool) -> u32 {
    let (width, height) = (width.div_ceil(TILES), height.div_ceil(TILES));
    if is_cpu {
        return height.div_ceil(PAINT_BAND);
    }
    width.div_ceil(PAINT_SQUARE) * height.div_ceil(PAINT_SQUARE)
}
