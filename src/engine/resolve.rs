//! Resolves requests in a scene as it is now. Everything that can be wrong with a request is found here, before any work on the GPU.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use super::bake_service::{BakeTicket, Goal};
use super::choices::{choose_for, grounds, magnification, with_detail};
use super::entity_tag::{Tagged, entity_tag};
use super::exposures::{Exposed, exposed, from_eye};
use super::loaded::Loaded;
use super::planner::{self, MovingFrame, PlannedFrame};
use super::queue::cost::CostKey;
use super::receipt::CameraReceipt;
use super::resolved::{Drawing, ResolvedFrame};
use super::sizes::{check_size, drawn_size, frame_limits};
use super::state::{Adapter, EngineState};
use super::viewpoint::{clip_region, pose, shown_part};
use super::{EngineError, FrameRequest};
use crate::bake::pack::GeometryKind;
use crate::encode::{self, EncodeError};
use crate::math::View;
use crate::passes::{Levels, PAINTED_BYTES, SLABS_BYTES, Slabs};
use crate::plan::auto::{self, Choice};
use crate::plan::planner::{Moving, PlanReceipt};
use crate::plan::{
    AdapterFacts, Antialias, ColorBy, Edl, ImagePart, Output, Reconstruct, Reconstruction,
    SceneFacts, Settings, Wait,
};
use crate::residency::model::SceneModel;
use crate::scene::clipping::ClipRegion;

/// Result of [`super::Engine::resolve`].
pub enum Resolution {
    Ready(Arc<ResolvedFrame>),
    NeedsBake(Box<UnbakedFrame>),
}

/// Results of the checks of a request.
struct Checked {
    view: View,
    /// The view of the image that the frame is a part of, or the frame's own.
    whole: View,
    /// The view of the whole image from an unshifted eye. What is chosen for this view is chosen for all parts of an image, and for both images
    /// of a stereo pair.
    middle: View,
    /// Distance of what both images of a stereo pair show in the same place, if the frame is one of them.
    stereo: Option<f64>,
    exposed: Exposed,
    camera: CameraReceipt,
    clip: Option<ClipRegion>,
}

/// A valid request whose scene lacks what only a bake makes: point trees, or normals and kernels of a large cloud.
pub struct UnbakedFrame {
    pub(super) state: Arc<EngineState>,
    scene: Arc<Loaded>,
    goal: Goal,
    request: FrameRequest,
}

impl UnbakedFrame {
    pub fn request(&self) -> &FrameRequest {
        &self.request
    }

    /// Begins the bake, or joins it if it runs already.
    ///
    /// # Errors
    /// [`EngineError::UnknownScene`] if the scene was deleted meanwhile.
    pub fn begin(&self) -> Result<BakeTicket, EngineError> {
        self.state.begin_bake(&self.scene, self.goal)
    }

    /// Waits for the bake and resolves the request in the scene as it was when the bake began, even if the scene has a newer
    /// revision by then. Dropping the future gives up waiting.
    ///
    /// # Errors
    /// Any error of the bake or of the request; [`EngineError::UnknownScene`] if the scene is deleted meanwhile.
    pub async fn bake(self) -> Result<Arc<ResolvedFrame>, EngineError> {
        let mut unbaked = self;
        loop {
            let scene = unbaked.begin()?.scene().await?;
            match resolve_in(&unbaked.state, scene, unbaked.request, None)? {
                Resolution::Ready(frame) => return Ok(frame),
                Resolution::NeedsBake(next) => unbaked = *next,
            }
        }
    }

    /// Does the work of [`UnbakedFrame::bake`]. Blocks; not for threads that run async tasks or parallel work.
    ///
    /// # Errors
    /// As [`UnbakedFrame::bake`].
    pub fn bake_blocking(self) -> Result<Arc<ResolvedFrame>, EngineError> {
        let mut unbaked = self;
        loop {
            let scene = unbaked.begin()?.wait_for_scene()?;
            match resolve_in(&unbaked.state, scene, unbaked.request, None)? {
                Resolution::Ready(frame) => return Ok(frame),
                Resolution::NeedsBake(next) => unbaked = *next,
            }
        }
    }
}

