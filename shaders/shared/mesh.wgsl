// Triangles of a page: corners as three 10-bit indices into the chunk's vertices, vertices as seven words
// (grid position, sRGB8 colour, octahedral normal, texture coordinates). Needs the bindings of the page.
@group(1) @binding(0) var<storage, read> vertices: array<u32>;
@group(1) @binding(1) var<storage, read> triangles: array<u32>;

const VERTEX_WORDS: u32 = 7u;

// Word offsets of the three vertices of a page's triangle whose chunk's vertices begin at `vertex_first`.
fn corner_words(triangle: u32, vertex_first: u32) -> vec3<u32> {
    let word = triangles[triangle];
    let local = vec3<u32>(word & 1023u, (word >> 10u) & 1023u, (word >> 20u) & 1023u);
    return (vec3<u32>(vertex_first) + local) * VERTEX_WORDS;
}

fn vertex_camera(placed: Placed, word: u32) -> vec3<f32> {
    let grid = vec3<i32>(bitcast<i32>(vertices[word]), bitcast<i32>(vertices[word + 1u]), bitcast<i32>(vertices[word + 2u]));
    return grid_to_camera(placed, grid);
}
