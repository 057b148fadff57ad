//! Effects that the renderer and the oracle draw alike.

/// Eye-dome lighting (Boucheny 2009, §4): depths of neighbouring pixels darken what lies behind them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeDome {
    pub strength: f32,
    /// Distance of the neighbours, in pixels.
    pub radius_px: f32,
}
