use proptest::prelude::*;

use super::*;
use crate::assets::first::lines;

fn read(text: &str) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(text.as_bytes().to_vec(), "a.swc"), &ReadOptions::default())
}

/// The x coordinates and the radii of each strand.
fn strands(asset: &Asset) -> Vec<Vec<(f64, f32)>> {
    let lines = lines(asset);
    let radii = lines.radii.as_ref().unwrap();
    lines
        .strands
        .windows(2)
        .map(|ends| {
            (ends[0] as usize..ends[1] as usize).map(|i| (lines.positions[i].x, radii[i])).collect()
        })
        .collect()
}

/// A node of an undefined type at `(x, 0, 0)`.
fn row(id: i64, x: f64, radius: f64, parent: i64) -> String {
    format!("{id} 0 {x} 0 0 {radius} {parent}\n")
}

#[test]
fn lines_may_end_with_carriage_returns_alone() {
    let text = "# a comment\n".to_owned() + &row(1, 1.0, 0.5, -1) + &row(2, 2.0, 0.25, 1);
    let asset = read(&text.replace('\n', "\r")).unwrap();
    assert_eq!(strands(&asset), [[(1.0, 0.5), (2.0, 0.25)]]);
}

#[test]
fn strands_begin_at_the_branch_point() {
    // 1 - 2 - 3 forks into 4 - 5 and 6, in an order that no tool writes.
    let text = [
        "# a comment\n\n".to_owned(),
        row(6, 6.0, 0.6, 3),
        row(3, 3.0, 0.3, 2) + "  # behind a node",
        row(1, 1.0, 0.1, -1),
        row(5, 5.0, 0.5, 4),
        row(2, 2.0, 0.2, 1),
        row(4, 4.0, 0.4, 3),
    ]
    .join("\n");
    let asset = read(&text).unwrap();
    assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
    assert_eq!(
        strands(&asset),
        [
            vec![(3.0, 0.3), (6.0, 0.6)],
            vec![(3.0, 0.3), (4.0, 0.4), (5.0, 0.5)],
            vec![(1.0, 0.1), (2.0, 0.2), (3.0, 0.3)],
        ]
    );
    assert!(lines(&asset).colors.is_none() && asset.format == "swc");
}

#[test]
fn types_are_a_field_and_belong_to_segments() {
    let text = "1 1 0 0 0 5 -1\n2 3 6 0 0 1 1\n3 3 9 0 0 1 2\n4 2 9 5 0 0.5 3\n5 4 9 0 5 0.5 3\n";
    let asset = read(text).unwrap();
    // The body is a ball, and the branch begins in it with its own radius.
    assert_eq!(
        strands(&asset),
        [
            vec![(0.0, 5.0), (0.0, 5.0)],
            vec![(0.0, 1.0), (6.0, 1.0), (9.0, 1.0)],
            vec![(9.0, 1.0), (9.0, 0.5)],
            vec![(9.0, 1.0), (9.0, 0.5)],
        ]
    );
    let lines = lines(&asset);
    let field = &lines.fields.list()[0];
    let types: Vec<f64> =
        (0..9).map(|vertex| field.value(lines.fields.at(vertex)).unwrap()).collect();
    assert_eq!(field.name, "type");
    assert_eq!(types, [1.0, 1.0, 3.0, 3.0, 3.0, 2.0, 2.0, 4.0, 4.0]);
}

#[test]
fn three_nodes_of_a_cell_body_are_a_ball() {
    let text = "1 1 0 0 0 5 -1\n2 1 0 -5 0 5 1\n3 1 0 5 0 5 1\n4 3 7 0 0 1 1\n5 3 9 0 0 1 4\n";
    let asset = read(text).unwrap();
    let expected = [vec![(0.0, 5.0), (0.0, 5.0)], vec![(0.0, 1.0), (7.0, 1.0), (9.0, 1.0)]];
    assert_eq!(strands(&asset), expected);
    assert!(asset.warnings.is_empty());
    // Those of a body that is no ball are drawn as they are.
    let long = text.replace("3 1 0 5 0 5 1", "3 1 0 15 0 5 1");
    assert_eq!(strands(&read(&long).unwrap()).len(), 3);
    let contour = "1 1 0 0 0 5 -1\n2 1 4 0 0 4 1\n3 1 8 0 0 3 2\n";
    assert_eq!(strands(&read(contour).unwrap()), [vec![(0.0, 5.0), (4.0, 4.0), (8.0, 3.0)]]);
}

#[test]
fn branches_of_outer_nodes_are_kept_with_a_warning() {
    let text = " 1 1 0  0  0  5 -1\n 2 1 0  -5 0  5  1\n 3 1 0  +5 0  5  1\n 4 3 0  0  0 10  2 # x\n 5 3 0  0  1 10  4\n";
    let asset = read(text).unwrap();
    assert_eq!(strands(&asset).len(), 2);
    assert!(asset.warnings[0].starts_with("1 branch begins at an outer node"), "{asset:?}");
    assert_eq!(lines(&asset).positions[2], DVec3::new(0.0, -5.0, 0.0));
}

