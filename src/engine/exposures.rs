//! Frames that are means of several exposures: where the exposures are seen from, and what they count together.

use std::sync::Arc;

use glam::DVec2;

use super::loaded::Loaded;
use super::viewpoint::{shown_part, view_of};
use super::{EngineError, FrameRequest, Pose};
use crate::math::{Exposure, MOST_EXPOSURES, View, exposures};
use crate::plan::{MOST_WHOLE_PX, Settings};
use crate::residency::layout::GpuStats;

/// The exposures of a frame.
#[derive(Default)]
pub struct Exposed {
    /// Their views, in the order of their times; none for a single exposure.
    pub views: Arc<[View]>,
    /// Those of the image that the frame is a part of, or the same.
    pub whole: Vec<View>,
    /// Distance of the plane of focus in scene units, where there is a lens.
    pub focus: Option<f64>,
}

/// Returns the exposures of a frame. `whole` is its view, or that of the image that it is a part of.
///
/// # Errors
/// The camera has no lens, no plane of focus, or one that is too near for the lens, or a camera cannot be drawn.
pub fn exposed(
    loaded: &Loaded,
    request: &FrameRequest,
    whole: &View,
) -> Result<Exposed, EngineError> {
    let settings = &request.settings;
    if !settings.is_blurred() {
        return Ok(Exposed::default());
    }
    let lens = match settings.lens_diameter() {
        Some(diameter) => Some((diameter, focus(loaded, settings, diameter, whole)?)),
        None => None,
    };
    let count = settings.exposures().min(MOST_EXPOSURES);
    let parts = f64::from(settings.parts());
    let view = |(number, exposure): (usize, Exposure)| -> Result<View, EngineError> {
        let view: View = match &request.pose {
            Pose::Moving { exposed, .. } if !exposed.is_empty() => {
                let middle = view_of(&exposed[number * exposed.len() / count as usize], request)?.0;
                from_eye(loaded, settings, &middle)?.map_or(middle, |(view, _)| view)
            }
            _ => *whole,
        };
        let view = match lens {
            Some((diameter, focus)) => view.from_lens(0.5 * diameter * exposure.on_lens, focus),
            None => view,
        };
        // Parts of pixels are drawn as pixels.
        Ok(view.moved(exposure.in_pixel / parts))
    };
    let whole: Vec<View> = exposures(count).enumerate().map(view).collect::<Result<_, _>>()?;
    let shown = whole.iter().map(|view| shown_part(view, request));
    let views: Vec<View> = shown.collect::<Result<_, _>>()?;
    Ok(Exposed { views: views.into(), whole, focus: lens.map(|(_, focus)| focus) })
}

/// Distance of the plane of focus: the given one, that of the camera's target, or that of the middle of the scene.
fn focus(
    loaded: &Loaded,
    settings: &Settings,
    diameter: f64,
    whole: &View,
) -> Result<f64, EngineError> {
    let bad = |reason: String, accepted: String| EngineError::BadParameter {
        parameter: Settings::LENS,
        reason,
        accepted,
    };
    if whole.is_orthographic() {
        let reason = "the camera's rays are parallel, so that it has no lens".to_owned();
        return Err(bad(reason, "0, or a camera in perspective".to_owned()));
    }
    // As the receipt has it.
    let exact = |distance| settings.focused_at(distance).focus();
    let Some(focus) = plane(loaded, settings.focus(), whole).and_then(exact) else {
        return Err(no_plane(Settings::LENS, Settings::FOCUS, "what is sharp"));
    };
    let reach = shift_px(whole, 0.5 * diameter, focus);
    if reach > f64::from(MOST_WHOLE_PX) {
        let most = diameter * f64::from(MOST_WHOLE_PX) / reach;
        let reason = format!(
            "seen from the border of a lens of {diameter}, the image at a distance of {focus} lies {reach:.0} pixels beside the frame"
        );
        return Err(bad(reason, format!("at most {most:.3e} with this focus distance")));
    }
    Ok(focus)
}

/// Distance of the plane whose points keep their places in the image: the given one, that of the camera's target, or that of the middle of the scene.
fn plane(loaded: &Loaded, given: Option<f64>, whole: &View) -> Option<f64> {
    let own = || Some(whole.focus).filter(|&focus| focus > 0.0);
    let middle = || {
        let bounds = loaded.extent.bounds;
        let depth = -whole.to_view(0.5 * (bounds.min + bounds.max)).z;
        Some(depth).filter(|depth| depth.is_finite() && *depth > 0.0)
    };
    given.or_else(own).or_else(middle)
}

fn no_plane(parameter: &'static str, distance: &str, what: &str) -> EngineError {
    EngineError::BadParameter {
        parameter,
        reason: format!(
            "the view has no target, and the middle of the scene is not before the eye, so that `{distance}` must say {what}"
        ),
        accepted: format!("a value together with `{distance}`"),
    }
}

/// Pixels by which the image of what is infinitely far moves if the eye moves by `offset`, and what is `distance` away keeps its place.
fn shift_px(whole: &View, offset: f64, distance: f64) -> f64 {
    (offset.abs() * whole.focal_px / distance).max_element()
}

