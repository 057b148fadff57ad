//! First phase: sorts a file's points along a Morton curve and collects the figures that need all points.

use std::io;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::super::colors::Painter;
use super::super::kernels::CUTOFF;
use super::super::normals::{Frame, is_radius, stride};
use super::super::pack::{CodeCounts, Grid, PackedField, Values, morton, pack_field, values_of};
use super::pieces::{self, Piece, Place};
use super::sort::{Sortable, Sorter};
use super::spill::SpillFile;
use super::{BakeFault, Phase, Work};
use crate::assets::{AssetError, Field, PointBlocks, PointCloud, Survey};

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
    /// Colour, if the file has colours.
    color: u32,
    /// Codes of scalar fields.
    pub(super) values: Values,
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

/// All points of a file along the curve of `grid`.
pub(super) struct Points {
    pub(super) file: SpillFile<Point>,
    /// Positions of the points, in the coordinates of `frame`.
    pub(super) places: SpillFile<Place>,
    /// The pieces that are in memory one at a time.
    pub(super) pieces: Vec<Piece>,
    pub(super) grid: Grid,
    pub(super) frame: Frame,
    /// Colours of points in a file without any.
    painter: Option<Painter>,
    list: Vec<Field>,
    pub(super) fields: Vec<PackedField>,
    /// The file has normals.
    pub(super) oriented: bool,
    /// Some point has no normal, or no kernel.
    pub(super) lacks_normals: bool,
    pub(super) lacks_kernels: bool,
}

impl Points {
    pub(super) fn color(&self, point: &Point) -> [u8; 4] {
        let own = point.color.to_le_bytes();
        let painter = self.painter.as_ref();
        painter.map_or(own, |painter| painter.color(|field| self.list[field].code(&point.values)))
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
        let mut all = Gathered::default();
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
            painter: (!all.has_colors).then(|| Painter::of(all.fields())),
            fields: all.fields().map(|(field, counts)| pack_field(field, counts)).collect(),
            list: all.fields().map(|(field, _)| field.clone()).collect(),
            oriented: all.has_normals,
            lacks_normals: all.lacks_normals,
            lacks_kernels: all.lacks_radii,
        })
    }
}

/// Figures of the whole file, known after all points have been read.
#[derive(Default)]
struct Gathered {
    /// The fields of the file, with the number of points that have each code.
    fields: Vec<(Field, CodeCounts)>,
    /// An evenly spread sample of positions.
    some: Vec<DVec3>,
    has_colors: bool,
    has_normals: bool,
    lacks_normals: bool,
    lacks_radii: bool,
}

impl Gathered {
    fn fields(&self) -> impl Iterator<Item = (&Field, &CodeCounts)> {
        self.fields.iter().map(|(field, counts)| (field, counts))
    }

    fn add(&mut self, block: &PointCloud, first: u32, step: usize) {
        if self.fields.is_empty() {
            let empty = |field: &Field| (field.clone(), CodeCounts::default());
            self.fields = block.fields.list().iter().map(empty).collect();
        }
        for (field, counts) in &mut self.fields {
            counts.add(field, &block.fields);
        }
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
        color: block.colors.as_ref().map_or(0, |colors| u32::from_le_bytes(colors[i])),
        values: values_of(block, i),
    })
}

impl Point {
    /// The standard deviation of the kernel that the file gives, if any.
    pub(super) fn deviation(&self) -> Option<f32> {
        is_radius(&self.radius).then_some(self.radius / CUTOFF)
    }
}
