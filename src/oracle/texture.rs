//! Texture filtering: the nearest texel, or trilinear over a pyramid of averages.

use glam::DVec2;

use crate::assets::{Encoding, Filter, Texture, Wrap};

use super::color::{byte_from_unit, linear_from_srgba8, srgb8_from_linear};

/// A place on a texture and how far a pixel's step moves it, in texture coordinates (1 = the whole texture).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    pub uv: DVec2,
    pub along_x: DVec2,
    pub along_y: DVec2,
}

/// One size of a texture, sRGB with straight alpha.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    pub width: usize,
    pub height: usize,
    pub rgba: Vec<[u8; 4]>,
    pub encoding: Encoding,
}

/// A texture in all its sizes down to one texel, the largest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid {
    pub levels: Vec<Level>,
}

impl Pyramid {
    /// Each level has half the size (rounded down, at least one) and averages 2 × 2 texels in linear light, rounded to
    /// sRGB bytes again; alpha is averaged as it is.
    pub fn of(texture: &Texture) -> Pyramid {
        let mut levels = vec![Level {
            width: texture.width as usize,
            height: texture.height as usize,
            rgba: texture.rgba.clone(),
            encoding: texture.encoding,
        }];
        while let Some(level) = levels.last().filter(|level| level.width > 1 || level.height > 1) {
            levels.push(level.halved());
        }
        Pyramid { levels }
    }
}

impl Level {
    fn halved(&self) -> Level {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let average = |i: usize| {
            let (x, y) = (i % width * 2, i / width * 2);
            let mut sum = [0.0; 4];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let texel =
                    (y + dy).min(self.height - 1) * self.width + (x + dx).min(self.width - 1);
                let linear = decoded(self.encoding, self.rgba[texel]);
                sum = std::array::from_fn(|channel| sum[channel] + linear[channel] / 4.0);
            }
            let byte = match self.encoding {
                Encoding::Srgb => srgb8_from_linear,
                Encoding::Linear => byte_from_unit,
            };
            let [r, g, b] = [sum[0], sum[1], sum[2]].map(byte);
            [r, g, b, byte_from_unit(sum[3])]
        };
        let rgba = (0..width * height).map(average).collect();
        Level { width, height, rgba, encoding: self.encoding }
    }

    /// Bilinear in linear light; texel centres lie at + ½.
    fn bilinear(&self, uv: DVec2, wrap: [Wrap; 2]) -> [f64; 4] {
        let place = uv * DVec2::new(self.width as f64, self.height as f64) - 0.5;
        let (corner, part) = (place.floor(), place - place.floor());
        let mut sum = [0.0; 4];
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let x = wrapped((corner.x as i64).saturating_add(dx), self.width, wrap[0]);
            let y = wrapped((corner.y as i64).saturating_add(dy), self.height, wrap[1]);
            let weight_x = if dx == 0 { 1.0 - part.x } else { part.x };
            let weight_y = if dy == 0 { 1.0 - part.y } else { part.y };
            let texel = decoded(self.encoding, self.rgba[y * self.width + x]);
            sum =
                std::array::from_fn(|channel| sum[channel] + texel[channel] * weight_x * weight_y);
        }
        sum
    }
}

/// Linear values of a texel.
fn decoded(encoding: Encoding, texel: [u8; 4]) -> [f64; 4] {
    match encoding {
        Encoding::Srgb => linear_from_srgba8(texel),
        Encoding::Linear => texel.map(|byte| f64::from(byte) / 255.0),
    }
}

/// An index brought into `0..size`.
fn wrapped(index: i64, size: usize, wrap: Wrap) -> usize {
    let size = size as i64;
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Mirror => {
            let phase = index.rem_euclid(2 * size);
            if phase < size { phase } else { 2 * size - 1 - phase }
        }
    };
    inside as usize
}

/// Whether a texture has texels, and as many as its size says.
pub fn is_sound(texture: &Texture) -> bool {
    !texture.rgba.is_empty()
        && texture.rgba.len() as u64 == u64::from(texture.width) * u64::from(texture.height)
}

/// The texture's linear RGB and alpha. An unsound texture is white; coordinates that are not finite count as 0.
pub fn sample(texture: &Texture, pyramid: Option<&Pyramid>, footprint: &Footprint) -> [f64; 4] {
    let (width, height) = (texture.width as usize, texture.height as usize);
    if !is_sound(texture) {
        return [1.0; 4];
    }
    let uv = if footprint.uv.is_finite() { footprint.uv } else { DVec2::ZERO };
    match (texture.filter, pyramid) {
        (Filter::Linear, Some(pyramid)) => trilinear(texture, pyramid, uv, footprint),
        _ => {
            let x = wrapped((uv.x * width as f64).floor() as i64, width, texture.wrap[0]);
            let y = wrapped((uv.y * height as f64).floor() as i64, height, texture.wrap[1]);
            decoded(texture.encoding, texture.rgba[y * width + x])
        }
    }
}

