// Parts of chunks: up to 64 neighbouring elements with bounds of their own; src/residency/parts.rs computes them.
//!include shared/turns

struct Part {
    // Corners of the box in 1/255 of the chunk's box, a byte for each axis. The last byte of `low` says how much shorter the longest
    // kernel axis is than the chunk's, in sixteenths of an octave.
    low: u32,
    high: u32,
    // Point trees: the code of the least error of a node, and of the largest error of a parent.
    error: u32,
    size: u32,
    // The code of the largest error of a node, and of the least error of a parent.
    error_all: u32,
    // Codes of sizes in place of errors; PLAIN is a flag.
    size_all: u32,
    // The longest distance of a node from its parent, in cells.
    delta: f32,
    // The cone of the normals: an axis (octahedral map, 8 bits each), the sine of the angle between the axis and the normals of nodes, and the
    // sine of the angle between a node's normal and the normals below it, both in 1/255 rounded up; zero for no cone.
    cone: u32,
}

// As one pixel each, no node of the part is thinned out or drawn in some views only.
const PLAIN: u32 = 0x80000000u;

@group(1) @binding(3) var<storage, read> parts: array<array<Part, 16>>;

// A corner of a part's box, as a fraction of the chunk's box from 0 to 1.
fn corner_of(word: u32) -> vec3<f32> {
    return vec3<f32>(vec3<u32>(word, word >> 8u, word >> 16u) & vec3<u32>(255u)) / 255.0;
}

// The longest kernel axis of a part, as a fraction of the chunk's.
fn longest_of(low: u32) -> f32 {
    return exp2((1.0 - 8.0 * f32(low >> 24u)) * 0.0078125);
}

// The box of a part in camera space, from the box of its chunk.
fn part_box(whole: Box, low_word: u32, high_word: u32) -> Box {
    let low = corner_of(low_word);
    let high = corner_of(high_word);
    // Measured from the chunk's middle, in units of half its edges.
    let middle = low + high - vec3<f32>(1.0);
    let size = high - low;
    return Box(
        whole.centre + whole.x * middle.x + whole.y * middle.y + whole.z * middle.z,
        whole.x * size.x,
        whole.y * size.y,
        whole.z * size.z,
        whole.slack,
    );
}
