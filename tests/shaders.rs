//! Every module that can be composed parses, and validates with the device's capabilities. Needs no GPU.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

use std::collections::BTreeSet;
use std::path::Path;

use naga::valid::{Capabilities, ValidationFlags, Validator};
use pointillist::gpu::shader::{self, Composed};
use pointillist::passes::shaders::{self, Choices, Portion, SHARED, Visibility, roots};
use pointillist::plan::{Kind, Pass};

/// Capabilities that 64-bit atomics need.
const WIDE: Capabilities =
    Capabilities::SHADER_INT64.union(Capabilities::SHADER_INT64_ATOMIC_MIN_MAX);

/// Capabilities that 64-bit sums need.
const WIDE_SUMS: Capabilities =
    Capabilities::SHADER_INT64.union(Capabilities::SHADER_INT64_ATOMIC_ALL_OPS);

fn uses(root: &str, alias: &str) -> bool {
    shaders::source(root).unwrap().lines().any(|line| line == format!("//!include {alias}"))
}

/// Every composition of a root with its name and choices.
fn compositions(root: &str) -> Vec<(String, Choices, Composed)> {
    let whole = shaders::composed(root, &Choices::default()).unwrap().source;
    // A choice matters to a root that includes its name, directly or through other includes.
    let asks = |alias: &str| {
        uses(root, alias)
            || SHARED.iter().any(|name| {
                let own = shaders::source(name).unwrap().lines().next().unwrap();
                uses(name, alias) && whole.contains(own)
            })
    };
    let sides = |alias: &str| if asks(alias) { vec![false, true] } else { vec![false] };
    let visibilities =
        if asks("VISIBILITY") { Visibility::ALL.to_vec() } else { vec![Visibility::Depth] };
    let mut all = vec![Choices::default()];
    let widen = |all: Vec<Choices>, alias: &str, set: fn(&mut Choices, bool)| -> Vec<Choices> {
        let sides = sides(alias);
        let with = |choices: Choices, side: bool| {
            let mut choices = choices;
            set(&mut choices, side);
            choices
        };
        all.into_iter().flat_map(|c| sides.iter().map(move |&s| with(c, s))).collect()
    };
    all = all
        .into_iter()
        .flat_map(|c| visibilities.iter().map(move |&visibility| Choices { visibility, ..c }))
        .collect();
    let portions = if asks("PORTION") { Portion::ALL.to_vec() } else { vec![Portion::All] };
    all = all
        .into_iter()
        .flat_map(|c| portions.iter().map(move |&portion| Choices { portion, ..c }))
        .collect();
    all = widen(all, "VOTE", |choices, side| choices.subgroups = side);
    all = widen(all, "ALPHA", |choices, side| choices.alpha_cut = side);
    all = widen(all, "CLIPS", |choices, side| choices.clipped = side);
    all = widen(all, "SUMS", |choices, side| choices.wide_sums = side);
    all = widen(all, "NORMAL_SUMS", |choices, side| choices.normal_sums = side);
    all = widen(all, "LIT", |choices, side| choices.lit = side);
    // Where splats may be lit, their lights may cast shadows.
    let casts = |c: Choices| if asks("SHADOWS") || c.lit { vec![false, true] } else { vec![false] };
    all = all
        .into_iter()
        .flat_map(|c| casts(c).into_iter().map(move |shadows| Choices { shadows, ..c }))
        .collect();
    // So may surroundings.
    let surrounded =
        |c: Choices| if asks("ENVIRONMENT") || c.lit { vec![false, true] } else { vec![false] };
    all = all
        .into_iter()
        .flat_map(|c| {
            surrounded(c).into_iter().map(move |environment| Choices { environment, ..c })
        })
        .collect();
    all = widen(all, "OPENNESS", |choices, side| choices.occlusion = side);
    all = widen(all, "FINISH", |choices, side| choices.kept = side);
    // Surfaces that are kept may have maps.
    let maps = |c: Choices| {
        if asks("KEPT_MAPS") || c.kept { vec![false, true] } else { vec![false] }
    };
    all = all
        .into_iter()
        .flat_map(|c| maps(c).into_iter().map(move |maps| Choices { maps, ..c }))
        .collect();
    // Layers have triangles, samples and lines.
    let resolved = ["triangles", "samples", "lines"].map(|kind| format!("resolve/resolve_{kind}"));
    if resolved.iter().any(|layered| layered == root) {
        all = widen(all, "WORDS", |choices, side| choices.layers = side);
    }
    all = widen(all, "NODES", |choices, side| choices.nodes = side);
    all = widen(all, "FIELDS", |choices, side| choices.fields = side);
    // Each of these is used in a pass of its own.
    let lists = ["ENTRIES", "LIST", "MEMBERS"].into_iter().find(|alias| asks(alias));
    all = widen(all, lists.unwrap_or("ENTRIES"), |choices, side| choices.trees = side);
    all.into_iter()
        .map(|choices| {
            (format!("{root} {choices:?}"), choices, shaders::composed(root, &choices).unwrap())
        })
        .collect()
}

