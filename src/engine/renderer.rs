//! The device and everything on it: batches go in, host memory with pixels comes out.

use std::cell::RefCell;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::EngineError;
use super::frame_job::FrameJob;
use super::group::groups;
use super::pick;
use crate::encode::FrameImage;
use crate::gpu::bind::BindCache;
use crate::gpu::buffer::Buffer;
use crate::gpu::readback::{Landing, Ring};
use crate::gpu::timing::Timer;
use crate::gpu::{Gpu, GpuError, GpuOptions};
use crate::passes::{
    self, Context, FrameTask, PassSpan, Pipelines, SMALL_SPLAT_PX, SMALL_TRIANGLE_PX, Scratch,
    Uniforms,
};
use crate::plan::{Output, Pass};
use crate::residency::layout::{GpuStats, MOST_VIEWS};
use crate::residency::model::SceneModel;
use crate::residency::{Residency, ResidencyError};

/// One adapter with its scenes.
pub struct Renderer {
    pub gpu: Arc<Gpu>,
    pub residency: Residency,
    pub pipelines: Arc<Pipelines>,
    binds: RefCell<BindCache>,
    scratch: Scratch,
    ring: Ring,
    timers: Vec<Timer>,
    fault: Arc<Mutex<Option<String>>>,
    small_triangle_px: u32,
    small_splat_px: u32,
    large_units_limit: u32,
    spoil: bool,
}

/// A submission on its way.
pub struct InFlight {
    groups: Vec<FlyingGroup>,
    timer: Timer,
    stamps: Option<(Landing, u64)>,
    index: wgpu::SubmissionIndex,
    /// Error of the driver while it was recorded and submitted.
    fault: Option<String>,
    pub began: Instant,
    record: Duration,
    submitted: Instant,
    /// From recording to landing.
    span: tracing::Span,
}

/// Frames that the same dispatches draw: their pixels one behind the other, then their counters.
struct FlyingGroup {
    jobs: Vec<Arc<FrameJob>>,
    landing: Landing,
    /// Bytes of one frame.
    pixel_bytes: u64,
    /// For a pick: where each geometry's chunks lie in the chunk table.
    chunk_ranges: Vec<Range<u32>>,
    spans: Vec<PassSpan>,
    large_capacity: u32,
    entry_capacity: u32,
    walk_stride: u32,
    gpu_bytes: u64,
}

/// A frame in host memory.
pub struct Drawn {
    pub job: Arc<FrameJob>,
    pub image: FrameImage,
    pub stats: GpuStats,
    /// Time of every pass that ran, in order, for all `views`; `None` where the adapter cannot say.
    pub pass_ns: Vec<(Pass, Option<u64>)>,
    pub gpu_ns: Option<u64>,
    pub batch_size: u32,
    /// Frames that the same dispatches drew.
    pub views: u32,
    pub queue: Duration,
    pub record: Duration,
    /// From its submission to that of others before it having ended.
    pub device_wait: Duration,
    pub readback: Duration,
    pub gpu_bytes: u64,
    pub landed: Instant,
}

/// Outcome of a submission.
#[derive(Default)]
pub struct Landed {
    pub drawn: Vec<Drawn>,
    /// To be drawn again: the device was lost.
    pub again: Vec<Arc<FrameJob>>,
    /// To be drawn again: a list was too short, or cut into too few parts, or splats too heavy, which is mended.
    pub redraw: Vec<Arc<FrameJob>>,
    pub failed: Vec<(Arc<FrameJob>, EngineError)>,
    pub lost: bool,
}

/// After this long at one submission the device is given up.
const PATIENCE: Duration = Duration::from_secs(600);
/// Bytes that views drawn together may need of any one buffer. It keeps the memory that scratch takes in proportion: a
/// frame of 4096² needs as much.
const SHARED_BYTES: u64 = 128 << 20;
/// The limit for a CPU adapter, whose caches it should not outgrow by far: large frames gain nothing by going together.
const SHARED_BYTES_CPU: u64 = 4 << 20;
const STATS_BYTES: u64 = size_of::<GpuStats>() as u64;

impl InFlight {
    pub fn jobs(&self) -> impl Iterator<Item = &Arc<FrameJob>> {
        self.groups.iter().flat_map(|group| &group.jobs)
    }
}

