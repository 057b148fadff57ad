//! Turns a pose into a frame request: as asked for, or cheaper while the pose moves. Pure.
//!
//! A moving frame is smaller, has no depth of field, is a JPEG where a browser would show one, and has less detail with `lod=spt`. The cost of such a
//! frame depends little on its pixels once they are few, and much on the accepted error.

use std::time::Instant;

use super::pacing::Pace;
use super::wire::Quality;
use crate::encode::ImageFormat;
use crate::engine::{FrameRequest, MovingFrame, PlannedFrame};
use crate::http::params::FrameParams;
use crate::http::problem::Problem;
use crate::plan::{MaxError, Output, Settings, scaled_size};

/// Shortest side of a moving frame.
const LEAST_SIDE: u32 = 64;
/// Largest error of a moving frame in its own pixels, unless a larger one was asked for.
const MOST_ERROR_PX: f32 = 4.0;

/// A frame to request.
pub struct Wanted {
    pub request: FrameRequest,
    pub quality: Quality,
    /// Width and height as a share of the requested size.
    pub scale: f64,
    /// How size and settings were chosen, where measurements tell.
    pub planned: Option<PlannedFrame>,
}

/// Fields of a frame's header that say how it was made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Made {
    pub format: ImageFormat,
    /// JPEG quality, for a JPEG.
    pub jpeg_quality: Option<u8>,
    /// Accepted error, with `lod=spt`.
    pub accepted_px: Option<f32>,
}

impl Made {
    pub fn of(request: &FrameRequest) -> Made {
        let settings = &request.settings;
        Made {
            format: request.format,
            jpeg_quality: (request.format == ImageFormat::Jpeg).then_some(request.quality),
            accepted_px: settings.accepted_px_of_trees(),
        }
    }
}

/// Builds the frame that a pose asks for. Colours are sent as JPEG where no format is given.
///
/// # Errors
/// Names the parameters that cannot be used.
pub fn still_request(id: &str, params: &FrameParams) -> Result<FrameRequest, Problem> {
    let format = match (params.format()?, params.output()?) {
        (Some(format), _) => format,
        (None, Output::Color) => ImageFormat::Jpeg,
        (None, _) => ImageFormat::Png,
    };
    let request = params.request(id, format, Instant::now())?;
    // Decided here, because moving and still frames are told apart by what antialiasing and blur do.
    Ok(request.with_antialias_decided().with_blur_decided())
}

/// Chooses settings and size of a moving frame where that is possible, from a request with a goal and the size of the still frame, the settings of the still
/// frame, and the range of scales.
pub type Plan<'a> = &'a dyn Fn(&FrameRequest, &Settings, [f64; 2]) -> Option<MovingFrame>;

/// Builds a frame of the given quality. A moving frame that comes out as good as requested counts as still. Without a plan, moving frames are
/// paced by time alone.
///
/// # Errors
/// As [`still_request`].
pub fn wanted(
    id: &str,
    params: &FrameParams,
    quality: Quality,
    pace: Pace,
    plan: Option<Plan<'_>>,
) -> Result<Wanted, Problem> {
    let still = still_request(id, params)?;
    if quality == Quality::Still {
        return Ok(Wanted { request: still, quality, scale: 1.0, planned: None });
    }
    let least = (f64::from(LEAST_SIDE) / f64::from(still.width.min(still.height))).min(1.0);
    let chosen = match plan {
        Some(plan) => {
            let settings = params.settings.moving_within(pace.draw_ms);
            let mut whole = still_request(id, &FrameParams { settings, ..params.clone() })?;
            whole.settings = whole.settings.without_blur();
            plan(&whole, &still.settings, [least, pace.link_scale.max(least)])
        }
        None => None,
    };
    let is_planned = chosen.is_some();
    let (mut request, planned) = match chosen {
        Some(MovingFrame { settings, size, planned }) => {
            let request = sized(id, params, size)?;
            (FrameRequest { settings, ..request }, Some(planned))
        }
        None => (paced(id, params, &still, pace.scale.max(least), pace.coarseness)?, None),
    };
    // A client that asked for a format that browsers show can show a JPEG. For other formats this is unknown.
    let shown = matches!(request.format, ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Webp);
    if shown && request.output == Output::Color {
        let most = if request.format == ImageFormat::Jpeg { request.quality } else { 100 };
        request.format = ImageFormat::Jpeg;
        request.quality = pace.jpeg_quality.min(most);
    }
    let facts = |request: &FrameRequest| {
        let settings = &request.settings;
        let sampling = (settings.parts(), settings.exposures());
        (request.width, request.height, sampling, Made::of(request))
    };
    let is_as_asked = !is_planned && facts(&request) == facts(&still);
    let quality = if is_as_asked { Quality::Still } else { Quality::Moving };
    let scale = f64::from(request.width) / f64::from(still.width);
    Ok(Wanted { request, quality, scale, planned })
}

/// The still frame in another size.
fn sized(id: &str, params: &FrameParams, [w, h]: [u32; 2]) -> Result<FrameRequest, Problem> {
    still_request(id, &FrameParams { w: Some(w), h: Some(h), ..params.clone() })
}

/// Builds a moving frame for which the planner chose nothing.
fn paced(
    id: &str,
    params: &FrameParams,
    still: &FrameRequest,
    scale: f64,
    coarseness: f64,
) -> Result<FrameRequest, Problem> {
    // A part of a larger image has its size from the place that it takes there.
    let scale = if still.settings.is_part() { 1.0 } else { scale.min(1.0) };
    let mut request = sized(id, params, scaled_size([still.width, still.height], scale))?;
    // The choice is made for the still frame that follows, so that points do not turn into splats when the pose stops.
    let frame = still.settings.still_frame(still.height);
    request.settings.stand_in_for(frame, moving_error(frame.max_error, coarseness));
    Ok(request)
}

/// Returns the error that a moving frame may have. Frames of full detail ignore it.
fn moving_error(asked: MaxError, coarseness: f64) -> MaxError {
    let px = asked.px() * coarseness as f32;
    MaxError::new(px.min(MOST_ERROR_PX.max(asked.px()))).unwrap_or(asked)
}

#[cfg(test)]
mod tests;
