// Normals of samples and vertices in world space.

// Rows of grid_from_world: what takes an instance's normals to world space, up to length.
struct NormalMap {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

fn normal_map(instance: u32) -> NormalMap {
    return NormalMap(instances[instance].inverse_x.xyz, instances[instance].inverse_y.xyz, instances[instance].inverse_z.xyz);
}

// A normal in world space, up to length.
fn turned(map: NormalMap, local: vec3<f32>) -> vec3<f32> {
    return map.x * local.x + map.y * local.y + map.z * local.z;
}

// Unit length, or zero.
fn unit_or_zero(v: vec3<f32>) -> vec3<f32> {
    let a = abs(v);
    let most = max(a.x, max(a.y, a.z));
    if !(most > 0.0) {
        return vec3<f32>(0.0);
    }
    let scaled = v / most;
    return scaled / length(scaled);
}

// Unit length and turned towards the eye, or zero.
fn facing_normal(m: vec3<f32>, towards: vec3<f32>) -> vec3<f32> {
    let n = unit_or_zero(m);
    return select(n, -n, dot(n, towards) > 0.0);
}
