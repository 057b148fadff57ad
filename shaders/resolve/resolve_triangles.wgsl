// Writes the attributes of the pixels that show a triangle of one page, perspective-correctly interpolated at the pixel's centre.
//!include shared/frame
//!include shared/scene
//!include shared/mesh
//!include shared/barycentric
//!include shared/texture
//!include shared/normals
//!include shared/resolve

@group(1) @binding(5) var<storage, read> textures: array<Texture>;
@group(1) @binding(6) var<storage, read> texels_0: array<u32>;
@group(1) @binding(7) var<storage, read> texels_1: array<u32>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// Values that the triangles of a slot have in common.
struct Shown {
    slot: u32,
    first: u32,
    vertex_first: u32,
    placed: Placed,
    normals: NormalMap,
    material: Material,
    id: u32,
}

// One triangle: positions as interpolation needs them, and the first corner's attributes with the differences of the others.
struct Corners {
    form: Barycentric,
    color: array<vec4<f32>, 3>,
    // In world space, up to length.
    normal: array<vec3<f32>, 3>,
    uv: array<vec2<f32>, 3>,
}

fn shown_slot(slot: u32) -> Shown {
    var shown: Shown;
    shown.slot = slot;
    if needs_depth() {
        return shown;
    }
    let at = frame.first_slot + slot;
    let instance = slots[at].instance;
    if needs_id() {
        shown.id = instances[instance].id;
        return shown;
    }
    let chunk = slots[at].chunk;
    shown.first = chunks[chunk].first;
    shown.vertex_first = chunks[chunk].vertex_first;
    shown.placed = placed[frame.first_instance + instance];
    if needs_normal() {
        shown.normals = normal_map(instance);
    }
    if needs_color() {
        shown.material = materials[chunks[chunk].material];
        if OVERRIDES {
            shown.material = effective_material(shown.material, instances[instance].material);
        }
    }
    return shown;
}

fn corner_color(word: u32) -> vec4<f32> {
    let color = unpack4x8unorm(vertices[word + 3u]);
    return vec4<f32>(linear_from_srgb(color.rgb), color.a);
}

fn corner_normal(word: u32) -> vec3<f32> {
    return octahedral_decode(vertices[word + 4u]);
}

fn corner_uv(word: u32) -> vec2<f32> {
    return vec2<f32>(bitcast<f32>(vertices[word + 5u]), bitcast<f32>(vertices[word + 6u]));
}

fn shown_corners(shown: Shown, triangle: u32) -> Corners {
    var corners: Corners;
    let words = corner_words(shown.first + triangle, shown.vertex_first);
    let a = vertex_camera(shown.placed, words.x);
    let b = vertex_camera(shown.placed, words.y);
    let c = vertex_camera(shown.placed, words.z);
    corners.form = barycentric_forms(a, b, c);
    if needs_normal() {
        let n = corner_normal(words.x);
        if all(n == vec3<f32>(0.0)) {
            corners.normal[0] = world_from_camera(cross(b - a, c - a));
        } else {
            corners.normal[0] = turned(shown.normals, n);
            corners.normal[1] = turned(shown.normals, corner_normal(words.y) - n);
            corners.normal[2] = turned(shown.normals, corner_normal(words.z) - n);
        }
    }
    if needs_color() {
        let color = corner_color(words.x);
        corners.color[0] = color;
        corners.color[1] = corner_color(words.y) - color;
        corners.color[2] = corner_color(words.z) - color;
    }
    if needs_color() && TEXTURES {
        let uv = corner_uv(words.x);
        corners.uv[0] = uv;
        corners.uv[1] = corner_uv(words.y) - uv;
        corners.uv[2] = corner_uv(words.z) - uv;
    }
    return corners;
}

fn surface_color(corners: Corners, material: Material, w: Weights) -> vec4<f32> {
    var color = material.base_color * (corners.color[0] + w.b * corners.color[1] + w.c * corners.color[2]);
    if TEXTURES && material.texture != 0u {
        color *= sample_texture(
            textures[material.texture - 1u],
            corners.uv[0] + w.b * corners.uv[1] + w.c * corners.uv[2],
            w.dx.x * corners.uv[1] + w.dx.y * corners.uv[2],
            w.dy.x * corners.uv[1] + w.dy.y * corners.uv[2],
        );
    }
    return color;
}

fn resolve(column: Column, shown: Shown, corners: Corners) {
    var surface: Surface;
    surface.slot = shown.slot;
    surface.id = shown.id;
    surface.inverse_depth = bitcast<f32>(column.word.y);
    surface.depth_scale = 1.0;
    if needs_color() || needs_normal() {
        let ray = ray_through(pixel_centre(column.at));
        let w = barycentric_weights(corners.form, ray);
        if needs_normal() {
            let own = corners.normal[0] + w.b * corners.normal[1] + w.c * corners.normal[2];
            surface.normal = facing_normal(own, world_from_camera(towards(ray)));
        }
        let color = surface_color(corners, shown.material, w);
        surface.alpha = clamp(color.a, 0.0, 1.0);
        // Triangles have no scalar fields.
        surface.color = select(color.rgb, linear_color(GREY), COLOR_BY == BY_FIELD);
    }
    finish(column.pixel, column.at, surface);
}

@compute @workgroup_size(64)
fn resolve_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let begin = runs[frame.first_run + segment.index].first_slot;
    let count = runs[frame.first_run + segment.index].count;
    var column = column_begin(group, lane);
    var resolved = 0u;
    resolve_load(&column, begin, count);
    loop {
        resolve_seek(&column, begin, count);
        if column_ends(column) {
            break;
        }
        var shown: Shown;
        shown.slot = NO_SLOT;
        if column.mine {
            shown = shown_slot(slot_of(column.word));
        }
        loop {
            // A pixel that shows nothing has no triangle id.
            let id = select(0u, column.word.x, column.mine);
            var corners: Corners;
            if column.mine && (needs_color() || needs_normal()) {
                corners = shown_corners(shown, ~id & SLOT_MASK);
            }
            loop {
                if column.mine {
                    resolve(column, shown, corners);
                    resolved++;
                }
                resolve_next(&column, begin, count);
                if !any_lane(column.mine) || any_lane(column.mine && column.word.x != id) {
                    break;
                }
            }
            if !any_lane(column.mine) || any_lane(column.mine && slot_of(column.word) != shown.slot) {
                break;
            }
        }
    }
    if resolved != 0u {
        note_triangles(resolved);
    }
}
