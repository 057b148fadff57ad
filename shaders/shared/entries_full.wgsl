// A scene's lists as they were uploaded: every chunk of every instance, every instance.
@group(1) @binding(0) var<storage, read> entries: array<Entry>;

fn entry_count() -> u32 {
    return frame.entry_count;
}

struct Walk {
    at: u32,
}

fn walk_from(first: u32) -> Walk {
    return Walk(first);
}

fn walk_next(walk: ptr<function, Walk>) -> Entry {
    let entry = entries[(*walk).at];
    (*walk).at++;
    return entry;
}

// How far samples are drawn beside their pixels, where that does not follow from their kernels.
fn node_px() -> f32 {
    return 0.0;
}

fn chunk_is_wanted(chunk: Chunk, scale: f32, low: f32, high: f32, far: f32) -> bool {
    return true;
}