/// The capabilities beyond core WGSL that a composition may use.
fn needed(composed: &Composed, choices: &Choices) -> Capabilities {
    let mut needed = Capabilities::empty();
    if composed.source.contains("fn visibility_write") && choices.visibility == Visibility::Wide {
        needed |= WIDE;
    }
    if composed.source.contains("fn sink") && choices.visibility == Visibility::LayersWide {
        needed |= WIDE_SUMS;
    }
    if composed.source.contains("fn add_0") && choices.wide_sums {
        needed |= WIDE_SUMS;
    }
    if composed.source.contains("fn slab_tag")
        && composed.source.contains("atomicCompareExchangeWeak")
    {
        needed |= WIDE_SUMS;
    }
    if composed.source.contains("fn walk_snapped") {
        needed |= Capabilities::SHADER_INT64;
    }
    if composed.source.contains("subgroupAny") {
        needed |= Capabilities::SUBGROUP;
    }
    needed
}

fn validate(name: &str, composed: &Composed, capabilities: Capabilities) -> Result<(), String> {
    let module = shader::parse(name, composed).unwrap_or_else(|error| panic!("{error}"));
    assert!(!module.entry_points.is_empty(), "{name} has no entry point");
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .map(drop)
        .map_err(|error| error.emit_to_string(&composed.source))
}

#[test]
fn every_composition_is_valid() {
    let mut checked = 0;
    for root in roots() {
        for (name, choices, composed) in compositions(root) {
            if let Err(error) = validate(&name, &composed, needed(&composed, &choices)) {
                panic!("{name}: {error}");
            }
            checked += 1;
        }
    }
    // Numbers of compositions:
    // - Samples: three ways to write, for what is opaque and for layers; with and without point trees; all at once or in turns.
    // - Triangles: the same six ways; with and without alpha; a thread each (all at once or in turns, with and without votes),
    //   or from a list (by threads or by the rasteriser).
    // - Lines: the same six ways; a thread each as for triangles, or from a list.
    // - Splats: depths as for samples, with and without clip lines; sums by clip lines, width, normals, lights and trees; a
    //   single pass by clip lines, lights, trees and scalar fields. Each of these with a thread per splat (all at once or in turns, with and
    //   without votes), or from a list. Painted splats as a single pass, with a thread per splat, and counted with and without trees.
    // - Passes over pixels: with and without votes; samples with and without trees; samples and lines with and without scalar fields; outputs written at once or later,
    //   in the latter case with and without maps; each of them also layer by layer.
    // - Wherever light is computed, with and without shadows, and with and without surroundings. The last pass over surfaces also with and without ambient occlusion, which is a pass over pixels.
    // - Level 0 of pull-push: with and without clip lines, trees and scalar fields.
    // - Lists: of everything, or of trees. Others: no choices.
    let (depths, sums, single) = (24, 160, 40);
    let over_pixels = 2 * 2 * (12 * 2 * 3 + 3 * 2 * 3 + 2 * 2 * 3 + 2 * 2 * 2) + 2 + 2;
    let level_0 = 2 * 2 * 2;
    let lists = 3 * 2;
    let others = 24;
    assert_eq!(
        checked,
        2 * 12
            + 12 * (2 * 2 + 2)
            + 6 * (2 * 2 + 1)
            + 5 * (depths + sums + single)
            + 4 * (single + 2)
            + over_pixels
            + level_0
            + lists
            + others
    );
}

#[test]
fn nothing_else_needs_more_than_the_core() {
    for root in roots() {
        for (name, choices, composed) in compositions(root) {
            let plain = validate(&name, &composed, Capabilities::empty());
            assert_eq!(plain.is_err(), !needed(&composed, &choices).is_empty(), "{name}");
        }
    }
}

/// Entry points have the name of their file. The rasteriser has a vertex and a fragment stage.
#[test]
fn entry_points_are_named_after_their_file() {
    for root in roots() {
        for (name, _, composed) in compositions(root) {
            let module = shader::parse(&name, &composed).unwrap();
            let names: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
            let file = root.rsplit('/').next().unwrap();
            let of_root = |pass: &&Pass| pass.shader() == root;
            let pass = Pass::ALL.iter().find(of_root);
            if pass.is_some_and(|pass| pass.kind() == Kind::Raster) {
                assert_eq!(names, ["vertex", "fragment"], "{name}");
            } else {
                assert_eq!(names, [file], "{name}");
            }
        }
    }
}

