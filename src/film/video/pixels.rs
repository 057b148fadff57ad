//! Decodes a frame's file to RGB.

use std::path::Path;

use super::{Reel, VideoError};
use crate::encode::ImageFormat;
use crate::film::manifest::{self, Record};

/// Reads the pixels of a recorded frame: RGB8, from the top row down. Alpha is dropped, as in a JPEG.
///
/// # Errors
/// The file cannot be read, or does not match the record.
pub fn read(folder: &Path, record: &Record, reel: &Reel) -> Result<Vec<u8>, VideoError> {
    let file = folder.join(&record.file);
    let bad = |reason: String| VideoError::Frame { file: file.clone(), reason };
    let bytes = manifest::read_sound(folder, record)
        .map_err(|error| VideoError::Io { file: file.clone(), error })?
        .ok_or_else(|| bad("it differs from the frame in the manifest".to_owned()))?;
    let (width, height, rgb) = match reel.format {
        ImageFormat::Raw => (reel.width, reel.height, without_alpha(&bytes)),
        ImageFormat::Qoi => {
            let (header, pixels) =
                qoi::decode_to_vec(&bytes).map_err(|error| bad(error.to_string()))?;
            let rgb =
                if header.channels == qoi::Channels::Rgb { pixels } else { without_alpha(&pixels) };
            (header.width, header.height, rgb)
        }
        _ => {
            let image = image::load_from_memory(&bytes).map_err(|error| bad(error.to_string()))?;
            (image.width(), image.height(), image.into_rgb8().into_raw())
        }
    };
    let expected = reel.width as usize * reel.height as usize * 3;
    if (width, height) != (reel.width, reel.height) || rgb.len() != expected {
        return Err(bad(format!(
            "it has {width} × {height} pixels instead of {} × {}",
            reel.width, reel.height
        )));
    }
    Ok(rgb)
}

fn without_alpha(rgba: &[u8]) -> Vec<u8> {
    rgba.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
}
