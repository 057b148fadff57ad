//! The receipt that comes with every frame.

use serde::Serialize;
use utoipa::ToSchema;

use crate::plan::planner::PlanReceipt;
use crate::plan::{
    FramePlan, Pass, PlannedPass, PlannedSpecialisation, Specialisation, UsedSettings,
};
use crate::scene::fields::{SceneField, class_color, class_name};
use crate::scene::recolor::{ColorMap, Recolor};

/// Fewer pixels than this are easily overlooked.
const FEW_PIXELS: u64 = 20;
/// A share of the light that is one step of a byte.
const LITTLE_LIGHT: f32 = 1.0 / 255.0;

/// The request as understood, the work that was done, and its cost. Times and counts that the adapter cannot
/// give are `null`, never invented.
#[derive(Clone, Debug, Default, Serialize, ToSchema)]
pub struct Receipt {
    /// Id of the request, as in `X-Request-Id`: by it logs tell how the frame was made. For one of several frames of a request
    /// with its number, as in `4bf92f35/7`.
    pub request_id: String,
    pub scene: String,
    pub revision: u64,
    pub adapter: String,
    /// Frames that shared this one's submission, this one included.
    pub batch_size: u32,
    /// Frames of the same scene, size and output that the same dispatches drew, this one included: the times of passes are
    /// those of all of them.
    pub views: u32,
    pub camera: CameraReceipt,
    pub settings: UsedSettings,
    /// Error that the request accepts, in pixels.
    #[serde(rename = "max_error_px")]
    pub accepted_px: Option<f64>,
    /// How settings were chosen for a time budget or a least PSNR; `null` where neither was asked for.
    pub planned: Option<PlanReceipt>,
    /// Meaning of the colours, where they show values.
    pub legend: Option<Legend>,
    /// Passes that ran, in the order in which they first did, then those that were skipped.
    pub passes: Vec<PassReceipt>,
    /// Effects without a pass of their own: whether passes have them.
    pub specialisations: Vec<SpecialisationReceipt>,
    /// Why the image shows nothing but the background, and what to do about it; `null` where something is seen.
    pub nothing_visible: Option<String>,
    /// From the first pass's begin to the last one's end.
    pub gpu_ns: Option<u64>,
    pub queue_ns: u64,
    /// CPU time from a job leaving the queue to its submission, shared by the batch.
    pub record_ns: u64,
    /// From submission to the GPU being through with what was submitted before.
    pub device_wait_ns: u64,
    /// From then on to the pixels being in host memory, less `gpu_ns` where that is known. Other frames of the batch that
    /// were drawn before count here.
    pub readback_ns: u64,
    /// From the pixels being in host memory to an encoder taking them up.
    pub encode_wait_ns: u64,
    pub encode_ns: u64,
    pub total_ns: u64,
    pub samples: SampleCounts,
    pub splats: SplatCounts,
    /// Triangles that reached the visibility passes, `null` when none were tested.
    pub triangles: TriangleCounts,
    /// Segments of lines that reached the visibility passes, `null` when none were tested.
    pub segments: SegmentCounts,
    pub instances: InstanceCounts,
    /// Bytes this scene holds on the GPU.
    pub gpu_bytes: u64,
    /// Nearest and farthest distance in a 16-bit depth image, in scene units: what its values 65535 and 1 stand for.
    pub depth_range: Option<[f32; 2]>,
    /// How translucent surfaces were drawn; `null` where the scene has none, and for outputs other than color.
    pub translucent: Option<TranslucentReceipt>,
    /// Pixels that pull-push has filled; `null` where samples are drawn otherwise.
    pub holes_filled: Option<u64>,
    /// Size of the encoded image.
    pub bytes: u64,
    /// True when an identical request already in flight supplied the frame.
    pub coalesced: bool,
}

impl Receipt {
    /// Warnings for a person who looks at the frame: why little or nothing can be seen, why the goal of the request is not promised or
    /// was not kept, and which surfaces may be missing.
    pub fn warnings(&self) -> Vec<String> {
        let planned = self.planned.as_ref().and_then(PlanReceipt::warning);
        [self.hardly_visible(), planned, self.left_out()].into_iter().flatten().collect()
    }

