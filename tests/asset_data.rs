//! Tests with real files: every mesh and PLY file loads with the counts and bounds that its source gives, and every broken one is
//! refused with a message. `POINTILLIST_DATA` names the folder. Without it, or `../shared/data` beside the checkout, these tests
//! print "skipped" and pass.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that unwraps says where it failed"
)]

use std::path::PathBuf;

use pointillist::assets::{self, Asset, AssetError, Geometry, ReadOptions};

fn data() -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    let folder = std::env::var_os("POINTILLIST_DATA").unwrap_or_else(|| beside.into());
    let folder = PathBuf::from(folder);
    if !folder.is_dir() {
        println!("skipped: no folder {}", folder.display());
        return None;
    }
    Some(folder)
}

/// File, number of vertices, number of triangles (0 for a point cloud), bounds.
type Expected = (&'static str, usize, usize, [f64; 6]);

const CLEAN: &[Expected] = &[
    (
        "scans/bun_zipper.ply",
        35947,
        69451,
        [-0.09469, 0.032987, -0.061874, 0.061009, 0.18732, 0.0588],
    ),
    (
        "scans/bun_zipper_res4.ply",
        453,
        948,
        [-0.093147, 0.03362, -0.056644, 0.058159, 0.1819, 0.057801],
    ),
    ("scans/armadillo.obj", 43243, 86482, [-0.43528, -0.5734, -0.37948, 0.40334, 0.42655, 0.38333]),
    (
        "scans/dragon_vrip.ply.gz",
        437645,
        871414,
        [-0.10832, 0.052729, -0.050414, 0.096566, 0.19717, 0.041208],
    ),
    (
        "scans/dragon_vrip_res4.ply.gz",
        5205,
        11102,
        [-0.10759, 0.052844, -0.049836, 0.095236, 0.19634, 0.040826],
    ),
    ("scans/laurana.ply", 25160, 50000, [-225.84, -241.81, -123.56, 241.8, 254.35, 136.5]),
    (
        "pointclouds/b9_training.ply",
        22300,
        0,
        [596650.0, 243620.0, 73.502, 596740.0, 243730.0, 97.186],
    ),
    ("lines/722817260.ply", 17875, 36127, [3424.1, 11584.0, 10288.0, 22185.0, 37470.0, 28079.0]),
    (
        "textured/bunny_attribute_color.ply",
        6056,
        12000,
        [-0.094758, 0.032987, -0.061868, 0.061038, 0.18734, 0.058831],
    ),
    ("textured/BoxTextured.glb", 24, 12, [-0.5, -0.5, -0.5, 0.5, 0.5, 0.5]),
    ("cad/cycloidal.ply", 21384, 43368, [0.23955, -0.33863, 0.81065, 2.1145, 1.536, 1.9176]),
    ("cad/fandisk.obj", 6475, 12946, [0.0, 12.605, -2.6803, 4.8279, 17.85, 0.0]),
    ("cad/three_cylinders.obj", 600, 1188, [-0.25, -0.35507, -0.05, 0.46812, 0.36522, 0.05]),
    ("cad/anchor_dense.off", 3793, 7598, [-0.5, -0.3125, -0.42829, 0.5, 0.3125, 0.42829]),
];

/// Scans of the bunny from several sides, below `scans/bunny_range`.
const RANGES: &[Expected] = &[
    ("bun000.ply", 40256, 0, [-0.09475, 0.035736, -0.058698, 0.061, 0.18794, 0.058723]),
    ("bun045.ply", 40097, 0, [-0.06325, 0.034209, -0.045165, 0.084, 0.18764, 0.093523]),
    ("bun090.ply", 30379, 0, [-0.05925, 0.035003, -0.074846, 0.062, 0.18793, 0.060868]),
    ("bun180.ply", 40251, 0, [-0.0615, 0.034092, -0.033928, 0.09475, 0.1876, 0.061187]),
    ("bun270.ply", 31701, 0, [-0.06225, 0.034715, -0.011259, 0.059, 0.18762, 0.094291]),
    ("bun315.ply", 35336, 0, [-0.0735, 0.034122, -0.019493, 0.0735, 0.18693, 0.10063]),
    ("chin.ply", 37738, 0, [-0.07125, 0.034043, -0.015159, 0.1035, 0.16643, 0.14482]),
    ("ear_back.ply", 32193, 0, [-0.084, 0.02579, 0.0037326, 0.1065, 0.18751, 0.11512]),
    ("top2.ply", 38298, 0, [-0.0675, 0.038349, -0.013399, 0.105, 0.1662, 0.12895]),
    ("top3.ply", 36023, 0, [-0.104, 0.035403, -0.018245, 0.089, 0.14725, 0.12377]),
];

fn counts(asset: &Asset) -> (usize, usize) {
    asset.geometries.iter().fold((0, 0), |(vertices, triangles), geometry| {
        let more = match geometry {
            Geometry::Points(_) | Geometry::Lines(_) => 0,
            Geometry::Mesh(mesh) => mesh.triangles.len(),
        };
        (vertices + geometry.positions().len(), triangles + more)
    })
}

/// Checks the invariants of every reader.
fn check_invariants(name: &str, asset: &Asset) {
    for geometry in &asset.geometries {
        let count = geometry.positions().len();
        assert!(count > 0 && geometry.positions().iter().all(|p| p.is_finite()), "{name}");
        let lengths = match geometry {
            Geometry::Points(cloud) => [
                cloud.colors.as_ref().map(Vec::len),
                cloud.normals.as_ref().map(Vec::len),
                (!cloud.fields.is_empty()).then(|| cloud.fields.points()),
                None,
                cloud.radii.as_ref().map(Vec::len),
            ],
            Geometry::Mesh(mesh) => {
                assert!(mesh.triangles.iter().flatten().all(|i| (*i as usize) < count), "{name}");
                let in_parts: usize = mesh.parts.iter().map(|part| part.triangles as usize).sum();
                assert!(mesh.parts.is_empty() || in_parts == mesh.triangles.len(), "{name}");
                for part in &mesh.parts {
                    assert!(part.material.is_none_or(|m| (m as usize) < asset.materials.len()));
                }
                let colors = mesh.colors.as_ref().map(Vec::len);
                let normals = mesh.normals.as_ref().map(Vec::len);
                [colors, normals, mesh.uvs.as_ref().map(Vec::len), None, None]
            }
            Geometry::Lines(lines) => {
                assert!(lines.strands.windows(2).all(|ends| ends[0] + 2 <= ends[1]), "{name}");
                assert_eq!(lines.strands.last().map(|&last| last as usize), Some(count), "{name}");
                [
                    lines.colors.as_ref().map(Vec::len),
                    lines.normals.as_ref().map(Vec::len),
                    (!lines.fields.is_empty()).then(|| lines.fields.points()),
                    None,
                    lines.radii.as_ref().map(Vec::len),
                ]
            }
        };
        assert!(lengths.into_iter().flatten().all(|length| length == count), "{name}");
    }
    for material in &asset.materials {
        assert!(material.base_texture.is_none_or(|t| (t as usize) < asset.textures.len()));
    }
    for placement in &asset.placements {
        assert!(placement.geometry < asset.geometries.len(), "{name}");
    }
}

fn load(folder: &std::path::Path, name: &str) -> Asset {
    let start = std::time::Instant::now();
    let asset = assets::read(&folder.join(name), &ReadOptions::default())
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    check_invariants(name, &asset);
    let (vertices, triangles) = counts(&asset);
    println!("{name}: {vertices} vertices, {triangles} triangles, {:?}", start.elapsed());
    for warning in &asset.warnings {
        println!("    {warning}");
    }
    asset
}

#[test]
fn clean_files_have_their_counts_and_bounds() {
    let Some(folder) = data() else { return };
    let ranges = folder.join("scans/bunny_range");
    let clean = CLEAN.iter().map(|expected| (&folder, expected));
    for (folder, (name, vertices, triangles, bounds)) in
        clean.chain(RANGES.iter().map(|expected| (&ranges, expected)))
    {
        let asset = load(folder, name);
        assert_eq!(counts(&asset), (*vertices, *triangles), "{name}");
        let found = asset.bounds();
        let found = [found.min.to_array(), found.max.to_array()].concat();
        for (found, expected) in found.iter().zip(bounds) {
            // The sources give five significant digits.
            let tolerance = expected.abs().max(0.01) * 1e-4;
            assert!((found - expected).abs() <= tolerance, "{name}: {found} {expected}");
        }
    }
}

#[test]
fn scans_carry_their_attributes() {
    let Some(folder) = data() else { return };
    let Geometry::Mesh(laurana) = &load(&folder, "scans/laurana.ply").geometries[0] else {
        panic!("laurana is a mesh")
    };
    assert!(laurana.colors.is_some());
    let normals = laurana.normals.as_ref().expect("laurana has normals");
    assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5));
    let Geometry::Points(street) = &load(&folder, "pointclouds/b9_training.ply").geometries[0]
    else {
        panic!("b9_training is a cloud")
    };
    assert!(street.colors.is_some() && street.field("classification").is_some());
    let Geometry::Mesh(bunny) = &load(&folder, "textured/bunny_attribute_color.ply").geometries[0]
    else {
        panic!("the bunny is a mesh")
    };
    let colors = bunny.colors.as_ref().expect("the bunny has colours");
    assert!(colors.iter().any(|color| *color != colors[0]));
}

