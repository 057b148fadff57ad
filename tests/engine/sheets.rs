//! Irregularly triangulated sheets and balls, of which unit tests and engine tests ask whether they are closed.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

pub type Triangulation = (Vec<DVec3>, Vec<[u32; 3]>);

/// A square from −1 to 1 of `side` × `side` vertices, each moved by up to `jitter` of the spacing along both axes. Positions between
/// 0 and 1 are raised to the power `grade`: triangles near one corner are small. `random` gives numbers from 0 to 1.
pub fn sheet(
    side: u32,
    jitter: f64,
    grade: f64,
    random: &mut impl FnMut() -> f64,
) -> Triangulation {
    let last = f64::from(side - 1);
    let mut place = |at: u32| {
        let inner = at > 0 && at < side - 1;
        let moved = if inner { jitter * (2.0 * random() - 1.0) } else { 0.0 };
        2.0 * ((f64::from(at) + moved) / last).powf(grade) - 1.0
    };
    let positions =
        (0..side * side).map(|i| DVec3::new(place(i % side), place(i / side), 0.0)).collect();
    let quads = (0..(side - 1) * (side - 1)).map(|i| i / (side - 1) * side + i % (side - 1));
    let triangles = quads.flat_map(|at| {
        let (right, above, across) = (at + 1, at + side, at + side + 1);
        match (at / side + at % side) % 2 {
            0 => [[at, right, above], [right, across, above]],
            _ => [[at, right, across], [at, across, above]],
        }
    });
    (positions, triangles.collect())
}

/// Splits a share of the triangles at random places: sides of all lengths, and needles.
pub fn split(
    (mut positions, mut triangles): Triangulation,
    share: f64,
    random: &mut impl FnMut() -> f64,
) -> Triangulation {
    for at in 0..triangles.len() {
        if random() >= share {
            continue;
        }
        let [a, b, c] = triangles[at];
        let [x, y, z] = [a, b, c].map(|corner| positions[corner as usize]);
        let [p, q, r] = [0; 3].map(|_| 0.05 + random());
        let new = positions.len() as u32;
        positions.push((x * p + y * q + z * r) / (p + q + r));
        triangles[at] = [a, b, new];
        triangles.extend([[b, c, new], [c, a, new]]);
    }
    (positions, triangles)
}

/// The unit sphere of `rings` × `2 · rings` quads, each vertex moved by up to `jitter` of the spacing.
pub fn ball(rings: u32, jitter: f64, random: &mut impl FnMut() -> f64) -> Triangulation {
    let (columns, mut positions) = (2 * rings, vec![DVec3::Z]);
    let mut moved = |at: u32, of: u32, turn: f64| {
        (f64::from(at) + jitter * (2.0 * random() - 1.0)) * turn / f64::from(of)
    };
    for i in 0..(rings - 1) * columns {
        let (sin, cos) = moved(i / columns + 1, rings, PI).sin_cos();
        let (y, x) = moved(i % columns, columns, TAU).sin_cos();
        positions.push(DVec3::new(sin * x, sin * y, cos));
    }
    positions.push(-DVec3::Z);
    let at = |ring: u32, column: u32| match ring {
        0 => 0,
        _ if ring == rings => 1 + (rings - 1) * columns,
        _ => 1 + (ring - 1) * columns + column % columns,
    };
    let quad = |i: u32| {
        let (ring, column) = (i / columns, i % columns);
        let [a, b] = [at(ring, column), at(ring, column + 1)];
        let [c, d] = [at(ring + 1, column), at(ring + 1, column + 1)];
        [[a, c, d], [a, d, b]]
    };
    let is_whole = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    (positions, (0..rings * columns).flat_map(quad).filter(is_whole).collect())
}

/// A ball whose vertices are moved towards its centre by up to `depth`: neighbouring triangles face very different ways.
pub fn crumpled(
    (positions, triangles): Triangulation,
    depth: f64,
    random: &mut impl FnMut() -> f64,
) -> Triangulation {
    (positions.into_iter().map(|at| at * (1.0 - depth * random())).collect(), triangles)
}

/// The Delaunay triangulation of places in the plane z = 0, no four of which lie on a circle (A. Bowyer, D. F. Watson 1981). A triangle to
/// infinity lies beyond each edge of the hull.
pub fn delaunay(positions: Vec<DVec3>) -> Triangulation {
    const FAR: u32 = u32::MAX;
    let at = |vertex: u32| positions[vertex as usize];
    let turn = |a: DVec3, b: DVec3, c: DVec3| (b - a).cross(c - a).z;
    let circle_holds = |&[a, b, c]: &[u32; 3], place: DVec3| {
        if c == FAR {
            return turn(at(a), at(b), place) > 0.0;
        }
        let [a, b, c] = [a, b, c].map(|vertex| at(vertex) - place);
        let lifted = |p: DVec3| DVec3::new(p.x, p.y, p.length_squared());
        lifted(a).cross(lifted(b)).dot(lifted(c)) > 0.0
    };
    let with_far_last = |triangle: [u32; 3]| match triangle {
        [FAR, b, c] => [b, c, FAR],
        [a, FAR, c] => [c, a, FAR],
        whole => whole,
    };
    let [b, c] = if turn(at(0), at(1), at(2)) > 0.0 { [1, 2] } else { [2, 1] };
    let mut triangles = vec![[0, b, c], [b, 0, FAR], [c, b, FAR], [0, c, FAR]];
    for vertex in 3..positions.len() as u32 {
        let mut edges = Vec::new();
        triangles.retain(|triangle| {
            let stays = !circle_holds(triangle, at(vertex));
            let [a, b, c] = *triangle;
            edges.extend([(a, b), (b, c), (c, a)].into_iter().filter(|_| !stays));
            stays
        });
        let outer = edges.iter().filter(|&&(a, b)| !edges.contains(&(b, a)));
        triangles.extend(outer.map(|&(a, b)| with_far_last([a, b, vertex])));
    }
    triangles.retain(|triangle| triangle[2] != FAR);
    (positions, triangles)
}
