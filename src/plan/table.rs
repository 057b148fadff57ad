//! The table of passes: every pass of this program, one line each, in the order in which they run.
//!
//! [`super::Pass`], its names, the plan, the embedded shaders, the pipelines, the recording and the receipts follow from these lines.
//! A line names, from left to right:
//!
//! 1. the variant of [`super::Pass`];
//! 2. the kind of the pass: `Compute` has one entry point, named after its file; `Raster` has `vertex` and `fragment`; `Fill` has no
//!    shader;
//! 3. the WGSL file below `shaders/`; the recording function has the same path below `passes/`;
//! 4. the suffix that the name of the pass adds to the name of the file;
//! 5. the stages in which it is recorded; the first is the one that it belongs to;
//! 6. whether it is recorded once a frame, once for each segment of a kind of geometry, once for each level of a pyramid, once for
//!    each digit of a sort, or once for each layer of translucent surfaces ([`Per`]);
//! 7. the reasons to skip it. The pass runs if none of them holds.
//!
//! A second table lists the effects that have no pass of their own: passes have their code where a frame calls for it.
//!
//! Buffers are not listed here: a shader declares what it binds, and `passes/bindings.rs` finds the buffer by its name.

use super::Facts;
use crate::bake::pack::GeometryKind;

/// Hands the lines of the table to the macro `$reader`.
macro_rules! pass_table {
    ($reader:ident) => {
        $reader! {
            ShadowMap            Fill    shadow/shadow_map             ""    [Shadows]           Frame     [NOT_COLOR NO_CASTER WITHOUT_SHADOWS];
            Clear                Fill    select/clear                  ""    [Select]            Frame     [];
            EnvironmentBackground Compute select/environment_background "" [Select]          Frame     [NOT_COLOR NO_ENVIRONMENT WITHOUT_ENVIRONMENT UNSEEN_ENVIRONMENT OTHER_BACKGROUND BEHIND_FOG];
            FogBackground        Compute select/fog_background         ""    [Select]            Frame     [NOT_COLOR NO_FOG WITHOUT_FOG EVEN_FOG];
            CullGroups           Compute select/cull_groups            ""    [Select]            Frame     [FULL_DETAIL];
            ListGroups           Compute select/list_groups            ""    [Select]            Frame     [FULL_DETAIL];
            Place                Compute select/place                  ""    [Select]            Frame     [];
            SelectChunks         Compute select/select_chunks          ""    [Select]            Frame     [FULL_DETAIL];
            ListEntries          Compute select/list_entries           ""    [Select]            Frame     [FULL_DETAIL];
            Cull                 Compute select/cull                   ""    [Select]            Frame     [];
            Scan                 Compute select/scan                   ""    [Select]            Frame     [];
            Compact              Compute select/compact                ""    [Select]            Frame     [];
            LaunchPortions       Compute select/launch_portions        ""    [Project Ids Blend] Frame     [NOTHING_TO_HIDE FEW_CHUNKS DRAWS_HIDDEN];
            ProjectSamples       Compute project/project_samples       ""    [Project]           Frame     [NO_SAMPLES AS_SPLATS AS_DISCS];
            ProjectSplats        Compute project/project_splats        ""    [Project]           Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS];
            WalkSplats           Compute project/walk_splats           ""    [Project]           Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS];
            ProjectTriangles     Compute project/project_triangles     ""    [Project]           Triangles [NO_TRIANGLES];
            RasteriseTriangles   Raster  project/rasterise_triangles   ""    [Project]           Triangles [NO_TRIANGLES WALKS];
            WalkTriangles        Compute project/walk_triangles        ""    [Project]           Triangles [NO_TRIANGLES RASTERISES];
            ProjectLines         Compute project/project_lines         ""    [Project]           Lines     [NO_LINES];
            WalkLines            Compute project/walk_lines            ""    [Project]           Lines     [NO_LINES];
            DepthPyramid         Compute select/depth_pyramid          ""    [Project Blend]     Frame     [NOTHING_TO_HIDE FEW_CHUNKS DRAWS_HIDDEN];
            CullHidden           Compute select/cull_hidden            ""    [Project Blend]     Frame     [NOTHING_TO_HIDE FEW_CHUNKS DRAWS_HIDDEN];
            ProjectSamplesId     Compute project/project_samples       "_id" [Ids]               Frame     [NO_SAMPLES AS_SPLATS AS_DISCS WIDE];
            ProjectSplatsId      Compute project/project_splats        "_id" [Ids]               Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS WIDE];
            WalkSplatsId         Compute project/walk_splats           "_id" [Ids]               Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS WIDE];
            ProjectTrianglesId   Compute project/project_triangles     "_id" [Ids]               Triangles [NO_TRIANGLES WIDE];
            RasteriseTrianglesId Raster  project/rasterise_triangles   "_id" [Ids]               Triangles [NO_TRIANGLES WIDE WALKS];
            WalkTrianglesId      Compute project/walk_triangles        "_id" [Ids]               Triangles [NO_TRIANGLES WIDE RASTERISES];
            ProjectLinesId       Compute project/project_lines         "_id" [Ids]               Lines     [NO_LINES WIDE];
            WalkLinesId          Compute project/walk_lines            "_id" [Ids]               Lines     [NO_LINES WIDE];
            BlendSplats          Compute reconstruct/blend_splats      ""    [Blend]             Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS OPAQUE IDS];
            BlendWalked          Compute reconstruct/blend_walked      ""    [Blend]             Samples   [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS OPAQUE IDS];
            FuzzySplats          Compute reconstruct/fuzzy_splats      ""    [Fuzzy]             Samples   [NO_SAMPLES AS_POINTS NOT_FUZZY];
            FuzzyWalked          Compute reconstruct/fuzzy_walked      ""    [Fuzzy]             Samples   [NO_SAMPLES AS_POINTS NOT_FUZZY];
            CountSplats          Compute reconstruct/count_splats      ""    [Paint]             Samples   [NO_SAMPLES NOT_PAINTED];
            NumberSplats         Compute reconstruct/number_splats     ""    [Paint]             Frame     [NO_SAMPLES NOT_PAINTED];
            ListSplats           Compute reconstruct/list_splats       ""    [Paint]             Samples   [NO_SAMPLES NOT_PAINTED];
            CountKeys            Compute reconstruct/count_keys        ""    [Paint]             Digit     [NO_SAMPLES NOT_PAINTED];
            SumCounts            Compute reconstruct/sum_counts        ""    [Paint]             Digit     [NO_SAMPLES NOT_PAINTED];
            MoveKeys             Compute reconstruct/move_keys         ""    [Paint]             Digit     [NO_SAMPLES NOT_PAINTED];
            CountTiles           Compute reconstruct/count_tiles       ""    [Paint]             Frame     [NO_SAMPLES NOT_PAINTED];
            SumCountsTiles       Compute reconstruct/sum_counts        "_tiles" [Paint]          Frame     [NO_SAMPLES NOT_PAINTED];
            MoveTiles            Compute reconstruct/move_tiles        ""    [Paint]             Frame     [NO_SAMPLES NOT_PAINTED];
            PaintSplats          Compute reconstruct/paint_splats      ""    [Paint]             Frame     [NO_SAMPLES NOT_PAINTED];
            RecordSamples        Compute reconstruct/record_samples    ""    [PullPush]          Samples   [NO_SAMPLES NOT_PULLED];
            Pull                 Compute reconstruct/pull              ""    [PullPush]          Coarser   [NO_SAMPLES NOT_PULLED];
            Push                 Compute reconstruct/push              ""    [PullPush]          Finer     [NO_SAMPLES NOT_PULLED];
            ResolveFuzzy         Compute resolve/resolve_fuzzy         ""    [Resolve]           Frame     [NO_SAMPLES AS_POINTS NOT_FUZZY];
            ResolvePulled        Compute resolve/resolve_pulled        ""    [Resolve]           Frame     [NO_SAMPLES NOT_PULLED];
            ResolveSplats        Compute resolve/resolve_splats        ""    [Resolve]           Frame     [NO_SAMPLES AS_POINTS PULLED NO_DEPTHS OPAQUE];
            ResolveSamples       Compute resolve/resolve_samples       ""    [Resolve]           Frame     [NO_SAMPLES PULLED BLENDED];
            ResolveTriangles     Compute resolve/resolve_triangles     ""    [Resolve]           Frame     [NO_TRIANGLES];
            ResolveLines         Compute resolve/resolve_lines         ""    [Resolve]           Frame     [NO_LINES];
            AmbientOcclusion     Compute resolve/ambient_occlusion     ""    [Resolve]           Frame     [NOT_COLOR NO_OCCLUSION WITHOUT_OCCLUSION DEPTHLESS LIT_SINGLY];
            WriteOutput          Compute resolve/write_output          ""    [Resolve]           Frame     [NOT_COLOR NO_EFFECT];
            CompositeSplats      Compute resolve/composite_splats      ""    [Resolve]           Frame     [NO_SAMPLES NOT_PAINTED];
            ProjectSamplesLayers        Compute project/project_samples     "_layers"    [Layers]   Frame     [OPAQUE_SAMPLES NOT_COLOR AS_SPLATS AS_DISCS];
            ProjectSplatsLayers         Compute project/project_splats      "_layers"    [Layers]   Samples   [OPAQUE_SAMPLES NOT_COLOR AS_POINTS PULLED NO_DEPTHS];
            WalkSplatsLayers            Compute project/walk_splats         "_layers"    [Layers]   Samples   [OPAQUE_SAMPLES NOT_COLOR AS_POINTS PULLED NO_DEPTHS];
            ProjectTrianglesLayers      Compute project/project_triangles   "_layers"    [Layers]   Triangles [OPAQUE_TRIANGLES NOT_COLOR];
            RasteriseTrianglesLayers    Raster  project/rasterise_triangles "_layers"    [Layers]   Triangles [OPAQUE_TRIANGLES NOT_COLOR WALKS];
            WalkTrianglesLayers         Compute project/walk_triangles      "_layers"    [Layers]   Triangles [OPAQUE_TRIANGLES NOT_COLOR RASTERISES];
            ProjectLinesLayers          Compute project/project_lines       "_layers"    [Layers]   Lines     [OPAQUE_LINES NOT_COLOR];
            WalkLinesLayers             Compute project/walk_lines          "_layers"    [Layers]   Lines     [OPAQUE_LINES NOT_COLOR];
            ProjectSamplesLayersId      Compute project/project_samples     "_layers_id" [LayerIds] Frame     [OPAQUE_SAMPLES NOT_COLOR AS_SPLATS AS_DISCS WIDE_SUMS];
            ProjectSplatsLayersId       Compute project/project_splats      "_layers_id" [LayerIds] Samples   [OPAQUE_SAMPLES NOT_COLOR AS_POINTS PULLED NO_DEPTHS WIDE_SUMS];
            WalkSplatsLayersId          Compute project/walk_splats         "_layers_id" [LayerIds] Samples   [OPAQUE_SAMPLES NOT_COLOR AS_POINTS PULLED NO_DEPTHS WIDE_SUMS];
            ProjectTrianglesLayersId    Compute project/project_triangles   "_layers_id" [LayerIds] Triangles [OPAQUE_TRIANGLES NOT_COLOR WIDE_SUMS];
            RasteriseTrianglesLayersId  Raster  project/rasterise_triangles "_layers_id" [LayerIds] Triangles [OPAQUE_TRIANGLES NOT_COLOR WIDE_SUMS WALKS];
            WalkTrianglesLayersId       Compute project/walk_triangles      "_layers_id" [LayerIds] Triangles [OPAQUE_TRIANGLES NOT_COLOR WIDE_SUMS RASTERISES];
            ProjectLinesLayersId        Compute project/project_lines       "_layers_id" [LayerIds] Lines     [OPAQUE_LINES NOT_COLOR WIDE_SUMS];
            WalkLinesLayersId           Compute project/walk_lines          "_layers_id" [LayerIds] Lines     [OPAQUE_LINES NOT_COLOR WIDE_SUMS];
            ResolveSamplesLayers        Compute resolve/resolve_samples     "_layers"    [Composite] Layer    [OPAQUE_SAMPLES NOT_COLOR];
            ResolveTrianglesLayers      Compute resolve/resolve_triangles   "_layers"    [Composite] Layer    [OPAQUE_TRIANGLES NOT_COLOR];
            ResolveLinesLayers          Compute resolve/resolve_lines       "_layers"    [Composite] Layer    [OPAQUE_LINES NOT_COLOR];
            CompositeLayers             Compute resolve/composite_layers    ""           [Composite] Frame    [OPAQUE_SCENE NOT_COLOR];
            Average              Compute resolve/average               ""    [Finish]            Frame     [NOT_AVERAGED EXPOSED];
            Accumulate           Compute resolve/accumulate            ""    [Finish]            Frame     [NOT_COLOR NOT_EXPOSED];
            Identify             Compute resolve/identify              ""    [Finish]            Frame     [NOT_PICKED];
        }
    };
}
pub(crate) use pass_table;

