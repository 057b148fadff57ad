// Draws triangles of a few pixels: a thread takes one triangle and walks its box. Coverage is decided in fixed point
// (1/256 pixel, top-left rule), so that triangles that share an edge agree about every pixel. Larger triangles and those that
// meet the camera plane are listed for the rasteriser, which snaps to the same grid.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/mesh
//!include shared/triangle
//!include shared/list
//!include shared/lanes
//!include shared/sorts
//!include VOTE
//!include PORTION
//!include ALPHA

const COUNTS: bool = FIRST_HALF;

// Chunks are translucent as a whole, and so are instances with translucent colours of their own.
fn is_of_sort(chunk: Chunk, instance_flags: u32) -> bool {
    let alpha = select(255u, 254u, (chunk.flags & CHUNK_TRANSLUCENT) != 0u);
    return is_drawn_with(alpha, instance_flags) && (instance_flags & INSTANCE_CLEAR) == 0u;
}

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// Whether a pixel on the edge from `a` to `b` belongs to the triangle on its inner side (left or top edge, y down).
fn bias(edge: vec2<i32>) -> i32 {
    return select(-1, 0, edge.y < 0 || (edge.y == 0 && edge.x > 0));
}

fn list_triangle(id: u32, bounds: ImageBounds) {
    let last = vec2<f32>(frame.size_px) - vec2<f32>(1.0);
    let rows = drawn_rows();
    let low = vec2<u32>(clamp(bounds.least - vec2<f32>(1.0), vec2<f32>(0.0), last));
    let high = vec2<u32>(clamp(bounds.most + vec2<f32>(1.0), vec2<f32>(0.0), last));
    let first = max(low.y, rows.x);
    let behind = min(high.y + 1u, rows.y);
    if first >= behind {
        return;
    }
    list_large(id, vec2<u32>(low.x, first), vec2<u32>(high.x, behind - 1u));
    // A triangle counts in the window where it begins.
    if COUNTS && draws_pixel(frame.first_pixel + low.y * frame.size_px.x + low.x) {
        atomicAdd(&stats[frame.view].triangles_rasterised, 1u);
    }
}

// On lavapipe all loops of a thread and of its vector share 65535 rounds; code after the last round never runs. A triangle
// is listed when no rounds are left for it.
const ROUNDS: u32 = 60000u;

// Returns an upper bound of the walk's rounds. A CPU's vector of threads executes both branches, so expensive code stands once.
fn triangle(slot_index: u32, at: Placed, chunk: Chunk, one_sided: f32, index: u32, rounds: u32) -> u32 {
    let id = (slot_index << SLOT_SHIFT) | index;
    let corners = corner_words(chunk.first + index, chunk.vertex_first);
    let a = vertex_camera(at, corners.x);
    let b = vertex_camera(at, corners.y);
    let c = vertex_camera(at, corners.z);
    let bounds = image_bounds(a, b, c);
    let size = vec2<f32>(frame.size_px);
    // Rejects triangles wholly behind the eye, seen from behind (the normal points away from the eye) or beside the image.
    let seen = max(a.z, max(b.z, c.z)) > NEAREST
        && !(one_sided * facing(a, b, c) > 0.0)
        && !any(bounds.most < vec2<f32>(-1.0)) && !any(bounds.least > size + vec2<f32>(1.0));
    let pa = snap(image_position(a));
    var pb = snap(image_position(b));
    var pc = snap(image_position(c));
    // First and last pixel whose centre the box may contain.
    let snapped_least = min(pa, min(pb, pc));
    let snapped_most = max(pa, max(pb, pc));
    let rows = vec2<i32>(drawn_rows());
    let low = max((snapped_least + vec2<i32>(127)) >> vec2<u32>(8u), vec2<i32>(0, rows.x));
    let high = min((snapped_most - vec2<i32>(128)) >> vec2<u32>(8u), vec2<i32>(i32(frame.size_px.x), rows.y) - vec2<i32>(1));
    let box = snapped_most - snapped_least;
    let holds = all(high >= low);
    let longest = u32(frame.small_triangle_px) + 1u;
    let small = bounds.snaps && max(box.x, box.y) <= frame.small_triangle_px * 256;
    let pixels = vec2<u32>(high - low + vec2<i32>(1));
    let wanted = select(0u, pixels.x * pixels.y, seen && small && holds);
    // Rounds of the search and of the pixels that it finds.
    let most = most_of_lanes(wanted, longest * longest) + 2u;
    let walks = rounds + most <= ROUNDS;
    if seen && select(!bounds.snaps || holds, holds && !walks, small) {
        list_triangle(id, bounds);
    }
    let ab0 = pb - pa;
    let ac0 = pc - pa;
    // Boxes larger than the walk's limit overflow here; their result is not used.
    let area = ab0.x * ac0.y - ab0.y * ac0.x;
    if area < 0 {
        let swap = pb;
        pb = pc;
        pc = swap;
    }
    let plane = triangle_plane(a, b, c);
    let texel = alpha_test(chunk, slots[frame.first_slot + slot_index].instance, corners, a, b, c);
    // Relative to the first pixel's centre, so that products stay below 2^31.
    let base = low * 256 + vec2<i32>(128);
    let ra = pa - base;
    let rb = pb - base;
    let rc = pc - base;
    let ab = rb - ra;
    let bc = rc - rb;
    let ca = ra - rc;
    var row = vec3<i32>(
        ab.y * ra.x - ab.x * ra.y + bias(ab),
        bc.y * rb.x - bc.x * rb.y + bias(bc),
        ca.y * rc.x - ca.x * rc.y + bias(ca),
    );
    let step_x = vec3<i32>(ab.y, bc.y, ca.y) * -256;
    let step_y = vec3<i32>(ab.x, bc.x, ca.x) * 256;
    var x = low.x;
    var y = select(high.y + 1, low.y, wanted != 0u && walks && area != 0);
    var e = row;
    loop {
        if y > high.y {
            break;
        }
        let ray = ray_through(vec2<f32>(f32(x), f32(y)) + vec2<f32>(0.5));
        if (e.x | e.y | e.z) >= 0 && alpha_passes(texel, ray) {
            triangle_write(plane, ray, frame.first_pixel + u32(y) * frame.size_px.x + u32(x), id);
        }
        x++;
        e += step_x;
        if x > high.x {
            x = low.x;
            y++;
            row += step_y;
            e = row;
        }
    }
    return most;
}

@compute @workgroup_size(LANES)
fn project_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let turn = turn_of(group.y * DISPATCH_ROW + group.x);
    if turn.parts == 0u {
        return;
    }
    let slot = slots[frame.first_slot + turn.slot];
    let chunk = chunks[slot.chunk];
    let instance = slot.instance;
    if !is_of_sort(chunk, instances[instance].flags) {
        return;
    }
    let at = placed[frame.first_instance + instance];
    let material = effective_material(materials[chunk.material], instances[instance].material);
    var one_sided = 0.0;
    // Clip boxes open what is closed.
    if CLIP_BOXES == 0u && (material.flags & MATERIAL_DOUBLE_SIDED) == 0u {
        one_sided = select(1.0, -1.0, (instances[instance].flags & INSTANCE_MIRRORED) != 0u);
    }
    var rounds = 0u;
    var i = next_element(lane, turn.parts, lane, chunk.count);
    while i < chunk.count {
        rounds += triangle(turn.slot, at, chunk, one_sided, i, rounds);
        i = next_element(i + LANES, turn.parts, lane, chunk.count);
    }
}
