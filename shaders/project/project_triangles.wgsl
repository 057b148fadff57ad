// Triangles of a few pixels: a thread takes one and walks its box. Coverage is decided in fixed point (1/256 pixel,
// top-left rule), so that triangles that share an edge share every pixel's verdict; larger ones and those that meet the
// camera plane are listed for the rasteriser, which snaps to the same grid.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/mesh
//!include shared/triangle
//!include shared/list
//!include ALPHA

const COUNTS: bool = FIRST_HALF;

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// Whether a pixel on the edge from `a` to `b` belongs to the triangle on its inner side (left or top edge, y down).
fn bias(edge: vec2<i32>) -> i32 {
    return select(-1, 0, edge.y < 0 || (edge.y == 0 && edge.x > 0));
}

fn walk(p: array<vec2<i32>, 3>, low: vec2<i32>, high: vec2<i32>, plane: Plane, id: u32, texel: AlphaTest) {
    // Relative to the first pixel's centre, so that products stay below 2^31.
    let base = low * 256 + vec2<i32>(128);
    let a = p[0] - base;
    let b = p[1] - base;
    let c = p[2] - base;
    let ab = b - a;
    let bc = c - b;
    let ca = a - c;
    var row = vec3<i32>(
        ab.y * a.x - ab.x * a.y + bias(ab),
        bc.y * b.x - bc.x * b.y + bias(bc),
        ca.y * c.x - ca.x * c.y + bias(ca),
    );
    let step_x = vec3<i32>(ab.y, bc.y, ca.y) * -256;
    let step_y = vec3<i32>(ab.x, bc.x, ca.x) * 256;
    for (var y = low.y; y <= high.y; y++) {
        var e = row;
        for (var x = low.x; x <= high.x; x++) {
            if (e.x | e.y | e.z) >= 0 {
                let ray = ray_through(vec2<f32>(f32(x), f32(y)) + vec2<f32>(0.5));
                if alpha_passes(texel, ray) {
                    visibility_write(frame.first_pixel + u32(y) * frame.size_px.x + u32(x), plane_inverse_depth(plane, ray), id);
                }
            }
            e += step_x;
        }
        row += step_y;
    }
}

fn list_triangle(id: u32, bounds: ImageBounds) {
    let last = vec2<f32>(frame.size_px) - vec2<f32>(1.0);
    let low = vec2<u32>(clamp(bounds.least - vec2<f32>(1.0), vec2<f32>(0.0), last));
    let high = vec2<u32>(clamp(bounds.most + vec2<f32>(1.0), vec2<f32>(0.0), last));
    list_large(id, low, high);
    if COUNTS {
        atomicAdd(&stats[frame.view].triangles_rasterised, 1u);
    }
}

fn triangle(slot_index: u32, at: Placed, chunk: Chunk, one_sided: f32, index: u32) {
    let id = (slot_index << SLOT_SHIFT) | index;
    let corners = corner_words(chunk.first + index, chunk.vertex_first);
    let a = vertex_camera(at, corners.x);
    let b = vertex_camera(at, corners.y);
    let c = vertex_camera(at, corners.z);
    // All behind the eye.
    if max(a.z, max(b.z, c.z)) <= NEAREST {
        return;
    }
    // Seen from behind: the normal points away from the eye.
    if one_sided * facing(a, b, c) > 0.0 {
        return;
    }
    let bounds = image_bounds(a, b, c);
    let size = vec2<f32>(frame.size_px);
    if any(bounds.most < vec2<f32>(-1.0)) || any(bounds.least > size + vec2<f32>(1.0)) {
        return;
    }
    if !bounds.snaps {
        list_triangle(id, bounds);
        return;
    }
    var p = array<vec2<i32>, 3>(snap(image_position(a)), snap(image_position(b)), snap(image_position(c)));
    let ab = p[1] - p[0];
    let ac = p[2] - p[0];
    // First and last pixel whose centre the box may hold.
    let snapped_least = min(p[0], min(p[1], p[2]));
    let snapped_most = max(p[0], max(p[1], p[2]));
    let low = max((snapped_least + vec2<i32>(127)) >> vec2<u32>(8u), vec2<i32>(0));
    let high = min((snapped_most - vec2<i32>(128)) >> vec2<u32>(8u), vec2<i32>(frame.size_px) - vec2<i32>(1));
    if any(high < low) {
        return;
    }
    let box = snapped_most - snapped_least;
    if max(box.x, box.y) > frame.small_triangle_px * 256 {
        list_triangle(id, bounds);
        return;
    }
    let area = ab.x * ac.y - ab.y * ac.x;
    if area == 0 {
        return;
    }
    if area < 0 {
        let swap = p[1];
        p[1] = p[2];
        p[2] = swap;
    }
    walk(p, low, high, triangle_plane(a, b, c), id, alpha_test(chunk, slots[frame.first_slot + slot_index].instance, corners, a, b, c));
}

@compute @workgroup_size(64)
fn project_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let index = group.y * DISPATCH_ROW + group.x;
    let run = runs[frame.first_run + segment.index];
    if index >= run.count {
        return;
    }
    let slot_index = run.first_slot + index;
    let slot = slots[frame.first_slot + slot_index];
    let chunk = chunks[slot.chunk];
    let instance = slot.instance;
    let at = placed[frame.first_instance + instance];
    let material = effective_material(materials[chunk.material], instances[instance].material);
    var one_sided = 0.0;
    if (material.flags & MATERIAL_DOUBLE_SIDED) == 0u {
        one_sided = select(1.0, -1.0, instances[instance].mirrored != 0u);
    }
    for (var i = lane; i < chunk.count; i += 64u) {
        triangle(slot_index, at, chunk, one_sided, i);
    }
}