/// Checks that settings can be chosen for a goal, where there is one.
fn check_goal(settings: &Settings) -> Result<(), EngineError> {
    let (parameter, reason) = match settings {
        _ if settings.goal().is_none() => return Ok(()),
        _ if settings.is_part() => {
            (ImagePart::NAME, "settings would be chosen anew for each part of the image")
        }
        _ if settings.is_blurred() => {
            let has_lens = settings.lens_diameter().is_some();
            let parameter = if has_lens { Settings::LENS } else { Settings::SHUTTER };
            (parameter, "settings are chosen by measurements of single exposures")
        }
        _ => return Ok(()),
    };
    Err(EngineError::BadParameter {
        parameter,
        reason: reason.to_owned(),
        accepted: "no value beside `budget_ms` or `min_psnr_db`".to_owned(),
    })
}

/// The request with its settings chosen, where it has a goal, and how they were chosen.
///
/// # Errors
/// Any error of the request.
fn prepared(
    state: &EngineState,
    loaded: &Loaded,
    request: FrameRequest,
) -> Result<(FrameRequest, Option<PlannedFrame>), EngineError> {
    let request = request.with_blur_decided();
    check_goal(&request.settings)?;
    let (request, planned) = if request.settings.goal().is_some() {
        let view = view_of(state, loaded, &request)?;
        planner::planned(state, loaded, request, &[view], |one| check_size(state, one).is_ok())
    } else {
        (request, None)
    };
    Ok((request.with_antialias_decided(), planned))
}

/// The view by which the settings of a request are chosen: they have an antialiasing of their own, and both eyes have the same.
fn view_of(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
) -> Result<View, EngineError> {
    let settings = Settings { antialias: Antialias::Off, ..request.settings };
    Ok(check(state, loaded, &FrameRequest { settings, ..request.clone() })?.middle)
}

/// Settings and size of a frame of a moving pose, from the measurements of its scene. The request has the size of the still frame, and a
/// goal. `at_once`: nothing is chosen that needs a bake. `None` if the scene was not measured, or no measured settings go with those that are given.
///
/// # Errors
/// Any error of the request; the frame is a part of an image.
pub fn moving(
    state: &EngineState,
    request: &FrameRequest,
    moving: &Moving<'_>,
    at_once: bool,
) -> Result<Option<MovingFrame>, EngineError> {
    let loaded = state.loaded(&request.scene)?;
    check_goal(&request.settings)?;
    let view = view_of(state, &loaded, request)?;
    let fits = |one: &FrameRequest| {
        let lacks = || {
            if loaded.is_whole() && loaded.trees().is_some() {
                return false;
            }
            view_of(state, &loaded, one).is_ok_and(|view| {
                let (drawn, _) = with_detail(state, &loaded, one, &view);
                goal_of(&loaded, &drawn, &view).is_some()
            })
        };
        check_size(state, one).is_ok() && !(at_once && lacks())
    };
    Ok(planner::planned_moving(state, &loaded, request, &view, moving, fits))
}

/// The settings for the frames of a film, and how they were chosen: the goal of the requests, if they have one, is kept by all of them.
///
/// # Errors
/// Any error of a request.
pub fn settings_for_all(
    state: &EngineState,
    requests: &[FrameRequest],
) -> Result<Option<(Settings, PlanReceipt)>, EngineError> {
    let Some(first) = requests.first().filter(|first| first.settings.goal().is_some()) else {
        return Ok(None);
    };
    check_goal(&first.clone().with_blur_decided().settings)?;
    let loaded = state.loaded(&first.scene)?;
    let views: Vec<View> = requests
        .iter()
        .map(|request| view_of(state, &loaded, request))
        .collect::<Result<_, EngineError>>()?;
    let (chosen, planned) = planner::planned(state, &loaded, first.clone(), &views, |one| {
        check_size(state, one).is_ok()
    });
    Ok(planned.map(|planned| (chosen.settings, planned.receipt)))
}

