//! Strands under construction: what every reader of lines does with a vertex and at the end of a strand.
//!
//! A vertex without a place (not-a-number, infinite) is left out, and its strand is cut there: no segment may pass over a gap
//! that the file has. Strands of fewer than two vertices are left out. A radius that is negative or no number is taken as 0, a
//! line without width. All of it is said in warnings.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::fields::{self, Column};
use super::input::Origin;
use super::warnings::{Odd, counted};
use super::{Asset, AssetError, Geometry, NEUTRAL, Polylines, ReadOptions, tidy};
use crate::memory::{Admission, Meter};

/// Bytes of a vertex's place, and of its codes of scalar fields.
const VERTEX_BYTES: u64 = 24;
const CODE_BYTES: u64 = 8;
/// Vertices that a thread colours by their directions at a time.
const COLORED_AT_A_TIME: usize = 1 << 14;

/// Where the colours of vertices come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Paint {
    /// There are none.
    Nothing,
    /// The file has sRGB bytes.
    Bytes,
    /// The file has sRGB channels up to 1, or up to 255 if one of them is above [`tidy::MOST_OF_UNIT`].
    Floats,
    /// The absolute coordinates of the direction are red, green and blue, as programs for tracts show them.
    Direction,
}

/// A vertex as a file has it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex<'v> {
    pub position: DVec3,
    /// Radius; ignored where strands have none.
    pub radius: f32,
    /// Looked at where the file has colours. Alpha that the file does not have is not-a-number for [`Paint::Floats`].
    pub color: [f32; 4],
    /// A number for each scalar field.
    pub values: &'v [f32],
}

impl Vertex<'_> {
    /// A vertex with a place alone.
    pub fn at(position: DVec3) -> Self {
        Vertex { position, radius: 0.0, color: [0.0; 4], values: &[] }
    }
}

/// The attributes that the strands of a file have.
pub(super) struct Attributes {
    pub radii: bool,
    pub paint: Paint,
    pub columns: Vec<Column>,
}

impl Attributes {
    pub fn nothing() -> Attributes {
        Attributes { radii: false, paint: Paint::Nothing, columns: Vec::new() }
    }
}

pub(super) struct Strands<'a> {
    file: &'a str,
    max_vertices: u64,
    lines: Polylines,
    floats: Vec<[f32; 4]>,
    /// Normal of the vertices to come, where strands are ribbons.
    normal: Vec3,
    odd_normals: Odd,
    paint: Paint,
    columns: Vec<Column>,
    meter: Meter<'a>,
    bytes_each: u64,
    /// The list of strands.
    list_meter: Meter<'a>,
    /// First vertex of the strand that is being read.
    begin: usize,
    /// Vertices that came, counted for warnings.
    came: u64,
    adrift: Odd,
    odd_radii: Odd,
    short: u64,
}

impl<'a> Strands<'a> {
    pub fn new(origin: &'a Origin, options: &ReadOptions, attributes: Attributes) -> Self {
        Self::within(&origin.name, &origin.admission, options.max_vertices, attributes)
    }

    /// Strands of a part of a file, with this many vertices at most.
    pub fn within(
        file: &'a str,
        admission: &'a Admission,
        max_vertices: u64,
        attributes: Attributes,
    ) -> Self {
        let Attributes { radii, paint, columns } = attributes;
        let colors = match paint {
            Paint::Nothing => 0,
            Paint::Bytes | Paint::Direction => 4,
            Paint::Floats => 20,
        };
        let fields = if columns.is_empty() { 0 } else { CODE_BYTES + 4 * columns.len() as u64 };
        let has_bytes = matches!(paint, Paint::Bytes | Paint::Direction);
        let lines = Polylines {
            radii: radii.then(Vec::new),
            colors: has_bytes.then(Vec::new),
            ..Polylines::default()
        };
        Self {
            file,
            max_vertices: max_vertices.min(u64::from(u32::MAX)),
            lines,
            floats: Vec::new(),
            normal: Vec3::ZERO,
            odd_normals: Odd::default(),
            paint,
            columns,
            meter: admission.meter(file),
            list_meter: admission.meter(file),
            bytes_each: VERTEX_BYTES + 4 * u64::from(radii) + colors + fields,
            begin: 0,
            came: 0,
            adrift: Odd::default(),
            odd_radii: Odd::default(),
            short: 0,
        }
    }

