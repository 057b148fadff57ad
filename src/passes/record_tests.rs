//! Numbers that Rust and WGSL both write down, compared as naga reads them. Needs no GPU.

use naga::{Expression, Handle, Literal, Module};

use crate::bake::environment::{BALL, LEAST_ROUGHNESS, MIRRORED, SCATTERED};
use crate::bake::pack::{
    BEGINS, CHUNK, DIRECTION_WORDS, ENDS, GeometryKind, LINE_WORDS, NO_NORMAL, VERTEX_WORDS,
};
use crate::gpu::shader::parse;
use crate::math::MOST_EXPOSURES;
use crate::passes::frame::output_number;
use crate::passes::project::LANES;
use crate::passes::recorder::DISPATCH_ROW;
use crate::passes::resolve::TILE;
use crate::passes::scratch::{
    BLOCK_PX, BLOCK_WORDS, CLIPPED_RECORD_BYTES, DEPTHS_BYTES, DIGIT_VALUES, MOST_ENTRIES,
    MOST_PAINTED, RECORD_BYTES,
};
use crate::passes::select::{compact, cull, place};
use crate::passes::shaders::{Choices, composed, source};
use crate::passes::slabs::SLABS;
use crate::passes::uniforms::DIGITS;
use crate::passes::windows::LAYERS;
use crate::plan::{Output, TURNS};
use crate::residency::layout::*;
use crate::residency::{GROUP, PART};
use crate::scene::MOST_CASTING_LIGHTS;

/// The module of a root, whichever way it is composed.
fn module(root: &str) -> Module {
    parse(root, &composed(root, &Choices::default()).unwrap()).unwrap()
}

fn words(module: &Module, expression: Handle<Expression>) -> Vec<u32> {
    match &module.global_expressions[expression] {
        Expression::Literal(Literal::U32(value)) => vec![*value],
        Expression::Literal(Literal::I32(value)) => vec![u32::try_from(*value).unwrap()],
        Expression::Compose { components, .. } => {
            components.iter().flat_map(|&component| words(module, component)).collect()
        }
        other => panic!("{other:?} is no number"),
    }
}

/// The value of a module's constant, one word a component.
fn vector(module: &Module, name: &str) -> Vec<u32> {
    let mut constants = module.constants.iter();
    let found = constants.find(|(_, constant)| constant.name.as_deref() == Some(name));
    let (_, constant) = found.unwrap_or_else(|| panic!("no constant {name}"));
    words(module, constant.init)
}

fn scalar(module: &Module, name: &str) -> u32 {
    let [value] = vector(module, name)[..] else { panic!("{name} is no scalar") };
    value
}

fn float(module: &Module, name: &str) -> f32 {
    let mut constants = module.constants.iter();
    let found = constants.find(|(_, constant)| constant.name.as_deref() == Some(name));
    let (_, constant) = found.unwrap_or_else(|| panic!("no constant {name}"));
    match module.global_expressions[constant.init] {
        Expression::Literal(Literal::F32(value)) => value,
        ref other => panic!("{other:?} is no number"),
    }
}

/// Threads in x of the module's only compute workgroup; there is one in y and z.
fn threads(module: &Module) -> u32 {
    let [entry] = &module.entry_points[..] else { panic!("one entry point is expected") };
    assert_eq!(entry.workgroup_size[1..], [1, 1]);
    entry.workgroup_size[0]
}

#[test]
fn direct_dispatches_cover_what_they_must() {
    let module_of_cull = module("select/cull");
    assert_eq!(scalar(&module_of_cull, "GROUP") * threads(&module_of_cull), cull::ENTRIES);
    assert_eq!(threads(&module("select/place")), place::INSTANCES);
    assert_eq!(threads(&module("select/compact")), compact::ENTRIES);
}

#[test]
fn what_is_hidden_is_asked_of_as_many() {
    let ask = module("select/cull_hidden");
    assert_eq!(scalar(&ask, "TURNS"), TURNS);
    assert_eq!(scalar(&ask, "PART") as usize, PART);
    assert_eq!(scalar(&ask, "BLOCK_PX"), BLOCK_PX);
    assert_eq!(scalar(&ask, "BLOCK_WORDS"), BLOCK_WORDS);
    assert_eq!(4 * u64::from(scalar(&ask, "DEPTHS_WORDS")), DEPTHS_BYTES);
    assert!(scalar(&ask, "DEPTHS_WORDS") > scalar(&ask, "DEPTH_BINS") + TURNS);
    // A place in the list of what is far has a slot below and a bin of depth above.
    assert_eq!(scalar(&ask, "TURN_SLOT"), (1 << scalar(&ask, "TURN_SHIFT")) - 1);
    assert!(MOST_ENTRIES - 1 <= scalar(&ask, "TURN_SLOT"));
    assert!(scalar(&ask, "DEPTH_BINS") < 1 << (32 - scalar(&ask, "TURN_SHIFT")));
}

