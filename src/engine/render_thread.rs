//! The render thread, the only owner of the device.
//!
//! ```text
//! queue ──take batch──▶ ensure resident ──record, submit──▶ in flight (2 at most) ──land──▶ encoders ──▶ waiters
//!   ▲                                                            │ lost
//!   └────────────────── put back, device opened again ◀──────────┘
//! ```

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::EngineError;
use super::config::DefaultLimits;
use super::encoders::Encoders;
use super::frame_job::FrameJob;
use super::priming::Primer;
use super::queue::Class;
use super::renderer::{InFlight, Renderer};
use super::state::{Adapter, EngineState, Flying, Phase};
use crate::gpu::{GpuError, GpuOptions};
use crate::memory;
use crate::residency::layout::MOST_ROWS;

/// Submissions in flight while more jobs wait: one is drawn while the next is recorded.
const DEPTH: usize = 2;
/// How often an idle thread lets the device free what was dropped.
const IDLE: Duration = Duration::from_millis(250);

/// Opens the device and runs until told to stop. `opened` hears once whether that worked.
pub fn run(state: &Arc<EngineState>, opened: impl FnOnce(Result<(), GpuError>)) {
    let options = GpuOptions {
        force_32_bit: state.config.force_32_bit,
        rasterise: state.config.rasterise,
        like_a_gpu: state.config.like_a_gpu,
        adapter: None,
        max_binding_bytes: state.config.max_binding_bytes,
        pipeline_folder: state.config.prime.as_ref().and_then(|prime| prime.folder.clone()),
        pipeline_source: crate::passes::shaders::fingerprint(),
    };
    let mut renderer = match open(state, &options) {
        Ok(renderer) => renderer,
        Err(error) => return opened(Err(error)),
    };
    let encoders = Encoders::start(state);
    opened(Ok(()));
    let mut primer = Primer::start(state, &renderer);
    loop {
        match serve(state, &mut renderer, &encoders) {
            Stop::Done => break,
            Stop::Lost => match reopen(state, &options) {
                Some(fresh) => {
                    // The thread that is replaced still has the lost device.
                    drop(primer);
                    renderer = fresh;
                    rayon::spawn(memory::release_unused);
                    primer = Primer::start(state, &renderer);
                }
                None => break,
            },
        }
    }
    drop(primer);
}

enum Stop {
    Done,
    Lost,
}

fn open(state: &EngineState, options: &GpuOptions) -> Result<Renderer, GpuError> {
    let mut renderer = Renderer::open(options, |gpu| {
        state.config.gpu_budget_bytes.unwrap_or_else(|| {
            let bound = (gpu.max_binding_bytes() * 24).min(4 << 30);
            let of_memory = DefaultLimits::of(state.config.memory_bytes);
            if gpu.is_cpu { bound.min(of_memory.cpu_adapter_bytes) } else { bound }
        })
    })?;
    if let Some(pixels) = state.config.small_triangle_px {
        renderer.set_small_triangle_px(pixels);
    }
    if let Some(pixels) = state.config.small_splat_px {
        renderer.set_small_splat_px(pixels);
    }
    if let Some(units) = state.config.large_units_limit {
        renderer.set_large_units_limit(units);
    }
    renderer.levels_hook = state.config.levels_hook.clone();
    state.set_adapter(Adapter {
        name: renderer.gpu.name.clone(),
        renderer: options.pipeline_source.clone(),
        atomics_64: renderer.gpu.atomics_64,
        atomic_sums_64: renderer.gpu.atomic_sums_64,
        rasterises: renderer.gpu.rasterises,
        is_discrete: renderer.gpu.is_discrete,
        max_binding_bytes: renderer.gpu.max_binding_bytes(),
        max_side: renderer.gpu.limits.max_texture_dimension_2d.min(MOST_ROWS),
        budget: renderer.residency.budget(),
    });
    state.set_phase(Phase::Ready);
    Ok(renderer)
}

