//! Frames: pixels, receipts, entity tags, formats, many poses at once, moved nodes.

use serde_json::{Value, json};

use super::client::Reply;
use super::daemon::Daemon;

const FRAME: &str = "/v1/scenes/grid/frame?camera=front&w=96&h=64";

/// Decodes an image to 8-bit pixels, and returns its size with them.
fn decode(reply: &Reply) -> (image::RgbaImage, (u32, u32)) {
    assert_eq!(reply.status, 200, "{}", reply.text());
    let image = image::load_from_memory(&reply.body).unwrap().to_rgba8();
    let size = image.dimensions();
    (image, size)
}

#[test]
fn a_frame_of_nothing_warns() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let seen = client.get(FRAME);
    assert_eq!(seen.header("pointillist-warning"), None);
    assert_eq!(seen.receipt()["nothing_visible"], Value::Null);
    let behind = client.get("/v1/scenes/grid/frame?eye=0,0,3&target=0,0,9&w=96&h=64");
    assert_eq!(behind.status, 200);
    let warning = behind.header("pointillist-warning").unwrap();
    assert!(
        warning.starts_with("nothing is visible: the scene lies behind the camera"),
        "{warning}"
    );
    let why = behind.receipt()["nothing_visible"].clone();
    assert!(warning.ends_with(why.as_str().unwrap()), "{why}");
    let far = client.get("/v1/scenes/grid/frame?eye=0,0,3000&target=0,0,0&w=192&h=128");
    let drawn = far.receipt()["samples"]["drawn"].as_u64().unwrap();
    assert!((1..20).contains(&drawn), "{drawn}");
    let warning = far.header("pointillist-warning").unwrap();
    assert!(warning.starts_with("hardly anything is visible"), "{warning}");
}

#[test]
fn a_frame_and_its_receipt() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let reply = client.get(FRAME);
    let (image, size) = decode(&reply);
    assert_eq!(size, (96, 64));
    let background = *image.get_pixel(0, 0);
    let covered = image.pixels().filter(|pixel| **pixel != background).count();
    assert!(covered > 500, "only {covered} pixels show the wall");

    assert_eq!(reply.header("content-type"), Some("image/png"));
    assert_eq!(reply.header("cache-control"), Some("no-cache"));
    assert_eq!(reply.header("vary"), Some("accept"));
    let receipt = reply.receipt();
    assert_eq!(receipt["scene"], "grid");
    assert_eq!(
        (&receipt["camera"]["width"], &receipt["camera"]["height"]),
        (&json!(96), &json!(64))
    );
    assert_eq!(receipt["camera"]["eye"], json!([0.0, 0.0, 3.0]));
    assert_eq!(receipt["bytes"], reply.body.len());
    let passes = receipt["passes"].as_array().unwrap();
    assert!(passes.iter().any(|pass| pass["ran"] == true));
    assert!(passes.iter().all(|pass| pass["ran"] == true || pass["why"].is_string()), "{passes:?}");
    let mut effects = receipt["specialisations"].as_array().unwrap().iter();
    let fog = effects.find(|effect| effect["name"] == "fog").unwrap();
    assert_eq!(fog, &json!({ "name": "fog", "ran": false, "why": "the scene has no fog" }));

    let timing = reply.header("server-timing").unwrap();
    for name in ["queue", "batch", "readback", "encode", "total"] {
        assert!(timing.split(", ").any(|e| e.starts_with(&format!("{name};dur="))), "{timing}");
    }
    for pass in passes.iter().filter(|pass| pass["gpu_ns"].is_u64()) {
        let name = pass["name"].as_str().unwrap();
        assert!(timing.contains(&format!("{name};dur=")), "{name} is not in {timing}");
    }
    let again = client.get(FRAME);
    assert_eq!(again.body, reply.body, "the same request twice gives the same bytes");
    assert_eq!(again.header("etag"), reply.header("etag"));
}

