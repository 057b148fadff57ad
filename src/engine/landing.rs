//! The end of a submission: waits for it, reads what it wrote, and decides which frames are done and which are drawn again.

use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::exposures::counted;
use super::frame_job::FrameJob;
use super::pick;
use super::renderer::{FlyingGroup, InFlight, Names, Renderer, STATS_BYTES};
use super::{EngineError, LevelsHook};
use crate::encode::FrameImage;
use crate::passes::{PassSpan, Shadows};
use crate::plan::{Output, Pass};
use crate::residency::layout::GpuStats;

/// After this long at one submission the device is given up.
const PATIENCE: Duration = Duration::from_secs(600);

/// A frame in host memory.
pub struct Drawn {
    pub job: Arc<FrameJob>,
    pub image: FrameImage,
    pub stats: GpuStats,
    /// Time of every pass that ran, in order, for all `views`; `None` where the adapter cannot say.
    pub pass_ns: Vec<(Pass, Option<u64>)>,
    pub gpu_ns: Option<u64>,
    /// As many shadow maps were drawn as for a frame at a new pose.
    pub draws_new_maps: bool,
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
    /// Ended between exposures, because nobody waited for them.
    pub given_up: Vec<Arc<FrameJob>>,
    pub lost: bool,
}

/// Times of a submission.
struct Times {
    began: Instant,
    submitted: Instant,
    record: Duration,
    /// When the submission before it landed.
    before: Instant,
    batch_size: u32,
    stamps: Option<Vec<u64>>,
}

/// Frames and counters that a group has written.
struct LandedGroup {
    frames: Vec<(FrameImage, GpuStats)>,
    /// Counters of each of its shadow maps that was drawn.
    maps: Vec<GpuStats>,
}

/// Whether the lists of a group were long enough.
enum Room {
    Enough,
    /// They are now.
    Made,
    /// They are for each of its frames by itself.
    MadeIfAlone,
    /// They cannot be for painted splats, which are blended in three passes then.
    MadeInThreePasses,
    /// They cannot be.
    None(EngineError),
}

impl FlyingGroup {
    /// Reads a group that has landed.
    fn read(&self) -> Option<LandedGroup> {
        let (size, count) = (self.pixel_bytes as usize, self.jobs.len());
        let views = count * self.exposures;
        let maps = self.shadows.as_ref().map_or(0, Shadows::stats_bytes);
        let total = self.pixel_bytes * count as u64 + STATS_BYTES * views as u64 + maps;
        self.landing.read(total, |bytes| {
            let (pixels, stats) = bytes.split_at(size * count);
            let stats: Vec<GpuStats> = stats
                .chunks_exact(STATS_BYTES as usize)
                .map(bytemuck::pod_read_unaligned)
                .collect();
            let (own, of_maps) = stats.split_at(views);
            let own = own.chunks_exact(self.exposures).map(counted);
            let images = self.jobs.iter().zip(pixels.chunks_exact(size)).map(|(job, pixels)| {
                match job.frame.picks.len() {
                    0 => image(job, pixels),
                    count => pick::image(count, pixels, &self.chunk_ranges),
                }
            });
            LandedGroup { frames: images.zip(own).collect(), maps: of_maps.to_vec() }
        })
    }
}

impl FlyingGroup {
    /// Hands the copies of levels to the test that has asked for them.
    fn show_levels(&self, hook: &LevelsHook) {
        let Range { start, end } = self.level_copies;
        if start < end {
            self.landing.read(end, |bytes| {
                hook(&bytemuck::pod_collect_to_vec::<u8, u32>(&bytes[start as usize..]));
            });
        }
    }

    /// No other frame may use the maps that the group has made.
    fn spoil_maps(&self) {
        if let Some(shadows) = self.shadows.as_ref().filter(|shadows| !shadows.sources.is_empty()) {
            shadows.set.soundness.spoil();
        }
    }

    /// Whether a list was too short for maps that another group has drawn.
    fn has_spoiled_maps(&self) -> bool {
        self.shadows.as_ref().is_some_and(|shadows| shadows.set.soundness.is_spoiled())
    }
}

impl Landed {
    fn refuse(&mut self, jobs: Vec<Arc<FrameJob>>, error: &EngineError) {
        self.failed.extend(jobs.into_iter().map(|job| (job, error.clone())));
    }
}