/// The view of one image of a stereo pair, with the distance of its plane, if the eye is shifted. Its axis is parallel to that of the unshifted eye, and its
/// frustum is skewed (L. F. Hodges, *Tutorial: Time-Multiplexed Stereoscopic Computer Graphics*, IEEE CG&A 12(2), 1992): nothing moves up or down.
///
/// # Errors
/// The camera has no distance at which both images agree, or one that is too near for the shift.
pub fn from_eye(
    loaded: &Loaded,
    settings: &Settings,
    whole: &View,
) -> Result<Option<(View, f64)>, EngineError> {
    let Some(offset) = settings.eye_shift() else { return Ok(None) };
    let bad = |reason: String, accepted: String| EngineError::BadParameter {
        parameter: Settings::EYE,
        reason,
        accepted,
    };
    if whole.is_orthographic() {
        let reason = "the camera's rays are parallel, so that both eyes would see the same";
        return Err(bad(reason.to_owned(), "0, or a camera in perspective".to_owned()));
    }
    // As the receipt has it.
    let exact = |distance| settings.stereo_from(distance).stereo_at();
    let Some(distance) = plane(loaded, settings.stereo_at(), whole).and_then(exact) else {
        return Err(no_plane(
            Settings::EYE,
            Settings::STEREO,
            "what both images show in one place",
        ));
    };
    let moved = shift_px(whole, offset, distance);
    if moved > f64::from(MOST_WHOLE_PX) {
        let most = offset.abs() * f64::from(MOST_WHOLE_PX) / moved;
        let reason = format!(
            "seen from {offset} beside, the image at a distance of {distance} lies {moved:.0} pixels beside the frame"
        );
        return Err(bad(
            reason,
            format!("at most {most:.3e} to either side with this stereo distance"),
        ));
    }
    Ok(Some((whole.from_lens(DVec2::new(offset, 0.0), distance), distance)))
}

/// Returns what exposures of one frame have counted: sums, and the largest where a count is compared with a limit for one exposure. Sums of 32 bits end
/// at their largest value.
pub fn counted(stats: &[GpuStats]) -> GpuStats {
    let Some((first, others)) = stats.split_first() else { return GpuStats::default() };
    others.iter().fold(*first, together)
}

fn together(a: GpuStats, b: &GpuStats) -> GpuStats {
    let wide = |a: [u32; 2], b: [u32; 2]| {
        let number = |words: [u32; 2]| u64::from(words[0]) | u64::from(words[1]) << 32;
        let sum = number(a).saturating_add(number(b));
        [sum as u32, (sum >> 32) as u32]
    };
    GpuStats {
        samples_tested: wide(a.samples_tested, b.samples_tested),
        triangles_tested: wide(a.triangles_tested, b.triangles_tested),
        segments_tested: wide(a.segments_tested, b.segments_tested),
        triangles_rasterised: a.triangles_rasterised.saturating_add(b.triangles_rasterised),
        pixels_of_samples: a.pixels_of_samples.saturating_add(b.pixels_of_samples),
        pixels_of_triangles: a.pixels_of_triangles.saturating_add(b.pixels_of_triangles),
        pixels_of_segments: a.pixels_of_segments.saturating_add(b.pixels_of_segments),
        pixels_filled: a.pixels_filled.saturating_add(b.pixels_filled),
        pixels_of_all_layers: a.pixels_of_all_layers.saturating_add(b.pixels_of_all_layers),
        splats_clipped: a.splats_clipped.saturating_add(b.splats_clipped),
        splats_listed: a.splats_listed.saturating_add(b.splats_listed),
        splats_scattered: a.splats_scattered.saturating_add(b.splats_scattered),
        segments_listed: a.segments_listed.saturating_add(b.segments_listed),
        nodes_drawn: a.nodes_drawn.saturating_add(b.nodes_drawn),
        instances_drawn: a.instances_drawn.max(b.instances_drawn),
        large_longest: a.large_longest.max(b.large_longest),
        large_units: a.large_units.max(b.large_units),
        large_wrapped: a.large_wrapped.max(b.large_wrapped),
        sums_full: a.sums_full.max(b.sums_full),
        entries_wanted: a.entries_wanted.max(b.entries_wanted),
        walk_cut: a.walk_cut.max(b.walk_cut),
        deepest: a.deepest.max(b.deepest),
        splats_wanted: a.splats_wanted.max(b.splats_wanted),
        paint_cut: a.paint_cut.max(b.paint_cut),
        // The bits of floats that are not negative are ordered as the floats are.
        passing_most: a.passing_most.max(b.passing_most),
        // Bounds serve one exposure alone.
        drawn_bounds: a.drawn_bounds,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_added_and_limits_are_those_of_the_worst_exposure() {
        let one = |number: u32| GpuStats {
            samples_tested: [u32::MAX, number],
            pixels_of_samples: number,
            large_longest: number,
            sums_full: number & 1,
            passing_most: number,
            ..GpuStats::default()
        };
        let all = counted(&[one(3), one(2), one(7)]);
        assert_eq!(all.samples_tested, [u32::MAX - 2, 14]);
        assert_eq!((all.pixels_of_samples, all.large_longest, all.sums_full), (12, 7, 1));
        assert_eq!(all.passing_most, 7);
        assert_eq!(counted(&[one(5)]), one(5));
        assert_eq!(counted(&[one(u32::MAX), one(1)]).pixels_of_samples, u32::MAX);
    }
}
