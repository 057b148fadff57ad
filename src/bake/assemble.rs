//! Prepares a scene's assets for any renderer: reads files, samples meshes, finds features, combines solids.
//!
//! The engine and the reference renderer of [`crate::accuracy`] both take their geometry from [`Assembler::asset`]. An asset that
//! several solids use is read and sampled once.

use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use super::csg::{self, CsgError};
use super::mesh_lines::{self, MeshLines, lines_of_mesh};
use super::prepare::{self, AssetTraits};
use super::upright::Shape;
use super::{
    FeatureOptions, SampleOptions, detect_features, estimate_kernels, expected_samples, sample_mesh,
};
use crate::assets::{
    self, Asset, AssetError, Clip, Geometry, NEUTRAL, Placement, PointCloud, ReadOptions,
};
use crate::memory::Interrupt;
use crate::scene::{AsLines, AssetRef, AssetSource, FileSource, Scene, SceneError, Solid};

/// [`Asset::format`] of solids, which are made of other assets.
pub const SOLID_FORMAT: &str = "csg";
/// [`Asset::format`] of operands, which solids use and no node draws.
pub const OPERAND_FORMAT: &str = "operand";
/// Maximum number of samples of a combined solid.
const MAX_SAMPLES: u64 = 50_000_000;
/// Bytes of a sample of a solid.
const SAMPLE_BYTES: u64 = 128;
/// Bytes of a sample while a mesh is sampled: the sample itself, its cell and its darts.
const SAMPLING_BYTES: u64 = 320;

