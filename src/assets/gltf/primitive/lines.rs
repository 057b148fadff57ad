//! Primitives of lines to strands. Segments of `LINES` that follow each other, each beginning where the one before ends, are
//! joined. The attribute `_RADIUS`, a number for each vertex, has radii.

use super::*;
use crate::assets::strands::{self, Paint, Strands, Vertex};

/// The custom attribute that has radii, without its underscore.
const RADIUS: &str = "RADIUS";

impl Primitives<'_> {
    pub(super) fn lines(
        &mut self,
        primitive: &Primitive,
        mode: Mode,
        attributes: &Attributes,
        indices: &[u32],
        material: Option<&Material>,
        place: &str,
    ) -> Result<Option<Geometry>, AssetError> {
        let radii = self.radii(primitive, attributes.positions.len(), place)?;
        // A loop ends at its first vertex, and every segment may be a strand.
        let count = indices.len() + 1;
        self.keep(count, 0, place)?;
        let has_colors = attributes.colors.is_some() || material.is_some();
        let described = strands::Attributes {
            radii: radii.is_some(),
            paint: if has_colors { Paint::Bytes } else { Paint::Nothing },
            columns: Vec::new(),
        };
        let file = format!("{}: {place}", self.file);
        let admission = self.buffers.admission.clone();
        let mut strands = Strands::within(&file, &admission, count as u64, described);
        let default = Material::default();
        let add = |strands: &mut Strands, index: u32| {
            let at = index as usize;
            let own = attributes.colors.as_ref().and_then(|colors| colors.get(at).copied());
            let color = match (own, material) {
                (None, None) => None,
                (own, material) => {
                    Some(painted(own.unwrap_or([255; 4]), material.unwrap_or(&default)))
                }
            };
            strands.vertex(Vertex {
                position: attributes.positions.get(at).copied().unwrap_or(DVec3::NAN),
                radius: radii.as_ref().and_then(|radii| radii.get(at).copied()).unwrap_or(0.0),
                color: color.map_or([0.0; 4], |color| color.map(f32::from)),
                values: &[],
            })
        };
        if mode == Mode::Lines {
            let (segments, rest) = indices.as_chunks::<2>();
            if !rest.is_empty() {
                self.warnings.push(format!("{place}: the last line lacks an end"));
            }
            let mut end = None;
            for &[from, to] in segments {
                if end != Some(from) {
                    strands.cut()?;
                    add(&mut strands, from)?;
                }
                add(&mut strands, to)?;
                end = Some(to);
            }
        } else {
            indices.iter().try_for_each(|&index| add(&mut strands, index))?;
            if let (Mode::LineLoop, Some(&first)) = (mode, indices.first()) {
                add(&mut strands, first)?;
            }
        }
        let mut warnings = Vec::new();
        let lines = strands.finish(&mut warnings);
        self.warnings.extend(warnings.into_iter().map(|text| format!("{place}: {text}")));
        match lines {
            Ok(lines) => Ok(Some(Geometry::Lines(lines))),
            Err(AssetError::Malformed { reason, .. }) => {
                self.warnings.push(format!("{place} is left out: {reason}"));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn radii(
        &mut self,
        primitive: &Primitive,
        vertices: usize,
        place: &str,
    ) -> Result<Option<Vec<f32>>, AssetError> {
        let Some(index) = attribute(primitive, Semantic::Extras(RADIUS.to_owned())) else {
            return Ok(None);
        };
        if self.buffers.count(index)? != vertices as u64 {
            let reason = "has another number of items than POSITION and is ignored";
            self.warnings.push(format!("{place}: _{RADIUS} {reason}"));
            return Ok(None);
        }
        Ok(Some(self.buffers.floats(index, &[Type::Scalar])?.0))
    }
}
