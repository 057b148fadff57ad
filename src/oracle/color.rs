//! sRGB (IEC 61966-2-1) in f64.

/// An sRGB byte in linear light, 0..=1.
pub fn linear_from_srgb8(byte: u8) -> f64 {
    let value = f64::from(byte) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Linear light, clamped to 0..=1, as the nearest sRGB byte.
pub fn srgb8_from_linear(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let value =
        if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    byte_from_unit(value)
}

/// 0..=1, clamped, as the nearest byte.
pub fn byte_from_unit(value: f64) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// sRGB with straight alpha → linear RGB with the same alpha.
pub fn linear_from_srgba8([r, g, b, a]: [u8; 4]) -> [f64; 4] {
    [linear_from_srgb8(r), linear_from_srgb8(g), linear_from_srgb8(b), f64::from(a) / 255.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_return() {
        for byte in 0..=255 {
            assert_eq!(srgb8_from_linear(linear_from_srgb8(byte)), byte);
        }
        assert_eq!((srgb8_from_linear(-1.0), srgb8_from_linear(7.0)), (0, 255));
        assert_eq!(srgb8_from_linear(0.5), 188);
        assert!((linear_from_srgb8(188) - 0.502_886).abs() < 1e-6);
    }
}
