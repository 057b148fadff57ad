// Samples have the colour of one of their scalar fields; `crate::bake::pack` says where its code is.
//!include shared/ramp
const SHOWS_FIELD: bool = true;

// The codes of the page's samples. Geometries without fields have none here, and are grey.
@group(1) @binding(11) var<storage, read> values: array<u32>;
// The colours of classes, then for each geometry and each field of the scene where its codes are and what they stand for; see
// `src/residency/fields.rs`.
@group(1) @binding(12) var<storage, read> fields: array<vec4<u32>>;

const CLASS_ROWS: u32 = 64u;

fn field_color(sample: u32, instance: u32) -> u32 {
    let at = fields[CLASS_ROWS + instances[instance].geometry * frame.field_count + frame.field];
    // Words of a sample, lowest bit, number of bits, whether codes are classes, largest code.
    let words = at.x & 3u;
    if words == 0u {
        return GREY;
    }
    let place = (at.x >> 2u) & 63u;
    let mask = (1u << ((at.x >> 8u) & 31u)) - 1u;
    let code = (values[sample * words + place / 32u] >> (place % 32u)) & mask;
    if code > (at.x >> 16u) {
        return GREY;
    }
    if (at.x & 0x2000u) != 0u {
        var number = i32(at.y + code);
        if number < 0 || number > 255 {
            number = 32 + ((number % 224) + 224) % 224;
        }
        return fields[u32(number) / 4u][u32(number) % 4u];
    }
    let share = fma(f32(code), bitcast<f32>(at.w), bitcast<f32>(at.z));
    return ramp_color(fma(share, frame.ramp.x, frame.ramp.w));
}
