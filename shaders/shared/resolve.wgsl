// Shared by all resolve passes: which pixels are a pass's own, and where their surfaces go. Pixels that show nothing have the background, which
// `clear` wrote.
//!include VOTE
//!include shared/column
//!include shared/colour
//!include shared/material
//!include shared/octahedral
//!include shared/output
//!include FINISH
// At least one instance overrides its asset's materials.
override OVERRIDES: bool = true;
// At least one material has a texture.
override TEXTURES: bool = true;

@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;

const NO_SLOT: u32 = 0xffffffffu;

// Looks at the column's pixel; `begin` and `count`: the segment's slots.
fn resolve_load(column: ptr<function, Column>, begin: u32, count: u32) {
    column_load(column);
    (*column).mine = (*column).mine && slot_of((*column).word) - begin < count;
}

fn resolve_next(column: ptr<function, Column>, begin: u32, count: u32) {
    column_step(column);
    resolve_load(column, begin, count);
}

// Skips rows in which no thread has a pixel of the segment.
fn resolve_seek(column: ptr<function, Column>, begin: u32, count: u32) {
    loop {
        if column_ends(*column) || any_lane((*column).mine) {
            break;
        }
        resolve_next(column, begin, count);
    }
}
