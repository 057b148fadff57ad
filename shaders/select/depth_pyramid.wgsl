// Builds the hierarchical depth buffer of the image drawn so far (Greene, Kass & Miller 1993). One thread takes one block.
//!include shared/frame
//!include shared/scene
//!include shared/pyramid

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(2) @binding(0) var<storage, read_write> pyramid: array<u32>;

@compute @workgroup_size(64)
fn depth_pyramid(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let blocks = pyramid_blocks();
    let index = invocation.x + invocation.y * DISPATCH_ROW * 64u;
    if index >= blocks.x * blocks.y {
        return;
    }
    let block = vec2<u32>(index % blocks.x, index / blocks.x);
    let record = block_record(block);
    // Non-negative floats sort as their bits do.
    var whole = 0xffffffffu;
    for (var tile = 0u; tile < BLOCK_TILES * BLOCK_TILES; tile++) {
        let corner = block * BLOCK_PX + vec2<u32>(tile % BLOCK_TILES, tile / BLOCK_TILES) * TILE_PX;
        var least = 0xffffffffu;
        for (var k = 0u; k < TILE_PX * TILE_PX; k++) {
            // The last row and column repeat beyond the image.
            let at = min(corner + vec2<u32>(k % TILE_PX, k / TILE_PX), frame.size_px - vec2<u32>(1u));
            least = min(least, visibility[frame.first_pixel + at.y * frame.size_px.x + at.x].y);
            // A pixel that shows nothing has the lowest value.
            if least == 0u {
                break;
            }
        }
        pyramid[record + 1u + tile] = least;
        whole = min(whole, least);
    }
    pyramid[record] = whole;
}