#[test]
fn textured_files_have_their_textures() {
    let Some(folder) = data() else { return };
    for (name, triangles, textures, size) in [
        ("textured/capsule/capsule.obj", 10200, 1, [2048, 1024]),
        ("textured/fuze/fuze.obj", 1000, 1, [1024, 1024]),
        ("textured/BoxTextured.glb", 12, 1, [256, 256]),
        ("trees/tree-lime-2-0.glb", 919, 1, [0, 0]),
        ("textured/statue.glb", 16259, 2, [0, 0]),
        ("textured/CesiumMilkTruck.glb", 2856, 1, [0, 0]),
        ("textured/spot/spot_triangulated.obj", 5856, 0, [0, 0]),
        ("textured/spot/spot_quadrangulated.obj", 5856, 0, [0, 0]),
    ] {
        let asset = load(&folder, name);
        assert_eq!(counts(&asset).1, triangles, "{name}");
        assert_eq!(asset.textures.len(), textures, "{name}");
        if size[0] > 0 {
            let texture = &asset.textures[0];
            assert_eq!([texture.width, texture.height], size, "{name}");
        }
        assert!(asset.geometries.iter().any(|g| matches!(g, Geometry::Mesh(m) if m.uvs.is_some())));
    }
    let truck = load(&folder, "textured/CesiumMilkTruck.glb");
    assert_eq!((truck.geometries.len(), truck.placements.len()), (4, 5));
    assert_eq!(truck.materials.len(), 4);
}