/// Why an asset was not assembled.
#[derive(Debug, thiserror::Error)]
pub enum AssembleError {
    /// A file cannot be read.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The load was cancelled, or there is no memory for it.
    #[error(transparent)]
    Interrupted(#[from] Interrupt),
    /// The scene's request does not fit the contents of an asset's file; the error names the place in the scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// An asset with everything that drawing needs.
#[derive(Debug)]
pub struct Prepared {
    pub asset: Asset,
    pub traits: AssetTraits,
    /// Indices of clouds that still lack normals or kernels ([`super::estimate`]).
    pub lacking: Vec<usize>,
    /// Measured if the scene is this asset alone, to guess the up direction.
    pub shape: Option<Shape>,
}

/// Assembles the assets of one scene.
pub struct Assembler {
    /// The scene's name in errors.
    scene: String,
    assets: Vec<AssetRef>,
    operands_only: Vec<bool>,
    is_operand: Vec<bool>,
    is_bare: bool,
    options: ReadOptions,
    /// Files that solids are made of, as read and sampled.
    files: HashMap<usize, Rc<Asset>>,
    /// Clouds that solids are made of.
    clouds: HashMap<usize, Rc<PointCloud>>,
}

impl Assembler {
    /// `scene` is the file that `description` came from, which errors name.
    pub fn new(scene: &Path, description: &Scene, options: &ReadOptions) -> Assembler {
        let mut is_operand = vec![false; description.assets.len()];
        for operand in description.assets.iter().flat_map(AssetRef::operands) {
            is_operand[operand.asset] = true;
        }
        Assembler {
            scene: scene.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            assets: description.assets.clone(),
            operands_only: description.operands_only(),
            is_operand,
            is_bare: !prepare::is_scene_file(scene),
            options: options.clone(),
            files: HashMap::new(),
            clouds: HashMap::new(),
        }
    }

    /// The asset with this index in the scene, ready to be drawn. An asset that only serves as an operand of others has no
    /// geometry.
    ///
    /// # Errors
    /// Fails if a file cannot be read or does not hold what the scene asks for.
    pub fn asset(&mut self, index: usize) -> Result<Prepared, AssembleError> {
        self.asset_without_estimates(index, usize::MAX)
    }

    /// Does the same as [`Assembler::asset`] without estimating normals and kernels of clouds with more than `most` points.
    ///
    /// # Errors
    /// Fails in the same cases as [`Assembler::asset`].
    pub fn asset_without_estimates(
        &mut self,
        index: usize,
        most: usize,
    ) -> Result<Prepared, AssembleError> {
        if self.operands_only[index] {
            return Ok(no_geometry());
        }
        let (mut asset, features) = match self.assets[index].source.clone() {
            AssetSource::File(source) => {
                let asset = Rc::unwrap_or_clone(self.file(index, &source)?);
                (asset, source.features)
            }
            AssetSource::Solid(solid) => (self.solid_asset(index, &solid)?, false),
        };
        let shape = if self.is_bare { Shape::of(&asset) } else { None };
        let has_metals = prepare::has_metals(&asset.materials);
        let mut traits = AssetTraits { format: asset.format, has_metals, ..AssetTraits::default() };
        let mut lacking = Vec::new();
        for (number, geometry) in asset.geometries.iter_mut().enumerate() {
            // Features are found with the help of kernels.
            if !features
                && prepare::prepare_points(geometry, &mut traits, most, &self.options.admission)?
            {
                lacking.push(number);
                continue;
            }
            prepare::prepare_geometry(geometry, &mut traits, &self.options.admission)?;
            if features && let Geometry::Points(cloud) = geometry {
                detect_features(cloud, &FeatureOptions::default());
            }
        }
        Ok(Prepared { asset, traits, lacking, shape })
    }

    /// Reads a file and samples it if the scene asks for samples.
    fn file(&mut self, index: usize, source: &FileSource) -> Result<Rc<Asset>, AssembleError> {
        if let Some(known) = self.files.get(&index) {
            return Ok(known.clone());
        }
        let mut asset = assets::read(&source.path, &self.options)?;
        let is_mesh = |geometry: &Geometry| matches!(geometry, Geometry::Mesh(_));
        if source.sample.is_some() && !asset.geometries.iter().any(is_mesh) {
            let reason = "the file holds points, which are samples already";
            return Err(self.invalid(index, ".sample", reason));
        }
        if source.features && asset.geometries.iter().all(is_mesh) {
            let reason = "is for points; the file holds a mesh, whose creases `sample` finds";
            return Err(self.invalid(index, ".features", reason));
        }
        if let Some(options) = source.as_lines {
            self.turn_into_lines(index, &mut asset, &options)?;
        }
        if let Some(radius) = source.line_radius {
            let mut has_lines = false;
            for geometry in &mut asset.geometries {
                if let Geometry::Lines(lines) = geometry {
                    has_lines = true;
                    if lines.radii.is_none() {
                        let bytes = 4 * lines.positions.len() as u64;
                        self.options.admission.grow(&self.assets[index].name, bytes)?;
                    }
                    lines.radii = Some(vec![radius as f32; lines.positions.len()]);
                }
            }
            if !has_lines {
                return Err(self.invalid(
                    index,
                    ".line_radius",
                    "the file holds no lines; only files of lines have it",
                ));
            }
        }
        if let Some(sampling) = source.sample {
            let defaults = SampleOptions::default();
            let options = SampleOptions {
                spacing: sampling.spacing,
                max_samples: defaults.max_samples.min(self.options.max_vertices),
                crease_deg: sampling.crease_deg.unwrap_or(defaults.crease_deg),
            };
            let Asset { geometries, materials, textures, .. } = &mut asset;
            for geometry in geometries.iter_mut() {
                if let Geometry::Mesh(mesh) = geometry {
                    let expected = expected_samples(mesh, &options).saturating_mul(SAMPLING_BYTES);
                    self.options.admission.grow(&self.assets[index].name, expected)?;
                    let cloud = sample_mesh(mesh, materials, textures, &options)
                        .map_err(|error| self.invalid(index, ".sample", &error.to_string()))?;
                    *geometry = Geometry::Points(cloud);
                }
            }
            // The samples have taken their colours.
            materials.clear();
            textures.clear();
        }
        let asset = Rc::new(asset);
        if self.is_operand[index] {
            self.files.insert(index, asset.clone());
        }
        Ok(asset)
    }

    /// Replaces each mesh by lines and the triangles that are left. Every part stands where the mesh stood.
    fn turn_into_lines(
        &self,
        index: usize,
        asset: &mut Asset,
        options: &AsLines,
    ) -> Result<(), AssembleError> {
        let Asset { geometries, materials, textures, placements, .. } = asset;
        let mut has_lines = false;
        for number in 0..geometries.len() {
            let Geometry::Mesh(mesh) = &geometries[number] else { continue };
            let bytes = mesh.triangles.len() as u64 * mesh_lines::TRIANGLE_BYTES;
            self.options.admission.grow(&self.assets[index].name, bytes)?;
            let MeshLines { rest, leaves, branches } =
                lines_of_mesh(mesh, materials, textures, options);
            has_lines |= leaves.is_some() || branches.is_some();
            let lines = leaves.into_iter().chain(branches).map(Geometry::Lines);
            let mut parts = rest.map(Geometry::Mesh).into_iter().chain(lines);
            let Some(first) = parts.next() else { continue };
            geometries[number] = first;
            for part in parts {
                let own = placements.iter().filter(|placement| placement.geometry == number);
                let own: Vec<Placement> = own.cloned().collect();
                let geometry = geometries.len();
                placements.extend(own.into_iter().map(|own| Placement { geometry, ..own }));
                geometries.push(part);
            }
        }
        if has_lines {
            return Ok(());
        }
        let reason = "the file holds no leaves (strips of quads) and no branches (rows of rings) up to the largest radius; \
                      they stay triangles without `as_lines`";
        Err(self.invalid(index, ".as_lines", reason))
    }

    fn solid_asset(&mut self, index: usize, solid: &Solid) -> Result<Asset, AssembleError> {
        let cloud = match self.clouds.get(&index) {
            Some(known) => known.as_ref().clone(),
            None => self.combine(index, solid)?,
        };
        let is_empty = cloud.positions.is_empty();
        let name = &self.assets[index].name;
        let mut asset = Asset::single(SOLID_FORMAT, name, Geometry::Points(cloud));
        if is_empty {
            asset.warnings.push(format!("nothing is left of the {}", solid.operation.key()));
        }
        Ok(asset)
    }

    /// The number of samples of an asset if every solid kept all samples of its operands, counted once per use.
    fn expanded_samples(
        &mut self,
        index: usize,
        known: &mut HashMap<usize, u64>,
    ) -> Result<u64, AssembleError> {
        if let Some(&known) = known.get(&index) {
            return Ok(known);
        }
        let mut samples = 0u64;
        match self.assets[index].source.clone() {
            AssetSource::Solid(solid) => {
                for operand in &solid.operands {
                    let operand = self.expanded_samples(operand.asset, known)?;
                    samples = samples.saturating_add(operand);
                }
            }
            AssetSource::File(_) => {
                samples = self.cloud(index)?.map_or(0, |cloud| cloud.positions.len() as u64);
            }
        }
        known.insert(index, samples);
        Ok(samples)
    }

    /// The recursion is as deep as solids are nested, which a scene's limits bound.
    fn combine(&mut self, index: usize, solid: &Solid) -> Result<PointCloud, AssembleError> {
        // The count comes first because combining takes long.
        let expanded = self.expanded_samples(index, &mut HashMap::new())?;
        let most = MAX_SAMPLES.min(self.options.max_vertices);
        if expanded > most {
            let reason = format!(
                "expands to {expanded} samples, as every use of a solid counts all that the solid is made of; at most {most}"
            );
            return Err(self.invalid(index, "", &reason));
        }
        let key = |operand: usize| format!(".{}[{operand}]", solid.operation.key());
        let limit = MAX_SAMPLES.min(self.options.max_vertices);
        let mut count = 0;
        let mut operands = Vec::with_capacity(solid.operands.len());
        for (number, operand) in solid.operands.iter().enumerate() {
            let Some(cloud) = self.cloud(operand.asset)? else {
                let name = &self.assets[operand.asset].name;
                let reason =
                    format!("`{name}` is a mesh; give it `sample` to combine it with others");
                return Err(self.invalid(index, &key(number), &reason));
            };
            count += cloud.positions.len() as u64;
            if count > limit {
                let reason = format!("{count} samples are over the limit of {limit}");
                return Err(self.invalid(index, &key(number), &reason));
            }
            let bytes = cloud.positions.len() as u64 * SAMPLE_BYTES;
            self.options.admission.grow(&self.assets[index].name, bytes)?;
            operands.push(csg::transformed(&cloud, &operand.solid_from_operand));
        }
        let admission = self.options.admission.clone();
        csg::combine(solid.operation, &operands, &admission).map_err(|error| {
            if let CsgError::Interrupted(interrupt) = error {
                return interrupt.into();
            }
            let place = error.operand().map_or_else(String::new, key);
            let operand = error.operand().and_then(|number| solid.operands.get(number));
            let name = operand.map_or("", |operand| &self.assets[operand.asset].name);
            self.invalid(index, &place, &format!("`{name}`: {error}"))
        })
    }

    /// All samples of an asset in one frame, with kernels; `None` if it contains a mesh.
    fn cloud(&mut self, index: usize) -> Result<Option<Rc<PointCloud>>, AssembleError> {
        if let Some(known) = self.clouds.get(&index) {
            return Ok(Some(known.clone()));
        }
        let cloud = match self.assets[index].source.clone() {
            AssetSource::Solid(solid) => self.combine(index, &solid)?,
            AssetSource::File(source) => {
                let asset = self.file(index, &source)?;
                let held: usize = asset.geometries.iter().map(|g| g.positions().len()).sum();
                self.options
                    .admission
                    .grow(&self.assets[index].name, held as u64 * SAMPLE_BYTES)?;
                let Some(mut cloud) = placed_samples(&asset) else { return Ok(None) };
                if cloud.normals.is_some() {
                    estimate_kernels(&mut cloud);
                    if source.features {
                        detect_features(&mut cloud, &FeatureOptions::default());
                    }
                }
                cloud
            }
        };
        let cloud = Rc::new(cloud);
        self.clouds.insert(index, cloud.clone());
        Ok(Some(cloud))
    }

    fn invalid(&self, index: usize, place: &str, reason: &str) -> AssembleError {
        AssembleError::Scene(SceneError::Invalid {
            file: self.scene.clone(),
            path: format!("assets.{}{place}", self.assets[index].name),
            reason: reason.to_owned(),
        })
    }
}

fn no_geometry() -> Prepared {
    let asset = Asset { format: OPERAND_FORMAT, ..Asset::default() };
    let traits = AssetTraits { format: OPERAND_FORMAT, ..AssetTraits::default() };
    Prepared { asset, traits, lacking: Vec::new(), shape: None }
}

/// The samples of all placements; `None` if a mesh is placed.
fn placed_samples(asset: &Asset) -> Option<PointCloud> {
    let mut all: Option<PointCloud> = None;
    for placement in &asset.placements {
        let Geometry::Points(cloud) = asset.geometries.get(placement.geometry)? else {
            return None;
        };
        let cloud = csg::transformed(cloud, &placement.asset_from_geometry);
        all = Some(match all {
            Some(all) => joined(all, cloud),
            None => cloud,
        });
    }
    Some(all.unwrap_or_default())
}

/// Joins two clouds, keeping the attributes that both have. Missing colours and clips are filled in instead.
fn joined(a: PointCloud, b: PointCloud) -> PointCloud {
    fn both<T>(a: Option<Vec<T>>, b: Option<Vec<T>>) -> Option<Vec<T>> {
        let (mut a, b) = (a?, b?);
        a.extend(b);
        Some(a)
    }
    fn filled<T: Copy>(
        a: Option<Vec<T>>,
        b: Option<Vec<T>>,
        counts: [usize; 2],
        with: T,
    ) -> Option<Vec<T>> {
        if a.is_none() && b.is_none() {
            return None;
        }
        let mut all = a.unwrap_or_else(|| vec![with; counts[0]]);
        all.extend(b.unwrap_or_else(|| vec![with; counts[1]]));
        Some(all)
    }
    let counts = [a.positions.len(), b.positions.len()];
    PointCloud {
        colors: filled(a.colors, b.colors, counts, NEUTRAL),
        clips: filled(a.clips, b.clips, counts, Clip::NONE),
        normals: both(a.normals, b.normals),
        radii: both(a.radii, b.radii),
        kernels: both(a.kernels, b.kernels),
        positions: [a.positions, b.positions].concat(),
        ..PointCloud::default()
    }
}

#[cfg(test)]
mod tests;
