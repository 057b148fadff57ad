//! How large frames may be, with all parts of their pixels and all of their exposures.

use super::state::EngineState;
use super::{EngineError, FrameRequest};
use crate::passes::EXPOSED_BYTES;
use crate::plan::Settings;

/// How many times as many pixels as the largest frame all exposures of a frame may have.
const MOST_TIMES: u64 = 16;

/// Most pixels and longest side of a frame on this adapter.
pub fn frame_limits(state: &EngineState) -> (u64, u32) {
    let adapter = state.adapter();
    // The visibility buffer has eight bytes a pixel and is bound whole.
    (
        state.config.max_pixels.min(adapter.max_binding_bytes / 8),
        state.config.max_side.min(adapter.max_side),
    )
}

/// Most pixels of all exposures of a frame on this adapter.
pub fn exposures_limit(state: &EngineState) -> u64 {
    frame_limits(state).0 * MOST_TIMES
}

/// Columns and rows of the image whose parts are averaged.
pub fn drawn_size(request: &FrameRequest) -> (u32, u32) {
    let parts = request.settings.parts();
    (request.width * parts, request.height * parts)
}

/// Checks that a frame is within the limits of sizes.
///
/// # Errors
/// A side of no pixels, or too many pixels, also of all exposures together.
pub fn check_size(state: &EngineState, request: &FrameRequest) -> Result<(), EngineError> {
    let (mut max_pixels, mut max_side) = frame_limits(state);
    let parts = request.settings.parts();
    max_pixels /= u64::from(parts * parts);
    max_side /= parts;
    for (parameter, value) in [("w", request.width), ("h", request.height)] {
        if value == 0 {
            return Err(EngineError::BadParameter {
                parameter,
                reason: "a frame has at least one pixel".to_owned(),
                accepted: format!("1 to {max_side}"),
            });
        }
        if value > max_side {
            return Err(EngineError::OverLimit {
                what: match (parameter, parts) {
                    ("w", 1) => "pixels in w",
                    ("h", 1) => "pixels in h",
                    ("w", _) => "pixels in w with antialiasing",
                    _ => "pixels in h with antialiasing",
                },
                found: u64::from(value),
                limit: u64::from(max_side),
                parameter: Some(parameter),
            });
        }
    }
    let found = u64::from(request.width) * u64::from(request.height);
    if found > max_pixels {
        let what = if parts > 1 {
            "pixels with antialiasing"
        } else if found > state.config.max_pixels {
            "pixels"
        } else {
            "pixels that this adapter binds at once, which no setting raises"
        };
        let parameter = (parts > 1).then_some("antialias");
        return Err(EngineError::OverLimit { what, found, limit: max_pixels, parameter });
    }
    check_exposures(state, request, found)
}

/// Checks that a frame of `pixels` pixels has room for the sums of its exposures, and that they do not take too long.
fn check_exposures(
    state: &EngineState,
    request: &FrameRequest,
    pixels: u64,
) -> Result<(), EngineError> {
    let settings = &request.settings;
    if !settings.is_blurred() {
        return Ok(());
    }
    let over = |what, found, limit| {
        let parameter = Some(Settings::EXPOSURES);
        Err(EngineError::OverLimit { what, found, limit, parameter })
    };
    let bound = state.adapter().max_binding_bytes / EXPOSED_BYTES;
    if pixels > bound {
        return over("pixels of a frame with exposures, which no setting raises", pixels, bound);
    }
    let parts = u64::from(settings.parts());
    let all = pixels * parts * parts * u64::from(settings.exposures());
    let limit = exposures_limit(state);
    if all > limit {
        return over("pixels of all exposures", all, limit);
    }
    Ok(())
}
