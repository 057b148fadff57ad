// Reads a slot's samples as splats; shared by the passes over a page of samples.
//!include NODES
@group(1) @binding(0) var<storage, read> positions: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(6) var<storage, read> attributes: array<vec2<u32>>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;

// Values that the samples of a slot have in common.
struct SplatSlot {
    index: u32,
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    first: u32,
    instance: u32,
    kernel_base: f32,
    // Point trees: the base of the nodes' codes in camera space.
    unit: f32,
    // See Slot.
    limits: u32,
    sorted: bool,
    // Parts whose nodes all are detailed enough, while their parents are not.
    sure: u32,
    // Key of the instance.
    key: u32,
    // Backs are never seen.
    one_sided: bool,
    // 0 where normals do not tell outside from inside, −1 where the instance mirrors, else 1.
    orientation: f32,
    // For point trees: what the map makes of areas.
    areas: Areas,
    // Longest column of the map from stored coordinates to camera space.
    scale: f32,
    // The map turns and scales, and does nothing else.
    is_even: bool,
}

fn splat_slot(index: u32) -> SplatSlot {
    let at = frame.first_slot + index;
    var slot: SplatSlot;
    slot.index = index;
    slot.row_x = slots[at].row_x;
    slot.row_y = slots[at].row_y;
    slot.row_z = slots[at].row_z;
    slot.first = slots[at].first;
    slot.instance = slots[at].instance;
    slot.unit = slots[at].unit;
    if TREE {
        slot.limits = slots[at].limits;
        slot.sorted = (slots[at].flags & SLOT_SORTED) != 0u;
        slot.sure = slots[at].parts >> 16u;
        slot.key = instance_key(slot.instance);
    }
    slot.one_sided = TREE && (slots[at].flags & SLOT_ONE_SIDED) != 0u;
    let chunk = slots[at].chunk;
    slot.kernel_base = chunks[chunk].kernel_base;
    let x = camera_vector(vec3<f32>(slot.row_x.x, slot.row_y.x, slot.row_z.x));
    let y = camera_vector(vec3<f32>(slot.row_x.y, slot.row_y.y, slot.row_z.y));
    let z = camera_vector(vec3<f32>(slot.row_x.z, slot.row_y.z, slot.row_z.z));
    // Cells may be so small that their squares, or the volume of three, are none in f32.
    let sizes = max(abs(x), max(abs(y), abs(z)));
    let most = max(max(sizes.x, max(sizes.y, sizes.z)), 1e-37);
    if TREE {
        slot.areas = areas_of(x, y, z);
    }
    if SPLIT {
        slot.is_even = keeps_angles(x / most, y / most, z / most);
    }
    slot.scale = most * sqrt(max(dot(x / most, x / most), max(dot(y / most, y / most), dot(z / most, z / most))));
    slot.orientation = f32(chunks[chunk].flags & CHUNK_ORIENTED) * sign(dot(cross(x / most, y / most), z / most));
    return slot;
}

fn taken(slot: SplatSlot, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(slot.row_x.xyz, v), dot(slot.row_y.xyz, v), dot(slot.row_z.xyz, v));
}

// The centre's place in the image, times z, and z.
fn splat_centre(slot: SplatSlot, sample: u32) -> vec3<f32> {
    let q = sample_cell(positions[slot.first + sample]);
    return vec3<f32>(
        fma(slot.row_x.x, q.x, fma(slot.row_x.y, q.y, fma(slot.row_x.z, q.z, slot.row_x.w))),
        fma(slot.row_y.x, q.x, fma(slot.row_y.y, q.y, fma(slot.row_y.z, q.z, slot.row_y.w))),
        fma(slot.row_z.x, q.x, fma(slot.row_z.y, q.y, fma(slot.row_z.z, q.z, slot.row_z.w))),
    );
}

// A sample without a normal is a disk that faces the eye.
fn facing_axes(slot: SplatSlot, p: vec3<f32>, axes: Tangents) -> Tangents {
    let way = towards(camera_place(p));
    let most = max(abs(way.x), max(abs(way.y), abs(way.z)));
    let direction = way / max(most, 1e-37);
    let own = tangent_frame(direction / max(length(direction), 1e-30));
    let radius = slot.scale * sqrt(max(dot(axes.u, axes.u), dot(axes.v, axes.v)));
    return Tangents(with_intrinsics(own.u * radius), with_intrinsics(own.v * radius));
}

// Cosine of the angle between a sample's normal and the way to the eye; UNTILTED where that is not asked, or has no answer.
fn tilt_cosine(slot: SplatSlot, sample: u32, centre: vec3<f32>) -> f32 {
    if !SPLIT {
        return UNTILTED;
    }
    let normal = attributes[sample].y;
    if normal == NO_NORMAL || !slot.is_even {
        return UNTILTED;
    }
    let across = camera_vector(taken(slot, octahedral_decode(normal))) / slot.scale;
    let direction = towards(centre);
    let way = direction / max(max(abs(direction.x), abs(direction.y)), max(abs(direction.z), 1e-37));
    return min(abs(dot(across, way)) * inverseSqrt(max(dot(across, across) * dot(way, way), 1e-37)), 1.0);
}

