use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;

use super::hierarchy::{self, Tree};
use super::node::Matter;
use super::node::{NO_NODE, Node};
use super::*;
use crate::assets::Kernel;
use crate::bake::kernels::circle;
use crate::bake::pack::octahedral_decode;
use crate::math::Bounds;
use crate::scene::random::SplitMix64;

fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut numbers = SplitMix64::new(seed);
    move || (numbers.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// Evenly distributed samples of a sphere, whose disks cover it.
fn sphere(count: usize, radius: f64) -> PointCloud {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let spacing = radius * (4.0 * std::f64::consts::PI / count as f64).sqrt();
    let normals: Vec<Vec3> = (0..count)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let ring = (1.0 - z * z).sqrt();
            DVec3::new(ring * cos, ring * sin, z).as_vec3()
        })
        .collect();
    PointCloud {
        positions: normals.iter().map(|n| n.as_dvec3() * radius).collect(),
        kernels: Some(normals.iter().map(|&n| circle(n, (0.46 * spacing) as f32)).collect()),
        normals: Some(normals),
        oriented: true,
        ..PointCloud::default()
    }
}

/// Random samples, some at one position, with disks of all sizes.
fn scattered(count: usize, seed: u64) -> PointCloud {
    let mut next = random(seed);
    let mut cloud = PointCloud::default();
    let (mut normals, mut kernels, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..count {
        let again = index > 0 && next() < 0.2;
        let position = DVec3::new(next(), next() * 0.3, next() * 10.0);
        cloud.positions.push(if again { cloud.positions[index - 1] } else { position });
        let normal = Vec3::new(next() as f32 - 0.5, next() as f32 - 0.5, next() as f32 - 0.5);
        let normal = if next() < 0.1 { Vec3::ZERO } else { normal.normalize_or_zero() };
        normals.push(normal);
        kernels.push(circle(normal, (10f64.powf(-4.0 * next()) * 0.1) as f32));
        colors.push([(next() * 255.0) as u8, 10, 200, 255]);
    }
    cloud.normals = Some(normals);
    cloud.kernels = Some(kernels);
    cloud.colors = Some(colors);
    cloud
}

fn tree_of(cloud: &PointCloud) -> Tree {
    hierarchy::build(cloud, None, &Bounds::of(cloud.positions.iter().copied()), Matter::Points)
}

fn packed(cloud: &PointCloud, tree: &Tree) -> (PackedSamples, Vec<u32>) {
    let bounds = Bounds::of(cloud.positions.iter().copied()).grown(1.0);
    sequence::sequence(cloud, tree, Grid::of(&bounds).unwrap(), 0)
}

fn is_above(tree: &Tree, mut node: usize, above: usize) -> bool {
    while node != above {
        if tree.nodes[node].parent == NO_NODE {
            return false;
        }
        node = tree.nodes[node].parent as usize;
    }
    true
}

#[test]
fn there_is_one_root_and_every_node_has_few_children() {
    for cloud in [sphere(5000, 2.0), scattered(3000, 1), scattered(1, 2), scattered(20, 3)] {
        let tree = tree_of(&cloud);
        let leaves = cloud.positions.len();
        assert_eq!(tree.samples.len(), leaves);
        assert_eq!(tree.nodes.iter().filter(|node| node.parent == NO_NODE).count(), 1);
        let mut children = vec![0; tree.nodes.len()];
        for node in &tree.nodes {
            if node.parent != NO_NODE {
                children[node.parent as usize] += 1;
            }
        }
        assert!(children[..leaves].iter().all(|&count| count == 0));
        assert!(children[leaves..].iter().all(|&count| (2..=8).contains(&count)));
        // Parents come after their children.
        let behind = |(index, node): (usize, &Node)| node.parent as usize > index;
        assert!(tree.nodes.iter().enumerate().all(behind));
        let mut seen = tree.samples.clone();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..leaves as u32));
    }
}

#[test]
fn many_samples_at_one_place_make_a_tree_too() {
    let mut cloud = sphere(4, 1.0);
    for _ in 0..600 {
        cloud.positions.push(cloud.positions[1]);
        cloud.normals.as_mut().unwrap().push(Vec3::Z);
        cloud.kernels.as_mut().unwrap().push(Kernel::default());
    }
    let tree = tree_of(&cloud);
    assert_eq!(tree.nodes.iter().filter(|node| node.parent == NO_NODE).count(), 1);
    assert!(build_tree(&cloud, None).unwrap().nodes.len() > 604);
}

