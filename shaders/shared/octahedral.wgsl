// Unit vectors in two signed 16-bit numbers (octahedral map); NO_NORMAL stands for none, BALL for all of them alike.
const NO_NORMAL: u32 = 0x80008000u;
const BALL: u32 = 0x80000000u;
// In kept surfaces: the colour is already that under all lights.
const LIT_ALREADY: u32 = 0x80000001u;

// Length that stands for a surface with all normals alike, and the length up to which blended normals are lit as such a surface. Rounding errors of
// missing normals are shorter.
const BALL_NORMAL: f32 = 0.2;
const LONGEST_BALL: f32 = 0.25;

fn octahedral_decode(packed: u32) -> vec3<f32> {
    if packed == NO_NORMAL {
        return vec3<f32>(0.0);
    }
    let f = unpack2x16snorm(packed);
    var n = vec3<f32>(f, 1.0 - abs(f.x) - abs(f.y));
    let t = max(-n.z, 0.0);
    n.x += select(t, -t, n.x >= 0.0);
    n.y += select(t, -t, n.y >= 0.0);
    return n / length(n);
}

// The place of a direction in the map, -1 to 1 along both sides.
fn octahedral_place(v: vec3<f32>) -> vec2<f32> {
    let n = v / max(abs(v.x) + abs(v.y) + abs(v.z), 1e-30);
    if n.z < 0.0 {
        let s = vec2<f32>(select(-1.0, 1.0, n.x >= 0.0), select(-1.0, 1.0, n.y >= 0.0));
        return (vec2<f32>(1.0) - abs(n.yx)) * s;
    }
    return n.xy;
}

fn octahedral_encode(v: vec3<f32>) -> u32 {
    if !(abs(v.x) + abs(v.y) + abs(v.z) > 0.0) {
        return NO_NORMAL;
    }
    return pack2x16snorm(octahedral_place(v));
}
