// Scene records. Positions are integers on a grid of the asset: local = origin + step · grid.

// Written once when a scene becomes resident or an instance moves.
struct Instance {
    // Columns of world_from_grid (linear part, the grid step included).
    axis_x: vec3<f32>,
    // Overriding material plus one, or 0.
    material: u32,
    axis_y: vec3<f32>,
    // Value of the id output.
    id: u32,
    axis_z: vec3<f32>,
    // See INSTANCE_MIRRORED and those behind it.
    flags: u32,
    // Rows of grid_from_world (linear part), or of the cofactors, scaled, where the transform is singular.
    inverse_x: vec3<f32>,
    // Half the asset's size in grid cells; the anchor stays within.
    reach: f32,
    inverse_y: vec3<f32>,
    // The geometry, counted asset by asset.
    geometry: u32,
    inverse_z: vec3<f32>,
    // In scenes of point trees, of the node that stands above the geometry as a whole: its error, its size and its distance, in world
    // units.
    error_parent: f32,
    // World position of the grid's origin as the sum of two floats an axis.
    origin_hi: vec3<f32>,
    size_parent: f32,
    origin_lo: vec3<f32>,
    delta: f32,
}

// The transform mirrors.
const INSTANCE_MIRRORED: u32 = 1u;
// The colour of the instance's own lets what is behind it show through.
const INSTANCE_TRANSLUCENT: u32 = 2u;
// That colour has no alpha at all: the instance is not there, whatever the output.
const INSTANCE_CLEAR: u32 = 4u;

// An instance seen from this frame's eye: camera = axes · (grid − anchor) + position.
struct Placed {
    axis_x: vec4<f32>,
    axis_y: vec4<f32>,
    axis_z: vec4<f32>,
    // w: 1 where the eye is outside of the asset's box, as far as f32 can tell.
    position: vec4<f32>,
    anchor: vec4<i32>,
}

// Kinds of geometry, see GeometryKind in src/bake/pack/kind.rs.
const SAMPLES: u32 = 0u;
const TRIANGLES: u32 = 1u;
const SEGMENTS: u32 = 2u;

// Flags of chunks. The normals of samples point outwards.
const CHUNK_ORIENTED: u32 = 1u;
// The surface is also closed: its back is never seen from outside.
const CHUNK_CLOSED: u32 = 2u;
// Nodes are strictly sorted by their parents' errors.
const CHUNK_SORTED: u32 = 4u;
// Surfaces behind all of its triangles, or behind some of its samples or segments, show through.
const CHUNK_TRANSLUCENT: u32 = 8u;

// Up to 1024 neighbouring elements of one kind.
struct Chunk {
    // Grid position of the box's minimum corner.
    origin: vec3<i32>,
    // First element in its page.
    first: u32,
    // Size of the box in grid cells.
    extent: vec3<f32>,
    count: u32,
    // Samples: their 21-bit coordinates count in steps of 2^shift cells.
    shift: u32,
    // Triangles and lines: first vertex in the page.
    vertex_first: u32,
    material: u32,
    // Samples: longest axis of a kernel, in steps of 2^shift cells. Lines: the largest radius, in cells.
    kernel_base: f32,
    // For point trees, in cells; see NodeRange in src/bake/pack.rs.
    node_base: f32,
    error_parent: f32,
    size_parent: f32,
    error_least: f32,
    size_least: f32,
    delta_most: f32,
    kind: u32,
    flags: u32,
}

// Some 32 instances of a scene of point trees, neighbours in space.
struct InstanceGroup {
    // Middle of the box around them, as the sum of two floats an axis; half its size.
    centre_hi: vec4<f32>,
    centre_lo: vec4<f32>,
    half: vec3<f32>,
    // Bounds of the nodes above them: the largest size and error, and the longest way there.
    size_parent: f32,
    first: u32,
    count: u32,
    error_parent: f32,
    delta_most: f32,
}

// The chunks of a geometry that lie in the page of a segment.
struct ChunkRun {
    first: u32,
    count: u32,
}

// Instances of a group.
const INSTANCE_GROUP: u32 = 32u;

// One chunk of one instance, whether visible or not.
struct Entry {
    instance: u32,
    chunk: u32,
}

// An entry that met the frustum. For samples the rows take 21-bit coordinates to (x·d px, y·d px, z) with the divisor d.
struct Slot {
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    instance: u32,
    chunk: u32,
    first: u32,
    count: u32,
    // For point trees: the base of the nodes' codes in camera space.
    unit: f32,
    // See SLOT_ONE_SIDED and SLOT_SORTED.
    flags: u32,
    // Codes of nodes that may be drawn: the parents' are below the lower half, their own are no less than the upper half.
    limits: u32,
    // The lower half has a bit for each part that may be drawn, the upper half for each part whose nodes pass their test for sure.
    parts: u32,
}