#[test]
fn an_empty_cloud_has_an_empty_tree() {
    let packed = build_tree(&PointCloud::default(), None).unwrap();
    assert!(packed.nodes.is_empty() && packed.chunks.is_empty());
}

#[test]
fn a_node_stands_for_all_leaves_below_it() {
    for cloud in [sphere(3000, 2.0), scattered(800, 7)] {
        let tree = tree_of(&cloud);
        for leaf in 0..tree.samples.len() {
            let below = tree.nodes[leaf];
            let mut at = below.parent;
            while at != NO_NODE {
                let node = &tree.nodes[at as usize];
                let way = (below.position - node.position).as_vec3();
                let slack = 1e-4 * node.radius;
                if node.normal == Vec3::ZERO {
                    assert!(way.length() + below.radius <= node.radius + slack);
                } else {
                    let height = way.dot(node.normal);
                    let across = (way - height * node.normal).length();
                    let cosine = below.normal.dot(node.normal);
                    let tilt = below.radius * (1.0 - cosine * cosine).max(0.0).sqrt();
                    assert!(across + below.radius <= node.radius + slack, "covered");
                    assert!(height.abs() + tilt <= node.lift + slack, "within the lift");
                }
                at = node.parent;
            }
        }
    }
}

/// In any direction within its plane, a disk ends at most its spread beyond some leaf's disk.
#[test]
fn a_disk_reaches_little_beyond_its_leaves() {
    let cloud = sphere(3000, 2.0);
    let tree = tree_of(&cloud);
    for (index, node) in tree.nodes.iter().enumerate().skip(tree.samples.len()) {
        if node.normal == Vec3::ZERO {
            continue;
        }
        let [a, b] = crate::bake::kernels::tangents(node.normal);
        let leaves: Vec<(Vec2, f32)> = (0..tree.samples.len())
            .filter(|&leaf| is_above(&tree, leaf, index))
            .map(|leaf| {
                let leaf = &tree.nodes[leaf];
                let way = (leaf.position - node.position).as_vec3();
                (Vec2::new(way.dot(a), way.dot(b)), leaf.radius * leaf.normal.dot(node.normal))
            })
            .collect();
        // These are other places than those that the tree was built with.
        for turn in 0..40 {
            let (sin, cos) = (turn as f32 * 2.399_963).sin_cos();
            let place = Vec2::new(cos, sin) * node.radius * ((turn as f32 + 0.5) / 40.0).sqrt();
            let way = |(at, radius): &(Vec2, f32)| (place - *at).length() - radius;
            let nearest = leaves.iter().map(way).fold(f32::MAX, f32::min);
            // Between the sampled places the distance may be a little larger.
            assert!(nearest <= node.spread + 0.1 * node.radius, "{nearest} {node:?}");
        }
        if index > tree.samples.len() + 60 {
            break;
        }
    }
}

#[test]
fn errors_grow_upwards_and_with_the_size_of_the_disk() {
    let cloud = sphere(20_000, 2.0);
    let tree = tree_of(&cloud);
    for node in &tree.nodes {
        if let Some(parent) = tree.nodes.get(node.parent as usize) {
            assert!(parent.error >= node.error && parent.radius >= 0.99 * node.radius);
        }
        assert!(node.error.is_finite() && node.radius.is_finite());
    }
    // A disk of radius r on a sphere of radius 2 is r²/4 away from it, or half of that if it lies in between.
    let inner = tree.nodes.iter().filter(|node| node.level > 0 && node.radius < 0.5);
    for node in inner {
        let sagitta = node.radius * node.radius / 4.0;
        assert!(node.lift <= 2.5 * sagitta + 0.1 * node.radius, "{node:?}");
        assert!(node.error < 1.5 * node.radius, "{node:?}");
    }
}

#[test]
fn colors_that_differ_keep_their_detail() {
    let mut cloud = sphere(4000, 2.0);
    let plain = tree_of(&cloud);
    let stripes = cloud.positions.iter().map(|p| {
        if (p.z * 20.0).floor() as i64 % 2 == 0 { [255, 255, 255, 255] } else { [0, 0, 0, 255] }
    });
    cloud.colors = Some(stripes.collect());
    let striped = tree_of(&cloud);
    let mean = |tree: &Tree| {
        let inner = &tree.nodes[tree.samples.len()..];
        inner.iter().map(|node| f64::from(node.error / node.radius)).sum::<f64>()
            / inner.len() as f64
    };
    assert!(mean(&striped) > 0.8 && mean(&plain) < 0.6, "{} {}", mean(&striped), mean(&plain));
}

