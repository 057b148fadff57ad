// Attributes of the pixels that show a triangle of one page: interpolated perspective-correctly at the pixel's centre.
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/mesh
//!include shared/barycentric
//!include shared/texture
//!include shared/normals
//!include shared/resolve

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(1) @binding(5) var<storage, read> textures: array<Texture>;
@group(1) @binding(6) var<storage, read> texels_0: array<u32>;
@group(1) @binding(7) var<storage, read> texels_1: array<u32>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// What the triangles of a slot have in common.
struct Shown {
    slot: u32,
    first: u32,
    vertex_first: u32,
    placed: Placed,
    normals: NormalMap,
    material: Material,
    id: u32,
}

// One of them: positions as interpolation needs them, and attributes of the first corner with what the others differ.
struct Corners {
    form: Barycentric,
    color: array<vec3<f32>, 3>,
    // In world space, up to length.
    normal: array<vec3<f32>, 3>,
    uv: array<vec2<f32>, 3>,
}

fn shown_slot(slot: u32) -> Shown {
    var shown: Shown;
    shown.slot = slot;
    if OUTPUT == OUTPUT_DEPTH {
        return shown;
    }
    let at = frame.first_slot + slot;
    let instance = slots[at].instance;
    if OUTPUT == OUTPUT_ID {
        shown.id = instances[instance].id;
        return shown;
    }
    let chunk = slots[at].chunk;
    shown.first = chunks[chunk].first;
    shown.vertex_first = chunks[chunk].vertex_first;
    shown.placed = placed[frame.first_instance + instance];
    if OUTPUT == OUTPUT_NORMAL || SHADED {
        shown.normals = normal_map(instance);
    }
    if OUTPUT == OUTPUT_COLOR {
        shown.material = materials[chunks[chunk].material];
        if OVERRIDES {
            shown.material = effective_material(shown.material, instances[instance].material);
        }
    }
    return shown;
}

fn corner_color(word: u32) -> vec3<f32> {
    return linear_from_srgb(unpack4x8unorm(vertices[word + 3u]).rgb);
}

fn corner_normal(word: u32) -> vec3<f32> {
    return octahedral_decode(vertices[word + 4u]);
}

fn corner_uv(word: u32) -> vec2<f32> {
    return vec2<f32>(bitcast<f32>(vertices[word + 5u]), bitcast<f32>(vertices[word + 6u]));
}

fn shown_corners(shown: Shown, triangle: u32) -> Corners {
    var surface: Corners;
    let corners = corner_words(shown.first + triangle, shown.vertex_first);
    surface.form = barycentric_forms(
        vertex_camera(shown.placed, corners.x),
        vertex_camera(shown.placed, corners.y),
        vertex_camera(shown.placed, corners.z),
    );
    if OUTPUT == OUTPUT_NORMAL || SHADED {
        let n = corner_normal(corners.x);
        if all(n == vec3<f32>(0.0)) {
            surface.normal[0] = world_from_camera(surface.form.all);
        } else {
            surface.normal[0] = turned(shown.normals, n);
            surface.normal[1] = turned(shown.normals, corner_normal(corners.y) - n);
            surface.normal[2] = turned(shown.normals, corner_normal(corners.z) - n);
        }
    }
    if OUTPUT == OUTPUT_COLOR {
        let color = corner_color(corners.x);
        surface.color[0] = color;
        surface.color[1] = corner_color(corners.y) - color;
        surface.color[2] = corner_color(corners.z) - color;
    }
    if OUTPUT == OUTPUT_COLOR && TEXTURES {
        let uv = corner_uv(corners.x);
        surface.uv[0] = uv;
        surface.uv[1] = corner_uv(corners.y) - uv;
        surface.uv[2] = corner_uv(corners.z) - uv;
    }
    return surface;
}

fn surface_color(surface: Corners, material: Material, w: Weights) -> vec3<f32> {
    var color = material.base_color.rgb * (surface.color[0] + w.b * surface.color[1] + w.c * surface.color[2]);
    if TEXTURES && material.texture != 0u {
        color *= sample_texture(
            textures[material.texture - 1u],
            surface.uv[0] + w.b * surface.uv[1] + w.c * surface.uv[2],
            w.dx.x * surface.uv[1] + w.dx.y * surface.uv[2],
            w.dy.x * surface.uv[1] + w.dy.y * surface.uv[2],
        ).rgb;
    }
    return color;
}

fn resolve(column: Column, shown: Shown, surface: Corners) {
    let pixel = column.pixel;
    if OUTPUT == OUTPUT_DEPTH {
        pixels[pixel] = bitcast<u32>(1.0 / bitcast<f32>(column.word.y));
        return;
    }
    if OUTPUT == OUTPUT_ID {
        pixels[pixel] = shown.id;
        return;
    }
    let ray = ray_through(pixel_centre(column.at));
    let w = barycentric_weights(surface.form, ray);
    if OUTPUT == OUTPUT_NORMAL || SHADED {
        let own = surface.normal[0] + w.b * surface.normal[1] + w.c * surface.normal[2];
        let n = facing_normal(own, world_from_camera(ray));
        if OUTPUT == OUTPUT_NORMAL {
            pixels[pixel] = normal_word(n);
            return;
        }
        normals[pixel] = octahedral_encode(n);
    }
    let color = surface_color(surface, shown.material, w);
    pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
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
            // Of a pixel that shows nothing: no id of a triangle.
            let id = select(0u, column.word.x, column.mine);
            var surface: Corners;
            if column.mine && (OUTPUT == OUTPUT_COLOR || OUTPUT == OUTPUT_NORMAL) {
                surface = shown_corners(shown, ~id & SLOT_MASK);
            }
            loop {
                if column.mine {
                    resolve(column, shown, surface);
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
        atomicAdd(&stats[frame.view].pixels_of_triangles, resolved);
    }
}
