//! Which reader a file belongs to: by content first, by extension second.

use std::io::Write;
use std::path::Path;

use super::input::Input;
use super::{Asset, AssetError, ReadOptions, gltf, obj, off, ply, stl};

/// Extensions of the formats that are read, in lower case; each may be followed by `.gz`.
pub const FORMATS: &[&str] = &[
    "ply", "las", "laz", "obj", "stl", "gltf", "glb", "xyz", "pts", "csv", "txt", "ptx", "pcd", "off",
    "e57",
];

/// Whether a file of this name is worth offering to [`read`].
pub fn is_supported_extension(name: &str) -> bool {
    FORMATS.contains(&extension(name).as_str())
}

/// The extension in lower case, looking through `.gz`.
fn extension(name: &str) -> String {
    let lower = name.to_ascii_lowercase();
    let inner = lower.strip_suffix(".gz").unwrap_or(&lower);
    inner.rsplit_once('.').map_or(String::new(), |(_, extension)| extension.to_owned())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Obj,
    Stl,
    Off,
    Glb,
    Gltf,
    Las,
    E57,
    Pcd,
    Ptx,
    Xyz,
    /// Known, and not offered: what it is.
    Refused(&'static str),
    Unknown,
}

/// Reads any supported file.
///
/// # Errors
/// See [`AssetError`]; nothing is returned in part.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Asset, AssetError> {
    let name = path.file_name().map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    );
    let input = Input::open(path, &name, options)?;
    let asset = match recognise(&input.origin.head, &name) {
        Format::Ply => ply::read_from(input, options),
        Format::Obj => obj::read_from(input, options),
        Format::Stl => stl::read_from(input, options),
        Format::Off => off::read_from(input, options),
        Format::Glb | Format::Gltf => gltf::read_from(input, options),
        format @ (Format::Las | Format::E57 | Format::Pcd | Format::Ptx | Format::Xyz) => {
            if input.origin.exact {
                read_samples(format, path, &name, options)
            } else {
                let unpacked = unpack(input)?;
                read_samples(format, unpacked.path(), &name, options)
            }
        }
        Format::Refused(what) => {
            Err(AssetError::unsupported(&name, format!("{what}; {}", accepted())))
        }
        Format::Unknown if input.origin.head.is_empty() => {
            Err(AssetError::unsupported(&name, format!("the file is empty; {}", accepted())))
        }
        Format::Unknown => Err(AssetError::unsupported(
            &name,
            format!("neither content nor extension belong to a known format; {}", accepted()),
        )),
    }?;
    options.progress.report(1.0);
    Ok(asset)
}

/// The formats that hold samples only.
fn read_samples(
    format: Format,
    path: &Path,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let _ = (path, options);
    Err(AssetError::unsupported(name, format!("{format:?} files are not read yet; {}", accepted())))
}

fn accepted() -> String {
    format!("accepted are {} and each of them gzipped", FORMATS.join(", "))
}

/// Decompresses into a temporary file, for readers that seek.
fn unpack(mut input: Input) -> Result<tempfile::NamedTempFile, AssetError> {
    let fail = |source| AssetError::io(&input.origin.name, source);
    let mut file = tempfile::NamedTempFile::new().map_err(fail)?;
    std::io::copy(&mut input.reader, &mut file).map_err(fail)?;
    file.flush().map_err(fail)?;
    Ok(file)
}

fn recognise(head: &[u8], name: &str) -> Format {
    let extension = extension(name);
    if head.is_empty() {
        return Format::Unknown;
    }
    if let Some(format) = by_signature(head) {
        return format;
    }
    if let Some(format) = by_extension(&extension, head) {
        return format;
    }
    by_text(head).unwrap_or(Format::Unknown)
}

