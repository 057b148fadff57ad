//! Reference frames of the scenes that the engine draws.
//!
//! A [`Reference`] is loaded from the same file as an engine's scene, with the same description, preparation and numbering
//! ([`crate::bake::assemble`], [`crate::bake::prepare`]), but keeps its geometry in f64, and the [`crate::oracle`] draws it. The
//! difference to the engine's frame is the effect of packing, the GPU's arithmetic and its passes.
//!
//! Loading takes as long as the engine's loading. A frame takes seconds rather than milliseconds. The reference is meant for
//! scenes of up to a few million primitives and frames of a few hundred pixels a side.

use std::path::Path;

use crate::assets::{Asset, AssetError, EnvironmentImage, ReadOptions};
use crate::bake::assemble::{AssembleError, Assembler, Prepared};
use crate::bake::environment::image_of;
use crate::bake::prepare::{self, Outlook, PlacedGeometry};
use crate::encode::FrameImage;
use crate::math::{Bounds, Camera, View};
use crate::oracle::{self, OracleFrame, OracleItem, OracleScene, Surroundings};
use crate::plan::Output;
use crate::scene::{Scene, SceneError, SceneLimits, Splats};

/// Why a reference cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Asset(#[from] AssetError),
    #[error("{what} ({found}) is over the limit of {limit}")]
    OverLimit { what: &'static str, found: u64, limit: u64 },
}

impl From<AssembleError> for ReferenceError {
    fn from(error: AssembleError) -> Self {
        match error {
            AssembleError::Asset(error) => ReferenceError::Asset(error),
            AssembleError::Interrupted(interrupt) => ReferenceError::Asset(interrupt.into()),
            AssembleError::Scene(error) => ReferenceError::Scene(error),
        }
    }
}

/// A scene as the oracle draws it, with everything that it refers to.
#[derive(Debug)]
pub struct Reference {
    description: Scene,
    /// Prepared assets, in the order of the description.
    assets: Vec<Asset>,
    placed: Vec<PlacedGeometry>,
    /// The image of the scene's surroundings.
    image: Option<EnvironmentImage>,
}

impl Reference {
    /// Loads the scene or asset file at `path` as an engine with this root, these read options and these limits does.
    ///
    /// # Errors
    /// Any error for which the engine refuses the file.
    pub fn load(
        path: &Path,
        root: &Path,
        read: &ReadOptions,
        limits: &SceneLimits,
    ) -> Result<Reference, ReferenceError> {
        let mut description = prepare::describe(path, root, limits)?;
        let mut options = read.clone();
        options.root.get_or_insert_with(|| root.to_path_buf());
        let mut assets = Vec::with_capacity(description.assets.len());
        let mut traits = Vec::with_capacity(description.assets.len());
        let mut assembler = Assembler::new(path, &description, &options);
        let mut shape = None;
        for index in 0..description.assets.len() {
            let Prepared { asset, traits: found, shape: measured, .. } = assembler.asset(index)?;
            shape = shape.or(measured);
            if description.cameras.is_empty() {
                description.cameras.extend(asset.cameras.iter().cloned());
            }
            traits.push(found);
            assets.push(asset);
        }
        if !prepare::is_scene_file(path) {
            let sensor = assets.iter().find_map(|asset| asset.sensor);
            let bounds = assets.iter().fold(Bounds::EMPTY, |all, asset| all.union(asset.bounds()));
            let outlook = Outlook { up: None, shape: shape.as_ref(), bounds, sensor };
            prepare::adapt_bare_asset(&mut description, &traits, &outlook);
        }
        let placements: Vec<_> = assets.iter().map(|asset| &asset.placements).collect();
        let limit = limits.max_instances;
        // One more than the limit suffices to detect an excess.
        let most = usize::try_from(limit).unwrap_or(usize::MAX).saturating_add(1);
        let placed: Vec<PlacedGeometry> =
            prepare::placed(&description, &placements).take(most).collect();
        if placed.len() as u64 > limit {
            let found = placed.len() as u64;
            return Err(ReferenceError::OverLimit { what: "instances", found, limit });
        }
        let image = match &description.environment {
            Some(environment) => Some(image_of(environment, &options)?),
            None => None,
        };
        Ok(Reference { description, assets, placed, image })
    }

    /// The scene description, as loaded and adapted.
    pub fn description(&self) -> &Scene {
        &self.description
    }

    /// The pose of a named camera of the scene, or else of its asset.
    pub fn camera(&self, name: &str) -> Option<Camera> {
        let mut cameras = self.description.cameras.iter();
        cameras.find(|(known, _)| known == name).map(|(_, camera)| *camera)
    }

    /// The scene for the oracle, with a pixel per sample. Instances have the engine's numbers.
    pub fn scene(&self) -> OracleScene<'_> {
        let item = |(number, placed): (usize, &PlacedGeometry)| {
            let asset = &self.assets[placed.asset];
            OracleItem {
                geometry: &asset.geometries[placed.geometry],
                world_from_geometry: placed.world_from_geometry,
                materials: &asset.materials,
                textures: &asset.textures,
                override_material: placed
                    .material
                    .map(|material| &self.description.materials[material]),
                instance: number as u32,
            }
        };
        OracleScene {
            items: self.placed.iter().enumerate().map(item).collect(),
            lights: &self.description.lights,
            shadows: true,
            background: self.description.background,
            splats: None,
            painted: None,
            pull_push: None,
            discs: None,
            least_line_px: 0.0,
            recolor: None,
            clip: None,
            edl: None,
            surroundings: self
                .image
                .as_ref()
                .zip(self.description.environment.as_ref())
                .map(|(image, environment)| Surroundings { image, environment }),
            fog: self.description.fog,
            occlusion: self.description.occlusion,
            tone: None,
        }
    }

    /// Draws a frame. `supersample` is as in [`oracle::render`]: 1 samples as the engine does; more gives the smooth image that
    /// both approximate.
    pub fn frame(&self, view: &View, supersample: u32) -> OracleFrame {
        self.frame_with(view, supersample, None)
    }

    /// Draws a frame with samples as splats, or with a pixel per sample if `splats` is `None`.
    pub fn frame_with(
        &self,
        view: &View,
        supersample: u32,
        splats: Option<&Splats>,
    ) -> OracleFrame {
        let scene = OracleScene { splats: splats.copied(), ..self.scene() };
        oracle::render(&scene, view, supersample)
    }
}

