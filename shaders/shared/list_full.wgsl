// The list of entries as it was uploaded.
@group(1) @binding(0) var<storage, read> entries: array<Entry>;

fn entry_count() -> u32 {
    return frame.entry_count;
}
