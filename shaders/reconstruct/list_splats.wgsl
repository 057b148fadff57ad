// Writes the record and the key of each splat that is painted.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/normals
//!include shared/splat
//!include CLIPS
//!include shared/sample_splats
//!include shared/splat_paint
//!include LIT
//!include shared/painted
//!include shared/gather

const NARROW: bool = false;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(5) var<storage, read_write> paint_list: PaintList;
@group(0) @binding(7) var<storage, read_write> paint_records: array<vec4<u32>>;
@group(0) @binding(8) var<storage, read_write> sort_to: array<vec2<u32>>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;

// A share of one as 16 bits, rounded by the shader because drivers round differently.
fn share_16(value: f32) -> u32 {
    return u32(fma(clamp(value, 0.0, 1.0), 65535.0, 0.5));
}

// A linear function of the offset from a place of the image as one of the offset from another place.
fn moved(form: vec3<f32>, by: vec2<f32>) -> vec3<f32> {
    return vec3<f32>(linear(form, by), form.yz);
}

// The divisor of kernel coordinates as a multiple of 1/z: both are linear, and vanish at the horizon of the splat's plane. 0 where it is 1.
fn divisor_scale(splat: Splat) -> f32 {
    let sizes = abs(splat.inverse);
    let most = max(sizes.x, max(sizes.y, sizes.z));
    var scale = splat.n.x / splat.inverse.x;
    if sizes.y == most {
        scale = splat.n.y / splat.inverse.y;
    }
    if sizes.z == most {
        scale = splat.n.z / splat.inverse.z;
    }
    return select(scale, 0.0, all(splat.n.yz == vec2<f32>(0.0)));
}

var<private> shared_paint: PaintSlot;
var<private> place: u32;

fn begin_slot(slot: SplatSlot) {
    shared_paint = paint_slot(slot);
}

fn take(slot: SplatSlot, i: u32, tally: ptr<function, Tally>) {
    let own_place = place;
    place++;
    let splat = splat_of(slot, i);
    if splat.way == NOTHING || any(splat.high < splat.low) {
        return;
    }
    (*tally).scattered++;
    (*tally).crossing += u32(splat.crosses);
    let paint = paint_of(slot, shared_paint, i);
    let at = record_of(own_place);
    // Offsets count from the centre of the box's first pixel.
    let by = vec2<f32>(splat.low) + vec2<f32>(0.5) - splat.centre;
    let s = bitcast<vec3<u32>>(moved(splat.s, by));
    let t = bitcast<vec3<u32>>(moved(splat.t, by));
    let inverse = bitcast<vec3<u32>>(moved(splat.inverse, by));
    let color = vec3<u32>(share_16(paint.color.r), share_16(paint.color.g), share_16(paint.color.b));
    let low = vec2<u32>(splat.low);
    let high = vec2<u32>(splat.high);
    paint_records[at] = vec4<u32>(s, bitcast<u32>(divisor_scale(splat)));
    paint_records[at + 1u] = vec4<u32>(t, bitcast<u32>(splat.least));
    paint_records[at + 2u] = vec4<u32>(inverse, bitcast<u32>(splat.most));
    paint_records[at + 3u] = vec4<u32>(
        low.x | (low.y << 16u),
        high.x | (high.y << 16u),
        color.r | (color.g << 16u),
        color.b,
    );
    paint_records[at + 4u] = vec4<u32>(bitcast<u32>(splat.offset), splat.facing, bitcast<u32>(splat.amplitude), 0u);
    if CLIPPED {
        let lines = clip_record(splat.clip, by);
        paint_records[at + RECORD] = lines[0];
        paint_records[at + RECORD + 1u] = lines[1];
    }
    let centre = camera_place(splat_centre(slot, i));
    let distance = select(length(centre), abs(centre.z), ORTHOGRAPHIC);
    let key = bitcast<u32>(clamp(distance, 1e-30, 1e30));
    sort_to[own_place] = vec2<u32>(key, with_tiles(own_place, tiles_of_box(vec4<u32>(low, high))));
    (*tally).farthest = max((*tally).farthest, key);
    (*tally).nearest = max((*tally).nearest, ~key);
}

@compute @workgroup_size(LANES)
fn list_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if paint_list.places == 0u {
        return;
    }
    begin_view(group.z);
    let index = runs[frame.first_run + segment.index].first_slot + group.y * DISPATCH_ROW + group.x;
    place = paint_list.begins[min(index * LANES + lane, arrayLength(&paint_list.begins) - 1u)];
    let tally = gather(group, lane);
    if TREE && tally.looked_at != 0u {
        count_samples(tally.looked_at);
    }
    if tally.scattered != 0u {
        atomicMax(&paint_list.farthest, tally.farthest);
        atomicMax(&paint_list.nearest, tally.nearest);
        atomicAdd(&stats[frame.view].splats_scattered, tally.scattered);
        atomicAdd(&stats[frame.view].splats_clipped, tally.crossing);
    }
}
