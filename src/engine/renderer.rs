//! The device and everything on it: batches go in, host memory with pixels comes out.

use std::cell::RefCell;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::frame_job::FrameJob;
use super::group::groups;
use super::pick;
use super::queue::Waiting;
use super::{EngineError, LevelsHook};
use crate::gpu::bind::BindCache;
use crate::gpu::buffer::Buffer;
use crate::gpu::readback::{Landing, Ring};
use crate::gpu::timing::Timer;
use crate::gpu::{Gpu, GpuError, GpuOptions};
use crate::passes::{
    self, Context, FrameTask, LevelCopies, Levels, MapKey, PassSpan, Pipelines, Round, Scratch,
    ShadowMaps, Shadows, Uniforms,
};
use crate::plan::{Pass, Specialisation};
use crate::residency::layout::{GpuStats, MOST_VIEWS};
use crate::residency::model::SceneModel;
use crate::residency::{Residency, ResidencyError};
use crate::scene::EyeDome;

/// One adapter with its scenes.
pub struct Renderer {
    pub gpu: Arc<Gpu>,
    pub residency: Residency,
    pub pipelines: Arc<Pipelines>,
    pub(super) binds: RefCell<BindCache>,
    pub(super) scratch: Scratch,
    pub(super) ring: Ring,
    pub(super) timers: Vec<Timer>,
    pub(super) fault: Arc<Mutex<Option<String>>>,
    pub(super) small_triangle_px: u32,
    pub(super) small_splat_px: u32,
    pub(super) large_units_limit: u32,
    pub(super) spoil: bool,
    pub(super) levels_hook: Option<LevelsHook>,
    shadow_maps: ShadowMaps,
}

/// A submission on its way.
pub struct InFlight {
    pub(super) groups: Vec<FlyingGroup>,
    pub(super) timer: Timer,
    pub(super) stamps: Option<(Landing, u64)>,
    pub(super) index: wgpu::SubmissionIndex,
    /// Error of the driver while it was recorded and submitted.
    pub(super) fault: Option<String>,
    pub began: Instant,
    pub(super) record: Duration,
    pub(super) submitted: Instant,
    /// From recording to landing.
    pub(super) span: tracing::Span,
}

/// Frames that the same dispatches draw, or one frame of several exposures: their pixels one behind the other, then the counters of all views.
pub(super) struct FlyingGroup {
    pub(super) jobs: Vec<Arc<FrameJob>>,
    /// Exposures whose mean each frame is, and views that the same dispatches draw.
    pub(super) exposures: usize,
    pub(super) views: usize,
    /// Whether nobody waited any more when a part of the exposures was drawn, so that the others are not.
    pub(super) is_given_up: bool,
    pub(super) landing: Landing,
    /// Bytes of one frame.
    pub(super) pixel_bytes: u64,
    /// Where the copies of levels lie that a test has asked for.
    pub(super) level_copies: Range<u64>,
    /// For a pick: where each geometry's chunks lie in the chunk table.
    pub(super) chunk_ranges: Vec<Range<u32>>,
    pub(super) spans: Vec<PassSpan>,
    /// The shadow maps that the frames use.
    pub(super) shadows: Option<Shadows>,
    pub(super) large_capacity: u32,
    pub(super) entry_capacity: u32,
    pub(super) paint_capacity: u32,
    pub(super) paint_launches: u32,
    pub(super) walk_stride: u32,
    pub(super) gpu_bytes: u64,
}

/// Bytes that views drawn together may need of any one buffer. It keeps the memory that scratch takes in proportion: a
/// frame of 4096² needs as much.
const SHARED_BYTES: u64 = 128 << 20;
/// The limit for a CPU adapter, whose caches it should not outgrow by far: large frames gain nothing by going together.
const SHARED_BYTES_CPU: u64 = 4 << 20;
pub(super) const STATS_BYTES: u64 = size_of::<GpuStats>() as u64;

