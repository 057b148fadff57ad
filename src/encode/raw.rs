//! Pixels without a header. The client knows the size from its request, and from the receipt.
//!
//! Colour and normals are four bytes `R G B A` per pixel. Depth is an IEEE 754 binary32 (infinite where there is nothing) and an
//! id a 32-bit integer, both little-endian. The top row comes first.

use super::{Encoded, FrameImage, pack};

/// Encodes any image with a single copy.
pub fn encode(image: &FrameImage) -> Encoded {
    let bytes = match image {
        FrameImage::Color { rgba, .. } | FrameImage::Normal { rgba, .. } => {
            rgba.as_flattened().to_vec()
        }
        FrameImage::Depth { depth, .. } => pack::little_endian(depth, |z| z.to_le_bytes()),
        FrameImage::Id { id, .. } => pack::little_endian(id, |id| id.to_le_bytes()),
    };
    Encoded::new(bytes, "application/octet-stream")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_little_endian() {
        let depth = vec![1.5f32, f32::INFINITY];
        let encoded = encode(&FrameImage::Depth { width: 2, height: 1, depth });
        assert_eq!(encoded.bytes, [0, 0, 0xc0, 0x3f, 0, 0, 0x80, 0x7f]);
        let encoded = encode(&FrameImage::Id { width: 1, height: 1, id: vec![0x0102_0304] });
        assert_eq!(encoded.bytes, [4, 3, 2, 1]);
        let rgba = vec![[1, 2, 3, 4], [5, 6, 7, 8]];
        let encoded = encode(&FrameImage::Color { width: 1, height: 2, rgba });
        assert_eq!(encoded.bytes, [1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
