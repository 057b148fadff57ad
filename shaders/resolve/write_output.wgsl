// Writes the output from kept surfaces: colours them by a value where that is asked for, then applies light and effects that read
// neighbouring pixels, and encodes the pixel.
//!include shared/frame
//!include shared/scene
//!include VOTE
//!include shared/column
//!include shared/colour
//!include shared/kept_color
//!include shared/material
//!include shared/octahedral
//!include shared/output
//!include shared/light
//!include shared/edl
//!include OPENNESS
//!include KEPT_MAPS
//!include shared/recolor
//!include shared/fog
// Eye-dome lighting is on.
override EDL: bool = true;
// At least one instance overrides its asset's materials.
override OVERRIDES: bool = true;

@group(0) @binding(1) var<storage, read> visibility: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> pixels: array<u32>;
@group(0) @binding(3) var<storage, read> normals: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: array<Stats>;
@group(0) @binding(9) var<storage, read> colors: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(3) var<storage, read> instances: array<Instance>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
@group(2) @binding(0) var<storage, read> slots: array<Slot>;

// The surface that a resolve pass kept.
fn kept_surface(column: Column) -> Surface {
    let packed = normals[column.pixel];
    var surface: Surface;
    surface.color = color_of_kept(colors[column.pixel]);
    surface.is_ball = packed == BALL;
    surface.normal = select(octahedral_decode(packed), vec3<f32>(0.0), surface.is_ball);
    surface.inverse_depth = bitcast<f32>(column.word.y);
    surface.depth_scale = 1.0;
    surface.slot = slot_of(column.word);
    recall_maps(column.pixel, &surface);
    return surface;
}

@compute @workgroup_size(64)
fn write_output(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    var column = column_begin(group, lane);
    column_load(&column);
    loop {
        loop {
            if column_ends(column) || any_lane(column.mine) {
                break;
            }
            column_step(&column);
            column_load(&column);
        }
        if column_ends(column) {
            break;
        }
        if column.mine {
            var surface = kept_surface(column);
            let is_lit = normals[column.pixel] == LIT_ALREADY;
            if !is_lit {
                surface.color = recoloured(surface, column.at);
            }
            if OCCLUSION && !is_lit {
                ambient_share = open_share(column.at, column.pixel);
            }
            if SHADED && !is_lit {
                surface.color = lit_color(surface, material_of(surface), column.at);
            } else if !is_lit {
                surface.color = unlit_color(surface.color);
            }
            if EDL {
                // Outlines show on surfaces that are too bright for the image as well.
                surface.color = min(surface.color, vec3<f32>(1.0)) * eye_dome(column.at, surface.inverse_depth);
            }
            surface.color = fogged_at(surface.color, column.at, 1.0 / surface.inverse_depth);
            pixels[column.pixel] = output_word(surface);
        }
        column_step(&column);
        column_load(&column);
    }
}
