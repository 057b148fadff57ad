//! Disks over triangles that are too large to be rasterised: one over a triangle, several along the longest side of a needle.
//!
//! A single disk over a needle is as long as the needle and nearly empty. The disks of all nodes above it are as large, so the nodes count as
//! sparse and are thinned out with all samples below them ([`coverage`](super::super::tree)). The hull of a Delaunay triangulation of random points
//! consists of needles, and sheets that are triangulated so had holes along their borders. Three such sheets, of 7,177 to 79,966 triangles, in 72
//! frames of 200 × 200 pixels with errors of 0.5 to 4 pixels:
//!
//! | needles have | open pixels in all | in one frame | pixels beyond the outline, as splats | samples |
//! |---|--:|--:|--:|--:|
//! | one disk | 837 | 76 | 5,161 | 4,314 to 47,287 |
//! | the samples of a rasterised triangle | 0 | 0 | 6,943 | 0 to 2 % fewer |
//! | disks along them, at most 16 | 0 | 0 | 3,375 | 3 to 7 % more |
//!
//! The bunny, the armadillo, the dragon and the other scans have up to 0.7 % more samples, machine parts up to 50 % (a limit of
//! [`TRIANGLES_PER_MORE`](super::TRIANGLES_PER_MORE)). Bakes take as long as before.

use glam::DVec3;

use super::{area_of, longest_side};

/// Most disks of a needle. Eight close the sheets of the table.
const MOST: f64 = 16.0;

/// A disk in the plane of its triangle.
pub struct Disk {
    pub centre: DVec3,
    pub radius: f64,
}

/// Number of disks that fit along a triangle, each about twice as long as the triangle is high, or two cells of this spacing where that is more.
pub fn wanted(corners: [DVec3; 3], spacing: f64) -> f64 {
    let longest = longest_side(corners);
    let height = 2.0 * area_of(corners) / longest;
    (longest / (2.0 * height.max(spacing))).floor().clamp(1.0, MOST)
}

/// `count` disks that together cover a triangle.
pub fn disks(corners: [DVec3; 3], count: usize) -> impl Iterator<Item = Disk> {
    let [a, b, c] = corners;
    let sides = [[a, b, c], [b, c, a], [c, a, b]];
    let length = |[from, to, _]: &[DVec3; 3]| from.distance(*to);
    let [from, to, tip] =
        sides.into_iter().max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(corners);
    let along = to - from;
    // Where along the longest side the tip stands.
    let foot = (tip - from).dot(along) / along.length_squared();
    let across = tip - from - along * foot;
    let height = move |share: f64| (share / foot).min((1.0 - share) / (1.0 - foot));
    let piece = move |index: usize| {
        let [start, end] = [index, index + 1].map(|at| at as f64 / count as f64);
        let highest =
            if start <= foot && foot <= end { 1.0 } else { height(start).max(height(end)) };
        let half = (0.5 * (end - start) * along, 0.5 * highest * across);
        Disk {
            centre: from + along * start + half.0 + half.1,
            radius: half.0.length().hypot(half.1.length()),
        }
    };
    let centre = (a + b + c) / 3.0;
    let whole = Disk {
        centre,
        radius: corners.iter().fold(0.0, |most: f64, p| most.max((*p - centre).length())),
    };
    let (one, several) = if count == 1 { (Some(whole), 0) } else { (None, count) };
    one.into_iter().chain((0..several).map(piece))
}
