//! How much pictures flicker along a path: what changes from one frame to the next and does not change in the reference. Pure.
//!
//! The error of a frame is the frame minus its reference. The *flicker energy* is the mean square of the difference between the errors of two
//! consecutive frames. It is the temporal term of the loss of Chaitanya et al. 2017 ("Interactive Reconstruction of Monte Carlo Image Sequences
//! using a Recurrent Denoising Autoencoder"), which compares differences in time of images and references, with squares in place of absolute
//! values. An error that stays where it is adds nothing, however large it is.
//!
//! A *pop* is a connected area of pixels in which a channel changes by more than [`SEEN`] beyond the change of the reference.

use serde::{Deserialize, Serialize};

use super::metrics::{SizeMismatch, areas, check};

/// Largest change of a channel, of 255, that counts as unseen.
pub const SEEN: u8 = 32;
/// Pixels from which on an area counts among the pops: smaller ones are edges that cross the middle of a pixel.
pub const POP_PX: usize = 4;

/// What changes between two frames beyond the change of their references.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Mean square over the red, green and blue bytes of all pixels.
    pub energy: f64,
    /// Pixels of the largest connected area that changes by more than [`SEEN`]; neighbours share a side.
    pub pop_px: u64,
    /// Number of such areas of at least [`POP_PX`] pixels.
    pub pops: u64,
}

impl Change {
    /// Compares the change from the first frame to the second with that of their references. Images have `width · height` pixels, row by row.
    ///
    /// # Errors
    /// An image has another size.
    pub fn between(
        frames: [&[[u8; 4]]; 2],
        references: [&[[u8; 4]]; 2],
        [width, height]: [u32; 2],
    ) -> Result<Change, SizeMismatch> {
        let size = Some((width, height));
        check(frames[0], frames[1], size)?;
        check(references[0], references[1], size)?;
        let step = |of: [&[[u8; 4]]; 2], pixel: usize, channel: usize| {
            i32::from(of[1][pixel][channel]) - i32::from(of[0][pixel][channel])
        };
        let (mut sum, mut seen) = (0, vec![false; frames[0].len()]);
        for (pixel, is_seen) in seen.iter_mut().enumerate() {
            for channel in 0..3 {
                let off = step(frames, pixel, channel) - step(references, pixel, channel);
                sum += i64::from(off * off);
                *is_seen |= off.abs() > i32::from(SEEN);
            }
        }
        let areas = areas(&seen, width, height)?;
        Ok(Change {
            energy: sum as f64 / (3 * seen.len()).max(1) as f64,
            pop_px: areas.iter().copied().max().unwrap_or(0) as u64,
            pops: areas.iter().filter(|&&area| area >= POP_PX).count() as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [8, 6];
    const GRAY: [u8; 4] = [100, 100, 100, 255];

    /// A grey image with a patch of another colour.
    fn image(patch: [u8; 4], pixels: &[usize]) -> Vec<[u8; 4]> {
        let mut image = vec![GRAY; 48];
        pixels.iter().for_each(|&pixel| image[pixel] = patch);
        image
    }

    #[test]
    fn errors_that_stay_and_changes_of_the_reference_are_no_flicker() {
        let (plain, patch) = (image(GRAY, &[]), image([250, 0, 0, 255], &[9, 10, 11]));
        let between = |frames, references| Change::between(frames, references, SIZE).unwrap();
        assert_eq!(between([&patch, &patch], [&plain, &plain]), Change::default());
        assert_eq!(between([&plain, &patch], [&plain, &patch]), Change::default());
        let found = between([&plain, &patch], [&plain, &plain]);
        let expected = 3.0 * (150.0f64.powi(2) + 2.0 * 100.0f64.powi(2)) / (3.0 * 48.0);
        assert!((found.energy - expected).abs() < 1e-9, "{found:?}");
        assert_eq!((found.pop_px, found.pops), (3, 0));
        // A frame that stays while the reference moves flickers as much.
        assert_eq!(between([&plain, &plain], [&plain, &patch]), found);
    }

    #[test]
    fn pops_are_connected_areas_of_changes_that_are_seen() {
        let plain = image(GRAY, &[]);
        let pixels = [0, 1, 8, 9, 4, 5, 6, 14, 22, 45];
        let change = |by: u8| {
            let other = image([100, 100 + by, 100, 255], &pixels);
            Change::between([&plain, &other], [&plain, &plain], SIZE).unwrap()
        };
        // Squares of 2 × 2 pixels and a hook of five; one pixel is alone.
        assert_eq!((change(33).pop_px, change(33).pops), (5, 2));
        assert_eq!((change(32).pop_px, change(32).pops), (0, 0));
        assert!((change(32).energy - 10.0 * 1024.0 / 144.0).abs() < 1e-9);
    }

    #[test]
    fn images_of_other_sizes_are_refused() {
        let (plain, short) = (image(GRAY, &[]), vec![GRAY; 47]);
        assert!(Change::between([&plain, &short], [&plain, &plain], SIZE).is_err());
        assert!(Change::between([&plain, &plain], [&short, &short], SIZE).is_err());
        assert!(Change::between([&short, &short], [&short, &short], SIZE).is_err());
    }
}
