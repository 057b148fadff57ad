// Places and normals of kept surfaces in camera space, for effects that look at the surroundings of a pixel.

// The place that a pixel shows, and 1; zeros where the pixel shows nothing or is beside the image.
fn kept_place(at: vec2<i32>) -> vec4<f32> {
    if any(at < vec2<i32>(0)) || any(at >= vec2<i32>(frame.size_px)) {
        return vec4<f32>(0.0);
    }
    let inverse = bitcast<f32>(visibility[frame.first_pixel + u32(at.y) * frame.size_px.x + u32(at.x)].y);
    if !(inverse > 0.0) {
        return vec4<f32>(0.0);
    }
    return vec4<f32>(at_depth(vec2<f32>(at) + vec2<f32>(0.5), 1.0 / inverse), 1.0);
}

// The unit direction from a place to the eye.
fn way_to_eye(place: vec3<f32>) -> vec3<f32> {
    return -towards(place) / max(length(towards(place)), 1e-30);
}

// Of the ways to the two neighbours along an axis, the one that changes the depth less; zero where neither shows a surface.
fn step_along(place: vec3<f32>, before: vec4<f32>, behind: vec4<f32>) -> vec3<f32> {
    let backward = place - before.xyz;
    let forward = behind.xyz - place;
    let takes_forward = behind.w > 0.0 && (before.w == 0.0 || abs(forward.z) <= abs(backward.z));
    return select(backward * before.w, forward, takes_forward);
}

// The unit normal of what a pixel shows, towards the eye. Where the surface has none that was kept, the depths of the neighbours tell it, or else it
// looks at the eye.
fn kept_normal(at: vec2<i32>, pixel: u32, place: vec3<f32>) -> vec3<f32> {
    let packed = normals[pixel];
    if packed != NO_NORMAL && packed != BALL && packed != LIT_ALREADY {
        return camera_from_world(octahedral_decode(packed));
    }
    let to_eye = way_to_eye(place);
    let along_x = step_along(place, kept_place(at - vec2<i32>(1, 0)), kept_place(at + vec2<i32>(1, 0)));
    let along_y = step_along(place, kept_place(at - vec2<i32>(0, 1)), kept_place(at + vec2<i32>(0, 1)));
    // Steps are as long as a pixel is wide, which may be far from 1.
    let across = cross(along_x / max(length(along_x), 1e-30), along_y / max(length(along_y), 1e-30));
    let size = length(across);
    if !(size > 1e-6) {
        return to_eye;
    }
    return across * (select(-1.0, 1.0, dot(across, to_eye) > 0.0) / size);
}
