// Normalisation, last of three passes (Zwicker et al. 2004, §6): divides the sums of pixels that show splats by their weights.
//!include shared/frame
//!include shared/scene
//!include shared/normals
//!include shared/kept
//!include shared/resolve_each

@group(0) @binding(5) var<storage, read> sums_0: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> sums_1: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read> sums_2: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read> sums_3: array<vec2<u32>>;

// Normals and depths were blended, for lighting here or for another use. Otherwise splats were lit singly or there are no lights.
override DEFERRED: bool = true;
// Surfaces without a preferred direction are lit as balls.
override BALLS: bool = false;
// Splats were lit one by one before they were blended, in a frame whose other pixels are lit: their normals light nothing any more.
override LIT_SINGLY: bool = false;

// Largest squared length that rounding leaves of unknown normals.
const LEAST_NORMAL: f32 = 1e-4;

fn is_ball(sums: vec3<u32>, inverse_weight: f32) -> bool {
    let n = fma(vec3<f32>(sums), vec3<f32>(2.0 * inverse_weight), vec3<f32>(-1.0));
    return dot(n, n) >= LEAST_NORMAL && dot(n, n) < LONGEST_BALL * LONGEST_BALL;
}

fn blended_normal(sums: vec3<u32>, inverse_weight: f32, at: vec2<u32>) -> vec3<f32> {
    let n = fma(vec3<f32>(sums), vec3<f32>(2.0 * inverse_weight), vec3<f32>(-1.0));
    if dot(n, n) < LEAST_NORMAL {
        return vec3<f32>(0.0);
    }
    return facing_normal(n, world_from_camera(towards(ray_through(pixel_centre(at)))));
}

fn resolve(column: Column) {
    let pixel = column.pixel;
    let at = column.at;
    var surface: Surface;
    surface.slot = slot_of(column.word);
    if needs_id() {
        surface.id = instances[slots[frame.first_slot + surface.slot].instance].id;
        finish(pixel, at, surface);
        return;
    }
    let first = sums_0[pixel];
    let second = sums_1[pixel];
    let inverse_weight = 1.0 / max(f32(first.y), 1.0);
    // Splats count behind the nearest one as well: the offset is taken back.
    surface.inverse_depth = bitcast<f32>(column.word.y & ~FACING_BITS);
    surface.depth_scale = 1.0;
    if needs_depth() {
        surface.depth_scale = fma(f32(second.y), 4294967296.0, f32(second.x)) / DEPTH_ONE * inverse_weight;
    } else if !needs_color() {
        surface.normal = blended_normal(vec3<u32>(first.x, second.xy), inverse_weight, at);
    } else {
        surface.color = vec3<f32>(vec3<u32>(first.x, second.xy)) * inverse_weight;
        if DEFERRED {
            let third = sums_2[pixel];
            let fourth = sums_3[pixel];
            let sums = vec3<u32>(third.xy, fourth.x);
            surface.is_ball = BALLS && is_ball(sums, inverse_weight);
            surface.normal = select(blended_normal(sums, inverse_weight, at), vec3<f32>(0.0), surface.is_ball);
            if LIT_SINGLY {
                surface.normal = vec3<f32>(0.0);
                surface.is_ball = false;
            }
            surface.depth_scale = clamp(f32(fourth.y) * inverse_weight, 1e-6, 1.0);
        }
    }
    finish(pixel, at, surface);
}

@compute @workgroup_size(64)
fn resolve_splats(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    // Slots of samples precede all others.
    let last = runs[frame.first_run + max(frame.sample_segments, 1u) - 1u];
    let count = select(0u, last.first_slot + last.count, frame.sample_segments != 0u);
    let resolved = resolve_each(group, lane, Run(0u, count));
    if resolved != 0u {
        atomicAdd(&stats[frame.view].pixels_of_samples, resolved);
    }
}