#[test]
fn entity_tags_cost_no_rendering() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let head = client.send("HEAD", FRAME, &[], None);
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert_eq!(head.header("content-type"), Some("image/png"));
    assert_ne!(head.header("content-length"), Some("0"));
    let etag = head.header("etag").expect("an entity tag").to_owned();
    assert!(etag.starts_with('"') && etag.ends_with('"'));
    for tags in [etag.clone(), format!("W/{etag}"), format!("\"x\", {etag}"), "*".to_owned()] {
        let reply = client.send("GET", FRAME, &[("if-none-match", &tags)], None);
        assert_eq!((reply.status, reply.body.len()), (304, 0), "{tags}");
        assert_eq!(reply.header("etag"), Some(etag.as_str()));
    }
    assert_eq!(client.metric("pointillist_engine_frames_total"), 0.0, "nothing was rendered");
    assert_eq!(client.metric("pointillist_not_modified_total"), 4.0);

    let reply = client.send("GET", FRAME, &[("if-none-match", "\"x\"")], None);
    assert_eq!((reply.status, reply.header("etag")), (200, Some(etag.as_str())));
    for other in ["w=97&h=64&camera=front", "w=96&h=64&camera=front&format=webp", "w=96&h=64"] {
        let path = format!("/v1/scenes/grid/frame?{other}");
        let reply = client.send("HEAD", &path, &[], None);
        assert_ne!(reply.header("etag"), Some(etag.as_str()), "{other}");
    }
    // The deadline does not change the entity tag.
    let reply = client.send("HEAD", &format!("{FRAME}&deadline_ms=5000"), &[], None);
    assert_eq!(reply.header("etag"), Some(etag.as_str()));
}

#[test]
fn formats_and_outputs() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let accepted = |accept: &str| client.send("GET", FRAME, &[("accept", accept)], None);
    assert_eq!(accepted("image/jpeg").header("content-type"), Some("image/jpeg"));
    assert_eq!(accepted("image/webp,*/*;q=0.1").header("content-type"), Some("image/webp"));
    assert_eq!(accepted("*/*").header("content-type"), Some("image/png"));
    for (format, media_type) in [
        ("png", "image/png"),
        ("jpeg", "image/jpeg"),
        ("webp", "image/webp"),
        ("qoi", "image/qoi"),
        ("exr", "image/x-exr"),
        ("raw", "application/octet-stream"),
    ] {
        let path = format!("{FRAME}&format={format}");
        let reply = client.get(&path);
        assert_eq!((reply.status, reply.header("content-type")), (200, Some(media_type)));
        assert_eq!(reply.header("vary"), None, "{format} was asked for by name");
        let head = client.send("HEAD", &path, &[], None);
        assert_eq!(head.header("content-type"), Some(media_type));
    }
    let depth = client.get(&format!("{FRAME}&output=depth&format=raw"));
    assert_eq!(depth.body.len(), 96 * 64 * 4);
    let depths: Vec<f32> =
        depth.body.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let near = depths.iter().copied().fold(f32::INFINITY, f32::min);
    assert!((near - 3.0).abs() < 1e-3, "the wall is 3 away, not {near}");
    let id = client.get(&format!("{FRAME}&output=id&format=raw"));
    assert!(id.body.chunks_exact(4).any(|b| b == [1, 0, 0, 0]));
    assert_eq!(client.get(&format!("{FRAME}&output=normal")).status, 200);
}

#[test]
fn poses_in_three_notations_agree() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let f = 1.0 / 22.5f64.to_radians().tan();
    let get = |pose: &str| {
        let reply = client.get(&format!("/v1/scenes/grid/frame?{pose}&w=64&h=64&format=raw"));
        assert_eq!(reply.status, 200, "{pose}: {}", reply.text());
        reply.body
    };
    let named = get("camera=front");
    assert_eq!(get("eye=0,0,3&target=0,0,0&up=0,1,0&fov=45"), named);
    let matrices = format!(
        "view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,-3,1&proj={f},0,0,0,0,{f},0,0,0,0,-1,-1,0,0,-0.2,0"
    );
    let differing = get(&matrices).iter().zip(&named).filter(|(a, b)| a != b).count();
    assert!(differing < 64, "{differing} bytes differ");
    get("fov=45&eye=1,0,3&target=0,0,0");
    // Parallel rays: by height, by matrices, and as the camera sees its target.
    let height = 2.0 * 3.0 * 22.5f64.to_radians().tan();
    let flat = get(&format!("eye=0,0,3&target=0,0,0&up=0,1,0&ortho_height={height}"));
    assert_ne!(flat, named);
    assert_eq!(get("camera=front&projection=orthographic"), flat);
    let f = 2.0 / height;
    let matrices = format!(
        "view=1,0,0,0,0,1,0,0,0,0,1,0,0,0,-3,1&proj={f},0,0,0,0,{f},0,0,0,0,-0.1,0,0,0,-1,1"
    );
    let differing = get(&matrices).iter().zip(&flat).filter(|(a, b)| a != b).count();
    assert!(differing < 64, "{differing} bytes differ");
    let body = json!({ "w": 64, "h": 64, "format": "raw",
        "fov": 45, "poses": [{ "eye": [0, 0, 3], "target": [0, 0, 0], "up": [0, 1, 0], "ortho_height": height }] });
    let reply = client.post_json("/v1/scenes/grid/frames", &body);
    assert_eq!(
        (reply.status, &parts(&reply)[0].3),
        (200, &flat),
        "a height replaces the field of view"
    );
    let receipt = parts(&reply)[0].2.clone().unwrap();
    assert!((receipt["camera"]["ortho_height"].as_f64().unwrap() - height).abs() < 1e-9);
    assert_eq!(receipt["camera"].get("fov_deg"), None);
    assert_eq!(receipt["settings"]["projection"], "orthographic");
}