/// Converts a reference frame to the engine's form: sRGB bytes, f32 depths, normals as bytes, ids.
pub fn image(frame: &OracleFrame, output: Output) -> FrameImage {
    let (width, height) = (frame.width, frame.height);
    match output {
        Output::Color => FrameImage::Color { width, height, rgba: frame.to_rgba8() },
        Output::Depth => {
            let depth = frame.depth.iter().map(|&depth| depth as f32).collect();
            FrameImage::Depth { width, height, depth }
        }
        Output::Normal => {
            let byte = |v: f64| (v * 127.0 + 128.0).round() as u8;
            let normal = |n: &glam::DVec3| match n.length_squared() {
                0.0 => [0; 4],
                _ => [byte(n.x), byte(n.y), byte(n.z), 255],
            };
            FrameImage::Normal { width, height, rgba: frame.normal.iter().map(normal).collect() }
        }
        Output::Id => FrameImage::Id { width, height, id: frame.id.clone() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let triangle = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n\
            property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
            -1 -1 0\n1 -1 0\n0 1 0\n3 0 1 2\n";
        std::fs::write(folder.path().join("t.ply"), triangle).unwrap();
        folder
    }

    fn view() -> View {
        let eye = DVec3::new(0.0, 0.0, 4.0);
        Camera::perspective(eye, DVec3::ZERO, 60.0).view(16, 12).unwrap()
    }

    #[test]
    fn a_scene_file_is_drawn_with_its_overrides_and_numbers() {
        let folder = folder();
        let path = folder.path().join("s.json");
        let text = r##"{"assets": {"t": {"file": "t.ply"}}, "lights": [], "background": "#102030",
            "materials": {"red": {"color": [1, 0, 0]}},
            "nodes": [{"asset": "t", "translate": [0, 0, -50]}, {"asset": "t", "material": "red"}],
            "cameras": {"c": {"eye": [0, 0, 4], "target": [0, 0, 0]}}}"##;
        std::fs::write(&path, text).unwrap();
        let (options, limits) = (ReadOptions::default(), SceneLimits::default());
        let reference = Reference::load(&path, folder.path(), &options, &limits).unwrap();
        let frame = reference.frame(&view(), 1);
        let draw = |output| image(&frame, output);
        let centre = 6 * 16 + 8;
        let FrameImage::Id { id, .. } = draw(Output::Id) else { panic!("ids") };
        assert_eq!((id[0], id[centre]), (0, 2));
        let FrameImage::Color { rgba, .. } = draw(Output::Color) else { panic!("colours") };
        assert_eq!((rgba[0], rgba[centre]), ([0x10, 0x20, 0x30, 255], [255, 0, 0, 255]));
        let FrameImage::Depth { depth, .. } = draw(Output::Depth) else { panic!("depths") };
        assert_eq!((depth[0], depth[centre]), (f32::INFINITY, 4.0));
        let FrameImage::Normal { rgba, .. } = draw(Output::Normal) else { panic!("normals") };
        assert_eq!((rgba[0], rgba[centre]), ([0; 4], [128, 128, 255, 255]));
    }

    #[test]
    fn a_bare_asset_is_a_scene() {
        let folder = folder();
        let path = folder.path().join("t.ply");
        let load = |path: &Path, limits: &SceneLimits| {
            Reference::load(path, folder.path(), &ReadOptions::default(), limits)
        };
        let reference = load(&path, &SceneLimits::default()).unwrap();
        assert_eq!(reference.description().name, "t");
        assert_eq!(reference.scene().lights.len(), 2);
        assert!(reference.camera("c").is_none());
        assert_eq!(reference.frame(&view(), 1).id[6 * 16 + 8], 1);
        assert_eq!(
            reference.frame_with(&view(), 1, Some(&Splats::default())),
            reference.frame(&view(), 1)
        );
        let none = SceneLimits { max_instances: 0, ..SceneLimits::default() };
        assert!(matches!(
            load(&path, &none),
            Err(ReferenceError::OverLimit { found: 1, limit: 0, .. })
        ));
        let missing = folder.path().join("missing.ply");
        let error = load(&missing, &SceneLimits::default()).unwrap_err();
        assert!(error.to_string().contains("missing.ply"), "{error}");
    }

    #[test]
    fn samples_are_drawn_as_pixels_or_as_splats() {
        let folder = folder();
        let path = folder.path().join("p.xyz");
        std::fs::write(&path, "0 0 0\n").unwrap();
        let limits = SceneLimits::default();
        let reference =
            Reference::load(&path, folder.path(), &ReadOptions::default(), &limits).unwrap();
        let covered = |splats| {
            let frame = reference.frame_with(&view(), 1, splats);
            frame.id.iter().filter(|&&id| id == 1).count()
        };
        assert_eq!(covered(None), 1);
        // The low-pass filter alone reaches the four pixels around the image's centre.
        assert!(covered(Some(&Splats::default())) >= 4);
    }
}