fn unfit_format(error: EncodeError) -> EngineError {
    let (reason, accepted) = match error {
        EncodeError::Unsupported { format, output, accepted } => {
            (format!("{format:?} cannot hold {output:?}").to_lowercase(), accepted)
        }
        other => (other.to_string(), "another format or size"),
    };
    EngineError::BadParameter { parameter: "format", reason, accepted: accepted.to_owned() }
}

/// Checks everything of a request but what only a baked scene can tell.
fn check(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
) -> Result<Checked, EngineError> {
    check_size(state, request)?;
    if !(1..=100).contains(&request.quality) {
        return Err(EngineError::BadParameter {
            parameter: "quality",
            reason: format!("{} is out of range", request.quality),
            accepted: "1 to 100".to_owned(),
        });
    }
    encode::accepts(request.format, request.output).map_err(unfit_format)?;
    let clip = clip_region(loaded, &request.settings)?;
    check_field(loaded, &request.settings)?;
    let (middle, camera) = pose(loaded, request, clip.as_ref())?;
    let beside = from_eye(loaded, &request.settings, &middle)?;
    let (whole, stereo) = beside.map_or((middle, None), |(view, distance)| (view, Some(distance)));
    let view = shown_part(&whole, request)?;
    let exposed = exposed(loaded, request, &whole)?;
    Ok(Checked { view, whole, middle, stereo, exposed, camera, clip })
}

/// Checks that the scene has the scalar field that colours samples and lines.
fn check_field(loaded: &Loaded, settings: &Settings) -> Result<(), EngineError> {
    let fields = &loaded.info.fields;
    let known: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
    let bad = |parameter, reason: String, own: String| EngineError::BadParameter {
        parameter,
        reason,
        accepted: match &known[..] {
            [] if parameter == "field" => "no field: the scene has no scalar fields".into(),
            [] => "colors, levels, height, normal, instance: the scene has no scalar fields".into(),
            known => format!("{own}{}", known.join(", ")),
        },
    };
    match (settings.colored_field(), settings.color_by, settings.field) {
        (None, ColorBy::Field, _) => {
            let reason = "`color_by=field` needs the name of a field".to_owned();
            Err(bad("field", reason, String::new()))
        }
        (Some(name), _, own) if !known.contains(&name.as_str()) => {
            let parameter = if own.is_some() { "field" } else { "color_by" };
            let with = if own.is_some() { "" } else { "field, with one of the scene's fields: " };
            Err(bad(parameter, format!("the scene has no field `{name}`"), with.to_owned()))
        }
        _ => Ok(()),
    }
}

/// Resolves a request in the latest revision of its scene. Never bakes.
///
/// # Errors
/// Any error of the request.
pub fn resolve(
    state: &Arc<EngineState>,
    request: FrameRequest,
    planned: Option<PlannedFrame>,
) -> Result<Resolution, EngineError> {
    let loaded = state.loaded(&request.scene)?;
    resolve_in(state, loaded, request, planned)
}

/// Does the work of [`resolve`] in a given revision of the scene. `planned` says how the settings were chosen, if they were.
pub fn resolve_in(
    state: &Arc<EngineState>,
    loaded: Arc<Loaded>,
    request: FrameRequest,
    planned: Option<PlannedFrame>,
) -> Result<Resolution, EngineError> {
    if let Some(hook) = &state.config.resolve_hook {
        hook();
    }
    let asked = request.clone();
    let (request, own) = prepared(state, &loaded, request)?;
    let planned = own.or(planned);
    let Ground { checked, drawn, full_because, lacks } = ground(state, &loaded, &request)?;
    let baked = match lacks {
        None if !drawn.settings.draws_trees() => Ok((loaded.model.clone(), loaded.facts)),
        None => {
            loaded.trees().transpose()?.map(|trees| (trees.model, trees.facts)).ok_or(Goal::Trees)
        }
        Some(goal) => Err(goal),
    };
    Ok(match baked {
        Ok(model) => {
            let frame = decide(state, &loaded, drawn, (full_because, planned), checked, model);
            Resolution::Ready(Arc::new(frame))
        }
        Err(goal) => {
            let (state, request) = (state.clone(), asked);
            Resolution::NeedsBake(Box::new(UnbakedFrame { state, scene: loaded, goal, request }))
        }
    })
}

