// Counts the chunks of each listed instance that may have nodes to draw: a prefix of its sequence (Dachsbacher et al. 2003,
// §3.7), found by binary search, page by page. One thread takes a group of instances.
//!include shared/frame
//!include shared/scene
//!include shared/frustum
//!include shared/accepted
//!include shared/chosen

@group(1) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(2) var<storage, read> instance_groups: array<InstanceGroup>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> pieces: array<ChunkRun>;
@group(1) @binding(5) var<storage, read> geometries: array<vec4<f32>>;
@group(2) @binding(0) var<storage, read> placed: array<Placed>;
@group(2) @binding(1) var<storage, read_write> chosen: array<u32>;
@group(2) @binding(2) var<storage, read_write> chosen_first: array<u32>;
@group(2) @binding(3) var<storage, read> listed: array<u32>;

// 0: errors, 1: sizes.
override MEASURE: u32 = 0u;

fn parent_of(chunk: u32) -> f32 {
    return select(chunks[chunk].error_parent, chunks[chunk].size_parent, MEASURE == 1u);
}

// Number of chunks at the front of a run whose nodes' parents may be too coarse.
fn prefix(piece: ChunkRun, scale: f32, near: f32, far: f32) -> u32 {
    let delta = scale * chunks[piece.first].delta_most + DEPTH_SLACK * far;
    let limit = accepted(near - delta, far + delta);
    var low = 0u;
    var high = piece.count;
    while low < high {
        let middle = (low + high) / 2u;
        if scale * parent_of(piece.first + middle) > limit {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(64)
fn select_chunks(@builtin(global_invocation_id) invocation: vec3<u32>) {
    begin_view(invocation.z);
    let rank = invocation.x + invocation.y * DISPATCH_ROW * 64u;
    if rank >= listed[0] {
        return;
    }
    let group = instance_groups[listed[1u + rank]];
    // See all_lights in shared/phong for why the bound is no uniform alone.
    let segment_count = min(frame.segment_count, arrayLength(&chosen_first));
    for (var segment = 0u; segment < segment_count; segment++) {
        chosen_first[segment * frame.instance_groups + rank] = 0u;
    }
    for (var member = 0u; member < group.count; member++) {
        let index = group.first + member;
        let at = placed[index];
        let geometry = instances[index].geometry;
        let half = geometries[geometry].xyz;
        let x = at.axis_x.xyz * half.x;
        let y = at.axis_y.xyz * half.y;
        let z = at.axis_z.xyz * half.z;
        let centre = grid_to_camera(at, vec3<i32>(0));
        let scale = stretch(at);
        let far = length(centre) + length(x) + length(y) + length(z);
        let near = centre.z - abs(x.z) - abs(y.z) - abs(z.z);
        let delta = instances[index].delta + DEPTH_SLACK * far;
        let parent = select(instances[index].error_parent, instances[index].size_parent, MEASURE == 1u);
        let own = parent > accepted(near - delta, far + delta)
            && box_is_seen(centre, x, y, z, widest_reach(Box(centre, x, y, z, 0.0)), lod_margin());
        for (var segment = 0u; segment < segment_count; segment++) {
            let row = segment * frame.instance_groups + rank;
            let piece = pieces[geometry * segment_count + segment];
            let before = chosen_first[row];
            chosen[row * CHOSEN + member] = before;
            if own && piece.count > 0u {
                chosen_first[row] = before + prefix(piece, scale, near, far);
            }
        }
    }
    for (var segment = 0u; segment < segment_count; segment++) {
        let row = segment * frame.instance_groups + rank;
        chosen[row * CHOSEN + group.count] = chosen_first[row];
    }
}
