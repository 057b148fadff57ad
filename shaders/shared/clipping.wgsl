// Boxes that the scene is clipped with; `crate::scene::clipping` says what is shown.

fn in_clip_box(clip: ClipBox, place: vec3<f32>) -> bool {
    let at = vec3<f32>(dot(clip.x.xyz, place), dot(clip.y.xyz, place), dot(clip.z.xyz, place));
    return all(at >= vec3<f32>(clip.x.w, clip.y.w, clip.z.w)) && all(at <= clip.high.xyz);
}

// Boxes that were found to hold a place, by the side that they show: x inside, y outside.
fn with_clip_box(found: vec2<bool>, clip: ClipBox, place: vec3<f32>) -> vec2<bool> {
    let holds = in_clip_box(clip, place);
    let shows_outside = clip.high.w != 0.0;
    return vec2<bool>(found.x || (holds && !shows_outside), found.y || (holds && shows_outside));
}

// Whether a place in camera space is shown. Without loops, of whose rounds a thread of lavapipe has few.
fn place_is_shown(place: vec3<f32>) -> bool {
    if CLIP_BOXES == 0u {
        return true;
    }
    var found = with_clip_box(vec2<bool>(CLIP_INSIDE == 0u, false), frame.clips[0], place);
    if CLIP_BOXES > 1u { found = with_clip_box(found, frame.clips[1], place); }
    if CLIP_BOXES > 2u { found = with_clip_box(found, frame.clips[2], place); }
    if CLIP_BOXES > 3u { found = with_clip_box(found, frame.clips[3], place); }
    if CLIP_BOXES > 4u { found = with_clip_box(found, frame.clips[4], place); }
    if CLIP_BOXES > 5u { found = with_clip_box(found, frame.clips[5], place); }
    if CLIP_BOXES > 6u { found = with_clip_box(found, frame.clips[6], place); }
    if CLIP_BOXES > 7u { found = with_clip_box(found, frame.clips[7], place); }
    return found.x && !found.y;
}
