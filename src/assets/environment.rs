//! Images of surroundings: light that arrives from all directions, in an equirectangular projection.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageReader, Limits};

use super::input::{Unread, read_bounded};
use super::{AssetError, ReadOptions};
use crate::scene::color::to_linear;

/// Light that arrives from each direction: linear RGB, row by row from the top. The image is twice as wide as high.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentImage {
    pub width: u32,
    pub height: u32,
    /// 0 to [`BRIGHTEST`].
    pub radiance: Vec<[f32; 3]>,
}

/// Brightest light of a channel. The sun is 1e5 times as bright as a white surface in its light.
pub const BRIGHTEST: f32 = 1e9;

/// Bytes of a texel while it is decoded: as the file has it, with alpha, and as kept.
const DECODED_BYTES: u64 = 44;

impl EnvironmentImage {
    /// Reads an image of surroundings; its format is recognised by its content. Formats of 8 and 16 bits are sRGB, the others linear.
    ///
    /// # Errors
    /// Files that are no image of surroundings, or for which `options` leave no room.
    pub fn read(path: &Path, options: &ReadOptions) -> Result<EnvironmentImage, AssetError> {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (texels, admission) = (options.max_texels, &options.admission);
        let most_bytes = texels.saturating_mul(16).saturating_add(1 << 20);
        let bytes = read_bounded(path, most_bytes, admission).map_err(|error| match error {
            Unread::Io(source) => AssetError::io(&file, source),
            Unread::Interrupted(interrupt) => interrupt.into(),
            Unread::TooLarge { found, limit } => {
                AssetError::TooLarge { file: file.clone(), what: "bytes", found, limit }
            }
        })?;
        let unreadable = |error: image::ImageError| {
            AssetError::unsupported(
                &file,
                format!("no image of the formats HDR, EXR, PNG, JPEG, WebP, BMP and TGA: {error}"),
            )
        };
        let reader = || {
            ImageReader::new(Cursor::new(&bytes))
                .with_guessed_format()
                .map_err(|error| unreadable(error.into()))
        };
        let (width, height) = reader()?.into_dimensions().map_err(unreadable)?;
        if height == 0 || u64::from(width) != 2 * u64::from(height) {
            return Err(AssetError::unsupported(
                &file,
                format!(
                    "the image of surroundings has {width} × {height} pixels; an equirectangular image is twice as wide as high"
                ),
            ));
        }
        let found = u64::from(width) * u64::from(height);
        if found > texels {
            return Err(AssetError::TooLarge { file, what: "texels", found, limit: texels });
        }
        admission.grow(&file, found.saturating_mul(DECODED_BYTES))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(found.saturating_mul(32).saturating_add(64 << 20));
        let mut reader = reader()?;
        reader.limits(limits);
        let image = reader.decode().map_err(|error| {
            let reason = format!("the image of surroundings is damaged: {error}");
            AssetError::unsupported(&file, reason)
        })?;
        let is_linear =
            matches!(image, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
        let light = |[r, g, b]: [f32; 3]| {
            if is_linear {
                return [r, g, b];
            }
            let [r, g, b, _] = to_linear([r, g, b, 1.0].map(f64::from));
            [r, g, b]
        };
        let image = image.into_rgb32f();
        let radiance: Vec<[f32; 3]> = image.pixels().map(|pixel| light(pixel.0)).collect();
        let is_light = |texel: &[f32; 3]| texel.iter().all(|c| (0.0..=BRIGHTEST).contains(c));
        if let Some(index) = radiance.iter().position(|texel| !is_light(texel)) {
            let (x, y) = (index % width as usize, index / width as usize);
            let reason = format!(
                "light of {:?} cannot be: every channel is 0 to {BRIGHTEST:e}",
                radiance[index]
            );
            return Err(AssetError::malformed(&file, format!("pixel {x}, {y}"), reason));
        }
        Ok(EnvironmentImage { width, height, radiance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, write: impl FnOnce(&Path)) -> Result<EnvironmentImage, AssetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        write(&path);
        EnvironmentImage::read(&path, &ReadOptions::default())
    }

    fn floats(width: u32, height: u32, light: f32) -> image::Rgb32FImage {
        image::Rgb32FImage::from_pixel(width, height, image::Rgb([light, 1.0, 0.5]))
    }

    #[test]
    fn light_is_linear() {
        for name in ["sky.hdr", "sky.exr"] {
            let found = read(name, |path| floats(8, 4, 6.0).save(path).unwrap()).unwrap();
            assert_eq!((found.width, found.height), (8, 4));
            assert_eq!(found.radiance, vec![[6.0, 1.0, 0.5]; 32], "{name}");
        }
        let grey = image::RgbImage::from_pixel(4, 2, image::Rgb([128, 255, 0]));
        let found = read("sky.png", |path| grey.save(path).unwrap()).unwrap();
        let [r, g, b] = found.radiance[7];
        assert!((r - 0.2158).abs() < 1e-3 && g == 1.0 && b == 0.0, "{r} {g} {b}");
    }

    #[test]
    fn what_is_no_image_of_surroundings_is_refused() {
        let told = |name: &str, write: &dyn Fn(&Path)| read(name, write).unwrap_err().to_string();
        let square = told("square.hdr", &|path| floats(4, 4, 1.0).save(path).unwrap());
        assert!(square.contains("4 × 4") && square.contains("twice as wide as high"), "{square}");
        let empty = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 0\n";
        let empty = told("empty.hdr", &|path| std::fs::write(path, empty).unwrap());
        assert!(empty.contains("0 × 0"), "{empty}");
        let text = told("text.hdr", &|path| std::fs::write(path, "no image").unwrap());
        assert!(text.contains("text.hdr") && text.contains("HDR, EXR, PNG"), "{text}");
        for light in [f32::NAN, f32::INFINITY, -1.0] {
            let bad = told("bad.exr", &|path| floats(4, 2, light).save(path).unwrap());
            assert!(bad.contains("pixel 0, 0") && bad.contains("0 to 1e9"), "{bad}");
        }
        let cut = told("cut.exr", &|path| {
            floats(64, 32, 1.0).save(path).unwrap();
            let bytes = std::fs::read(path).unwrap();
            std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        });
        assert!(cut.contains("cut.exr") && cut.contains("damaged"), "{cut}");
        let missing = EnvironmentImage::read(Path::new("nowhere.hdr"), &ReadOptions::default());
        assert!(missing.unwrap_err().to_string().contains("nowhere.hdr"));
        let few = ReadOptions { max_texels: 31, ..ReadOptions::default() };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.hdr");
        floats(8, 4, 1.0).save(&path).unwrap();
        let large = EnvironmentImage::read(&path, &few).unwrap_err().to_string();
        assert!(large.contains("texels (32) is over the limit of 31"), "{large}");
    }
}
