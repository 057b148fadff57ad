//! Loads scenes: reads their files, bakes and packs what they draw.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use sha2::{Digest, Sha256};

use super::asset_cache::{AssetCache, Extras, ReadAsset};
use super::asset_keys::{AssetKey, AssetKeys, digest_file, digest_packed};
use super::cloud_cache::CloudEntry;
use super::error::{asset_error, scene_error};
use super::loaded::{Loaded, Parts, build};
use super::scene_files::SceneFiles;
use super::uid::next_uid;
use super::watch::{Abandoned, Watch};
use super::{EngineConfig, EngineError, Source};
use crate::assets::warnings::condensed;
use crate::assets::{AssetError, Geometry, NamedFiles, PointCloud, ReadOptions};
use crate::bake::CUTOFF;
use crate::bake::assemble::{Assembler, Prepared};
use crate::bake::environment::{EnvironmentMap, image_of};
use crate::bake::estimate::{EstimateError, lacks_normals, pack_estimated};
use crate::bake::pack::{
    PackedAsset, PackedGeometry, pack_lines, pack_mesh, pack_samples, pack_texture, packing_bytes,
};
use crate::bake::prepare::{self, AssetTraits, Outlook};
use crate::math::Bounds;
use crate::memory::{Admission, Reservation};
use crate::residency::model::{AssetModel, Deferred};
use crate::residency::once::MadeOnce;
use crate::scene::{AssetRef, Environment, EnvironmentSource, Scene};

/// Reads a scene file or a bare asset and packs all that it draws.
pub fn load(
    id: &str,
    Source { path, base, up }: &Source,
    config: &EngineConfig,
    cache: &AssetCache,
    admission: &Admission,
) -> Result<Loaded, EngineError> {
    let is_scene = prepare::is_scene_file(path);
    let mut hasher = Sha256::new();
    if is_scene {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        hasher.update(digest_file(path, &file, admission).map_err(asset_error)?);
    }
    let mut description =
        prepare::describe_within(path, base.as_deref(), &config.root, &config.scene, admission)
            .map_err(scene_error)?;
    let described = admission.held();
    let mut assets = Vec::new();
    let mut placements = Vec::new();
    let mut warnings = Vec::new();
    let mut outlook = Outlook { up: up.or(config.up), bounds: Bounds::EMPTY, ..Outlook::default() };
    let mut shape = None;
    let options = admitted(config, admission);
    let mut assembler = Assembler::new(path, &description, &options);
    let mut keys = AssetKeys::within(admission);
    let operands_only = description.operands_only();
    let shares_operands = description.assets.iter().any(|asset| !asset.operands().is_empty());
    let most = config.estimate_at_once;
    let mut asset_keys = Vec::with_capacity(description.assets.len());
    let mut unwritten = Vec::new();
    for (index, reference) in description.assets.iter().enumerate() {
        let entry = CloudEntry::of(reference, config, !is_scene).filter(|_| !operands_only[index]);
        let note = entry.as_ref().and_then(|entry| entry.note(config));
        if let Some(note) = &note {
            keys.know(index, note.digest);
        }
        let key = keys.of(&description, index)?;
        asset_keys.push(key);
        // An asset that is only an operand draws nothing, and must not be cached as its file's content.
        let asset = if operands_only[index] {
            let prepared = assembler.asset(index)?;
            pack_asset(reference, prepared, key.digest, Completeness::Points, admission)
                .map_err(Stop::error)?
        } else {
            let known = entry.as_ref().zip(note.as_ref());
            let mut was_read = false;
            let asset = cache.get_or_read(key, !is_scene, || {
                if let Some((entry, note)) = known
                    && let Some(asset) = entry.asset(&reference.name, note, admission)?
                {
                    return Ok(asset);
                }
                was_read = true;
                read_asset(reference, (index, most), &mut assembler, key, admission)
            })?;
            if was_read && key.alone {
                unwritten.extend(entry.and_then(|entry| entry.keep(&asset)));
            }
            asset
        };
        if !shares_operands {
            // Free what reading and packing reserved. The asset keeps its own memory.
            admission.shrink_to(described);
        }
        hasher.update(asset.digest);
        let extras = asset.extras;
        warnings.extend(extras.warnings.into_iter().map(|text| (reference.name.clone(), text)));
        if description.cameras.is_empty() {
            description.cameras.extend(extras.cameras);
        }
        shape = shape.or(extras.shape);
        outlook.sensor = outlook.sensor.or(extras.sensor);
        for placement in extras.placements.iter() {
            let own = asset.model.bounds[placement.geometry];
            outlook.bounds = outlook.bounds.union(own.transformed(&placement.asset_from_geometry));
        }
        assets.push(asset.model);
        placements.push(extras.placements);
    }
    if !is_scene {
        let traits: Vec<AssetTraits> = assets.iter().map(|asset| asset.traits()).collect();
        outlook.shape = shape.as_ref();
        prepare::adapt_bare_asset(&mut description, &traits, &outlook);
        let Scene { up, lights, background, .. } = &description;
        hasher.update(format!("{up:?} {lights:?} {background:?}"));
    }
    let environment = match &description.environment {
        Some(environment) => Some(Arc::new(surroundings(environment, &options, &mut hasher)?)),
        None => None,
    };
    let warnings = scene_warnings(warnings, &assets, &description);
    let up = up.or(config.up);
    let files = SceneFiles::of(
        &Source { path: path.clone(), base: base.clone(), up },
        &description,
        &options.named,
    );
    let digest = hasher.finalize().into();
    let id = id.to_owned();
    drop(assembler);
    admission.shrink_to(described);
    let parts = Parts {
        id,
        revision: 1,
        description,
        assets,
        placements,
        environment,
        warnings,
        digest,
        origin: digest,
        keys: asset_keys,
        path: path.to_owned(),
        files: Some(Arc::new(files)),
    };
    Ok(Loaded { unwritten, ..build(parts, config, None, admission)? })
}