/// Returns what a bake has to make before a frame for this request can be drawn; `None` if nothing is missing. Decides no more than
/// that, so it takes no time worth mentioning.
///
/// # Errors
/// As [`resolve`].
pub fn lacking(state: &EngineState, request: &FrameRequest) -> Result<Option<Goal>, EngineError> {
    let loaded = state.loaded(&request.scene)?;
    let (request, _) = prepared(state, &loaded, request.clone())?;
    Ok(ground(state, &loaded, &request)?.lacks)
}

/// A checked request whose level of detail is decided.
struct Ground {
    checked: Checked,
    drawn: FrameRequest,
    full_because: Option<String>,
    lacks: Option<Goal>,
}

fn ground(
    state: &EngineState,
    loaded: &Loaded,
    request: &FrameRequest,
) -> Result<Ground, EngineError> {
    let checked = check(state, loaded, request)?;
    let (drawn, full_because) = with_detail(state, loaded, request, &checked.middle);
    let lacks = goal_of(loaded, &drawn, &checked.middle);
    Ok(Ground { checked, drawn, full_because, lacks })
}

/// How samples of a frame are drawn.
struct Chosen {
    /// The settings of the request, with nothing left open.
    settings: Settings,
    /// The choice, where it was left open.
    auto: Option<Choice>,
    /// Why the choice is provisional.
    provisional: Option<String>,
}

/// Decides what the request leaves open about how samples are drawn. Where that needs normals and kernels that are missing, the estimate
/// is begun, and the choice is made without them.
fn choose_reconstruction(
    state: &EngineState,
    loaded: &Arc<Loaded>,
    request: &FrameRequest,
    facts: &SceneFacts,
    view: &View,
) -> Chosen {
    let is_open = request.settings.leaves_drawing_open();
    let grounds = is_open.then(|| grounds(loaded, request, facts.counts.samples > 0, view));
    let mut auto = grounds.as_ref().map(auto::choose);
    let mut provisional = None;
    if let (Some(choice), Some(grounds)) = (&mut auto, &grounds)
        && loaded.lacks(&request.settings.decided(choice.reconstruct), needed_output(request))
    {
        provisional = Some(match state.estimate_in_background(loaded) {
            Ok(done) => {
                format!("normals and kernels are being estimated ({:.0} %)", done * 100.0)
            }
            Err(error) => format!("normals and kernels cannot be estimated: {error}"),
        });
        *choice = auto::choose(&auto::Grounds { has_kernels: false, ..*grounds });
    }
    let asked = request.settings;
    let decided = auto.map_or(asked, |choice| asked.decided(choice.reconstruct));
    let settings = Settings { projection: Some(view.projection), ..decided }
        .with_edl_decided(facts, request.output)
        .with_line_width_decided(facts)
        .with_shadow_maps_within(facts, frame_limits(state).0);
    let settings = match (&provisional, &grounds) {
        // Until there are kernels, discs close what splats will.
        (Some(_), Some(grounds)) => {
            let spacing_px = grounds.spacing_px.map(|px| px / magnification(request));
            settings.with_point_size(auto::disc_px(spacing_px))
        }
        _ => settings,
    };
    Chosen { settings, auto, provisional }
}