impl Renderer {
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
        let (never_begun, given_up) = self.finish(&flight);
        let mut landed = Landed::default();
        let stamps =
            flight.stamps.as_ref().filter(|_| !never_begun).and_then(|(landing, bytes)| {
                landing.read(*bytes, bytemuck::pod_collect_to_vec::<u8, u64>)
            });
        let times = Times {
            began: flight.began,
            submitted: flight.submitted,
            record: flight.record,
            before,
            batch_size: flight.jobs().count() as u32,
            stamps,
        };
        let refusal = match flight.fault {
            _ if given_up => Some(format!("the GPU was at it for {} s", PATIENCE.as_secs())),
            // Drawing it again would end the same way. What the driver has refused may be any buffer of ours: the device
            // is opened anew, with nothing but what is known to be whole.
            Some(text) if !self.gpu.is_lost() => Some(text),
            _ => None,
        };
        let _entered = flight.span.enter();
        for mut group in flight.groups {
            // Buffers of what never began would show an older frame.
            let read = if never_begun { None } else { group.read() };
            if let (Some(hook), Some(_)) = (&self.levels_hook, &read) {
                group.show_levels(hook);
            }
            let jobs = std::mem::take(&mut group.jobs);
            if group.is_given_up && read.is_some() {
                // Whether the lists were long enough for its maps is not known.
                group.spoil_maps();
                landed.given_up.extend(jobs);
                self.ring.give_back(group.landing);
                continue;
            }
            let Some(LandedGroup { frames, maps }) = read else {
                landed.lost = true;
                group.spoil_maps();
                match &refusal {
                    Some(text) => landed.refuse(jobs, &EngineError::Internal(text.clone())),
                    None => landed.again.extend(jobs),
                }
                continue;
            };
            match self.make_all_room(&group, &frames, &maps) {
                Room::Enough => self.hand_over(&mut landed, &times, &group, jobs, frames),
                Room::Made => landed.redraw.extend(jobs),
                Room::MadeIfAlone => {
                    jobs.iter().for_each(|job| job.set_alone());
                    landed.redraw.extend(jobs);
                }
                Room::MadeInThreePasses => {
                    jobs.iter().for_each(|job| job.take_three_passes());
                    landed.redraw.extend(jobs);
                }
                Room::None(error) => landed.refuse(jobs, &error),
            }
            self.ring.give_back(group.landing);
        }
        if let Some((landing, _)) = flight.stamps {
            self.ring.give_back(landing);
        }
        self.timers.push(flight.timer);
        landed.lost |= self.gpu.is_lost();
        landed
    }

    /// Waits until a submission has ended and its buffers are mapped. Returns whether it never began, and whether it was given up.
    fn finish(&self, flight: &InFlight) -> (bool, bool) {
        let mut waited = self.wait(flight, Some(&flight.index));
        let never_begun = matches!(waited, Err(wgpu::PollError::WrongSubmissionIndex(..)))
            || flight.fault.is_some();
        if never_begun {
            // A device that is gone says so once its queue is empty.
            waited = self.wait(flight, None);
        }
        let given_up = waited.is_err() && !self.gpu.is_lost();
        // The callbacks of mappings run within polls.
        let is_pending = || flight.groups.iter().any(|group| group.landing.is_pending());
        let mut tries = 0;
        while waited.is_ok() && is_pending() && tries < 1000 {
            if self.gpu.device.poll(wgpu::PollType::Poll).is_err() {
                break;
            }
            tries += 1;
        }
        (never_begun, given_up)
    }

    /// Grows the lists that were too short for a group that has landed, or for the shadow maps that it uses.
    fn make_all_room(
        &mut self,
        group: &FlyingGroup,
        frames: &[(FrameImage, GpuStats)],
        maps: &[GpuStats],
    ) -> Room {
        for stats in maps {
            let room = match self.over_limit(stats) {
                Some(error) => Room::None(error),
                None if stats.sums_full != 0 => Room::None(EngineError::Internal(
                    "too many splats over one pixel of a shadow map".to_owned(),
                )),
                None => self.make_room(group, stats, 1),
            };
            if !matches!(room, Room::Enough) {
                group.spoil_maps();
                return room;
            }
        }
        if group.has_spoiled_maps() {
            group.spoil_maps();
            return Room::Made;
        }
        if let Some(shadows) = &group.shadows {
            shadows.set.soundness.settle();
        }
        let Some((_, stats)) = frames.first() else { return Room::Enough };
        self.make_room(group, stats, group.views)
    }

    /// Grows the lists that were too short for `views` views of a group.
    fn make_room(&mut self, group: &FlyingGroup, stats: &GpuStats, views: usize) -> Room {
        let too_many = |what, found, limit| {
            Room::None(EngineError::OverLimit {
                what,
                found: u64::from(found),
                limit: u64::from(limit),
                parameter: None,
            })
        };
        let (wanted, longest) = (stats.entries_wanted, stats.large_longest);
        if wanted > group.entry_capacity {
            self.scratch.grow_entries(&self.gpu, wanted);
            let limit = self.scratch.entry_capacity();
            if limit >= wanted {
                return Room::Made;
            }
            return too_many("chunks of point trees in view", wanted, limit);
        }
        if longest > group.large_capacity {
            self.scratch.grow_large(&self.gpu, longest);
            let limit = self.scratch.large_capacity();
            return match views {
                _ if limit >= longest => Room::Made,
                0 | 1 => too_many("large triangles and splats in view", longest, limit),
                _ => Room::MadeIfAlone,
            };
        }
        if stats.paint_cut != 0 {
            return match self.scratch.grow_paint_launches(group.paint_launches) {
                true => Room::Made,
                false => Room::MadeInThreePasses,
            };
        }
        if stats.splats_wanted > group.paint_capacity {
            if stats.splats_wanted == u32::MAX {
                return Room::MadeInThreePasses;
            }
            self.scratch.grow_painted(&self.gpu, stats.splats_wanted);
            return match self.scratch.paint_capacity() >= stats.splats_wanted {
                true => Room::Made,
                false => Room::MadeInThreePasses,
            };
        }
        if stats.walk_cut != 0 {
            if self.scratch.grow_walk(group.walk_stride) {
                return Room::Made;
            }
            let text = "a list of large triangles or splats took too many rounds";
            return Room::None(EngineError::Internal(text.to_owned()));
        }
        Room::Enough
    }

    /// Sorts the frames of a group that has landed whole.
    fn hand_over(
        &self,
        landed: &mut Landed,
        times: &Times,
        group: &FlyingGroup,
        jobs: Vec<Arc<FrameJob>>,
        frames: Vec<(FrameImage, GpuStats)>,
    ) {
        let now = Instant::now();
        let (pass_ns, gpu_ns) = self.durations(&group.spans, times.stamps.as_deref());
        tell_passes(&jobs, &pass_ns);
        let since = now - times.submitted;
        let rest = since.saturating_sub(Duration::from_nanos(gpu_ns.unwrap_or(0)));
        let device_wait = times.before.saturating_duration_since(times.submitted).min(rest);
        let views = frames.len() as u32;
        let shadows = group.shadows.as_ref();
        let draws_new_maps = shadows.is_none_or(Shadows::are_those_of_a_new_pose);
        for (job, (image, stats)) in jobs.into_iter().zip(frames) {
            if stats.sums_full != 0 {
                job.lighten();
                landed.redraw.push(job);
            } else if let Some(error) = self.over_limit(&stats) {
                landed.failed.push((job, error));
            } else {
                landed.drawn.push(Drawn {
                    queue: times.began.saturating_duration_since(job.enqueued),
                    record: times.record,
                    device_wait,
                    readback: rest - device_wait,
                    job,
                    image,
                    stats,
                    pass_ns: pass_ns.clone(),
                    gpu_ns,
                    draws_new_maps,
                    batch_size: times.batch_size,
                    views,
                    gpu_bytes: group.gpu_bytes,
                    landed: now,
                });
            }
        }
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
            parameter: None,
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
        let (mut first, mut last, mut is_whole) = (u64::MAX, 0, true);
        for span in spans {
            is_whole &= span.span.is_some();
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
        // A frame of more passes than there are stamps has no time.
        (passes, (is_whole && last >= first).then(|| ns(last - first)).flatten())
    }
}

/// Tells what each pass of frames that were drawn together took.
fn tell_passes(jobs: &[Arc<FrameJob>], pass_ns: &[(Pass, Option<u64>)]) {
    for (pass, gpu_ns) in pass_ns {
        let (name, views, frames) = (pass.name(), jobs.len(), Names(jobs));
        tracing::debug!(pass = name, gpu_ns, views, %frames, "drawn");
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
