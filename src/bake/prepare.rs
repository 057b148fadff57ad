//! Prepares a file for drawing, for any renderer.
//!
//! The engine packs the result for the GPU; the reference renderer of [`crate::accuracy`] passes it to the oracle unchanged. Both
//! take every step from here, so that a frame and its reference show the same scene: the description that a path stands for
//! ([`describe`]), the attributes that geometries lack ([`prepare_geometry`]), the lights and up direction of a bare file
//! ([`adapt_bare_asset`]), and the position and number of each geometry ([`placed`]).

use std::borrow::Borrow;
use std::path::Path;

use glam::{DAffine3, DVec3};

use super::estimate::lacks_estimates;
use super::upright::{self, Guess, Shape};
use super::{estimate_kernels, fill_colors, smooth_normals};
use crate::assets::{Geometry, Material, Placement};
use crate::math::{Bounds, Sensor};
use crate::memory::{Admission, Interrupt};
use crate::scene::{self, Environment, Instance, Scene, SceneError, SceneLimits};

/// Angle between faces, in degrees, above which a mesh without normals keeps its edge.
const CREASE_DEG: f64 = 35.0;
/// Luminance of a surface under the lights of a bare file, as a share of that of its colours, about.
const LIT: f64 = 0.5;
/// Median luminance below which what is drawn stands out badly from the default background.
const DARK: f64 = 0.085;
/// Background of bare files that are mostly dark: `#c4cad0` in linear RGB.
const LIGHT_BACKGROUND: [f32; 4] = [0.552, 0.591, 0.631, 1.0];
/// Metallic share above which a material counts as a metal.
const METAL: f32 = 0.25;

/// The contents of an asset's file before preparation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AssetTraits {
    /// Same value as [`crate::assets::Asset::format`].
    pub format: &'static str,
    /// Some geometry had colours.
    pub has_colors: bool,
    /// Some geometry had no colours and is coloured by its intensity.
    pub shows_intensity: bool,
    /// Some geometry had normals.
    pub has_normals: bool,
    /// Some geometry had no normals, so they are estimated from the neighbourhood.
    pub normals_estimated: bool,
    /// Some geometry is a mesh.
    pub has_triangles: bool,
    /// Some geometry is made of lines.
    pub has_lines: bool,
    /// Some part of a mesh has a material.
    pub has_materials: bool,
    /// Some material is a metal.
    pub has_metals: bool,
}

/// Whether some material is a metal, which shows nothing but what it reflects.
pub fn has_metals(materials: &[Material]) -> bool {
    let is_metal = |material: &Material| {
        !material.unlit && material.physical.is_some_and(|own| own.metallic > METAL)
    };
    materials.iter().any(is_metal)
}

/// One drawn copy of one geometry. Its number is its index in the list from [`placed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedGeometry {
    /// Index into [`Scene::assets`].
    pub asset: usize,
    /// Index into the asset's geometries.
    pub geometry: usize,
    pub world_from_geometry: DAffine3,
    /// Index into [`Scene::materials`].
    pub material: Option<usize>,
}

/// Tells whether a path names a scene file; any other file is drawn as a scene of its own.
pub fn is_scene_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// The scene that the file at `path` (below `root`) stands for.
///
/// # Errors
/// Fails for a scene file that [`scene::load`] refuses.
pub fn describe(path: &Path, root: &Path, limits: &SceneLimits) -> Result<Scene, SceneError> {
    describe_within(path, None, root, limits, &Admission::default())
}

/// The scene that the file at `path` stands for, as [`scene::load_within`] reads it.
///
/// # Errors
/// Fails for a scene file that [`scene::load_within`] refuses.
pub fn describe_within(
    path: &Path,
    base: Option<&Path>,
    root: &Path,
    limits: &SceneLimits,
    admission: &Admission,
) -> Result<Scene, SceneError> {
    if is_scene_file(path) {
        return scene::load_within(path, base, root, limits, admission);
    }
    let stem = path.file_stem().map_or_else(|| "asset".into(), |stem| stem.to_string_lossy());
    Ok(Scene::from_asset(&stem, path.to_path_buf()))
}

