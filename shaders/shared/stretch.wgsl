// An upper bound of what an instance's map does to lengths: its longest column where columns are orthogonal, more where they
// are not (Gershgorin's circles of the map's squares).
fn stretch(at: Placed) -> f32 {
    return stretch_of(at.axis_x.xyz, at.axis_y.xyz, at.axis_z.xyz);
}

// The largest stretch of a map with these columns.
fn stretch_of(x_in: vec3<f32>, y_in: vec3<f32>, z_in: vec3<f32>) -> f32 {
    let sizes = max(abs(x_in), max(abs(y_in), abs(z_in)));
    // Squares of small numbers would be none in f32.
    let most = max(sizes.x, max(sizes.y, sizes.z));
    let unit = 1.0 / max(most, 1e-37);
    let x = x_in * unit;
    let y = y_in * unit;
    let z = z_in * unit;
    let xy = abs(dot(x, y));
    let yz = abs(dot(y, z));
    let zx = abs(dot(z, x));
    return most * sqrt(max(dot(x, x) + xy + zx, max(dot(y, y) + yz + xy, dot(z, z) + zx + yz)));
}

// The map of areas that a map with these columns causes: rows of its adjugate, in parts of the square of how far it stretches.
struct Areas {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

fn areas_of(x_in: vec3<f32>, y_in: vec3<f32>, z_in: vec3<f32>) -> Areas {
    let most = max(stretch_of(x_in, y_in, z_in), 1e-37);
    let x = x_in / most;
    let y = y_in / most;
    let z = z_in / most;
    return Areas(cross(y, z), cross(z, x), cross(x, y));
}

// The part of a disk's area that is seen of it, once mapped, from the eye: n · adj(M) d for its normal n before that and the way d to its
// centre; of a ball, whose normal is zero, |adj(M) d|. In parts of the square of the stretch.
fn seen_area(areas: Areas, normal: vec3<f32>, centre: vec3<f32>) -> f32 {
    let direction = towards(centre);
    let most = max(abs(direction.x), max(abs(direction.y), abs(direction.z)));
    let way = direction / max(most, 1e-37);
    let d = way / max(length(way), 1e-37);
    let seen = vec3<f32>(dot(areas.x, d), dot(areas.y, d), dot(areas.z, d));
    return select(abs(dot(normal, seen)), length(seen), all(normal == vec3<f32>(0.0)));
}

// Whether three axes are as long as each other, and at right angles. Chunks of one instance differ by powers of two, and so agree.
fn keeps_angles(x: vec3<f32>, y: vec3<f32>, z: vec3<f32>) -> bool {
    let one = dot(x, x);
    let off = max(
        max(abs(dot(y, y) - one), abs(dot(z, z) - one)),
        max(abs(dot(x, y)), max(abs(dot(y, z)), abs(dot(z, x)))),
    );
    return off <= 1e-3 * one;
}