impl InFlight {
    pub fn jobs(&self) -> impl Iterator<Item = &Arc<FrameJob>> {
        self.groups.iter().flat_map(|group| &group.jobs)
    }
}

impl Renderer {
    /// Opens an adapter; `budget` is asked once its limits are known.
    ///
    /// # Errors
    /// See [`GpuError`].
    pub fn open(
        options: &GpuOptions,
        budget: impl FnOnce(&Gpu) -> u64,
    ) -> Result<Renderer, GpuError> {
        let gpu = Arc::new(Gpu::open(options)?);
        let fault = Arc::new(Mutex::new(None));
        let sink = fault.clone();
        gpu.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let text = error.to_string();
            tracing::error!(error = %text, "the GPU refused a command");
            sink.lock().get_or_insert(text);
        }));
        let residency = Residency::new(&gpu, budget(&gpu));
        // Some ten seconds' work.
        let large_units_limit = if gpu.is_cpu { 1 << 20 } else { 1 << 24 };
        let scratch = Scratch::new(&gpu);
        Ok(Renderer {
            small_triangle_px: passes::small_triangle_px(gpu.is_cpu),
            small_splat_px: passes::small_splat_px(gpu.is_cpu),
            gpu,
            residency,
            pipelines: Arc::default(),
            binds: RefCell::default(),
            scratch,
            ring: Ring::default(),
            timers: Vec::new(),
            fault,
            large_units_limit,
            spoil: false,
            levels_hook: None,
            shadow_maps: ShadowMaps::default(),
        })
    }

    /// For measurements: boxes of triangles with a longer side than this go to the rasteriser.
    pub fn set_small_triangle_px(&mut self, pixels: u32) {
        self.small_triangle_px = pixels;
    }

    /// For measurements: boxes of splats with a longer side than this are walked by several threads.
    pub fn set_small_splat_px(&mut self, pixels: u32) {
        self.small_splat_px = pixels;
    }

    /// For tests: what boxes of large triangles may cover of a frame, in units of 4096 pixels.
    pub fn set_large_units_limit(&mut self, units: u32) {
        self.large_units_limit = units;
    }

    /// For tests: the driver refuses the next submission.
    pub fn spoil_next(&mut self) {
        self.spoil = true;
    }

    fn spoil(&self, encoder: &mut wgpu::CommandEncoder) {
        let buffer = self.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("larger than any"),
            size: self.gpu.limits.max_buffer_size.saturating_add(4),
            usage: wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        encoder.clear_buffer(&buffer, 0, None);
    }

    /// Makes a scene resident.
    ///
    /// # Errors
    /// A scene that cannot fit.
    pub fn ensure(&mut self, model: &Arc<SceneModel>) -> Result<(), EngineError> {
        // Bind groups keep the buffers alive that an eviction, a growth or a new revision has replaced.
        match self.residency.ensure(&self.gpu, model) {
            Ok(false) => Ok(()),
            Ok(true) => {
                self.binds.borrow_mut().clear();
                Ok(())
            }
            Err(error) => {
                self.binds.borrow_mut().clear();
                Err(engine_error(error))
            }
        }
    }

    /// Frees a scene.
    pub fn remove(&mut self, id: &str) {
        self.shadow_maps.remove(id);
        self.residency.remove(&self.gpu, id);
        self.binds.borrow_mut().clear();
    }

    /// Records and submits frames of resident scenes. `alive` is called whenever a part of a long frame has ended.
    ///
    /// # Errors
    /// The whole batch, with the reason.
    pub fn submit(
        &mut self,
        jobs: Vec<Arc<FrameJob>>,
        alive: &dyn Fn(),
    ) -> Result<InFlight, (Vec<Arc<FrameJob>>, EngineError)> {
        let submitted = self.try_submit(jobs, alive);
        if submitted.is_err() {
            // Maps that a failed submission reserved may be empty.
            self.shadow_maps.clear();
        }
        submitted
    }

    fn try_submit(
        &mut self,
        jobs: Vec<Arc<FrameJob>>,
        alive: &dyn Fn(),
    ) -> Result<InFlight, (Vec<Arc<FrameJob>>, EngineError)> {
        let began = Instant::now();
        let span = batch_span(&jobs);
        let entered = span.enter();
        let mut timer = self.timers.pop().unwrap_or_else(|| Timer::new(&self.gpu));
        timer.reset();
        let mut commands = Commands::new(self.gpu.clone(), alive);
        let groups = groups(&jobs, |job| job.group_key(), |job| self.most_views(job));
        let tasks: Vec<Vec<FrameTask>> = groups.iter().map(|group| self.tasks(group)).collect();
        let mut uniforms = Uniforms::default();
        let mut offsets = Vec::with_capacity(tasks.len());
        for tasks in &tasks {
            let mut own = Vec::with_capacity(tasks.len());
            for task in tasks {
                let Some(scene) = self.residency.scene(&task.model.id) else {
                    return Err((
                        jobs,
                        EngineError::Internal("a scene left the GPU before its frame".into()),
                    ));
                };
                self.scratch.reserve(&self.gpu, scene, task);
                for map in task.shadows.iter().flat_map(Shadows::drawn) {
                    self.scratch.reserve(&self.gpu, scene, map);
                }
                own.push(uniforms.group(task, scene));
            }
            offsets.push(own);
        }
        uniforms.write(&self.gpu, &mut self.scratch);
        let mut recorded = Vec::with_capacity(tasks.len());
        for ((tasks, offsets), jobs_of_group) in tasks.iter().zip(&offsets).zip(&groups) {
            match self.record_group(&mut commands, &mut timer, tasks, offsets, jobs_of_group) {
                Ok(group) => recorded.push(group),
                Err(error) => return Err((jobs, error)),
            }
        }
        let stamps = timer.resolve(&mut commands.encoder).map(|(buffer, bytes)| {
            let landing = self.ring.take(&self.gpu, bytes);
            let encoder = &mut commands.encoder;
            encoder.copy_buffer_to_buffer(buffer, 0, landing.buffer(), 0, bytes);
            (landing, bytes)
        });
        if std::mem::take(&mut self.spoil) {
            self.spoil(&mut commands.encoder);
        }
        // Some adapters begin to draw at once.
        let (submitted, index) = commands.submit();
        let groups: Vec<FlyingGroup> = groups
            .into_iter()
            .zip(recorded)
            .zip(tasks)
            .map(|((jobs, recorded), mut tasks)| {
                let Recorded { landing, pixel_bytes, level_copies, spans, is_given_up } = recorded;
                landing.map();
                // There is at least one task, and the first one has the most views and draws the shadow maps.
                let first = tasks.swap_remove(0);
                let gpu_bytes = jobs.first().map_or(0, |job| job.frame.model.gpu_bytes());
                let picking = jobs.first().filter(|job| !job.frame.picks.is_empty());
                let chunk_ranges = picking
                    .map(|job| self.residency.chunk_ranges(&job.frame.model))
                    .unwrap_or_default();
                FlyingGroup {
                    exposures: jobs.first().map_or(1, |job| job.frame.exposures.len().max(1)),
                    views: first.views.len(),
                    is_given_up,
                    jobs,
                    landing,
                    pixel_bytes,
                    level_copies,
                    chunk_ranges,
                    spans,
                    shadows: first.shadows,
                    large_capacity: self.scratch.large_capacity(),
                    entry_capacity: self.scratch.entry_capacity(),
                    paint_capacity: self.scratch.paint_capacity(),
                    paint_launches: self.scratch.paint_launches(),
                    walk_stride: self.scratch.walk_stride(),
                    gpu_bytes,
                }
            })
            .collect();
        if let Some((landing, _)) = &stamps {
            landing.map();
        }
        let fault = self.fault.lock().take();
        let record = submitted - began;
        drop(entered);
        Ok(InFlight { groups, timer, stamps, index, fault, began, record, submitted, span })
    }

    /// Views of a job's scene that may be drawn together: what each needs of a buffer must fit it as often.
    fn most_views(&self, job: &FrameJob) -> usize {
        let Some(scene) = self.residency.scene(&job.frame.model.id) else { return 1 };
        let view = job.frame.view.finer(job.drawing().settings.parts());
        let largest = Scratch::largest(scene, (view.width, view.height), &job.drawing().plan);
        let shared = if self.gpu.is_cpu { SHARED_BYTES_CPU } else { SHARED_BYTES };
        let room = self.gpu.max_binding_bytes().min(shared) / largest.max(1);
        room.clamp(1, u64::from(MOST_VIEWS)) as usize
    }

    /// The tasks that draw a group, one after the other: several where its frame is the mean of many exposures.
    fn tasks(&mut self, jobs: &[Arc<FrameJob>]) -> Vec<FrameTask> {
        // Groups are never empty.
        let job = &jobs[0];
        let task = self.task(jobs);
        let shadows = self.shadows(&task, job);
        let task = FrameTask { shadows, ..task };
        let exposures = &job.frame.exposures;
        if exposures.is_empty() {
            return vec![task];
        }
        let at_once = if job.shares_dispatches() { self.most_views(job) } else { 1 };
        let rounds = exposures.chunks(at_once).enumerate();
        let rounds = rounds.map(|(number, views)| {
            let first = number * at_once;
            let is_last = first + views.len() == exposures.len();
            // The first round draws the maps of all.
            let shadows = task.shadows.clone().map(|shadows| match first {
                0 => shadows,
                _ => Shadows { sources: Vec::new(), ..shadows },
            });
            FrameTask {
                views: views.iter().map(|view| view.finer(task.parts)).collect(),
                round: Some(Round {
                    first: first as u32,
                    exposures: is_last.then_some(exposures.len() as u32),
                }),
                shadows,
                ..task.clone()
            }
        });
        rounds.collect()
    }

    fn task(&self, jobs: &[Arc<FrameJob>]) -> FrameTask {
        // Groups are never empty.
        let first = &jobs[0];
        let drawing = first.drawing();
        let parts = drawing.settings.parts();
        let scale = parts as f32;
        let edl = drawing.settings.eye_dome();
        FrameTask {
            model: first.frame.model.clone(),
            views: jobs.iter().map(|job| job.frame.view.finer(parts)).collect(),
            output: first.frame.request.output,
            plan: drawing.plan.clone(),
            reconstruction: drawing.reconstruction.in_parts(scale),
            extent: first.frame.extent,
            small_splat_px: self.small_splat_px,
            weight_one: first.weight_one(),
            small_triangle_px: self.small_triangle_px,
            large_capacity: self.scratch.large_capacity(),
            walk_stride: self.scratch.walk_stride(),
            large_units_limit: self.large_units_limit,
            accepted_px: drawing.settings.accepted_px() * scale,
            error_mode: drawing.settings.error_mode,
            levels: drawing.settings.shows_levels(),
            recolor: drawing.recolor,
            clip: drawing.clip,
            edl: edl.map(|edl| EyeDome { radius_px: edl.radius_px * scale, ..edl }),
            round: None,
            parts,
            least_line_px: drawing.settings.least_line_px() * scale,
            background: drawing.background(&first.frame.model),
            environment: drawing.plan.draws(Specialisation::Environment),
            fog: drawing.fog(&first.frame.model),
            occlusion: first
                .frame
                .model
                .occlusion
                .filter(|_| drawing.plan.runs(Pass::AmbientOcclusion)),
            tone: drawing.tone(),
            image_rows: drawing.settings.image_rows().map(|rows| rows.saturating_mul(parts)),
            window_pixels: passes::window_pixels(self.gpu.max_binding_bytes()),
            entry_capacity: self.scratch.entry_capacity(),
            paint_capacity: self.scratch.paint_capacity(),
            paint_launches: self.scratch.paint_launches(),
            shadows: None,
            opaque_only: false,
        }
    }

    /// The shadow maps of frames, if their lights cast shadows.
    fn shadows(&mut self, task: &FrameTask, job: &FrameJob) -> Option<Shadows> {
        let drawing = job.drawing();
        let frames = drawing.shadows.as_ref()?;
        let key = MapKey {
            scene: task.model.id.clone(),
            revision: task.model.uid,
            plan: frames.plan.clone(),
            reconstruction: frames.reconstruction,
            accepted_px: drawing.settings.accepted_px(),
            clip: task.clip,
        };
        let tasks = frames.views.iter().map(|view| key.task(*view, task)).collect();
        let (views, anew) = (&frames.views, job.frame.request.settings.draws_maps);
        let (set, sources) = self.shadow_maps.get(&self.gpu, &self.binds, key, views, anew);
        Some(Shadows { tasks, set, sources })
    }

    /// Records the tasks of a group, and copies its pixels and counters to where the host reads them. The exposures of a frame are
    /// submitted part by part, until nobody waits for the frame any more.
    fn record_group(
        &mut self,
        commands: &mut Commands<'_>,
        timer: &mut Timer,
        tasks: &[FrameTask],
        offsets: &[passes::GroupUniforms],
        jobs: &[Arc<FrameJob>],
    ) -> Result<Recorded, EngineError> {
        // Groups are never empty, and a pick is a group by itself.
        let picks = &jobs[0].frame.picks;
        let internal = |text: String| EngineError::Internal(text);
        // There is at least one.
        let first = &tasks[0];
        let scene = self
            .residency
            .scene(&first.model.id)
            .ok_or_else(|| internal("a scene left the GPU before its frame".into()))?;
        let (width, height) = first.image_size();
        let pixel_bytes = match picks.len() {
            0 => u64::from(width) * u64::from(height) * 4,
            count => count as u64 * pick::BYTES,
        };
        // All exposures make one image.
        let images = if first.round.is_some() { 1 } else { u64::from(first.count()) };
        let views: u64 = tasks.iter().map(|task| u64::from(task.count())).sum();
        let (pixels, stats) = (images * pixel_bytes, views * STATS_BYTES);
        let shadows = first.shadows.as_ref();
        let counted = shadows.map_or(0, Shadows::stats_bytes);
        let copied = match &self.levels_hook {
            Some(_) if first.plan.runs(Pass::Pull) => {
                LevelCopies::COUNT * u64::from(first.count()) * Levels::of(first.size()).bytes()
            }
            _ => 0,
        };
        let copies = pixels + stats + counted;
        let landing = self.ring.take(&self.gpu, copies + copied);
        let (mut spans, mut behind, mut is_given_up) = (Vec::new(), pixels, false);
        for (number, (task, offset)) in tasks.iter().zip(offsets).enumerate() {
            if number > 0 {
                commands.pass_on();
                is_given_up = jobs.iter().all(|job| job.is_abandoned());
                if is_given_up {
                    break;
                }
            }
            let encoder = &mut commands.encoder;
            let mut context = Context {
                gpu: &self.gpu,
                pipelines: &self.pipelines,
                binds: &self.binds,
                scratch: &mut self.scratch,
                residency: &self.residency,
                timer: &mut *timer,
                copies: (copied > 0)
                    .then(|| LevelCopies { buffer: landing.buffer(), next: copies }),
            };
            let recorded = passes::record(&mut context, encoder, task, scene, offset);
            spans.extend(recorded.map_err(|error| internal(error.to_string()))?);
            let (counts, length) =
                (self.scratch.stats.buffer(), u64::from(task.count()) * STATS_BYTES);
            encoder.copy_buffer_to_buffer(counts.raw(), 0, landing.buffer(), behind, length);
            behind += length;
        }
        let (scratch, encoder) = (&self.scratch, &mut commands.encoder);
        let mut copy = |source: &Buffer, from: u64, start: u64, length: u64| {
            encoder.copy_buffer_to_buffer(source.raw(), from, landing.buffer(), start, length);
        };
        let (shown, identities) = (scratch.pixels.buffer(), scratch.visibility.buffer());
        for (&[x, y], start) in picks.iter().zip((0..).step_by(pick::BYTES as usize)) {
            let pixel = u64::from(y) * u64::from(width) + u64::from(x);
            copy(shown, pixel * 4, start, 4);
            copy(identities, pixel * 8, start + 4, 8);
        }
        if picks.is_empty() {
            let has_means = [Pass::Average, Pass::Accumulate].map(|pass| first.plan.runs(pass));
            copy(if has_means.contains(&true) { identities } else { shown }, 0, 0, pixels);
        }
        if let Some(shadows) = shadows.filter(|_| counted > 0) {
            copy(&shadows.set.stats, 0, pixels + stats, counted);
        }
        let level_copies = copies..copies + copied;
        Ok(Recorded { landing, pixel_bytes, level_copies, spans, is_given_up })
    }
}