/// Decides how a checked request is drawn. `model` is the scene or its point trees.
fn decide(
    state: &EngineState,
    loaded: &Arc<Loaded>,
    request: FrameRequest,
    (full_because, planned): (Option<String>, Option<PlannedFrame>),
    Checked { view, whole, middle, stereo, exposed, camera, clip }: Checked,
    (model, facts): (Arc<SceneModel>, SceneFacts),
) -> ResolvedFrame {
    let adapter = state.adapter();
    let Chosen { settings, auto, provisional } =
        choose_reconstruction(state, loaded, &request, &facts, &middle);
    let settings = exposed.focus.map_or(settings, |focus| settings.focused_at(focus));
    let settings = stereo.map_or(settings, |distance| settings.stereo_from(distance));
    let seen: Vec<View> = [whole].into_iter().chain(exposed.whole).collect();
    // Disks reach beyond their samples.
    let bounds =
        loaded.extent.bounds.grown(f64::from(loaded.model.splats.cutoff) * loaded.extent.kernel);
    let way = |settings: &Settings, instead_because| {
        let adapter = AdapterFacts {
            atomics_64: adapter.atomics_64,
            atomic_sums_64: adapter.atomic_sums_64,
            rasterises: adapter.rasterises,
            draws_hidden: state.config.draw_hidden,
        };
        let reconstruction = Reconstruction::new(settings, &loaded.model.splats);
        let recolor = |settings: &Settings| {
            settings.recolor(loaded.up(), || loaded.heights(), &loaded.info.fields)
        };
        let facts = (&facts, &adapter);
        let drawing = Drawing::new(settings, reconstruction, facts, request.output, recolor, clip);
        let lit = (&loaded.model.lights[..], &loaded.model.splats, &bounds);
        let drawing = drawing.with_shadows(lit, &seen, facts);
        Drawing { instead_because, ..drawing }
    };
    let reconstruction = Reconstruction::new(&settings, &loaded.model.splats);
    let other = match reconstruction.pull_push() {
        Some(_) => settings.as_splats(),
        None => settings.in_three_passes(),
    };
    let has_samples = facts.counts.samples > 0;
    let blended = reconstruction.without_depths().filter(|_| has_samples);
    let fuzzy = reconstruction.fuzzy().filter(|_| has_samples);
    let fits = |splats| {
        let accepted_px = if facts.trees { settings.accepted_px() } else { 0.0 };
        let parts = request.settings.parts();
        let accepted_px = accepted_px * parts as f32;
        seen.iter()
            .all(|view| Slabs::new(splats, &loaded.extent, &view.finer(parts), accepted_px).fit())
    };
    let refused = blended.and_then(|_| no_blending(&request, &adapter)).or_else(|| {
        let too_deep = "the scene is too deep for the slabs of a single pass";
        let splats = fuzzy?;
        no_fuzzy(&adapter).or_else(|| (!fits(splats)).then_some(too_deep))
    });
    let pulled = reconstruction.pull_push().filter(|_| has_samples);
    let refused = refused.or_else(|| pulled.and_then(|_| no_pyramid(&request, &adapter)));
    let patches = loaded.patches(GeometryKind::Samples);
    let outgrow = |view: &View| auto::outgrow(patches, auto::spacing_px(patches, view), view);
    let refused = refused.or_else(|| {
        let too_few = "fewer than eight samples lie along the shorter side of the image";
        (pulled.is_some() && seen.iter().any(outgrow)).then_some(too_few)
    });
    let composites = facts.has_translucent() && request.output == Output::Color;
    let depthless = match (blended, pulled) {
        (Some(_), _) => Some("fuzzy and painted splats leave no depths for translucent surfaces"),
        (None, Some(_)) => Some("pull-push leaves no depths for translucent surfaces"),
        (None, None) => None,
    };
    let refused = refused.or(depthless.filter(|_| composites));
    let drawing = match refused {
        Some(_) => way(&other, refused),
        None => way(&settings, None),
    };
    let too_many = match fuzzy {
        Some(_) => "more splats lie over one pixel than a single pass has room for",
        None => {
            "the frame may show more splats, or larger ones, than can be sorted; a coarser level of detail has fewer"
        }
    };
    let in_three_passes =
        (blended.is_some() && refused.is_none()).then(|| way(&other, Some(too_many)));
    let tagged = Tagged {
        auto: auto.as_ref(),
        goal: planned.as_ref().map(|planned| planned.receipt.goal()),
        drawing: &drawing,
        instead: in_three_passes.as_ref(),
        is_provisional: provisional.is_some(),
    };
    let views: Vec<View> = [view].into_iter().chain(exposed.views.iter().copied()).collect();
    let key = entity_tag(loaded, &request, &tagged, &views, &adapter);
    let cost_key = cost_key(&request, &settings);
    ResolvedFrame {
        request,
        model,
        view,
        exposures: exposed.views,
        camera,
        extent: loaded.extent,
        drawing,
        provisional,
        auto,
        full_because,
        in_three_passes,
        key,
        cost_key,
        adapter: adapter.name,
        planned,
        scene: loaded.clone(),
        picks: Arc::default(),
    }
}

