// The list of entries as `cull` has written it.
//!include shared/chosen
@group(2) @binding(5) var<storage, read> entries: array<Entry>;
@group(2) @binding(6) var<storage, read> sizes: Sizes;

fn entry_count() -> u32 {
    return sizes.group_count * 32u;
}