/// Tries until an adapter answers again or the engine stops.
fn reopen(state: &EngineState, options: &GpuOptions) -> Option<Renderer> {
    state.set_phase(Phase::Lost);
    state.stats.device_losses.fetch_add(1, Ordering::Relaxed);
    tracing::warn!("the GPU was lost; opening it again and bringing the scenes back");
    let mut pause = Duration::from_millis(50);
    loop {
        match open(state, options) {
            Ok(renderer) => return Some(renderer),
            Err(error) => tracing::error!(%error, "the GPU cannot be opened again yet"),
        }
        if state.is_stopping() {
            for job in state.take_all() {
                state.answer(&job, Err(EngineError::ShuttingDown));
            }
            return None;
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(Duration::from_secs(5));
    }
}

/// Whether a test has made the file that `POINTILLIST_LOSE_DEVICE` names; the order is taken by removing the file. Release builds do not ask
/// for the variable.
fn is_loss_ordered() -> bool {
    cfg!(debug_assertions)
        && std::env::var_os("POINTILLIST_LOSE_DEVICE")
            .is_some_and(|file| std::fs::remove_file(file).is_ok())
}

fn serve(state: &Arc<EngineState>, renderer: &mut Renderer, encoders: &Encoders) -> Stop {
    let mut flights: VecDeque<InFlight> = VecDeque::new();
    let mut last_landed = Instant::now();
    loop {
        assert!(!state.is_to_break(), "told to break");
        let work = state.next_batch(flying(&flights), IDLE);
        // The batch just taken is refused: a device may die between any two commands.
        if state.take_lose_request() || is_loss_ordered() {
            renderer.gpu.device.destroy();
        }
        if !work.batch.is_empty() && state.take_spoil_request() {
            renderer.spoil_next();
        }
        state.beat(!work.batch.is_empty() || !flights.is_empty());
        let idle = work.batch.is_empty();
        if !idle {
            let batch = apart(state, work.batch);
            let batch = make_resident(state, renderer, batch);
            if batch.iter().any(|job| job.is_long()) {
                // Nobody else's frames wait for all exposures.
                if let Some(lost) =
                    land_all(state, renderer, &mut flights, encoders, &mut last_landed)
                {
                    retry(state, [lost, batch].concat());
                    return Stop::Lost;
                }
            }
            if !batch.is_empty() {
                match renderer.submit(batch, &|| state.beat(true)) {
                    Ok(flight) => flights.push_back(flight),
                    Err((jobs, error)) => {
                        for job in jobs {
                            state.refund(&job);
                            state.answer(&job, Err(error.clone()));
                        }
                    }
                }
            }
        }
        // Before anybody is answered, so that who has seen a frame finds its scene resident.
        publish(state, renderer);
        while flights.len() >= DEPTH
            || (idle && !flights.is_empty())
            || (!flights.is_empty() && state.is_queue_empty())
        {
            let Some(flight) = flights.pop_front() else { break };
            let (mut again, lost) = land(state, renderer, flight, encoders, &mut last_landed);
            if lost {
                // Later submissions may still have landed.
                for flight in flights.drain(..) {
                    again.extend(land(state, renderer, flight, encoders, &mut last_landed).0);
                }
            }
            retry(state, again);
            if lost {
                return Stop::Lost;
            }
        }
        if idle && flights.is_empty() {
            if work.stopping {
                return Stop::Done;
            }
            if renderer.gpu.device.poll(wgpu::PollType::Poll).is_err() || renderer.gpu.is_lost() {
                return Stop::Lost;
            }
        }
    }
}

/// Lands all submissions. Returns the jobs to draw again if the device is lost.
fn land_all(
    state: &EngineState,
    renderer: &mut Renderer,
    flights: &mut VecDeque<InFlight>,
    encoders: &Encoders,
    last_landed: &mut Instant,
) -> Option<Vec<Arc<FrameJob>>> {
    let (mut again, mut is_lost) = (Vec::new(), false);
    for flight in flights.drain(..) {
        let (jobs, lost) = land(state, renderer, flight, encoders, last_landed);
        again.extend(jobs);
        is_lost |= lost;
    }
    if is_lost {
        return Some(again);
    }
    retry(state, again);
    None
}

/// Takes frames of several exposures out of a batch with others, so that nobody waits for all of them; they come next. If such a frame is
/// the first, it is drawn by itself, and the others come next.
fn apart(state: &EngineState, batch: Vec<Arc<FrameJob>>) -> Vec<Arc<FrameJob>> {
    let mut batch = batch.into_iter();
    let Some(first) = batch.next() else { return Vec::new() };
    let (now, later): (Vec<_>, Vec<_>) = match first.is_long() {
        true => (Vec::new(), batch.collect()),
        false => batch.partition(|job| !job.is_long()),
    };
    state.put_back(later);
    std::iter::once(first).chain(now).collect()
}

/// Submissions that have not landed.
fn flying(flights: &VecDeque<InFlight>) -> Flying {
    let mut flying = Flying { flights: flights.len(), ..Flying::default() };
    let charged = flights.iter().flat_map(InFlight::jobs).filter_map(|job| job.charged());
    for (client, cost_ns) in charged {
        flying.cost_ns += cost_ns;
        flying.has_jobs |= client.class() == Class::Job;
    }
    flying
}

/// Brings the scenes of a batch to the GPU. Jobs of other scenes than the first wait for the next batch when bringing theirs
/// might push the first one out.
fn make_resident(
    state: &EngineState,
    renderer: &mut Renderer,
    batch: Vec<Arc<FrameJob>>,
) -> Vec<Arc<FrameJob>> {
    let mut ready: Vec<Arc<FrameJob>> = Vec::with_capacity(batch.len());
    let mut later = Vec::new();
    for job in batch {
        let model = &job.frame.model;
        if !ready.is_empty() && !renderer.residency.is_current(model) {
            later.push(job);
            continue;
        }
        match renderer.ensure(model) {
            Ok(()) => ready.push(job),
            Err(error) => {
                state.refund(&job);
                state.answer(&job, Err(error));
            }
        }
    }
    state.put_back(later);
    ready
}

/// Lands one submission: the jobs to draw again on another device, and whether this one is to be given up.
fn land(
    state: &EngineState,
    renderer: &mut Renderer,
    flight: InFlight,
    encoders: &Encoders,
    last_landed: &mut Instant,
) -> (Vec<Arc<FrameJob>>, bool) {
    // Not what it waited behind the one before.
    let began = flight.began.max(*last_landed);
    let landed = renderer.land(flight, *last_landed);
    *last_landed = Instant::now();
    let took = began.elapsed();
    state.stats.batches.fetch_add(1, Ordering::Relaxed);
    if let Some(observer) = state.observer.get() {
        observer.batch(landed.drawn.len());
    }
    let frames = landed.drawn.len().max(1) as u32;
    let costs: Vec<(Arc<FrameJob>, Option<u64>)> = landed
        .drawn
        .iter()
        .map(|drawn| {
            let share_ns = drawn.gpu_ns.map(|ns| ns / u64::from(drawn.views.max(1)));
            // An adapter that cannot tell leaves what passed on the clock.
            let ns = share_ns.unwrap_or((took / frames).as_nanos() as u64);
            (drawn.job.clone(), Some(ns))
        })
        .chain(landed.failed.iter().map(|(job, _)| (job.clone(), None)))
        .collect();
    state.settle(&costs, took);
    for job in landed.given_up {
        state.settle_given_up(&job, took);
    }
    for drawn in landed.drawn {
        encoders.push(drawn);
    }
    for (job, error) in landed.failed {
        state.answer(&job, Err(error));
    }
    let (redraw, stuck): (Vec<_>, Vec<_>) =
        landed.redraw.into_iter().partition(|job| job.may_redraw());
    for job in stuck {
        let text =
            "the frame was drawn again and again, and each time a list was too short".to_owned();
        state.answer(&job, Err(EngineError::Internal(text)));
    }
    state.put_back(redraw);
    (landed.again, landed.lost)
}

fn retry(state: &EngineState, jobs: Vec<Arc<FrameJob>>) {
    let (again, hopeless): (Vec<_>, Vec<_>) = jobs.into_iter().partition(|job| job.try_again());
    for job in hopeless {
        state.answer(&job, Err(EngineError::DeviceLost { retry_after: Duration::from_secs(1) }));
    }
    state.put_back(again);
}

/// Tells the others what is on the GPU, after freeing what was removed.
fn publish(state: &EngineState, renderer: &mut Renderer) {
    let removed = state.set_resident(renderer.residency.ids());
    for id in &removed {
        renderer.remove(id);
    }
    if !removed.is_empty() {
        // Not here: frames wait for this thread.
        rayon::spawn(memory::release_unused);
    }
    let stats = &state.stats;
    stats.gpu_bytes_resident.store(renderer.residency.used(), Ordering::Relaxed);
    stats.evictions.store(renderer.residency.evictions(), Ordering::Relaxed);
    stats.uploads.store(renderer.residency.uploads(), Ordering::Relaxed);
    let written = renderer.residency.instances_written();
    stats.instances_written.store(written, Ordering::Relaxed);
    stats.pipelines_late.store(renderer.pipelines.late(), Ordering::Relaxed);
}