/// Returns the key of frames that cost about the same.
fn cost_key(request: &FrameRequest, settings: &Settings) -> CostKey {
    let mut hasher = DefaultHasher::new();
    request.scene.hash(&mut hasher);
    (request.output as u8, settings.kind_of_cost()).hash(&mut hasher);
    let (width, height) = drawn_size(request);
    let exposures = u64::from(request.settings.exposures());
    CostKey { kind: hasher.finish(), pixels: u64::from(width) * u64::from(height) * exposures }
}

/// Returns what a bake has to make before a frame whose level of detail is decided can be drawn; `None` if nothing is missing.
fn goal_of(loaded: &Loaded, request: &FrameRequest, view: &View) -> Option<Goal> {
    let (settings, output) = (&request.settings, needed_output(request));
    if settings.draws_trees() {
        return loaded.trees().is_none().then_some(Goal::Trees);
    }
    if loaded.is_whole() {
        return None;
    }
    let lacks = match (settings.leaves_drawing_open(), settings.wait) {
        (_, Wait::Whole) => true,
        // A picture of normals needs them however samples are drawn.
        (true, Wait::Ready) => {
            output == Output::Normal && loaded.lacks(&settings.decided(Reconstruct::Points), output)
        }
        (true, Wait::Complete) => {
            let wanted = choose_for(loaded, request, loaded.facts.counts.samples > 0, view);
            loaded.lacks(&settings.decided(wanted.reconstruct), output)
        }
        (false, _) => loaded.lacks(settings, output),
    };
    lacks.then_some(Goal::Estimates)
}

/// The output that needs as much of a scene as the frame: a picture coloured by normals needs them as a picture of normals does.
fn needed_output(request: &FrameRequest) -> Output {
    match request.settings.color_by {
        ColorBy::Normal if request.output == Output::Color => Output::Normal,
        _ => request.output,
    }
}

/// Why splats that leave no depths cannot draw the frame.
fn no_blending(request: &FrameRequest, adapter: &Adapter) -> Option<&'static str> {
    let (width, height) = drawn_size(request);
    let pixels = u64::from(width) * u64::from(height);
    if request.output != Output::Color {
        return Some("fuzzy and painted splats have nothing but colours");
    }
    if request.settings.edl == Edl::On {
        return Some("fuzzy and painted splats leave no depths for eye-dome lighting");
    }
    if request.settings.recolors() {
        return Some("fuzzy and painted splats leave no surfaces to colour");
    }
    (pixels * SLABS_BYTES.max(PAINTED_BYTES) > adapter.max_binding_bytes).then_some(
        "the adapter cannot bind the buffers that fuzzy or painted splats need for so many pixels",
    )
}

/// Why the frame cannot be drawn with `reconstruct=fuzzy`.
fn no_fuzzy(adapter: &Adapter) -> Option<&'static str> {
    (!adapter.atomic_sums_64).then_some("a single pass needs 64-bit atomics that add and exchange")
}

/// Why pull-push cannot draw a frame.
fn no_pyramid(request: &FrameRequest, adapter: &Adapter) -> Option<&'static str> {
    (Levels::of(drawn_size(request)).bytes() > adapter.max_binding_bytes)
        .then_some("the adapter cannot bind the pyramid of pull-push for so many pixels; a smaller frame needs a smaller one")
}
