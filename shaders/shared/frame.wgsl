// Values that are uniform over all invocations of one view. Camera space: x right, y down, z forward, the eye at the origin.
//
// An orthographic view has parallel rays along z. Both projections divide camera-space places by a divisor (z, or 1) to get to the
// image, and both keep 1/z of what pixels show; in perspective it is linear in the pixel, in an orthographic view z is.
// A clip box: the map from camera space to its coordinates, less the eye's, as rows with the box's least corner in w.
struct ClipBox {
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    // Its largest corner. w: 0 where its inside is shown, else 1.
    high: vec4<f32>,
}

// A sun's shadow map: the maps from places relative to the frame's origin, in world axes, to the pixels of the map and to the distance from the plane
// that its depths are counted from, each a product with the first three numbers plus the last. Or the six maps of a lamp, one behind the other, whose rows are 0.
struct ShadowMap {
    x: vec4<f32>,
    y: vec4<f32>,
    depth: vec4<f32>,
    // Side of a pixel in world units; of a lamp's maps, at a distance of 1.
    pixel: f32,
    // Tangent of half the sun's angular diameter; the radius of a lamp.
    spread: f32,
    // Pixels along a side.
    side: u32,
    // Where the map begins in `shadow_maps`.
    first: u32,
}

struct Frame {
    // Rows of camera_from_world; w is unused.
    right: vec4<f32>,
    down: vec4<f32>,
    forward: vec4<f32>,
    // The eye in world space as the sum of two floats an axis. Orthographic: the place on the optical axis at depth `focus`.
    eye_hi: vec4<f32>,
    eye_lo: vec4<f32>,
    // Pixels for each unit beside the optical axis, over the divisor.
    focal_px: vec2<f32>,
    principal_px: vec2<f32>,
    size_px: vec2<u32>,
    entry_count: u32,
    instance_count: u32,
    light_count: u32,
    // Longest side in pixels of a triangle's box that compute still walks itself.
    small_triangle_px: i32,
    // Entries that the list of large triangles holds, and units of 4096 pixels that they may cover: beyond either, none is
    // drawn, and the frame is not shown.
    large_capacity: u32,
    large_units_limit: u32,
    // Views of one scene may be drawn together: which one this is, of how many, and where its share of each buffer begins.
    view: u32,
    views: u32,
    first_pixel: u32,
    first_instance: u32,
    first_entry: u32,
    first_group: u32,
    first_slot: u32,
    first_run: u32,
    // Segments of samples, which come first.
    sample_segments: u32,
    // Longest side in pixels of a splat's box that one thread walks.
    small_splat_px: i32,
    // Fixed-point weight of a splat where its kernel is 1.
    weight_one: f32,
    // Where kernels end in standard deviations; standard deviation of the low-pass filter; what kernels' axes are multiplied
    // by; how far behind a surface splats count, in its splats' radii. All 0 where samples are drawn as points.
    splat_cutoff: f32,
    splat_lowpass_px: f32,
    splat_width: f32,
    splat_offset: f32,
    // Slabs of depth of splats that are blended in a single pass: where they begin, how many for each unit, where that ends (and its
    // logarithm to base 2), and how many for each doubling from there.
    slab_near: f32,
    slab_per_unit: f32,
    slab_meet: f32,
    slab_meet_log2: f32,
    slab_per_octave: f32,
    // Point trees: the accepted error at depth 1 on the optical axis.
    lod_scale: f32,
    // Capacity of the list of entries.
    entry_capacity: u32,
    // Number of groups of instances.
    instance_groups: u32,
    // Number of segments of the scene.
    segment_count: u32,
    // Eye-dome lighting: its strength, and the distance in pixels of the neighbours that a pixel is compared with.
    edl: vec2<f32>,
    // Samples as discs: their radius in scene units; `splat_lowpass_px` is their least radius in pixels, and `splat_cutoff` 1.
    disc_radius: f32,
    // The colour map of surfaces that show a value: how many colours it has; the share of the range that a position in camera space has, as a product
    // with the first three numbers plus the last, or that a field's share of its own range has, as a product with the first number
    // plus the last; the colours as sRGB8.
    ramp_count: u32,
    ramp: vec4<f32>,
    ramp_colors: array<vec4<u32>, 3>,
    // Orthographic views: depth of the origin that world-space places are subtracted from.
    focus: f32,
    // The scalar field that colours samples, among those of the scene.
    field: u32,
    field_count: u32,
    // Least radius of lines in scene units, over the divisor.
    line_radius: f32,
    // Painted splats that there is room for.
    paint_capacity: u32,
    // Factor of the light that surfaces reflect and give off.
    exposure: f32,
    // Ambient occlusion: its radius in scene units, and its strength.
    occlusion: vec2<f32>,
    // Height in pixels of the image that the view is a part of, or the view's own.
    image_height: f32,
    // Added to the keys by which things are drawn with a probability; see `dithered`.
    dither: f32,
    // Fog: its linear colour, and its density for each unit; the height above its base of a place in camera space, in scale heights, as a product
    // with the first three numbers plus the last.
    fog: vec4<f32>,
    fog_up: vec4<f32>,
    clips: array<ClipBox, 8>,
    // Shadow maps of the suns that cast shadows.
    map_records: array<ShadowMap, 4>,
}