/// Hands the lines of the table of specialisations to the macro `$reader`. A line names the variant of [`super::Specialisation`], the override
/// or the fragment of shaders that has the effect, and the reasons to leave the effect out, as in the table of passes.
macro_rules! specialisation_table {
    ($reader:ident) => {
        $reader! {
            Textures    "TEXTURES"     [SHAPES NO_TEXTURES];
            Maps        "MAPS"         [SHAPES NO_MAPS];
            Materials   "MATERIALS"    [NOT_COLOR NO_LIGHTS PLAIN_MATERIALS];
            Specular    "SPECULAR"     [NOT_COLOR NO_LIGHTS NO_SPECULAR];
            Physical    "PHYSICAL"     [NOT_COLOR NO_LIGHTS NO_PHYSICAL];
            Emissive    "EMISSIVE"     [NOT_COLOR NO_LIGHTS NO_EMISSIVE];
            Transmits   "TRANSMITS"    [NOT_COLOR OPAQUE_SCENE NO_TRANSMISSION];
            PointLights "POINT_LIGHTS" [NOT_COLOR NO_LIGHTS NO_POINT_LIGHTS];
            Environment "ENVIRONMENT"  [NOT_COLOR NO_ENVIRONMENT WITHOUT_ENVIRONMENT];
            Fog         "FOG"          [NOT_COLOR NO_FOG WITHOUT_FOG];
            Tone        "TONE"         [NOT_COLOR NO_LIGHTS PLAIN_TONE];
            Edl         "EDL"          [NOT_COLOR WITHOUT_EDL];
        }
    };
}
pub(super) use specialisation_table;

