//! Images that materials name, decoded to sRGB texels within a budget.
//!
//! A texture that is missing, broken or too large is never a reason to refuse an asset: these
//! functions return a sentence for [`Asset::warnings`](super::Asset::warnings), and the material
//! keeps its base colour.

use std::io::Cursor;

use image::{ImageReader, Limits};

use super::input::{Folder, read_bounded};
use super::{Encoding, Filter, ReadOptions, Texture, Wrap};
use crate::memory::Admission;

/// Bytes of a texel while it is decoded: as the file has it, as bytes, and as kept.
const DECODED_BYTES: u64 = 12;

/// Texels that the rest of an asset's textures may still have together.
#[derive(Debug)]
pub(crate) struct TextureBudget {
    texels: u64,
    admission: Admission,
}

impl TextureBudget {
    pub fn new(options: &ReadOptions) -> Self {
        Self { texels: options.max_texels, admission: options.admission.clone() }
    }

    /// The load that reads.
    pub fn admission(&self) -> &Admission {
        &self.admission
    }

    /// Bytes that an encoded image may have at most: no format needs more than 16 a texel.
    pub fn max_encoded_bytes(&self) -> u64 {
        self.texels.saturating_mul(16).saturating_add(1 << 20)
    }
}

/// Reads and decodes the image that an asset names relative to its folder.
///
/// # Errors
/// A sentence for a warning.
pub(crate) fn load(
    reference: &str,
    folder: Option<&Folder>,
    budget: &mut TextureBudget,
) -> Result<Texture, String> {
    let fail = |reason: String| format!("texture {reference} is left out: {reason}");
    let folder = folder.ok_or_else(|| fail("the asset lies in no folder".to_owned()))?;
    let path = folder.find(reference).map_err(fail)?;
    let bytes = read_bounded(&path, budget.max_encoded_bytes(), &budget.admission)
        .map_err(|error| fail(error.to_string()))?;
    decode(&bytes, reference, budget)
}

/// Decodes an image; its format is recognised by its content.
///
/// # Errors
/// A sentence for a warning.
pub(crate) fn decode(
    bytes: &[u8],
    name: &str,
    budget: &mut TextureBudget,
) -> Result<Texture, String> {
    let fail = |reason: String| format!("texture {name} is left out: {reason}");
    let reader = || {
        let mut reader = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| error.to_string())?;
        if reader.format().is_none() && name.to_ascii_lowercase().ends_with(".tga") {
            // TGA is the one format without a signature.
            reader.set_format(image::ImageFormat::Tga);
        }
        Ok(reader)
    };
    let (width, height) =
        reader().map_err(fail)?.into_dimensions().map_err(|error| fail(error.to_string()))?;
    let texels = u64::from(width) * u64::from(height);
    if texels == 0 {
        return Err(fail("it has no texels".to_owned()));
    }
    if texels > budget.texels {
        return Err(fail(format!(
            "its {width} × {height} texels exceed the {} that are left",
            budget.texels
        )));
    }
    let admitted = budget.admission.grow(name, texels.saturating_mul(DECODED_BYTES));
    admitted.map_err(|error| fail(error.to_string()))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(texels.saturating_mul(32).saturating_add(64 << 20));
    let mut reader = reader().map_err(fail)?;
    reader.limits(limits);
    let image = reader.decode().map_err(|error| fail(error.to_string()))?;
    let rgba: Vec<[u8; 4]> = image.into_rgba8().pixels().map(|pixel| pixel.0).collect();
    if rgba.len() as u64 != texels {
        return Err(fail("its size differs from its header's".to_owned()));
    }
    budget.texels -= texels;
    Ok(Texture {
        name: name.to_owned(),
        width,
        height,
        rgba,
        wrap: [Wrap::default(); 2],
        filter: Filter::default(),
        encoding: Encoding::default(),
    })
}

/// Whether any texel lets something through.
pub(crate) fn has_alpha(texture: &Texture) -> bool {
    texture.rgba.iter().any(|texel| texel[3] < 255)
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;

    fn few(max_texels: u64) -> TextureBudget {
        TextureBudget::new(&ReadOptions { max_texels, ..ReadOptions::default() })
    }

    /// A PNG of the given texels, row by row.
    pub(crate) fn png(width: u32, texels: &[[u8; 4]]) -> Vec<u8> {
        let height = texels.len() as u32 / width;
        let image = image::RgbaImage::from_raw(width, height, texels.concat()).unwrap();
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn decodes_and_counts_texels() {
        let texels = [[1, 2, 3, 4], [5, 6, 7, 255]];
        let mut budget = few(3);
        let texture = decode(&png(2, &texels), "t.png", &mut budget).unwrap();
        assert_eq!((texture.width, texture.height), (2, 1));
        assert_eq!(texture.rgba, texels);
        assert!(has_alpha(&texture));
        let error = decode(&png(2, &texels), "t.png", &mut budget).unwrap_err();
        assert!(error.contains("t.png") && error.contains("2 × 1"), "{error}");
    }

    #[test]
    fn webp_decodes() {
        let mut bytes = Vec::new();
        image_webp::WebPEncoder::new(&mut bytes)
            .encode(&[9, 8, 7, 6, 5, 4], 2, 1, image_webp::ColorType::Rgb8)
            .unwrap();
        let texture = decode(&bytes, "t", &mut few(100)).unwrap();
        assert_eq!(texture.rgba, [[9, 8, 7, 255], [6, 5, 4, 255]]);
        assert!(!has_alpha(&texture));
    }

    #[test]
    fn a_giant_header_is_refused_before_decoding() {
        let mut bytes = png(1, &[[0; 4]]);
        bytes[16..20].copy_from_slice(&60_000u32.to_be_bytes());
        bytes[20..24].copy_from_slice(&60_000u32.to_be_bytes());
        assert!(decode(&bytes, "t", &mut few(1 << 28)).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn damage_never_panics(at in 0usize..80, value: u8, cut in 0usize..80) {
            let mut bytes = png(2, &[[1, 2, 3, 4]; 4]);
            let at = at % bytes.len();
            bytes[at] = value;
            bytes.truncate(bytes.len() - cut % bytes.len());
            let _ = decode(&bytes, "t", &mut few(1 << 16));
        }
    }
}
