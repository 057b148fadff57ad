// What every resolve pass shares: which pixels are its own, and what it writes there.
//!include VOTE
//!include shared/column
//!include shared/outputs
// A shade pass follows and wants normals.
override SHADED: bool = true;
// Some instance overrides its asset's materials.
override OVERRIDES: bool = true;
// Some material has a texture.
override TEXTURES: bool = true;

@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read_write> normals: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;

const INFINITE_DEPTH: u32 = 0x7f800000u;

fn background_word() -> u32 {
    if OUTPUT == OUTPUT_COLOR {
        return frame.background;
    }
    return select(0u, INFINITE_DEPTH, OUTPUT == OUTPUT_DEPTH);
}

const NO_SLOT: u32 = 0xffffffffu;

// Looks at the column's pixel; `begin` and `count`: the segment's slots.
fn resolve_load(column: ptr<function, Column>, begin: u32, count: u32) {
    column_load(column);
    if (*column).word.y == 0u && segment.first != 0u && column_is_pixel(*column) {
        pixels[(*column).pixel] = background_word();
    }
    (*column).mine = (*column).mine && slot_of((*column).word) - begin < count;
}

fn resolve_next(column: ptr<function, Column>, begin: u32, count: u32) {
    column_step(column);
    resolve_load(column, begin, count);
}

// Past rows in which no thread has a pixel of the segment.
fn resolve_seek(column: ptr<function, Column>, begin: u32, count: u32) {
    loop {
        if column_ends(*column) || any_lane((*column).mine) {
            break;
        }
        resolve_next(column, begin, count);
    }
}

fn pixel_centre(at: vec2<u32>) -> vec2<f32> {
    return vec2<f32>(at) + vec2<f32>(0.5);
}

// Visible from the front: the normal turned towards the eye, as bytes n · 127 + 128.
fn normal_word(n: vec3<f32>) -> u32 {
    if dot(n, n) < 0.25 {
        return 0u;
    }
    let b = vec3<u32>(round(n * 127.0 + vec3<f32>(128.0)));
    return b.x | (b.y << 8u) | (b.z << 16u) | 0xff000000u;
}
