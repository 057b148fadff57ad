// Splats that are painted over each other (Coconu & Hege 2002). Each has a place, which follows from its slot and its number there and from
// nothing else; the record at that place says how it is drawn, and the key how far away it is.
//
// The image has TILES × TILES tiles. Once splats are sorted, each tile has a list of those that reach into it, the nearest first.

const TILES: u32 = 16u;

// Passes over painted splats tell each other these numbers.
struct PaintList {
    // Places, and splats that are drawn.
    places: u32,
    painted: u32,
    // The largest key, and the complement of the least one.
    farthest: atomic<u32>,
    nearest: atomic<u32>,
    // Where the lists of the tiles begin, row by row, and where the last one ends.
    tiles: array<u32, 257>,
    // How many samples of each slot each thread takes, then the places at which these begin.
    begins: array<u32>,
}

// A key, and a place with the tiles that the splat reaches into. Keys are the bits of the distance from the eye, and 0 where nothing is drawn.
// Distances, unlike depths, stay the same when the camera turns.
const NO_KEY: u32 = 0u;

const PLACE_BITS: u32 = 22u;
const PLACE: u32 = 0x3fffffu;
// Above the place: the first tile, and which others.
const TILE_BITS: u32 = 8u;
const ONE_TILE: u32 = 0u;
const AND_RIGHT: u32 = 1u;
const AND_BELOW: u32 = 2u;
// As the record's box says.
const MANY_TILES: u32 = 3u;

// Wanted by a frame whose splats cannot be sorted, whatever the room.
const TOO_MANY: u32 = 0xffffffffu;

// Vectors of a record: of all splats, and of those with clip lines.
const RECORD: u32 = 5u;
const CLIPPED_RECORD: u32 = 7u;
// Some splats of the scene have clip lines.
override CLIPPED: bool = false;

fn record_of(place: u32) -> u32 {
    return place * select(RECORD, CLIPPED_RECORD, CLIPPED);
}

// The box of a record: first and last pixels.
fn box_of(words: vec2<u32>) -> vec4<u32> {
    return vec4<u32>(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu, words.y >> 16u);
}

fn tile_size() -> vec2<u32> {
    return (frame.size_px + vec2<u32>(TILES - 1u)) / TILES;
}

// First and last column and row of the tiles that a box reaches into.
fn tiles_of_box(box: vec4<u32>) -> vec4<u32> {
    let size = tile_size();
    return box / vec4<u32>(size, size);
}

// A place with the tiles of a splat.
fn with_tiles(place: u32, tiles: vec4<u32>) -> u32 {
    let more = tiles.zw - tiles.xy;
    let others = select(select(MANY_TILES, AND_RIGHT * more.x + AND_BELOW * more.y, more.x + more.y <= 1u), ONE_TILE, more.x + more.y == 0u);
    return place | (tiles.y * TILES + tiles.x) << PLACE_BITS | others << (PLACE_BITS + TILE_BITS);
}
