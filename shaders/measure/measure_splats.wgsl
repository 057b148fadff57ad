// Records the values that the splat passes compute for single splats, for `pointillist accuracy --stability`. One thread a splat.
//!include shared/frame
//!include shared/scene
//!include shared/splat
//!include shared/clip_none

const NARROW: bool = false;
const POINTS: u32 = 16u;
// Side of the largest image.
const SIDE_PX: u32 = 16384u;

const UNSEEN: u32 = 0u;
const REGULAR: u32 = 1u;
const CROSSES: u32 = 2u;

struct Probe {
    // Centre and tangents, multiplied by the intrinsics.
    centre: vec3<f32>,
    cutoff: f32,
    u: vec3<f32>,
    v: vec3<f32>,
    focal_px: vec2<f32>,
    principal_px: vec2<f32>,
    // Image positions at which the kernel coordinates are evaluated.
    points_px: array<vec2<f32>, POINTS>,
}

struct Found {
    side: u32,
    centre: vec2<f32>,
    s: vec3<f32>,
    t: vec3<f32>,
    low: vec2<i32>,
    high: vec2<i32>,
    // s, t and n at each point.
    kernels: array<vec4<f32>, POINTS>,
}

@group(2) @binding(0) var<storage, read> probes: array<Probe>;
@group(2) @binding(1) var<storage, read_write> found: array<Found>;

@compute @workgroup_size(64)
fn measure_splats(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[id.x];
    frame.focal_px = probe.focal_px;
    frame.principal_px = probe.principal_px;
    frame.size_px = vec2<u32>(SIDE_PX);
    frame.splat_cutoff = probe.cutoff;
    let splat = make_splat(id.x, probe.centre, probe.u, probe.v, vec2<u32>(NO_LINE), 1.0);
    var side = select(UNSEEN, REGULAR, splat.inverse.x > 0.0);
    if splat.crosses {
        side = CROSSES;
    }
    found[id.x].side = side;
    found[id.x].centre = splat.centre;
    found[id.x].s = splat.s;
    found[id.x].t = splat.t;
    found[id.x].low = splat.low;
    found[id.x].high = splat.high;
    for (var i = 0u; i < POINTS; i++) {
        let d = probe.points_px[i] - splat.centre;
        found[id.x].kernels[i] = vec4<f32>(linear(splat.s, d), linear(splat.t, d), linear(splat.n, d), 0.0);
    }
}
