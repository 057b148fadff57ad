// Colours of pixels that show splats blended in a single pass: the nearest slab combined with the slab behind it.
//!include shared/frame
//!include shared/scene
//!include shared/kept
//!include shared/resolve
//!include shared/slabs

// Each pixel holds the even slab, then the odd slab; of each, the lower half, then the upper half.
@group(0) @binding(5) var<storage, read> layers: array<vec4<u32>>;

// Red, green, blue and weight.
fn sums_of(word: vec2<u32>) -> vec4<f32> {
    let red = ((word.y & 0x3fu) << 7u) | (word.x >> 25u);
    let color = vec3<f32>(vec3<u32>(red, (word.x >> 12u) & 0x1fffu, word.x & 0xfffu));
    return vec4<f32>(color / vec3<f32>(1.0, 1.0, BLUE_STEPS), f32(weights_of(word.y)));
}

// Adds both slabs if they are adjacent and show one side of a surface; otherwise returns the nearer slab alone.
fn both_slabs(words: vec4<u32>) -> vec4<f32> {
    let even = SLAB_NEAREST - tag_of(words.y);
    let odd = SLAB_NEAREST - tag_of(words.w);
    // Slabs 2n and 2n + 1 have the same number among the even and the odd slabs.
    let even_first = (even >> 1u) <= (odd >> 1u);
    let apart = select((even >> 1u) - (odd >> 1u) - 1u, (odd >> 1u) - (even >> 1u), even_first);
    let nearer = select(words.zw, words.xy, even_first);
    let farther = select(words.xy, words.zw, even_first);
    let beside = tag_of(farther.y) != 0u && apart == 0u && ((even ^ odd) & 1u) == 0u;
    if weights_of(nearer.y) == WEIGHTS_FULL || (beside && weights_of(farther.y) == WEIGHTS_FULL) {
        atomicMax(&stats[frame.view].sums_full, 1u);
    }
    return sums_of(nearer) + select(vec4<f32>(0.0), sums_of(farther), beside);
}

@compute @workgroup_size(64)
fn resolve_fuzzy(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    var column = column_begin(group, lane);
    var resolved = 0u;
    loop {
        if column_ends(column) {
            break;
        }
        var words = vec4<u32>(0u);
        if column.inside {
            words = layers[column.pixel];
        }
        column.mine = (words.y | words.w) != 0u;
        if column.mine {
            let sums = both_slabs(words);
            pixels[column.pixel] = color_word(sums.rgb / max(sums.a, 1.0));
            // The triangle at this pixel lies behind the splats.
            visibility[column.pixel] = vec2<u32>(0u);
            resolved++;
        }
        column_step(&column);
    }
    if resolved != 0u {
        atomicAdd(&stats[frame.view].pixels_of_samples, resolved);
    }
}
