//! Effects that the renderer and the oracle draw alike.

/// Samples as discs that face the image plane, each at its own depth. Of the two diameters the larger one in the image counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discs {
    pub diameter_px: f32,
    /// In scene units; the discs shrink with distance.
    pub diameter: f32,
}

/// Eye-dome lighting (Boucheny 2009, §4): depths of neighbouring pixels darken what lies behind them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeDome {
    pub strength: f32,
    /// Distance of the neighbours, in pixels.
    pub radius_px: f32,
}