impl FlyingGroup {
    /// The frames of a group that has landed.
    fn read(&self) -> Option<Vec<(FrameImage, GpuStats)>> {
        let (size, count) = (self.pixel_bytes as usize, self.jobs.len());
        let total = (self.pixel_bytes + STATS_BYTES) * count as u64;
        self.landing.read(total, |bytes| {
            let (pixels, stats) = bytes.split_at(size * count);
            let stats = stats.chunks_exact(STATS_BYTES as usize);
            let frames = self.jobs.iter().zip(pixels.chunks_exact(size)).zip(stats);
            frames
                .map(|((job, pixels), stats)| {
                    let image = match job.frame.picks.len() {
                        0 => image(job, pixels),
                        count => pick::image(count, pixels, &self.chunk_ranges),
                    };
                    (image, bytemuck::pod_read_unaligned(stats))
                })
                .collect()
        })
    }
}

impl Landed {
    fn refuse(&mut self, jobs: Vec<Arc<FrameJob>>, error: &EngineError) {
        self.failed.extend(jobs.into_iter().map(|job| (job, error.clone())));
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
            gpu,
            residency,
            pipelines: Arc::default(),
            binds: RefCell::default(),
            scratch,
            ring: Ring::default(),
            timers: Vec::new(),
            fault,
            small_triangle_px: SMALL_TRIANGLE_PX,
            small_splat_px: SMALL_SPLAT_PX,
            large_units_limit,
            spoil: false,
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
        self.residency.remove(&self.gpu, id);
        self.binds.borrow_mut().clear();
    }

