//! The WGSL files, embedded, and the modules composed of them.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::gpu::shader::{Composed, ShaderError, compose};
use crate::plan::{Kind, Pass, pass_table};

macro_rules! fragments {
    ($($name:literal),+ $(,)?) => {
        /// The names of all fragments that passes share.
        pub const SHARED: &[&str] = &[$($name),+];

        const SHARED_SOURCES: &[&str] =
            &[$(include_str!(concat!("../../shaders/", $name, ".wgsl"))),+];
    };
}

macro_rules! roots {
    ($($pass:ident $kind:ident $folder:ident/$file:ident $half:literal
        [$($stage:ident)+] $per:ident [$($reason:ident)*];)+) => {
        /// The text of each pass's own file.
        const ROOT_SOURCES: &[Option<&str>] = &[$(root!($kind $folder $file)),+];
    };
}

macro_rules! root {
    (Fill $folder:ident $file:ident) => {
        None
    };
    ($kind:ident $folder:ident $file:ident) => {
        Some(include_str!(concat!(
            "../../shaders/",
            stringify!($folder),
            "/",
            stringify!($file),
            ".wgsl"
        )))
    };
}
pass_table!(roots);

/// Files with an entry point that no frame runs: they call the passes' functions, so that these can be judged.
const MEASURES: &[&str] = &["measure/measure_splats"];

/// The files that have entry points, by their names below `shaders/`.
pub fn roots() -> Vec<&'static str> {
    let mut roots = MEASURES.to_vec();
    for pass in Pass::ALL.iter().filter(|pass| pass.kind() != Kind::Fill) {
        if !roots.contains(&pass.shader()) {
            roots.push(pass.shader());
        }
    }
    roots
}

/// The text of a file of `shaders/`.
pub fn source(name: &str) -> Option<&'static str> {
    let shared = SHARED.iter().copied().zip(SHARED_SOURCES.iter().copied().map(Some));
    let roots = Pass::ALL.iter().map(|pass| pass.shader()).zip(ROOT_SOURCES.iter().copied());
    let embedded = || shared.chain(roots).find(|(file, _)| *file == name);
    on_disk(name).or_else(|| embedded()?.1)
}

/// In debug builds, the folder `POINTILLIST_SHADERS` stands in for what was embedded, so that shaders can be worked on
/// without building anew.
fn on_disk(name: &str) -> Option<&'static str> {
    if !cfg!(debug_assertions) {
        return None;
    }
    let folder = std::env::var_os("POINTILLIST_SHADERS")?;
    let path = std::path::Path::new(&folder).join(name).with_extension("wgsl");
    std::fs::read_to_string(path).ok().map(|text| &*text.leak())
}

fragments![
    "shared/frame",
    "shared/scene",
    "shared/mesh",
    "shared/triangle",
    "shared/plane",
    "shared/edges",
    "shared/line",
    "shared/line_walk",
    "shared/octahedral",
    "shared/colour",
    "shared/mean",
    "shared/material",
    "shared/transmits",
    "shared/texture",
    "shared/barycentric",
    "shared/alpha_none",
    "shared/albedo",
    "shared/alpha_cut",
    "shared/column",
    "shared/resolve",
    "shared/resolve_each",
    "shared/vote_subgroup",
    "shared/vote_alone",
    "shared/normals",
    "shared/phong",
    "shared/environment_none",
    "shared/environment_map",
    "shared/physical",
    "shared/tone",
    "shared/maps_none",
    "shared/maps_kept",
    "shared/shadow_none",
    "shared/shadow_maps",
    "shared/kept",
    "shared/kept_color",
    "shared/output",
    "shared/surface",
    "shared/light",
    "shared/edl",
    "shared/kept_places",
    "shared/openness_all",
    "shared/openness_near",
    "shared/fog",
    "shared/finish_written",
    "shared/finish_kept",
    "shared/large",
    "shared/list",
    "shared/walk",
    "shared/splat",
    "shared/kernel",
    "shared/landing",
    "shared/halves",
    "shared/patches",
    "shared/corner",
    "shared/level_bounds",
    "shared/sample_splats",
    "shared/splat_depth",
    "shared/splat_paint",
    "shared/splat_sums",
    "shared/splat_fuzzy",
    "shared/painted",
    "shared/canvas",
    "shared/linear",
    "shared/digits",
    "shared/keys",
    "shared/tiles",
    "shared/over",
    "shared/gather",
    "shared/slabs",
    "shared/scatter",
    "shared/walk_splat",
    "shared/portions",
    "shared/pyramid",
    "shared/recolor",
    "shared/ramp",
    "shared/fields_none",
    "shared/fields_shown",
    "shared/clipping",
    "shared/turns",
    "shared/parts",
    "shared/tested",
    "shared/portion_all",
    "shared/portion_turn",
    "shared/clip_none",
    "shared/clip_lines",
    "shared/sums_64",
    "shared/sums_32",
    "shared/normal_sums_none",
    "shared/normal_sums_64",
    "shared/normal_sums_32",
    "shared/lit_none",
    "shared/lit_splat",
    "shared/rows_all",
    "shared/sorts",
    "shared/visibility_64",
    "shared/visibility_depth",
    "shared/visibility_id",
    "shared/window",
    "shared/sinks",
    "shared/visibility_layers_64",
    "shared/visibility_layers_depth",
    "shared/visibility_layers_id",
    "shared/words_shown",
    "shared/words_layer",
    "shared/finish_layer",
    "shared/accepted",
    "shared/codes",
    "shared/chosen",
    "shared/launch",
    "shared/lanes",
    "shared/frustum",
    "shared/stretch",
    "shared/entries_full",
    "shared/entries_tree",
    "shared/list_full",
    "shared/list_tree",
    "shared/members_all",
    "shared/members_listed",
    "shared/nodes_none",
    "shared/nodes_tree",
    "measure/measure_splats",
];

