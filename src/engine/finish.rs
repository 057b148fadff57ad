//! Finishes drawn frames: encodes them, writes their receipts and answers their callers.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use super::framing;
use super::landing::Drawn;
use super::receipt::{
    InstanceCounts, Legend, PassReceipt, Receipt, SampleCounts, SegmentCounts,
    SpecialisationReceipt, SplatCounts, TranslucentOrder, TranslucentReceipt, TriangleCounts,
};
use super::state::EngineState;
use super::trace::FrameSpans;
use super::{EncodedFrame, EngineError};
use crate::passes::{LAYERS, srgb8};
use crate::plan::{Pass, Reconstruct, UsedSettings, UsedSplats};
use crate::residency::layout::GpuStats;

/// Encodes a frame, writes its receipt and answers whoever waits.
pub fn finish(state: &EngineState, drawn: Drawn) {
    let began = Instant::now();
    let request = &drawn.job.frame.request;
    let span = FrameSpans::encode(&drawn.job.span, &drawn.job.request_id, request.format);
    let entered = span.enter();
    let encoded = crate::encode::encode(&drawn.image, request.format, request.quality);
    let encode = began.elapsed();
    let reply = match encoded {
        Ok(encoded) => {
            let mut receipt = receipt(state, &drawn);
            receipt.encode_wait_ns =
                began.saturating_duration_since(drawn.landed).as_nanos() as u64;
            receipt.encode_ns = encode.as_nanos() as u64;
            receipt.depth_range = encoded.depth_range;
            receipt.bytes = encoded.bytes.len() as u64;
            receipt.total_ns = drawn.job.enqueued.elapsed().as_nanos() as u64;
            state.stats.frames.fetch_add(1, Ordering::Relaxed);
            state.stats.encode_ns.fetch_add(receipt.encode_ns, Ordering::Relaxed);
            let share_ns = receipt.gpu_share_ns().unwrap_or(0);
            state.stats.gpu_ns.fetch_add(share_ns, Ordering::Relaxed);
            if let Some(observer) = state.observer.get() {
                observer.frame(drawn.job.lane().class(), &receipt);
            }
            Ok(Arc::new(EncodedFrame {
                bytes: encoded.bytes.into(),
                content_type: encoded.content_type,
                receipt,
            }))
        }
        Err(error) => Err(EngineError::Internal(error.to_string())),
    };
    drop(entered);
    drop(span);
    state.answer(&drawn.job, reply);
}

fn wide(words: [u32; 2]) -> u64 {
    u64::from(words[0]) | u64::from(words[1]) << 32
}

/// Nodes that passed their test, whichever way they are drawn.
fn accepted(stats: &GpuStats) -> u64 {
    [stats.nodes_drawn, stats.splats_listed, stats.splats_scattered].map(u64::from).iter().sum()
}

/// Why a frame shows nothing, where it does.
fn nothing_visible(drawn: &Drawn) -> Option<String> {
    let resolved = &drawn.job.frame;
    let background = drawn.job.drawing().background(&resolved.model);
    let background = srgb8(background).to_le_bytes();
    let GpuStats { pixels_of_samples, pixels_of_triangles, pixels_of_segments, .. } = drawn.stats;
    let covered = u64::from(pixels_of_samples)
        + u64::from(pixels_of_triangles)
        + u64::from(pixels_of_segments);
    // Behind dense fog, an image of one colour may show the scene; behind layers of fog, and of surroundings, the background has many colours.
    let plan = &drawn.job.drawing().plan;
    let has_colors = plan.runs(Pass::FogBackground) || plan.runs(Pass::EnvironmentBackground);
    let is_even = has_colors || drawn.image.is_blank(background);
    let is_blank = covered == 0 && is_even;
    let is_clipped = drawn.job.drawing().clip.is_some();
    is_blank.then(|| framing::why_nothing(&resolved.extent.bounds, &resolved.view, is_clipped))
}