#[test]
fn odd_meshes_load() {
    let Some(folder) = data() else { return };
    let almond = load(&folder, "trees/AlmondWP.obj.gz");
    assert_eq!(counts(&almond).1, 165_236);
    assert_eq!(almond.materials.len(), 2);
    let coloured = load(&folder, "pointclouds/same_cloud_many_formats/1.2-with-color.obj");
    assert_eq!(counts(&coloured).1, 1672);
    // 1640 statements name 1272 different materials.
    assert_eq!(coloured.materials.len(), 1272);
    let part = load(&folder, "cad/featuretype.STL");
    assert_eq!(counts(&part).1, 3476);
    assert_eq!(counts(&load(&folder, "cad/ADIS16480.STL")).1, 7436);
    assert_eq!(counts(&load(&folder, "cad/1002_tray_bottom.STL")).1, 4520);
    assert!(counts(&part).0 < 3476, "corners are welded");
}

#[test]
fn unusual_files_load_with_warnings() {
    let Some(folder) = data() else { return };
    for (name, vertices, triangles, warns) in [
        ("corrupt/float_inf_point_cloud.ply", 13, 0, true),
        ("corrupt/points_emptyface.ply", 1024, 0, false),
        ("corrupt/issue_2421.ply", 1, 0, false),
        ("corrupt/nancolor.obj", 8, 12, true),
        ("corrupt/notenoughindices.obj", 3, 1, true),
        ("corrupt/degenerate_mesh.obj", 3, 1, true),
        ("corrupt/fuzz.glb", 24, 12, false),
    ] {
        let asset = load(&folder, name);
        assert_eq!(counts(&asset), (vertices, triangles), "{name}");
        assert_eq!(!asset.warnings.is_empty(), warns, "{name}");
    }
}

#[test]
fn broken_files_are_refused_in_words() {
    let Some(folder) = data() else { return };
    for (name, words) in [
        ("corrupt/truncated.ply", "the file ends here"),
        (
            "corrupt/corrupted_invalid_vertex_count.ply",
            "face 19, property vertex_indices: the file ends",
        ),
        ("corrupt/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", "header line 7"),
        ("corrupt/empty.ply", "is empty"),
        ("corrupt/no_vertex.ply", "no vertex element"),
        ("corrupt/malformed.obj", "face 5 (line 28)"),
        ("corrupt/corrupted_invalid_facet_vertex.obj", "does not exist, the file has 6"),
        ("corrupt/corrupted_invalid_double.obj", "vertex 5 (line 6): property x"),
        ("corrupt/truncated.off", "vertex 3 (line 6): has 1 of 3 values"),
        ("corrupt/OutOfMemory.off", "declares 353535235358"),
        ("corrupt/truncated.stl", "declares 20 triangles"),
        ("corrupt/no_magic_number.tck", "a track file begins with \"mrtrix tracks\""),
        ("corrupt/badArray.gltf", "meshes[0].primitives"),
        ("corrupt/badNumber.gltf", "materials[0].normalTexture.scale"),
    ] {
        let error = assets::read(&folder.join(name), &ReadOptions::default())
            .err()
            .unwrap_or_else(|| panic!("{name} loads"))
            .to_string();
        println!("{error}");
        let file = name.rsplit('/').next().unwrap_or(name);
        assert!(error.starts_with(&format!("{file}: ")) && error.contains(words), "{error}");
    }
}