/// How the visibility buffer is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Visibility {
    /// One pass, 64-bit words.
    Wide,
    /// First of two passes.
    Depth,
    /// Second of two passes.
    Id,
    /// The nearest translucent fragments, in as many passes as for [`Visibility::Wide`] or the two others.
    LayersWide,
    LayersDepth,
    LayersId,
}

impl Visibility {
    pub const ALL: [Visibility; 6] = [
        Visibility::Wide,
        Visibility::Depth,
        Visibility::Id,
        Visibility::LayersWide,
        Visibility::LayersDepth,
        Visibility::LayersId,
    ];

    /// Whether translucent fragments are kept.
    pub fn is_of_layers(self) -> bool {
        use Visibility::{LayersDepth, LayersId, LayersWide};
        matches!(self, LayersWide | LayersDepth | LayersId)
    }

    fn fragment(self) -> &'static str {
        match self {
            Visibility::Wide => "shared/visibility_64",
            Visibility::Depth => "shared/visibility_depth",
            Visibility::Id => "shared/visibility_id",
            Visibility::LayersWide => "shared/visibility_layers_64",
            Visibility::LayersDepth => "shared/visibility_layers_depth",
            Visibility::LayersId => "shared/visibility_layers_id",
        }
    }
}

/// Which of a segment's visible slots a pass draws.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Portion {
    #[default]
    All,
    /// Those whose turn it is: what is near first, then what turns out not to be hidden.
    Turn,
}

impl Portion {
    pub const ALL: [Portion; 2] = [Portion::All, Portion::Turn];

    fn fragment(self) -> &'static str {
        match self {
            Portion::All => "shared/portion_all",
            Portion::Turn => "shared/portion_turn",
        }
    }
}

/// Which fragments stand for the names in capitals that a module includes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choices {
    /// `VOTE`: threads may vote.
    pub subgroups: bool,
    /// `VISIBILITY`: how the visibility buffer is written.
    pub visibility: Visibility,
    /// `ALPHA`: some material cuts holes.
    pub alpha_cut: bool,
    /// `CLIPS`: samples carry clip lines.
    pub clipped: bool,
    /// `SUMS`, `NORMAL_SUMS`: 64-bit atomics add.
    pub wide_sums: bool,
    /// `NORMAL_SUMS`: normals and depths are blended beside colours.
    pub normal_sums: bool,
    /// `LIT`: splats are lit one by one.
    pub lit: bool,
    /// `SHADOWS`: lights cast shadows.
    pub shadows: bool,
    /// `ENVIRONMENT`: the scene's surroundings light it.
    pub environment: bool,
    /// `OPENNESS`: surfaces hide ambient light from each other.
    pub occlusion: bool,
    /// `KEPT_MAPS`: kept surfaces have what maps say of them.
    pub maps: bool,
    /// `ENTRIES`, `LIST`, `MEMBERS`: the frame lists its own entries, from point trees.
    pub trees: bool,
    /// `NODES`: samples are nodes of point trees.
    pub nodes: bool,
    /// `FIELDS`: samples and lines have the colours of a scalar field.
    pub fields: bool,
    /// `PORTION`: which slots are drawn.
    pub portion: Portion,
    /// `FINISH`: a later pass writes the output.
    pub kept: bool,
    /// `FINISH`, `WORDS`: translucent surfaces are drawn, layer by layer.
    pub layers: bool,
}