/// Splits a multipart answer into content type, pose index, receipt and content of each part.
pub fn parts(reply: &Reply) -> Vec<(String, u64, Option<Value>, Vec<u8>)> {
    let content_type = reply.header("content-type").unwrap();
    let boundary = content_type.strip_prefix("multipart/mixed; boundary=").unwrap();
    let mut rest = &reply.body[..];
    let mut found = Vec::new();
    let delimiter = format!("\r\n--{boundary}");
    loop {
        rest = rest.strip_prefix(delimiter.as_bytes()).expect("a delimiter");
        if rest == b"--\r\n" {
            return found;
        }
        let end = rest.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = std::str::from_utf8(&rest[2..end]).unwrap();
        let header = |name: &str| {
            head.lines().filter_map(|line| line.split_once(": ")).find_map(|(known, value)| {
                known.eq_ignore_ascii_case(name).then(|| value.to_owned())
            })
        };
        let length: usize = header("content-length").unwrap().parse().unwrap();
        let content = rest[end + 4..end + 4 + length].to_vec();
        rest = &rest[end + 4 + length..];
        let receipt =
            header("pointillist-receipt").map(|text| serde_json::from_str(&text).unwrap());
        let index = header("pointillist-pose").unwrap().parse().unwrap();
        found.push((header("content-type").unwrap(), index, receipt, content));
    }
}

#[test]
fn many_poses_in_one_answer() {
    let daemon = Daemon::start(&["--queue", "4", "--max-batch", "2"]);
    let client = daemon.client();
    let mut poses: Vec<Value> =
        (0..20).map(|i| json!({"eye": [0.1 * f64::from(i), 0, 3], "target": [0, 0, 0]})).collect();
    poses[3] = json!({"eye": [0, 0, 0], "target": [0, 0, 0]});
    poses[5] = json!({"camera": "nobody"});
    poses[7] = json!({"camera": "front", "format": "jpeg", "w": 32});
    poses[9] = json!({"filter": "exact", "reconstruct": "points"});
    let request = json!({"poses": poses, "w": 48, "h": 40, "format": "png"});
    let reply = client.post_json("/v1/scenes/grid/frames", &request);
    assert_eq!(reply.status, 200, "{}", reply.text());
    let parts = parts(&reply);
    assert_eq!(parts.len(), 20);
    for (i, (content_type, index, receipt, content)) in parts.iter().enumerate() {
        assert_eq!(*index, i as u64);
        if [3, 5, 9].contains(&i) {
            assert_eq!(content_type, "application/problem+json", "{i}");
            let problem: Value = serde_json::from_slice(content).unwrap();
            assert_eq!(problem["status"], 422, "{problem}");
            continue;
        }
        let size = if i == 7 { (32, 40) } else { (48, 40) };
        let expected = if i == 7 { "image/jpeg" } else { "image/png" };
        assert_eq!(content_type, expected, "{i}: {}", String::from_utf8_lossy(content));
        let image = image::load_from_memory(content).unwrap();
        assert_eq!((image.width(), image.height()), size);
        let receipt = receipt.as_ref().expect("a receipt");
        assert_eq!(receipt["camera"]["width"], size.0);
        if i != 7 {
            let x = receipt["camera"]["eye"][0].as_f64().unwrap();
            assert!((x - 0.1 * i as f64).abs() < 1e-9, "{x}");
        }
    }
    let single = client.get("/v1/scenes/grid/frame?eye=0,0,3&target=0,0,0&w=48&h=40");
    assert_eq!(parts[0].3, single.body, "alone or in a series, a pose gives the same image");
}