#[test]
fn foreign_formats_are_named() {
    let Some(folder) = data() else { return };
    for (name, words) in [
        ("splats/train-1000.ply", "Gaussian splats"),
        ("splats/guitar.compressed.ply", "Gaussian splats"),
        ("splats/fourth_st.spz", "Gaussian splats"),
        ("pointclouds/pc_color.drc", "Draco"),
        ("lines/bio_neuron-000.asc", "Neurolucida"),
        ("trees/AlmondLeaf.png", "image"),
        ("SOURCES.md", "known format"),
    ] {
        let error = assets::read(&folder.join(name), &ReadOptions::default());
        let error = error.err().unwrap_or_else(|| panic!("{name} loads"));
        println!("{error}");
        assert!(matches!(error, AssetError::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains(words), "{error}");
    }
}

/// File, strands, vertices, bounds, words of a warning. Those of tracts are NiBabel's.
type ExpectedLines = (&'static str, usize, usize, [f64; 6], &'static str);

const LINES: &[ExpectedLines] = &[
    ("lines/standard.tck", 120, 360, [-0.5, -1.5, -1.0, 3.5, 13.5, 13.0], ""),
    ("lines/standard.trk", 120, 360, [-0.5, -1.5, -1.0, 3.5, 13.5, 13.0], ""),
    (
        "lines/tracks300.trk",
        300,
        14576,
        [64.0245132446289, 78.36035919189453, 61.47268, 115.55522918701172, 121.12667, 91.91046],
        "",
    ),
    // One streamline of three has a single point.
    ("lines/complex.trk", 2, 7, [0.0, 1.0, 2.0, 12.0, 13.0, 14.0], "single vertex"),
    ("lines/complex_big_endian.trk", 2, 7, [0.0, 1.0, 2.0, 12.0, 13.0, 14.0], "single vertex"),
    (
        "corrupt/matlab_nan.tck",
        1,
        108,
        [-0.98094, -19.076, 7.4381, -0.11249, -0.45225, 15.243],
        "the header counts 615000 streamlines, the file holds 1",
    ),
];

#[test]
fn lines_have_their_strands() {
    let Some(folder) = data() else { return };
    for &(name, strands, vertices, bounds, warning) in LINES {
        let asset = load(&folder, name);
        let Geometry::Lines(lines) = &asset.geometries[0] else { panic!("{name}") };
        assert_eq!(lines.strands.len(), strands + 1, "{name}");
        assert_eq!(lines.positions.len(), vertices, "{name}");
        let found = pointillist::math::Bounds::of(lines.positions.iter().copied());
        let found = [found.min.to_array(), found.max.to_array()].concat();
        for (found, expected) in found.iter().zip(bounds) {
            assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{name}: {found}");
        }
        let warned = asset.warnings.iter().any(|text| text.contains(warning));
        assert_eq!(warned, !warning.is_empty(), "{name}: {:?}", asset.warnings);
        assert_eq!(lines.colors.as_ref().map(Vec::len), Some(vertices), "{name}");
    }
}

/// Every node but the root has a segment to its parent; a cell body of one node is a ball.
#[test]
fn neurons_have_a_segment_for_each_node() {
    let Some(folder) = data() else { return };
    for (name, nodes, segments, warning) in [
        ("lines/722817260.swc", 4332, 4331, ""),
        ("lines/754534424.swc", 4696, 4695, ""),
        ("lines/Neuron.swc", 847, 846, ""),
        ("corrupt/Neuron_missing_parents.swc", 843, 838, "parents that do not exist"),
        ("corrupt/neurite_wrong_root_point.swc", 7, 5, "outer nodes"),
    ] {
        let asset = load(&folder, name);
        let Geometry::Lines(lines) = &asset.geometries[0] else { panic!("{name}") };
        let found = lines.positions.len() + 1 - lines.strands.len();
        println!("{name}: {found} segments for {nodes} nodes, {:?}", asset.warnings);
        assert_eq!(found, segments, "{name}");
        assert_eq!(lines.radii.as_ref().map(Vec::len), Some(lines.positions.len()));
        let warned = asset.warnings.iter().any(|text| text.contains(warning));
        assert_eq!(warned, !warning.is_empty(), "{name}: {:?}", asset.warnings);
    }
}

#[test]
fn polylines_of_vtk_load() {
    let Some(folder) = data() else { return };
    for (name, strands, vertices) in
        [("lines/track1.binary.vtk", 1, 16267), ("lines/political.vtp", 980, 95141)]
    {
        let asset = load(&folder, name);
        let Geometry::Lines(lines) = &asset.geometries[0] else { panic!("{name}") };
        println!("{name}: {:?}", asset.warnings);
        assert_eq!(lines.strands.len(), strands + 1, "{name}");
        assert_eq!(lines.positions.len(), vertices, "{name}");
    }
}
