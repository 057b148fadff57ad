//! Surroundings of a photographer's studio: dark walls, a bright ceiling, two soft boxes and a window with evening light.

use std::f64::consts::PI;

use super::numeric::{lerp, sin, smoothstep};
use crate::assets::EnvironmentImage;

const WIDTH: u32 = 128;
const HEIGHT: u32 = WIDTH / 2;

/// A bright rectangle: where its middle is and how large it is, in degrees to the right and above the horizon, and its light.
struct Panel {
    middle: [f64; 2],
    size: [f64; 2],
    light: [f64; 3],
}

const PANELS: [Panel; 3] = [
    Panel { middle: [-70.0, 35.0], size: [50.0, 40.0], light: [7.0, 7.2, 7.5] },
    Panel { middle: [105.0, 25.0], size: [24.0, 55.0], light: [5.0, 5.2, 5.6] },
    Panel { middle: [178.0, 14.0], size: [60.0, 22.0], light: [6.0, 3.2, 1.3] },
];

/// Light of a direction, in degrees to the right of the image's centre and above the horizon.
fn light(right: f64, above: f64) -> [f64; 3] {
    let up = sin(above / 180.0 * PI);
    let wall = smoothstep(-0.12, 0.0, up);
    let ceiling = smoothstep(0.3, 1.0, up);
    let floor = [0.1, 0.09, 0.085];
    let walls = [0.2, 0.22, 0.26];
    let above_all = [0.75, 0.78, 0.82];
    let mut sum: [f64; 3] =
        std::array::from_fn(|i| lerp(lerp(floor[i], walls[i], wall), above_all[i], ceiling));
    for Panel { middle, size, light } in PANELS {
        let aside = (right - middle[0] + 540.0).rem_euclid(360.0) - 180.0;
        let distances = [aside.abs() / size[0], (above - middle[1]).abs() / size[1]];
        let share: f64 = distances.iter().map(|far| 1.0 - smoothstep(0.42, 0.56, *far)).product();
        sum = std::array::from_fn(|i| sum[i] + share * light[i]);
    }
    sum
}

/// The studio, 128 × 64 pixels.
pub fn studio() -> EnvironmentImage {
    let texel = |i: u32| {
        let turn = (f64::from(i % WIDTH) + 0.5) / f64::from(WIDTH);
        let down = (f64::from(i / WIDTH) + 0.5) / f64::from(HEIGHT);
        light(360.0 * (turn - 0.5), 180.0 * (0.5 - down)).map(|channel| channel as f32)
    };
    EnvironmentImage {
        width: WIDTH,
        height: HEIGHT,
        radiance: (0..WIDTH * HEIGHT).map(texel).collect(),
    }
}