/// Reads and blurs the surroundings of a scene, and hashes what decides them.
fn surroundings(
    environment: &Environment,
    options: &ReadOptions,
    hasher: &mut Sha256,
) -> Result<EnvironmentMap, EngineError> {
    let file = match &environment.image {
        EnvironmentSource::File(path) => {
            let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            hasher.update(digest_file(path, &file, &options.admission).map_err(asset_error)?);
            file
        }
        EnvironmentSource::Studio => {
            hasher.update("studio");
            "studio".to_owned()
        }
    };
    let image = image_of(environment, options).map_err(asset_error)?;
    options.admission.grow(&file, EnvironmentMap::needed_bytes(&image))?;
    let mut map = EnvironmentMap::of(&image, environment);
    map.memory = options.admission.keep(map.bytes());
    Ok(map)
}

/// Returns the warnings of a scene: those of its assets, each with the asset's name, and what will look other than was asked for.
fn scene_warnings(
    of_assets: Vec<(String, String)>,
    assets: &[Arc<AssetModel>],
    description: &Scene,
) -> Vec<String> {
    let mut warnings = condensed(of_assets);
    warnings.extend(assets.iter().filter_map(|asset| strays(asset)));
    let splats = &description.splats;
    if f64::from(splats.cutoff) * f64::from(splats.width) < f64::from(CUTOFF) {
        warnings.push(format!(
            "splats end at {} standard deviations; estimated kernels close a surface from {CUTOFF} on",
            splats.cutoff * splats.width
        ));
    }
    warnings
}

/// Returns the options for reading files: below the root, and within the load's memory.
fn admitted(config: &EngineConfig, admission: &Admission) -> ReadOptions {
    let mut options = ReadOptions { named: NamedFiles::default(), ..config.read.clone() };
    options.root.get_or_insert_with(|| config.root.clone());
    options.admission = admission.clone();
    options
}

