//! Scalar fields of a scene's points and lines, and the classes of laser scans.

use serde::Serialize;
use utoipa::ToSchema;

/// A scalar field that some of a scene's points or lines have.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct SceneField {
    pub name: String,
    /// Smallest and largest value.
    pub least: f64,
    pub most: f64,
    /// Values that a colour map shows by default: from the smallest 1st percentile of an asset to the largest 99th percentile.
    pub shown: [f64; 2],
    /// For classes, those that points or vertices of lines have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub classes: Option<Vec<u8>>,
}

/// Names and sRGB colours of the ASPRS standard classes 0 to 22 (LAS 1.4 R15, table 17): vegetation in greens,
/// buildings in red, water in blue, transport in greys, noise in magenta.
const CLASSES: [(&str, [u8; 3]); 23] = [
    ("never classified", [170, 170, 170]),
    ("unclassified", [204, 204, 204]),
    ("ground", [160, 120, 80]),
    ("low vegetation", [170, 210, 120]),
    ("medium vegetation", [100, 180, 80]),
    ("high vegetation", [40, 130, 50]),
    ("building", [210, 80, 60]),
    ("low point (noise)", [255, 0, 255]),
    ("model key point", [240, 220, 90]),
    ("water", [60, 130, 220]),
    ("rail", [150, 110, 160]),
    ("road surface", [110, 110, 120]),
    ("overlap", [150, 190, 200]),
    ("wire, guard", [240, 190, 70]),
    ("wire, conductor", [255, 220, 60]),
    ("transmission tower", [120, 80, 180]),
    ("wire connector", [200, 150, 60]),
    ("bridge deck", [140, 150, 160]),
    ("high noise", [200, 0, 200]),
    ("overhead structure", [190, 140, 110]),
    ("ignored ground", [130, 100, 60]),
    ("snow", [235, 245, 255]),
    ("temporal exclusion", [220, 200, 180]),
];

/// The name of an ASPRS standard class.
pub fn class_name(class: u8) -> Option<&'static str> {
    CLASSES.get(usize::from(class)).map(|&(name, _)| name)
}

/// The sRGB of a class: customary colours for standard classes, one of 20 hues for others.
pub fn class_color(class: u8) -> [u8; 3] {
    if let Some(&(_, color)) = CLASSES.get(usize::from(class)) {
        return color;
    }
    // Steps of 7 on a wheel of 20 hues keep neighbouring classes apart.
    let hue = f32::from(class) * 7.0 % 20.0 / 20.0 * 6.0;
    let channel = |offset: f32| {
        let distance = ((hue + offset) % 6.0 - 3.0).abs();
        ((0.3 + 0.6 * (distance - 1.0).clamp(0.0, 1.0)) * 255.0).round() as u8
    };
    [channel(0.0), channel(4.0), channel(2.0)]
}

/// The number, 0 to 255, whose colour a label has. Labels beyond share the colours of numbers from 32 on, which have no meaning of
/// their own.
pub fn class_number(label: f64) -> u8 {
    let label = label.round() as i64;
    u8::try_from(label).unwrap_or_else(|_| 32 + label.rem_euclid(224) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_any_size_have_a_colour() {
        assert_eq!([0.0, 31.0, 255.0].map(class_number), [0, 31, 255]);
        let beyond = [256.0, -1.0, 479.0, 1e300].map(class_number);
        assert!(beyond.iter().all(|&class| class >= 32), "{beyond:?}");
        assert_ne!(class_number(256.0), class_number(257.0));
        assert!((22..255).all(|class| class_color(class) != class_color(class + 1)));
        assert_eq!((class_name(6), class_name(23)), (Some("building"), None));
    }
}
