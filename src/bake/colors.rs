//! Colours for points without any.

use crate::assets::PointCloud;

/// Colour of points that neither intensity nor class distinguishes.
pub(super) const NEUTRAL: [u8; 4] = [204, 204, 204, 255];
/// Intensities below and above these fractions of all points become the darkest and the lightest grey.
const STRETCH: [f64; 2] = [0.01, 0.99];
/// The darkest grey, which stands out from the default background (`#202428`).
const FLOOR: f64 = 80.0;
/// Minimum grey of the median intensity, as a share of the range from the darkest to the lightest: most intensities of a survey
/// are low, and few returns are very bright.
const MEDIAN: f64 = 0.45;
/// Minimum exponent: a smaller one would turn the lowest intensities into noise.
const LEAST_EXPONENT: f64 = 0.4;

/// Colours of the ASPRS standard classes 0 to 22 (LAS 1.4 R15, table 17): vegetation in greens,
/// buildings in red, water in blue, transport in greys, noise in magenta.
const CLASS_COLORS: [[u8; 3]; 23] = [
    [170, 170, 170], // 0 created, never classified
    [204, 204, 204], // 1 unclassified
    [160, 120, 80],  // 2 ground
    [170, 210, 120], // 3 low vegetation
    [100, 180, 80],  // 4 medium vegetation
    [40, 130, 50],   // 5 high vegetation
    [210, 80, 60],   // 6 building
    [255, 0, 255],   // 7 low point (noise)
    [240, 220, 90],  // 8 model key point
    [60, 130, 220],  // 9 water
    [150, 110, 160], // 10 rail
    [110, 110, 120], // 11 road surface
    [150, 190, 200], // 12 overlap
    [240, 190, 70],  // 13 wire, guard
    [255, 220, 60],  // 14 wire, conductor
    [120, 80, 180],  // 15 transmission tower
    [200, 150, 60],  // 16 wire connector
    [140, 150, 160], // 17 bridge deck
    [200, 0, 200],   // 18 high noise
    [190, 140, 110], // 19 overhead structure
    [130, 100, 60],  // 20 ignored ground
    [235, 245, 255], // 21 snow
    [220, 200, 180], // 22 temporal exclusion
];

/// Gives a cloud colours if it has none: grey from its intensity, stretched between the 1st and the
/// 99th percentile; else, when it has several classes, a colour for each; else one light grey. Returns whether the intensity
/// is shown.
///
/// Classes 0 to 22 have the ASPRS colours above, the others one of 20 hues each.
pub fn fill_colors(cloud: &mut PointCloud) -> bool {
    let count = cloud.positions.len();
    if cloud.colors.as_ref().is_some_and(|colors| colors.len() == count) {
        return false;
    }
    let intensity = cloud.intensity.as_deref().filter(|values| values.len() == count);
    let classes = cloud.classification.as_deref().filter(|classes| classes.len() == count);
    let mut counts = Counts::default();
    counts.add(intensity.unwrap_or(&[]), classes.unwrap_or(&[]));
    let palette = counts.palette();
    let color = |i: usize| {
        palette.color(intensity.map_or(0, |values| values[i]), classes.map_or(0, |c| c[i]))
    };
    cloud.colors = Some((0..count).map(color).collect());
    matches!(palette, Palette::Greys { .. })
}

/// Histograms of intensities and classes.
#[derive(Clone, Debug)]
pub(super) struct Counts {
    intensities: Vec<u64>,
    classes: Vec<u64>,
}

impl Default for Counts {
    fn default() -> Counts {
        Counts { intensities: vec![0; 1 << 16], classes: vec![0; 1 << 8] }
    }
}

impl Counts {
    pub(super) fn add(&mut self, intensities: &[u16], classes: &[u8]) {
        intensities.iter().for_each(|&value| self.intensities[usize::from(value)] += 1);
        classes.iter().for_each(|&class| self.classes[usize::from(class)] += 1);
    }