// The surface is closed and the eye is outside: backs are never seen.
const SLOT_ONE_SIDED: u32 = 1u;
// Parents' codes do not decrease within the chunk.
const SLOT_SORTED: u32 = 2u;
// A limit that no code of a parent reaches.
const MOST_LIMIT: u32 = 0xffffu;

// Entries of one page and one kind: workgroups [first_group, end_group) of the entry list.
struct Segment {
    first_group: u32,
    end_group: u32,
}

// Which segment a pass draws.
struct SegmentUse {
    index: u32,
    unused: u32,
}

// Where a segment's visible slots lie among those of a view.
struct Run {
    first_slot: u32,
    count: u32,
}

// Workgroups of a segment, in the form that an indirect dispatch reads.
struct Dispatch {
    groups_x: atomic<u32>,
    groups_y: atomic<u32>,
    groups_z: atomic<u32>,
    unused: u32,
}

struct Stats {
    samples_tested_lo: atomic<u32>,
    samples_tested_hi: atomic<u32>,
    triangles_tested_lo: atomic<u32>,
    triangles_tested_hi: atomic<u32>,
    instances_drawn: atomic<u32>,
    triangles_rasterised: atomic<u32>,
    pixels_of_samples: atomic<u32>,
    pixels_of_triangles: atomic<u32>,
    // For all views together, in the first one's record: the longest list of large triangles that a segment asked for.
    large_longest: atomic<u32>,
    // Pixels in the boxes of large triangles, in units of 4096, and whether that sum has passed 2^32.
    large_units: atomic<u32>,
    large_wrapped: atomic<u32>,
    // Splats that reach the camera plane, that were listed for their size or for that, and all others.
    splats_clipped: atomic<u32>,
    splats_listed: atomic<u32>,
    splats_scattered: atomic<u32>,
    // The weights of some pixel's splats do not fit their sum.
    sums_full: atomic<u32>,
    // Entries that the selection asked for; beyond the room that there is, none is drawn and the frame is not shown.
    entries_wanted: atomic<u32>,
    // Nodes of point trees that passed their test.
    nodes_drawn: atomic<u32>,
    // For all views together, in the first one's record: some workgroup had more to walk than it may; the frame is not shown.
    walk_cut: atomic<u32>,
    // Bounds in pixels of all that may be drawn: how far they begin before the image's right and lower edges, and where they end.
    drawn_before: array<atomic<u32>, 2>,
    drawn_end: array<atomic<u32>, 2>,
    // Pixels that show no sample of their own, and that pull-push has filled.
    pixels_filled: atomic<u32>,
    // Most layers of translucent surfaces of a pixel, and pixels with as many as are kept, through which one sees: what lies behind is
    // left out.
    deepest: atomic<u32>,
    pixels_of_all_layers: atomic<u32>,
    // Segments of lines: in slots that were tested, left to walk_lines, and pixels that show one.
    segments_tested_lo: atomic<u32>,
    segments_tested_hi: atomic<u32>,
    segments_listed: atomic<u32>,
    pixels_of_segments: atomic<u32>,
    // Places for painted splats that the frame asked for; beyond the room that there is, none is drawn and the frame is not shown.
    splats_wanted: atomic<u32>,
    // Threads that have splats left to paint; a frame with any is not shown.
    paint_cut: atomic<u32>,
    // Of the pixels of all layers, the bits of the largest share of a channel's light from behind that passes all of them.
    passing_most: atomic<u32>,
}

// Words of a view's record, and places in it for those who only read.
const STATS_WORDS: u32 = 32u;
const STAT_LARGE_LONGEST: u32 = 8u;
const STAT_LARGE_UNITS: u32 = 9u;
const STAT_LARGE_WRAPPED: u32 = 10u;
const STAT_SUMS_FULL: u32 = 14u;
const STAT_ENTRIES_WANTED: u32 = 15u;
const STAT_WALK_CUT: u32 = 17u;

const SLOT_SHIFT: u32 = 10u;
const SLOT_MASK: u32 = 1023u;
// Workgroups of an indirect dispatch in x before a second row begins.
const DISPATCH_ROW: u32 = 32768u;
// Nearer than this is at the eye and not drawn; it also keeps 1/z finite.
const NEAREST: f32 = 1e-30;

// A sample's place in its chunk, in steps of 2^shift cells: 21 bits an axis.
fn sample_cell(word: vec2<u32>) -> vec3<f32> {
    return vec3<f32>(
        f32(word.x & 0x1fffffu),
        f32(((word.x >> 21u) | (word.y << 11u)) & 0x1fffffu),
        f32((word.y >> 10u) & 0x1fffffu),
    );
}

fn grid_to_camera(placed: Placed, grid: vec3<i32>) -> vec3<f32> {
    let d = vec3<f32>(grid - placed.anchor.xyz);
    return fma(placed.axis_x.xyz, vec3<f32>(d.x),
        fma(placed.axis_y.xyz, vec3<f32>(d.y),
            fma(placed.axis_z.xyz, vec3<f32>(d.z), placed.position.xyz)));
}
