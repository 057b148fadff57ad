// How passes over the image go through a tile. A thread's pixels are a column, downwards. On CPU adapters a load costs a
// scalar access for every thread, the attributes of a pixel are some fifty loads, both sides of an `if` run under a mask,
// and every loop runs at least once. So the threads of a vector go down together: in one step past what none of them has
// to draw.
//
// Loops end by the row, which is the same for all threads of a workgroup, so that votes are taken by all of them. What is
// drawn depends on no vote: a thread only ever draws its own pixels, and a vote that says yes too often costs time alone.
//!include WORDS
const TILE: vec2<u32> = vec2<u32>(64u, 16u);

struct Column {
    at: vec2<u32>,
    pixel: u32,
    // One row below the last row of the tile that may be drawn.
    bottom: u32,
    // The tile may be wider than what may be drawn.
    inside: bool,
    word: vec2<u32>,
    // The pixel is for this pass to draw.
    mine: bool,
}

fn column_begin(group: vec3<u32>, lane: u32) -> Column {
    // An empty tile costs no more than this check.
    let before = vec2<u32>(atomicLoad(&stats[frame.view].drawn_before[0]), atomicLoad(&stats[frame.view].drawn_before[1]));
    let end = vec2<u32>(atomicLoad(&stats[frame.view].drawn_end[0]), atomicLoad(&stats[frame.view].drawn_end[1]));
    let begin = frame.size_px - before;
    let corner = group.xy * TILE;
    var column: Column;
    column.at = vec2<u32>(corner.x + lane, max(corner.y, begin.y));
    column.pixel = frame.first_pixel + column.at.y * frame.size_px.x + column.at.x;
    column.bottom = select(min(corner.y + TILE.y, end.y), 0u, corner.x >= end.x || corner.x + TILE.x <= begin.x
        || !may_have_words(frame.first_pixel + corner.y * frame.size_px.x, frame.first_pixel + (corner.y + TILE.y) * frame.size_px.x));
    column.inside = column.at.x >= begin.x && column.at.x < end.x;
    return column;
}

fn column_ends(column: Column) -> bool {
    return column.at.y >= column.bottom;
}

fn column_is_pixel(column: Column) -> bool {
    return column.inside && column.at.y < column.bottom;
}

// Loads the word of the column's pixel; below the tile and beside the image that is nothing.
fn column_load(column: ptr<function, Column>) {
    (*column).word = vec2<u32>(0u);
    if column_is_pixel(*column) {
        (*column).word.y = high_word((*column).pixel);
    }
    (*column).mine = (*column).word.y != 0u;
    if (*column).mine {
        (*column).word.x = low_word((*column).pixel);
    }
}

fn pixel_centre(at: vec2<u32>) -> vec2<f32> {
    return vec2<f32>(at) + vec2<f32>(0.5);
}

fn column_step(column: ptr<function, Column>) {
    (*column).pixel += frame.size_px.x;
    (*column).at.y++;
}

fn slot_of(word: vec2<u32>) -> u32 {
    return (~word.x) >> SLOT_SHIFT;
}