#[test]
fn codes_are_bounds_and_keep_the_order() {
    let mut next = random(5);
    let base = 3.7;
    let mut last = (0.0f32, NONE);
    let mut values: Vec<f32> =
        (0..2000).map(|_| base * 0.5 * (-30.0 * next()).exp2() as f32).collect();
    values.sort_by(f32::total_cmp);
    for value in values {
        let code = sequence::code(value, base);
        assert!(decode(code, base) >= value && decode(code, base) <= value * 1.018, "{value}");
        assert!(code <= last.1 && value >= last.0 && code != NO_PARENT);
        last = (value, code);
        // The parent is half as large, or far larger.
        for factor in [0.5, 3.0, 40.0] {
            let size = sequence::code(value * factor, base);
            let words = |value| [sequence::delta_bits(value, size, base), size << CODE_BITS];
            let found = decode_delta(words(value), base);
            assert!(found >= value, "{value}");
            assert!(found <= value * if factor > 10.0 { 20.0 } else { 1.21 }, "{value} {found}");
        }
        // Codes of sizes end 32 octaves below the base.
        if value > 1e-7 {
            let size = sequence::code(value * 0.1, base);
            let words = [sequence::delta_bits(value, size, base), size << CODE_BITS];
            assert_eq!(decode_delta(words, base), base);
        }
    }
    assert_eq!(decode(sequence::code(0.0, base), base), 0.0);
}

#[test]
fn cones_hold_the_normals_below() {
    let cloud = sphere(3000, 2.0);
    let tree = tree_of(&cloud);
    let (packed, order) = packed(&cloud, &tree);
    let mut sines = vec![2.0; tree.nodes.len()];
    for (words, &node) in packed.nodes.iter().zip(&order) {
        sines[node as usize] = cone_sine(words[1]);
    }
    assert!(sines.iter().filter(|sine| **sine < 0.5).count() > 3500);
    for leaf in 0..tree.samples.len() {
        let mut at = tree.nodes[leaf].parent;
        while at != NO_NODE {
            let node = &tree.nodes[at as usize];
            let sine = sines[at as usize];
            let cosine = node.normal.dot(tree.nodes[leaf].normal);
            assert!(sine > 1.0 || cosine >= (1.0 - sine * sine).max(0.0).sqrt() - 1e-4);
            at = node.parent;
        }
    }
}

#[test]
fn the_first_chunks_are_small_and_chunks_say_what_is_in_them() {
    let cloud = sphere(30_000, 2.0);
    let packed = build_tree(&cloud, None).unwrap();
    let counts: Vec<u32> = packed.chunks.iter().map(|chunk| chunk.count).collect();
    assert_eq!(counts[..2], [64, 192]);
    assert!(counts.iter().all(|&count| count as usize <= crate::bake::pack::CHUNK));
    assert_eq!(counts.iter().map(|&count| count as usize).sum::<usize>(), packed.nodes.len());
    for pair in packed.chunks.windows(2) {
        assert!(pair[0].range.error_parent >= pair[1].range.error_parent);
        assert!(pair[0].range.delta_most >= pair[1].range.delta_most);
    }
    for chunk in &packed.chunks {
        for [error, size] in &packed.nodes[chunk.first as usize..][..chunk.count as usize] {
            let range = chunk.range;
            let parent = error >> CODE_BITS & CODE;
            assert!(parent == NO_PARENT || decode(parent, range.base) <= range.error_parent);
            assert!(decode(error & CODE, range.base) >= range.error_least);
            assert!(decode(size & CODE, range.base) >= range.size_least);
            assert!(decode_delta([*error, *size], range.base) <= range.delta_most);
        }
    }
    let statistics = TreeStatistics::of(&packed);
    assert_eq!(statistics.leaves, 30_000);
    assert!(statistics.inner < 20_000, "{statistics:?}");
    // A node takes 28 bytes.
    assert_eq!(statistics.bytes, 28 * packed.nodes.len() as u64);
}

#[test]
fn trees_are_equal_whatever_the_number_of_threads() {
    let cloud = scattered(40_000, 9);
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build_tree(&cloud, None).unwrap())
    };
    let (a, b) = (build(1), build(3));
    assert!(a.nodes == b.nodes && a.positions == b.positions && a.attributes == b.attributes);
}

