// Which entries (chunk × instance) meet the view frustum. The rank of a visible entry within its workgroup and each
// workgroup's count are kept for the scan, so that the list of slots has the same order in every run.
//!include shared/frame
//!include shared/scene

@group(1) @binding(0) var<storage, read> entries: array<Entry>;
@group(1) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(2) @binding(0) var<storage, read> placed: array<Placed>;
@group(2) @binding(1) var<storage, read_write> ranks: array<u32>;
@group(2) @binding(2) var<storage, read_write> group_counts: array<u32>;

const NOT_VISIBLE: u32 = 0xffffffffu;
// Chunks of triangles carry this shift.
const TRIANGLES: u32 = 0xffffffffu;
const NO_INSTANCE: u32 = 0xffffffffu;
// Of the terms' magnitude: what f32 may lose while they are summed.
const SLACK: f32 = 4e-6;

// False when the box, and all within `radius` of it, lies on the negative side of a plane through the eye.
fn reaches(normal: vec3<f32>, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> bool {
    let reach = abs(dot(normal, x)) + abs(dot(normal, y)) + abs(dot(normal, z)) + radius * length(normal);
    let scale = dot(abs(normal), abs(centre)) + reach;
    return dot(normal, centre) + reach >= -SLACK * scale;
}

// An upper bound of what an instance's map does to lengths: its longest column where columns are orthogonal, more where they
// are not (Gershgorin's circles of the map's squares).
fn stretch(at: Placed) -> f32 {
    let sizes = max(abs(at.axis_x.xyz), max(abs(at.axis_y.xyz), abs(at.axis_z.xyz)));
    // Squares of small numbers would be none in f32.
    let most = max(sizes.x, max(sizes.y, sizes.z));
    let unit = 1.0 / max(most, 1e-37);
    let x = at.axis_x.xyz * unit;
    let y = at.axis_y.xyz * unit;
    let z = at.axis_z.xyz * unit;
    let xy = abs(dot(x, y));
    let yz = abs(dot(y, z));
    let zx = abs(dot(z, x));
    return most * sqrt(max(dot(x, x) + xy + zx, max(dot(y, y) + yz + xy, dot(z, z) + zx + yz)));
}

fn in_frustum(entry: Entry) -> bool {
    let chunk = chunks[entry.chunk];
    let at = placed[frame.first_instance + entry.instance];
    let half = chunk.extent * 0.5;
    let x = at.axis_x.xyz * half.x;
    let y = at.axis_y.xyz * half.y;
    let z = at.axis_z.xyz * half.z;
    let centre = grid_to_camera(at, chunk.origin) + x + y + z;
    let f = frame.focal_px;
    let c = frame.principal_px;
    let s = vec2<f32>(frame.size_px);
    // Splats reach beyond their centres, and the low-pass filter widens them in the image. Both are 0 for points.
    let base = select(chunk.kernel_base * exp2(f32(chunk.shift)), 0.0, chunk.shift == TRIANGLES);
    let radius = 1.01 * frame.splat_cutoff * frame.splat_width * base * stretch(at);
    let m = frame.splat_cutoff * frame.splat_lowpass_px;
    return reaches(vec3<f32>(0.0, 0.0, 1.0), centre, x, y, z, radius)
        && reaches(vec3<f32>(f.x, 0.0, c.x + m), centre, x, y, z, radius)
        && reaches(vec3<f32>(-f.x, 0.0, s.x - c.x + m), centre, x, y, z, radius)
        && reaches(vec3<f32>(0.0, f.y, c.y + m), centre, x, y, z, radius)
        && reaches(vec3<f32>(0.0, -f.y, s.y - c.y + m), centre, x, y, z, radius);
}

// One thread a group of entries: no barrier, which costs more than the work on a CPU adapter.
const GROUP: u32 = 32u;

@compute @workgroup_size(32)
fn cull(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let group = invocation.x + invocation.y * DISPATCH_ROW * 32u;
    let first = group * GROUP;
    if first >= frame.entry_count {
        return;
    }
    var rank = 0u;
    for (var k = 0u; k < GROUP; k++) {
        let entry = entries[first + k];
        var mine = NOT_VISIBLE;
        if entry.instance != NO_INSTANCE {
            if in_frustum(entry) {
                mine = rank;
                rank++;
            }
        }
        ranks[frame.first_entry + first + k] = mine;
    }
    group_counts[frame.first_group + group] = rank;
}
