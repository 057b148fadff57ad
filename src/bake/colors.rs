//! Colours for points without any.

use rayon::prelude::*;

use super::pack::CodeCounts;
use crate::assets::fields::{CLASSIFICATION, INTENSITY, Scale};
use crate::assets::{Field, NEUTRAL, PointCloud};
use crate::scene::fields::{class_color, class_number};

/// Intensities below and above these fractions of all points become the darkest and the lightest grey.
const STRETCH: [f64; 2] = [0.01, 0.99];
/// The darkest grey, which stands out from the default background (`#202428`).
const FLOOR: f64 = 80.0;
/// Minimum grey of the median intensity, as a share of the range from the darkest to the lightest: most intensities of a survey
/// are low, and few returns are very bright.
const MEDIAN: f64 = 0.45;
/// Minimum exponent: a smaller one would turn the lowest intensities into noise.
const LEAST_EXPONENT: f64 = 0.4;

/// Gives a cloud colours if it has none: grey from its intensity, stretched between the 1st and the
/// 99th percentile; else, when it has several classes, a colour for each; else one light grey. Returns whether the intensity
/// is shown.
///
/// Classes have the colours of [`class_color`].
pub fn fill_colors(cloud: &mut PointCloud) -> bool {
    let count = cloud.positions.len();
    if cloud.colors.as_ref().is_some_and(|colors| colors.len() == count) {
        return false;
    }
    let list = cloud.fields.list();
    let counted = |field: &Field| {
        let mut counts = CodeCounts::default();
        if Painter::needs(&field.name) {
            counts.add(field, &cloud.fields);
        }
        counts
    };
    let counts: Vec<CodeCounts> = list.iter().map(counted).collect();
    let painter = Painter::of(list.iter().zip(&counts));
    let color = |point: usize| painter.color(|field| list[field].code(cloud.fields.at(point)));
    cloud.colors = Some((0..count).into_par_iter().map(color).collect());
    painter.shows_intensity()
}

/// Colours of points that have none in their file.
#[derive(Clone, Copy, Debug)]
pub(super) enum Painter {
    /// Grey from a field's code.
    Greys {
        field: usize,
        scale: Scale,
        low: f64,
        extent: f64,
        exponent: f64,
    },
    /// A colour for each value of a field.
    Classes {
        field: usize,
        scale: Scale,
    },
    Neutral,
}

impl Painter {
    /// Whether a field with this name may decide colours.
    fn needs(name: &str) -> bool {
        name == INTENSITY || name == CLASSIFICATION
    }

    /// Colours for points with these fields.
    pub(super) fn of<'a>(fields: impl Iterator<Item = (&'a Field, &'a CodeCounts)>) -> Painter {
        let mut found = Painter::Neutral;
        for (field, (Field { name, scale, .. }, counts)) in fields.enumerate() {
            let scale = *scale;
            if name == INTENSITY
                && let Some([low, median, high]) = stretch(counts, &scale)
            {
                let extent = high - low;
                let middle = ((median - low) / extent).clamp(1e-6, 1.0);
                let exponent = match middle < MEDIAN {
                    true => (MEDIAN.ln() / middle.ln()).max(LEAST_EXPONENT),
                    false => 1.0,
                };
                return Painter::Greys { field, scale, low, extent, exponent };
            }
            if name == CLASSIFICATION && counts.of(&scale).nth(1).is_some() {
                found = Painter::Classes { field, scale };
            }
        }
        found
    }

    fn shows_intensity(&self) -> bool {
        matches!(self, Painter::Greys { .. })
    }

    /// The colour of a point, given the code of each field.
    pub(super) fn color(&self, code: impl Fn(usize) -> u16) -> [u8; 4] {
        match *self {
            Painter::Greys { field, scale, low, extent, exponent } => {
                let code = Some(code(field)).filter(|&code| code <= scale.most).unwrap_or_default();
                let share = ((f64::from(code) - low) / extent).clamp(0.0, 1.0);
                let level = (FLOOR + share.powf(exponent) * (255.0 - FLOOR)).round() as u8;
                [level, level, level, 255]
            }
            Painter::Classes { field, scale } => {
                scale.value(code(field)).map_or(NEUTRAL, |class| {
                    let [r, g, b] = class_color(class_number(class));
                    [r, g, b, 255]
                })
            }
            Painter::Neutral => NEUTRAL,
        }
    }
}

