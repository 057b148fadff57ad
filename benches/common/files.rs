//! Files that the benches draw, made once under `target/bench`. The peer reads the same ones.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use pointillist::assets::Progress;
use pointillist::generate::{Form, Generated, Kind, Parameters, generate, generate_scene, write};
use serde_json::{Map, Value, json};

/// Writes through `fill` unless the file is there. A broken run leaves nothing half done behind.
pub fn once(name: &str, fill: impl FnOnce(&Path) -> anyhow::Result<()>) -> anyhow::Result<PathBuf> {
    let folder = super::folder();
    std::fs::create_dir_all(&folder)?;
    let file = folder.join(name);
    if !file.exists() {
        println!("making {}", file.display());
        let partial = folder.join(format!("partial-{name}"));
        fill(&partial).with_context(|| file.display().to_string())?;
        std::fs::rename(&partial, &file)?;
    }
    Ok(file)
}

/// A point cloud or mesh of the program's own generators.
pub fn generated(name: &str, kind: Kind, parameters: &Parameters) -> anyhow::Result<PathBuf> {
    once(name, |file| {
        let asset = generate(kind, parameters, &Progress::new(|_| ()))?;
        write(&asset, file)?;
        Ok(())
    })
}

/// A scene file, which names assets beside it; written anew each time.
pub fn scene(name: &str, description: &Value) -> anyhow::Result<PathBuf> {
    let folder = super::folder();
    std::fs::create_dir_all(&folder)?;
    let file = folder.join(name);
    std::fs::write(&file, description.to_string()).with_context(|| file.display().to_string())?;
    Ok(file)
}

/// Between copies, which are a little less wide.
const STEP: f64 = 2.0;

/// A scene of `side` × `side` copies of a relief.
pub fn copies(side: u32) -> anyhow::Result<PathBuf> {
    let triangles = super::pick(400_000, 10_000);
    let parameters = Parameters { seed: 1, triangles: Some(triangles), ..Parameters::default() };
    let asset = format!("relief-{triangles}.ply");
    generated(&asset, Kind::Relief, &parameters)?;
    let description = json!({
        "assets": { "relief": { "file": asset } },
        "nodes": [{
            "asset": "relief",
            "repeat": { "grid": [side, 1, side], "step": [STEP, 0.0, STEP] },
        }],
    });
    scene(&format!("copies-{side}-of-{triangles}.json"), &description)
}

/// The generator's scene of ten trees of this many leaves.
pub fn grove(form: Form, leaves: u64) -> anyhow::Result<PathBuf> {
    let name = match form {
        Form::Triangles => "triangles",
        Form::Lines => "lines",
    };
    let name = format!("grove-{name}-{leaves}");
    let file = super::folder().join(format!("{name}.json"));
    if !file.exists() {
        std::fs::create_dir_all(super::folder())?;
        println!("making {}", file.display());
        let parameters =
            Parameters { seed: 1, count: Some(leaves), form: Some(form), ..Parameters::default() };
        let mut scene = generate_scene(Kind::Grove, &name, &parameters, &Progress::new(|_| ()))?;
        // The file with the scene's name comes last: a broken run leaves none.
        for (asset, made) in std::mem::take(&mut scene.assets) {
            write(&made, &file.with_file_name(asset))?;
        }
        write(&Generated::Scene(scene), &file)?;
    }
    Ok(file)
}

/// Ten models, and a scene in which each has every tenth place of a square of `side` × `side`.
pub fn crowd(side: u32) -> anyhow::Result<PathBuf> {
    const KINDS: [(&str, Kind, u64); 10] = [
        ("relief", Kind::Relief, 1),
        ("statue", Kind::Statue, 2),
        ("tree", Kind::Tree, 3),
        ("sphere", Kind::Sphere, 4),
        ("relief", Kind::Relief, 5),
        ("statue", Kind::Statue, 6),
        ("tree", Kind::Tree, 7),
        ("cube", Kind::Cube, 8),
        ("relief", Kind::Relief, 9),
        ("statue", Kind::Statue, 10),
    ];
    let (mut assets, mut nodes) = (Map::new(), Vec::new());
    for (index, (name, kind, seed)) in KINDS.into_iter().enumerate() {
        let count = super::pick(10_000, 1_000) * (1 + seed);
        let size = Some(1.0 + 0.08 * seed as f64);
        let parameters = Parameters { seed, size, ..Parameters::of_size(kind, count) };
        let file = format!("small-{name}-{seed}-of-{count}.ply");
        generated(&file, kind, &parameters)?;
        let asset = format!("{name} {seed}");
        let (column, row) = ((index % 5) as f64, (index / 5) as f64);
        nodes.push(json!({
            "asset": asset,
            "translate": [STEP * column, 0.0, STEP * row],
            "repeat": { "grid": [side / 5, 1, side / 2], "step": [5.0 * STEP, 0.0, 2.0 * STEP] },
        }));
        assets.insert(asset, json!({ "file": file }));
    }
    let description = json!({ "assets": assets, "nodes": nodes });
    scene(&format!("crowd-{side}.json"), &description)
}

