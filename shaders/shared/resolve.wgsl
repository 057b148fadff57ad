// What every resolve pass shares: which pixels are its own, and what it writes there.
struct SegmentUse {
    index: u32,
    // 1 for the frame's first resolve, which also writes the background.
    first: u32,
}

// 0 color, 1 depth, 2 normal, 3 id.
override OUTPUT: u32 = 0u;
// A shade pass follows and wants normals.
override SHADED: bool = true;
// Some instance overrides its asset's materials.
override OVERRIDES: bool = true;
// Some material has a texture.
override TEXTURES: bool = true;

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read_write> normals: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: Stats;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(1) var<storage, read> dispatches: array<Dispatch>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;

const OUTPUT_COLOR: u32 = 0u;
const OUTPUT_DEPTH: u32 = 1u;
const OUTPUT_NORMAL: u32 = 2u;
const OUTPUT_ID: u32 = 3u;
const INFINITE_DEPTH: u32 = 0x7f800000u;

fn background_word() -> u32 {
    if OUTPUT == OUTPUT_COLOR {
        return frame.background;
    }
    return select(0u, INFINITE_DEPTH, OUTPUT == OUTPUT_DEPTH);
}

// A thread's pixels: a column of a tile. CPU adapters run both sides of an `if` under a mask and every loop at least once;
// so the threads of a vector first step to the next row in which one of them has a pixel of this segment, which is
// cheap, and then resolve it. Tiles that show nothing pass by in one step.
struct Walk {
    pixel: u32,
    // One row below the tile.
    end: u32,
    at: vec2<u32>,
    word: vec2<u32>,
}

const TILE: vec2<u32> = vec2<u32>(64u, 16u);

fn walk_begin(group: vec3<u32>, lane: u32) -> Walk {
    let at = group.xy * TILE + vec2<u32>(lane, 0u);
    let size = frame.size_px;
    var walk: Walk;
    walk.at = at;
    walk.pixel = at.y * size.x + at.x;
    walk.end = select(min(at.y + TILE.y, size.y) * size.x + at.x, walk.pixel, at.x >= size.x);
    return walk;
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

// An instance's normal in world space, unit length and turned towards the eye, or zero.
fn world_normal(instance: u32, local: vec3<f32>, towards: vec3<f32>) -> vec3<f32> {
    let m = instances[instance].inverse_x.xyz * local.x
        + instances[instance].inverse_y.xyz * local.y
        + instances[instance].inverse_z.xyz * local.z;
    return facing_normal(m, towards);
}

fn facing_normal(m: vec3<f32>, towards: vec3<f32>) -> vec3<f32> {
    let a = abs(m);
    let most = max(a.x, max(a.y, a.z));
    if !(most > 0.0) {
        return vec3<f32>(0.0);
    }
    let scaled = m / most;
    let n = scaled / length(scaled);
    return select(n, -n, dot(n, towards) > 0.0);
}
