// The error that may be accepted at a depth and a distance: a displacement of it, across the ray, is the accepted one in pixels. Not
// less than none: what is exact may be drawn anywhere. Where rays are parallel it is the same everywhere.
fn accepted(z: f32, far: f32) -> f32 {
    if ORTHOGRAPHIC {
        return frame.lod_scale;
    }
    let near = max(z, 0.0);
    return frame.lod_scale * near * (near / max(far, NEAREST));
}

// Relative error that f32 may add to a position in camera space, as a fraction of its distance.
const DEPTH_SLACK: f32 = 4e-6;

// In the split error mode: the least part of a node's error that is seen of it, from wherever.
const SIDEWAYS: f32 = 0.5;

// The accepted error in pixels.
fn lod_px() -> f32 {
    return frame.lod_scale * max(frame.focal_px.x, frame.focal_px.y);
}

// Distance in pixels from which a node beside the image may still reach into it.
fn lod_margin() -> f32 {
    return lod_px() + frame.splat_cutoff * frame.splat_lowpass_px;
}