/// A camera that selects packed nodes in the precision of shaders.
struct Camera {
    eye: Vec3,
    forward: Vec3,
    /// Maps grid cells to camera space.
    axes: glam::Mat3,
    lod: f32,
    split: bool,
}

impl Camera {
    /// The nodes of the tree that are drawn by a measure.
    fn drawn(&self, packed: &PackedSamples, order: &[u32], measure: usize) -> Vec<bool> {
        let mut drawn = vec![false; order.len()];
        let [x, y, z] = self.axes.to_cols_array_2d().map(Vec3::from);
        let stretch = x.length().max(y.length()).max(z.length());
        // Shaders make the same test: under a non-uniform scale errors do not depend on the angle.
        let one = x.length_squared();
        let off =
            [y.length_squared() - one, z.length_squared() - one, x.dot(y), y.dot(z), z.dot(x)];
        let is_even = off.iter().all(|off| off.abs() <= 1e-3 * one);
        let origin = packed.grid.position(glam::IVec3::ZERO).as_vec3() / packed.grid.step as f32;
        for chunk in &packed.chunks {
            for at in (chunk.first..chunk.first + chunk.count).map(|at| at as usize) {
                let cell = chunk.cell(packed.positions[at]);
                let centre = self.axes * (cell.as_vec3() + origin) - self.eye;
                let normal = octahedral_decode(packed.attributes[at][1]);
                let across = self.axes * normal / stretch;
                let cosine = if self.split && is_even && normal != Vec3::ZERO {
                    (across.dot(centre) / (across.length() * centre.length())).abs().min(1.0)
                } else {
                    UNTILTED
                };
                let seen = Seen { z: centre.dot(self.forward), far: centre.length(), cosine };
                let (words, base) = (packed.nodes[at], chunk.range.base * stretch);
                drawn[order[at] as usize] = is_drawn(words, measure, base, self.lod, seen);
            }
        }
        drawn
    }
}

/// Finds a leaf that is not drawn and has no drawn ancestor.
fn uncovered(tree: &Tree, drawn: &[bool]) -> Option<usize> {
    (0..tree.samples.len()).find(|&leaf| {
        let mut at = leaf as u32;
        while at != NO_NODE && !drawn[at as usize] {
            at = tree.nodes[at as usize].parent;
        }
        at == NO_NODE
    })
}