/// Part of a frame. Stages follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Draws the scene as the lights see it. The other stages are those of such a frame as well.
    Shadows,
    /// Selects the visible chunks, and computes the map from each chunk to the image.
    Select,
    /// Draws everything into the visibility buffer. With occlusion culling, the stage repeats in turns.
    Project,
    /// Writes the ids of the nearest elements, where 64-bit atomics are missing.
    Ids,
    /// Adds up the weighted splats at the visible surface.
    Blend,
    /// Blends and depth-tests splats in a single pass.
    Fuzzy,
    /// Sorts splats by their distance and paints them over each other.
    Paint,
    /// Fills the gaps between samples from coarser levels of the image.
    PullPush,
    /// Computes the pixels.
    Resolve,
    /// This stage and the next two repeat for each window of the image. Keeps the nearest translucent fragments of each pixel.
    Layers,
    /// Writes the ids of those fragments, where 64-bit atomics are missing.
    LayerIds,
    /// Lays translucent surfaces over the image.
    Composite,
    /// Makes the result of the pixels.
    Finish,
}

impl Stage {
    pub const ALL: [Stage; 13] = [
        Stage::Shadows,
        Stage::Select,
        Stage::Project,
        Stage::Ids,
        Stage::Blend,
        Stage::Fuzzy,
        Stage::Paint,
        Stage::PullPush,
        Stage::Resolve,
        Stage::Layers,
        Stage::LayerIds,
        Stage::Composite,
        Stage::Finish,
    ];

