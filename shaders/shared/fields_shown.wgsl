// Samples and lines have the colour of one of their scalar fields; `crate::bake::pack` says where its code is.
//!include shared/ramp
const SHOWS_FIELD: bool = true;

// The codes of the page's samples, or of the vertices of its lines. Geometries without fields have none here, and are grey.
@group(1) @binding(11) var<storage, read> values: array<u32>;
// The colours of classes, then for each geometry and each field of the scene where its codes are and what they stand for; see
// `src/residency/fields.rs`.
@group(1) @binding(12) var<storage, read> fields: array<vec4<u32>>;

const CLASS_ROWS: u32 = 64u;

fn shown_field(instance: u32) -> vec4<u32> {
    return fields[CLASS_ROWS + instances[instance].geometry * frame.field_count + frame.field];
}

// Words of an element, lowest bit, number of bits, whether codes are classes, largest code.
fn code_of(field: vec4<u32>, element: u32) -> u32 {
    let place = (field.x >> 2u) & 63u;
    let mask = (1u << ((field.x >> 8u) & 31u)) - 1u;
    return (values[element * (field.x & 3u) + place / 32u] >> (place % 32u)) & mask;
}

fn is_of_classes(field: vec4<u32>) -> bool {
    return (field.x & 0x2000u) != 0u;
}

// The colour of a code, or of a value between two codes.
fn value_color(field: vec4<u32>, code: f32) -> u32 {
    let share = fma(code, bitcast<f32>(field.w), bitcast<f32>(field.z));
    return ramp_color(fma(share, frame.ramp.x, frame.ramp.w));
}

fn code_color(field: vec4<u32>, code: u32) -> u32 {
    if code > (field.x >> 16u) {
        return GREY;
    }
    if is_of_classes(field) {
        var number = i32(field.y + code);
        if number < 0 || number > 255 {
            number = 32 + ((number % 224) + 224) % 224;
        }
        return fields[u32(number) / 4u][u32(number) % 4u];
    }
    return value_color(field, f32(code));
}

fn field_color(sample: u32, instance: u32) -> u32 {
    let field = shown_field(instance);
    if (field.x & 3u) == 0u {
        return GREY;
    }
    return code_color(field, code_of(field, sample));
}

// The colour at a share of the way between two vertices of a line: see `Field::between`.
fn field_color_between(vertices: vec2<u32>, share: f32, instance: u32) -> u32 {
    let field = shown_field(instance);
    if (field.x & 3u) == 0u {
        return GREY;
    }
    let codes = vec2<u32>(code_of(field, vertices.x), code_of(field, vertices.y));
    if is_of_classes(field) || max(codes.x, codes.y) > (field.x >> 16u) {
        return code_color(field, select(codes.y, codes.x, share < 0.5));
    }
    return value_color(field, mix(f32(codes.x), f32(codes.y), share));
}