/// `count` points spread evenly over the cube from −1 to 1, coloured by where they are: 15 bytes each.
pub fn random_points(count: u64) -> anyhow::Result<PathBuf> {
    once(&format!("random-{count}.ply"), |file| {
        let mut out = BufWriter::new(File::create(file)?);
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n")?;
        write!(out, "property float x\nproperty float y\nproperty float z\n")?;
        write!(out, "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n")?;
        let mut numbers = Numbers(1);
        for _ in 0..count {
            let point = [(); 3].map(|()| numbers.next() * 2.0 - 1.0);
            for coordinate in point {
                out.write_all(&coordinate.to_le_bytes())?;
            }
            out.write_all(&point.map(|coordinate| ((coordinate + 1.0) * 127.5) as u8))?;
        }
        Ok(out.flush()?)
    })
}

/// Disks over a square around the origin of the plane z = 0.
pub struct Wall {
    /// Side of the square that a frame shows; the wall is a tenth longer on either side.
    pub side: f64,
    /// Distance between neighbours.
    pub spacing: f64,
    pub radius: f64,
}

/// Coloured disks without normals of their own, on waves as high as a fiftieth of the wall: such a scene has no lights.
pub fn wall(of: &Wall) -> anyhow::Result<PathBuf> {
    let Wall { side, spacing, radius } = *of;
    once(&format!("wall-{side}-spacing-{spacing}-radius-{radius}.ply"), |file| {
        let half = 0.6 * side + radius;
        let count = (2.0 * half / spacing).ceil() as u64 + 1;
        let mut out = BufWriter::new(File::create(file)?);
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", count * count)?;
        write!(out, "property float x\nproperty float y\nproperty float z\n")?;
        write!(out, "property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
        write!(out, "property float radius\nend_header\n")?;
        let mut numbers = Numbers(1);
        for row in 0..count {
            for column in 0..count {
                let mut at = |index: u64| {
                    let jitter = f64::from(numbers.next()) - 0.5;
                    (index as f64 + 0.3 * jitter) * spacing - half
                };
                let (x, y) = (at(column), at(row));
                let turn = std::f64::consts::TAU / side;
                let z = 0.01 * side * ((3.0 * turn * x).sin() + (2.0 * turn * y).cos());
                for coordinate in [x, y, z] {
                    out.write_all(&(coordinate as f32).to_le_bytes())?;
                }
                let shade =
                    [x / half, y / half, 50.0 * z / side].map(|v| (127.5 + 120.0 * v) as u8);
                out.write_all(&shade)?;
                out.write_all(&(radius as f32).to_le_bytes())?;
            }
        }
        Ok(out.flush()?)
    })
}

/// Right triangles with legs of `side` units, two a square, over the square from `-side` to `extent + side`
/// in the plane z = 0.
pub fn triangle_grid(side: u32, extent: u32) -> anyhow::Result<PathBuf> {
    once(&format!("triangles-{side}-of-{extent}.ply"), |file| {
        let cells = extent.div_ceil(side) + 2;
        let corners = cells + 1;
        let mut out = BufWriter::new(File::create(file)?);
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
            corners * corners
        )?;
        write!(out, "property float x\nproperty float y\nproperty float z\n")?;
        writeln!(out, "element face {}", 2 * cells * cells)?;
        write!(out, "property list uchar int vertex_indices\nend_header\n")?;
        for row in 0..corners {
            for column in 0..corners {
                for at in [column, row] {
                    out.write_all(&(at as f32 * side as f32 - side as f32).to_le_bytes())?;
                }
                out.write_all(&0f32.to_le_bytes())?;
            }
        }
        for row in 0..cells {
            for column in 0..cells {
                let first = row * corners + column;
                let above = first + corners;
                for face in [[first, first + 1, above], [above, first + 1, above + 1]] {
                    out.write_all(&[3])?;
                    for corner in face {
                        out.write_all(&(corner as i32).to_le_bytes())?;
                    }
                }
            }
        }
        Ok(out.flush()?)
    })
}

/// The Stanford dragon as `make data` brings it.
pub fn dragon() -> Option<PathBuf> {
    let file = PathBuf::from("scenes/data/dragon.ply");
    file.exists().then_some(file)
}

/// Evenly spread numbers in [0, 1): Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators".
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u32 << 24) as f32
    }
}
