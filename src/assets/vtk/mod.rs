//! Readers for polygonal data of VTK: the legacy format ([`legacy`], `.vtk`) and the XML format ([`xml`], `.vtp`).
//!
//! Both give [`PolyData`]: points, cells that refer to them, and arrays of numbers for points or cells. Lines become strands,
//! polygons and strips triangles; points of a file that has neither are a cloud. A file with lines and polygons has two
//! geometries.
//!
//! An array of one number called `radius` or `radii` has the radii of lines. One of three numbers called `ribbon_normals` makes
//! them ribbons, whose half width is the radius. Arrays of three or four numbers are colours if
//! they are bytes, if their name says so, or if the legacy format does. Other arrays become scalar fields: of points first,
//! then of cells, which are the same along a line.

mod legacy;
mod polygons;
mod values;
mod xml;

#[cfg(test)]
mod tests;

use glam::{DVec3, Vec3};

pub use self::legacy::read_from as read_legacy;
use self::values::Array;
pub use self::xml::read_from as read_xml;
use super::fields::{self, Column, Numbers};
use super::input::Origin;
use super::strands::{Attributes, Paint, Strands, Vertex};
use super::{Asset, AssetError, Geometry, Placement, ReadOptions};

const RADII: [&str; 2] = ["radius", "radii"];
const RIBBON: &str = "ribbon_normals";
/// Arrays of more numbers than this for an element are left out.
const MOST_COMPONENTS: usize = 4;

/// Cells, each a list of points.
#[derive(Debug, Default)]
struct Cells {
    /// Where each cell ends among the corners.
    ends: Vec<u64>,
    /// Numbers of points.
    corners: Vec<u32>,
}

impl Cells {
    fn len(&self) -> usize {
        self.ends.len()
    }

    /// The corners of each cell.
    fn each(&self) -> impl Iterator<Item = &[u32]> {
        let begins = std::iter::once(&0).chain(&self.ends);
        let ends = begins.zip(&self.ends);
        ends.map(|(begin, end)| {
            self.corners.get(*begin as usize..*end as usize).unwrap_or_default()
        })
    }

    fn bytes(&self) -> u64 {
        8 * self.ends.len() as u64 + 4 * self.corners.len() as u64
    }
}

/// The content of a file of either format.
#[derive(Debug, Default)]
struct PolyData {
    points: Vec<DVec3>,
    /// Number of cells that are points, which come before all others.
    verts: u64,
    lines: Cells,
    polys: Cells,
    strips: Cells,
    point_arrays: Vec<Array>,
    cell_arrays: Vec<Array>,
    warnings: Vec<String>,
}

impl PolyData {
    /// Bytes of everything that has been read.
    fn bytes(&self) -> u64 {
        let arrays = self.point_arrays.iter().chain(&self.cell_arrays);
        let arrays: u64 = arrays.map(|array| 4 * array.values.len() as u64).sum();
        let cells = self.lines.bytes() + self.polys.bytes() + self.strips.bytes();
        24 * self.points.len() as u64 + cells + arrays
    }

    /// Refuses corners that are no points.
    fn check(&self, file: &str) -> Result<(), AssetError> {
        for (name, cells) in
            [("line", &self.lines), ("polygon", &self.polys), ("strip", &self.strips)]
        {
            for (number, cell) in cells.each().enumerate() {
                if let Some(point) = cell.iter().find(|at| **at as usize >= self.points.len()) {
                    let count = self.points.len();
                    let reason = format!("point {point} does not exist, the file has {count}");
                    return Err(AssetError::malformed(file, format!("{name} {number}"), reason));
                }
            }
        }
        Ok(())
    }

    /// Leaves out arrays that cannot be told from others or have another length than what they describe.
    fn tidy(&mut self) {
        let drawn = self.lines.len() + self.polys.len() + self.strips.len();
        let cells = (self.verts as usize).saturating_add(drawn);
        let points = self.points.len();
        for (arrays, elements, what) in
            [(&mut self.point_arrays, points, "points"), (&mut self.cell_arrays, cells, "cells")]
        {
            arrays.retain(|array| {
                let fits = array.values.len() == elements.saturating_mul(array.components);
                if !fits {
                    let (name, numbers) = (&array.name, array.values.len());
                    self.warnings.push(format!(
                        "array \"{name}\" is left out: it has {numbers} numbers for {elements} {what}"
                    ));
                }
                fits
            });
        }
    }

