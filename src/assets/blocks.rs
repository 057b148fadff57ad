//! Points of a file some at a time, for files that do not fit into memory.
//!
//! The whole file decides what the points are (whether colours are bytes, which intensity is the largest), so that it is gone
//! through twice: [`PointBlocks::survey`] finds that out, and [`PointBlocks::each`] gives the points as [`super::read`] would have
//! given them all at once. PLY files without faces can be read so, gzipped or not, and LAS and LAZ files that are not gzipped; of a
//! LAZ file as many chunks are in memory as threads decompress.

use std::path::{Path, PathBuf};

use super::dispatch::{InBlocks, display_name, in_blocks};
use super::input::Input;
use super::{AssetError, PointCloud, ReadOptions, las, ply};
use crate::math::Bounds;

/// A file of points.
pub struct PointBlocks {
    path: PathBuf,
    name: String,
    options: ReadOptions,
    format: InBlocks,
    announced: u64,
}

/// Figures of a file of points.
#[derive(Clone, Debug)]
pub struct Survey {
    pub points: u64,
    pub bounds: Bounds,
    facts: Facts,
}

#[derive(Clone, Debug)]
enum Facts {
    Ply(ply::Facts),
    Las(las::Facts),
}

impl PointBlocks {
    /// `None` for a mesh, and for formats that are only read as a whole.
    ///
    /// # Errors
    /// A file that cannot be opened, or whose header is refused.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Option<PointBlocks>, AssetError> {
        let name = display_name(path);
        let input = Input::open(path, &name, options)?;
        let Some(format) = in_blocks(&input) else { return Ok(None) };
        let announced = match format {
            InBlocks::Ply => ply::announced(input, options)?,
            InBlocks::Las => Some(las::announced(path, &name, options)?),
        };
        Ok(announced.map(|announced| PointBlocks {
            path: path.to_owned(),
            name,
            options: options.clone(),
            format,
            announced,
        }))
    }

    /// How many points the file's header announces; it may have fewer that count.
    pub fn announced(&self) -> u64 {
        self.announced
    }

    /// Goes through the file once.
    ///
    /// # Errors
    /// As [`super::read`].
    pub fn survey(&self) -> Result<Survey, AssetError> {
        let (mut points, mut bounds) = (0, Bounds::EMPTY);
        let facts = self.walk(None, &mut |cloud: PointCloud| {
            points += cloud.positions.len() as u64;
            bounds = bounds.union(Bounds::of(cloud.positions.iter().copied()));
            Ok(())
        })?;
        if points == 0 {
            let reason = "holds no points with finite coordinates";
            return Err(AssetError::malformed(&self.name, "file", reason));
        }
        Ok(Survey { points, bounds, facts })
    }

    /// Calls `visit` with all points, in their order, some at a time.
    ///
    /// # Errors
    /// As [`super::read`]; a file that is no longer the one that was surveyed; those of `visit`.
    pub fn each(
        &self,
        survey: &Survey,
        visit: &mut (dyn FnMut(PointCloud) -> Result<(), AssetError> + Send),
    ) -> Result<(), AssetError> {
        let (mut points, mut bounds) = (0, Bounds::EMPTY);
        let changed = || AssetError::malformed(&self.name, "file", "has changed meanwhile");
        self.walk(Some(&survey.facts), &mut |cloud: PointCloud| {
            points += cloud.positions.len() as u64;
            bounds = bounds.union(Bounds::of(cloud.positions.iter().copied()));
            if points > survey.points || survey.bounds.union(bounds) != survey.bounds {
                return Err(changed());
            }
            visit(cloud)
        })?;
        if points == survey.points { Ok(()) } else { Err(changed()) }
    }

    fn walk(
        &self,
        known: Option<&Facts>,
        visit: &mut (dyn FnMut(PointCloud) -> Result<(), AssetError> + Send),
    ) -> Result<Facts, AssetError> {
        let Self { path, name, options, .. } = self;
        Ok(match (self.format, known) {
            (InBlocks::Ply, known) => {
                let known = match known {
                    Some(Facts::Ply(known)) => Some(known),
                    _ => None,
                };
                let input = Input::open(path, name, options)?;
                Facts::Ply(ply::each(input, options, known, visit)?)
            }
            (InBlocks::Las, known) => {
                let known = match known {
                    Some(Facts::Las(known)) => Some(known),
                    _ => None,
                };
                Facts::Las(las::each(path, name, options, known, visit)?)
            }
        })
    }
}

