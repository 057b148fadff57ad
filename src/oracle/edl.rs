//! Eye-dome lighting (Boucheny 2009, §4), from the depths of a frame's pixels.

use crate::scene::EyeDome;

/// A neighbour counts by at most this base-2 logarithm of the ratio of distances.
const MOST: f64 = 0.01;

/// The factor by which the light of pixel (x, y) is reduced; `depth` holds the frame's depths row by row. `ortho_height` is the height
/// of an orthographic view, by which differences of depth are divided; in perspective depths count by their ratio.
pub fn factor(
    edl: &EyeDome,
    ortho_height: Option<f64>,
    depth: &[f64],
    (width, height): (usize, usize),
    (x, y): (usize, usize),
) -> f64 {
    let own = depth[y * width + x];
    if own.is_infinite() {
        return 1.0;
    }
    let radius = f64::from(edl.radius_px);
    let neighbours = (0..8).map(|k| {
        let (sine, cosine) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
        let at =
            |from: usize, offset: f64| from.checked_add_signed((radius * offset).round() as isize);
        (at(x, cosine), at(y, sine))
    });
    let before =
        neighbours.map(|(x, y)| match (x.filter(|&x| x < width), y.filter(|&y| y < height)) {
            (Some(x), Some(y)) => {
                let neighbour = depth[y * width + x];
                let nearer = match ortho_height {
                    None => (own / neighbour).log2(),
                    Some(height) => (own - neighbour) / height * std::f64::consts::LOG2_E,
                };
                nearer.clamp(0.0, MOST)
            }
            _ => 0.0,
        });
    // All neighbours of a gap between samples stand before it. What they have in common does not darken it.
    let (sum, least) = before.fold((0.0, MOST), |(sum, least), one| (sum + one, one.min(least)));
    (-300.0 * f64::from(edl.strength) * (sum / 8.0 - least)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_behind_an_edge_are_dark_and_others_are_not() {
        let edl = EyeDome { strength: 1.0, radius_px: 1.0 };
        let (near, far) = (1.0, 1.005);
        let depth = [near, far, far, far, f64::INFINITY, far];
        let of = |x| factor(&edl, None, &depth, (6, 1), (x, 0));
        assert_eq!([of(0), of(2), of(3), of(4), of(5)], [1.0; 5]);
        // One of eight neighbours stands 0.5 % before it.
        let expected = (-300.0 * 1.005f64.log2() / 8.0).exp();
        assert!((of(1) - expected).abs() < 1e-12 && expected < 0.8);
        let twice = EyeDome { strength: 2.0, ..edl };
        assert!((factor(&twice, None, &depth, (6, 1), (1, 0)) - expected * expected).abs() < 1e-12);
        // As a perspective sees it whose view is as high as it is far away.
        let flat = factor(&edl, Some(1.005), &depth, (6, 1), (1, 0));
        assert!((flat - expected).abs() < 1e-3, "{flat} {expected}");
    }

    #[test]
    fn gaps_between_samples_are_no_darker_than_their_surroundings() {
        let edl = EyeDome { strength: 0.5, radius_px: 1.0 };
        let mut depth = [1.0; 25];
        depth[12] = 2.0;
        assert_eq!(factor(&edl, None, &depth, (5, 5), (2, 2)), 1.0);
        // A groove of one pixel's width is darkened by six neighbours, each by as much as counts.
        depth[7] = 2.0;
        depth[17] = 2.0;
        let groove = factor(&edl, None, &depth, (5, 5), (2, 2));
        assert!((groove - (-150.0 * 6.0 * MOST / 8.0f64).exp()).abs() < 1e-12, "{groove}");
    }
}