fn receipt(state: &EngineState, drawn: &Drawn) -> Receipt {
    let job = &drawn.job;
    let resolved = &job.frame;
    let counts = resolved.model.counts();
    let drawing = job.drawing();
    let runs = |pass| drawing.plan.runs(pass);
    let as_splats = runs(Pass::ProjectSplats) || runs(Pass::FuzzySplats) || runs(Pass::ListSplats);
    let samples = runs(Pass::ProjectSamples) || as_splats;
    let splats = |count: u32| as_splats.then_some(u64::from(count));
    let splats_used = UsedSplats::of(&drawing.reconstruction).filter(|_| counts.samples > 0);
    Receipt {
        request_id: job.request_id.as_str().to_owned(),
        scene: resolved.request.scene.clone(),
        revision: resolved.model.revision,
        adapter: state.adapter().name,
        batch_size: drawn.batch_size,
        views: drawn.views,
        camera: resolved.camera.clone(),
        settings: UsedSettings {
            applied: drawing.applied,
            provisional: resolved.provisional.clone(),
            asked: resolved.auto.map(|_| Reconstruct::Auto),
            because: resolved.auto.map(|choice| choice.because()),
            spacing_px: resolved.auto.and_then(|choice| choice.spacing_px),
            instead_because: drawing.instead_because,
            full_because: resolved.full_because.clone(),
            splats: splats_used,
        },
        accepted_px: drawing.applied.accepted_px(),
        planned: resolved.planned.as_ref().map(|planned| {
            // Passes that drew several frames at once do not tell the time of one.
            let ns = drawn.gpu_ns.filter(|_| drawn.views == 1);
            // Measured frames drew as many maps of their lights.
            let is_as_measured = drawn.draws_new_maps;
            state.planners.see(planned, ns.map(|ns| ns as f64 / 1e6), is_as_measured)
        }),
        legend: drawing
            .recolor
            .and_then(|recolor| Legend::of(&recolor, &resolved.scene.info.fields)),
        passes: PassReceipt::list(&drawing.plan, &drawn.pass_ns),
        specialisations: SpecialisationReceipt::list(&drawing.plan),
        nothing_visible: nothing_visible(drawn),
        gpu_ns: drawn.gpu_ns,
        queue_ns: drawn.queue.as_nanos() as u64,
        record_ns: drawn.record.as_nanos() as u64,
        device_wait_ns: drawn.device_wait.as_nanos() as u64,
        readback_ns: drawn.readback.as_nanos() as u64,
        samples: SampleCounts {
            stored: counts.samples,
            tested: samples.then(|| wide(drawn.stats.samples_tested)),
            accepted: resolved.model.trees.then(|| accepted(&drawn.stats)),
            drawn: samples.then_some(u64::from(drawn.stats.pixels_of_samples)),
        },
        splats: SplatCounts {
            clipped: splats(drawn.stats.splats_clipped),
            rasterised: splats(drawn.stats.splats_listed),
            scattered: splats(drawn.stats.splats_scattered),
        },
        triangles: TriangleCounts {
            stored: counts.triangles,
            tested: runs(Pass::ProjectTriangles).then(|| wide(drawn.stats.triangles_tested)),
            rasterised: runs(Pass::ProjectTriangles)
                .then_some(u64::from(drawn.stats.triangles_rasterised)),
        },
        segments: SegmentCounts {
            stored: counts.segments,
            tested: runs(Pass::ProjectLines).then(|| wide(drawn.stats.segments_tested)),
            listed: runs(Pass::ProjectLines).then_some(u64::from(drawn.stats.segments_listed)),
        },
        instances: InstanceCounts {
            stored: counts.instances,
            drawn: Some(u64::from(drawn.stats.instances_drawn)),
        },
        translucent: runs(Pass::CompositeLayers).then_some(TranslucentReceipt {
            order: TranslucentOrder::PixelDepth,
            layers: LAYERS,
            deepest: drawn.stats.deepest,
            pixels_of_all_layers: u64::from(drawn.stats.pixels_of_all_layers),
            most_left_out: f32::from_bits(drawn.stats.passing_most),
        }),
        holes_filled: runs(Pass::ResolvePulled).then_some(u64::from(drawn.stats.pixels_filled)),
        gpu_bytes: drawn.gpu_bytes,
        ..Receipt::default()
    }
}
