// The hierarchical depth buffer: of each tile of 4 × 4 pixels, and of each block of 4 × 4 tiles, the depth that all of it is nearer
// than, as 1/z. A block's record is its own, then its tiles' row by row.
const TILE_PX: u32 = 4u;
const BLOCK_TILES: u32 = 4u;
const BLOCK_PX: u32 = 16u;
const BLOCK_WORDS: u32 = 17u;

fn pyramid_blocks() -> vec2<u32> {
    return (frame.size_px + vec2<u32>(BLOCK_PX - 1u)) / BLOCK_PX;
}

// The record of a block of this frame's view.
fn block_record(block: vec2<u32>) -> u32 {
    let blocks = pyramid_blocks();
    return (frame.view * blocks.x * blocks.y + block.y * blocks.x + block.x) * BLOCK_WORDS;
}
