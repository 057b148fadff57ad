// Writes level 0 of the pull-push pyramid: ellipse, plane, colour and normal of the sample that each pixel shows. A thread takes samples in turns, and
// records those that won their pixels.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/large
//!include shared/splat
//!include CLIPS
//!include shared/sample_splats
//!include shared/lit_none
//!include shared/normals
//!include shared/colour
//!include shared/material
//!include shared/splat_paint
//!include shared/landing
//!include shared/lanes
//!include shared/portion_all
//!include shared/patches

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(2) @binding(1) var<storage, read> runs: array<Run>;
@group(2) @binding(2) var<uniform> segment: SegmentUse;
const NARROW: bool = true;

// Most slope of a disk towards the camera plane, as a share of the slope at which it reaches the plane. A disk that reaches the plane has no ellipse.
const STEEPEST: f32 = 0.8;
// Variance in square pixels below which an ellipse does not tell a slope.
const THIN: f32 = 0.09;

fn disk_patch(slot: SplatSlot, i: u32) -> Patch {
    let sample = slot.first + i;
    let f = frame.splat_cutoff;
    let whole = splat_centre(slot, i);
    let normal = attributes[sample].y;
    let axes = kernel_axes(kernels[sample * KERNEL_WORDS], slot.kernel_base, octahedral_decode(normal));
    var image = Tangents(taken(slot, axes.u), taken(slot, axes.v));
    var orientation = slot.orientation;
    var p = whole;
    if normal == NO_NORMAL {
        image = facing_axes(slot, p, axes);
        orientation = 0.0;
    } else {
        let kept = kept_part(clip_words(sample));
        p = whole + kept.centre.x * image.u + kept.centre.y * image.v;
        image = Tangents(kept.u.x * image.u + kept.u.y * image.v, kept.v.x * image.u + kept.v.y * image.v);
    }
    let w = 1.0 / divisor(p.z);
    let at_px = p.xy * w;
    var slopes = vec2<f32>(image.u.z, image.v.z) * w;
    var ju = (image.u.xy - at_px * tilt(image.u.z)) * w;
    var jv = (image.v.xy - at_px * tilt(image.v.z)) * w;
    let u = camera_vector(image.u);
    let v = camera_vector(image.v);
    var one: Patch;
    one.facing = facing_of(cross_2d(ju, jv), orientation);
    one.radius = f * sqrt(max(dot(u, u), dot(v, v))) * frame.focal_px.y * w + 0.5;
    if !ORTHOGRAPHIC {
        let shrunk = min(STEEPEST / max(f * length(slopes), 1e-20), 1.0);
        slopes *= shrunk;
        ju *= shrunk;
        jv *= shrunk;
    }
    let e = outline(vec2<f32>(ju.x, jv.x), vec2<f32>(ju.y, jv.y), slopes, ORTHOGRAPHIC);
    one.spread = f * f * vec3<f32>(e.xx, e.xy, e.yy);
    // The plane's slope as its disk shows it; what is seen edge-on shows none.
    let xx = dot(vec2<f32>(ju.x, jv.x), vec2<f32>(ju.x, jv.x)) + THIN / (f * f);
    let xy = dot(vec2<f32>(ju.x, jv.x), vec2<f32>(ju.y, jv.y));
    let yy = dot(vec2<f32>(ju.y, jv.y), vec2<f32>(ju.y, jv.y)) + THIN / (f * f);
    let with_value = (slopes.x * ju + slopes.y * jv) * select(-1.0, 1.0, ORTHOGRAPHIC);
    let determinant = max(xx * yy - xy * xy, 1e-20);
    let slope = vec2<f32>(yy * with_value.x - xy * with_value.y, xx * with_value.y - xy * with_value.x) / determinant;
    one.slope = slope * frame.focal_px;
    let centre = at_px + e.shift;
    if ORTHOGRAPHIC {
        one.value = p.z;
    } else {
        let change = clamp(1.0 + dot(slope, e.shift), 0.1, 10.0);
        one.value = w * change;
        one.slope /= change;
    }
    one.at = centre;
    return one;
}

@compute @workgroup_size(LANES)
fn record_samples(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return;
    }
    let slot = splat_slot(turn.slot);
    let here = frame.first_slot + slot.index;
    let count = slots[here].count;
    let parts = turn.parts & slots[here].parts;
    let longest = slot.kernel_base * slot.scale;
    let shared_paint = paint_slot(slot);
    for (var i = next_element(lane, parts, lane, count); i < count; i = next_element(i + LANES, parts, lane, count)) {
        let sample = slot.first + i;
        if TREE && !is_within_limits(sample, slot.limits) {
            continue;
        }
        let at = place_of(positions[sample], slot.row_x, slot.row_y, slot.row_z);
        let place = landing(at, sample, longest);
        if place == NO_PIXEL {
            continue;
        }
        let word = ~((slot.index << SLOT_SHIFT) | i);
        if visibility[place].x != word {
            continue;
        }
        var one = disk_patch(slot, i);
        one.word = word;
        let pixel = landing_pixel(at.image);
        one.at -= vec2<f32>(pixel) + vec2<f32>(0.5);
        if COLORS || NORMALS {
            let paint = paint_of(slot, shared_paint, i);
            one.color = paint.color;
            one.normal = 2.0 * paint.normal - vec3<f32>(1.0);
        }
        store_patch(patch_index(pixel, 0u, 0u), one);
    }
}
