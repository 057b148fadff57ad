// Tests which entries (chunk × instance) meet the view frustum and, for point trees, the accepted error. The pass keeps each
// visible entry's rank within its workgroup and each workgroup's count for the scan, so that the slot order is deterministic.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include shared/portions
//!include ENTRIES

@group(1) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(2) @binding(0) var<storage, read> placed: array<Placed>;
@group(2) @binding(1) var<storage, read_write> ranks: array<u32>;
@group(2) @binding(2) var<storage, read_write> group_counts: array<u32>;
@group(2) @binding(3) var<storage, read_write> depths: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;

// Occlusion culling is on.
override HIDES: bool = false;
// Translucent surfaces are laid over the image, and hide nothing.
override COMPOSITES: bool = false;

const NOT_VISIBLE: u32 = 0xffffffffu;
const NO_INSTANCE: u32 = 0xffffffffu;

// Distance that splats extend beyond their centres, and lines beyond their axes; 0 for points and triangles.
fn reach_of(chunk: Chunk, scale: f32, box: Box) -> f32 {
    if chunk.kind == SEGMENTS {
        return line_reach(chunk, scale, box);
    }
    if chunk.kind != SAMPLES {
        return 0.0;
    }
    return splat_reach(chunk, scale);
}

// The low-pass filter widens splats in the image, and points of nodes cover pixels beside their own.
fn is_wanted(chunk: Chunk, box: Box, scale: f32, radius: f32) -> bool {
    let deep = box_deep(box);
    let margin = select(frame.splat_cutoff * frame.splat_lowpass_px, LINE_FILTER_PX, chunk.kind == SEGMENTS);
    return chunk_is_wanted(chunk, scale, box.centre.z - deep, box.centre.z + deep, box_far(box))
        && box_is_seen(box.centre, box.x, box.y, box.z, radius, margin + node_px());
}

// Extends the bounds of everything that may be drawn.
fn note_bounds(least: vec2<f32>, most: vec2<f32>) {
    let size = vec2<f32>(frame.size_px);
    let begin = vec2<u32>(clamp(floor(least), vec2<f32>(0.0), size));
    let end = vec2<u32>(clamp(ceil(most), vec2<f32>(0.0), size));
    atomicMax(&stats[frame.view].drawn_before[0], frame.size_px.x - begin.x);
    atomicMax(&stats[frame.view].drawn_before[1], frame.size_px.y - begin.y);
    atomicMax(&stats[frame.view].drawn_end[0], end.x);
    atomicMax(&stats[frame.view].drawn_end[1], end.y);
}

// Adds a chunk's image cover to the bin of its nearest depth.
fn note_depth(box: Box, index: u32) {
    let bounds = box_bounds(box);
    // A dither from the index rounds fractions of a part, so that many chunks sum to about the exact cover.
    let parts = u32(cover_of(bounds) * f32(COVER_ONE) + fract(f32(index & 0xffffu) * 0.618034));
    if parts > 0u {
        let at = frame.view * DEPTHS_WORDS + depth_bin(bounds.near);
        let rows = vec2<u32>(clamp(vec2<f32>(bounds.least.y, bounds.most.y), vec2<f32>(0.0), vec2<f32>(f32(frame.size_px.y))));
        atomicAdd(&depths[at], parts);
        // Rows are counted from the last one, so that no value is 0.
        atomicMax(&depths[at + DEPTH_TOPS], frame.size_px.y - rows.x);
        atomicMax(&depths[at + DEPTH_BOTTOMS], rows.y);
    }
}

// One thread takes a group of entries: that needs no barrier, which costs more than the work on a CPU adapter.
const GROUP: u32 = 32u;

@compute @workgroup_size(32)
fn cull(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let group = invocation.x + invocation.y * DISPATCH_ROW * 32u;
    let first = group * GROUP;
    if first >= entry_count() {
        return;
    }
    // A splat fills at least one pixel.
    let filter_px = max(select(0.0, max(frame.splat_cutoff * frame.splat_lowpass_px, 1.0), frame.splat_cutoff > 0.0), node_px());
    var walk = walk_from(first);
    var rank = 0u;
    var least = vec2<f32>(frame.size_px);
    var most = vec2<f32>(0.0);
    for (var k = 0u; k < GROUP; k++) {
        let entry = walk_next(&walk);
        var mine = NOT_VISIBLE;
        if entry.instance != NO_INSTANCE {
            let chunk = chunks[entry.chunk];
            let at = placed[frame.first_instance + entry.instance];
            let box = grid_box(at, chunk.origin, chunk.extent);
            let scale = stretch(at);
            let reach = reach_of(chunk, scale, box);
            if is_wanted(chunk, box, scale, reach) {
                mine = rank;
                rank++;
                let bounds = drawn_bounds(Box(box.centre, box.x, box.y, box.z, box.slack + reach), select(filter_px, LINE_FILTER_PX, chunk.kind == SEGMENTS));
                least = min(least, bounds.least);
                most = max(most, bounds.most);
                if HIDES && !(COMPOSITES && (chunk.flags & CHUNK_TRANSLUCENT) != 0u) {
                    note_depth(box, first + k);
                }
            }
        }
        ranks[frame.first_entry + first + k] = mine;
    }
    group_counts[frame.first_group + group] = rank;
    if rank > 0u {
        note_bounds(least, most);
    }
}