/// Gives a geometry the colours, normals, radii and kernels that it lacks, and records in `traits`, whose format is already set,
/// which attributes it had. The admission holds the memory of the added attributes.
///
/// # Errors
/// Fails if the load was cancelled or there is no memory for it; the geometry is then unchanged or prepared in part.
pub fn prepare_geometry(
    geometry: &mut Geometry,
    traits: &mut AssetTraits,
    admission: &Admission,
) -> Result<(), Interrupt> {
    let before = admission.held();
    let (kept, while_estimating) = preparation_bytes(geometry);
    admission.grow("estimating normals and kernels", kept + while_estimating)?;
    let (has_colors, has_normals) = match geometry {
        Geometry::Points(cloud) => {
            let had = (cloud.colors.is_some(), cloud.normals.is_some());
            traits.shows_intensity |= fill_colors(cloud);
            cloud.oriented = had.1;
            estimate_kernels(cloud);
            had
        }
        Geometry::Mesh(mesh) => {
            traits.has_triangles = true;
            traits.has_materials |= mesh.parts.iter().any(|part| part.material.is_some());
            let had = (mesh.colors.is_some(), mesh.normals.is_some());
            // A glTF mesh without normals is drawn flat (glTF 2.0, 3.7.2.1).
            smooth_normals(mesh, if traits.format.starts_with("gl") { 0.0 } else { CREASE_DEG });
            had
        }
        Geometry::Lines(lines) => {
            traits.has_lines = true;
            lines.radii.get_or_insert_with(|| {
                vec![usual_radius(&lines.positions, &lines.strands); lines.positions.len()]
            });
            // Tubes have the normals of their surface.
            (lines.colors.is_some(), true)
        }
    };
    traits.has_colors |= has_colors;
    traits.has_normals |= has_normals;
    traits.normals_estimated |= !has_normals;
    admission.shrink_to(before + kept);
    admission.check()
}

/// The radius of lines whose file has none: a 2000th of the diagonal, a pixel or so where the whole asset fills a frame. Where lines are
/// so many that they would cover the frame [`LAYERS`] times over at that radius, it is smaller, so that inner lines can be seen
/// between outer ones.
///
/// By Cauchy's formula a convex box of surface `S` covers `S / 4` on average over all directions, and strips of half width `r` and
/// length `L` cover `2 r L π / 4`.
pub fn usual_radius(positions: &[DVec3], strands: &[u32]) -> f32 {
    let bounds = Bounds::of(positions.iter().copied());
    if bounds.is_empty() {
        return 0.0;
    }
    let extent = bounds.extent();
    let diagonal = extent.length();
    let length: f64 = strands
        .windows(2)
        .filter_map(|ends| positions.get(ends[0] as usize..ends[1] as usize))
        .map(|strand| strand.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>())
        .sum();
    let surface = 2.0 * (extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
    // A straight line has a box without a surface.
    let surface = surface.max(0.01 * diagonal * diagonal);
    let crowded = LAYERS * surface / (std::f64::consts::TAU * length);
    let radius = if crowded.is_finite() { crowded } else { diagonal }.min(diagonal / 2000.0);
    radius as f32
}

/// How often lines of [`usual_radius`] cover an asset's box at most.
const LAYERS: f64 = 4.0;

/// Maximum bytes that [`prepare_geometry`] adds to a geometry, and that it needs temporarily.
fn preparation_bytes(geometry: &Geometry) -> (u64, u64) {
    match geometry {
        Geometry::Points(cloud) => {
            let count = cloud.positions.len() as u64;
            let is_complete = cloud.normals.is_some() && cloud.kernels.is_some();
            // Colour, normal, radius and kernel; the search's tree and its results.
            (44 * count, if is_complete { 0 } else { 120 * count })
        }
        Geometry::Mesh(mesh) => {
            let corners = 3 * mesh.triangles.len() as u64;
            // Vertices are split at creases; corners are sorted by vertex.
            if mesh.normals.is_some() { (0, 0) } else { (24 * corners, 48 * corners) }
        }
        Geometry::Lines(lines) => {
            (if lines.radii.is_some() { 0 } else { 4 * lines.positions.len() as u64 }, 0)
        }
    }
}

/// Gives a cloud of more than `most` points only the attributes that a picture of unlit points needs. Returns whether it did: a
/// cloud that needs no estimates is left unchanged.
///
/// # Errors
/// Fails if the load was cancelled or there is no memory for the colours.
pub fn prepare_points(
    geometry: &mut Geometry,
    traits: &mut AssetTraits,
    most: usize,
    admission: &Admission,
) -> Result<bool, Interrupt> {
    let Geometry::Points(cloud) = geometry else { return Ok(false) };
    let is_estimated_later = cloud.positions.len() > most
        && cloud.kernels.is_none()
        && cloud.clips.is_none()
        && lacks_estimates(cloud);
    if !is_estimated_later {
        return Ok(false);
    }
    if cloud.colors.is_none() {
        admission.grow("colours of points", 4 * cloud.positions.len() as u64)?;
    }
    traits.has_colors |= cloud.colors.is_some();
    traits.has_normals |= cloud.normals.is_some();
    traits.normals_estimated |= cloud.normals.is_none();
    cloud.oriented = cloud.normals.is_some();
    traits.shows_intensity |= fill_colors(cloud);
    Ok(true)
}

/// Hints from a bare asset's file about the initial view.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outlook<'a> {
    /// The up direction that the user set, in place of a guess.
    pub up: Option<DVec3>,
    pub shape: Option<&'a Shape>,
    /// Box around everything that is drawn.
    pub bounds: Bounds,
    /// The sensor that took the points.
    pub sensor: Option<Sensor>,
}

