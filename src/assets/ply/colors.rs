//! Colours of vertices and of faces.

use super::super::points::WordColors;
use super::super::tidy;
use super::body::Wanted;
use super::header::{Element, Kind, Scalar};

/// Names of the properties of red, green, blue and alpha, the best first.
const NAMES: [&[&str]; 4] = [
    &["red", "diffuse_red", "color_0", "r"],
    &["green", "diffuse_green", "color_1", "g"],
    &["blue", "diffuse_blue", "color_2", "b"],
    &["alpha", "diffuse_alpha", "color_3", "a"],
];
/// A triangle's face where that has no colour.
const NO_FACE: u32 = u32::MAX;

/// The properties that are an element's colours: none at all, or red, green, blue and, if there is one, alpha.
pub(super) fn properties(element: &Element) -> [Option<usize>; 4] {
    let found = NAMES.map(|names| element.scalar(names));
    if found[..3].contains(&None) { [None; 4] } else { found }
}

/// Colours as they come in.
pub(super) enum Colors {
    None,
    Bytes(Vec<[u8; 4]>),
    /// Integers of 16 bits and, unless it is empty, their alpha. Many hold values of 8 bits.
    Words(Vec<[u16; 3]>, Vec<u16>),
    Floats(Vec<[f32; 4]>),
}

impl Colors {
    /// A column for the colours of an element in these [`properties`].
    pub fn new(
        element: &Element,
        [red, _, _, alpha]: [Option<usize>; 4],
        reserve: usize,
    ) -> Colors {
        match red.map(|property| element.properties[property].kind) {
            None | Some(Kind::List { .. }) => Colors::None,
            Some(Kind::Scalar(scalar)) if scalar.is_float() => {
                Colors::Floats(Vec::with_capacity(reserve))
            }
            Some(Kind::Scalar(Scalar::U16 | Scalar::I16)) => {
                let alphas = if alpha.is_some() { reserve } else { 0 };
                Colors::Words(Vec::with_capacity(reserve), Vec::with_capacity(alphas))
            }
            Some(Kind::Scalar(_)) => Colors::Bytes(Vec::with_capacity(reserve)),
        }
    }

    /// How many there are so far.
    fn len(&self) -> usize {
        match self {
            Colors::None => 0,
            Colors::Bytes(colors) => colors.len(),
            Colors::Words(colors, _) => colors.len(),
            Colors::Floats(colors) => colors.len(),
        }
    }

    /// Adds a colour. All or none have an alpha.
    pub fn push(&mut self, rgb: [f64; 3], alpha: Option<f64>) {
        let [r, g, b] = rgb;
        match self {
            Colors::None => {}
            Colors::Bytes(colors) => {
                let rgba = [r, g, b, alpha.unwrap_or(255.0)];
                colors.push(rgba.map(|channel| channel.round() as u8));
            }
            Colors::Words(colors, alphas) => {
                let word = |channel: f64| channel.round() as u16;
                colors.push(rgb.map(word));
                alphas.extend(alpha.map(word));
            }
            Colors::Floats(colors) => {
                let rgba = [r, g, b, alpha.unwrap_or(f64::NAN)];
                colors.push(rgba.map(|channel| channel as f32));
            }
        }
    }

    /// Whether any is not black: software declares colours that it does not fill.
    pub fn are_filled(&self) -> bool {
        match self {
            Colors::None => false,
            Colors::Bytes(colors) => colors.iter().any(|[r, g, b, _]| [*r, *g, *b] != [0; 3]),
            Colors::Words(colors, _) => colors.iter().any(|color| *color != [0; 3]),
            Colors::Floats(colors) => colors.iter().any(|[r, g, b, _]| [*r, *g, *b] != [0.0; 3]),
        }
    }

    /// The colours as bytes, if any is filled. Warnings call the first one at fault `first` and its number.
    pub fn finish(self, first: &str, warnings: &mut Vec<String>) -> Option<Vec<[u8; 4]>> {
        match self {
            colors if !colors.are_filled() => None,
            Colors::None => None,
            Colors::Bytes(colors) => Some(colors),
            Colors::Words(colors, alpha) => {
                let mut range = WordColors::default();
                range.add(&colors);
                bytes_of_words(&colors, &alpha, range)
            }
            Colors::Floats(colors) => Some(tidy::colors_from_floats(&colors, first, warnings)),
        }
    }
}

/// Bytes of colours of 16 bits, of which `range` has seen all.
pub(super) fn bytes_of_words(
    rgb: &[[u16; 3]],
    alpha: &[u16],
    range: WordColors,
) -> Option<Vec<[u8; 4]>> {
    let mut colors = range.colors(rgb)?;
    colors.iter_mut().zip(alpha).for_each(|(color, &alpha)| color[3] = range.alpha(alpha));
    Some(colors)
}

/// Colours of faces, and the triangles that have them.
pub(super) struct FaceColors {
    colors: Colors,
    /// For each triangle up to the last one with a colour, the number of its face among those with a colour.
    faces: Vec<u32>,
}

impl FaceColors {
    pub fn nothing() -> FaceColors {
        FaceColors { colors: Colors::None, faces: Vec::new() }
    }

    /// Asks for the colours of an element's faces. False where an element before has colours, too.
    pub fn ask(&mut self, element: &Element, wanted: &mut Wanted) -> bool {
        let properties = properties(element);
        if properties[0].is_none() {
            return true;
        }
        if !matches!(self.colors, Colors::None) {
            return false;
        }
        self.colors = Colors::new(element, properties, 0);
        let found = properties.into_iter().flatten();
        wanted.values = found.clone().count();
        found.enumerate().for_each(|(slot, property)| wanted.slots[property] = Some(slot));
        true
    }

    /// Takes the colour of a face from the values that [`Self::ask`] wants, and returns the number for [`Self::give`].
    pub fn push(&mut self, values: &[f64]) -> u32 {
        let &[r, g, b, ref alpha @ ..] = values else { return NO_FACE };
        let number = self.colors.len() as u32;
        self.colors.push([r, g, b], alpha.first().copied());
        number
    }

    /// Gives a triangle its face's colour.
    pub fn give(&mut self, face: u32, triangle: usize) {
        if face != NO_FACE {
            self.faces.resize(triangle, NO_FACE);
            self.faces.push(face);
        }
    }

    /// Bytes of what has been read, and of a colour for each triangle.
    pub fn bytes(&self) -> u64 {
        (16 * self.colors.len() + 8 * self.faces.len()) as u64
    }

    /// The colours of that many triangles, white where a face has none; `None` where no face has one.
    pub fn of_triangles(
        mut self,
        triangles: usize,
        warnings: &mut Vec<String>,
    ) -> Option<Vec<[u8; 4]>> {
        let colors = self.colors.finish("that of face", warnings)?;
        self.faces.resize(triangles, NO_FACE);
        let color = |face: &u32| colors.get(*face as usize).copied().unwrap_or([255; 4]);
        Some(self.faces.iter().map(color).collect())
    }
}
