// Empties what the passes of all views gather in: visibility buffer, counters, list of large triangles, dispatches.
//!include shared/frame
//!include shared/scene

@group(0) @binding(1) var<storage, read_write> visibility: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<u32>;
@group(2) @binding(1) var<storage, read_write> dispatches: array<u32>;
@group(2) @binding(2) var<storage, read_write> portions: array<u32>;
@group(2) @binding(3) var<storage, read_write> depths: array<u32>;
@group(2) @binding(4) var<storage, read_write> large: array<u32, 4>;

// Pairs of pixels a thread takes, 64 apart.
const PAIRS_EACH: u32 = 16u;

@compute @workgroup_size(64)
fn clear(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(0u);
    let pairs = (frame.views * frame.size_px.x * frame.size_px.y + 1u) / 2u;
    for (var k = 0u; k < PAIRS_EACH; k++) {
        let pair = ((group.y * DISPATCH_ROW + group.x) * PAIRS_EACH + k) * 64u + lane;
        if pair < pairs {
            visibility[pair] = vec4<u32>(0u);
        }
    }
    if group.x == 0u && group.y == 0u {
        let counters = min(frame.views * STATS_WORDS, arrayLength(&stats));
        for (var i = lane; i < counters; i += 64u) {
            stats[i] = 0u;
        }
        for (var i = lane; i < arrayLength(&dispatches); i += 64u) {
            dispatches[i] = 0u;
        }
        for (var i = lane; i < arrayLength(&portions); i += 64u) {
            portions[i] = 0u;
        }
        for (var i = lane; i < arrayLength(&depths); i += 64u) {
            depths[i] = 0u;
        }
    }
    if group.x == 0u && group.y == 0u && lane < 4u {
        large[lane] = select(0u, 1u, lane == 1u);
    }
}
