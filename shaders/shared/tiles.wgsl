// Tiles that splats reach into.
//!include shared/digits

// Keys and places, the nearest first.
@group(0) @binding(6) var<storage, read> sorted: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read> paint_records: array<vec4<u32>>;

// First and last column and row of tiles.
fn tiles_of(place: u32) -> vec4<u32> {
    let size = tile_size();
    return box_of(paint_records[record_of(place) + 3u].xy) / vec4<u32>(size, size);
}
