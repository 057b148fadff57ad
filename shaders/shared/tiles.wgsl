// Tiles that splats reach into.
//!include shared/digits

// Keys and places, the nearest first.
@group(0) @binding(6) var<storage, read> sorted: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read> paint_records: array<vec4<u32>>;

// First and last column and row of tiles.
fn tiles_of(word: u32) -> vec4<u32> {
    let others = word >> (PLACE_BITS + TILE_BITS);
    if others == MANY_TILES {
        return tiles_of_box(box_of(paint_records[record_of(word & PLACE) + 3u].xy));
    }
    let tile = (word >> PLACE_BITS) & (TILES * TILES - 1u);
    let first = vec2<u32>(tile % TILES, tile / TILES);
    return vec4<u32>(first, first + vec2<u32>(others & 1u, others >> 1u));
}
