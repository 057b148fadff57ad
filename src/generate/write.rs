//! Writers for generated assets: binary PLY, LAS and LAZ, OBJ with MTL and PNG, VTK and TCK, Radiance HDR, scene files.
//!
//! The files do not depend on the time or the machine: no dates, no identifiers, always little-endian. Points have f64
//! coordinates, meshes f32.

mod strands;

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::{GenerateError, Generated, GeneratedMesh, GeneratedScene};
use crate::assets::fields::{CLASSIFICATION, INTENSITY, Scale};
use crate::assets::{EnvironmentImage, Field, Material, Mesh, PointCloud, Texture};
use crate::math::Bounds;

/// Writes `generated` to `path`, and to further files beside it if the format needs them. Returns all written files.
///
/// # Errors
/// The extension does not fit the asset, or an I/O error occurred. Incomplete files may remain.
pub fn write(generated: &Generated, path: &Path) -> Result<Vec<PathBuf>, GenerateError> {
    let extension =
        path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let refuse =
        |what, accepted| GenerateError::Format { file: path.display().to_string(), what, accepted };
    match (generated, extension.as_str()) {
        (Generated::Points(cloud), "ply") => ply_points(cloud, path),
        (Generated::Points(cloud), "las" | "laz") => las_points(cloud, path, extension == "laz"),
        (Generated::Points(_), _) => Err(refuse("points", ".ply, .las, .laz and .json")),
        (Generated::Mesh(mesh), "ply") if mesh.texture.is_none() => ply_mesh(&mesh.mesh, path),
        (Generated::Mesh(mesh), "obj") => return obj(mesh, path),
        (Generated::Mesh(mesh), _) if mesh.texture.is_some() => {
            return Err(refuse("a textured mesh", ".obj and .json"));
        }
        (Generated::Mesh(_), _) => return Err(refuse("a mesh", ".ply, .obj and .json")),
        (Generated::Lines(lines), "vtk") => strands::vtk(lines, path),
        (Generated::Lines(lines), "tck") => strands::tck(lines, path),
        (Generated::Lines(_), _) => return Err(refuse("lines", ".vtk, .tck and .json")),
        (Generated::Plant(plant), "vtk") => {
            let beside = |end: &str| {
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                path.with_file_name(format!("{stem}-{end}"))
            };
            let (leaves, trunk) = (beside("leaves.vtk"), beside("trunk.ply"));
            strands::vtk(&plant.branches, path)?;
            strands::vtk(&plant.leaves, &leaves)?;
            ply_mesh(&plant.trunk.mesh, &trunk)?;
            return Ok(vec![path.to_owned(), leaves, trunk]);
        }
        (Generated::Plant(_), _) => return Err(refuse("a tree of lines", ".vtk and .json")),
        (Generated::Surroundings(image), "hdr") => radiance(image, path),
        (Generated::Surroundings(_), _) => return Err(refuse("surroundings", ".hdr")),
        (Generated::Scene(scene), "json") => {
            let mut files = vec![path.to_owned()];
            std::fs::write(path, &scene.json).map_err(GenerateError::io(path))?;
            let folder = path.parent().unwrap_or(Path::new(""));
            for (name, asset) in &scene.assets {
                files.extend(write(asset, &folder.join(name))?);
            }
            return Ok(files);
        }
        (Generated::Scene(_), _) => return Err(refuse("a scene", ".json")),
        (Generated::Scenes(scenes), "") => return folder_of(scenes, path),
        (Generated::Scenes(_), _) => return Err(refuse("many scenes", "names of folders")),
    }?;
    Ok(vec![path.to_owned()])
}

fn folder_of(
    scenes: &[(String, GeneratedScene)],
    path: &Path,
) -> Result<Vec<PathBuf>, GenerateError> {
    std::fs::create_dir_all(path).map_err(GenerateError::io(path))?;
    let mut files = Vec::new();
    for (name, scene) in scenes {
        let file = path.join(format!("{name}.json"));
        files.extend(write(&Generated::Scene(scene.clone()), &file)?);
    }
    Ok(files)
}

