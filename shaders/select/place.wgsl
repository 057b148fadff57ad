// Places each instance relative to this frame's eye.
//
// The eye may be 1e7 units from the world's origin and a millimetre from the surface. The pass therefore chooses a grid point
// near the eye, the anchor, for each instance. It sums the anchor's camera-space position with an error-free addition, from
// terms that are exact in f32: two-float origins, and anchors with at most 12 significant bits times axes split into two
// halves. The other passes only add small integers to that position.
//!include shared/frame
//!include shared/scene
//!include MEMBERS

@group(1) @binding(0) var<storage, read> instances: array<Instance>;
@group(2) @binding(0) var<storage, read_write> placed: array<Placed>;
@group(2) @binding(1) var<storage, read_write> seen: array<u32>;

// A running sum and its rounding error (Knuth's two-sum).
struct Sum {
    head: vec3<f32>,
    tail: vec3<f32>,
}

// Hides a value from compilers that treat floats as real numbers and would cancel the error term (Mesa does). No frame
// is 2^31 pixels wide, so the bits stay unchanged.
fn opaque(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) ^ vec3<u32>(frame.size_px.x >> 31u));
}

fn add(sum: Sum, term: vec3<f32>) -> Sum {
    let head = opaque(sum.head + term);
    let part = opaque(head - sum.head);
    let lost = (sum.head - (head - part)) + (term - part);
    return Sum(head, sum.tail + lost);
}

// The upper 12 bits of the mantissa: its product with a 12-bit integer is exact.
fn upper(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) & vec3<u32>(0xfffff000u));
}

@compute @workgroup_size(64)
fn place(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let index = member(invocation.x + invocation.y * DISPATCH_ROW * 64u);
    if index >= frame.instance_count {
        return;
    }
    let instance = instances[index];
    var offset = Sum(instance.origin_hi.xyz, vec3<f32>(0.0));
    offset = add(offset, -frame.eye_hi.xyz);
    offset = add(offset, instance.origin_lo.xyz);
    offset = add(offset, -frame.eye_lo.xyz);
    let from_eye = offset.head + offset.tail;

    // The eye's position on the grid, clamped to the asset and cut to 12 significant bits.
    let eye_grid = -vec3<f32>(
        dot(instance.inverse_x.xyz, from_eye),
        dot(instance.inverse_y.xyz, from_eye),
        dot(instance.inverse_z.xyz, from_eye),
    );
    let cell = max(instance.reach / 2048.0, 1.0);
    // NaN where products overflowed: at that distance any anchor will do.
    let known = select(vec3<f32>(0.0), eye_grid, eye_grid == eye_grid);
    let inside = clamp(known, vec3<f32>(-instance.reach), vec3<f32>(instance.reach));
    let anchor = vec3<i32>(upper(round(inside / cell) * cell));
    let a = vec3<f32>(anchor);

    let axis_x = instance.axis_x.xyz;
    let axis_y = instance.axis_y.xyz;
    let axis_z = instance.axis_z.xyz;
    offset = add(offset, upper(axis_x) * a.x);
    offset = add(offset, upper(axis_y) * a.y);
    offset = add(offset, upper(axis_z) * a.z);
    offset = add(offset, (axis_x - upper(axis_x)) * a.x);
    offset = add(offset, (axis_y - upper(axis_y)) * a.y);
    offset = add(offset, (axis_z - upper(axis_z)) * a.z);

    var out: Placed;
    out.axis_x = vec4<f32>(camera_from_world(axis_x), 0.0);
    out.axis_y = vec4<f32>(camera_from_world(axis_y), 0.0);
    out.axis_z = vec4<f32>(camera_from_world(axis_z), 0.0);
    // NaN counts as within the reach.
    var outside = any(abs(known) > vec3<f32>(instance.reach + 1.0)) && all(eye_grid == eye_grid);
    let position = camera_position(offset.head + offset.tail);
    if ORTHOGRAPHIC {
        // The box lies wholly before the plane through the eye.
        let deep = abs(out.axis_x.z) + abs(out.axis_y.z) + abs(out.axis_z.z);
        let middle = camera_position(from_eye).z;
        outside = middle - instance.reach * deep > 1e-6 * (abs(middle) + frame.focus);
    }
    out.position = vec4<f32>(position, f32(outside));
    out.anchor = vec4<i32>(anchor, 0);
    placed[frame.first_instance + index] = out;
    seen[frame.first_instance + index] = 0u;
}
