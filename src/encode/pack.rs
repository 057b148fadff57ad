//! Packs pixels into three or four 8-bit channels, for formats that support nothing else.

use std::borrow::Cow;

use super::FrameImage;

/// Interleaved 8-bit channels, row by row from the top.
pub(super) struct Packed<'a> {
    pub bytes: Cow<'a, [u8]>,
    /// Whether there is a fourth channel with straight alpha.
    pub alpha: bool,
}

/// Packs colour, normals or ids; `None` for depth, which does not fit. An alpha channel without information is dropped. Colour
/// and normals that keep their alpha are borrowed; everything else is copied.
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

/// Numbers of 4 bytes in little-endian order.
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