    /// Whether it draws translucent surfaces, window by window.
    pub fn is_windowed(self) -> bool {
        matches!(self, Stage::Layers | Stage::LayerIds | Stage::Composite)
    }
}

/// How often a pass is recorded. Consecutive passes over segments of one kind take turns segment by segment, and share the list of
/// elements that are too large for one thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Per {
    Frame,
    /// Each segment of one kind of geometry.
    Segment(GeometryKind),
    /// Each level of the pyramid of an image, from the finest to the coarsest.
    Coarser,
    /// Each level but the image itself, from the coarsest to the finest.
    Finer,
    /// Each digit of the keys that splats are sorted by. Consecutive passes take turns digit by digit.
    Digit,
    /// Each layer of translucent surfaces, the nearest first. Consecutive passes take turns layer by layer, and lines do in any case; another
    /// pass that is alone goes through all layers at once.
    Layer,
}

/// Makes a [`Per`] of the word in the table: `Frame`, `Coarser`, `Finer`, `Digit`, `Layer`, or a kind of geometry.
macro_rules! per {
    (Frame) => {
        Per::Frame
    };
    (Coarser) => {
        Per::Coarser
    };
    (Finer) => {
        Per::Finer
    };
    (Digit) => {
        Per::Digit
    };
    (Layer) => {
        Per::Layer
    };
    ($kind:ident) => {
        Per::Segment(GeometryKind::$kind)
    };
}
pub(super) use per;

