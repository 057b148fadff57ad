//! Readers of files: each extension, points in blocks, and the files that an asset names.

use std::cell::OnceCell;
use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::{Run, assert_finite};
use crate::assets::{
    Asset, AssetError, EnvironmentImage, Field, Fields, Geometry, Mesh, PointBlocks, PointCloud,
    Polylines, ReadOptions, goes_by_extension, read,
};
use crate::memory::{Admission, HostMemory};

pub const TARGETS: &[(&str, Run)] = &[
    ("ply-blocks", |data| read_blocks("ply", data)),
    ("las-blocks", |data| read_blocks("las", data)),
    ("mtl", read_materials),
    ("texture", read_texture),
    ("environment", read_environment),
];

/// Memory of a load. A file of a few KiB that needs more is a defect, or is refused.
const BUDGET_BYTES: u64 = 64 << 20;
/// Bytes that a reader may keep without having reserved them.
const SLACK_BYTES: u64 = 1 << 20;
/// Gzipped files are read as well where this divides the length of the input.
const GZIPPED_EVERY: usize = 8;

fn options() -> ReadOptions {
    ReadOptions {
        max_vertices: 1 << 20,
        max_triangles: 1 << 20,
        max_texels: 1 << 20,
        max_decompressed_bytes: 8 << 20,
        admission: Admission::new(&HostMemory::new(BUDGET_BYTES)),
        ..ReadOptions::default()
    }
}

/// Calls `use_folder` with a folder of this thread's own.
fn in_folder(use_folder: impl FnOnce(&Path)) {
    thread_local! {
        static FOLDER: OnceCell<tempfile::TempDir> = const { OnceCell::new() };
    }
    FOLDER.with(|folder| {
        use_folder(folder.get_or_init(|| tempfile::tempdir().unwrap()).path());
    });
}

/// Calls `use_file` with a file of these bytes, unless they belong to another format than the extension's.
fn in_file(extension: &str, data: &[u8], use_file: impl FnOnce(&Path)) {
    let name = format!("a.{extension}");
    if goes_by_extension(data, &name) {
        in_folder(|folder| {
            let path = folder.join(&name);
            std::fs::write(&path, data).unwrap();
            use_file(&path);
        });
    }
}

/// Reads a file with this extension. A file whose content belongs to another format is that format's target's.
pub fn read_as(extension: &str, data: &[u8]) {
    in_file(extension, data, |path| {
        let asset = checked(path);
        let is_gzipped = data.starts_with(&[0x1f, 0x8b]);
        if !is_gzipped && data.len().is_multiple_of(GZIPPED_EVERY) {
            // Compression is seen by the content, so that the name, which warnings have, may stay.
            std::fs::write(path, gzipped(data)).unwrap();
            match (&asset, &checked(path)) {
                (Some(plain), Some(gzipped)) => {
                    // How much of a compressed file is ignored is not known.
                    let content = |asset: &Asset| Asset { warnings: Vec::new(), ..asset.clone() };
                    let [plain, gzipped] = [plain, gzipped].map(content);
                    assert_eq!(format!("{plain:?}"), format!("{gzipped:?}"));
                }
                (None, None) => {}
                _ => panic!("the file and the gzipped file differ in whether they are read"),
            }
        }
    });
}

/// What a file holds, whose content alone tells its format.
pub fn any_asset(data: &[u8]) -> Option<Asset> {
    let mut asset = None;
    in_folder(|folder| {
        let path = folder.join("any");
        std::fs::write(&path, data).unwrap();
        asset = read(&path, &options()).ok();
    });
    asset
}

/// A gzipped file without compression, which is made faster.
fn gzipped(data: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    encoder.write_all(data).unwrap();
    encoder.finish().unwrap()
}

/// Reads a file and checks the asset, or that the error names the file.
fn checked(path: &Path) -> Option<Asset> {
    let options = options();
    match read(path, &options) {
        Ok(asset) => {
            check(&asset);
            let (kept, reserved) = (kept_bytes(&asset), options.admission.held());
            assert!(kept <= reserved + SLACK_BYTES, "{kept} bytes kept, {reserved} reserved");
            Some(asset)
        }
        Err(error) => {
            refused(&error, path);
            None
        }
    }
}

