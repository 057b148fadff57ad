//! The WGSL files, embedded, and the modules composed of them.

use crate::gpu::shader::{Composed, ShaderError, compose};

macro_rules! fragments {
    ($($name:literal),+ $(,)?) => {
        /// The text of a fragment of `shaders/`.
        pub fn source(name: &str) -> Option<&'static str> {
            if let Some(text) = on_disk(name) {
                return Some(text);
            }
            match name {
                $($name => Some(include_str!(concat!("../../shaders/", $name, ".wgsl"))),)+
                _ => None,
            }
        }

        /// The names of all fragments.
        pub const FRAGMENTS: &[&str] = &[$($name),+];
    };
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
    "shared/octahedral",
    "shared/colour",
    "shared/material",
    "shared/texture",
    "shared/barycentric",
    "shared/alpha_none",
    "shared/alpha_cut",
    "shared/column",
    "shared/resolve",
    "shared/vote_subgroup",
    "shared/vote_alone",
    "shared/visibility_64",
    "shared/visibility_depth",
    "shared/visibility_id",
    "select/clear",
    "select/place",
    "select/cull",
    "select/scan",
    "select/compact",
    "project/project_samples",
    "project/project_triangles",
    "project/rasterise_triangles",
    "project/walk_triangles",
    "resolve/resolve_samples",
    "resolve/resolve_triangles",
    "shade/shade",
];

/// How the visibility buffer is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Visibility {
    /// One pass, 64-bit words.
    Wide,
    /// First of two passes.
    Depth,
    /// Second of two passes.
    Id,
}

impl Visibility {
    pub const ALL: [Visibility; 3] = [Visibility::Wide, Visibility::Depth, Visibility::Id];

    fn fragment(self) -> &'static str {
        match self {
            Visibility::Wide => "shared/visibility_64",
            Visibility::Depth => "shared/visibility_depth",
            Visibility::Id => "shared/visibility_id",
        }
    }
}

/// Composes the module of a pass that leaves the visibility buffer alone; `subgroups`: its threads may vote.
pub fn plain(root: &str, subgroups: bool) -> Result<Composed, ShaderError> {
    let vote = if subgroups { "shared/vote_subgroup" } else { "shared/vote_alone" };
    compose(source, root, &[("VOTE", vote)])
}

/// Composes a module that writes the visibility buffer.
pub fn visible(
    root: &str,
    visibility: Visibility,
    alpha_cut: bool,
) -> Result<Composed, ShaderError> {
    let alpha = if alpha_cut { "shared/alpha_cut" } else { "shared/alpha_none" };
    compose(source, root, &[("VISIBILITY", visibility.fragment()), ("ALPHA", alpha)])
}