    fn finish(
        mut self,
        format: &'static str,
        origin: &Origin,
        options: &ReadOptions,
    ) -> Result<Asset, AssetError> {
        let file = origin.name.as_str();
        self.check(file)?;
        self.tidy();
        let mut asset = Asset { format, ..Asset::default() };
        if self.lines.len() > 0 {
            let lines = self.strands(origin, options)?;
            asset.geometries.extend(lines.map(Geometry::Lines));
        }
        if self.polys.len() + self.strips.len() > 0 {
            let mesh = self.mesh(origin, options)?;
            asset.geometries.push(Geometry::Mesh(mesh));
        }
        if asset.geometries.is_empty() {
            asset.geometries.push(Geometry::Points(self.cloud(origin)?));
        }
        asset.placements = (0..asset.geometries.len())
            .map(|geometry| Placement {
                name: file.to_owned(),
                geometry,
                asset_from_geometry: glam::DAffine3::IDENTITY,
            })
            .collect();
        asset.warnings = self.warnings;
        Ok(asset)
    }

    /// The lines, with the arrays of points and of lines; `None` where no line has two points and the file has polygons or strips as well.
    fn strands(
        &mut self,
        origin: &Origin,
        options: &ReadOptions,
    ) -> Result<Option<super::Polylines>, AssetError> {
        let roles = Roles::of(&self.point_arrays);
        let cell_roles = Roles::of(&self.cell_arrays);
        if roles.normals.is_some() {
            self.warnings.push("normals of lines are left out: lines are tubes; an array called `ribbon_normals` makes ribbons".to_owned());
        }
        let paint = match roles.color.or(cell_roles.color) {
            Some(color) if color.is_byte => Paint::Bytes,
            Some(_) => Paint::Floats,
            None => Paint::Nothing,
        };
        let mut columns = Vec::new();
        let mut add = |fields: &[&Array]| {
            for array in fields {
                let names = array.names().into_iter().map(|name| fields::name_of(&name));
                columns.extend(names.map(|name| Column::of(&name, Numbers::Singles(Vec::new()))));
            }
        };
        add(&roles.fields);
        add(&cell_roles.fields);
        let radii = roles.radius.is_some() || cell_roles.radius.is_some();
        let attributes = Attributes { radii, paint, columns };
        let mut strands = Strands::new(origin, options, attributes);
        if roles.ribbon.is_some() {
            strands = strands.into_ribbons();
        }
        strands.reserve(self.lines.corners.len())?;
        let mut values = Vec::new();
        for (number, line) in self.lines.each().enumerate() {
            let cell = (self.verts as usize).saturating_add(number);
            for &point in line {
                let at = point as usize;
                values.clear();
                for array in &roles.fields {
                    values.extend_from_slice(array.of(at));
                }
                for array in &cell_roles.fields {
                    values.extend_from_slice(array.of(cell));
                }
                let own = |of_points: Option<&Array>, of_cells: Option<&Array>| {
                    let own = of_points.and_then(|array| array.of(at).first().copied());
                    own.or_else(|| of_cells.and_then(|array| array.of(cell).first().copied()))
                };
                if let Some(&[x, y, z]) = roles.ribbon.map(|array| array.of(at)) {
                    strands.turn(Vec3::new(x, y, z));
                }
                strands.vertex(Vertex {
                    position: self.points.get(at).copied().unwrap_or(DVec3::NAN),
                    radius: own(roles.radius, cell_roles.radius).unwrap_or(0.0),
                    color: match (roles.color, cell_roles.color) {
                        (Some(color), _) => color.color(at),
                        (None, Some(color)) => color.color(cell),
                        (None, None) => [0.0; 4],
                    },
                    values: &values,
                })?;
            }
            strands.cut()?;
        }
        strands.finish_beside(self.polys.len() + self.strips.len() > 0, &mut self.warnings)
    }
}

/// The purpose of an array.
#[derive(Default)]
struct Roles<'a> {
    radius: Option<&'a Array>,
    color: Option<&'a Array>,
    normals: Option<&'a Array>,
    /// Normals that make lines ribbons.
    ribbon: Option<&'a Array>,
    fields: Vec<&'a Array>,
}

impl<'a> Roles<'a> {
    fn of(arrays: &'a [Array]) -> Roles<'a> {
        let mut roles = Roles::default();
        for array in arrays {
            let name = array.name.to_ascii_lowercase();
            let is_radius = array.components == 1 && RADII.contains(&name.as_str());
            if is_radius && roles.radius.is_none() {
                roles.radius = Some(array);
            } else if array.is_color() && roles.color.is_none() {
                roles.color = Some(array);
            } else if name == RIBBON && array.components == 3 && roles.ribbon.is_none() {
                roles.ribbon = Some(array);
            } else if array.is_normals && array.components == 3 && roles.normals.is_none() {
                roles.normals = Some(array);
            } else {
                roles.fields.push(array);
            }
        }
        roles
    }
}