fn refused(error: &AssetError, path: &Path) {
    if let AssetError::Interrupted(_) = error {
        return;
    }
    let (text, name) = (error.to_string(), path.file_name().unwrap().to_string_lossy());
    assert!(text.starts_with(&format!("{name}: ")), "{text}");
    assert!(text.len() < 4096, "{} bytes of error: {text:.200}", text.len());
}

/// Bytes of the large arrays.
fn kept_bytes(asset: &Asset) -> u64 {
    let geometry = |geometry: &Geometry| match geometry {
        Geometry::Points(points) => size_of_val(&points.positions[..]),
        Geometry::Mesh(mesh) => size_of_val(&mesh.positions[..]) + size_of_val(&mesh.triangles[..]),
        Geometry::Lines(lines) => size_of_val(&lines.positions[..]),
    };
    let texels = asset.textures.iter().map(|texture| size_of_val(&texture.rgba[..]));
    (asset.geometries.iter().map(geometry).sum::<usize>() + texels.sum::<usize>()) as u64
}

fn check(asset: &Asset) {
    for geometry in &asset.geometries {
        match geometry {
            Geometry::Points(points) => check_points(points),
            Geometry::Mesh(mesh) => check_mesh(mesh, asset.materials.len()),
            Geometry::Lines(lines) => check_lines(lines),
        }
    }
    for placement in &asset.placements {
        assert!(placement.geometry < asset.geometries.len(), "a placement has no geometry");
    }
    for material in &asset.materials {
        let physical = material.physical.and_then(|own| own.map);
        let maps = [material.normal_map, material.occlusion_map];
        let maps = maps.into_iter().flatten().map(|map| map.texture);
        let named = [material.base_texture, material.emissive_map, physical];
        for texture in named.into_iter().flatten().chain(maps) {
            assert!((texture as usize) < asset.textures.len(), "a material has no texture");
        }
    }
    for texture in &asset.textures {
        let texels = u64::from(texture.width) * u64::from(texture.height);
        assert_eq!(texture.rgba.len() as u64, texels, "{}", texture.name);
    }
    assert_finite(&(&asset.materials, &asset.placements, &asset.cameras, &asset.sensor));
}

fn check_positions(positions: &[DVec3]) {
    assert!(positions.iter().all(|position| position.is_finite()), "a position is not finite");
}

fn check_normals(normals: Option<&[Vec3]>, count: usize) {
    let Some(normals) = normals else { return };
    assert_eq!(normals.len(), count, "normals");
    let is_unit = |normal: &Vec3| *normal == Vec3::ZERO || (normal.length() - 1.0).abs() < 1e-3;
    assert!(normals.iter().all(is_unit), "a normal is neither of unit length nor zero");
}

fn check_count<T>(list: Option<&[T]>, count: usize, what: &str) {
    assert!(list.is_none_or(|list| list.len() == count), "there is not one of {what} a vertex");
}

fn check_fields(fields: &Fields, count: usize) {
    if !fields.is_empty() {
        assert_eq!(fields.points(), count, "fields");
    }
    let mut names: Vec<&String> = fields.list().iter().map(|field| &field.name).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|pair| pair[0] < pair[1]), "two fields have one name");
    let of_point = |point: usize, field: &Field| field.value(fields.at(point));
    for point in 0..fields.points() {
        let values = fields.list().iter().filter_map(|field| of_point(point, field));
        assert!(values.into_iter().all(f64::is_finite), "a value of point {point} is not finite");
    }
}

fn check_points(points: &PointCloud) {
    let count = points.positions.len();
    check_positions(&points.positions);
    check_normals(points.normals.as_deref(), count);
    check_count(points.colors.as_deref(), count, "colours");
    check_count(points.radii.as_deref(), count, "radii");
    check_count(points.kernels.as_deref(), count, "kernels");
    check_count(points.clips.as_deref(), count, "clips");
    check_fields(&points.fields, count);
    let mut radii = points.radii.iter().flatten();
    assert!(radii.all(|radius| radius.is_finite() && *radius > 0.0), "a radius is not positive");
    let mut kernels = points.kernels.iter().flatten();
    assert!(kernels.all(|kernel| kernel.u.is_finite() && kernel.v.is_finite()), "a kernel");
}

