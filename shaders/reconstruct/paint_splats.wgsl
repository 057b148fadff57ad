// Paints the splats of each tile over each other (Coconu & Hege 2002, §5.4). On CPU adapters a workgroup takes a band of a tile, and each of its
// threads has columns of its own. On GPUs it takes a square of pixels, one a thread. In both cases no two threads write a pixel.
//
// Splats come from front to back: each is painted under what is there, which gives the same as painting it before what comes later,
// and a thread is done once nothing shines through its pixels.
//
// On lavapipe all loops of a thread share 65535 rounds, and what comes after is never done. A thread that has none left notes how far it
// came, and the next launch goes on from there. If none is left, the frame is drawn again with more.
//!include shared/frame
//!include shared/scene
//!include shared/linear
//!include shared/clipping
//!include shared/painted
//!include shared/kept
//!include shared/canvas
//!include shared/lanes

// Triangles and lines may hide splats; they are drawn before.
override HIDES: bool = true;
// A splat hides as much as so many of it, one over the other.
override LAYERS: f32 = 5.0;
// Width of what a splat covers, in percent of its kernel.
override WIDTH_PERCENT: u32 = 115u;
// Rows of a band.
override BAND: u32 = 32u;
// A thread has a single pixel, which it keeps in registers.
override PIXELWISE: bool = false;
// Width and height of a square of pixels, and of the part of it that neighbouring threads take.
const SQUARE: u32 = 16u;
const PATCH: vec2<u32> = vec2<u32>(8u, 4u);
// However small, a weight counts where there is no other.
const LEAST_WEIGHT: f32 = 1e-12;
// Rounds of a launch.
override ROUNDS: u32 = 60000u;
@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(5) var<storage, read_write> paint_list: PaintList;
@group(0) @binding(6) var<storage, read> paint_order: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read> paint_records: array<vec4<u32>>;
// How many splats of its list a thread has painted, and how many of its pixels are opaque.
@group(0) @binding(8) var<storage, read_write> paint_cursors: array<vec2<u32>>;

fn share_of_16(bits: u32) -> f32 {
    return f32(bits & 0xffffu) / 65535.0;
}

// These values are the same for all pixels of a splat; see list_splats.
struct PaintedSplat {
    at: u32,
    low: vec2<u32>,
    s: vec4<f32>,
    t: vec4<f32>,
    inverse: vec4<f32>,
    color: vec3<f32>,
    offset: f32,
    facing: u32,
    amplitude: f32,
}

// A splat at a pixel: what it covers of it, its weight among others, and one over its depth. It covers nothing where it is not seen.
struct Touch {
    cover: f32,
    weight: f32,
    inverse: f32,
}

fn touch_of(splat: PaintedSplat, pixel: vec2<u32>) -> Touch {
    let d = vec2<f32>(pixel) - vec2<f32>(splat.low);
    let s = linear(splat.s.xyz, d);
    let t = linear(splat.t.xyz, d);
    let along = linear(splat.inverse.xyz, d);
    let n = select(1.0, splat.s.w * along, splat.s.w != 0.0);
    let q = fma(s, s, t * t) / (n * n);
    let inverse = clamp(select(along, 1.0 / along, ORTHOGRAPHIC), splat.t.w, splat.inverse.w);
    let end = frame.splat_cutoff * frame.splat_cutoff;
    // Parallel rays meet the splat behind the eye as well.
    var shown = n > 0.0 && q < end && (!ORTHOGRAPHIC || along > NEAREST);
    if HIDES {
        shown = shown && inverse >= bitcast<f32>(visibility[pixel.y * frame.size_px.x + pixel.x].y);
    }
    if CLIP_BOXES != 0u {
        shown = shown && place_is_shown(at_depth(vec2<f32>(pixel) + vec2<f32>(0.5), 1.0 / inverse));
    }
    if CLIPPED {
        let lines = vec2<u32>(splat.at + RECORD, splat.at + RECORD + 1u);
        let first = linear(bitcast<vec3<f32>>(paint_records[lines.x].xyz), d) >= 0.0;
        let second = linear(bitcast<vec3<f32>>(paint_records[lines.y].xyz), d) >= 0.0;
        shown = shown && select(first && second, first || second, paint_records[lines.x].w != 0u);
    }
    // Both end at 0, so that no outline moves by jumps. Splats smaller than a pixel cover no more of it for their greater width.
    let narrow = 10000.0 / f32(WIDTH_PERCENT * WIDTH_PERCENT);
    let least = exp(-0.5 * end * narrow);
    let amplitude = splat.amplitude * mix(narrow, 1.0, splat.amplitude);
    let cover = amplitude * (exp(-0.5 * q * narrow) - least) / (1.0 - least);
    let weight = splat.amplitude * (exp(-0.5 * q) - least);
    return Touch(select(0.0, min(cover, 1.0), shown), max(weight, LEAST_WEIGHT), inverse);
}

