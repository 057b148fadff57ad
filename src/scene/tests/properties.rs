//! Properties of random scenes.

use glam::{DAffine3, DVec3};
use proptest::prelude::*;

use super::*;

/// A node of a random prototype graph, flattened to what the properties need.
#[derive(Clone, Debug)]
struct RandomNode {
    draws: Draws,
    offset: [i32; 3],
    grid: [u32; 3],
    material: Option<usize>,
    visible: bool,
}

/// Prototypes that only use those before them, and top-level nodes.
#[derive(Clone, Debug)]
struct RandomScene {
    prototypes: Vec<Vec<RandomNode>>,
    nodes: Vec<RandomNode>,
}

fn random_node(prototypes: usize) -> impl Strategy<Value = RandomNode> {
    let draws = (0..4u8, 0..prototypes.max(1)).prop_map(move |(kind, index)| match kind {
        0 => Draws::Nothing,
        1 => Draws::Asset(0),
        _ if prototypes > 0 => Draws::Prototype(index),
        _ => Draws::Asset(0),
    });
    (
        draws,
        prop::array::uniform3(-5..5i32),
        prop::array::uniform3(1..3u32),
        prop::option::of(0..2usize),
        prop::bool::weighted(0.9),
    )
        .prop_map(|(draws, offset, grid, material, visible)| RandomNode {
            draws,
            offset,
            grid,
            material,
            visible,
        })
}

fn random_scene() -> impl Strategy<Value = RandomScene> {
    let prototypes: Vec<_> = (0..4).map(|i| prop::collection::vec(random_node(i), 0..3)).collect();
    (prototypes, prop::collection::vec(random_node(4), 0..3))
        .prop_map(|(prototypes, nodes)| RandomScene { prototypes, nodes })
}

impl RandomScene {
    fn to_json(&self) -> String {
        let node = |n: &RandomNode| {
            let draws = match n.draws {
                Draws::Nothing => String::new(),
                Draws::Asset(_) => r#""asset": "a","#.to_owned(),
                Draws::Prototype(i) => format!(r#""prototype": "p{i}","#),
            };
            let material = match n.material {
                Some(i) => format!(r#""material": "m{i}","#),
                None => String::new(),
            };
            let (visible, offset, grid) = (n.visible, n.offset, n.grid);
            format!(
                r#"{{{draws} {material} "visible": {visible}, "translate": {offset:?}, "rotate": [0, 90, 0],
                "scale": 2, "repeat": {{"grid": {grid:?}, "step": [8, 16, 32]}}}}"#
            )
        };
        let list = |nodes: &[RandomNode]| nodes.iter().map(node).collect::<Vec<_>>().join(",");
        let prototypes: Vec<String> = self
            .prototypes
            .iter()
            .enumerate()
            .map(|(i, nodes)| format!(r#""p{i}": {{"children": [{}]}}"#, list(nodes)))
            .collect();
        format!(
            r#"{{"assets": {{"a": {{"file": "a.ply"}}}}, "materials": {{"m0": {{}}, "m1": {{}}}},
            "prototypes": {{{}}}, "nodes": [{}]}}"#,
            prototypes.join(","),
            list(&self.nodes)
        )
    }

    /// The product formula: copies × (own + Σ below), summed.
    fn count(&self, nodes: &[RandomNode]) -> u64 {
        nodes
            .iter()
            .filter(|n| n.visible)
            .map(|n| {
                let drawn = match n.draws {
                    Draws::Nothing => 0,
                    Draws::Asset(_) => 1,
                    Draws::Prototype(i) => self.count(&self.prototypes[i]),
                };
                n.grid.iter().map(|&c| u64::from(c)).product::<u64>() * drawn
            })
            .sum()
    }

