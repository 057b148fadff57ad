// Attributes of the pixels that show a triangle of one page: interpolated perspective-correctly at the pixel's centre.
//!include VOTE
//!include shared/frame
//!include shared/scene
//!include shared/octahedral
//!include shared/colour
//!include shared/material
//!include shared/mesh
//!include shared/barycentric
//!include shared/texture
//!include shared/resolve

@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(1) @binding(5) var<storage, read> textures: array<Texture>;
@group(1) @binding(6) var<storage, read> texels_0: array<u32>;
@group(1) @binding(7) var<storage, read> texels_1: array<u32>;
@group(2) @binding(3) var<storage, read> placed: array<Placed>;

fn vertex_uv(word: u32) -> vec2<f32> {
    return vec2<f32>(bitcast<f32>(vertices[word + 5u]), bitcast<f32>(vertices[word + 6u]));
}

fn surface_color(corners: vec3<u32>, w: Weights, material: Material) -> vec3<f32> {
    let a = linear_from_srgb(unpack4x8unorm(vertices[corners.x + 3u]).rgb);
    let b = linear_from_srgb(unpack4x8unorm(vertices[corners.y + 3u]).rgb);
    let c = linear_from_srgb(unpack4x8unorm(vertices[corners.z + 3u]).rgb);
    var color = material.base_color.rgb * (a + w.b * (b - a) + w.c * (c - a));
    if TEXTURES && material.texture != 0u {
        let uv = vertex_uv(corners.x);
        let ab = vertex_uv(corners.y) - uv;
        let ac = vertex_uv(corners.z) - uv;
        color *= sample_texture(
            textures[material.texture - 1u],
            uv + w.b * ab + w.c * ac,
            w.dx.x * ab + w.dx.y * ac,
            w.dy.x * ab + w.dy.y * ac,
        ).rgb;
    }
    return color;
}

fn surface_normal(instance: u32, corners: vec3<u32>, w: Weights, plane: vec3<f32>, ray: vec3<f32>) -> vec3<f32> {
    let towards = world_from_camera(ray);
    let a = vertices[corners.x + 4u];
    if a == NO_NORMAL {
        return facing_normal(world_from_camera(plane), towards);
    }
    let na = octahedral_decode(a);
    let nb = octahedral_decode(vertices[corners.y + 4u]);
    let nc = octahedral_decode(vertices[corners.z + 4u]);
    return world_normal(instance, na + w.b * (nb - na) + w.c * (nc - na), towards);
}

fn resolve(pixel: u32, at: vec2<u32>, word: vec2<u32>) {
    if OUTPUT == OUTPUT_DEPTH {
        pixels[pixel] = bitcast<u32>(1.0 / bitcast<f32>(word.y));
        return;
    }
    let id = ~word.x;
    let slot = id >> SLOT_SHIFT;
    let instance = slots[slot].instance;
    if OUTPUT == OUTPUT_ID {
        pixels[pixel] = instances[instance].id;
        return;
    }
    let chunk = chunks[slots[slot].chunk];
    let seen = placed[instance];
    let corners = triangle_corners(chunk, id & SLOT_MASK);
    let form = barycentric_forms(
        vertex_camera(seen, corners.x), vertex_camera(seen, corners.y), vertex_camera(seen, corners.z));
    let ray = ray_through(pixel_centre(at));
    let w = barycentric_weights(form, ray);
    if OUTPUT == OUTPUT_NORMAL || SHADED {
        let n = surface_normal(instance, corners, w, form.all, ray);
        if OUTPUT == OUTPUT_NORMAL {
            pixels[pixel] = normal_word(n);
            return;
        }
        normals[pixel] = octahedral_encode(n);
    }
    var material = materials[chunk.material];
    if OVERRIDES {
        material = effective_material(material, instances[instance].material);
    }
    let color = surface_color(corners, w, material);
    pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
}

@compute @workgroup_size(64)
fn resolve_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let begin = dispatches[segment.index].first_slot;
    let count = dispatches[segment.index].count;
    let width = frame.size_px.x;
    var walk = walk_begin(group, lane);
    var shown = 0u;
    loop {
        var mine = false;
        loop {
            if walk.pixel >= walk.end {
                break;
            }
            walk.word = visibility[walk.pixel];
            if walk.word.y == 0u && segment.first != 0u {
                pixels[walk.pixel] = background_word();
            }
            mine = walk.word.y != 0u && ((~walk.word.x) >> SLOT_SHIFT) - begin < count;
            if any_lane(mine) {
                break;
            }
            walk.pixel += width;
            walk.at.y++;
        }
        if walk.pixel >= walk.end {
            break;
        }
        if mine {
            resolve(walk.pixel, walk.at, walk.word);
            shown++;
        }
        walk.pixel += width;
        walk.at.y++;
    }
    if shown != 0u {
        atomicAdd(&stats.pixels_of_triangles, shown);
    }
}