#[test]
fn rows_of_dispatches_are_as_long() {
    let roots = [
        "select/place",
        "select/cull",
        "select/scan",
        "select/compact",
        "project/project_samples",
        "project/project_triangles",
        "project/project_lines",
    ];
    for root in roots {
        assert_eq!(scalar(&module(root), "DISPATCH_ROW"), DISPATCH_ROW, "{root}");
    }
}

#[test]
fn groups_of_entries_are_as_long() {
    for root in ["select/cull", "select/compact"] {
        assert_eq!(scalar(&module(root), "GROUP") as usize, GROUP, "{root}");
    }
}

#[test]
fn tiles_are_as_large() {
    for root in [
        "resolve/resolve_samples",
        "resolve/resolve_triangles",
        "resolve/resolve_lines",
        "resolve/write_output",
    ] {
        assert_eq!(vector(&module(root), "TILE"), [TILE.0, TILE.1], "{root}");
    }
}

#[test]
fn the_walk_has_as_many_threads() {
    for root in [
        "project/walk_triangles",
        "project/walk_splats",
        "project/walk_lines",
        "reconstruct/blend_walked",
        "reconstruct/fuzzy_walked",
    ] {
        let walk = module(root);
        assert_eq!(scalar(&walk, "LANES"), LANES, "{root}");
        assert_eq!(threads(&walk), LANES, "{root}");
    }
}

#[test]
fn slabs_are_as_many() {
    for root in ["reconstruct/fuzzy_splats", "resolve/resolve_fuzzy"] {
        assert_eq!(f64::from(float(&module(root), "SLABS")), SLABS, "{root}");
    }
}

#[test]
fn images_of_surroundings_are_those_that_are_made() {
    let choices = Choices { environment: true, shadows: true, ..Choices::default() };
    let root = "resolve/resolve_triangles";
    let triangles = parse(root, &composed(root, &choices).unwrap()).unwrap();
    for (name, value) in
        [("MIRRORED_IMAGES", MIRRORED), ("SCATTERED", SCATTERED), ("BALL_SEEN", BALL)]
    {
        assert_eq!(scalar(&triangles, name) as usize, value, "{name}");
    }
    assert_eq!(float(&triangles, "FIRST_ROUGHNESS"), LEAST_ROUGHNESS);
    assert_eq!(scalar(&triangles, "RECORDS") as usize, MOST_CASTING_LIGHTS);
}

#[test]
fn packing_is_read_as_it_is_written() {
    let triangles = module("resolve/resolve_triangles");
    assert_eq!(scalar(&triangles, "VERTEX_WORDS") as usize, VERTEX_WORDS);
    assert_eq!(scalar(&triangles, "NO_NORMAL"), NO_NORMAL);
    let lines = module("resolve/resolve_lines");
    assert_eq!(scalar(&lines, "TUBE_WORDS") as usize, LINE_WORDS);
    assert_eq!(scalar(&lines, "RIBBON_WORDS") as usize, LINE_WORDS + DIRECTION_WORDS);
    assert_eq!([scalar(&lines, "LINE_BEGINS"), scalar(&lines, "LINE_ENDS")], [BEGINS, ENDS]);
    // A word of the visibility buffer names a slot and one of its chunk's elements.
    assert_eq!(1 << scalar(&triangles, "SLOT_SHIFT"), CHUNK);
    assert_eq!(scalar(&triangles, "SLOT_MASK") as usize, CHUNK - 1);
    let compact = module("select/compact");
    for &kind in GeometryKind::ALL {
        assert_eq!(scalar(&compact, &kind.name().to_uppercase()), kind as u32, "{kind:?}");
    }
    // The padding of the list of entries.
    assert_eq!(scalar(&module("select/cull"), "NO_INSTANCE"), u32::MAX);
    let ranks = ["select/cull", "select/compact"].map(|root| scalar(&module(root), "NOT_VISIBLE"));
    assert_eq!(ranks[0], ranks[1]);
}