/// A value that no frame can have is reported before the first part, with its place.
#[test]
fn poses_that_break_the_contract_refuse_the_request() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    for (pose, place) in [
        (json!({"eye": [0, 0], "target": [0, 0, 0]}), "poses[1].eye"),
        (json!({"camera": "front", "blend": "max"}), "poses[1].blend"),
        (json!({"camera": "front", "w": 0}), "poses[1].w"),
        (json!({"camera": "front", "speed": 0}), "poses[1].speed"),
    ] {
        let reply = client.post_json("/v1/scenes/grid/frames", &json!({"poses": [{}, pose]}));
        assert_eq!(reply.status, 422, "{}", reply.text());
        assert_eq!(reply.problem()["parameter"], place);
    }
}

#[test]
fn a_node_is_moved_and_hidden() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let before = client.get(FRAME);
    let patch = |body: Value| {
        let json = [("content-type", "application/json")];
        client.send("PATCH", "/v1/scenes/grid/nodes/wall", &json, Some(body.to_string().as_bytes()))
    };
    let revision = client.get("/v1/scenes/grid").json()["revision"].as_u64().unwrap();
    let reply = patch(json!({"visible": false}));
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert!(reply.json()["revision"].as_u64().unwrap() > revision);
    let hidden = client.get(FRAME);
    assert_ne!(hidden.header("etag"), before.header("etag"));
    let (image, _) = decode(&hidden);
    let background = *image.get_pixel(0, 0);
    assert!(image.pixels().all(|pixel| *pixel == background));

    assert_eq!(patch(json!({"visible": true, "translate": [0.5, 0, 0]})).status, 200);
    let moved = client.get(FRAME);
    assert_ne!((&moved.body, moved.header("etag")), (&before.body, before.header("etag")));
    assert_eq!(patch(json!({"translate": [0, 0, 0]})).status, 200);
    assert_eq!(client.get(FRAME).body, before.body);
}

/// Adds a second scene of the same wall, with settings for splats in the scene file.
fn with_splats(root: &std::path::Path) {
    let mut scene = super::daemon::grid_scene("grid.ply");
    scene["name"] = json!("opaque");
    scene["splats"] = json!({ "filter": "exact", "prefilter": false, "blend": "opaque", "shading": "splat", "cutoff": 2.5 });
    std::fs::write(root.join("opaque.json"), scene.to_string()).unwrap();
}

fn splats_of(scene: &str, settings: &str) -> String {
    format!("/v1/scenes/{scene}/frame?camera=front&w=96&h=64&reconstruct=splats{settings}")
}

