// Which side of an edge a pixel's ray is on, for triangles that may meet the camera plane: a ray is tested against the planes through the eye
// and each edge (Olano & Greer 1997), each computed in the same way for both triangles that share the edge.

// Returns a product and its rounding error (Dekker), from halves of 12 bits each.
fn exact_product(x: f32, y: f32) -> vec2<f32> {
    let xh = bitcast<f32>(bitcast<u32>(x) & 0xfffff000u);
    let yh = bitcast<f32>(bitcast<u32>(y) & 0xfffff000u);
    let xl = x - xh;
    let yl = y - yh;
    let product = x * y;
    return vec2<f32>(product, ((xh * yh - product) + (xh * yl + xl * yh)) + xl * yl);
}

// Computes p · q − r · s without cancellation; swapping the two products only changes the sign.
fn difference(p: f32, q: f32, r: f32, s: f32) -> f32 {
    let first = exact_product(p, q);
    let second = exact_product(r, s);
    return (first.x - second.x) + (first.y - second.y);
}

// Normal of the plane through the eye and an edge, of about unit length: only its sign at a ray matters.
fn edge_plane(p: vec3<f32>, q: vec3<f32>) -> vec3<f32> {
    let n = vec3<f32>(
        difference(p.y, q.z, p.z, q.y),
        difference(p.z, q.x, p.x, q.z),
        difference(p.x, q.y, p.y, q.x),
    );
    let most = max(abs(n.x), max(abs(n.y), abs(n.z)));
    return n / select(most, 1.0, most < 1e-37);
}

// Rays in the plane of an edge belong to exactly one of the two triangles that share the edge.
fn owns(n: vec3<f32>) -> bool {
    return n.x > 0.0 || (n.x == 0.0 && n.y > 0.0);
}

fn inside(n: vec3<f32>, ray: vec3<f32>) -> bool {
    let side = dot(n, ray);
    return side > 0.0 || (side == 0.0 && owns(n));
}