impl Survey {
    /// As [`super::Asset::format`].
    pub fn format(&self) -> &'static str {
        match &self.facts {
            Facts::Ply(_) => "ply",
            Facts::Las(facts) => facts.format(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::{Geometry, read};

    /// The points of a file all at once, and some at a time.
    fn both(name: &str, bytes: &[u8]) -> (PointCloud, Vec<PointCloud>, Survey) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let options = ReadOptions::default();
        let Geometry::Points(whole) = read(&path, &options).unwrap().geometries.remove(0) else {
            panic!("{name} is no cloud");
        };
        let file = PointBlocks::open(&path, &options).unwrap().unwrap();
        let survey = file.survey().unwrap();
        let mut blocks = Vec::new();
        file.each(&survey, &mut |block| {
            blocks.push(block);
            Ok(())
        })
        .unwrap();
        (whole, blocks, survey)
    }

    fn joined<T: Clone>(
        blocks: &[PointCloud],
        of: fn(&PointCloud) -> &Option<Vec<T>>,
    ) -> Option<Vec<T>> {
        let lists: Option<Vec<Vec<T>>> = blocks.iter().map(|block| of(block).clone()).collect();
        lists.map(|lists| lists.concat())
    }

    fn check(name: &str, bytes: &[u8]) {
        let (whole, blocks, survey) = both(name, bytes);
        let positions: Vec<_> = blocks.iter().flat_map(|b| b.positions.clone()).collect();
        assert_eq!(positions, whole.positions, "{name}");
        assert_eq!(survey.points, positions.len() as u64);
        assert_eq!(survey.bounds, Bounds::of(positions.iter().copied()));
        assert_eq!(joined(&blocks, |b| &b.colors), whole.colors, "{name}");
        assert_eq!(joined(&blocks, |b| &b.normals), whole.normals, "{name}");
        let words: Vec<u32> = blocks.iter().flat_map(|b| b.fields.words().to_vec()).collect();
        assert_eq!(words, whole.fields.words(), "{name}");
        assert!(blocks.iter().all(|b| b.fields.list() == whole.fields.list()), "{name}");
        assert_eq!(joined(&blocks, |b| &b.radii), whole.radii, "{name}");
    }

    fn ply(count: u32, properties: &str, row: impl Fn(u32) -> String) -> Vec<u8> {
        let lines: String =
            properties.split(' ').map(|p| format!("property float {p}\n")).collect();
        let rows: String = (0..count).map(|i| row(i) + "\n").collect();
        format!("ply\nformat ascii 1.0\nelement vertex {count}\n{lines}end_header\n{rows}")
            .into_bytes()
    }

    #[test]
    fn ply_points_are_the_same_in_blocks() {
        // The last block alone tells that colours are bytes and that normals are there.
        let row = |i: u32| {
            let late = f32::from(u8::from(i > 140_000));
            let x = if i % 1000 == 7 { "nan".to_owned() } else { i.to_string() };
            format!("{x} 1 2 0 {late} {late} {} 0 1 {} {}", 200.0 * late, i % 777, i % 300)
        };
        check("a.ply", &ply(150_000, "x y z nx ny nz red green blue intensity class", row));
        check("b.ply", &ply(70_000, "x y z radius", |i| format!("{i} 0 1 0.5")));
        check(
            "c.ply",
            &ply(70_000, "x y z radius nx ny nz", |i| {
                format!("{i} 0 1 {} 0 0 0", if i == 69_000 { -1 } else { 1 })
            }),
        );
    }

    #[test]
    fn las_points_are_the_same_in_blocks() {
        for (name, compressed) in [("a.las", false), ("a.laz", true)] {
            let bytes = las::tests::file((1, 4), 7, compressed, 150_000, 1);
            check(name, &bytes);
        }
    }

    #[test]
    fn meshes_and_other_formats_are_not_read_in_blocks() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
        for (name, text) in [("a.ply", mesh), ("a.xyz", "1 2 3\n")] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            assert!(PointBlocks::open(&path, &ReadOptions::default()).unwrap().is_none(), "{name}");
        }
    }
}