/// Radiance HDR.
fn radiance(image: &EnvironmentImage, path: &Path) -> Result<(), GenerateError> {
    let pixels: Vec<image::Rgb<f32>> = image.radiance.iter().map(|&rgb| image::Rgb(rgb)).collect();
    image::codecs::hdr::HdrEncoder::new(create(path)?)
        .encode(&pixels, image.width as usize, image.height as usize)
        .map_err(|error| GenerateError::io(path)(std::io::Error::other(error)))
}

fn create(path: &Path) -> Result<BufWriter<File>, GenerateError> {
    Ok(BufWriter::with_capacity(1 << 18, File::create(path).map_err(GenerateError::io(path))?))
}

/// Number of channels of a file's colours: none, three, or four where some alpha is not 255.
#[derive(Clone, Copy)]
struct Channels(usize);

impl Channels {
    fn of(colors: Option<&Vec<[u8; 4]>>) -> Channels {
        let has_alpha = |colors: &Vec<[u8; 4]>| colors.iter().any(|color| color[3] != 255);
        Channels(colors.map_or(0, |colors| if has_alpha(colors) { 4 } else { 3 }))
    }
}

/// Writes the header of a PLY file. The properties of a vertex are in the order of `ply_vertex`.
fn ply_header(
    out: &mut impl Write,
    (count, coordinates): (usize, &str),
    (normals, colors): (bool, Channels),
    fields: &[Field],
    radii: bool,
    triangles: Option<usize>,
) -> std::io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment made by pointillist generate")?;
    writeln!(out, "element vertex {count}")?;
    for axis in ["x", "y", "z"] {
        writeln!(out, "property {coordinates} {axis}")?;
    }
    if normals {
        writeln!(out, "property float nx\nproperty float ny\nproperty float nz")?;
    }
    for channel in ["red", "green", "blue", "alpha"].iter().take(colors.0) {
        writeln!(out, "property uchar {channel}")?;
    }
    for field in fields {
        writeln!(out, "property {} {}", ply_type(field), field.name)?;
    }
    if radii {
        writeln!(out, "property float radius")?;
    }
    if let Some(triangles) = triangles {
        writeln!(out, "element face {triangles}\nproperty list uchar uint vertex_indices")?;
    }
    writeln!(out, "end_header")
}

/// The PLY type of a field's values.
fn ply_type(field: &Field) -> &'static str {
    let Scale { least, step, most, has_gaps } = field.scale;
    let last = least + f64::from(most);
    let is_whole = step == 1.0 && least.fract() == 0.0 && least >= 0.0 && !has_gaps;
    match last {
        last if is_whole && last <= 255.0 && field.name == CLASSIFICATION => "uchar",
        last if is_whole && last <= 65535.0 => "ushort",
        _ => "float",
    }
}

fn ply_points(cloud: &PointCloud, path: &Path) -> Result<(), GenerateError> {
    let mut out = create(path)?;
    let channels = Channels::of(cloud.colors.as_ref());
    let mut body = || -> std::io::Result<()> {
        ply_header(
            &mut out,
            (cloud.positions.len(), "double"),
            (cloud.normals.is_some(), channels),
            cloud.fields.list(),
            cloud.radii.is_some(),
            None,
        )?;
        for (i, p) in cloud.positions.iter().enumerate() {
            for axis in p.to_array() {
                out.write_all(&axis.to_le_bytes())?;
            }
            if let Some(n) = cloud.normals.as_ref().and_then(|list| list.get(i)) {
                out.write_all(bytemuck::cast_slice(&n.to_array().map(f32::to_le_bytes)))?;
            }
            if let Some(color) = cloud.colors.as_ref().and_then(|list| list.get(i)) {
                out.write_all(&color[..channels.0])?;
            }
            for field in cloud.fields.list() {
                let value = field.value(cloud.fields.at(i)).unwrap_or(f64::NAN);
                match ply_type(field) {
                    "uchar" => out.write_all(&[value as u8])?,
                    "ushort" => out.write_all(&(value as u16).to_le_bytes())?,
                    _ => out.write_all(&(value as f32).to_le_bytes())?,
                }
            }
            if let Some(radius) = cloud.radii.as_ref().and_then(|list| list.get(i)) {
                out.write_all(&radius.to_le_bytes())?;
            }
        }
        out.flush()
    };
    body().map_err(GenerateError::io(path))
}

