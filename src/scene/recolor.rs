//! Named colour maps, and colours by a value of the surface.

use glam::DVec3;

use super::fields::{class_color, class_number};
use super::name::Name;
use crate::words::words;

/// Largest number of colours that a map has.
pub const MOST_COLORS: usize = 12;

words! {
    /// A map from numbers to colours: linear in sRGB between colours at equal distances.
    pub enum ColorMap {
        /// Dark violet through green to yellow; lightness grows evenly, also for colour-blind readers
        #[default]
        Viridis,
        /// Dark blue through red to yellow; lightness grows evenly
        Plasma,
        /// Blue through yellow to red, lightest in the middle
        Spectral,
        /// Black to white
        Grey,
    }
}

impl ColorMap {
    /// The colours from the least value to the largest, as sRGB bytes.
    pub fn colors(self) -> &'static [[u8; 3]] {
        match self {
            ColorMap::Viridis => &[
                [68, 1, 84],
                [71, 45, 123],
                [59, 82, 139],
                [44, 114, 142],
                [33, 145, 140],
                [40, 174, 128],
                [94, 201, 98],
                [173, 220, 48],
                [253, 231, 37],
            ],
            ColorMap::Plasma => &[
                [13, 8, 135],
                [76, 2, 161],
                [126, 3, 168],
                [170, 35, 149],
                [204, 71, 120],
                [230, 108, 92],
                [248, 149, 64],
                [253, 197, 39],
                [240, 249, 33],
            ],
            ColorMap::Spectral => &[
                [94, 79, 162],
                [50, 136, 189],
                [102, 194, 165],
                [171, 221, 164],
                [230, 245, 152],
                [255, 255, 191],
                [254, 224, 139],
                [253, 174, 97],
                [244, 109, 67],
                [213, 62, 79],
                [158, 1, 66],
            ],
            ColorMap::Grey => &[[0, 0, 0], [255, 255, 255]],
        }
    }

    /// The colour of a share of the range, 0 to 1, as sRGB from 0 to 1; nearer ends stand for what lies beyond them.
    pub fn at(self, share: f64) -> [f64; 3] {
        let colors = self.colors();
        let last = colors.len() - 1;
        let place = share.clamp(0.0, 1.0) * last as f64;
        let index = (place as usize).min(last - 1);
        let part = place - index as f64;
        let mixed = |channel: usize| {
            let [a, b] = [0, 1].map(|next| f64::from(colors[index + next][channel]));
            (a + (b - a) * part) / 255.0
        };
        [mixed(0), mixed(1), mixed(2)]
    }
}

/// Value that colours a surface, in place of its own colours.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a frame has one, and names are copied like other settings"
)]
pub enum Recolor {
    /// Distance along the scene's up direction, from a least to a largest value, through a map.
    Height { up: DVec3, range: [f64; 2], map: ColorMap },
    /// World-space normal, `n · ½ + ½` as sRGB; grey without one.
    Normal,
    /// A hue for each instance.
    Instance,
    /// A scalar field of samples and lines: the colours of its classes, or its values from a least to a largest through a map. Grey without a
    /// value.
    Field { name: Name, range: [f64; 2], map: ColorMap, has_classes: bool },
}

/// Grey of surfaces that have no value, as an sRGB byte.
pub const NO_VALUE: u8 = 128;

impl Recolor {
    /// The name of the shown scalar field; `None` if none is shown.
    pub fn field(&self) -> Option<&str> {
        match self {
            Recolor::Field { name, .. } => Some(name.as_str()),
            _ => None,
        }
    }

    /// The sRGB colour of a value of the shown field, or of its absence; grey if no field is shown.
    pub fn field_color(&self, value: Option<f64>) -> [u8; 3] {
        let (Recolor::Field { range, map, has_classes, .. }, Some(value)) = (self, value) else {
            return [NO_VALUE; 3];
        };
        if *has_classes {
            return class_color(class_number(value));
        }
        map.at(share(value, *range)).map(|channel| (channel * 255.0).round() as u8)
    }
}

/// The share that a value has of a range; the middle of a range without extent.
pub fn share(value: f64, [least, most]: [f64; 2]) -> f64 {
    if most == least { 0.5 } else { (value - least) / (most - least) }
}

/// The sRGB of the instance with an id (its number plus one), 0 to 1: neighbouring ids have different hues.
pub fn instance_color(id: u32) -> [f64; 3] {
    // Multiples of the golden ratio, in 24 bits.
    let hue = f64::from(id.wrapping_mul(0x9e37_79b9) >> 8) / f64::from(1u32 << 24) * 6.0;
    [0.0, 4.0, 2.0].map(|shift| {
        let part = (((hue + shift) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        0.25 + 0.7 * part
    })
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;

    #[test]
    fn maps_go_from_their_first_colour_to_their_last() {
        for map in ColorMap::value_variants() {
            let colors = map.colors();
            assert!((2..=MOST_COLORS).contains(&colors.len()));
            for (share, index) in
                [(-1.0, 0), (0.0, 0), (1.0, colors.len() - 1), (9.0, colors.len() - 1)]
            {
                assert_eq!(map.at(share), colors[index].map(|byte| f64::from(byte) / 255.0));
            }
            assert!(map.at(f64::NAN).iter().all(|channel| channel.is_nan() || *channel >= 0.0));
        }
        assert_eq!(ColorMap::Grey.at(0.25), [0.25; 3]);
    }

    #[test]
    fn neighbouring_instances_have_different_hues() {
        for id in 1..200 {
            let [a, b] = [id, id + 1].map(instance_color);
            let apart: f64 = (0..3).map(|c| (a[c] - b[c]).abs()).sum();
            assert!(apart > 0.3, "{id}");
        }
    }
}
