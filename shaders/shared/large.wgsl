// The list of triangles or splats that are too large for one thread. The passes that fill it and draw it share this file.

// Words of the indirect draw that stands before the list of large triangles, and of each entry: id, then what
// list_word packs.
const LIST_HEAD: u32 = 4u;
const LIST_ENTRY: u32 = 2u;

const ROW_BITS: u32 = 14u;
const ROW_MASK: u32 = 0x3fffu;

// First and last row, and the view.
fn list_word(first_row: u32, last_row: u32, view: u32) -> u32 {
    return first_row | (last_row << ROW_BITS) | (view << (2u * ROW_BITS));
}

fn list_rows(word: u32) -> vec2<i32> {
    return vec2<i32>(i32(word & ROW_MASK), i32((word >> ROW_BITS) & ROW_MASK));
}

fn list_view(word: u32) -> u32 {
    return word >> (2u * ROW_BITS);
}

// Returns whether the list is complete.
fn list_is_whole(longest: u32) -> bool {
    return longest <= frame.large_capacity;
}

// Returns whether a view's part of the list stays within the frame's cost limit.
fn may_draw(units: u32, wrapped: u32) -> bool {
    return units <= frame.large_units_limit && wrapped == 0u;
}
