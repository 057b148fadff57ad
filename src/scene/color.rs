//! Colours as scene files write them: sRGB, in hex or as three numbers.

/// One sRGB channel in `0..=1` as linear light (IEC 61966-2-1).
pub fn linear_from_srgb(channel: f64) -> f64 {
    if channel <= 0.040_45 { channel / 12.92 } else { ((channel + 0.055) / 1.055).powf(2.4) }
}

/// The inverse of [`linear_from_srgb`].
pub fn srgb_from_linear(channel: f64) -> f64 {
    if channel <= 0.003_130_8 { channel * 12.92 } else { 1.055 * channel.powf(1.0 / 2.4) - 0.055 }
}

/// Reads `#rgb`, `#rrggbb` or `#rrggbbaa` as sRGB channels and straight alpha in `0..=1`.
pub fn parse_hex(text: &str) -> Option<[f64; 4]> {
    let digits = text.strip_prefix('#')?;
    if !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let number = u64::from(u32::from_str_radix(digits, 16).ok()?);
    let channels = match digits.len() {
        3 => [number >> 8 & 15, number >> 4 & 15, number & 15, 15].map(|nibble| nibble * 17),
        6 => [number >> 16, number >> 8, number, 255].map(|byte| byte & 255),
        8 => [number >> 24, number >> 16, number >> 8, number].map(|byte| byte & 255),
        _ => return None,
    };
    Some(channels.map(|byte| byte as f64 / 255.0))
}

/// sRGB with alpha → linear with alpha, in f32 as shaders take it.
pub fn to_linear(srgb: [f64; 4]) -> [f32; 4] {
    let [r, g, b, a] = srgb;
    [linear_from_srgb(r) as f32, linear_from_srgb(g) as f32, linear_from_srgb(b) as f32, a as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_in_all_lengths() {
        assert_eq!(parse_hex("#fff"), Some([1.0; 4]));
        assert_eq!(parse_hex("#f08"), Some([1.0, 0.0, 136.0 / 255.0, 1.0]));
        assert_eq!(parse_hex("#336699"), Some([0.2, 0.4, 0.6, 1.0]));
        assert_eq!(parse_hex("#00000080"), Some([0.0, 0.0, 0.0, 128.0 / 255.0]));
        for bad in ["", "#", "fff", "#ff", "#ffff", "#+12345", "#gggggg", "#123456789", "#äöü"] {
            assert_eq!(parse_hex(bad), None, "{bad}");
        }
    }

    #[test]
    fn the_curve_has_its_known_points() {
        assert_eq!(linear_from_srgb(0.0), 0.0);
        assert!((linear_from_srgb(1.0) - 1.0).abs() < 1e-12);
        assert!((linear_from_srgb(0.5) - 0.214_041_140_482_232_55).abs() < 1e-9);
        let knee = 0.040_45;
        assert!((linear_from_srgb(knee) - linear_from_srgb(knee + 1e-12)).abs() < 1e-7);
    }
}
