// Draws triangles that are large or meet the camera plane, on adapters whose rasteriser is slower than this pass (CPUs). Eight
// threads, one CPU vector, take a triangle in a band of the image and walk the columns of its box there.
//
// Coverage is decided in 64-bit integers on the grid of project_triangles. A triangle that meets the camera plane has
// no corners to snap: there a pixel's ray is tested against the planes through the eye and each edge (Olano & Greer
// 1997), each computed in the same way for both triangles that share the edge.
//!include shared/frame
//!include shared/scene
//!include VISIBILITY
//!include shared/mesh
//!include shared/triangle
//!include shared/large
//!include shared/walk
//!include shared/edges
//!include ALPHA

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

struct Box {
    low: vec2<i32>,
    high: vec2<i32>,
}

struct Surface {
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
    id: u32,
    plane: Plane,
    texel: AlphaTest,
}

fn cover(s: Surface, at: vec2<i32>) {
    let ray = ray_through(vec2<f32>(at) + vec2<f32>(0.5));
    if alpha_passes(s.texel, ray) {
        triangle_write(s.plane, ray, frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x), s.id);
    }
}

// 0 where a pixel on the edge belongs to the triangle on its inner side, else −1: see project_triangles.
fn bias(edge: vec2<i64>) -> i64 {
    return select(-1li, 0li, edge.y < 0li || (edge.y == 0li && edge.x > 0li));
}

fn walk_snapped(s: Surface, box: Box, lane: i32) {
    let base = vec2<i64>(box.low) * 256li + vec2<i64>(128li);
    let a = vec2<i64>(snap(image_position(s.a))) - base;
    var b = vec2<i64>(snap(image_position(s.b))) - base;
    var c = vec2<i64>(snap(image_position(s.c))) - base;
    let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if area < 0li {
        let swap = b;
        b = c;
        c = swap;
    }
    let ab = b - a;
    let bc = c - b;
    let ca = a - c;
    let origin = vec3<i64>(
        ab.y * a.x - ab.x * a.y + bias(ab),
        bc.y * b.x - bc.x * b.y + bias(bc),
        ca.y * c.x - ca.x * c.y + bias(ca),
    );
    let step_x = vec3<i64>(ab.y, bc.y, ca.y) * -256li;
    let step_y = vec3<i64>(ab.x, bc.x, ca.x) * 256li;
    for (var x = box.low.x + lane; x <= box.high.x; x += LANES) {
        var e = origin + step_x * i64(x - box.low.x);
        for (var y = box.low.y; y <= box.high.y; y++) {
            if (e.x | e.y | e.z) >= 0li && area != 0li {
                cover(s, vec2<i32>(x, y));
            }
            e += step_y;
        }
    }
}

fn walk_rays(s: Surface, box: Box, lane: i32) {
    let turn = select(1.0, -1.0, facing(s.a, s.b, s.c) < 0.0);
    let a = image_vector(s.a);
    let b = image_vector(s.b);
    let c = image_vector(s.c);
    let ab = edge_plane(a, b) * turn;
    let bc = edge_plane(b, c) * turn;
    let ca = edge_plane(c, a) * turn;
    for (var x = box.low.x + lane; x <= box.high.x; x += LANES) {
        for (var y = box.low.y; y <= box.high.y; y++) {
            let ray = ray_through(vec2<f32>(f32(x), f32(y)) + vec2<f32>(0.5));
            if inside(ab, ray) && inside(bc, ray) && inside(ca, ray) {
                cover(s, vec2<i32>(x, y));
            }
        }
    }
}

fn triangle(id: u32, rows: vec2<i32>, lane: i32) -> u32 {
    let slot = frame.first_slot + (id >> SLOT_SHIFT);
    let chunk = chunks[slots[slot].chunk];
    let instance = slots[slot].instance;
    let at = placed[frame.first_instance + instance];
    let corners = corner_words(chunk.first + (id & SLOT_MASK), chunk.vertex_first);
    var s: Surface;
    s.id = id;
    s.a = vertex_camera(at, corners.x);
    s.b = vertex_camera(at, corners.y);
    s.c = vertex_camera(at, corners.z);
    s.plane = triangle_plane(s.a, s.b, s.c);
    s.texel = alpha_test(chunk, instance, corners, s.a, s.b, s.c);
    let bounds = image_bounds(s.a, s.b, s.c);
    let last = vec2<f32>(frame.size_px) - vec2<f32>(1.0);
    let low = vec2<i32>(clamp(floor(bounds.least - vec2<f32>(1.0)), vec2<f32>(0.0), last));
    let high = vec2<i32>(clamp(floor(bounds.most + vec2<f32>(1.0)), vec2<f32>(0.0), last));
    let box = Box(max(low, vec2<i32>(0, rows.x)), min(high, vec2<i32>(high.x, rows.y)));
    if bounds.snaps {
        walk_snapped(s, box, lane);
    } else {
        walk_rays(s, box, lane);
    }
    return walk_rounds(box.high.x - box.low.x, box.high.y - box.low.y);
}

fn walk_one(id: u32, rows: vec2<i32>, lane: u32) -> u32 {
    return triangle(id, rows, i32(lane));
}

@compute @workgroup_size(8)
fn walk_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    walk_list(group, groups.x, lane);
}