#[test]
fn splats_and_their_receipt() {
    let daemon = Daemon::start_in(with_splats, &[]);
    let client = daemon.client();
    let points = client.get(&format!("{FRAME}&reconstruct=points"));
    assert_eq!(
        points.receipt()["settings"],
        json!({"antialias": "off", "edl": "off", "lod": "full", "projection": "perspective", "color_by": "colors", "reconstruct": "points",
            "exposure": 0.0, "tone_map": "none", "point_size": 0.0, "point_size_px": 1.0})
    );
    assert_eq!(points.receipt()["splats"]["scattered"], Value::Null);

    let splats = client.get(&splats_of("grid", ""));
    let (image, _) = decode(&splats);
    assert_ne!(splats.body, points.body);
    let background = *image.get_pixel(0, 0);
    let covered = image.pixels().filter(|pixel| **pixel != background).count();
    assert!(covered > 2000, "only {covered} pixels show the wall, which splats close");
    let receipt = splats.receipt();
    let defaults = json!({"antialias": "off", "edl": "off", "exposure": 0.0, "tone_map": "none", "lod": "full", "projection": "perspective", "color_by": "colors", "reconstruct": "splats", "filter": "perspective", "prefilter": true,
        "blend": "weighted", "shading": "deferred", "lowpass_px": 0.5, "cutoff": 2.0, "width": 1.0, "depth_offset": 1.0});
    assert_eq!(receipt["settings"], defaults);
    let drawn = |key: &str| receipt["splats"][key].as_u64().unwrap();
    assert_eq!(drawn("scattered") + drawn("rasterised"), 64 * 64, "{receipt}");
    assert_eq!(drawn("clipped"), 0);
    let ran = |name: &str| {
        let passes = receipt["passes"].as_array().unwrap();
        passes.iter().find(|pass| pass["name"] == name).unwrap()["ran"] == true
    };
    assert!(ran("project_splats") && ran("blend_splats") && ran("resolve_splats"));
    assert!(!ran("project_samples") && !ran("resolve_samples"));

    let asked = "&filter=affine&prefilter=false&blend=opaque&shading=splat";
    let settings = &client.get(&splats_of("grid", asked)).receipt()["settings"];
    assert_eq!(
        [&settings["filter"], &settings["prefilter"], &settings["blend"], &settings["shading"]],
        [&json!("affine"), &json!(false), &json!("opaque"), &Value::Null],
        "opaque splats are not lit in two ways"
    );
    let settings = &client.get(&splats_of("opaque", "&prefilter=true")).receipt()["settings"];
    assert_eq!(
        [&settings["filter"], &settings["prefilter"], &settings["blend"], &settings["cutoff"]],
        [&json!("exact"), &json!(true), &json!("opaque"), &json!(2.5)],
        "what is left out is as the scene has it"
    );

    let fuzzy = FRAME.to_owned() + "&reconstruct=fuzzy";
    let receipt = client.get(&fuzzy).receipt();
    let expected = json!({"antialias": "off", "edl": "off", "exposure": 0.0, "tone_map": "none", "lod": "full", "projection": "perspective", "color_by": "colors", "reconstruct": "fuzzy", "filter": "perspective", "prefilter": true,
        "lowpass_px": 0.5, "cutoff": 2.0, "width": 1.0, "depth_offset": 1.0});
    assert_eq!(receipt["settings"], expected);
    assert_eq!(receipt["splats"]["scattered"], 64 * 64);
    let settings = &client.get(&(fuzzy + "&output=normal")).receipt()["settings"];
    assert_eq!(settings["reconstruct"], "splats");
    assert_eq!(settings["instead_because"], "fuzzy and painted splats have nothing but colours");
}

/// At 128 rows the wall's samples are 1.6 px apart, and at a quarter of the rows a quarter of that.
#[test]
fn what_is_not_said_is_drawn_as_fits() {
    let daemon = Daemon::start_in(with_splats, &[]);
    let client = daemon.client();
    let frame = |query: &str| client.get(&format!("/v1/scenes/grid/frame?camera=front{query}"));
    for (size, drawn) in [("&w=192&h=128", "splats"), ("&w=48&h=32", "points")] {
        let auto = frame(size);
        let settings = &auto.receipt()["settings"];
        assert_eq!((&settings["asked"], &settings["reconstruct"]), (&"auto".into(), &drawn.into()));
        let px = settings["spacing_px"].as_f64().unwrap();
        assert_eq!(px > 0.6, drawn == "splats", "{settings}");
        let because = settings["because"].as_str().unwrap();
        let (begin, end) = ("samples lie up to ", " px apart in 90 % of what they cover");
        let told: f64 =
            because.strip_prefix(begin).unwrap().strip_suffix(end).unwrap().parse().unwrap();
        assert!((told / px - 1.0).abs() < 0.05, "{settings}");
        // An explicit setting gives an equal frame, but another receipt.
        let named = frame(&format!("{size}&reconstruct={drawn}"));
        assert_eq!(named.body, auto.body);
        assert_eq!(named.receipt()["settings"].get("asked"), None);
        assert_ne!(named.header("etag"), auto.header("etag"));
        assert_eq!(frame(&format!("{size}&reconstruct=auto")).header("etag"), auto.header("etag"));
        let trees = frame(&format!("{size}&lod=spt&color_by=levels"));
        assert_eq!(trees.receipt()["settings"]["reconstruct"], drawn);
    }
    // Settings of splats apply only where splats are drawn.
    let opaque =
        |size: &str| frame(&format!("{size}&blend=opaque")).receipt()["settings"]["blend"].clone();
    assert_eq!((opaque("&w=192&h=128"), opaque("&w=48&h=32")), ("opaque".into(), Value::Null));
    // Larger accepted errors leave gaps between nodes that are drawn as points.
    let coarse = frame("&w=48&h=32&lod=spt&max_error_px=4&color_by=levels").receipt();
    assert_eq!(coarse["settings"]["reconstruct"], "splats");
}