    /// The palette of points without colours.
    pub(super) fn palette(&self) -> Palette {
        if let Some([low, median, high]) = self.stretch() {
            let extent = high - low;
            let middle = ((median - low) / extent).clamp(1e-6, 1.0);
            let exponent =
                if middle < MEDIAN { (MEDIAN.ln() / middle.ln()).max(LEAST_EXPONENT) } else { 1.0 };
            return Palette::Greys { low, extent, exponent };
        }
        let several = self.classes.iter().filter(|&&count| count > 0).count() > 1;
        if several { Palette::Classes } else { Palette::Neutral }
    }

    /// Percentiles of the intensity: low, median, high. `None` if all points have the same intensity.
    fn stretch(&self) -> Option<[f64; 3]> {
        let total: u64 = self.intensities.iter().sum();
        let percentile = |fraction: f64| {
            let rank = ((total as f64 - 1.0) * fraction).round() as u64;
            let mut below = 0;
            self.intensities.iter().position(|&count| {
                below += count;
                below > rank
            })
        };
        let [mut low, mut high] = [percentile(STRETCH[0])?, percentile(STRETCH[1])?];
        if low == high {
            // Nearly all points agree: the few others still differ.
            low = self.intensities.iter().position(|&count| count > 0)?;
            high = self.intensities.iter().rposition(|&count| count > 0)?;
        }
        let median = percentile(0.5)?;
        (low != high).then_some([low as f64, median as f64, high as f64])
    }
}

/// Colours of points without any.
#[derive(Clone, Copy, Debug)]
pub(super) enum Palette {
    Greys { low: f64, extent: f64, exponent: f64 },
    Classes,
    Neutral,
}

impl Palette {
    pub(super) fn color(self, intensity: u16, class: u8) -> [u8; 4] {
        match self {
            Palette::Greys { low, extent, exponent } => {
                let share = ((f64::from(intensity) - low) / extent).clamp(0.0, 1.0);
                let level = (FLOOR + share.powf(exponent) * (255.0 - FLOOR)).round() as u8;
                [level, level, level, 255]
            }
            Palette::Classes => class_color(class),
            Palette::Neutral => NEUTRAL,
        }
    }
}

fn class_color(class: u8) -> [u8; 4] {
    if let Some(&[r, g, b]) = CLASS_COLORS.get(usize::from(class)) {
        return [r, g, b, 255];
    }
    // Steps of 7 on a wheel of 20 hues keep neighbouring classes apart.
    let hue = f32::from(class) * 7.0 % 20.0 / 20.0 * 6.0;
    let channel = |offset: f32| {
        let distance = ((hue + offset) % 6.0 - 3.0).abs();
        ((0.3 + 0.6 * (distance - 1.0).clamp(0.0, 1.0)) * 255.0).round() as u8
    };
    [channel(0.0), channel(4.0), channel(2.0), 255]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn cloud(count: usize) -> PointCloud {
        PointCloud { positions: vec![DVec3::ZERO; count], ..PointCloud::default() }
    }

    #[test]
    fn intensity_is_stretched_between_percentiles() {
        let mut cloud = cloud(1001);
        let mut values: Vec<u16> = (0..1001).map(|i| 1000 + i).collect();
        (values[0], values[1000]) = (0, 65535);
        cloud.intensity = Some(values);
        cloud.classification = Some((0..1001).map(|i| (i % 2) as u8).collect());
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
        cloud.intensity =
            Some((0..1000).map(|i| if i < 970 { 2 + i % 40 } else { 3000 }).collect());
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
        cloud.intensity = Some(vec![7; 256]);
        cloud.classification = Some((0..=255).collect());
        fill_colors(&mut cloud);
        let colors = cloud.colors.unwrap();
        assert_eq!(colors[6], [210, 80, 60, 255]);
        assert!(colors[23..].windows(2).all(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn without_anything_points_are_grey_and_colours_are_kept() {
        let mut plain = cloud(3);
        plain.classification = Some(vec![2; 3]);
        fill_colors(&mut plain);
        assert_eq!(plain.colors, Some(vec![NEUTRAL; 3]));
        plain.colors = Some(vec![[1, 2, 3, 4]; 3]);
        fill_colors(&mut plain);
        assert_eq!(plain.colors, Some(vec![[1, 2, 3, 4]; 3]));
        let mut empty = cloud(0);
        empty.intensity = Some(Vec::new());
        fill_colors(&mut empty);
        assert_eq!(empty.colors, Some(Vec::new()));
    }
}
