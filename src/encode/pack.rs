//! Pixels as three or four 8-bit channels, for the formats that know nothing else.

use std::borrow::Cow;

use super::FrameImage;

/// Interleaved 8-bit channels, row by row from the top.
pub(super) struct Packed<'a> {
    pub bytes: Cow<'a, [u8]>,
    /// Four channels with straight alpha; three otherwise.
    pub alpha: bool,
}

/// Colour, normals or ids as bytes; `None` for depth, which bytes cannot hold. Alpha goes where it says nothing.
/// Colour and normals with a meaningful alpha are borrowed, the rest is copied.
pub(super) fn rgb_or_rgba(image: &FrameImage) -> Option<Packed<'_>> {
    let packed = match image {
        FrameImage::Color { rgba, .. } | FrameImage::Normal { rgba, .. } => {
            if rgba.iter().all(|pixel| pixel[3] == 255) {
                Packed { bytes: Cow::Owned(drop_alpha(rgba)), alpha: false }
            } else {
                Packed { bytes: Cow::Borrowed(bytemuck::cast_slice(rgba)), alpha: true }
            }
        }
        FrameImage::Id { id, .. } => {
            let wide = id.iter().any(|&id| id >= 1 << 24);
            let bytes: Vec<u8> = if wide {
                id.iter().flat_map(|id| id.to_le_bytes()).collect()
            } else {
                let rgba: Vec<[u8; 4]> = id.iter().map(|id| id.to_le_bytes()).collect();
                drop_alpha(&rgba)
            };
            Packed { bytes: Cow::Owned(bytes), alpha: wide }
        }
        FrameImage::Depth { .. } => return None,
    };
    Some(packed)
}

fn drop_alpha(rgba: &[[u8; 4]]) -> Vec<u8> {
    let mut rgb = vec![0u8; rgba.len() * 3];
    for (rgb, &[r, g, b, _]) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(rgba) {
        *rgb = [r, g, b];
    }
    rgb
}

/// 4-byte numbers in little-endian order.
pub(super) fn little_endian<T: bytemuck::NoUninit>(
    values: &[T],
    to_bytes: impl Fn(&T) -> [u8; 4],
) -> Vec<u8> {
    if cfg!(target_endian = "little") {
        bytemuck::cast_slice(values).to_vec()
    } else {
        values.iter().flat_map(to_bytes).collect()
    }
}
