// The list of entries as it was uploaded.
@group(1) @binding(0) var<storage, read> entries: array<Entry>;

fn entry_count() -> u32 {
    return frame.entry_count;
}

// All samples of a chunk are tested.
const COUNTS_SAMPLES: bool = true;
const LISTS_SORTED: bool = false;

fn code_limits(chunk: Chunk, at: Placed, box: Box, unit: f32) -> u32 {
    return MOST_LIMIT;
}

fn wanted_parts(index: u32, chunk: Chunk, at: Placed, box: Box, unit: f32, one_sided: bool) -> u32 {
    return ALL_PARTS;
}