#[test]
fn flags_and_outputs_have_the_same_numbers() {
    let triangles = module("resolve/resolve_triangles");
    let numbers = [
        ("INSTANCE_MIRRORED", INSTANCE_MIRRORED),
        ("INSTANCE_TRANSLUCENT", INSTANCE_TRANSLUCENT),
        ("INSTANCE_CLEAR", INSTANCE_CLEAR),
        ("MATERIAL_DOUBLE_SIDED", MATERIAL_DOUBLE_SIDED),
        ("MATERIAL_UNLIT", MATERIAL_UNLIT),
        ("MATERIAL_ALPHA_TEST", MATERIAL_ALPHA_TEST),
        ("MATERIAL_PHYSICAL", MATERIAL_PHYSICAL),
        ("OVERRIDE_METALLIC", OVERRIDE_METALLIC),
        ("OVERRIDE_ROUGHNESS", OVERRIDE_ROUGHNESS),
        ("OVERRIDE_EMISSIVE", OVERRIDE_EMISSIVE),
        ("OVERRIDE_BASE_COLOR", OVERRIDE_BASE_COLOR),
        ("OVERRIDE_SPECULAR", OVERRIDE_SPECULAR),
        ("OVERRIDE_SHININESS", OVERRIDE_SHININESS),
        ("OVERRIDE_UNLIT", OVERRIDE_UNLIT),
        ("OVERRIDE_DOUBLE_SIDED", OVERRIDE_DOUBLE_SIDED),
        ("CHUNK_ORIENTED", CHUNK_ORIENTED),
        ("CHUNK_CLOSED", CHUNK_CLOSED),
        ("CHUNK_SORTED", CHUNK_SORTED),
        ("CHUNK_TRANSLUCENT", CHUNK_TRANSLUCENT),
        ("OUTPUT_COLOR", output_number(Output::Color)),
        ("OUTPUT_DEPTH", output_number(Output::Depth)),
        ("OUTPUT_NORMAL", output_number(Output::Normal)),
        ("OUTPUT_ID", output_number(Output::Id)),
    ];
    for (name, number) in numbers {
        assert_eq!(scalar(&triangles, name), number, "{name}");
    }
}

/// Elements of a global array of fixed length.
fn array_length(module: &Module, name: &str) -> u32 {
    let mut globals = module.global_variables.iter();
    let (_, variable) = globals.find(|(_, v)| v.name.as_deref() == Some(name)).unwrap();
    match module.types[variable.ty].inner {
        naga::TypeInner::Array { size: naga::ArraySize::Constant(size), .. } => size.get(),
        ref other => panic!("{name} is {other:?}"),
    }
}

#[test]
fn views_fit_their_records() {
    let walk = module("project/walk_triangles");
    assert_eq!(scalar(&walk, "STATS_WORDS") as usize * 4, size_of::<GpuStats>());
    assert_eq!(array_length(&walk, "frames"), MOST_VIEWS);
    // An entry of the list of large triangles: two rows and a view in one word.
    let row_bits = scalar(&walk, "ROW_BITS");
    assert_eq!(1 << row_bits, MOST_ROWS);
    assert_eq!(scalar(&walk, "ROW_MASK"), MOST_ROWS - 1);
    assert!(MOST_VIEWS <= 1 << (32 - 2 * row_bits));
}

#[test]
fn painted_splats_fit_their_records() {
    let sort = module("reconstruct/move_tiles");
    assert_eq!(scalar(&sort, "VALUES"), DIGIT_VALUES);
    assert_eq!(scalar(&sort, "TILES").pow(2), DIGIT_VALUES);
    assert_eq!(scalar(&module("reconstruct/count_keys"), "DIGITS"), DIGITS);
    assert_eq!(1 << scalar(&sort, "PLACE_BITS"), MOST_PAINTED);
    assert_eq!(scalar(&sort, "PLACE"), MOST_PAINTED - 1);
    assert_eq!(1 << scalar(&sort, "TILE_BITS"), DIGIT_VALUES);
    let records = [RECORD_BYTES, CLIPPED_RECORD_BYTES];
    let vectors = ["RECORD", "CLIPPED_RECORD"].map(|name| u64::from(scalar(&sort, name)));
    assert_eq!(records, vectors.map(|count| 16 * count));
}

#[test]
fn lights_fit_their_records() {
    let resolve = module("resolve/resolve_triangles");
    assert_eq!(array_length(&resolve, "few_lights"), FEW_LIGHTS);
}

#[test]
fn as_many_layers_are_kept_as_are_resolved() {
    let choices = Choices { layers: true, ..Choices::default() };
    let root = "resolve/resolve_triangles";
    let resolve = parse(root, &composed(root, &choices).unwrap()).unwrap();
    assert_eq!(scalar(&resolve, "LAYERS"), LAYERS);
    let sinks = source("shared/sinks").unwrap();
    assert_eq!(sinks.matches("rest = sink(").count() as u32, LAYERS);
    assert!(sinks.contains(&format!("sink({}u, pixel", LAYERS - 1)));
}

/// White in every part of every exposure.
#[test]
fn sums_of_exposures_fit_their_words() {
    let one = f64::from(float(&module("resolve/accumulate"), "ONE"));
    let parts = u32::pow(4, 2);
    assert!(one * f64::from(MOST_EXPOSURES * parts) <= f64::from(u32::MAX), "{one}");
    assert!(2.0 * one * f64::from(MOST_EXPOSURES * parts) > f64::from(u32::MAX), "{one}");
}