    /// Records and submits frames of resident scenes.
    ///
    /// # Errors
    /// The whole batch, with the reason.
    pub fn submit(
        &mut self,
        jobs: Vec<Arc<FrameJob>>,
    ) -> Result<InFlight, (Vec<Arc<FrameJob>>, EngineError)> {
        let began = Instant::now();
        let span = batch_span(&jobs);
        let entered = span.enter();
        let mut timer = self.timers.pop().unwrap_or_else(|| Timer::new(&self.gpu));
        timer.reset();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("batch") });
        let groups = groups(&jobs, |job| job.group_key(), |job| self.most_views(job));
        let tasks: Vec<FrameTask> = groups.iter().map(|group| self.task(group)).collect();
        let mut uniforms = Uniforms::default();
        let mut offsets = Vec::with_capacity(tasks.len());
        for task in &tasks {
            let Some(scene) = self.residency.scene(&task.model.id) else {
                return Err((
                    jobs,
                    EngineError::Internal("a scene left the GPU before its frame".into()),
                ));
            };
            self.scratch.reserve(&self.gpu, scene, task);
            offsets.push(uniforms.group(task, scene));
        }
        uniforms.write(&self.gpu, &mut self.scratch);
        let mut recorded = Vec::with_capacity(tasks.len());
        for ((task, offset), jobs_of_group) in tasks.iter().zip(&offsets).zip(&groups) {
            // Groups are never empty, and a pick is a group by itself.
            let picks = &jobs_of_group[0].frame.picks;
            match self.record_group(&mut encoder, &mut timer, task, offset, picks) {
                Ok(group) => recorded.push(group),
                Err(error) => return Err((jobs, error)),
            }
        }
        let stamps = timer.resolve(&mut encoder).map(|(buffer, bytes)| {
            let landing = self.ring.take(&self.gpu, bytes);
            encoder.copy_buffer_to_buffer(buffer, 0, landing.buffer(), 0, bytes);
            (landing, bytes)
        });
        if std::mem::take(&mut self.spoil) {
            self.spoil(&mut encoder);
        }
        let commands = encoder.finish();
        // Some adapters begin to draw at once.
        let submitted = Instant::now();
        let index = self.gpu.queue.submit([commands]);
        let groups: Vec<FlyingGroup> = groups
            .into_iter()
            .zip(recorded)
            .map(|(jobs, (landing, pixel_bytes, spans))| {
                landing.map();
                let gpu_bytes = jobs.first().map_or(0, |job| job.frame.model.gpu_bytes());
                let picking = jobs.first().filter(|job| !job.frame.picks.is_empty());
                let chunk_ranges = picking
                    .map(|job| self.residency.chunk_ranges(&job.frame.model))
                    .unwrap_or_default();
                FlyingGroup {
                    jobs,
                    landing,
                    pixel_bytes,
                    chunk_ranges,
                    spans,
                    large_capacity: self.scratch.large_capacity(),
                    entry_capacity: self.scratch.entry_capacity(),
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
        let size = (job.frame.request.width, job.frame.request.height);
        let largest = Scratch::largest(scene, size, &job.drawing().plan);
        let shared = if self.gpu.is_cpu { SHARED_BYTES_CPU } else { SHARED_BYTES };
        let room = self.gpu.max_binding_bytes().min(shared) / largest.max(1);
        room.clamp(1, u64::from(MOST_VIEWS)) as usize
    }

    fn task(&self, jobs: &[Arc<FrameJob>]) -> FrameTask {
        // Groups are never empty.
        let first = &jobs[0];
        let drawing = first.drawing();
        FrameTask {
            model: first.frame.model.clone(),
            views: jobs.iter().map(|job| job.frame.view).collect(),
            output: first.frame.request.output,
            plan: drawing.plan.clone(),
            reconstruction: drawing.reconstruction,
            extent: first.frame.extent,
            small_splat_px: self.small_splat_px,
            weight_one: first.weight_one(),
            small_triangle_px: self.small_triangle_px,
            large_capacity: self.scratch.large_capacity(),
            walk_stride: self.scratch.walk_stride(),
            large_units_limit: self.large_units_limit,
            accepted_px: drawing.settings.accepted_px(),
            error_mode: drawing.settings.error_mode,
            levels: drawing.settings.shows_levels(),
            recolor: drawing.recolor,
            clip: drawing.clip,
            edl: drawing.settings.eye_dome(),
            background: drawing.background(&first.frame.model),
            entry_capacity: self.scratch.entry_capacity(),
        }
    }

    fn record_group(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        task: &FrameTask,
        offset: &passes::GroupUniforms,
        picks: &[[u32; 2]],
    ) -> Result<(Landing, u64, Vec<PassSpan>), EngineError> {
        let internal = |text: String| EngineError::Internal(text);
        let scene = self
            .residency
            .scene(&task.model.id)
            .ok_or_else(|| internal("a scene left the GPU before its frame".into()))?;
        let mut context = Context {
            gpu: &self.gpu,
            pipelines: &self.pipelines,
            binds: &self.binds,
            scratch: &mut self.scratch,
            residency: &self.residency,
            timer,
        };
        let spans = passes::record(&mut context, encoder, task, scene, offset)
            .map_err(|error| internal(error.to_string()))?;
        let (width, height) = task.size();
        let pixel_bytes = match picks.len() {
            0 => u64::from(width) * u64::from(height) * 4,
            count => count as u64 * pick::BYTES,
        };
        let (pixels, stats) =
            (u64::from(task.count()) * pixel_bytes, u64::from(task.count()) * STATS_BYTES);
        let landing = self.ring.take(&self.gpu, pixels + stats);
        let scratch = &self.scratch;
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
            copy(shown, 0, 0, pixels);
        }
        copy(scratch.stats.buffer(), 0, pixels, stats);
        Ok((landing, pixel_bytes, spans))
    }

    /// Waits until the GPU is through with a submission, or with all of them. A slow frame is no lost device.
    fn wait(
        &self,
        flight: &InFlight,
        index: Option<&wgpu::SubmissionIndex>,
    ) -> Result<wgpu::PollStatus, wgpu::PollError> {
        loop {
            let waited = self.gpu.device.poll(wgpu::PollType::Wait {
                submission_index: index.cloned(),
                timeout: Some(Duration::from_secs(30)),
            });
            // Only a timeout is worth another wait: what a lost device refused never ends.
            let slow = matches!(waited, Err(wgpu::PollError::Timeout));
            if !slow || self.gpu.is_lost() || flight.began.elapsed() > PATIENCE {
                return waited;
            }
            let frames: Vec<&str> = flight.jobs().map(|job| job.frame.model.id.as_str()).collect();
            let elapsed_s = flight.began.elapsed().as_secs();
            tracing::warn!(?frames, elapsed_s, "the GPU is still drawing");
        }
    }

    /// Waits for a submission and brings its frames to host memory. The one before it had landed `before`.
    pub fn land(&mut self, flight: InFlight, before: Instant) -> Landed {
        let mut waited = self.wait(&flight, Some(&flight.index));
        // The callbacks of mappings run within polls.
        let pending =
            |flight: &InFlight| flight.groups.iter().any(|group| group.landing.is_pending());
        let never_begun = matches!(waited, Err(wgpu::PollError::WrongSubmissionIndex(..)))
            || flight.fault.is_some();
        if never_begun {
            // A device that is gone says so once its queue is empty.
            waited = self.wait(&flight, None);
        }
        let given_up = waited.is_err() && !self.gpu.is_lost();
        let mut tries = 0;
        while waited.is_ok() && pending(&flight) && tries < 1000 {
            if self.gpu.device.poll(wgpu::PollType::Poll).is_err() {
                break;
            }
            tries += 1;
        }
        let mut landed = Landed::default();
        let stamps =
            flight.stamps.as_ref().filter(|_| !never_begun).and_then(|(landing, bytes)| {
                landing.read(*bytes, bytemuck::pod_collect_to_vec::<u8, u64>)
            });
        let batch_size = flight.jobs().count() as u32;
        let refusal = match flight.fault {
            _ if given_up => Some(format!("the GPU was at it for {} s", PATIENCE.as_secs())),
            // Drawing it again would end the same way. What the driver has refused may be any buffer of ours: the device
            // is opened anew, with nothing but what is known to be whole.
            Some(text) if !self.gpu.is_lost() => Some(text),
            _ => None,
        };
        let (began, submitted, record) = (flight.began, flight.submitted, flight.record);
        let _entered = flight.span.enter();
        for group in flight.groups {
            // Buffers of what never began would show an older frame.
            let read = if never_begun { None } else { group.read() };
            let Some(frames) = read else {
                landed.lost = true;
                match &refusal {
                    Some(text) => landed.refuse(group.jobs, &EngineError::Internal(text.clone())),
                    None => landed.again.extend(group.jobs),
                }
                continue;
            };
            self.ring.give_back(group.landing);
            let views = frames.len() as u32;
            let wanted = frames.first().map_or(0, |(_, stats)| stats.entries_wanted);
            if wanted > group.entry_capacity {
                self.scratch.grow_entries(&self.gpu, wanted);
                let limit = self.scratch.entry_capacity();
                if limit >= wanted {
                    landed.redraw.extend(group.jobs);
                } else {
                    let error = EngineError::OverLimit {
                        what: "chunks of point trees in view",
                        found: u64::from(wanted),
                        limit: u64::from(limit),
                    };
                    landed.refuse(group.jobs, &error);
                }
                continue;
            }
            let longest = frames.first().map_or(0, |(_, stats)| stats.large_longest);
            if longest > group.large_capacity {
                self.scratch.grow_large(&self.gpu, longest);
                let limit = self.scratch.large_capacity();
                if limit >= longest {
                    landed.redraw.extend(group.jobs);
                } else if views > 1 {
                    // Each by itself may fit.
                    group.jobs.iter().for_each(|job| job.set_alone());
                    landed.redraw.extend(group.jobs);
                } else {
                    let error = EngineError::OverLimit {
                        what: "large triangles and splats in view",
                        found: u64::from(longest),
                        limit: u64::from(limit),
                    };
                    landed.refuse(group.jobs, &error);
                }
                continue;
            }
            if frames.first().is_some_and(|(_, stats)| stats.walk_cut != 0) {
                if self.scratch.grow_walk(group.walk_stride) {
                    landed.redraw.extend(group.jobs);
                } else {
                    let text = "a list of large triangles or splats took too many rounds";
                    landed.refuse(group.jobs, &EngineError::Internal(text.to_owned()));
                }
                continue;
            }
            let now = Instant::now();
            let (pass_ns, gpu_ns) = self.durations(&group.spans, stamps.as_deref());
            tell_passes(&group.jobs, &pass_ns);
            let since = now - submitted;
            let gpu = Duration::from_nanos(gpu_ns.unwrap_or(0));
            let rest = since.saturating_sub(gpu);
            let device_wait = before.saturating_duration_since(submitted).min(rest);
            for (job, (image, stats)) in group.jobs.into_iter().zip(frames) {
                if stats.sums_full != 0 {
                    job.lighten();
                    landed.redraw.push(job);
                    continue;
                }
                if let Some(error) = self.over_limit(&stats) {
                    landed.failed.push((job, error));
                    continue;
                }
                landed.drawn.push(Drawn {
                    queue: began.saturating_duration_since(job.enqueued),
                    record,
                    device_wait,
                    readback: rest - device_wait,
                    job,
                    image,
                    stats,
                    pass_ns: pass_ns.clone(),
                    gpu_ns,
                    batch_size,
                    views,
                    gpu_bytes: group.gpu_bytes,
                    landed: now,
                });
            }
        }
        if let Some((landing, _)) = flight.stamps {
            self.ring.give_back(landing);
        }
        self.timers.push(flight.timer);
        landed.lost |= self.gpu.is_lost();
        landed
    }

    /// Why a view was not drawn: its large triangles cover too much.
    fn over_limit(&self, stats: &GpuStats) -> Option<EngineError> {
        if stats.large_wrapped == 0 && stats.large_units <= self.large_units_limit {
            return None;
        }
        let units = if stats.large_wrapped == 0 { stats.large_units } else { u32::MAX };
        Some(EngineError::OverLimit {
            what: "pixels to test for large triangles and splats",
            found: u64::from(units) * 4096,
            limit: u64::from(self.large_units_limit) * 4096,
        })
    }

    /// Time of each pass, parts of one pass added up, and from the first begin to the last end.
    fn durations(
        &self,
        spans: &[PassSpan],
        stamps: Option<&[u64]>,
    ) -> (Vec<(Pass, Option<u64>)>, Option<u64>) {
        let period = self.gpu.timestamp_period_ns;
        let ns = |ticks: u64| period.map(|period| (ticks as f64 * f64::from(period)) as u64);
        let mut passes: Vec<(Pass, Option<u64>)> = Vec::new();
        let (mut first, mut last) = (u64::MAX, 0);
        for span in spans {
            let ticks = span.span.zip(stamps).and_then(|(span, stamps)| {
                let begin = *stamps.get(span.begin as usize)?;
                let end = *stamps.get(span.end as usize)?;
                first = first.min(begin);
                last = last.max(end);
                Some(end.saturating_sub(begin))
            });
            let time = ticks.and_then(ns);
            match passes.iter_mut().find(|(pass, _)| *pass == span.pass) {
                Some((_, sum)) => *sum = sum.zip(time).map(|(a, b)| a + b),
                None => passes.push((span.pass, time)),
            }
        }
        (passes, (last >= first).then(|| ns(last - first)).flatten())
    }
}

