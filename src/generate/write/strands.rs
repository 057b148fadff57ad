//! Lines as binary files of legacy VTK, with all attributes, and as track files of MRtrix, which have places alone.

use std::io::Write;
use std::path::Path;

use super::create;
use crate::assets::Polylines;
use crate::generate::GenerateError;

/// Writes version 4.2 of the format: big-endian, coordinates in f32.
pub(super) fn vtk(lines: &Polylines, path: &Path) -> Result<(), GenerateError> {
    let strands = lines.strands.len().saturating_sub(1);
    let vertices = lines.positions.len();
    // Numbers of points and of corners are 32 bits with a sign.
    if i32::try_from(vertices + strands).is_err() {
        let reason = format!("{vertices} vertices are too many for a .vtk file: use .tck");
        return Err(GenerateError::write(path, reason));
    }
    let mut out = create(path)?;
    let mut body = || -> std::io::Result<()> {
        writeln!(out, "# vtk DataFile Version 4.2\nmade by pointillist generate\nBINARY")?;
        writeln!(out, "DATASET POLYDATA\nPOINTS {vertices} float")?;
        for position in &lines.positions {
            for axis in position.to_array() {
                out.write_all(&(axis as f32).to_be_bytes())?;
            }
        }
        writeln!(out, "\nLINES {strands} {}", vertices + strands)?;
        for ends in lines.strands.windows(2) {
            out.write_all(&(ends[1] - ends[0]).to_be_bytes())?;
            for vertex in ends[0]..ends[1] {
                out.write_all(&vertex.to_be_bytes())?;
            }
        }
        writeln!(out, "\nPOINT_DATA {vertices}")?;
        if let Some(colors) = &lines.colors {
            writeln!(out, "COLOR_SCALARS color 3")?;
            colors.iter().try_for_each(|color| out.write_all(&color[..3]))?;
            writeln!(out)?;
        }
        if let Some(radii) = &lines.radii {
            writeln!(out, "SCALARS radius float 1\nLOOKUP_TABLE default")?;
            radii.iter().try_for_each(|radius| out.write_all(&radius.to_be_bytes()))?;
            writeln!(out)?;
        }
        if let Some(normals) = &lines.normals {
            writeln!(out, "VECTORS ribbon_normals float")?;
            for normal in normals {
                out.write_all(normal.to_array().map(f32::to_be_bytes).as_flattened())?;
            }
            writeln!(out)?;
        }
        for field in lines.fields.list() {
            writeln!(out, "SCALARS {} float 1\nLOOKUP_TABLE default", field.name)?;
            for vertex in 0..vertices {
                let value = field.value(lines.fields.at(vertex)).unwrap_or(f64::NAN);
                out.write_all(&(value as f32).to_be_bytes())?;
            }
            writeln!(out)?;
        }
        out.flush()
    };
    body().map_err(GenerateError::io(path))
}

/// Writes little-endian floats of 32 bits.
pub(super) fn tck(lines: &Polylines, path: &Path) -> Result<(), GenerateError> {
    let strands = lines.strands.len().saturating_sub(1);
    let head = |offset: usize| {
        format!("mrtrix tracks\ncount: {strands}\ndatatype: Float32LE\nfile: . {offset:08}\nEND\n")
    };
    let mut out = create(path)?;
    let mut body = || -> std::io::Result<()> {
        out.write_all(head(head(0).len()).as_bytes())?;
        let mut triple =
            |numbers: [f32; 3]| out.write_all(numbers.map(f32::to_le_bytes).as_flattened());
        for ends in lines.strands.windows(2) {
            for position in &lines.positions[ends[0] as usize..ends[1] as usize] {
                triple(position.as_vec3().to_array())?;
            }
            triple([f32::NAN; 3])?;
        }
        triple([f32::INFINITY; 3])?;
        out.flush()
    };
    body().map_err(GenerateError::io(path))
}