/// Reads a single asset of a scene file or a bare asset, and estimates everything that it lacks.
pub fn load_one(
    path: &Path,
    description: &Scene,
    index: usize,
    config: &EngineConfig,
) -> Result<Arc<AssetModel>, EngineError> {
    let admission = Admission::new(&config.memory);
    let key = AssetKeys::within(&admission).of(description, index)?;
    let asset = (index, key);
    whole_asset(path, description, asset, config, &Watch::NONE, &admission).map_err(Stop::error)
}

/// Does the work of [`load_one`]; stops when `watch` says so.
pub fn whole_asset(
    path: &Path,
    description: &Scene,
    (index, key): (usize, AssetKey),
    config: &EngineConfig,
    watch: &Watch<'_>,
    admission: &Admission,
) -> Result<Arc<AssetModel>, Stop> {
    let options = admitted(config, admission);
    let mut assembler = Assembler::new(path, description, &options);
    let reference = &description.assets[index];
    let read = assembler.asset_without_estimates(index, config.estimate_at_once);
    let prepared = read.map_err(|error| Stop::Failed(error.into()))?;
    watch.check()?;
    watch.tell(READING);
    let watch = watch.part(READING, 1.0 - READING);
    let whole = Completeness::Whole(&watch);
    Ok(pack_asset(reference, prepared, key.digest, whole, admission)?.model)
}

/// Share of reading in the time of reading and estimating.
const READING: f64 = 0.1;

/// How complete an asset must be.
#[derive(Clone, Copy)]
pub enum Completeness<'a> {
    /// Only the data for drawing points without lights.
    Points,
    Whole(&'a Watch<'a>),
}

/// Reason why there is no asset.
pub enum Stop {
    Failed(EngineError),
    Abandoned,
}

impl Stop {
    pub fn error(self) -> EngineError {
        match self {
            Stop::Failed(error) => error,
            Stop::Abandoned => EngineError::Internal("estimating was given up".into()),
        }
    }
}

impl From<Abandoned> for Stop {
    fn from(_: Abandoned) -> Stop {
        Stop::Abandoned
    }
}

/// Returns the warning about points of an asset that the default view leaves out.
fn strays(asset: &AssetModel) -> Option<String> {
    let outlines = asset.outlines();
    let strays: u64 = outlines.iter().map(|outline| outline.strays).sum();
    let farthest = outlines.iter().map(|outline| outline.farthest_stray).fold(0.0, f64::max);
    let counts = asset.counts();
    let (name, all) = (&asset.name, counts.elements());
    let what = if counts.triangles > 0 { "triangles" } else { "points" };
    (strays > 0).then(|| {
        format!(
            "{name}: {strays} of {all} {what} lie far from the rest, up to {farthest:.3e} units; the default view leaves them outside its frame"
        )
    })
}

fn read_asset(
    reference: &AssetRef,
    (index, most): (usize, usize),
    assembler: &mut Assembler,
    AssetKey { digest, alone }: AssetKey,
    admission: &Admission,
) -> Result<ReadAsset, EngineError> {
    let prepared = assembler.asset_without_estimates(index, most)?;
    let packed = pack_asset(reference, prepared, digest, Completeness::Points, admission);
    let mut read = packed.map_err(Stop::error)?;
    if !alone {
        let mut hasher = Sha256::new_with_prefix(digest);
        digest_packed(&mut hasher, &read.model.packed);
        read.digest = hasher.finalize().into();
    }
    Ok(read)
}

