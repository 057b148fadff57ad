//! Frames through the engine, without a server.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use glam::{DQuat, DVec3};
use pointillist::encode::ImageFormat;
use pointillist::engine::{
    EncodedFrame, Engine, EngineConfig, FrameRequest, Pose, Receipt, SceneInfo,
};
use pointillist::math::Camera;
use pointillist::plan::{Output, Reconstruct, Settings};

/// A camera that turns about the vertical axis through its target, as the peer's does.
#[derive(Clone, Copy, Debug)]
pub struct Orbit {
    pub eye: DVec3,
    pub target: DVec3,
    pub fov_deg: f64,
}

/// Between two frames, so that none is like the one before it.
pub const STEP_DEG: f64 = 0.5;

impl Orbit {
    /// All of a scene in view, from the front.
    ///
    /// # Errors
    /// A scene without extent.
    pub fn around(info: &SceneInfo) -> anyhow::Result<Orbit> {
        let [low, high] = info.bounds.context("an empty scene")?.map(DVec3::from);
        let (target, radius, fov_deg) = (0.5 * (low + high), 0.5 * (high - low).length(), 40.0f64);
        let distance = radius / (0.5 * fov_deg).to_radians().sin();
        Ok(Orbit { eye: target + DVec3::Z * distance, target, fov_deg })
    }

    /// As a frame sees the scene where no pose is given.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn fitted(drawing: &Drawing, size: [u32; 2], settings: Settings) -> anyhow::Result<Orbit> {
        let frame = drawing.submit(Pose::FIT, size, settings, ImageFormat::Jpeg)?;
        let camera = &frame.receipt.camera;
        let [eye, target] = [camera.eye, camera.target].map(DVec3::from);
        Ok(Orbit { eye, target, fov_deg: camera.fov_deg.unwrap_or(40.0) })
    }

    pub fn at(&self, degrees: f64) -> Camera {
        let turn = DQuat::from_rotation_y(degrees.to_radians());
        Camera::perspective(
            self.target + turn * (self.eye - self.target),
            self.target,
            self.fov_deg,
        )
    }
}

/// A scene and its engine.
pub struct Drawing {
    pub engine: Engine,
    pub info: SceneInfo,
    pub size: u32,
}

impl Drawing {
    /// Opens an engine for `file` alone.
    ///
    /// # Errors
    /// No adapter, a file that is refused.
    pub fn open(
        file: &Path,
        size: u32,
        adjust: impl FnOnce(&mut EngineConfig),
    ) -> anyhow::Result<Drawing> {
        let mut config = EngineConfig::new(file.parent().unwrap_or(Path::new(".")).canonicalize()?);
        config.may_draw_in_full = true;
        adjust(&mut config);
        let engine = Engine::start(config)?;
        let info = engine.load("scene", &file.canonicalize()?)?;
        Ok(Drawing { engine, info, size })
    }

    /// Another scene of the same folder in the same engine.
    ///
    /// # Errors
    /// A file that is refused.
    pub fn beside(&self, file: &Path) -> anyhow::Result<Drawing> {
        let id = file.file_stem().context("a file has a name")?.to_string_lossy();
        let info = self.engine.load(&id, &file.canonicalize()?)?;
        Ok(Drawing { engine: self.engine.clone(), info, size: self.size })
    }

    /// Builds what frames with these settings need, so that none of them waits for it.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn bake(&self, settings: Settings) -> anyhow::Result<()> {
        let size = [self.size, self.size];
        Ok(self.engine.bake(&self.request(Pose::FIT, size, settings, ImageFormat::Jpeg))?)
    }

    /// One frame, square, as the engine draws when nothing is chosen.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn frame(&self, camera: Camera, format: ImageFormat) -> anyhow::Result<Arc<EncodedFrame>> {
        self.submit(
            Pose::Camera(camera),
            [self.size, self.size],
            Settings::drawn_as(Reconstruct::Points),
            format,
        )
    }

    /// Draws such a frame as a JPEG, without its image.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn receipt(&self, camera: Camera) -> anyhow::Result<Receipt> {
        Ok(self.frame(camera, ImageFormat::Jpeg)?.receipt.clone())
    }

    /// The receipt of a frame of any size and settings.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn draw(
        &self,
        camera: Camera,
        size: [u32; 2],
        settings: Settings,
    ) -> anyhow::Result<Receipt> {
        Ok(self.image(camera, size, settings, ImageFormat::Jpeg)?.receipt.clone())
    }

    /// A frame of any size, settings and format.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn image(
        &self,
        camera: Camera,
        size: [u32; 2],
        settings: Settings,
        format: ImageFormat,
    ) -> anyhow::Result<Arc<EncodedFrame>> {
        self.submit(Pose::Camera(camera), size, settings, format)
    }

    /// Raw values of any output of a frame.
    ///
    /// # Errors
    /// The engine refuses.
    pub fn raw(
        &self,
        camera: Camera,
        size: [u32; 2],
        settings: Settings,
        output: Output,
    ) -> anyhow::Result<Arc<EncodedFrame>> {
        let request = self.request(Pose::Camera(camera), size, settings, ImageFormat::Raw);
        Ok(self.engine.submit(FrameRequest { output, ..request })?.wait()?)
    }

    fn submit(
        &self,
        pose: Pose,
        size: [u32; 2],
        settings: Settings,
        format: ImageFormat,
    ) -> anyhow::Result<Arc<EncodedFrame>> {
        Ok(self.engine.submit(self.request(pose, size, settings, format))?.wait()?)
    }

    fn request(
        &self,
        pose: Pose,
        [width, height]: [u32; 2],
        settings: Settings,
        format: ImageFormat,
    ) -> FrameRequest {
        FrameRequest {
            scene: self.info.id.clone(),
            pose,
            width,
            height,
            settings,
            output: Output::Color,
            format,
            quality: 85,
            deadline: None,
        }
    }
}

/// GPU time of a frame in milliseconds.
///
/// # Errors
/// An adapter without timestamps, on which there is nothing to compare.
pub fn gpu_ms(receipt: &Receipt) -> anyhow::Result<f64> {
    Ok(super::ms(receipt.gpu_ns.context("this adapter has no timestamps")?))
}

/// GPU time of a pass; 0 where it did not run.
///
/// # Errors
/// An adapter without timestamps, on which there is nothing to compare.
pub fn pass_ns(receipt: &Receipt, name: &str) -> anyhow::Result<u64> {
    match receipt.passes.iter().find(|pass| pass.name == name) {
        Some(pass) if pass.ran => pass.gpu_ns.context("this adapter has no timestamps"),
        _ => Ok(0),
    }
}

/// Names and median milliseconds of the passes that ran, in order.
pub fn pass_medians(receipts: &[Receipt]) -> Vec<(&'static str, f64)> {
    let Some(first) = receipts.first() else { return Vec::new() };
    let ran = first.passes.iter().filter(|pass| pass.ran);
    ran.map(|pass| {
        let times: Vec<f64> = receipts
            .iter()
            .filter_map(|receipt| pass_ns(receipt, pass.name).ok().map(super::ms))
            .collect();
        (pass.name, super::median(&times))
    })
    .collect()
}