var<private> own_painted: vec4<f32>;
var<private> own_sums: vec4<f32>;
var<private> own_ends: vec2<f32>;

fn painted_at(pixel: u32) -> vec4<f32> {
    if PIXELWISE {
        return own_painted;
    }
    return painted[pixel];
}

fn set_painted(pixel: u32, value: vec4<f32>) {
    if PIXELWISE {
        own_painted = value;
    } else {
        painted[pixel] = value;
    }
}

fn sums_at(pixel: u32) -> vec4<f32> {
    if PIXELWISE {
        return own_sums;
    }
    return paint_sums[pixel];
}

fn ends_at(pixel: u32) -> vec2<f32> {
    if PIXELWISE {
        return own_ends;
    }
    return paint_ends[pixel];
}

fn set_surface(pixel: u32, sums: vec4<f32>, ends: vec2<f32>) {
    if PIXELWISE {
        own_sums = sums;
        own_ends = ends;
    } else {
        paint_sums[pixel] = sums;
        paint_ends[pixel] = ends;
    }
}

// Paints a splat at a pixel, under what is there. Returns whether the pixel is opaque since then.
fn paint(splat: PaintedSplat, touch: Touch, pixel: u32) -> bool {
    let alpha = 1.0 - pow(1.0 - touch.cover, LAYERS);
    if !SURFACES {
        let over = painted_at(pixel);
        if over.a < OPAQUE {
            let next = under(over, splat.color, alpha);
            set_painted(pixel, next);
            return next.a >= OPAQUE;
        }
        return false;
    }
    let sums = sums_at(pixel);
    if sums.a < 0.0 {
        return false;
    }
    let share = vec4<f32>(splat.color, 1.0) * touch.weight;
    let kept = ends_at(pixel);
    let bits = bitcast<u32>(kept.x);
    let beside = touch.inverse >= bitcast<f32>(bits & ~FACING_BITS) && !shows_other_side(bits, splat.facing);
    if sums.a > 0.0 && beside {
        set_surface(pixel, sums + share, vec2<f32>(kept.x, kept.y * (1.0 - alpha)));
        return false;
    }
    var next = vec4<f32>(0.0);
    if sums.a > 0.0 {
        next = with_surface(painted_at(pixel), sums, kept.y);
        set_painted(pixel, next);
    }
    let opaque = next.a >= OPAQUE;
    let offset = touch.inverse / fma(splat.offset, touch.inverse, 1.0);
    let end = bitcast<f32>((bitcast<u32>(offset) & ~FACING_BITS) | splat.facing);
    set_surface(pixel, select(share, vec4<f32>(0.0, 0.0, 0.0, -1.0), opaque), vec2<f32>(end, 1.0 - alpha));
    return opaque;
}

// Reads the splat of a record.
fn splat_of(record: u32, box: vec4<u32>, words: vec4<u32>) -> PaintedSplat {
    var splat: PaintedSplat;
    splat.at = record;
    splat.low = box.xy;
    splat.s = bitcast<vec4<f32>>(paint_records[record]);
    splat.t = bitcast<vec4<f32>>(paint_records[record + 1u]);
    // Parallel rays need the depth as well, to leave out what lies behind the eye.
    if HIDES || SURFACES || ORTHOGRAPHIC || CLIP_BOXES != 0u || splat.s.w != 0.0 {
        splat.inverse = bitcast<vec4<f32>>(paint_records[record + 2u]);
    }
    splat.color = vec3<f32>(share_of_16(words.z), share_of_16(words.z >> 16u), share_of_16(words.w));
    let rest = paint_records[record + 4u];
    splat.offset = bitcast<f32>(rest.x);
    splat.facing = rest.y;
    splat.amplitude = bitcast<f32>(rest.z);
    return splat;
}

// Records of splats that may reach into the square, and a bit for each that does.
var<workgroup> batch: array<u32, 256>;
var<workgroup> reaching: array<atomic<u32>, 8>;
var<workgroup> open_pixels: atomic<u32>;
var<workgroup> goes_on: bool;

