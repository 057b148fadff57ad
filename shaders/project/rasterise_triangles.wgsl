// Draws triangles that are large or meet the camera plane with the adapter's rasteriser and clipper, into the shared
// visibility buffer. Depth is not interpolated but computed from the triangle's plane, as in the compute walk.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/mesh
//!include shared/triangle
//!include shared/large
//!include ALPHA

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(0) @binding(4) var<storage, read> stats: array<u32>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;
@group(2) @binding(4) var<storage, read> large: array<u32>;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) id: u32,
    @location(1) @interpolate(flat) view: u32,
}

fn corner_positions(id: u32) -> array<vec3<f32>, 3> {
    let slot = frame.first_slot + (id >> SLOT_SHIFT);
    let chunk = chunks[slots[slot].chunk];
    let at = placed[frame.first_instance + slots[slot].instance];
    let corners = corner_words(chunk.first + (id & SLOT_MASK), chunk.vertex_first);
    return array<vec3<f32>, 3>(
        vertex_camera(at, corners.x), vertex_camera(at, corners.y), vertex_camera(at, corners.z));
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    begin_view(0u);
    // All corners coincide, so nothing is covered.
    let nowhere = Corner(vec4<f32>(0.0, 0.0, 0.0, 1.0), 0u, 0u);
    if !list_is_whole(stats[STAT_LARGE_LONGEST]) {
        return nowhere;
    }
    // All views have one size, so the draw's viewport suits each of them; the attachment is not used.
    let entry = LIST_HEAD + index / 3u * LIST_ENTRY;
    let id = large[entry];
    let view = list_view(large[entry + 1u]);
    begin_view(view);
    let counters = view * STATS_WORDS;
    if !may_draw(stats[counters + STAT_LARGE_UNITS], stats[counters + STAT_LARGE_WRAPPED]) {
        return nowhere;
    }
    let p = corner_positions(id);
    let camera = p[index % 3u];
    let size = vec2<f32>(frame.size_px);
    var out: Corner;
    out.id = id;
    out.view = view;
    let near = min(p[0].z, min(p[1].z, p[2].z));
    let w = divisor(camera.z);
    var clip = vec4<f32>(
        (2.0 * (frame.focal_px * camera.xy + frame.principal_px * w) - size * w) / size * vec2<f32>(1.0, -1.0),
        0.5 * w,
        w,
    );
    if ORTHOGRAPHIC || near > NEAREST {
        let pixel = image_position(camera);
        if all(abs(pixel) < vec2<f32>(GUARD_PX)) {
            // The corner is already snapped: the rasteriser gets the corner that the compute walk uses.
            let snapped = round(pixel * 256.0) / 256.0;
            clip = vec4<f32>((2.0 * snapped / size - vec2<f32>(1.0)) * vec2<f32>(1.0, -1.0), 0.5, 1.0);
        }
    }
    out.position = clip;
    return out;
}

@fragment
fn fragment(in: Corner) {
    begin_view(in.view);
    let x = u32(in.position.x);
    let y = u32(in.position.y);
    let ray = ray_through(vec2<f32>(f32(x), f32(y)) + vec2<f32>(0.5));
    let p = corner_positions(in.id);
    let slot = frame.first_slot + (in.id >> SLOT_SHIFT);
    let chunk = chunks[slots[slot].chunk];
    let corners = corner_words(chunk.first + (in.id & SLOT_MASK), chunk.vertex_first);
    let test = alpha_test(chunk, slots[slot].instance, corners, p[0], p[1], p[2]);
    if x < frame.size_px.x && y < frame.size_px.y && alpha_passes(test, ray) {
        triangle_write(triangle_plane(p[0], p[1], p[2]), ray, frame.first_pixel + y * frame.size_px.x + x, in.id);
    }
}