fn check_mesh(mesh: &Mesh, materials: usize) {
    let count = mesh.positions.len();
    check_positions(&mesh.positions);
    check_normals(mesh.normals.as_deref(), count);
    check_count(mesh.colors.as_deref(), count, "colours");
    check_count(mesh.uvs.as_deref(), count, "texture coordinates");
    let mut uvs = mesh.uvs.iter().flatten();
    assert!(uvs.all(|uv| uv.is_finite()), "a texture coordinate is not finite");
    let mut corners = mesh.triangles.iter().flatten();
    assert!(corners.all(|&corner| (corner as usize) < count), "a corner has no vertex");
    if !mesh.parts.is_empty() {
        let covered: u64 = mesh.parts.iter().map(|part| u64::from(part.triangles)).sum();
        assert_eq!(covered, mesh.triangles.len() as u64, "parts");
    }
    let mut named = mesh.parts.iter().filter_map(|part| part.material);
    assert!(named.all(|material| (material as usize) < materials), "a part has no material");
}

fn check_lines(lines: &Polylines) {
    let count = lines.positions.len();
    check_positions(&lines.positions);
    check_normals(lines.normals.as_deref(), count);
    check_count(lines.colors.as_deref(), count, "colours");
    check_count(lines.radii.as_deref(), count, "radii");
    check_fields(&lines.fields, count);
    let mut radii = lines.radii.iter().flatten();
    assert!(radii.all(|radius| radius.is_finite() && *radius >= 0.0), "a radius is negative");
    let strands = &lines.strands;
    assert!(strands.windows(2).all(|pair| pair[0] + 2 <= pair[1]), "a strand is no line");
    assert_eq!(strands.first().map_or(0, |&first| first), 0, "vertices before the first strand");
    assert_eq!(strands.last().map_or(0, |&last| last as usize), count, "vertices of no strand");
}

/// Reads points some at a time, and all at once.
fn read_blocks(extension: &str, data: &[u8]) {
    in_file(extension, data, |path| {
        let options = options();
        let mut positions = Vec::new();
        let blocks = PointBlocks::open(path, &options).and_then(|blocks| {
            let Some(blocks) = blocks else { return Ok(false) };
            let survey = blocks.survey()?;
            let mut visit = |cloud: PointCloud| {
                check_points(&cloud);
                positions.extend(cloud.positions);
                Ok(())
            };
            blocks.each(&survey, &mut visit).map(|()| true)
        });
        match blocks {
            Ok(true) => {}
            Ok(false) => return,
            Err(error) => return refused(&error, path),
        }
        // A whole file may be refused for what a piece of it does not need.
        let Some(asset) = checked(path) else { return };
        let [Geometry::Points(points)] = &asset.geometries[..] else {
            panic!("a file of points is {} geometries", asset.geometries.len())
        };
        assert_eq!(points.positions, positions);
    });
}

/// Reads the materials that an OBJ file names.
fn read_materials(data: &[u8]) {
    const MESH: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 3/3 2/2 1/1\n";
    in_folder(|folder| {
        let path = folder.join("named.obj");
        std::fs::write(&path, MESH).unwrap();
        std::fs::write(folder.join("a.mtl"), data).unwrap();
        assert!(checked(&path).is_some(), "damaged materials are warnings");
    });
}

/// Reads the texture that an OBJ file's material names. The first byte chooses between names with and without a format.
fn read_texture(data: &[u8]) {
    const MESH: &str = "mtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n";
    let name = if data.starts_with(b"\0") { "t.tga" } else { "t.png" };
    in_folder(|folder| {
        let path = folder.join("textured.obj");
        std::fs::write(&path, MESH).unwrap();
        std::fs::write(folder.join("b.mtl"), format!("newmtl a\nmap_Kd {name}\n")).unwrap();
        std::fs::write(folder.join(name), data).unwrap();
        assert!(checked(&path).is_some(), "a damaged texture is a warning");
    });
}

fn read_environment(data: &[u8]) {
    in_folder(|folder| {
        let path = folder.join("a.hdr");
        std::fs::write(&path, data).unwrap();
        match EnvironmentImage::read(&path, &options()) {
            Ok(image) => {
                let texels = u64::from(image.width) * u64::from(image.height);
                assert_eq!(image.radiance.len() as u64, texels);
                let mut light = image.radiance.iter().flatten();
                assert!(light.all(|light| light.is_finite() && *light >= 0.0));
            }
            Err(error) => refused(&error, &path),
        }
    });
}