impl Default for Choices {
    fn default() -> Self {
        Choices {
            subgroups: false,
            visibility: Visibility::Depth,
            alpha_cut: false,
            clipped: false,
            wide_sums: false,
            normal_sums: false,
            lit: false,
            shadows: false,
            environment: false,
            occlusion: false,
            maps: false,
            trees: false,
            nodes: false,
            fields: false,
            portion: Portion::All,
            kept: false,
            layers: false,
        }
    }
}

impl Choices {
    fn aliases(&self) -> [(&'static str, &'static str); 19] {
        let either = |choice, yes, no| if choice { yes } else { no };
        [
            ("VOTE", either(self.subgroups, "shared/vote_subgroup", "shared/vote_alone")),
            ("VISIBILITY", self.visibility.fragment()),
            ("ALPHA", either(self.alpha_cut, "shared/alpha_cut", "shared/alpha_none")),
            ("CLIPS", either(self.clipped, "shared/clip_lines", "shared/clip_none")),
            ("SUMS", either(self.wide_sums, "shared/sums_64", "shared/sums_32")),
            (
                "NORMAL_SUMS",
                match (self.normal_sums, self.wide_sums) {
                    (false, _) => "shared/normal_sums_none",
                    (true, true) => "shared/normal_sums_64",
                    (true, false) => "shared/normal_sums_32",
                },
            ),
            ("LIT", either(self.lit, "shared/lit_splat", "shared/lit_none")),
            ("SHADOWS", either(self.shadows, "shared/shadow_maps", "shared/shadow_none")),
            (
                "ENVIRONMENT",
                either(self.environment, "shared/environment_map", "shared/environment_none"),
            ),
            ("OPENNESS", either(self.occlusion, "shared/openness_near", "shared/openness_all")),
            ("KEPT_MAPS", either(self.maps, "shared/maps_kept", "shared/maps_none")),
            ("ENTRIES", either(self.trees, "shared/entries_tree", "shared/entries_full")),
            ("LIST", either(self.trees, "shared/list_tree", "shared/list_full")),
            ("MEMBERS", either(self.trees, "shared/members_listed", "shared/members_all")),
            ("NODES", either(self.nodes, "shared/nodes_tree", "shared/nodes_none")),
            ("FIELDS", either(self.fields, "shared/fields_shown", "shared/fields_none")),
            ("PORTION", self.portion.fragment()),
            (
                "FINISH",
                match (self.layers, self.kept) {
                    (true, _) => "shared/finish_layer",
                    (false, true) => "shared/finish_kept",
                    (false, false) => "shared/finish_written",
                },
            ),
            ("WORDS", either(self.layers, "shared/words_layer", "shared/words_shown")),
        ]
    }
}

/// Hash of the program's build and of all shaders that it composes, including those on disk. Renderers with different fingerprints may
/// draw different pixels and share no pipelines.
pub fn fingerprint() -> String {
    fingerprint_of(crate::BUILD)
}

fn fingerprint_of(build: &str) -> String {
    let mut hasher = Sha256::new_with_prefix(build);
    for name in SHARED.iter().copied().chain(roots()) {
        hasher.update(name);
        hasher.update(source(name).unwrap_or_default());
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Composes the module of a pass; `root` is its file below `shaders/`.
///
/// # Errors
/// A fragment that is not there, which is a defect of this program.
pub fn composed(root: &str, choices: &Choices) -> Result<Composed, ShaderError> {
    compose(source, root, &choices.aliases())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Specialisation;

    /// Each is an override of some shader, or stands for fragments.
    #[test]
    fn specialisations_are_those_of_shaders() {
        let texts: Vec<&str> = SHARED.iter().copied().chain(roots()).filter_map(source).collect();
        let aliases = Choices::default().aliases();
        for effect in Specialisation::ALL {
            let name = effect.constant();
            let declared = format!("override {name}: ");
            let is_override = texts.iter().any(|text| text.contains(&declared));
            assert!(is_override || aliases.iter().any(|(alias, _)| *alias == name), "{name}");
        }
    }

    #[test]
    fn another_build_is_another_renderer() {
        assert_eq!(fingerprint(), fingerprint_of(crate::BUILD));
        assert_ne!(fingerprint(), fingerprint_of(crate::VERSION));
    }
}
