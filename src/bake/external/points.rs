//! First phase: sorts a file's points along a Morton curve and collects the figures that need all points.

use std::io;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::super::colors::{Counts, Palette};
use super::super::kernels::CUTOFF;
use super::super::normals::{Frame, is_radius, stride};
use super::super::pack::{Grid, morton};
use super::pieces::{self, Piece, Place};
use super::sort::{Sortable, Sorter};
use super::spill::SpillFile;
use super::{BakeFault, Phase, Work};
use crate::assets::{AssetError, PointBlocks, PointCloud, Survey};

/// A point of a file.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Point {
    /// Morton code.
    place: u64,
    pub(super) position: [f64; 3],
    /// Zero if unknown.
    pub(super) normal: [f32; 3],
    /// Zero if the file has none.
    pub(super) radius: f32,
    /// Place in the file.
    pub(super) index: u32,
    /// Colour, or intensity and class.
    paint: u32,
}

impl Sortable for Point {
    type Key = (u64, u32);

    fn key(&self) -> (u64, u32) {
        (self.place, self.index)
    }
}

impl Point {
    pub(super) fn position(&self) -> DVec3 {
        self.position.into()
    }

    pub(super) fn normal(&self) -> Vec3 {
        self.normal.into()
    }
}

/// Interpretation of a point's paint word.
#[derive(Clone, Copy)]
enum Paint {
    Color,
    Of(Palette),
}

/// All points of a file along the curve of `grid`.
pub(super) struct Points {
    pub(super) file: SpillFile<Point>,
    /// Positions of the points, in the coordinates of `frame`.
    pub(super) places: SpillFile<Place>,
    /// The pieces that are in memory one at a time.
    pub(super) pieces: Vec<Piece>,
    pub(super) grid: Grid,
    pub(super) frame: Frame,
    paint: Paint,
    /// The file has normals.
    pub(super) oriented: bool,
    /// Some point has no normal, or no kernel.
    pub(super) lacks_normals: bool,
    pub(super) lacks_kernels: bool,
}

impl Points {
    pub(super) fn color(&self, point: &Point) -> [u8; 4] {
        match self.paint {
            Paint::Color => point.paint.to_le_bytes(),
            Paint::Of(palette) => palette.color(point.paint as u16, (point.paint >> 16) as u8),
        }
    }

    /// Reads the file and sorts its points.
    pub(super) fn read(
        source: &PointBlocks,
        survey: &Survey,
        work: &Work,
    ) -> Result<Points, BakeFault> {
        let grid = Grid::of(&survey.bounds)?;
        let step = stride(survey.points as usize);
        let mut sorter = Sorter::new(work.spill, work.memory.to_sort(), work.memory.to_merge());
        let mut all =
            Gathered { counts: Counts::default(), some: Vec::new(), ..Gathered::default() };
        let mut failed = None;
        let mut index = 0;
        let folder = work.spill.folder();
        source
            .each(survey, &mut |block: PointCloud| {
                all.add(&block, index, step);
                for record in records(&block, &grid, index) {
                    if let Err(error) = sorter.push(record) {
                        failed = Some(error);
                        // Any error ends the reading.
                        return Err(AssetError::io(
                            &folder.display().to_string(),
                            io::Error::other(""),
                        ));
                    }
                }
                index += block.positions.len() as u32;
                work.tell(Phase::Read, f64::from(index) / survey.points as f64);
                Ok(())
            })
            .map_err(|error| failed.map_or(BakeFault::Asset(error), BakeFault::from))?;
        let frame = Frame::of_some(&all.some).ok_or(BakeFault::Empty)?;
        let sorted = sorter.finish()?;
        let (mut file, mut places) = (work.spill.file()?, work.spill.file()?);
        let mut walk = sorted.walk()?;
        while let Some(point) = walk.next()? {
            file.push(point)?;
            places.push(Place { at: frame.to_local(point.position()), index: point.index })?;
        }
        drop(sorted);
        file.flush()?;
        places.flush()?;
        let code = |at| {
            let mut point = [Point::zeroed()];
            file.read(at, &mut point).map(|()| point[0].place)
        };
        let most = work.memory.of_pieces() as u64;
        let pieces = pieces::cut(file.count(), most, code, &places)?;
        Ok(Points {
            file,
            places,
            pieces,
            grid,
            frame,
            paint: if all.has_colors { Paint::Color } else { Paint::Of(all.counts.palette()) },
            oriented: all.has_normals,
            lacks_normals: all.lacks_normals,
            lacks_kernels: all.lacks_radii,
        })
    }
}

/// Figures of the whole file, known after all points have been read.
#[derive(Default)]
struct Gathered {
    counts: Counts,
    /// An evenly spread sample of positions.
    some: Vec<DVec3>,
    has_colors: bool,
    has_normals: bool,
    lacks_normals: bool,
    lacks_radii: bool,
}

impl Gathered {
    fn add(&mut self, block: &PointCloud, first: u32, step: usize) {
        let none = (&[][..], &[][..]);
        let (intensities, classes) = match block.colors {
            Some(_) => none,
            None => (
                block.intensity.as_deref().unwrap_or(none.0),
                block.classification.as_deref().unwrap_or(none.1),
            ),
        };
        self.counts.add(intensities, classes);
        let skipped = (step - first as usize % step) % step;
        self.some.extend(block.positions.iter().skip(skipped).step_by(step));
        self.has_colors = block.colors.is_some();
        self.has_normals = block.normals.is_some();
        self.lacks_normals |=
            block.normals.as_ref().is_none_or(|normals| normals.contains(&Vec3::ZERO));
        self.lacks_radii |= block.radii.as_ref().is_none_or(|radii| !radii.iter().all(is_radius));
    }
}

fn records(block: &PointCloud, grid: &Grid, first: u32) -> impl Iterator<Item = Point> {
    block.positions.iter().enumerate().map(move |(i, &position)| Point {
        place: morton(grid.quantise(position)),
        position: position.into(),
        normal: block.normals.as_ref().map_or(Vec3::ZERO, |normals| normals[i]).into(),
        radius: block.radii.as_ref().map_or(0.0, |radii| radii[i]),
        index: first + i as u32,
        paint: match &block.colors {
            Some(colors) => u32::from_le_bytes(colors[i]),
            None => {
                let intensity = block.intensity.as_ref().map_or(0, |values| values[i]);
                let class = block.classification.as_ref().map_or(0, |classes| classes[i]);
                u32::from(intensity) | u32::from(class) << 16
            }
        },
    })
}

impl Point {
    /// The standard deviation of the kernel that the file gives, if any.
    pub(super) fn deviation(&self) -> Option<f32> {
        is_radius(&self.radius).then_some(self.radius / CUTOFF)
    }
}