/// Adapts the description of a bare asset file: a scan's own colours and intensities are shown unlit; metals are lit by a studio, which they
/// reflect; dark content has a light background; the first view is the sensor's, and up is the user's, the sensor's, or a guess.
pub fn adapt_bare_asset(description: &mut Scene, assets: &[AssetTraits], outlook: &Outlook) {
    let scan = |asset: &AssetTraits| {
        let is_painted = asset.has_colors || asset.shows_intensity;
        is_painted && !asset.has_normals && !asset.has_triangles && !asset.has_lines
    };
    if assets.iter().all(scan) {
        description.lights.clear();
    }
    let drawn = if description.lights.is_empty() { 1.0 } else { LIT };
    if outlook.shape.is_some_and(|shape| shape.lightness * drawn < DARK) {
        description.background = LIGHT_BACKGROUND;
    }
    let bounds = outlook.bounds;
    let format = assets.first().map_or("", |asset| asset.format);
    let (up, because) = match (outlook.up, outlook.sensor) {
        (Some(up), _) => (up, "it was asked for".to_owned()),
        (None, Some(Sensor::View(view))) => {
            description.sensor = Some(view);
            (view.camera.up, "the camera that took the points had it above".to_owned())
        }
        (None, _) => {
            let Guess { up, because } = upright::guess(format, &bounds, outlook.shape);
            (up, because)
        }
    };
    if let Some(Sensor::Place(place)) = outlook.sensor {
        description.front = outside(&bounds, up, place);
    }
    if assets.iter().any(|asset| asset.has_metals) {
        description.lights.clear();
        description.environment = Some(Environment::studio(up));
    }
    description.up = up;
    description.up_because = because;
}

/// The horizontal direction from the middle of a box to a position outside it; `None` if the position is implausibly far away.
fn outside(bounds: &Bounds, up: DVec3, place: DVec3) -> Option<DVec3> {
    const FARTHEST_EXTENTS: f64 = 10.0;
    let up = up.try_normalize()?;
    let horizontal = |v: DVec3| v - up * up.dot(v);
    let offset = horizontal(place - bounds.centre());
    let is_beside = (horizontal(bounds.extent()) * 0.5 - offset.abs()).min_element() < 0.0;
    let is_near = offset.length() < FARTHEST_EXTENTS * bounds.extent().max_element();
    offset.try_normalize().filter(|_| is_beside && is_near)
}

/// The box of the visible geometry: vertices that no triangle uses are left out.
pub fn drawn_bounds(geometry: &Geometry) -> Bounds {
    match geometry {
        Geometry::Points(cloud) => Bounds::of_all(&cloud.positions),
        Geometry::Mesh(mesh) => {
            let used = mesh.triangles.iter().flatten();
            Bounds::of(used.filter_map(|&v| mesh.positions.get(v as usize).copied()))
        }
        Geometry::Lines(_) => geometry.bounds(),
    }
}

/// Lists every geometry that a scene draws, by instance and then by placement. `placements` has one list for each of the scene's
/// assets.
pub fn placed<'a, P: Borrow<Vec<Placement>>>(
    description: &Scene,
    placements: &'a [P],
) -> impl Iterator<Item = PlacedGeometry> + use<'a, P> {
    placed_instances(description.instances(), placements)
}