#[test]
fn parents_that_do_not_exist_are_warnings() {
    let text =
        row(1, 1.0, 1.0, -1) + &row(2, 2.0, 1.0, 1) + &row(3, 3.0, 1.0, 77) + &row(4, 4.0, 1.0, 3);
    let asset = read(&text).unwrap();
    assert_eq!(strands(&asset).len(), 2);
    let warning = "1 node names a parent that does not exist and begins a tree of its own; the first is on line 3, with the parent 77";
    assert_eq!(asset.warnings, [warning]);
    let asset = read("1 0 0 0 0 1 NaN\n2 0 1 0 0 1 1\n").unwrap();
    assert_eq!(asset.warnings, ["1 node has NaN for its parent and counts as a root"]);
}

#[test]
fn odd_numbers_are_left_out_or_repaired() {
    // A node without a place cuts its strand; one alone is a ball.
    let text = "1 0 0 0 0 1 -1\n2 0 1 0 0 nan 1\n3 0 nan 0 0 1 2\n4 0 3 0 0 -2 3\n5 0 4 0 0 1 4\n9 0 7 0 0 2 -1\n";
    let asset = read(text).unwrap();
    assert_eq!(
        strands(&asset),
        [vec![(7.0, 2.0), (7.0, 2.0)], vec![(0.0, 1.0), (1.0, 0.0)], vec![(3.0, 0.0), (4.0, 1.0)]]
    );
    assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
}

#[test]
fn errors_name_line_and_column() {
    let node = row(1, 0.0, 1.0, -1);
    for (text, expected) in [
        ("", "a.swc: strand: the file holds no strands"),
        ("1 0 0 0 0 1\n", "a.swc: node 0 (line 1), column parent: is missing"),
        ("1 0 0 zero 0 1 -1\n", "a.swc: node 0 (line 1), column y: \"zero\" is not a number"),
        ("1.5 0 0 0 0 1 -1\n", "column id: 1.5 is not a whole number"),
        ("inf 0 0 0 0 1 -1\n", "column id: inf is not a whole number"),
        ("nan 0 0 0 0 1 -1\n", "column id: NaN is not a whole number"),
        ("1 0 0 0 0 1 0.5\n", "column parent: 0.5 is not a whole number"),
        (
            &(node.clone() + &node),
            "node 1 (line 2), column id: line 1 has a node with the number 1",
        ),
        (&row(1, 0.0, 1.0, 1), "the ancestors of node 1 lead in a circle"),
        (
            &(node + &row(2, 0.0, 1.0, 3) + &row(3, 0.0, 1.0, 2)),
            "line 2), column parent: the ancestors",
        ),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
    let few = ReadOptions { max_vertices: 1, ..ReadOptions::default() };
    let two = row(1, 0.0, 1.0, -1) + &row(2, 1.0, 1.0, 1);
    let refused = read_from(Input::from_bytes(two.into_bytes(), "a"), &few);
    assert!(matches!(refused, Err(AssetError::TooLarge { limit: 1, .. })));
}

/// Trees as deep as there are nodes need no deep stack.
#[test]
fn long_chains_are_read() {
    let text: String = (0..100_000).map(|i| row(i, i as f64, 1.0, i - 1)).collect();
    assert_eq!(
        strands(&read(&text).unwrap()),
        [(0..100_000).map(|i| (f64::from(i), 1.0)).collect::<Vec<_>>()]
    );
}

proptest! {
    #[test]
    fn every_node_is_in_a_strand(parents in prop::collection::vec(0usize..1000, 1..60), types in prop::collection::vec(0u8..5, 60)) {
        // Each node's parent is one before it.
        let text: String = parents.iter().enumerate().map(|(i, parent)| {
            let parent = if i == 0 { -1 } else { (parent % i) as i64 };
            format!("{i} {} {i} 0 0 1 {parent}\n", types[i])
        }).collect();
        let asset = read(&text).unwrap();
        let mut segments = 0;
        for strand in strands(&asset) {
            segments += strand.windows(2).filter(|pair| pair[0].0 != pair[1].0).count();
            for pair in strand.windows(2).filter(|pair| pair[0].0 != pair[1].0) {
                let (from, to) = (pair[0].0 as usize, pair[1].0 as usize);
                prop_assert_eq!(parents[to] % to, from);
            }
        }
        prop_assert_eq!(segments, parents.len() - 1);
    }

    #[test]
    fn anything_ends_without_panic(text in "([-0-9 .eN#a\n]|1 0 0 0 0 1 -1\n|2 1 0 0 0 1 1\n){0,60}") {
        let _ = read(&text);
    }
}