/// The span of a submission, with the names of its frames.
fn batch_span(jobs: &[Arc<FrameJob>]) -> tracing::Span {
    tracing::debug_span!(parent: None, "batch", size = jobs.len(), frames = %Names(jobs))
}

/// Tells what each pass of frames that were drawn together took.
fn tell_passes(jobs: &[Arc<FrameJob>], pass_ns: &[(Pass, Option<u64>)]) {
    for (pass, gpu_ns) in pass_ns {
        let (name, views, frames) = (pass.name(), jobs.len(), Names(jobs));
        tracing::debug!(pass = name, gpu_ns, views, %frames, "drawn");
    }
}

/// The names of frames, which are written only when somebody reads them.
struct Names<'a>(&'a [Arc<FrameJob>]);

impl std::fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (number, job) in self.0.iter().enumerate() {
            let space = if number == 0 { "" } else { " " };
            write!(f, "{space}{}", job.request_id)?;
        }
        Ok(())
    }
}

fn image(job: &FrameJob, bytes: &[u8]) -> FrameImage {
    let (width, height) = (job.frame.request.width, job.frame.request.height);
    match job.frame.request.output {
        Output::Color => {
            FrameImage::Color { width, height, rgba: bytemuck::pod_collect_to_vec(bytes) }
        }
        Output::Depth => {
            FrameImage::Depth { width, height, depth: bytemuck::pod_collect_to_vec(bytes) }
        }
        Output::Normal => {
            FrameImage::Normal { width, height, rgba: bytemuck::pod_collect_to_vec(bytes) }
        }
        Output::Id => FrameImage::Id { width, height, id: bytemuck::pod_collect_to_vec(bytes) },
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