fn ply_mesh(mesh: &Mesh, path: &Path) -> Result<(), GenerateError> {
    let mut out = create(path)?;
    let channels = Channels::of(mesh.colors.as_ref());
    let mut body = || -> std::io::Result<()> {
        ply_header(
            &mut out,
            (mesh.positions.len(), "float"),
            (mesh.normals.is_some(), channels),
            &[],
            false,
            Some(mesh.triangles.len()),
        )?;
        for (i, p) in mesh.positions.iter().enumerate() {
            for axis in p.to_array() {
                out.write_all(&(axis as f32).to_le_bytes())?;
            }
            if let Some(n) = mesh.normals.as_ref().and_then(|list| list.get(i)) {
                out.write_all(bytemuck::cast_slice(&n.to_array().map(f32::to_le_bytes)))?;
            }
            if let Some(color) = mesh.colors.as_ref().and_then(|list| list.get(i)) {
                out.write_all(&color[..channels.0])?;
            }
        }
        for triangle in &mesh.triangles {
            out.write_all(&[3])?;
            out.write_all(bytemuck::cast_slice(&triangle.map(u32::to_le_bytes)))?;
        }
        out.flush()
    };
    body().map_err(GenerateError::io(path))
}

/// Writes LAS 1.2, point format 2 (colour), in whole millimetres.
fn las_points(cloud: &PointCloud, path: &Path, compress: bool) -> Result<(), GenerateError> {
    let fail = |error: las::Error| GenerateError::write(path, error);
    let header = las_header(cloud, compress).map_err(fail)?;
    let mut writer = las::Writer::new(create(path)?, header).map_err(fail)?;
    let mut body = || -> las::Result<()> {
        for index in 0..cloud.positions.len() {
            writer.write_point(las_point(cloud, index)?)?;
        }
        writer.close()
    };
    let result = body();
    if result.is_err() {
        // The writer's destructor would try to finish the file once more, and panic.
        std::mem::forget(writer);
    }
    result.map_err(fail)
}

fn las_header(cloud: &PointCloud, compress: bool) -> las::Result<las::Header> {
    let middle = Bounds::of(cloud.positions.iter().copied()).centre();
    // Offsets in whole kilometres keep millimetres within 32 bits at any place.
    let transform =
        |axis: usize| las::Transform { scale: 0.001, offset: (middle[axis] / 1e3).floor() * 1e3 };
    let mut builder = las::Builder::from((1, 2));
    builder.generating_software = "pointillist generate".to_owned();
    builder.system_identifier = "SIMULATED".to_owned();
    builder.point_format = las::point::Format::new(2)?;
    builder.point_format.is_compressed = compress;
    builder.transforms = las::Vector { x: transform(0), y: transform(1), z: transform(2) };
    builder.into_header()
}

fn las_point(cloud: &PointCloud, index: usize) -> las::Result<las::Point> {
    let p = cloud.positions[index];
    let value = |name: &str, otherwise: f64| cloud.value(name, index).unwrap_or(otherwise);
    let class = value(CLASSIFICATION, 1.0) as u8;
    // Expand eight bits to sixteen so that 255 becomes 65535.
    let [r, g, b, _] = cloud.colors.as_ref().map_or([255; 4], |list| list[index]);
    let [r, g, b] = [r, g, b].map(|c| u16::from(c) * 257);
    Ok(las::Point {
        x: p.x,
        y: p.y,
        z: p.z,
        intensity: value(INTENSITY, 0.0) as u16,
        return_number: 1,
        number_of_returns: 1,
        classification: las::point::Classification::new(class)?,
        color: Some(las::Color::new(r, g, b)),
        ..las::Point::default()
    })
}