#[test]
fn entity_tags_of_splats_follow_what_is_drawn() {
    let daemon = Daemon::start_in(with_splats, &[]);
    let client = daemon.client();
    let tag = |scene: &str, settings: &str| {
        let reply = client.send("HEAD", &splats_of(scene, settings), &[], None);
        assert_eq!(reply.status, 200, "{scene} {settings}");
        reply.header("etag").unwrap().to_owned()
    };
    let plain = client.send("HEAD", FRAME, &[], None);
    let spelt_out = client.send("HEAD", &format!("{FRAME}&reconstruct=auto"), &[], None);
    assert_eq!(plain.header("etag"), spelt_out.header("etag"));
    for (scene, same, other, tags_in_all) in [
        (
            "grid",
            ["&filter=perspective", "&prefilter=true", "&blend=weighted", "&shading=deferred"],
            ["&filter=affine", "&prefilter=false", "&blend=opaque", "&shading=splat"],
            5,
        ),
        (
            "opaque",
            ["&filter=exact", "&prefilter=false", "&blend=opaque", "&shading=splat"],
            ["&filter=perspective", "&prefilter=true", "&blend=weighted", "&shading=deferred"],
            // Opaque splats are lit in one way.
            4,
        ),
    ] {
        let plain = tag(scene, "");
        assert_ne!(spelt_out.header("etag"), Some(plain.as_str()));
        assert_eq!(tag(scene, &same.concat()), plain, "{scene}");
        let mut tags: Vec<String> = other.iter().map(|settings| tag(scene, settings)).collect();
        tags.push(plain.clone());
        for setting in same {
            assert_eq!(tag(scene, setting), plain, "{scene} {setting}");
        }
        tags.sort_unstable();
        tags.dedup();
        assert_eq!(tags.len(), tags_in_all, "{scene}: each setting has a tag of its own");
    }
}

#[test]
fn poses_of_a_series_inherit_how_splats_are_drawn() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let pose = json!({"camera": "front"});
    let own =
        json!({"camera": "front", "filter": "exact", "prefilter": true, "shading": "deferred"});
    let points = json!({"camera": "front", "reconstruct": "points"});
    let both = json!({"camera": "front", "reconstruct": "points", "blend": "opaque"});
    let request = json!({"poses": [pose, own, points, both], "w": 96, "h": 64, "reconstruct": "splats",
        "filter": "affine", "prefilter": false, "blend": "opaque", "shading": "splat"});
    let reply = client.post_json("/v1/scenes/grid/frames", &request);
    assert_eq!(reply.status, 200, "{}", reply.text());
    let parts = parts(&reply);
    for (part, query) in [
        (0, "&filter=affine&prefilter=false&blend=opaque&shading=splat"),
        (1, "&filter=exact&prefilter=true&blend=opaque&shading=deferred"),
    ] {
        let alone = client.get(&splats_of("grid", query));
        assert_eq!(parts[part].2.as_ref().unwrap()["settings"], alone.receipt()["settings"]);
        assert_eq!(parts[part].3, alone.body, "{query}");
    }
    let points = client.get(&format!("{FRAME}&reconstruct=points"));
    assert_eq!(parts[2].3, points.body, "points have none of it");
    let problem: Value = serde_json::from_slice(&parts[3].3).unwrap();
    assert_eq!(problem["status"], 422, "{problem}");
    assert!(problem["parameter"].as_str().unwrap().ends_with("blend"), "{problem}");
}