    /// Why little or nothing can be seen, where that is so.
    fn hardly_visible(&self) -> Option<String> {
        if let Some(why) = &self.nothing_visible {
            return Some(format!("nothing is visible: {why}"));
        }
        let pixels = u64::from(self.camera.width) * u64::from(self.camera.height);
        let drawn = self
            .samples
            .drawn
            .filter(|_| self.triangles.stored == 0 && self.segments.stored == 0)?;
        let is_little = drawn < FEW_PIXELS && drawn * FEW_PIXELS * FEW_PIXELS < pixels;
        is_little.then(|| {
            let pixels =
                if drawn == 1 { "pixel of the image shows" } else { "pixels of the image show" };
            format!("hardly anything is visible: {drawn} {pixels} samples")
        })
    }

    /// A warning that surfaces may be missing behind the translucent ones that are kept, where a pixel may differ by more than [`LITTLE_LIGHT`].
    fn left_out(&self) -> Option<String> {
        let TranslucentReceipt { layers, most_left_out, .. } =
            self.translucent.filter(|drawn| drawn.most_left_out > LITTLE_LIGHT)?;
        let percent = 100.0 * most_left_out;
        Some(format!(
            "pixels may lack translucent surfaces behind their nearest {layers}, which let up to {percent:.1} % of the light pass"
        ))
    }

    /// `gpu_ns`, divided equally among the frames that were drawn together.
    pub fn gpu_share_ns(&self) -> Option<u64> {
        self.gpu_ns.map(|ns| ns / u64::from(self.views.max(1)))
    }

    /// [`Self::gpu_share_ns`] without the shadow maps: the next frame from the same pose uses them again.
    pub fn gpu_share_without_maps_ns(&self) -> Option<u64> {
        let maps = self.passes.iter().filter(|pass| pass.name == Pass::ShadowMap.name());
        let maps: u64 = maps.filter_map(|pass| pass.gpu_ns).sum();
        self.gpu_ns.map(|ns| ns.saturating_sub(maps) / u64::from(self.views.max(1)))
    }
}

/// The pose as understood.
#[derive(Clone, Debug, Default, Serialize, ToSchema)]
pub struct CameraReceipt {
    pub eye: [f64; 3],
    pub target: [f64; 3],
    pub up: [f64; 3],
    /// Vertical field of view, of a perspective.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<f64>,
    /// Height of the view in scene units, of an orthographic projection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ortho_height: Option<f64>,
    pub width: u32,
    pub height: u32,
}

/// A pass that ran, or why it did not.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PassReceipt {
    #[schema(value_type = Pass)]
    pub name: &'static str,
    pub ran: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu_ns: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

impl PassReceipt {
    /// The passes that were recorded, in that order, each with its time; then those that `plan` skips, with the reasons.
    pub fn list(plan: &FramePlan, recorded: &[(Pass, Option<u64>)]) -> Vec<PassReceipt> {
        let ran = recorded.iter().map(|&(pass, gpu_ns)| PassReceipt {
            name: pass.name(),
            ran: true,
            gpu_ns,
            why: None,
        });
        let skipped = plan.passes.iter().filter_map(|planned| {
            let why = Some(planned.skipped?.to_owned());
            Some(PassReceipt { name: planned.pass.name(), ran: false, gpu_ns: None, why })
        });
        let is_idle = |planned: &&PlannedPass| {
            planned.skipped.is_none() && !recorded.iter().any(|(pass, _)| *pass == planned.pass)
        };
        let idle = plan.passes.iter().filter(is_idle).map(|planned| PassReceipt {
            name: planned.pass.name(),
            ran: false,
            gpu_ns: None,
            why: Some(match planned.pass {
                Pass::ShadowMap => "the maps of an earlier frame are used again".to_owned(),
                _ => "the scene has nothing that it draws".to_owned(),
            }),
        });
        ran.chain(skipped).chain(idle).collect()
    }
}

/// An effect that passes have, or why they have not.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SpecialisationReceipt {
    pub name: Specialisation,
    pub ran: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<&'static str>,
}

impl SpecialisationReceipt {
    pub fn list(plan: &FramePlan) -> Vec<SpecialisationReceipt> {
        let line = |planned: &PlannedSpecialisation| SpecialisationReceipt {
            name: planned.specialisation,
            ran: planned.skipped.is_none(),
            why: planned.skipped,
        };
        plan.specialisations.iter().map(line).collect()
    }
}

/// Meaning of the colours of a colour map, or of classes.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Legend {
    /// The value that colours show: `height`, or the name of a scalar field.
    pub of: String,
    /// Values of the first and the last colour: heights in scene units, values of a field as in the file.
    pub least: f64,
    pub most: f64,
    /// Colours at equal distances from the first value to the last, as `#rrggbb`; none for classes.
    pub colors: Vec<String>,
    /// The classes of the scene, each with its own colour.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub classes: Vec<LegendClass>,
}

