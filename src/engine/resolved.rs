//! Resolved frames: requests after every check and every decision.
//!
//! ```text
//! FrameRequest ──resolve──▶ ResolvedFrame ──▶ queue ──▶ render thread ──▶ receipt
//!                    └────▶ UnbakedFrame ──bake──▶ ResolvedFrame
//! ```
//! [`super::Engine::resolve`] looks the scene up once. The frame keeps that revision of it: the entity tag, the queue, the render thread
//! and the receipt all read the same value, and none of them asks the library again.

use std::sync::Arc;

use super::FrameRequest;
use super::loaded::Loaded;
use super::planner::PlannedFrame;
use super::queue::cost::CostKey;
use super::receipt::CameraReceipt;
use super::viewpoint::whole_size;
use crate::math::{Bounds, View};
use crate::plan::auto::Choice;
use crate::plan::shadow::light_views;
use crate::plan::{
    AdapterFacts, Background, FrameFacts, FramePlan, Given, Output, Pass, Reconstruction,
    SceneFacts, Settings, Shadows, Specialisation, plan,
};
use crate::residency::model::{Extent, SceneModel};
use crate::scene::clipping::ClipRegion;
use crate::scene::recolor::Recolor;
use crate::scene::{Fog, Light, Splats, Tone};

/// A checked request, with everything that was decided for it.
#[derive(Clone)]
pub struct ResolvedFrame {
    pub request: FrameRequest,
    pub(super) scene: Arc<Loaded>,
    pub(super) model: Arc<SceneModel>,
    /// The view of the frame, and of its outputs other than blurred colours.
    pub(super) view: View,
    /// Views of the exposures whose mean the frame is; none for a single exposure.
    pub(super) exposures: Arc<[View]>,
    pub(super) camera: CameraReceipt,
    pub(super) extent: Extent,
    pub(super) drawing: Drawing,
    /// Reason why the frame will change in a while, with the progress towards that.
    pub(super) provisional: Option<String>,
    /// How samples are drawn where the request left that open, and why.
    pub(super) auto: Option<Choice>,
    /// How settings were chosen, where the request has a goal.
    pub(super) planned: Option<PlannedFrame>,
    /// Reason why a frame with `lod=spt` is drawn at full detail.
    pub(super) full_because: Option<String>,
    /// The drawing for splats that overflow a single pass.
    pub(super) in_three_passes: Option<Drawing>,
    /// Key that is equal for requests whose frames are equal to the byte.
    pub(super) key: String,
    pub(super) cost_key: CostKey,
    /// Name of the adapter that the frame was resolved for.
    pub(super) adapter: String,
    /// Pixels that are picked: column and row. If there are any, the frame has their identities in place of its image.
    pub(super) picks: Arc<[[u32; 2]]>,
}

/// One way to draw a frame. Passes take all settings from here, so that equal drawings are drawn alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    pub plan: FramePlan,
    /// Settings that affect the frame, with what the scene adds to them.
    pub applied: Given,
    /// `applied`, with how samples are drawn, and with defaults for all others: frames that are drawn alike have equal settings.
    pub settings: Settings,
    /// Reason for not drawing as requested.
    pub instead_because: Option<&'static str>,
    /// How samples are drawn.
    pub reconstruction: Reconstruction,
    /// Value that colours surfaces in place of their own colours.
    pub recolor: Option<Recolor>,
    pub clip: Option<ClipRegion>,
    /// The frames of depths that lights see, where they cast shadows.
    pub shadows: Option<ShadowFrames>,
}

/// How shadow maps are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowFrames {
    /// Views of the maps of all lights that cast shadows; see [`light_views`].
    pub views: Vec<View>,
    pub plan: FramePlan,
    pub reconstruction: Reconstruction,
}

impl ResolvedFrame {
    /// Returns the strong entity tag (quoted): a hash of all that decides the frame's bytes.
    pub fn etag(&self) -> &str {
        &self.key
    }

    /// Returns the entity tag; `None` for a frame that will change once normals and kernels are estimated.
    pub fn final_etag(&self) -> Option<&str> {
        self.provisional.is_none().then_some(&self.key)
    }

