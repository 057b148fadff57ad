// Writes the attributes of the pixels that show a triangle of one page, perspective-correctly interpolated at the pixel's centre.
//!include shared/frame
//!include shared/scene
//!include shared/mesh
//!include shared/barycentric
//!include shared/texture
//!include shared/normals
//!include shared/resolve
//!include shared/transmits

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
    mirrored: bool,
}

// One triangle: positions as interpolation needs them, and the first corner's attributes with the differences of the others.
struct Corners {
    form: Barycentric,
    color: array<vec4<f32>, 3>,
    // In world space, up to length.
    normal: array<vec3<f32>, 3>,
    uv: array<vec2<f32>, 3>,
    // Where materials have maps, in world space and up to length: the directions in which u and v grow, zero where the texture coordinates
    // tell none.
    along_u: vec3<f32>,
    along_v: vec3<f32>,
    // The triangle's front is seen: counter-clockwise as the file has it.
    shows_front: bool,
}

// Where a pixel is on textures.
struct Footprint {
    uv: vec2<f32>,
    dx: vec2<f32>,
    dy: vec2<f32>,
}

// Some map says how the surface is turned.
fn needs_maps() -> bool {
    return MAPS && (needs_color() || needs_normal());
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
    if MAPS {
        shown.mirrored = (instances[instance].flags & INSTANCE_MIRRORED) != 0u;
    }
    if needs_color() || needs_maps() {
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
    if (needs_color() || needs_maps()) && TEXTURES {
        let uv = corner_uv(words.x);
        corners.uv[0] = uv;
        corners.uv[1] = corner_uv(words.y) - uv;
        corners.uv[2] = corner_uv(words.z) - uv;
    }
    if needs_maps() {
        let turn = select(-1.0, 1.0, corners.uv[1].x * corners.uv[2].y - corners.uv[2].x * corners.uv[1].y > 0.0);
        corners.along_u = turn * world_from_camera((b - a) * corners.uv[2].y - (c - a) * corners.uv[1].y);
        corners.along_v = turn * world_from_camera((c - a) * corners.uv[1].x - (b - a) * corners.uv[2].x);
        corners.shows_front = (dot(cross(b - a, c - a), towards(a)) < 0.0) != shown.mirrored;
    }
    return corners;
}

fn footprint(corners: Corners, w: Weights) -> Footprint {
    return Footprint(
        corners.uv[0] + w.b * corners.uv[1] + w.c * corners.uv[2],
        w.dx.x * corners.uv[1] + w.dx.y * corners.uv[2],
        w.dy.x * corners.uv[1] + w.dy.y * corners.uv[2],
    );
}

// The values of a texture, given as its number plus one; `none` where that is 0.
fn map_values(number: u32, at: Footprint, none: vec3<f32>) -> vec3<f32> {
    if number == 0u {
        return none;
    }
    return sample_texture(textures[number - 1u], at.uv, at.dx, at.dy).rgb;
}

// The normal that a map gives a surface whose own one, turned to the eye, is `n`. Green points along decreasing v.
fn mapped_normal(n: vec3<f32>, corners: Corners, material: Material, at: Footprint) -> vec3<f32> {
    if material.normal_map == 0u {
        return n;
    }
    let side = select(-1.0, 1.0, corners.shows_front);
    let front = n * side;
    let tangent = unit_or_zero(corners.along_u - front * dot(front, corners.along_u));
    let across = cross(front, tangent);
    let bitangent = select(across, -across, dot(across, corners.along_v) > 0.0);
    let texel = 2.0 * map_values(material.normal_map, at, vec3<f32>(0.5)) - vec3<f32>(1.0);
    let scaled = vec3<f32>(texel.xy * material.normal_scale, texel.z);
    let mapped = unit_or_zero(tangent * scaled.x + bitangent * scaled.y + front * scaled.z) * side;
    let is_known = any(tangent != vec3<f32>(0.0)) && any(mapped != vec3<f32>(0.0));
    return select(n, mapped, is_known);
}

fn surface_color(corners: Corners, material: Material, w: Weights) -> vec4<f32> {
    var color = material.base_color * (corners.color[0] + w.b * corners.color[1] + w.c * corners.color[2]);
    if TEXTURES && material.texture != 0u {
        let at = footprint(corners, w);
        color *= sample_texture(textures[material.texture - 1u], at.uv, at.dx, at.dy);
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
        if needs_maps() {
            let material = shown.material;
            let at = footprint(corners, w);
            surface.normal = mapped_normal(surface.normal, corners, material, at);
            let reflection = map_values(material.reflection_map, at, vec3<f32>(1.0));
            let open = map_values(material.occlusion_map, at, vec3<f32>(1.0)).r;
            surface.taken = vec3<f32>(1.0) - vec3<f32>(open, reflection.gb);
            surface.dimmed = vec3<f32>(1.0) - map_values(material.emissive_map, at, vec3<f32>(1.0));
            if TRANSMITS {
                surface.stopped = 1.0 - map_values(material.transmission_map, at, vec3<f32>(1.0)).r;
            }
        }
        let color = surface_color(corners, shown.material, w);
        // Alpha does not say how much glass hides.
        let is_solid = TRANSMITS && (shown.material.flags & MATERIAL_SOLID) != 0u;
        surface.alpha = select(clamp(color.a, 0.0, 1.0), 1.0, is_solid);
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
