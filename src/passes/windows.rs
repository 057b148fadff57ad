//! Windows of the image: the parts of a group's pixels whose translucent fragments are kept at once, so that what a frame needs for
//! them is bounded.

use std::ops::Range;

/// Translucent fragments of a pixel that are kept; as in `shared/window`.
pub const LAYERS: u32 = 8;
/// Bytes of the fragments of a pixel.
pub const FRAGMENT_BYTES: u64 = 8 * LAYERS as u64;
/// Bytes of what they cover of it: colour and alpha, and how much of each channel where light may pass surfaces.
pub const fn covered_bytes(transmits: bool) -> u64 {
    if transmits { 32 } else { 16 }
}

/// Bytes of the fragments of a window, at most.
const MOST_BYTES: u64 = 128 << 20;

/// Most pixels of a window where a binding has so many bytes.
pub fn most_pixels(binding_bytes: u64) -> u32 {
    (binding_bytes.min(MOST_BYTES) / FRAGMENT_BYTES).max(1) as u32
}

/// The windows of so many pixels, of `most` each.
pub fn windows(pixels: u64, most: u32) -> Vec<Range<u32>> {
    let pixels = u32::try_from(pixels).unwrap_or(u32::MAX);
    let begins = (0..pixels).step_by(most as usize);
    begins.map(|begin| begin..pixels.min(begin.saturating_add(most))).collect()
}

/// Records of a window, one a layer; `Window` in `shared/window`.
pub fn records(window: &Range<u32>) -> impl Iterator<Item = [u32; 4]> + use<> {
    let (begin, pixels) = (window.start, window.end - window.start);
    (0..LAYERS).map(move |layer| [begin, pixels, layer, 0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_every_pixel_once() {
        let most = most_pixels(u64::MAX);
        assert!(windows(0, most).is_empty());
        let picture = windows(1920 * 1080, most);
        assert!(picture.len() == 1 && picture[0] == (0..1920 * 1080));
        for pixels in [1, 1 << 21, (1 << 21) + 1, 1 << 24] {
            let found = windows(pixels, most);
            assert!(found.windows(2).all(|pair| pair[0].end == pair[1].start));
            assert_eq!(found.iter().map(|w| u64::from(w.end - w.start)).sum::<u64>(), pixels);
            assert!(found.iter().all(|w| w.end - w.start <= most));
        }
        assert_eq!((windows(5, 2).len(), most_pixels(1 << 20), most_pixels(1)), (3, 16384, 1));
    }
}