/// Formats whose first bytes settle it.
fn by_signature(head: &[u8]) -> Option<Format> {
    const SPLATS: &str = "Gaussian splats (SPZ) are not offered yet";
    const LINES: &str = "lines are not offered yet";
    let starts = |signature: &[u8]| head.starts_with(signature);
    let first_word = head.split(|byte| byte.is_ascii_whitespace()).next().unwrap_or_default();
    Some(match head {
        _ if first_word == b"ply" => Format::Ply,
        _ if starts(b"glTF") => Format::Glb,
        _ if starts(b"LASF") => Format::Las,
        _ if starts(b"ASTM-E57") => Format::E57,
        _ if starts(b"# .PCD") => Format::Pcd,
        _ if starts(b"NGSP") => Format::Refused(SPLATS),
        _ if starts(b"DRACO") => Format::Refused("Draco compression is not offered"),
        _ if starts(b"TRACK\0") => Format::Refused("a TrackVis file holds streamlines; lines are not offered yet"),
        _ if starts(b"mrtrix tracks") => Format::Refused("an MRtrix file holds streamlines; lines are not offered yet"),
        _ if starts(b"# vtk DataFile") => Format::Refused("legacy VTK files are not offered"),
        _ if contains(head, b"<VTKFile") => Format::Refused("VTK's XML files are not offered"),
        _ if starts(b"ISO-10303-21") => Format::Refused("STEP files hold CAD solids, which are not offered"),
        _ if starts(b"Kaydara FBX") => Format::Refused("FBX files are not offered"),
        _ if starts(b"PK\x03\x04") => Format::Refused("a ZIP archive (3MF, USDZ, KMZ …) is not offered: unpack it"),
        _ if starts(b"\x89PNG") || starts(b"\xff\xd8\xff") => Format::Refused("this is an image, not a scene of points or meshes"),
        _ if is_off(first_word) => Format::Off,
        _ if is_swc(head) => Format::Refused(LINES),
        _ => return None,
    })
}

fn contains(head: &[u8], needle: &[u8]) -> bool {
    head.windows(needle.len()).any(|window| window == needle)
}

fn is_off(word: &[u8]) -> bool {
    word.len() <= 8
        && word.strip_suffix(b"OFF").is_some_and(|prefix| {
            prefix.iter().all(|byte| matches!(byte, b'S' | b'T' | b'C' | b'N' | b'4' | b'n'))
        })
}

fn is_swc(_head: &[u8]) -> bool {
    false
}

fn by_extension(extension: &str, head: &[u8]) -> Option<Format> {
    Some(match extension {
        "ply" => Format::Ply,
        "obj" => Format::Obj,
        "stl" => Format::Stl,
        "off" => Format::Off,
        "gltf" | "glb" => Format::Gltf,
        "las" | "laz" => Format::Las,
        "e57" => Format::E57,
        "pcd" => Format::Pcd,
        "ptx" => Format::Ptx,
        "asc" if matches!(head.first(), Some(b';' | b'(')) => {
            Format::Refused("a Neurolucida file holds traced lines; lines are not offered yet")
        }
        "xyz" | "pts" | "csv" | "txt" | "asc" => Format::Xyz,
        "swc" => Format::Refused("an SWC file holds traced lines; lines are not offered yet"),
        "splat" | "ksplat" | "spz" => Format::Refused("Gaussian splats are not offered yet"),
        "drc" => Format::Refused("Draco compression is not offered"),
        "trk" | "tck" => Format::Refused("streamlines are not offered yet"),
        "vtk" | "vtp" | "vtu" => Format::Refused("VTK files are not offered"),
        _ => return None,
    })
}

/// Text without a signature under a name that says nothing.
fn by_text(head: &[u8]) -> Option<Format> {
    let text = std::str::from_utf8(head.get(..512).unwrap_or(head)).ok()?;
    if text.trim_start().starts_with('{') && contains(head, b"\"asset\"") {
        return Some(Format::Gltf);
    }
    if text.trim_start().starts_with("solid") && contains(head, b"facet") {
        return Some(Format::Stl);
    }
    let line = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#'))?;
    let first = line.split_whitespace().next()?;
    if ["v", "vn", "vt", "mtllib", "o", "g", "usemtl"].contains(&first) {
        return Some(Format::Obj);
    }
    let mut columns = line.split([' ', '\t', ',', ';']).filter(|column| !column.is_empty());
    let numbers = columns.by_ref().take(3).filter(|column| column.parse::<f64>().is_ok()).count();
    (numbers == 3).then_some(Format::Xyz)
}