/// Type of GPU commands that make up a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Compute,
    Raster,
    /// Commands that fill buffers.
    Fill,
}

/// A reason to skip a pass, or to leave an effect out of the passes.
pub(super) struct Reason {
    pub text: &'static str,
    pub holds: fn(&Facts) -> bool,
}

/// The first of some reasons that holds.
pub(super) fn first(reasons: &[Reason], facts: &Facts) -> Option<&'static str> {
    reasons.iter().find(|reason| (reason.holds)(facts)).map(|reason| reason.text)
}

/// Smallest number of chunks for which occlusion culling pays.
pub const MANY_CHUNKS: u64 = 128;

macro_rules! reasons {
    ($($name:ident: $text:literal, $holds:expr;)+) => {
        $(pub(super) const $name: Reason = Reason { text: $text, holds: $holds };)+
    };
}

reasons! {
    NO_SAMPLES: "the scene has no samples", |f| !f.scene.has(GeometryKind::Samples);
    NO_TRIANGLES: "the scene has no triangles", |f| !f.scene.has(GeometryKind::Triangles);
    NO_LINES: "the scene has no lines", |f| !f.scene.has(GeometryKind::Lines);
    FULL_DETAIL: "the level of detail is full", |f| !f.scene.trees;
    NOTHING_TO_HIDE: "nothing in the frame can be occluded",
        |f| GeometryKind::ALL.iter().all(|&kind| !f.scene.has(kind) || f.is_drawn_wherever(kind));
    FEW_CHUNKS: "the scene has fewer than 128 chunks", |f| f.scene.counts.chunks < MANY_CHUNKS;
    DRAWS_HIDDEN: "occlusion culling is off", |f| f.adapter.draws_hidden;
    WIDE: "the adapter has 64-bit atomics", |f| f.adapter.atomics_64;
    WIDE_SUMS: "the adapter has 64-bit atomics that return values", |f| f.adapter.atomic_sums_64;
    RASTERISES: "the adapter's rasteriser draws large triangles", |f| f.adapter.rasterises;
    WALKS: "the adapter's rasteriser is slower than walk_triangles", |f| !f.adapter.rasterises;
    AS_POINTS: "samples are drawn as points", |f| f.frame.reconstruction.is_points();
    AS_DISCS: "samples are drawn as discs", |f| f.frame.reconstruction.discs().is_some();
    AS_SPLATS: "samples are drawn as splats",
        |f| f.frame.reconstruction.is_splats() && f.frame.reconstruction.pull_push().is_none();
    OPAQUE: "splats are not blended", |f| f.frame.reconstruction.weighted().is_none();
    NO_DEPTHS: "splats are drawn after all else, and leave no depths", |f| f.frame.reconstruction.without_depths().is_some();
    NOT_FUZZY: "splats are not blended in a single pass", |f| f.frame.reconstruction.fuzzy().is_none();
    NOT_PAINTED: "splats are not painted over each other", |f| f.frame.reconstruction.painted().is_none();
    PULLED: "pull-push fills the gaps between samples", |f| f.frame.reconstruction.pull_push().is_some();
    NOT_PULLED: "gaps between samples are not filled by pull-push",
        |f| f.frame.reconstruction.pull_push().is_none();
    BLENDED: "splats are blended", |f| f.scene.has(GeometryKind::Samples) && f.frame.reconstruction.blends();
    NO_EFFECT: "no effect reads neighbouring pixels, and no translucent surface the depths of blended splats",
        |f| f.frame.edl.is_none() && !f.composites_over_splats() && super::Pass::AmbientOcclusion.skipped(f).is_some();
    NOT_COLOR: "the output is not color", |f| f.frame.output != super::Output::Color;
    NO_CASTER: "no light casts shadows", |f| f.scene.casting_lights == 0;
    WITHOUT_SHADOWS: "shadows are off", |f| f.frame.shadows == super::Shadows::Off;
    NO_OCCLUSION: "the scene has no ambient occlusion", |f| !f.scene.occlusion;
    WITHOUT_OCCLUSION: "ambient occlusion is off", |f| f.frame.occlusion == super::Effect::Off;
    DEPTHLESS: "fuzzy and painted splats leave no depths for ambient occlusion", |f| f.leaves_no_depths();
    LIT_SINGLY: "splats are lit one by one, so that their ambient light is mixed with the rest", |f| f.lights_splats();
    NO_ENVIRONMENT: "the scene has no environment", |f| !f.scene.environment;
    WITHOUT_ENVIRONMENT: "the environment is off", |f| f.frame.environment == super::Effect::Off;
    UNSEEN_ENVIRONMENT: "the environment is not the scene's background", |f| !f.scene.shows_environment;
    OTHER_BACKGROUND: "the request has a background of its own", |f| f.frame.has_background;
    BEHIND_FOG: "fog that is as dense everywhere hides the background",
        |f| super::Specialisation::Fog.skipped(f).is_none() && !f.scene.layered_fog;
    NO_FOG: "the scene has no fog", |f| !f.scene.fog;
    WITHOUT_FOG: "fog is off", |f| f.frame.fog == super::Effect::Off;
    EVEN_FOG: "the fog is as dense at every height", |f| !f.scene.layered_fog;
    SHAPES: "the output is depth or id",
        |f| matches!(f.frame.output, super::Output::Depth | super::Output::Id);
    NO_TEXTURES: "no material has a texture", |f| !f.scene.looks.textures;
    NO_MAPS: "no material has a map of normals, occlusion, reflection, emitted light or transmission",
        |f| !f.scene.looks.maps;
    NO_LIGHTS: "the scene has no lights", |f| f.scene.lights == 0;
    PLAIN_MATERIALS: "no material shines, is metallic or rough, gives off light or is unlit, and no node has a material of its own",
        |f| !f.scene.looks.has_looked_up();
    NO_SPECULAR: "no material has a highlight of Phong's model", |f| !f.scene.looks.specular;
    NO_PHYSICAL: "no material has a metallic value or a roughness", |f| !f.scene.looks.physical;
    NO_EMISSIVE: "no material gives off light", |f| !f.scene.looks.emissive;
    NO_TRANSMISSION: "no material transmits light", |f| !f.scene.looks.transmits;
    NO_POINT_LIGHTS: "no light stands at a point", |f| !f.scene.looks.point_lights;
    PLAIN_TONE: "exposure is 0, and there is no tone map", |f| !f.frame.is_toned;
    WITHOUT_EDL: "eye-dome lighting is off", |f| f.frame.edl.is_none();
    NOT_AVERAGED: "pixels have one part", |f| !f.frame.is_averaged;
    EXPOSED: "the parts of pixels are averaged with the exposures", |f| f.frame.is_exposed;
    NOT_EXPOSED: "the frame is a single exposure: it has no aperture, and no path moves its camera while a shutter is open",
        |f| !f.frame.is_exposed;
    OPAQUE_SCENE: "nothing in the scene is translucent", |f| !f.scene.has_translucent();
    OPAQUE_SAMPLES: "the scene has no translucent samples", |f| !f.scene.is_translucent(GeometryKind::Samples);
    OPAQUE_TRIANGLES: "the scene has no translucent triangles", |f| !f.scene.is_translucent(GeometryKind::Triangles);
    OPAQUE_LINES: "the scene has no translucent lines", |f| !f.scene.is_translucent(GeometryKind::Lines);
    IDS: "the output is id", |f| f.frame.output == super::Output::Id;
    // `FramePlan::with_identities` makes it run.
    NOT_PICKED: "no pixel is picked", |_| true;
}