/// At any distance, errors by viewing angle draw fewer nodes, and no leaf is left uncovered.
#[test]
fn a_split_error_draws_fewer_nodes_of_a_curved_surface() {
    let cloud = sphere(20_000, 2.0);
    let tree = tree_of(&cloud);
    let (packed, order) = packed(&cloud, &tree);
    let mut counts = [0, 0];
    for distance in [4.0f32, 7.0, 12.0, 20.0, 33.0] {
        for (split, sum) in [false, true].into_iter().zip(&mut counts) {
            let eye = Vec3::new(0.48, -0.6, 0.64) * distance;
            let axes = glam::Mat3::IDENTITY * packed.grid.step as f32;
            let camera = Camera { eye, forward: -eye / distance, axes, lod: 0.02, split };
            let drawn = camera.drawn(&packed, &order, 0);
            assert_eq!(uncovered(&tree, &drawn), None);
            *sum += drawn.iter().filter(|drawn| **drawn).count();
        }
    }
    let [unified, split] = counts;
    assert!(100 * split < 95 * unified, "{split} of {unified}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]
    /// For any eye, scale (also one per axis) and accepted error, every leaf has a drawn ancestor-or-self. The test runs in f32
    /// on the packed words and positions, as in shaders.
    #[test]
    fn every_leaf_is_covered(
        seed in 0u64..1000,
        even in any::<bool>(),
        eye in prop::array::uniform3(-20.0f32..20.0),
        forward in prop::array::uniform3(-1.0f32..1.0),
        scale in -6.0f32..6.0,
        stretch in prop::option::of(prop::array::uniform3(-1.0f32..1.0)),
        lod in -16.0f32..2.0,
        measure in 0usize..2,
        split in any::<bool>(),
    ) {
        let cloud = if even { sphere(1500, 3.0) } else { scattered(900, seed) };
        let tree = tree_of(&cloud);
        let (packed, order) = packed(&cloud, &tree);
        let forward = Vec3::from(forward).try_normalize().unwrap_or(Vec3::Z);
        let (scale, lod) = (scale.exp2(), lod.exp2());
        let sides = stretch.map_or(Vec3::ONE, |s| Vec3::from(s.map(f32::exp2)));
        let axes = glam::Mat3::from_diagonal(sides * scale * packed.grid.step as f32);
        let camera = Camera { eye: Vec3::from(eye) * scale.min(1.0), forward, axes, lod, split: split && measure == 0 };
        let drawn = camera.drawn(&packed, &order, measure);
        prop_assert_eq!(uncovered(&tree, &drawn), None, "a leaf has no drawn ancestor");
    }
}

/// A flat sheet of triangles, and the unit sphere.
fn meshes() -> [(bool, crate::assets::Mesh); 2] {
    let side = 40u32;
    let at =
        |i: u32| DVec3::new(f64::from(i % side), f64::from(i / side), 0.003 * f64::from(i % 7));
    let quad = |i: u32| {
        let at = i / (side - 1) * side + i % (side - 1);
        [[at, at + 1, at + side + 1], [at, at + side + 1, at + side]]
    };
    let sheet = crate::assets::Mesh {
        positions: (0..side * side).map(at).collect(),
        triangles: (0..(side - 1) * (side - 1)).flat_map(quad).collect(),
        ..Default::default()
    };
    let (rings, columns) = (24u32, 48u32);
    let on_sphere = |i: u32| {
        let theta = f64::from(i / columns) / f64::from(rings) * std::f64::consts::PI;
        let phi = f64::from(i % columns) / f64::from(columns) * std::f64::consts::TAU;
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    };
    let quad = |i: u32| {
        let (ring, column) = (i / columns * columns, i % columns);
        let [a, b] = [ring + column, ring + (column + 1) % columns];
        [[a, a + columns, b], [b, a + columns, b + columns]]
    };
    let sphere = crate::assets::Mesh {
        positions: (0..(rings + 1) * columns).map(on_sphere).collect(),
        triangles: (0..rings * columns).flat_map(quad).collect(),
        ..Default::default()
    };
    [(false, sheet), (true, sphere)]
}

fn mesh_tree((closed, mesh): &(bool, crate::assets::Mesh)) -> PackedSamples {
    let hybrid = crate::bake::hybrid::hybrid_mesh(mesh, &[], &[], 1 << 20).unwrap();
    let bounds = Bounds::of(mesh.positions.iter().copied());
    build_tree_within(&hybrid.samples, Some(&hybrid.stands), bounds, *closed).unwrap()
}

/// For any accepted error, and however small the nodes then are, only the root of a surface is ever thinned.
#[test]
fn whole_surfaces_are_not_thinned() {
    let scan = build_tree(&sphere(4000, 2.0), None).unwrap();
    let meshes = meshes();
    for tree in [scan, mesh_tree(&meshes[0]), mesh_tree(&meshes[1])] {
        for ([error, _], [color, _]) in tree.nodes.iter().zip(&tree.attributes) {
            let [_, _, _, byte] = color.to_le_bytes();
            let is_root = error >> CODE_BITS & CODE == NO_PARENT;
            assert!(is_root || probability(byte, 0.01) == 1.0, "{byte}");
            assert!(!is_root || probability(byte, 0.01) < 0.011, "{byte}");
        }
    }
}

#[test]
fn a_root_knows_what_its_leaves_cover() {
    let [sheet, ball] = meshes();
    let near = |found: f32, expected: f32| (found / expected - 1.0).abs() < 0.1;
    let area = |tree: &PackedSamples| Root::of(tree).unwrap().measures.area;
    let found = [area(&mesh_tree(&sheet)), area(&mesh_tree(&ball))];
    assert!(near(found[0], 39.0 * 39.0) && near(found[1], std::f32::consts::PI), "{found:?}");
    // A scan's area is known only from its kernels.
    let found = area(&build_tree(&sphere(4000, 2.0), None).unwrap());
    assert!((0.7..1.5).contains(&(found / (4.0 * std::f32::consts::PI))), "{found}");
}

#[test]
fn what_covers_little_is_drawn_seldom() {
    for share in [0.0, 0.01, 0.3, 0.9, 1.0, 7.0] {
        let of = |around: u8| probability(around << 6, share);
        assert_eq!(of(0), share.min(1.0));
        assert!((1..3).all(|around| (0.0..=1.0).contains(&of(around))), "{share}");
        assert!((0..3).all(|around| of(around) <= of(around + 1) || share > 0.3), "{share}");
        assert_eq!(of(3), 1.0);
    }
    assert_eq!(probability(EXACT, 0.0), 1.0);
}
