//! Exposure and tone mapping of the light that surfaces reflect and give off.

use crate::scene::{Tone, ToneMap};

/// The colour that light of a surface is shown as, linear RGB.
pub fn mapped(light: [f64; 3], tone: &Tone) -> [f64; 3] {
    let light = light.map(|channel| channel * tone.stops.exp2());
    match tone.map {
        ToneMap::None => light,
        ToneMap::Neutral => neutral(light),
        ToneMap::Aces => aces(light),
    }
}

/// Khronos PBR Neutral (Khronos Group 2024).
fn neutral(light: [f64; 3]) -> [f64; 3] {
    const START: f64 = 0.8 - 0.04;
    let least = light.into_iter().fold(f64::INFINITY, f64::min);
    let offset = if least < 0.08 { least - 6.25 * least.powi(2) } else { 0.04 };
    let light = light.map(|channel| channel - offset);
    let peak = light.into_iter().fold(0.0, f64::max);
    if peak < START {
        return light;
    }
    let room = 1.0 - START;
    let compressed = 1.0 - room * room / (peak + room - START);
    let grey = 1.0 - 1.0 / (0.15 * (peak - compressed) + 1.0);
    light.map(|channel| channel * compressed / peak * (1.0 - grey) + compressed * grey)
}

/// The reference rendering and output transforms of the Academy Color Encoding System, as fitted by Hill (2016).
fn aces(light: [f64; 3]) -> [f64; 3] {
    const INTO: [[f64; 3]; 3] =
        [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]];
    const OUT: [[f64; 3]; 3] = [
        [1.60475, -0.53108, -0.07367],
        [-0.10208, 1.10813, -0.00605],
        [-0.00327, -0.07276, 1.07602],
    ];
    let times = |rows: [[f64; 3]; 3], v: [f64; 3]| {
        rows.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum::<f64>())
    };
    let curve =
        |v: f64| (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081);
    times(OUT, times(INTO, light).map(curve)).map(|channel| channel.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tone(map: ToneMap, stops: f64) -> Tone {
        Tone { map, stops }
    }

    #[test]
    fn exposure_doubles_light_with_each_stop() {
        assert_eq!(mapped([0.1, 0.2, 0.4], &tone(ToneMap::None, 2.0)), [0.4, 0.8, 1.6]);
        assert_eq!(mapped([0.5; 3], &tone(ToneMap::None, -1.0)), [0.25; 3]);
    }

    /// Grey from black to far beyond white comes out in order and below 1; ACES may pass 1 by rounding of its matrices.
    #[test]
    fn curves_rise_and_end_at_white() {
        for map in [ToneMap::Neutral, ToneMap::Aces] {
            let mut before = -1.0;
            for step in 0..400 {
                let light = 1e-3 * f64::from(step).powi(2);
                let [r, g, b] = mapped([light; 3], &tone(map, 0.0));
                assert!((r - g).abs() < 2e-3 && (g - b).abs() < 2e-3, "{map:?} {light}");
                assert!(r >= before - 1e-9 && r < 1.02, "{map:?} {light}: {r}");
                before = r;
            }
            assert!(before > 0.97, "{map:?}: {before}");
        }
    }

    /// The published curve: a colour of 0.5 loses the 4 % that Fresnel's reflection adds.
    #[test]
    fn neutral_keeps_base_colors() {
        let [r, g, b] = mapped([0.54, 0.34, 0.14], &tone(ToneMap::Neutral, 0.0));
        assert!((r - 0.5).abs() < 1e-12 && (g - 0.3).abs() < 1e-12 && (b - 0.1).abs() < 1e-12);
    }
}
