// Attributes of the pixels that show a triangle of one page: interpolated perspective-correctly at the pixel's centre.
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

fn vertex_color(word: u32) -> vec4<f32> {
    let c = unpack4x8unorm(vertices[word + 3u]);
    return vec4<f32>(linear_from_srgb(c.rgb), c.a);
}

fn vertex_uv(word: u32) -> vec2<f32> {
    return vec2<f32>(bitcast<f32>(vertices[word + 5u]), bitcast<f32>(vertices[word + 6u]));
}

fn surface_color(corners: vec3<u32>, w: Weights, material: Material) -> vec3<f32> {
    var color = material.base_color.rgb;
    let words = vec3<u32>(vertices[corners.x + 3u], vertices[corners.y + 3u], vertices[corners.z + 3u]);
    if any(words != vec3<u32>(0xffffffffu)) {
        let a = vertex_color(corners.x).rgb;
        color *= a + w.b * (vertex_color(corners.y).rgb - a) + w.c * (vertex_color(corners.z).rgb - a);
    }
    if material.texture != 0u {
        let a = vertex_uv(corners.x);
        let ab = vertex_uv(corners.y) - a;
        let ac = vertex_uv(corners.z) - a;
        color *= sample_texture(
            textures[material.texture - 1u],
            a + w.b * ab + w.c * ac,
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

@compute @workgroup_size(64)
fn resolve_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let pixel_count = frame.size_px.x * frame.size_px.y;
    let begin = dispatches[segment.index].first_slot;
    let count = dispatches[segment.index].count;
    var shown = 0u;
    for (var k = 0u; k < PIXELS_EACH; k++) {
        let pixel = (group.x * PIXELS_EACH + k) * 64u + lane;
        if pixel >= pixel_count {
            break;
        }
        let word = visibility[pixel];
        if word.y == 0u {
            if segment.first != 0u {
                pixels[pixel] = background_word();
            }
            continue;
        }
        let id = ~word.x;
        let slot = id >> SLOT_SHIFT;
        if slot - begin >= count {
            continue;
        }
        shown++;
        if frame.output == OUTPUT_DEPTH {
            pixels[pixel] = bitcast<u32>(1.0 / bitcast<f32>(word.y));
            continue;
        }
        let instance = slots[slot].instance;
        if frame.output == OUTPUT_ID {
            pixels[pixel] = instances[instance].id;
            continue;
        }
        let chunk = chunks[slots[slot].chunk];
        let at = placed[instance];
        let corners = triangle_corners(chunk, id & SLOT_MASK);
        let form = barycentric_forms(
            vertex_camera(at, corners.x), vertex_camera(at, corners.y), vertex_camera(at, corners.z));
        let ray = ray_through(vec2<f32>(f32(pixel % frame.size_px.x), f32(pixel / frame.size_px.x)) + vec2<f32>(0.5));
        let w = barycentric_weights(form, ray);
        if frame.output == OUTPUT_NORMAL || segment.shaded != 0u {
            let n = surface_normal(instance, corners, w, form.all, ray);
            if frame.output == OUTPUT_NORMAL {
                pixels[pixel] = normal_word(n);
                continue;
            }
            normals[pixel] = octahedral_encode(n);
        }
        let material = effective_material(materials[chunk.material], instances[instance].material);
        let color = surface_color(corners, w, material);
        pixels[pixel] = pack4x8unorm(vec4<f32>(srgb_from_linear(color), 1.0));
    }
    if shown != 0u {
        atomicAdd(&stats.pixels_of_triangles, shown);
    }
}
