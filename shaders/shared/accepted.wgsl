// The error that may be accepted at a depth and a distance: a displacement of it, across the ray, is the accepted one in pixels. Not
// less than none: what is exact may be drawn anywhere.
fn accepted(z: f32, far: f32) -> f32 {
    let near = max(z, 0.0);
    return frame.lod_scale * near * (near / max(far, NEAREST));
}

// What f32 may lose of a place in camera space, in parts of its distance.
const DEPTH_SLACK: f32 = 4e-6;

// In the split error mode: the least part of a node's error that is seen of it, from wherever.
const SIDEWAYS: f32 = 0.5;

// Pixels beside the image that what is drawn may reach into it from.
fn lod_margin() -> f32 {
    return frame.lod_scale * max(frame.focal_px.x, frame.focal_px.y) + frame.splat_cutoff * frame.splat_lowpass_px;
}
