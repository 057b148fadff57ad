//! PFM, the portable float map: depth as f32, for programs that read no richer format.
//!
//! A text header `Pf`, width and height, then the scale `-1.0`, whose sign means little-endian, then the rows from the **bottom**
//! up. Depth is infinite where there is nothing.

use super::{EncodeError, Encoded, FrameImage, ImageFormat, pack, unsupported};

/// Encodes depth.
///
/// # Errors
/// The image is not depth.
pub fn encode(image: &FrameImage) -> Result<Encoded, EncodeError> {
    let FrameImage::Depth { width, height, depth } = image else {
        return Err(unsupported(ImageFormat::Pfm, image));
    };
    let mut bytes = format!("Pf\n{width} {height}\n-1.0\n").into_bytes();
    bytes.reserve(depth.len() * 4);
    // `max`, because chunks of zero pixels are not allowed.
    for row in depth.chunks((*width).max(1) as usize).rev() {
        bytes.extend(pack::little_endian(row, |z| z.to_le_bytes()));
    }
    Ok(Encoded::new(bytes, "image/x-portable-floatmap"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Width, height and the rows from the top.
    fn parse(bytes: &[u8]) -> (usize, usize, Vec<f32>) {
        let mut lines = bytes.splitn(4, |&b| b == b'\n');
        assert_eq!(lines.next().unwrap(), b"Pf");
        let size = std::str::from_utf8(lines.next().unwrap()).unwrap();
        let (width, height) = size.split_once(' ').unwrap();
        let (width, height): (usize, usize) = (width.parse().unwrap(), height.parse().unwrap());
        let scale: f32 = std::str::from_utf8(lines.next().unwrap()).unwrap().parse().unwrap();
        assert!(scale < 0.0, "a positive scale would mean big-endian");
        let body = lines.next().unwrap();
        assert_eq!(body.len(), width * height * 4);
        let at = |x: usize, y: usize| {
            let i = ((height - 1 - y) * width + x) * 4;
            f32::from_le_bytes(body[i..i + 4].try_into().unwrap())
        };
        let depth = (0..width * height).map(|i| at(i % width, i / width)).collect();
        (width, height, depth)
    }

    #[test]
    fn depth_returns_exactly_and_bottom_row_comes_first() {
        let mut depth: Vec<f32> = (0..12).map(|i| 0.1 + i as f32 * 1.7).collect();
        depth[4] = f32::INFINITY;
        let image = FrameImage::Depth { width: 4, height: 3, depth: depth.clone() };
        let encoded = encode(&image).unwrap();
        assert_eq!(parse(&encoded.bytes), (4, 3, depth.clone()));
        let first = &encoded.bytes[b"Pf\n4 3\n-1.0\n".len()..][..4];
        assert_eq!(first, depth[8].to_le_bytes());
    }
}