fn files_below(folder: &Path, prefix: &str, found: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            files_below(&path, &format!("{prefix}{name}/"), found);
        } else {
            found.insert(format!("{prefix}{name}"));
        }
    }
}

#[test]
fn every_file_is_embedded_and_used() {
    let mut files = BTreeSet::new();
    files_below(&Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders"), "", &mut files);
    let embedded = SHARED.iter().copied().chain(roots());
    let embedded: BTreeSet<String> = embedded.map(str::to_owned).collect();
    assert_eq!(files, embedded);
    let mut used = BTreeSet::new();
    for root in roots() {
        for (_, _, composed) in compositions(root) {
            let lines = 1..=composed.source.lines().count();
            used.extend(lines.filter_map(|line| Some(composed.line(line)?.0.to_owned())));
        }
    }
    assert_eq!(used, embedded, "a fragment that no composition includes");
}

/// Whether an expression's value comes only from uniforms and constants, and from at least one uniform.
fn uniform_alone(
    module: &naga::Module,
    function: &naga::Function,
    expression: naga::Handle<naga::Expression>,
) -> Option<bool> {
    use naga::Expression as E;
    let of = |inner| uniform_alone(module, function, inner);
    let all = |parts: &[naga::Handle<E>]| {
        parts.iter().try_fold(false, |found, &part| Some(found | of(part)?))
    };
    match &function.expressions[expression] {
        E::Literal(_) | E::Constant(_) | E::Override(_) | E::ZeroValue(_) => Some(false),
        E::GlobalVariable(variable) => {
            // The private variable is the view's record, copied from uniforms.
            let space = module.global_variables[*variable].space;
            let steady = [naga::AddressSpace::Uniform, naga::AddressSpace::Private];
            steady.contains(&space).then_some(true)
        }
        E::Load { pointer: inner }
        | E::AccessIndex { base: inner, .. }
        | E::Splat { value: inner, .. }
        | E::Swizzle { vector: inner, .. }
        | E::Unary { expr: inner, .. }
        | E::As { expr: inner, .. } => of(*inner),
        E::Access { base, index } => all(&[*base, *index]),
        E::Binary { left, right, .. } => all(&[*left, *right]),
        E::Select { condition, accept, reject } => all(&[*condition, *accept, *reject]),
        E::Compose { components, .. } => all(components),
        E::Math { arg, arg1, arg2, arg3, .. } => {
            let parts: Vec<_> = [Some(*arg), *arg1, *arg2, *arg3].into_iter().flatten().collect();
            all(&parts)
        }
        _ => None,
    }
}

fn inlined_uniforms(module: &naga::Module, function: &naga::Function, block: &naga::Block) -> bool {
    use naga::Statement as S;
    let within = |block| inlined_uniforms(module, function, block);
    let alone = |part| uniform_alone(module, function, part) == Some(true);
    let breaks = |block: &naga::Block| block.iter().any(|statement| matches!(statement, S::Break));
    block.iter().any(|statement| match statement {
        S::Block(block) => within(block),
        S::Loop { body, continuing, break_if } => {
            within(body) || within(continuing) || break_if.is_some_and(alone)
        }
        S::Switch { selector, cases } => alone(*selector) || cases.iter().any(|c| within(&c.body)),
        S::If { condition, accept, reject } => {
            let compared = match function.expressions[*condition] {
                naga::Expression::Binary { left, right, .. } => alone(left) || alone(right),
                _ => false,
            };
            alone(*condition)
                || (compared && (breaks(accept) || breaks(reject)))
                || within(accept)
                || within(reject)
        }
        _ => false,
    })
}

/// Mesa's lavapipe compiles the values of uniforms that steer a branch or a loop into the shader, and compiles it again when they
/// change: fifty milliseconds per frame that no timing shows.
#[test]
fn no_branch_or_loop_hangs_on_uniforms_alone() {
    for root in roots() {
        for (name, _, composed) in compositions(root) {
            let module = shader::parse(&name, &composed).unwrap();
            let entries = module.entry_points.iter().map(|entry| &entry.function);
            for function in module.functions.iter().map(|(_, f)| f).chain(entries) {
                assert!(
                    !inlined_uniforms(&module, function, &function.body),
                    "{name}: {:?}",
                    function.name
                );
            }
        }
    }
    let bad = "struct F { n: u32 } @group(0) @binding(0) var<uniform> f: F;
        @group(0) @binding(1) var<storage, read_write> o: array<u32>;
        @compute @workgroup_size(1) fn main() { for (var i = 0u; i < f.n + 1u; i++) { o[i] = i; } }";
    let module = naga::front::wgsl::parse_str(bad).unwrap();
    let main = &module.entry_points[0].function;
    assert!(inlined_uniforms(&module, main, &main.body));
}
