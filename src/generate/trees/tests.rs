use super::super::isosurface::tests::{assert_watertight, volume};
use super::*;

const SMALL: TreeParameters = TreeParameters { height: 8.0, leaves: 1_003, seed: 3 };

fn corners(plant: &Plant) -> Vec<DVec3> {
    let (leaves, normals) = (&plant.leaves, plant.leaves.normals.as_ref().unwrap());
    let radii = leaves.radii.as_ref().unwrap();
    (0..leaves.positions.len())
        .flat_map(|vertex| {
            let side = leaves.side(normals, vertex, leaves.strand_of(vertex as u32));
            let out = side * f64::from(radii[vertex]);
            [leaves.positions[vertex] - out, leaves.positions[vertex] + out]
        })
        .collect()
}

/// Ribbons have the corners of the quads, so that the two forms cover equal pixels.
#[test]
fn both_forms_have_equal_leaves() {
    let mesh = triangles(&SMALL, &Progress::none()).mesh;
    let plant = lines(&SMALL, &Progress::none());
    assert_eq!(plant.leaves.strands.len() - 1, SMALL.leaves);
    let ribbons = corners(&plant);
    assert_eq!(ribbons.len(), 6 * SMALL.leaves);
    let first = mesh.positions.len() - ribbons.len();
    let farthest = mesh.positions[first..]
        .iter()
        .zip(&ribbons)
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
    assert!(farthest < 1e-6, "{farthest}");
    let colors = mesh.colors.unwrap();
    let of_ribbons = plant.leaves.colors.as_ref().unwrap();
    assert!((0..ribbons.len()).all(|corner| colors[first + corner] == of_ribbons[corner / 2]));
}

/// Tubes are closed and face outwards. Lines have a strand for each stem but the trunk.
#[test]
fn both_forms_have_equal_stems() {
    let mesh = triangles(&SMALL, &Progress::none()).mesh;
    let plant = lines(&SMALL, &Progress::none());
    let wood = &mesh.triangles[..mesh.triangles.len() - 4 * SMALL.leaves];
    assert_watertight(wood);
    assert_watertight(&plant.trunk.mesh.triangles);
    // 1003 leaves are on 51 twigs of 3 branches of 2 limbs.
    assert_eq!(plant.branches.strands.len() - 1, 51 + 3 + 2);
    let radii = plant.branches.radii.as_ref().unwrap();
    assert!(radii.iter().all(|radius| *radius > 0.0));
    let cones: f64 = plant
        .branches
        .segments()
        .map(|vertex| {
            let at = vertex as usize;
            let length = plant.branches.positions[at].distance(plant.branches.positions[at + 1]);
            let [a, b] = [radii[at], radii[at + 1]].map(f64::from);
            PI / 3.0 * length * (a * a + a * b + b * b)
        })
        .sum();
    let trunk = volume(&plant.trunk.mesh.positions, &plant.trunk.mesh.triangles);
    let solid = volume(&mesh.positions, wood);
    assert!(trunk > 0.0 && ((solid - trunk) / cones - 1.0).abs() < 0.12, "{solid} {trunk} {cones}");
}

/// Stems begin on the axes of their parents, which are at least twice as wide there. So forks have no notch, and the round ends of stems lie
/// within their parents.
#[test]
fn stems_begin_within_their_parents() {
    let branches = lines(&SMALL, &Progress::none()).branches;
    let radii = branches.radii.as_ref().unwrap();
    // The radius of a stem where it begins on another one, over the radius of that.
    let share_of_parent = |first: u32| {
        let (place, own) = (branches.positions[first as usize], branches.strand_of(first));
        let others = branches.segments().map(|vertex| vertex as usize);
        let shares = others.filter(|vertex| !own.contains(vertex)).filter_map(|vertex| {
            let [a, b] = [branches.positions[vertex], branches.positions[vertex + 1]];
            let along = ((place - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            let radius = radii[vertex] + along as f32 * (radii[vertex + 1] - radii[vertex]);
            let is_on = place.distance(a.lerp(b, along)) < 1e-6;
            is_on.then(|| radii[first as usize] / radius)
        });
        shares.reduce(f32::max)
    };
    let firsts = &branches.strands[..branches.strands.len() - 1];
    let shares: Vec<f32> = firsts.iter().filter_map(|&first| share_of_parent(first)).collect();
    // The two limbs begin on the trunk, which is no line.
    assert_eq!(shares.len(), 51 + 3);
    assert!(shares.iter().all(|&share| share < 0.5 + 1e-4), "{shares:?}");
}

#[test]
fn trees_are_as_large_as_asked_for() {
    for height in [0.5, 8.0] {
        let plant = lines(&TreeParameters { height, ..SMALL }, &Progress::none());
        let high = plant.leaves.positions.iter().fold(0.0f64, |most, p| most.max(p.y));
        assert!((0.75..1.25).contains(&(high / height)), "{high} of {height}");
    }
    for wanted in [2_000, 60_000] {
        let leaves = TreeParameters::leaves_of(wanted) as usize;
        let mesh = triangles(&TreeParameters { leaves, ..SMALL }, &Progress::none()).mesh;
        let share = mesh.triangles.len() as f64 / wanted as f64;
        assert!((0.9..1.15).contains(&share), "{share} of {wanted}");
    }
}

/// Normals have unit length, and each order has a stem.
#[test]
fn a_tree_of_one_leaf_is_a_tree() {
    let one = TreeParameters { leaves: 1, ..SMALL };
    let plant = lines(&one, &Progress::none());
    assert_eq!(plant.leaves.strands, [0, 3]);
    assert_eq!(plant.branches.strands.len() - 1, 3);
    let normals = plant.leaves.normals.as_ref().unwrap();
    assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-6));
    assert_eq!(
        triangles(&one, &Progress::none()).mesh.positions.len(),
        6 + (9 * 12 + 2) + (7 * 8 + 2) + (6 * 6 + 2) + (4 * 4 + 2)
    );
}