    /// Makes room for vertices that are known to come.
    ///
    /// # Errors
    /// More vertices than the options allow, or than there is memory for.
    pub fn reserve(&mut self, vertices: usize) -> Result<(), AssetError> {
        AssetError::check_limit(self.file, "vertices", vertices as u64, self.max_vertices)?;
        self.meter.reach_exactly(vertices as u64 * self.bytes_each)?;
        self.lines.positions.reserve_exact(vertices);
        self.lines.radii.iter_mut().for_each(|list| list.reserve_exact(vertices));
        self.lines.normals.iter_mut().for_each(|list| list.reserve_exact(vertices));
        self.lines.colors.iter_mut().for_each(|list| list.reserve_exact(vertices));
        if self.paint == Paint::Floats {
            self.floats.reserve_exact(vertices);
        }
        self.columns.iter_mut().for_each(|column| column.reserve(vertices));
        Ok(())
    }

    /// Makes the strands ribbons, before the first vertex.
    #[must_use]
    pub fn into_ribbons(mut self) -> Self {
        self.lines.normals = Some(Vec::new());
        self.bytes_each += size_of::<Vec3>() as u64;
        self
    }

    /// Says which normal the next vertices of a ribbon have, of any length.
    pub fn turn(&mut self, normal: Vec3) {
        self.normal = normal;
    }

    /// Adds vertices that have finite places and nothing else. The strands have neither radii nor normals, and no colours or fields from the file.
    ///
    /// # Errors
    /// More vertices than the options allow, or than there is memory for.
    pub fn places(
        &mut self,
        places: impl ExactSizeIterator<Item = DVec3>,
    ) -> Result<(), AssetError> {
        let count = (self.lines.positions.len() + places.len()) as u64;
        AssetError::check_limit(self.file, "vertices", count, self.max_vertices)?;
        self.meter.reach(count * self.bytes_each)?;
        self.came += places.len() as u64;
        self.lines.positions.extend(places);
        Ok(())
    }

    /// Adds a vertex to the strand.
    ///
    /// # Errors
    /// More vertices than the options allow, or than there is memory for.
    pub fn vertex(&mut self, vertex: Vertex) -> Result<(), AssetError> {
        let number = self.came;
        self.came += 1;
        if !vertex.position.is_finite() {
            self.adrift.add(number);
            return self.cut();
        }
        let count = self.lines.positions.len() as u64 + 1;
        if count > self.max_vertices {
            AssetError::check_limit(self.file, "vertices", count, self.max_vertices)?;
        }
        self.meter.reach(count * self.bytes_each)?;
        self.lines.positions.push(vertex.position);
        if let Some(radii) = &mut self.lines.radii {
            let is_radius = vertex.radius >= 0.0 && vertex.radius.is_finite();
            if !is_radius {
                self.odd_radii.add(number);
            }
            radii.push(if is_radius { vertex.radius } else { 0.0 });
        }
        if let Some(normals) = &mut self.lines.normals {
            let unit = self.normal.try_normalize();
            if unit.is_none() {
                self.odd_normals.add(number);
            }
            normals.push(unit.unwrap_or(Vec3::Z));
        }
        match (self.paint, &mut self.lines.colors) {
            (Paint::Bytes, Some(colors)) => colors.push(vertex.color.map(|channel| channel as u8)),
            (Paint::Floats, _) => self.floats.push(vertex.color),
            _ => {}
        }
        for (column, &value) in self.columns.iter_mut().zip(vertex.values) {
            column.push(value.into());
        }
        Ok(())
    }

    /// Ends the strand. The next vertex begins another one.
    ///
    /// # Errors
    /// There is no memory for it.
    pub fn cut(&mut self) -> Result<(), AssetError> {
        let (begin, end) = (self.begin, self.lines.positions.len());
        if end == begin {
            return Ok(());
        }
        if end - begin == 1 {
            self.short += 1;
            self.lines.positions.truncate(begin);
            self.lines.radii.iter_mut().for_each(|list| list.truncate(begin));
            self.lines.normals.iter_mut().for_each(|list| list.truncate(begin));
            self.floats.truncate(begin);
            if self.paint == Paint::Bytes {
                self.lines.colors.iter_mut().for_each(|list| list.truncate(begin));
            }
            self.columns.iter_mut().for_each(|column| column.truncate(begin));
            return Ok(());
        }
        self.list_meter.reach(4 * (self.lines.strands.len() as u64 + 2))?;
        self.lines.strands.push(begin as u32);
        self.begin = end;
        Ok(())
    }

    /// Number of vertices that came.
    pub fn came(&self) -> u64 {
        self.came
    }

