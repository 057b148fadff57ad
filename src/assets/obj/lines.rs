//! Line elements to strands.

use super::super::input::Origin;
use super::super::strands::{Attributes, Paint, Strands, Vertex};
use super::super::tokens::Tokens;
use super::super::{AssetError, Polylines, ReadOptions};
use super::Statements;

/// The line elements of a file, as they stand.
#[derive(Default)]
pub(super) struct LineElements {
    /// Positions of all their vertices.
    vertices: Vec<u32>,
    /// Where each ends among the vertices, and the line of the file that it is on.
    ends: Vec<(u64, u32)>,
}

impl LineElements {
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn bytes(&self) -> u64 {
        4 * self.vertices.len() as u64 + 16 * self.ends.len() as u64
    }
}

impl Statements<'_> {
    /// Reads `v` or `v/t` for each vertex; texture coordinates of lines mean nothing here.
    pub(super) fn line_element(&mut self, tokens: Tokens, line: u64) -> Result<(), String> {
        for token in tokens.take_while(|token| !token.starts_with(b"#")) {
            let [vertex, ..] = self.corner(token)?;
            self.line_elements.vertices.push(vertex);
        }
        let end = self.line_elements.vertices.len() as u64;
        self.line_elements.ends.push((end, u32::try_from(line).unwrap_or(u32::MAX)));
        Ok(())
    }

    /// The strands; `None` where the file has no line elements, or has faces and no line element with two vertices.
    pub(super) fn strands(
        &self,
        colors: Option<&[[u8; 4]]>,
        origin: &Origin,
        options: &ReadOptions,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Polylines>, AssetError> {
        if self.line_elements.is_empty() {
            return Ok(None);
        }
        let paint = if colors.is_some() { Paint::Bytes } else { Paint::Nothing };
        let attributes = Attributes { paint, ..Attributes::nothing() };
        let mut strands = Strands::new(origin, options, attributes);
        strands.reserve(self.line_elements.vertices.len())?;
        let mut vertices = self.line_elements.vertices.iter();
        let mut begin = 0;
        for (element, &(end, line)) in self.line_elements.ends.iter().enumerate() {
            for &vertex in vertices.by_ref().take((end - begin) as usize) {
                let at = vertex as usize;
                let Some(&position) = self.positions.get(at) else {
                    let count = self.positions.len();
                    let reason =
                        format!("vertex {} does not exist, the file has {count}", at as u64 + 1);
                    let place = format!("line element {element} (line {line})");
                    return Err(AssetError::malformed(self.file, place, reason));
                };
                let color = colors.and_then(|colors| colors.get(at).copied()).unwrap_or_default();
                strands.vertex(Vertex { color: color.map(f32::from), ..Vertex::at(position) })?;
            }
            strands.cut()?;
            begin = end;
        }
        strands.finish_beside(!self.faces.is_empty(), warnings)
    }
}