    /// Every instance, flattened the plain way: nested loops and matrix products.
    fn flatten(
        &self,
        nodes: &[RandomNode],
        world: DAffine3,
        material: Option<usize>,
        found: &mut Vec<(DAffine3, Option<usize>)>,
    ) {
        for n in nodes.iter().filter(|n| n.visible) {
            let own = DAffine3::from_translation(DVec3::from_array(n.offset.map(f64::from)))
                * DAffine3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X, DVec3::ZERO)
                * DAffine3::from_scale(DVec3::splat(2.0));
            let material = n.material.or(material);
            let [nx, ny, nz] = n.grid;
            let middle = |i: u32, n: u32| f64::from(i) - (f64::from(n) - 1.0) / 2.0;
            for z in 0..nz {
                for y in 0..ny {
                    for x in 0..nx {
                        let shift = DVec3::new(middle(x, nx), middle(y, ny), middle(z, nz))
                            * DVec3::new(8.0, 16.0, 32.0);
                        let here = world * DAffine3::from_translation(shift) * own;
                        match n.draws {
                            Draws::Nothing => {}
                            Draws::Asset(_) => found.push((here, material)),
                            Draws::Prototype(i) => {
                                self.flatten(&self.prototypes[i], here, material, found);
                            }
                        }
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn instances_equal_the_product_and_the_flattened_scene(random in random_scene()) {
        let folder = Folder::new();
        let limits = SceneLimits { max_instances: u64::MAX, ..SceneLimits::default() };
        let scene = parse(&random.to_json(), "t", &folder.root, &folder.root, &limits).unwrap();
        let count = random.count(&random.nodes);
        prop_assert_eq!(scene.instance_count(), count);
        prop_assume!(count < 200_000);
        let mut expected = Vec::new();
        random.flatten(&random.nodes, DAffine3::IDENTITY, None, &mut expected);
        let found: Vec<_> =
            scene.instances().iter().map(|i| (i.world_from_asset, i.material)).collect();
        // Small integers and quarter turns: every product is exact.
        prop_assert_eq!(found, expected);
    }

    /// A back edge somewhere makes a cycle if and only if its end reaches its start.
    #[test]
    fn cycles_are_always_found(edges in prop::collection::vec((0..8usize, 0..8usize), 1..14)) {
        let children: Vec<String> = (0..8)
            .map(|from| {
                let uses: Vec<String> = edges
                    .iter()
                    .filter(|e| e.0 == from)
                    .map(|e| format!(r#"{{"children": [{{"prototype": "p{}"}}]}}"#, e.1))
                    .collect();
                format!(r#""p{from}": {{"children": [{}]}}"#, uses.join(","))
            })
            .collect();
        let text = format!(r#"{{"assets": {{}}, "nodes": [], "prototypes": {{{}}}}}"#, children.join(","));
        let mut reach = [[false; 8]; 8];
        for &(from, to) in &edges {
            reach[from][to] = true;
        }
        for via in 0..8 {
            for from in 0..8 {
                for to in 0..8 {
                    reach[from][to] |= reach[from][via] && reach[via][to];
                }
            }
        }
        let cyclic = (0..8).any(|i| reach[i][i]);
        match Folder::new().parse(&text) {
            Ok(_) => prop_assert!(!cyclic),
            Err(SceneError::Invalid { reason, .. }) => {
                prop_assert!(cyclic && reason.contains("contains itself"), "{}", reason);
                let names: Vec<&str> = reason["contains itself: ".len()..].split(" → ").collect();
                prop_assert_eq!(names.first(), names.last());
                for pair in names.windows(2) {
                    let index = |name: &str| name[1..].parse::<usize>().unwrap();
                    prop_assert!(edges.contains(&(index(pair[0]), index(pair[1]))));
                }
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    /// Bytes overwritten, removed or repeated anywhere: an answer, never a panic.
    #[test]
    fn damaged_files_never_panic(
        random in random_scene(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..3u8, "[-0-9eE.\\[\\]{}\",:ntfa]"), 1..6),
    ) {
        let mut text: Vec<char> = random.to_json().chars().collect();
        for (at, kind, with) in edits {
            let at = at.index(text.len());
            match kind {
                0 => text[at] = with.chars().next().unwrap(),
                1 => { text.remove(at); }
                _ => { let c = text[at]; text.insert(at, c); }
            }
        }
        let text: String = text.into_iter().collect();
        let folder = Folder::new();
        if let Ok(scene) = folder.parse(&text)
            && scene.instance_count() < 100_000
        {
            prop_assert_eq!(scene.instances().len() as u64, scene.instance_count());
        }
    }

    /// Whole values replaced by others of any type.
    #[test]
    fn values_of_the_wrong_type_never_panic(
        random in random_scene(),
        target in any::<prop::sample::Index>(),
        value in prop::sample::select(vec![
            "null", "true", "-1", "0", "1e300", "18446744073709551616", "\"\"", "\"#fff\"", "[]",
            "[1]", "[1,2,3]", "[[[]]]", "{}", "{\"a\":1}",
        ]),
    ) {
        let json: serde_json::Value = serde_json::from_str(&random.to_json()).unwrap();
        let mut pointers = Vec::new();
        collect_pointers(&json, String::new(), &mut pointers);
        let mut json = json;
        let pointer = &pointers[target.index(pointers.len())];
        *json.pointer_mut(pointer).unwrap() = serde_json::from_str(value).unwrap();
        let folder = Folder::new();
        match folder.parse(&json.to_string()) {
            Ok(scene) => {
                if scene.instance_count() < 100_000 {
                    scene.instances();
                }
            }
            Err(error) => prop_assert!(error.to_string().starts_with("test.json: ")),
        }
    }
}

fn collect_pointers(value: &serde_json::Value, here: String, found: &mut Vec<String>) {
    match value {
        serde_json::Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                collect_pointers(item, format!("{here}/{i}"), found);
            }
        }
        serde_json::Value::Object(map) => {
            for (key, item) in map {
                collect_pointers(item, format!("{here}/{key}"), found);
            }
        }
        _ => {}
    }
    found.push(here);
}