    /// The strands, and the warnings about them.
    ///
    /// # Errors
    /// No strand is left.
    pub fn finish(mut self, warnings: &mut Vec<String>) -> Result<Polylines, AssetError> {
        self.cut()?;
        warnings.extend(self.adrift.warning(
            "vertex with non-finite coordinates is left out, and its strand is cut there",
            "vertices with non-finite coordinates are left out, and their strands are cut there",
            "vertex",
        ));
        warnings.extend(self.odd_radii.warning(
            "radius is negative or not a number; 0 is used",
            "radii are negative or not numbers; 0 is used",
            "that of vertex",
        ));
        warnings.extend(self.odd_normals.warning(
            "normal has no direction and is taken as 0, 0, 1",
            "normals have no direction and are taken as 0, 0, 1",
            "that of vertex",
        ));
        warnings.extend(counted(
            self.short,
            "strand of a single vertex is left out",
            "strands of a single vertex are left out",
        ));
        if self.lines.strands.is_empty() {
            let reason = match self.came {
                0 => "the file holds no strands",
                _ => "no strand has two vertices with finite coordinates",
            };
            return Err(AssetError::malformed(self.file, "strand", reason));
        }
        let mut lines = self.lines;
        lines.strands.push(lines.positions.len() as u32);
        match self.paint {
            Paint::Floats => {
                lines.colors =
                    Some(tidy::colors_from_floats(&self.floats, "that of vertex", warnings))
            }
            Paint::Direction => color_by_direction(&mut lines),
            Paint::Nothing | Paint::Bytes => {}
        }
        lines.fields = fields::encoded(self.columns, warnings);
        Ok(lines)
    }

    /// Does the same as [`Self::finish`] for a format that has other kinds of geometry as well. Where no strand is left of a file that
    /// `has_others`, `None` and a warning tell so.
    ///
    /// # Errors
    /// No strand is left and the file has no other geometry, or there is no memory for the last strand.
    pub fn finish_beside(
        self,
        has_others: bool,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Polylines>, AssetError> {
        match self.finish(warnings) {
            Ok(lines) => Ok(Some(lines)),
            Err(AssetError::Malformed { reason, .. }) if has_others => {
                warnings.push(format!("lines are left out: {reason}"));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// [`Self::finish`] for a format that holds nothing but strands.
    ///
    /// # Errors
    /// No strand is left.
    pub fn into_asset(
        self,
        format: &'static str,
        mut warnings: Vec<String>,
    ) -> Result<Asset, AssetError> {
        let file = self.file;
        let lines = self.finish(&mut warnings)?;
        let mut asset = Asset::single(format, file, Geometry::Lines(lines));
        asset.warnings = warnings;
        Ok(asset)
    }
}

/// Gives all vertices the colours of their strands' directions, in parallel.
fn color_by_direction(lines: &mut Polylines) {
    let Polylines { positions, strands, colors, .. } = lines;
    let colors = colors.get_or_insert_default();
    colors.resize(positions.len(), NEUTRAL);
    colors.par_chunks_mut(COLORED_AT_A_TIME).enumerate().for_each(|(part, colors)| {
        let begin = part * COLORED_AT_A_TIME;
        // The strand behind the one that the vertex belongs to.
        let mut after = strands.partition_point(|&first| first as usize <= begin);
        for (vertex, color) in (begin..).zip(colors) {
            after += usize::from(strands[after] as usize <= vertex);
            let (first, end) = (strands[after - 1] as usize, strands[after] as usize);
            *color = direction_color(&positions[first..end], vertex - first);
        }
    });
}

/// Appends the colours of a strand's directions.
pub fn direction_colors(strand: &[DVec3], colors: &mut Vec<[u8; 4]>) {
    colors.extend((0..strand.len()).map(|at| direction_color(strand, at)));
}

/// The colour of a strand's direction at a vertex: that of the chord between its neighbours. Where they are at one place, it is that of the
/// segment behind it.
fn direction_color(strand: &[DVec3], at: usize) -> [u8; 4] {
    let last = strand.len() - 1;
    let (before, after) = (strand[at.saturating_sub(1)], strand[(at + 1).min(last)]);
    let chord = if after == before { after - strand[at] } else { after - before };
    // Scaled first: squares of very long or short chords leave the range of f64.
    let chord = chord / chord.abs().max_element();
    let channels = chord.abs() * (255.0 / chord.length());
    if !channels.is_finite() {
        return NEUTRAL;
    }
    let [r, g, b] = channels.to_array().map(|channel| channel.round() as u8);
    [r, g, b, 255]
}

#[cfg(test)]
mod tests;