    /// Returns the pixels of the whole image that the frame is a part of, or of the frame, times their parts and exposures.
    pub fn pixels_in_all(&self) -> u64 {
        let (width, height) = whole_size(&self.request);
        let (parts, exposures) = (self.drawing.settings.parts(), self.exposures.len().max(1));
        [width, height, parts, parts, exposures as u32].map(u64::from).iter().product()
    }

    /// Returns the camera from which the frame is seen.
    pub fn camera(&self) -> &CameraReceipt {
        &self.camera
    }

    /// Returns the name of the adapter that the entity tag is for.
    pub fn adapter(&self) -> &str {
        &self.adapter
    }

    /// Returns the settings of the frame, with nothing left open.
    pub fn settings(&self) -> &Settings {
        &self.drawing.settings
    }

    /// Returns the settings that affect the frame, as its receipt has them unless splats overflow a single pass.
    pub fn applied(&self) -> &Given {
        &self.drawing.applied
    }

    pub fn plan(&self) -> &FramePlan {
        &self.drawing.plan
    }
}

impl Drawing {
    /// Decides how an output of a scene is drawn. `reconstruction` and `settings` belong together; `recolor` finds the value that colours
    /// surfaces.
    pub fn new(
        settings: &Settings,
        reconstruction: Reconstruction,
        (scene, adapter): (&SceneFacts, &AdapterFacts),
        output: Output,
        recolor: impl FnOnce(&Settings) -> Option<Recolor>,
        clip: Option<ClipRegion>,
    ) -> Drawing {
        let settled = settings.settled(&reconstruction);
        let applied = settled.affecting(scene, output);
        // Without samples it has no effect how they are drawn, but the other frames of a film draw them likewise.
        let settings = Settings::from(applied).drawn_like(&settled);
        let (edl, is_averaged) = (settings.eye_dome(), settings.parts() > 1);
        let is_exposed = settings.is_blurred();
        let frame = FrameFacts {
            output,
            reconstruction,
            edl,
            shadows: settings.shadows,
            environment: settings.environment,
            has_background: settings.background.is_some(),
            fog: settings.fog,
            occlusion: settings.ao,
            is_toned: settings.tone().is_some(),
            is_averaged,
            is_exposed,
        };
        Drawing {
            applied,
            settings,
            plan: plan(scene, &frame, adapter),
            instead_because: None,
            reconstruction,
            recolor: recolor(&settings),
            clip,
            shadows: None,
        }
    }

    /// The drawing with its shadow maps, where the plan has any: `lights` and `splats` are those of the scene, `bounds` hold all of it, and `seen` are the views of
    /// the frame and its exposures, or of the image that they are parts of.
    #[must_use]
    pub fn with_shadows(
        self,
        (lights, splats, bounds): (&[Light], &Splats, &Bounds),
        seen: &[View],
        (scene, adapter): (&SceneFacts, &AdapterFacts),
    ) -> Drawing {
        if !self.plan.runs(Pass::ShadowMap) {
            return self;
        }
        let views = light_views(lights, bounds, seen, self.settings.shadow_px.get());
        // Lights see closed surfaces, whatever the frame draws samples as.
        let reconstruction = Reconstruction::new(&Settings::exact(), splats);
        let frame = FrameFacts {
            output: Output::Depth,
            reconstruction,
            shadows: Shadows::Off,
            ..FrameFacts::default()
        };
        let plan = plan(scene, &frame, adapter);
        Drawing { shadows: Some(ShadowFrames { views, plan, reconstruction }), ..self }
    }

    /// The fog that surfaces are seen through.
    pub fn fog(&self, model: &SceneModel) -> Option<Fog> {
        model.fog.filter(|_| self.plan.draws(Specialisation::Fog))
    }

    /// How light becomes colours; `None` where colours are the light.
    pub fn tone(&self) -> Option<Tone> {
        self.settings.tone().filter(|_| self.plan.draws(Specialisation::Tone))
    }

    /// Linear RGB and straight alpha of pixels that show nothing. Fog that is as dense everywhere hides what is infinitely far away; the background keeps its
    /// alpha.
    pub fn background(&self, model: &SceneModel) -> [f32; 4] {
        let own = self.settings.background.map_or(model.background, Background::linear);
        match self.fog(model) {
            Some(Fog { color: [r, g, b], layer: None, .. }) if own[3] > 0.0 => [r, g, b, own[3]],
            _ => own,
        }
    }
}

#[cfg(test)]
mod tests;