@group(0) @binding(0) var<uniform> frames: array<Frame, 16>;

// Several views are drawn together; a dispatch counts them in z.
override VIEWS: bool = false;

// Rays are parallel.
override ORTHOGRAPHIC: bool = false;

// Number of clip boxes, and whether the inside of one is shown.
override CLIP_BOXES: u32 = 0u;
override CLIP_INSIDE: u32 = 0u;

var<private> frame: Frame;

// To be called first. A uniform at a fixed place is read once for a whole vector of threads.
fn begin_view(view: u32) {
    if VIEWS {
        frame = frames[view];
    } else {
        frame = frames[0];
    }
}

// A key of this exposure, from 0 to 1, of what is drawn with a probability: exposures of one frame have different ones.
fn dithered(key: f32) -> f32 {
    return fract(key + frame.dither);
}

fn camera_from_world(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(frame.right.xyz, v), dot(frame.down.xyz, v), dot(frame.forward.xyz, v));
}

fn world_from_camera(v: vec3<f32>) -> vec3<f32> {
    return frame.right.xyz * v.x + frame.down.xyz * v.y + frame.forward.xyz * v.z;
}

// The camera-space position of a place that is given relative to the frame's origin, in world axes.
fn camera_position(from_origin: vec3<f32>) -> vec3<f32> {
    let position = camera_from_world(from_origin);
    if ORTHOGRAPHIC {
        return vec3<f32>(position.xy, position.z + frame.focus);
    }
    return position;
}

// The inverse of camera_position.
fn from_origin(position: vec3<f32>) -> vec3<f32> {
    if ORTHOGRAPHIC {
        return world_from_camera(vec3<f32>(position.xy, position.z - frame.focus));
    }
    return world_from_camera(position);
}

// By what a place at a depth is divided to get to the image.
fn divisor(z: f32) -> f32 {
    return select(z, 1.0, ORTHOGRAPHIC);
}

// Radius of the thinnest lines at a depth.
fn least_line_radius(z: f32) -> f32 {
    return frame.line_radius * divisor(max(z, 0.0));
}

// A place's image in homogeneous coordinates.
fn image_vector(position: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(position.xy, divisor(position.z));
}

// The direction, up to its length, in which the eye sees a place.
fn towards(position: vec3<f32>) -> vec3<f32> {
    return select(position, vec3<f32>(0.0, 0.0, 1.0), ORTHOGRAPHIC);
}

// The camera-space place at an image position and a depth.
fn at_depth(pixel: vec2<f32>, z: f32) -> vec3<f32> {
    return on_ray(ray_through(pixel), z);
}

// The camera-space place at a depth on a ray that ray_through gives.
fn on_ray(ray: vec3<f32>, z: f32) -> vec3<f32> {
    if ORTHOGRAPHIC {
        return vec3<f32>(ray.xy, z);
    }
    return z * ray;
}

// An image position in homogeneous coordinates, with z = 1. In perspective, the camera-space direction through it.
fn ray_through(pixel: vec2<f32>) -> vec3<f32> {
    return vec3<f32>((pixel - frame.principal_px) / frame.focal_px, 1.0);
}

// The intrinsics take places of camera space to their images: x and y in pixels times the divisor, and z.

// The camera-space direction of what the intrinsics were multiplied with.
fn camera_vector(t: vec3<f32>) -> vec3<f32> {
    return vec3<f32>((t.xy - frame.principal_px * select(t.z, 0.0, ORTHOGRAPHIC)) / frame.focal_px, t.z);
}

// The camera-space place of what the intrinsics were applied to.
fn camera_place(p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>((p.xy - frame.principal_px * divisor(p.z)) / frame.focal_px, p.z);
}