/// A group that has been recorded.
struct Recorded {
    landing: Landing,
    pixel_bytes: u64,
    level_copies: Range<u64>,
    spans: Vec<PassSpan>,
    is_given_up: bool,
}

/// The commands of a batch. Parts of it may be submitted before the others are recorded.
struct Commands<'a> {
    gpu: Arc<Gpu>,
    encoder: wgpu::CommandEncoder,
    /// The part that was submitted last.
    flying: Option<wgpu::SubmissionIndex>,
    /// When the first part was submitted.
    submitted: Option<Instant>,
    /// Is called whenever a part has ended.
    alive: &'a dyn Fn(),
}

impl<'a> Commands<'a> {
    /// Longest wait for a part; a device that needs longer for it is waited for at the end.
    const PATIENCE: Duration = Duration::from_secs(30);

    fn encoder(gpu: &Gpu) -> wgpu::CommandEncoder {
        let label = wgpu::CommandEncoderDescriptor { label: Some("batch") };
        gpu.device.create_command_encoder(&label)
    }

    fn new(gpu: Arc<Gpu>, alive: &'a dyn Fn()) -> Commands<'a> {
        Commands { encoder: Commands::encoder(&gpu), gpu, flying: None, submitted: None, alive }
    }

    /// Submits what is recorded, and waits for the part before it: one is drawn while the next is recorded.
    fn pass_on(&mut self) {
        let full = std::mem::replace(&mut self.encoder, Commands::encoder(&self.gpu));
        self.submitted.get_or_insert_with(Instant::now);
        let before = self.flying.replace(self.gpu.queue.submit([full.finish()]));
        if before.is_some() {
            // Whether the device is lost is found out when the batch lands.
            let _ = self.gpu.device.poll(wgpu::PollType::Wait {
                submission_index: before,
                timeout: Some(Commands::PATIENCE),
            });
            (self.alive)();
        }
    }

    /// Submits the rest. Returns when the first part was submitted, and the number of the last submission.
    fn submit(self) -> (Instant, wgpu::SubmissionIndex) {
        let submitted = self.submitted.unwrap_or_else(Instant::now);
        (submitted, self.gpu.queue.submit([self.encoder.finish()]))
    }
}

/// The span of a submission, with the names of its frames.
fn batch_span(jobs: &[Arc<FrameJob>]) -> tracing::Span {
    tracing::debug_span!(parent: None, "batch", size = jobs.len(), frames = %Names(jobs))
}

/// The names of frames, which are written only when somebody reads them.
pub(super) struct Names<'a>(pub(super) &'a [Arc<FrameJob>]);

impl std::fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (number, job) in self.0.iter().enumerate() {
            let space = if number == 0 { "" } else { " " };
            write!(f, "{space}{}", job.request_id)?;
        }
        Ok(())
    }
}

pub fn engine_error(error: ResidencyError) -> EngineError {
    match error {
        ResidencyError::OverBudget { what, needed, budget } => {
            EngineError::OutOfGpuMemory { what, needed, budget }
        }
        ResidencyError::OverBinding { what, needed, limit } => {
            EngineError::OverBinding { what, needed, limit }
        }
    }
}
