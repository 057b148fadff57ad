// Boxes beside the view frustum.

// Of the terms' magnitude: what f32 may lose while they are summed.
const SLACK: f32 = 4e-6;

// False when the box, and all within `radius` of it, lies on the negative side of a plane through the eye.
fn reaches(normal: vec3<f32>, centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32) -> bool {
    let reach = abs(dot(normal, x)) + abs(dot(normal, y)) + abs(dot(normal, z)) + radius * length(normal);
    let scale = dot(abs(normal), abs(centre)) + reach;
    return dot(normal, centre) + reach >= -SLACK * scale;
}

// Of a box in camera space with half edges x, y, z; `margin`: pixels beside the image that count as well.
fn box_is_seen(centre: vec3<f32>, x: vec3<f32>, y: vec3<f32>, z: vec3<f32>, radius: f32, margin: f32) -> bool {
    let f = frame.focal_px;
    let c = frame.principal_px;
    let s = vec2<f32>(frame.size_px);
    return reaches(vec3<f32>(0.0, 0.0, 1.0), centre, x, y, z, radius)
        && reaches(vec3<f32>(f.x, 0.0, c.x + margin), centre, x, y, z, radius)
        && reaches(vec3<f32>(-f.x, 0.0, s.x - c.x + margin), centre, x, y, z, radius)
        && reaches(vec3<f32>(0.0, f.y, c.y + margin), centre, x, y, z, radius)
        && reaches(vec3<f32>(0.0, -f.y, s.y - c.y + margin), centre, x, y, z, radius);
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