/// Does the same as [`placed`] for some of a scene's instances.
pub fn placed_instances<'a, P: Borrow<Vec<Placement>>>(
    instances: Vec<Instance>,
    placements: &'a [P],
) -> impl Iterator<Item = PlacedGeometry> + use<'a, P> {
    instances.into_iter().flat_map(move |instance| {
        let here: &Vec<Placement> = placements[instance.asset].borrow();
        here.iter().map(move |placement| PlacedGeometry {
            asset: instance.asset,
            geometry: placement.geometry,
            world_from_geometry: instance.world_from_asset * placement.asset_from_geometry,
            material: instance.material,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::tidy::srgb_byte_from_linear;
    use crate::assets::{Mesh, Physical, PointCloud};
    use crate::scene::Light;

    fn traits(format: &'static str) -> AssetTraits {
        AssetTraits { format, ..AssetTraits::default() }
    }

    #[test]
    fn a_cloud_gets_what_it_lacks() {
        let positions: Vec<DVec3> =
            (0..64).map(|i| DVec3::new(f64::from(i % 8), f64::from(i / 8), 0.0)).collect();
        let cloud = PointCloud { positions, colors: Some(vec![[9; 4]; 64]), ..Default::default() };
        let mut geometry = Geometry::Points(cloud);
        let mut found = traits("las");
        prepare_geometry(&mut geometry, &mut found, &Admission::default()).unwrap();
        let expected = AssetTraits { has_colors: true, normals_estimated: true, ..traits("las") };
        assert_eq!(found, expected);
        let Geometry::Points(cloud) = geometry else { unreachable!("a cloud stays one") };
        assert_eq!(cloud.colors.unwrap(), vec![[9; 4]; 64]);
        assert!(cloud.normals.unwrap().iter().all(|n| n.z.abs() > 0.99));
        assert!(cloud.radii.unwrap().iter().all(|&radius| radius > 0.0));
        assert!(cloud.kernels.unwrap().iter().all(|kernel| kernel.u.length() > 0.0));
    }

    #[test]
    fn only_gltf_meshes_are_flat() {
        // Two triangles that meet at 20°.
        let (sin, cos) = 20f64.to_radians().sin_cos();
        let positions = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [cos, 0.0, sin]];
        let mesh = Mesh {
            positions: positions.map(DVec3::from).to_vec(),
            triangles: vec![[0, 1, 2], [1, 0, 3]],
            ..Default::default()
        };
        for (format, vertices) in [("ply", 4), ("glb", 6), ("gltf", 6)] {
            let mut geometry = Geometry::Mesh(mesh.clone());
            let mut found = traits(format);
            prepare_geometry(&mut geometry, &mut found, &Admission::default()).unwrap();
            assert_eq!(geometry.positions().len(), vertices, "{format}");
            assert!(found.has_triangles && found.normals_estimated && !found.has_normals);
        }
    }

    #[test]
    fn bare_meshes_are_lit_as_in_scenes_and_white_does_not_clip() {
        let mut scene = Scene::from_asset("a", "a".into());
        let plain = AssetTraits { has_triangles: true, ..traits("stl") };
        adapt_bare_asset(&mut scene, &[plain], &Outlook::default());
        assert_eq!(scene.lights, Light::default_pair());
        let brightest: f32 = scene
            .lights
            .iter()
            .map(|light| match light {
                Light::Ambient { color } | Light::Headlight { color } => color[0],
                other => panic!("{other:?}"),
            })
            .sum();
        let white = srgb_byte_from_linear(brightest);
        assert!((210..=230).contains(&white), "{white}");
    }

    #[test]
    fn bare_files_with_metals_have_surroundings_to_reflect() {
        let physical = |metallic| Material {
            physical: Some(Physical { metallic, ..Physical::default() }),
            ..Material::default()
        };
        assert!(!has_metals(&[Material::default(), physical(0.0)]));
        assert!(!has_metals(&[Material { unlit: true, ..physical(1.0) }]));
        assert!(has_metals(&[physical(0.0), physical(1.0)]));
        let mut scene = Scene::from_asset("a", "a".into());
        let metal = AssetTraits { has_triangles: true, has_metals: true, ..traits("glb") };
        let outlook = Outlook { up: Some(DVec3::Z), ..Outlook::default() };
        adapt_bare_asset(&mut scene, &[metal], &outlook);
        assert!(scene.lights.is_empty());
        let around = scene.environment.unwrap();
        assert!((around.image_from_world * DVec3::Z).distance(DVec3::Y) < 1e-12 && !around.shown);
    }

    #[test]
    fn dark_bare_files_have_a_light_background() {
        let scan = AssetTraits { has_colors: true, ..traits("laz") };
        let mesh = AssetTraits { has_triangles: true, ..traits("obj") };
        let background = |asset, lightness| {
            let mut scene = Scene::from_asset("a", "a".into());
            let shape = Shape { lightness, ..Shape::default() };
            let outlook = Outlook { shape: Some(&shape), ..Outlook::default() };
            adapt_bare_asset(&mut scene, &[asset], &outlook);
            scene.background
        };
        let usual = Scene::from_asset("a", "a".into()).background;
        assert_eq!(background(scan, 1.0), usual);
        assert_eq!(background(scan, 0.12), usual);
        assert_eq!(background(mesh, 0.12), LIGHT_BACKGROUND, "light is dimmer than colours");
        assert_eq!(background(scan, 0.02), LIGHT_BACKGROUND);
        let bytes = LIGHT_BACKGROUND.map(srgb_byte_from_linear);
        assert_eq!(bytes[..3], [0xc4, 0xca, 0xd0]);
    }

    #[test]
    fn bare_scans_are_unlit_and_upright() {
        let scan = AssetTraits { has_colors: true, ..traits("laz") };
        let bare = || Scene::from_asset("a", "a".into());
        let adapted = |asset| {
            let mut scene = bare();
            adapt_bare_asset(&mut scene, &[asset], &Outlook::default());
            (scene.lights.is_empty(), scene.up == DVec3::Z)
        };
        assert_eq!(adapted(scan), (true, true));
        assert_eq!(adapted(AssetTraits { format: "ply", ..scan }), (true, false));
        assert_eq!(adapted(AssetTraits { has_normals: true, ..scan }), (false, true));
        assert_eq!(adapted(AssetTraits { has_colors: false, ..scan }), (false, true));
        let intensity = AssetTraits { has_colors: false, shows_intensity: true, ..scan };
        assert_eq!(adapted(intensity), (true, true));
        assert_eq!(adapted(AssetTraits { has_triangles: true, ..scan }), (false, true));
    }

    #[test]
    fn scans_are_seen_from_the_scanner() {
        let bounds = Bounds { min: DVec3::new(-2.0, -5.0, -1.0), max: DVec3::new(2.0, -1.0, 3.0) };
        let scan = AssetTraits { has_colors: true, ..traits("e57") };
        let front = |place: DVec3| {
            let mut scene = Scene::from_asset("a", "a".into());
            let sensor = Some(Sensor::Place(place));
            let outlook = Outlook { sensor, bounds, ..Outlook::default() };
            adapt_bare_asset(&mut scene, &[scan], &outlook);
            assert_eq!(scene.up, DVec3::Z);
            scene.front
        };
        assert_eq!(front(DVec3::ZERO), Some(DVec3::Y), "beside it");
        assert_eq!(front(DVec3::new(0.0, -2.0, 9.0)), None, "within or above it");
        assert_eq!(front(DVec3::new(0.0, 1e6, 0.0)), None, "coordinates of a grid");
    }

    #[test]
    fn placements_are_listed_within_instances() {
        let text = r#"{"assets": {"a": {"file": "a.ply"}},
            "nodes": [{"asset": "a", "repeat": {"grid": [2, 1, 1], "step": [10, 0, 0]}}]}"#;
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.ply"), "").unwrap();
        let limits = SceneLimits::default();
        let scene = scene::parse(text, "s", folder.path(), folder.path(), &limits).unwrap();
        let placement = |geometry, x| Placement {
            name: String::new(),
            geometry,
            asset_from_geometry: DAffine3::from_translation(DVec3::new(x, 0.0, 0.0)),
        };
        let lists = [Box::new(vec![placement(1, 1.0), placement(0, 2.0)])];
        let found: Vec<(usize, f64)> = placed(&scene, &lists)
            .map(|placed| (placed.geometry, placed.world_from_geometry.translation.x))
            .collect();
        assert_eq!(found, [(1, -4.0), (0, -3.0), (1, 6.0), (0, 7.0)]);
    }
}
