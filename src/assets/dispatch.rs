//! Which reader a file belongs to: by content first, by extension second.

use std::io::{BufRead, Write};
use std::path::Path;

#[cfg(any(test, fuzzing))]
use super::input::HEAD_BYTES;
use super::input::Input;
use super::warnings::condensed;
use super::{
    Asset, AssetError, ReadOptions, e57, gltf, hair, las, obj, off, pcd, ply, ptx, stl, swc, tck,
    translucent, trk, trx, vtk, xyz,
};

/// Extensions of the formats that are read, in lower case; each may be followed by `.gz`.
pub const FORMATS: &[&str] = &[
    "ply", "las", "laz", "obj", "stl", "gltf", "glb", "xyz", "pts", "csv", "tsv", "txt", "ptx",
    "pcd", "off", "e57", "swc", "tck", "trk", "trx", "vtk", "vtp", "hair",
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
    Gltf,
    Las,
    E57,
    Pcd,
    Ptx,
    Xyz,
    Swc,
    Tck,
    Trk,
    Trx,
    /// The legacy format of VTK.
    Vtk,
    /// The XML format of VTK.
    Vtp,
    Hair,
    /// Known, and not offered: what it is.
    Refused(&'static str),
    Unknown,
}

/// Reads any supported file.
///
/// # Errors
/// See [`AssetError`]; nothing is returned in part.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Asset, AssetError> {
    let name = display_name(path);
    let input = Input::open(path, &name, options)?;
    let format = recognise(&input.origin.head, &name);
    let mut asset = match format {
        Format::Ply => ply::read_from(input, options),
        Format::Obj => obj::read_from(input, options),
        Format::Stl => stl::read_from(input, options),
        Format::Off => off::read_from(input, options),
        Format::Gltf => gltf::read_from(input, options),
        Format::Swc => swc::read_from(input, options),
        Format::Tck => tck::read_from(input, options),
        Format::Trk => trk::read_from(input, options),
        Format::Vtk => vtk::read_legacy(input, options),
        Format::Vtp => vtk::read_xml(input, options),
        Format::Hair => hair::read_from(input, options),
        format @ (Format::Las
        | Format::E57
        | Format::Pcd
        | Format::Ptx
        | Format::Xyz
        | Format::Trx) => {
            if input.origin.exact {
                read_path(format, path, &name, options)
            } else if let Some(read) = streamed(format) {
                read(input.reader, &name, options)
            } else {
                let unpacked = unpack(input)?;
                read_path(format, unpacked.path(), &name, options)
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
            format!(
                "neither its content nor its extension belongs to a known format; {}",
                accepted()
            ),
        )),
    }?;
    if matches!(format, Format::Ply | Format::Off | Format::Vtk | Format::Vtp) {
        translucent::from_vertex_colors(&mut asset, &name, options)?;
    }
    if format != Format::Gltf {
        translucent::fill_unwritten(&mut asset);
    }
    translucent::drop_without_alpha(&mut asset);
    asset.warnings = condensed(asset.warnings.drain(..).map(|text| ("", text)));
    options.progress.report(1.0);
    Ok(asset)
}

/// Whether a file's own bytes decide its content. The answer is no for files that may name others: OBJ, glTF, and PLY with a texture.
pub fn stands_alone(path: &Path, options: &ReadOptions) -> bool {
    let name = display_name(path);
    // A file that cannot be opened has no content to share.
    let Ok(mut input) = Input::open(path, &name, options) else { return false };
    let head = &input.origin.head;
    match recognise(head, &name) {
        Format::Obj => false,
        Format::Gltf => gltf::names_no_files(&mut input.reader),
        Format::Ply => contains(head, b"end_header") && !contains(head, b"TextureFile"),
        _ => true,
    }
}

/// The name of a file in errors.
pub(super) fn display_name(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// The formats whose points can be had some at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InBlocks {
    Ply,
    Las,
}

/// Which of them an opened file has.
pub(super) fn in_blocks(input: &Input) -> Option<InBlocks> {
    match recognise(&input.origin.head, &input.origin.name) {
        Format::Ply => Some(InBlocks::Ply),
        // A file that is compressed once more would have to be unpacked first.
        Format::Las if input.origin.exact => Some(InBlocks::Las),
        _ => None,
    }
}

/// A reader that goes through a file once, from a stream.
type Streamed = fn(Box<dyn BufRead>, &str, &ReadOptions) -> Result<Asset, AssetError>;

/// The readers that need no file to seek in.
fn streamed(format: Format) -> Option<Streamed> {
    match format {
        Format::Pcd => Some(pcd::read_from),
        Format::Ptx => Some(ptx::read_from),
        Format::Xyz => Some(xyz::read_from),
        _ => None,
    }
}