/// The colour of a class.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LegendClass {
    pub class: u8,
    /// Name of an ASPRS standard class; `null` for others.
    pub name: Option<&'static str>,
    /// As `#rrggbb`.
    pub color: String,
}

impl Legend {
    /// `None` for colours that stand for no value; `fields` are those of the scene.
    pub fn of(recolor: &Recolor, fields: &[SceneField]) -> Option<Legend> {
        let hex = |[r, g, b]: [u8; 3]| format!("#{r:02x}{g:02x}{b:02x}");
        let mapped = |of: String, [least, most]: [f64; 2], map: ColorMap| {
            let colors = map.colors().iter().copied().map(hex).collect();
            Legend { of, least, most, colors, classes: Vec::new() }
        };
        match *recolor {
            Recolor::Normal | Recolor::Instance => None,
            Recolor::Height { range, map, .. } => Some(mapped("height".to_owned(), range, map)),
            Recolor::Field { name, range, map, has_classes: false } => {
                Some(mapped(name.to_string(), range, map))
            }
            Recolor::Field { name, .. } => {
                let field = fields.iter().find(|field| field.name == name.as_str())?;
                let class = |&class: &u8| LegendClass {
                    class,
                    name: class_name(class),
                    color: hex(class_color(class)),
                };
                let classes = field.classes.iter().flatten().map(class).collect();
                let (least, most) = (field.least, field.most);
                Some(Legend { of: name.to_string(), least, most, colors: Vec::new(), classes })
            }
        }
    }
}

/// The order of translucent surfaces, and what is missing of them.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub struct TranslucentReceipt {
    pub order: TranslucentOrder,
    /// Nearest surfaces of a pixel that are kept; those behind them are left out.
    pub layers: u32,
    /// Most surfaces of a pixel, of those that are kept.
    pub deepest: u32,
    /// Pixels with as many surfaces as are kept, through all of which one sees: further ones may be missing. With antialiasing, parts of
    /// pixels.
    pub pixels_of_all_layers: u64,
    /// Largest share of the light from behind that passes all surfaces of such a pixel in any channel, 0 to 1; 0 without such pixels. If colours are at
    /// most 1, no linear colour channel differs by more than this share, or by more than 1/512, from a frame with all surfaces composited in order.
    pub most_left_out: f32,
}

/// How the order of translucent surfaces was found.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TranslucentOrder {
    /// Each pixel's surfaces were sorted by depth: the order is right where surfaces cross as well.
    PixelDepth,
}

#[derive(Clone, Copy, Debug, Default, Serialize, ToSchema)]
pub struct SampleCounts {
    /// In the scene, instances counted.
    pub stored: u64,
    /// In chunks that met the frustum and, of point trees, the accepted error, and were not hidden by what is nearer; each was projected.
    pub tested: Option<u64>,
    /// Nodes of point trees that the accepted error asked for, and that lie in the image; `null` at full detail.
    pub accepted: Option<u64>,
    /// Pixels that show a sample; a pixel counts once for each translucent sample that it keeps.
    pub drawn: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize, ToSchema)]
pub struct SplatCounts {
    /// Splats that reach the camera plane, and so are cut there. The other two numbers count them as well.
    pub clipped: Option<u64>,
    /// Splats drawn by `walk_splats` and `blend_walked`: large ones, and those that reach the camera plane.
    pub rasterised: Option<u64>,
    /// Splats drawn by one thread each.
    pub scattered: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize, ToSchema)]
pub struct TriangleCounts {
    pub stored: u64,
    /// In parts of chunks that met the frustum and were not hidden by what is nearer.
    pub tested: Option<u64>,
    /// Triangles drawn by `rasterise_triangles` or `walk_triangles`: large ones, and those that meet the camera plane.
    pub rasterised: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize, ToSchema)]
pub struct SegmentCounts {
    pub stored: u64,
    /// In parts of chunks that met the frustum and were not hidden by what is nearer.
    pub tested: Option<u64>,
    /// Segments drawn by `walk_lines`: large ones, and those that meet the camera plane.
    pub listed: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize, ToSchema)]
pub struct InstanceCounts {
    pub stored: u64,
    pub drawn: Option<u64>,
}
