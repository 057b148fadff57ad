// The resolved surface: what a pixel shows, before light and effects. Resolve passes make one, with the parts that the `needs_…` functions
// ask for, and `finish` takes it: it writes the output at once (shared/finish_written), or keeps the surface for passes that look at
// neighbouring pixels (shared/finish_kept).
struct Surface {
    // Linear, without lighting.
    color: vec3<f32>,
    // Translucent surfaces: how much of what is behind they hide.
    alpha: f32,
    // World space, unit length, turned towards the eye; zero if the surface has none and is not lit.
    normal: vec3<f32>,
    // The surface reflects like a ball: it has all normals alike.
    is_ball: bool,
    // The distance along the viewing axis is depth_scale / inverse_depth; the scale is 1 except for blended splats.
    inverse_depth: f32,
    depth_scale: f32,
    // Slot of the chunk, counted from the view's first one.
    slot: u32,
    // Id of the instance, where the output shows it.
    id: u32,
    // Shares that maps take away: of the ambient light, of the material's roughness, and of its metallic value.
    taken: vec3<f32>,
    // The same of the light that the surface gives off.
    dimmed: vec3<f32>,
    // The same of the light that passes it.
    stopped: f32,
}

// Light is computed for each pixel, from its normal.
override SHADED: bool = true;

// Value that colours surfaces in place of their own colours; see shared/recolor.
override COLOR_BY: u32 = 0u;

const BY_HEIGHT: u32 = 1u;
const BY_NORMAL: u32 = 2u;
const BY_INSTANCE: u32 = 3u;
// Samples have the colours already when they become surfaces.
const BY_FIELD: u32 = 4u;

// sRGB8 of what has no value to show.
const GREY: u32 = 0xff808080u;

fn needs_color() -> bool {
    return OUTPUT == OUTPUT_COLOR;
}

fn needs_normal() -> bool {
    return OUTPUT == OUTPUT_NORMAL || SHADED || COLOR_BY == BY_NORMAL;
}

// Depth is wanted as it was blended, not that of the nearest splat.
fn needs_depth() -> bool {
    return OUTPUT == OUTPUT_DEPTH;
}

fn needs_id() -> bool {
    return OUTPUT == OUTPUT_ID;
}