/// The formats whose readers open the file themselves.
fn read_path(
    format: Format,
    path: &Path,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    match format {
        Format::Las => las::read(path, name, options),
        Format::E57 => e57::read(path, name, options),
        Format::Pcd => pcd::read(path, name, options),
        Format::Ptx => ptx::read(path, name, options),
        Format::Trx => trx::read(path, name, options),
        _ => xyz::read(path, name, options),
    }
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

/// Whether a file goes to the reader that its extension names, and to no other because of its content.
#[cfg(any(test, fuzzing))]
pub(crate) fn goes_by_extension(head: &[u8], name: &str) -> bool {
    let head = head.get(..HEAD_BYTES as usize).unwrap_or(head);
    by_extension(&extension(name), head) == Some(recognise(head, name))
}

fn recognise(head: &[u8], name: &str) -> Format {
    if head.is_empty() {
        return Format::Unknown;
    }
    if head.starts_with(ZIP) && extension(name) == "trx" {
        return Format::Trx;
    }
    by_signature(head)
        .or_else(|| by_extension(&extension(name), head))
        .or_else(|| by_text(head))
        .unwrap_or(Format::Unknown)
}

/// First bytes of a ZIP archive. TRX files are some, with an entry or an extension of their own.
const ZIP: &[u8] = b"PK\x03\x04";

/// First bytes that settle it.
const SIGNATURES: [(&[u8], Format); 14] = [
    (b"glTF", Format::Gltf),
    (b"LASF", Format::Las),
    (b"ASTM-E57", Format::E57),
    (b"# .PCD", Format::Pcd),
    (b"NGSP", Format::Refused("an SPZ file holds Gaussian splats, which are not offered yet")),
    (b"DRACO", Format::Refused("Draco compression is not offered")),
    (b"TRACK\0", Format::Trk),
    (b"mrtrix tracks", Format::Tck),
    (b"# vtk DataFile", Format::Vtk),
    (b"HAIR", Format::Hair),
    (b"ISO-10303-21", Format::Refused("a STEP file holds CAD solids, which are not offered")),
    (ZIP, Format::Refused("a ZIP archive (3MF, USDZ, KMZ) is not offered: unpack it")),
    (b"\x89PNG", Format::Refused("is an image, not a scene of points or meshes")),
    (b"\xff\xd8\xff", Format::Refused("is an image, not a scene of points or meshes")),
];

fn by_signature(head: &[u8]) -> Option<Format> {
    if head.starts_with(ZIP) && contains(head, b"header.json") {
        return Some(Format::Trx);
    }
    let signed = SIGNATURES.iter().find(|(signature, _)| head.starts_with(signature));
    if let Some((_, format)) = signed {
        return Some(*format);
    }
    let word = head.split(|byte| byte.is_ascii_whitespace()).next().unwrap_or_default();
    if word == b"ply" {
        return Some(Format::Ply);
    }
    if is_off(word) {
        return Some(Format::Off);
    }
    contains(head, b"<VTKFile").then_some(Format::Vtp)
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
            Format::Refused("a Neurolucida file is not offered: convert it to SWC")
        }
        "xyz" | "pts" | "csv" | "tsv" | "txt" | "asc" => Format::Xyz,
        "swc" => Format::Swc,
        "splat" | "ksplat" | "spz" => Format::Refused("Gaussian splats are not offered yet"),
        "drc" => Format::Refused("Draco compression is not offered"),
        "tck" => Format::Tck,
        "trk" => Format::Trk,
        "trx" => Format::Trx,
        "vtk" => Format::Vtk,
        "vtp" => Format::Vtp,
        "hair" => Format::Hair,
        "vtu" => {
            Format::Refused("unstructured grids of VTK are not offered: convert them to PolyData")
        }
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use proptest::prelude::*;

    use super::*;
    use crate::assets::Geometry;
    use crate::memory::{Admission, HostMemory, Interrupt};

    #[test]
    fn extensions_look_through_gzip_and_case() {
        for name in ["a.PLY", "b.swc", "b.tsv", "b.obj.gz", "c.copc.laz", "d.e.STL", "e.xyz.GZ"] {
            assert!(is_supported_extension(name), "{name}");
        }
        for name in ["ply", "a.gz", "b.asc", "c.ply.bak", "", "d.splat"] {
            assert!(!is_supported_extension(name), "{name}");
        }
    }

    #[test]
    fn content_goes_before_extension() {
        assert_eq!(recognise(b"ply\nformat", "a.obj"), Format::Ply);
        assert_eq!(recognise(b"COFF\n1", "a"), Format::Off);
        assert_eq!(recognise(b"glTF\x02", "a.txt"), Format::Gltf);
        assert_eq!(recognise(b"solid but binary", "a.StL"), Format::Stl);
        assert_eq!(recognise(b"1 2 3\n", "a.xyz.gz"), Format::Xyz);
        assert_eq!(recognise(b"# x\n1.5, 2,3\n", "a"), Format::Xyz);
        assert_eq!(recognise(b"name\tx\ty\tz\n", "a.tsv"), Format::Xyz);
        assert_eq!(recognise(b"v 1 2 3\n", "noext"), Format::Obj);
        assert_eq!(recognise(b" {\"asset\": {}}", "noext"), Format::Gltf);
        assert_eq!(recognise(b"hello", "noext"), Format::Unknown);
        assert!(matches!(recognise(b"; Neurolucida", "a.asc"), Format::Refused(_)));
        assert_eq!(recognise(b"1 2 3", "a.asc"), Format::Xyz);
    }

    fn read_file(name: &str, bytes: &[u8]) -> Result<Asset, AssetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read(&path, &ReadOptions::default())
    }

    fn gz(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn gzipped_files_read_like_plain_ones() {
        let off = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
        for (name, bytes) in [("a.off", off.to_vec()), ("a.off.gz", gz(off)), ("b", gz(off))] {
            let asset = read_file(name, &bytes).unwrap();
            assert!(matches!(&asset.geometries[0], Geometry::Mesh(m) if m.triangles.len() == 1));
            assert_eq!(asset.placements.len(), 1);
        }
    }

    #[test]
    fn every_reader_reserves_before_it_keeps_and_ends_when_it_is_cancelled() {
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 0 0\n0 1 0\n";
        let stl = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n";
        let pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n0 0 0\n1 0 0\n0 1 0\n";
        let ptx = format!(
            "3\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n{}",
            "1 2 3 0.5\n".repeat(3)
        );
        let gltf = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
        let files = [
            ("a.ply", ply),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
            ("a.stl", stl),
            ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
            ("a.xyz", "0 0 0\n1 0 0\n0 1 0\n"),
            ("a.pcd", pcd),
            ("a.ptx", ptx.as_str()),
            ("a.gltf", gltf),
        ];
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            for (name, bytes) in [
                (name.to_owned(), text.as_bytes().to_vec()),
                (format!("{name}.gz"), gz(text.as_bytes())),
            ] {
                let path = folder.path().join(&name);
                std::fs::write(&path, bytes).unwrap();
                let within = |memory: &HostMemory| {
                    let admission = Admission::new(memory);
                    let options =
                        ReadOptions { admission: admission.clone(), ..ReadOptions::default() };
                    (read(&path, &options), admission)
                };
                let (refused, admission) = within(&HostMemory::new(32));
                let is_refused = matches!(
                    refused,
                    Err(AssetError::Interrupted(Interrupt::OutOfMemory(ref error))) if error.is_hopeless()
                );
                assert!(is_refused, "{name}: {refused:?}");
                assert!(admission.held() <= 32);
                let (asset, admission) = within(&HostMemory::new(64 << 20));
                assert!(asset.is_ok(), "{name}: {asset:?}");
                assert!(admission.held() >= 3 * 24, "{name}: {}", admission.held());
                let admission = Admission::default();
                admission.cancel();
                let options = ReadOptions { admission, ..ReadOptions::default() };
                let cancelled = read(&path, &options);
                let is_cancelled =
                    matches!(cancelled, Err(AssetError::Interrupted(Interrupt::Cancelled)));
                assert!(is_cancelled, "{name}: {cancelled:?}");
            }
        }
    }

    #[test]
    fn refusals_say_what_would_be_accepted() {
        for (name, bytes) in [("a.ply", &b""[..]), ("a.splat", b"xxxx"), ("a", b"\0\0\0\0")] {
            let error = read_file(name, bytes).unwrap_err();
            assert!(matches!(error, AssetError::Unsupported { .. }));
            let text = error.to_string();
            assert!(text.starts_with(&format!("{name}: ")) && text.contains("glb"), "{text}");
        }
        let folder = tempfile::tempdir().unwrap();
        assert!(read(folder.path(), &ReadOptions::default()).is_err());
        let missing = read(&folder.path().join("no.ply"), &ReadOptions::default());
        assert!(matches!(missing, Err(AssetError::Io { .. })));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn random_bytes_never_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            extension in prop::sample::select(vec!["ply", "obj", "stl", "off", "gltf", "glb", "swc", "tck", "trk", "trx", "vtk", "vtp", "hair", "x"]),
        ) {
            let _ = read_file(&format!("a.{extension}"), &bytes);
        }
    }
}