fn pack_asset(
    reference: &AssetRef,
    Prepared { mut asset, traits, lacking, shape }: Prepared,
    digest: [u8; 32],
    completeness: Completeness<'_>,
    admission: &Admission,
) -> Result<ReadAsset, Stop> {
    let mut geometries = Vec::with_capacity(asset.geometries.len());
    let bounds = asset.geometries.iter().map(prepare::drawn_bounds).collect();
    let (mut deferred, mut estimated) = (None, 0.0);
    let total = lacking.iter().map(|&number| size(&asset.geometries[number])).sum::<f64>();
    for (number, geometry) in asset.geometries.iter_mut().enumerate() {
        let granted = admission.grow(&reference.label(), packing_bytes(geometry));
        granted.map_err(|interrupt| Stop::Failed(interrupt.into()))?;
        let taken = std::mem::replace(geometry, Geometry::Points(PointCloud::default()));
        let packed = match (taken, completeness) {
            (Geometry::Mesh(mesh), _) => {
                pack_mesh(&mesh, &asset.materials).map(PackedGeometry::Triangles)
            }
            (Geometry::Lines(lines), _) => pack_lines(&lines).map(PackedGeometry::Lines),
            (Geometry::Points(cloud), Completeness::Whole(watch)) if lacking.contains(&number) => {
                let part = cloud.positions.len() as f64 / total;
                let watch = watch.part(estimated, part);
                estimated += part;
                match pack_estimated(cloud, watch.stop_flag(), &|done| watch.tell(done)) {
                    Ok(samples) => Ok(PackedGeometry::Samples(samples)),
                    Err(EstimateError::Pack(error)) => Err(error),
                    Err(EstimateError::Stopped) => return Err(Stop::Abandoned),
                }
            }
            (Geometry::Points(cloud), _) => {
                if lacking.contains(&number) {
                    let deferred: &mut Deferred = deferred.get_or_insert_default();
                    deferred.lacks_normals |= lacks_normals(&cloud);
                }
                pack_samples(&cloud).map(PackedGeometry::Samples)
            }
        };
        geometries.push(packed.map_err(|error| {
            Stop::Failed(asset_error(AssetError::Malformed {
                file: reference.label(),
                place: "positions".to_owned(),
                reason: error.to_string(),
            }))
        })?);
    }
    let textures = asset.textures.iter().map(pack_texture).collect();
    let mut model = AssetModel {
        memory: Reservation::default(),
        uid: next_uid(),
        name: reference.name.clone(),
        format: asset.format,
        packed: PackedAsset { geometries, materials: asset.materials, textures },
        bounds,
        has_colors: traits.has_colors,
        shows_intensity: traits.shows_intensity,
        has_normals: traits.has_normals,
        normals_estimated: traits.normals_estimated,
        beside: Vec::new(),
        tree: MadeOnce::default(),
        deferred,
        outlined: OnceLock::new(),
    };
    model.memory = admission.keep(model.gpu_bytes());
    Ok(ReadAsset {
        model: Arc::new(model),
        extras: Extras {
            placements: Arc::new(asset.placements),
            cameras: asset.cameras,
            sensor: asset.sensor,
            shape,
            warnings: asset.warnings,
        },
        digest,
    })
}

fn size(geometry: &Geometry) -> f64 {
    geometry.positions().len() as f64
}

/// Makes a path absolute and checks that it is inside the root.
pub fn check_path(path: &Path, root: &Path) -> Result<PathBuf, EngineError> {
    let display = path
        .file_name()
        .map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    let io = |source| asset_error(AssetError::Io { file: display.clone(), source });
    let path = path.canonicalize().map_err(io)?;
    let root = root.canonicalize().map_err(io)?;
    if !path.starts_with(&root) {
        return Err(asset_error(AssetError::Unsupported {
            file: display,
            reason: "lies outside the scene root".to_owned(),
        }));
    }
    if !path.is_file() {
        // A pipe would be waited for, for ever.
        let reason = if path.is_dir() {
            "is a folder; name one file in it: a scene (.json), or a file of points or triangles"
        } else {
            "is no regular file; write a pipe's content to a file first"
        };
        let reason = reason.to_owned();
        return Err(asset_error(AssetError::Unsupported { file: display, reason }));
    }
    Ok(path)
}