/// Percentiles of codes: low, median, high. `None` if all points have the same code.
fn stretch(counts: &CodeCounts, scale: &Scale) -> Option<[f64; 3]> {
    let percentile = |fraction| counts.percentile(scale, fraction);
    let [mut low, mut high] = [percentile(STRETCH[0])?, percentile(STRETCH[1])?];
    if low == high {
        // Nearly all points agree: the few others still differ.
        low = counts.of(scale).next()?.0;
        high = counts.of(scale).last()?.0;
    }
    let median = percentile(0.5)?;
    (low != high).then_some([low, median, high].map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::Fields;
    use glam::DVec3;

    fn cloud(count: usize) -> PointCloud {
        PointCloud { positions: vec![DVec3::ZERO; count], ..PointCloud::default() }
    }

    #[test]
    fn intensity_is_stretched_between_percentiles() {
        let mut cloud = cloud(1001);
        let mut values: Vec<u16> = (0..1001).map(|i| 1000 + i).collect();
        (values[0], values[1000]) = (0, 65535);
        let classes = (0..1001).map(|i| i % 2).collect();
        cloud.fields = Fields::of_numbers(vec![(CLASSIFICATION, classes), (INTENSITY, values)]);
        fill_colors(&mut cloud);
        let colors = cloud.colors.unwrap();
        assert_eq!(
            [colors[0], colors[10], colors[1000]],
            [[80, 80, 80, 255], [80, 80, 80, 255], [255; 4]]
        );
        assert_eq!(colors[500], [168, 168, 168, 255]);
    }

    #[test]
    fn most_of_a_cloud_with_few_bright_returns_is_not_dark() {
        let mut cloud = cloud(1000);
        // Intensities as in surveys: most returns are weak, and a few come from reflectors.
        let values = (0..1000).map(|i| if i < 970 { 2 + i % 40 } else { 3000 }).collect();
        cloud.fields = Fields::of_numbers(vec![(INTENSITY, values)]);
        assert!(fill_colors(&mut cloud));
        let colors = cloud.colors.unwrap();
        let background = 0x24;
        let dark = colors.iter().filter(|color| color[0] < 2 * background).count();
        assert_eq!(dark, 0);
        let mut levels: Vec<u8> = colors.iter().map(|color| color[0]).collect();
        levels.sort_unstable();
        assert!(levels[500] > levels[20] + 10, "{levels:?}");
    }

    #[test]
    fn classes_have_colours_of_their_own() {
        let mut cloud = cloud(256);
        let classes = (0..=255).collect();
        let same = vec![7; 256];
        cloud.fields = Fields::of_numbers(vec![(INTENSITY, same), (CLASSIFICATION, classes)]);
        fill_colors(&mut cloud);
        let colors = cloud.colors.unwrap();
        assert_eq!(colors[6], [210, 80, 60, 255]);
        assert!(colors[23..].windows(2).all(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn without_anything_points_are_grey_and_colours_are_kept() {
        let mut plain = cloud(3);
        plain.fields = Fields::of_numbers(vec![(CLASSIFICATION, vec![2; 3])]);
        fill_colors(&mut plain);
        assert_eq!(plain.colors, Some(vec![NEUTRAL; 3]));
        plain.colors = Some(vec![[1, 2, 3, 4]; 3]);
        fill_colors(&mut plain);
        assert_eq!(plain.colors, Some(vec![[1, 2, 3, 4]; 3]));
        let mut empty = cloud(0);
        empty.fields = Fields::of_numbers(vec![(INTENSITY, Vec::new())]);
        fill_colors(&mut empty);
        assert_eq!(empty.colors, Some(Vec::new()));
    }
}