// The area in the image of a node's disk, cut off, of which so much is seen; no less than a pixel, which it fills.
fn drawn_px(slot: SplatSlot, axis: vec3<f32>, centre: vec3<f32>, seen: f32) -> f32 {
    let focal_px = max(frame.focal_px.x, frame.focal_px.y);
    let deviation = min(slot.scale * length(axis) * focal_px / divisor(max(centre.z, NEAREST)), MOST_THINNED_PX / frame.splat_cutoff);
    return max(3.1415927 * frame.splat_cutoff * frame.splat_cutoff * deviation * deviation * seen, 1.0);
}

// Whether a node of a point tree is as detailed as is asked, and its parent is not.
fn splat_is_chosen(slot: SplatSlot, sample: u32) -> bool {
    let at = slot.first + sample;
    let centre = camera_place(splat_centre(slot, sample));
    return node_is_drawn(at, slot.unit, centre, tilt_cosine(slot, at, centre));
}

// A sample or node as a disc, which covers all samples that the node stands for; if they leave gaps, its area is theirs. Nothing if the node
// is thinned out.
fn node_disc(slot: SplatSlot, sample: u32, p: vec3<f32>) -> Splat {
    let at = slot.first + sample;
    let own = attributes[at];
    var extent = node_extent(at, slot.unit);
    var seen = 1.0;
    if !is_whole(own.x) {
        seen = seen_area(slot.areas, octahedral_decode(own.y), camera_place(p));
        extent *= sqrt(min(node_part(own.x) * seen, 1.0));
    }
    let disc = make_disc((slot.index << SLOT_SHIFT) | sample, p, extent);
    if !is_whole(own.x) {
        let centre = camera_place(p);
        let radius = disc_px(max(p.z, NEAREST), extent);
        if !is_kept(at, own.x, slot.unit, centre, seen, max(3.1415927 * radius.x * radius.y, 1.0), positions[at], slot.key) {
            return no_splat();
        }
    }
    return disc;
}

// A splat that is not drawn.
fn no_splat() -> Splat {
    var splat: Splat;
    splat.way = NOTHING;
    return splat;
}

// Whether a node of a mesh does not cover the middle of the pixel that holds its centre; `image` is the centre's place in the image. Outlines would be
// half a pixel too wide if the node filled that pixel. Nodes of clouds always fill it.
fn is_passed_by(slot: SplatSlot, at: u32, centre: vec3<f32>, image: vec2<f32>) -> bool {
    let own = attributes[at];
    if !is_whole(own.x) || (own.x >> 24u) >= FILLS || !(centre.z > NEAREST) {
        return false;
    }
    let beside = at_depth(floor(image) + vec2<f32>(0.5), centre.z) - centre;
    return !covers_pixel(at, own, slot.unit, centre, beside, slot.areas);
}

fn splat_of(slot: SplatSlot, sample: u32) -> Splat {
    let at = slot.first + sample;
    let p = splat_centre(slot, sample);
    let centre = camera_place(p);
    let normal = attributes[at].y;
    if DISCS {
        return node_disc(slot, sample, p);
    }
    let axes = kernel_axes(kernels[at * KERNEL_WORDS], slot.kernel_base, octahedral_decode(normal));
    if !is_whole(attributes[at].x) {
        let seen = seen_area(slot.areas, octahedral_decode(normal), centre);
        // Without a normal it is drawn as a disk that faces the eye, stretched evenly.
        let drawn = drawn_px(slot, axes.u, centre, select(seen, 1.0, normal == NO_NORMAL));
        if !is_kept(at, attributes[at].x, slot.unit, centre, seen, drawn, positions[at], slot.key) {
            return no_splat();
        }
    }
    var image = Tangents(taken(slot, axes.u), taken(slot, axes.v));
    var lines = clip_words(at);
    var orientation = slot.orientation;
    if slot.one_sided && normal != NO_NORMAL {
        let u = camera_vector(image.u);
        let v = camera_vector(image.v);
        let across = cross(u, v);
        // A bound for all leaves below, as seen from anywhere on the disk.
        let way = towards(centre);
        let beside = select(2.0 * frame.splat_cutoff * max(length(u), length(v)), 0.0, ORTHOGRAPHIC);
        let reach = cone_sine(at) * length(way) + beside;
        if dot(across, way) * orientation > length(across) * reach {
            return no_splat();
        }
    }
    if normal == NO_NORMAL {
        image = facing_axes(slot, p, axes);
        // They were given for axes that nobody knows.
        lines = vec2<u32>(NO_LINE);
        orientation = 0.0;
    }
    var splat = make_splat((slot.index << SLOT_SHIFT) | sample, p, image.u, image.v, lines, orientation);
    if TREE && NARROW {
        splat.passed_by = is_passed_by(slot, at, centre, splat.centre);
    }
    return splat;
}