// Paints a square of a tile, a pixel a thread. The threads look through the tile's list together, so many splats at a time as there are threads.
fn paint_square(tile: u32, number: u32, lane: u32) {
    let size = tile_size();
    let across = (size.x + SQUARE - 1u) / SQUARE;
    let tile_first = vec2<u32>(tile % TILES, tile / TILES) * size;
    let first = tile_first + vec2<u32>(number % across, number / across) * SQUARE;
    let end = min(min(first + vec2<u32>(SQUARE), tile_first + size), frame.size_px);
    // Neighbouring threads run together: their pixels should be near each other.
    let in_patch = lane % (PATCH.x * PATCH.y);
    let patch_number = lane / (PATCH.x * PATCH.y);
    let patches = SQUARE / PATCH.x;
    let own = first + vec2<u32>(patch_number % patches, patch_number / patches) * PATCH + vec2<u32>(in_patch % PATCH.x, in_patch / PATCH.x);
    let is_inside = all(own < end);
    let pixel = own.y * frame.size_px.x + own.x;
    var is_open = is_inside;
    let list_end = paint_list.tiles[tile + 1u];
    var at = paint_list.tiles[tile];
    loop {
        if lane < 8u {
            atomicStore(&reaching[lane], 0u);
        }
        if lane == 8u {
            atomicStore(&open_pixels, 0u);
        }
        workgroupBarrier();
        if is_open {
            atomicStore(&open_pixels, 1u);
        }
        if at + lane < list_end {
            let record = record_of(paint_order[at + lane].y & PLACE);
            let box = box_of(paint_records[record + 3u].xy);
            batch[lane] = record;
            if all(box.xy < end) && all(box.zw >= first) {
                atomicOr(&reaching[lane / 32u], 1u << (lane % 32u));
            }
        }
        workgroupBarrier();
        if lane == 0u {
            goes_on = at < list_end && atomicLoad(&open_pixels) != 0u;
        }
        if !workgroupUniformLoad(&goes_on) {
            break;
        }
        at += LANES;
        for (var word = 0u; word < 8u && is_open; word++) {
            var left = atomicLoad(&reaching[word]);
            while left != 0u && is_open {
                let record = batch[word * 32u + firstTrailingBit(left)];
                left &= left - 1u;
                let words = paint_records[record + 3u];
                let box = box_of(words.xy);
                if all(own >= box.xy) && all(own <= box.zw) {
                    let splat = splat_of(record, box, words);
                    let touch = touch_of(splat, own);
                    if touch.cover > 0.0 {
                        is_open = !paint(splat, touch, pixel);
                    }
                }
            }
        }
        workgroupBarrier();
    }
    if is_inside {
        painted[pixel] = own_painted;
        if SURFACES {
            paint_sums[pixel] = own_sums;
            paint_ends[pixel] = own_ends;
        }
    }
}

// Paints a band of a tile.
fn paint_band(group: vec3<u32>, groups: vec3<u32>, lane: u32) {
    let size = tile_size();
    // First pixel of the band, and the one behind its last.
    let first = vec2<u32>(group.x % TILES, group.x / TILES) * size + vec2<u32>(0u, group.y * BAND);
    let end = min(vec2<u32>(first.x + size.x, min(first.y + BAND, (group.x / TILES + 1u) * size.y)), frame.size_px);
    let own_first = first.x + lane;
    if own_first >= end.x || first.y >= end.y {
        return;
    }
    let own_pixels = ((end.x - own_first + LANES - 1u) / LANES) * (end.y - first.y);
    let cursor = (group.y * groups.x + group.x) * LANES + lane;
    let list_end = paint_list.tiles[group.x + 1u];
    var at = paint_list.tiles[group.x] + paint_cursors[cursor].x;
    var filled = paint_cursors[cursor].y;
    if at < list_end && filled < own_pixels && paint_cursors[cursor].x != 0u {
        atomicSub(&stats[0].paint_cut, 1u);
    }
    var rounds = 0u;
    let most = (size.x / LANES + 2u) * (BAND + 1u);
    while at < list_end && filled < own_pixels && rounds + most < ROUNDS {
        let record = record_of(paint_order[at].y & PLACE);
        at++;
        rounds++;
        let words = paint_records[record + 3u];
        let box = box_of(words.xy);
        let begin = max(box.xy, first);
        let last = min(box.zw, end - vec2<u32>(1u));
        // Columns of this thread: as many as any thread has count.
        let column = own_first + (begin.x - first.x + LANES - 1u - lane) / LANES * LANES;
        if begin.y > last.y || begin.x > last.x {
            continue;
        }
        rounds += ((last.x - begin.x) / LANES + 2u) * (last.y - begin.y + 2u);
        if column > last.x {
            continue;
        }
        let splat = splat_of(record, box, words);
        for (var x = column; x <= last.x; x += LANES) {
            for (var y = begin.y; y <= last.y; y++) {
                let touch = touch_of(splat, vec2<u32>(x, y));
                if touch.cover > 0.0 {
                    filled += u32(paint(splat, touch, y * frame.size_px.x + x));
                }
            }
        }
    }
    paint_cursors[cursor] = vec2<u32>(at - paint_list.tiles[group.x], filled);
    if at < list_end && filled < own_pixels {
        atomicAdd(&stats[0].paint_cut, 1u);
    }
}

@compute @workgroup_size(LANES)
fn paint_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    if PIXELWISE {
        paint_square(group.x, group.y, lane);
    } else {
        paint_band(group, groups, lane);
    }
}
