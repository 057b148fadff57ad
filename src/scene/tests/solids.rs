//! Assets that are more than a file: sampled, searched for features, made of others. And how splats are drawn.

use glam::DVec3;

use super::*;

/// A scene with these assets, and one node that draws `part`.
fn with_assets(assets: &str) -> String {
    format!(r#"{{"assets": {{{assets}}}, "nodes": [{{"asset": "part"}}]}}"#)
}

const TWO: &str =
    r#""a": {"file": "a.ply", "sample": {}}, "b": {"file": "b.ply", "sample": {"spacing": 0.5}}"#;

#[test]
fn solids_name_other_assets() {
    let text = with_assets(&format!(
        r#"{TWO}, "part": {{"difference": [{{"asset": "inner"}},
            {{"asset": "b", "translate": [1, 2, 3], "rotate": [0, 0, 90], "scale": 2}}]}},
        "inner": {{"union": [{{"asset": "a"}}, {{"asset": "a", "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 7,0,0,1]}}]}},
        "scan": {{"file": "sub/c.ply", "features": true}}"#
    ));
    let scene = Folder::new().parse(&text).unwrap();
    let AssetSource::File(b) = &scene.assets[1].source else { panic!("a file") };
    assert_eq!(b.sample, Some(MeshSampling { spacing: Some(0.5), crease_deg: None }));
    let AssetSource::File(scan) = &scene.assets[4].source else { panic!("a file") };
    assert!(scan.features && scan.sample.is_none());
    let AssetSource::Solid(part) = &scene.assets[2].source else { panic!("a solid") };
    assert_eq!(part.operation, CsgOperation::Difference);
    assert_eq!(part.operands.iter().map(|o| o.asset).collect::<Vec<_>>(), [3, 1]);
    let map = part.operands[1].solid_from_operand;
    assert_eq!(map.transform_point3(DVec3::X), DVec3::new(1.0, 4.0, 3.0));
    assert_eq!(scene.assets[3].operands()[1].solid_from_operand.translation.x, 7.0);
    assert_eq!(scene.operands_only(), [true, true, false, true, false]);
}

#[test]
fn hidden_nodes_draw_as_well() {
    let text = format!(
        r#"{{"assets": {{{TWO}, "part": {{"union": [{{"asset": "a"}}, {{"asset": "b"}}]}}}},
        "prototypes": {{"p": {{"children": [{{"asset": "b"}}]}}}},
        "nodes": [{{"asset": "a", "visible": false}}]}}"#
    );
    assert_eq!(Folder::new().parse(&text).unwrap().operands_only(), [false, false, false]);
}

#[test]
fn wrong_mixes_are_refused() {
    let f = Folder::new();
    let part = |part: &str, path: &str, words: &str| {
        f.assert_refused(&with_assets(&format!(r#"{TWO}, "part": {part}"#)), path, words);
    };
    let pair = r#"[{"asset": "a"}, {"asset": "b"}]"#;
    part("{}", "assets.part", "needs `file`, or one of");
    part(&format!(r#"{{"file": "a.ply", "union": {pair}}}"#), "assets.part", "`file` and `union`");
    part(
        &format!(r#"{{"difference": {pair}, "union": {pair}}}"#),
        "assets.part",
        "both `union` and `difference`",
    );
    part(
        &format!(r#"{{"union": {pair}, "sample": {{}}}}"#),
        "assets.part.sample",
        "beside `union`",
    );
    part(
        &format!(r#"{{"union": {pair}, "features": true}}"#),
        "assets.part.features",
        "means nothing",
    );
    part(
        r#"{"file": "a.ply", "sample": {}, "features": true}"#,
        "assets.part.features",
        "beside `sample`",
    );
    part(r#"{"union": []}"#, "assets.part.union", "at least two");
    part(r#"{"union": [{"asset": "a"}]}"#, "assets.part.union", "at least two");
    part(r#"{"union": [{"asset": "a"}, {}]}"#, "assets.part.union[1]", "missing field `asset`");
    part(
        r#"{"union": [{"asset": "a"}, {"asset": "ab"}]}"#,
        "assets.part.union[1].asset",
        "there is no asset `ab`; did you mean",
    );
    part(
        r#"{"difference": [{"asset": "a"}, {"asset": "b", "scale": 0}]}"#,
        "assets.part.difference[1].scale",
        "flattens",
    );
    part(
        r#"{"difference": [{"asset": "a"}, {"asset": "b", "visible": true}]}"#,
        "assets.part.difference[1].visible",
        "unknown key `visible`",
    );
    part(r#"{"file": "a.ply", "sample": {"space": 1}}"#, "assets.part.sample.space", "`spacing`");
    part(r#"{"file": "a.ply", "sample": {"spacing": 0}}"#, "assets.part.sample.spacing", "outside");
    part(
        r#"{"file": "a.ply", "sample": {"crease": 181}}"#,
        "assets.part.sample.crease",
        "outside 0..=180",
    );
    part(r#"{"fil": "a.ply"}"#, "assets.part.fil", "did you mean `file`?");
}

#[test]
fn solids_made_of_themselves_are_refused() {
    let f = Folder::new();
    let text = with_assets(&format!(
        r#"{TWO}, "part": {{"union": [{{"asset": "a"}}, {{"asset": "x"}}]}},
        "x": {{"intersection": [{{"asset": "y"}}, {{"asset": "b"}}]}},
        "y": {{"difference": [{{"asset": "b"}}, {{"asset": "x"}}]}}"#
    ));
    f.assert_refused(&text, "assets.x", "is made of itself: x → y → x");
    let own = with_assets(&format!(
        r#"{TWO}, "part": {{"union": [{{"asset": "a"}}, {{"asset": "part"}}]}}"#
    ));
    f.assert_refused(&own, "assets.part", "part → part");
}

#[test]
fn solids_have_limits() {
    let f = Folder::new();
    let mut assets = TWO.to_owned();
    for i in 0..70 {
        let below = if i == 0 { "a".to_owned() } else { format!("s{}", i - 1) };
        assets.push_str(&format!(
            r#", "s{i}": {{"union": [{{"asset": "{below}"}}, {{"asset": "b"}}]}}"#
        ));
    }
    let chain = format!(r#"{{"assets": {{{assets}}}, "nodes": []}}"#);
    match f.parse(&chain) {
        Err(SceneError::TooLarge { what: "depth of solids", found: 71, limit: 64, .. }) => {}
        other => panic!("{other:?}"),
    }
    let few = SceneLimits { max_nodes: 10, ..SceneLimits::default() };
    match parse(&chain, "t", &f.root, &f.root, &few) {
        Err(SceneError::TooLarge { what: "operands", found: 140, limit: 10, .. }) => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn splats_say_how_they_are_drawn() {
    let f = Folder::new();
    let with = |splats: &str| format!(r#"{{"assets": {{}}, "nodes": [], "splats": {splats}}}"#);
    assert_eq!(f.parse(&with("{}")).unwrap().splats, Splats::default());
    let text = with(
        r#"{"filter": "exact", "blend": "opaque", "shading": "splat", "prefilter": false,
        "lowpass": 0.25, "cutoff": 1, "width": 3, "depth_offset": 0}"#,
    );
    let expected = Splats {
        filter: Filter::Exact,
        blend: Blend::Opaque,
        shading: Shading::Splat,
        prefilter: false,
        lowpass_px: 0.25,
        cutoff: 1.0,
        width: 3.0,
        depth_offset: 0.0,
    };
    assert_eq!(f.parse(&text).unwrap().splats, expected);
    for (key, low, high) in [
        ("lowpass", 0.1, 4.0),
        ("cutoff", 0.5, 4.0),
        ("width", 0.01, 100.0),
        ("depth_offset", 0.0, 100.0),
    ] {
        for number in [low - 0.001, high + 0.001] {
            let text = with(&format!(r#"{{"{key}": {number}}}"#));
            f.assert_refused(&text, &format!("splats.{key}"), "lies outside");
        }
        for number in [low, high] {
            assert!(f.parse(&with(&format!(r#"{{"{key}": {number}}}"#))).is_ok());
        }
    }
    f.assert_refused(&with(r#"{"filter": "afine"}"#), "splats.filter", "did you mean `affine`?");
    f.assert_refused(&with(r#"{"cut": 1}"#), "splats.cut", "unknown key `cut`");
    f.assert_refused(&with("[]"), "splats", "expected an object");
}

#[test]
fn operands_count_as_what_they_expand_to() {
    let nested = |depth: usize| {
        let mut assets = r#""u0": {"file": "a.ply", "sample": {}}"#.to_owned();
        for level in 1..=depth {
            let below = level - 1;
            let twice = format!(
                r#"[{{"asset": "u{below}"}}, {{"asset": "u{below}", "translate": [1, 0, 0]}}]"#
            );
            assets += &format!(r#", "u{level}": {{"union": {twice}}}"#);
        }
        format!(r#"{{"assets": {{{assets}}}, "nodes": [{{"asset": "u{depth}"}}]}}"#)
    };
    let folder = Folder::new();
    // 2¹² is as many as there may be.
    assert!(folder.parse(&nested(12)).is_ok());
    folder.assert_refused(&nested(13), "assets.u13", "expands to 8192 operands");
    folder.assert_refused(&nested(40), "assets.u13", "at most 4096");
}