#[test]
fn level_of_detail_and_its_receipt() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    // The first frame waits until the trees are built. So few samples are drawn from trees only to show the levels.
    const LEVELS: &str = "&lod=spt&color_by=levels";
    let reply = client.get(&format!("{FRAME}{LEVELS}&max_error_px=24&reconstruct=points"));
    let (image, _) = decode(&reply);
    let receipt = reply.receipt();
    assert_eq!(receipt["settings"]["lod"], "spt");
    assert_eq!(receipt["max_error_px"], 24.0);
    let samples = &receipt["samples"];
    let count = |name: &str| samples[name].as_u64().unwrap_or_else(|| panic!("{name}: {samples}"));
    assert!(count("stored") >= count("tested") && count("tested") >= count("accepted"));
    assert!(count("drawn") > 500, "discs cover more pixels than there are nodes: {samples}");
    let passes = receipt["passes"].as_array().unwrap();
    let ran = |name: &str| passes.iter().any(|pass| pass["name"] == name && pass["ran"] == true);
    for pass in ["cull_groups", "list_groups", "select_chunks", "list_entries"] {
        assert!(ran(pass), "{pass}");
    }
    let background = *image.get_pixel(0, 0);
    assert!(image.pixels().filter(|pixel| **pixel != background).count() > 500);

    // Each level of detail has its own entity tag, and equal ones have equal tags.
    let tag =
        |query: &str| client.get(&format!("{FRAME}{query}")).header("etag").map(str::to_owned);
    let levels = |query: &str| format!("{LEVELS}{query}");
    let queries = [
        String::new(),
        levels("&max_error_px=24"),
        levels("&max_error_px=32"),
        levels(""),
        levels("&max_error_px=24&reconstruct=splats"),
        levels("&max_error_px=24&reconstruct=splats&error_mode=split"),
    ];
    let tags: Vec<_> = queries.iter().map(|query| tag(query)).collect();
    for (index, one) in tags.iter().enumerate() {
        assert!(one.is_some() && !tags[..index].contains(one), "{}", queries[index]);
    }
    assert_eq!(tag(&levels("&max_error_px=1")), tags[3]);
    assert_eq!(tag(&(queries[4].clone() + "&error_mode=unified")), tags[4]);
    // Trees have nothing to leave out: the frame is that of full detail.
    assert_eq!(tag("&lod=spt&max_error_px=24"), tags[0]);
    assert_eq!(tag("&lod=spt&color_by=colors"), tags[0]);
    let fine = client.get(&format!("{FRAME}&lod=spt")).receipt();
    assert_eq!(fine["settings"]["lod"], "full");
    assert!(fine["settings"]["full_because"].as_str().unwrap().contains("drawn sooner"), "{fine}");
    assert_eq!(receipt["settings"]["error_mode"], Value::Null);
    let split = client.get(&format!("{FRAME}{}", queries[5]));
    assert_eq!(split.receipt()["settings"]["error_mode"], "split");
    let full = client.get(FRAME);
    assert_eq!(full.receipt()["max_error_px"], Value::Null);
    assert_eq!(full.receipt()["samples"]["accepted"], Value::Null);
}

#[test]
fn up_and_fov_alone_turn_and_widen_the_default_view() {
    let daemon = Daemon::start(&[]);
    let client = daemon.client();
    let camera = |query: &str| {
        let reply = client.get(&format!("/v1/scenes/grid/frame?w=32&h=32{query}"));
        assert_eq!(reply.status, 200, "{}", reply.text());
        reply.receipt()["camera"].clone()
    };
    let usual = camera("");
    let turned = camera("&up=z");
    assert_eq!(turned["up"], json!([0.0, 0.0, 1.0]));
    assert_ne!(turned["eye"], usual["eye"]);
    assert_eq!(camera("&up=0,0,1"), turned);
    let wide = camera("&fov=80");
    assert_eq!(wide["fov_deg"], json!(80.0));
    assert_eq!(wide["up"], usual["up"]);
    let reply = client.post_json(
        "/v1/scenes/grid/frames",
        &json!({ "w": 32, "h": 32, "up": "-z", "poses": [{}] }),
    );
    assert_eq!(reply.status, 200, "{}", reply.text());
    for (query, parameter) in
        [("up=0,0,0", "up"), ("up=w", "up"), ("fov=180", "fov"), ("fov=0", "fov")]
    {
        let problem = client.get(&format!("/v1/scenes/grid/frame?{query}"));
        assert_eq!(
            (problem.status, problem.json()["parameter"].as_str()),
            (422, Some(parameter)),
            "{query}"
        );
    }
}