/// Writes an OBJ file, with the material in an MTL file and the texture in a PNG file of the same stem.
fn obj(generated: &GeneratedMesh, path: &Path) -> Result<Vec<PathBuf>, GenerateError> {
    let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("mesh");
    let (mtl, image) = (path.with_extension("mtl"), path.with_extension("png"));
    let mut files = vec![path.to_owned()];
    let mut out = create(path)?;
    let has_material = generated.material.is_some() || generated.texture.is_some();
    obj_body(&mut out, &generated.mesh, has_material.then_some(stem))
        .map_err(GenerateError::io(path))?;
    if has_material {
        let material = generated.material.clone().unwrap_or_default();
        let texture = generated.texture.as_ref().map(|_| format!("{stem}.png"));
        let mut text = mtl_text(stem, &material, texture.as_deref());
        for map in &generated.maps {
            let name = format!("{stem}-{}.png", map.texture.name);
            let file = path.with_file_name(&name);
            text.push_str(&format!("{} {name}\n", map.statement));
            png(&map.texture, &file)?;
            files.push(file);
        }
        std::fs::write(&mtl, text).map_err(GenerateError::io(&mtl))?;
        files.push(mtl);
    }
    if let Some(texture) = &generated.texture {
        png(texture, &image)?;
        files.push(image);
    }
    Ok(files)
}

fn obj_body(out: &mut impl Write, mesh: &Mesh, material: Option<&str>) -> std::io::Result<()> {
    writeln!(out, "# made by pointillist generate")?;
    if let Some(name) = material {
        writeln!(out, "mtllib {name}.mtl\nusemtl {name}")?;
    }
    for p in &mesh.positions {
        writeln!(out, "v {:.5} {:.5} {:.5}", p.x, p.y, p.z)?;
    }
    for uv in mesh.uvs.iter().flatten() {
        // OBJ counts v from the bottom.
        writeln!(out, "vt {:.5} {:.5}", uv.x, 1.0 - uv.y)?;
    }
    for n in mesh.normals.iter().flatten() {
        writeln!(out, "vn {:.4} {:.4} {:.4}", n.x, n.y, n.z)?;
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| {
            let i = u64::from(index) + 1;
            match (mesh.uvs.is_some(), mesh.normals.is_some()) {
                (true, true) => format!("{i}/{i}/{i}"),
                (true, false) => format!("{i}/{i}"),
                (false, true) => format!("{i}//{i}"),
                (false, false) => format!("{i}"),
            }
        });
        writeln!(out, "f {a} {b} {c}")?;
    }
    out.flush()
}

fn mtl_text(name: &str, material: &Material, texture: Option<&str>) -> String {
    let [r, g, b, _] = material.base_color;
    let [sr, sg, sb] = material.specular;
    let mut text = format!(
        "# made by pointillist generate\nnewmtl {name}\nKd {r:.4} {g:.4} {b:.4}\n\
         Ks {sr:.4} {sg:.4} {sb:.4}\nNs {:.1}\nd 1.0\nillum 2\n",
        material.shininess
    );
    if let Some(own) = &material.physical {
        text.push_str(&format!("Pr {:.4}\nPm {:.4}\n", own.roughness, own.metallic));
        if own.transmission > 0.0 {
            let [r, g, b] = own.volume.map(|channel| channel * own.transmission);
            text.push_str(&format!("Tf {r:.4} {g:.4} {b:.4}\n"));
        }
    }
    if material.emissive != [0.0; 3] {
        let [r, g, b] = material.emissive;
        text.push_str(&format!("Ke {r:.4} {g:.4} {b:.4}\n"));
    }
    if let Some(texture) = texture {
        text.push_str(&format!("map_Kd {texture}\n"));
    }
    text
}

/// Writes an 8-bit RGB PNG.
fn png(texture: &Texture, path: &Path) -> Result<(), GenerateError> {
    let fail = |error: png::EncodingError| GenerateError::write(path, error);
    let mut encoder = png::Encoder::new(create(path)?, texture.width, texture.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().map_err(fail)?;
    let rgb: Vec<u8> = texture.rgba.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    writer.write_image_data(&rgb).map_err(fail)?;
    writer.finish().map_err(fail)
}