/// Between the two levels whose texels are about as large as the pixel's longer side on the texture.
fn trilinear(texture: &Texture, pyramid: &Pyramid, uv: DVec2, footprint: &Footprint) -> [f64; 4] {
    let size = DVec2::new(f64::from(texture.width), f64::from(texture.height));
    let texels = (footprint.along_x * size).length().max((footprint.along_y * size).length());
    let last = pyramid.levels.len() - 1;
    // `max` also turns NaN into the finest level.
    let level = texels.log2().max(0.0).min(last as f64);
    let fine = level.floor() as usize;
    let part = level - level.floor();
    let near = pyramid.levels[fine].bilinear(uv, texture.wrap);
    let far = pyramid.levels[(fine + 1).min(last)].bilinear(uv, texture.wrap);
    std::array::from_fn(|channel| near[channel] * (1.0 - part) + far[channel] * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Texture {
        let rgba = (0..width * height).map(|i| texel(i % width, i / width)).collect();
        let wrap = [Wrap::Repeat; 2];
        let (filter, encoding) = (Filter::Linear, Encoding::Srgb);
        Texture { name: String::new(), width, height, rgba, wrap, filter, encoding }
    }

    fn at(uv: [f64; 2], texels_a_pixel: f64, width: f64) -> Footprint {
        let along_x = DVec2::new(texels_a_pixel / width, 0.0);
        Footprint { uv: uv.into(), along_x, along_y: DVec2::ZERO }
    }

    #[test]
    fn indices_wrap() {
        let indices = [-5, -4, -1, 0, 3, 4, 7, 8];
        let wrap_all = |wrap| indices.map(|i| wrapped(i, 4, wrap));
        assert_eq!(wrap_all(Wrap::Repeat), [3, 0, 3, 0, 3, 0, 3, 0]);
        assert_eq!(wrap_all(Wrap::Clamp), [0, 0, 0, 0, 3, 3, 3, 3]);
        assert_eq!(wrap_all(Wrap::Mirror), [3, 3, 0, 0, 3, 3, 0, 0]);
    }

    #[test]
    fn pyramid_averages_in_linear_light() {
        let checker = texture(5, 2, |x, y| if (x + y) % 2 == 0 { [255; 4] } else { [0; 4] });
        let pyramid = Pyramid::of(&checker);
        let sizes: Vec<_> = pyramid.levels.iter().map(|l| (l.width, l.height)).collect();
        assert_eq!(sizes, [(5, 2), (2, 1), (1, 1)]);
        // Half the light is sRGB 188; alpha 127.5 rounds up, and 128 stays.
        assert_eq!(pyramid.levels[1].rgba, [[188, 188, 188, 128]; 2]);
        assert_eq!(pyramid.levels[2].rgba, [[188, 188, 188, 128]]);
        assert_eq!(Pyramid::of(&texture(1, 1, |_, _| [7; 4])).levels.len(), 1);
    }

    #[test]
    fn linear_filter_interpolates_levels_and_texels() {
        let ramp = texture(4, 1, |x, _| [if x < 2 { 0 } else { 255 }, 0, 0, 255]);
        let pyramid = Pyramid::of(&ramp);
        let red = |footprint: Footprint| sample(&ramp, Some(&pyramid), &footprint)[0];
        // Texel centres, half-way between texels 1 and 2, and a quarter of the way.
        assert_eq!(red(at([0.375, 0.5], 1.0, 4.0)), 0.0);
        assert_eq!(red(at([0.5, 0.5], 1.0, 4.0)), 0.5);
        assert_eq!(red(at([0.4375, 0.5], 0.1, 4.0)), 0.25);
        // Level 1 has texels 0 and 1; level 2 one of half the light, as a byte.
        assert_eq!(red(at([0.75, 0.5], 2.0, 4.0)), 1.0);
        let half = linear_from_srgba8([188, 0, 0, 0])[0];
        assert_eq!(red(at([0.75, 0.5], 64.0, 4.0)), half);
        let between = red(at([0.75, 0.5], 8f64.sqrt(), 4.0));
        assert!((between - (1.0 + half) / 2.0).abs() < 1e-12);
    }

    #[test]
    fn odd_coordinates_give_a_texel() {
        let ramp = texture(4, 4, |x, y| [x as u8, y as u8, 0, 255]);
        let pyramid = Pyramid::of(&ramp);
        for bad in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
            for wide in [1.0, f64::NAN, f64::INFINITY] {
                let color = sample(&ramp, Some(&pyramid), &at([bad, 0.1], wide, 4.0));
                assert!(color.iter().all(|c| c.is_finite()), "{bad} {wide}: {color:?}");
            }
        }
    }
}
