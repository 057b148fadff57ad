// The frame's output: how a pixel's word encodes a surface.
//!include shared/surface
override OUTPUT: u32 = 0u;

const OUTPUT_COLOR: u32 = 0u;
const OUTPUT_DEPTH: u32 = 1u;
const OUTPUT_NORMAL: u32 = 2u;
const OUTPUT_ID: u32 = 3u;

// Normals as bytes n · 127 + 128.
fn normal_word(n: vec3<f32>) -> u32 {
    if dot(n, n) < 0.25 {
        return 0u;
    }
    let b = vec3<u32>(round(n * 127.0 + vec3<f32>(128.0)));
    return b.x | (b.y << 8u) | (b.z << 16u) | 0xff000000u;
}

// The word of a surface whose light is computed, or which is not lit.
fn output_word(surface: Surface) -> u32 {
    if OUTPUT == OUTPUT_DEPTH {
        return bitcast<u32>(surface.depth_scale / surface.inverse_depth);
    }
    if OUTPUT == OUTPUT_ID {
        return surface.id;
    }
    if OUTPUT == OUTPUT_NORMAL {
        return normal_word(surface.normal);
    }
    return color_word(surface.color);
}
