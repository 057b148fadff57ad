//! Lengths, ranges and patterns of everything that a client may send, from the constants that the handlers enforce.

use serde_json::{Value, json};

use super::tidy::{each_object, remove_property};
use crate::accuracy::service::{MOST_CAMERAS, MOST_REPEATS};
use crate::encode::{self, ImageFormat};
use crate::engine::pick::MOST_PIXELS;
use crate::film::shots::{FPS_RANGE, MOST_FRAMES};
use crate::film::video::KBPS_RANGE;
use crate::http::jobs::create as job;
use crate::http::names::{FILE_NAME_PATTERN, ID_PATTERN, MAX_FILE_NAME_BYTES};
use crate::http::{compare, frames, mjpeg, params, pick, stream, upload};
use crate::math::{FARTHEST, FOV_RANGE_DEG, ORTHO_HEIGHT_RANGE};
use crate::plan::{self, Given, Output, SettingKind};
use crate::residency::layout::MOST_ROWS;
use crate::scene::{LARGEST_COORDINATE, LARGEST_SCALE};

/// Schema of the format names that a request may use: those of answers, and `jpg`.
const WANTED_FORMAT: &str = "#/components/schemas/WantedFormat";
const JPG: &str = "jpg";

/// Number of numbers in a property of this name, in requests and answers alike.
const LENGTHS: [(&str, usize); 13] = [
    ("eye", 3),
    ("target", 3),
    ("up", 3),
    ("translate", 3),
    ("rotate", 3),
    ("quaternion", 4),
    ("view", 16),
    ("proj", 16),
    ("matrix", 16),
    ("depth_range", 2),
    ("position", 3),
    ("normal", 3),
    ("shown", 2),
];

/// Returns the entry of [`LENGTHS`] for a name.
pub fn length_of(name: &str) -> Option<(&'static str, usize)> {
    LENGTHS.into_iter().find(|(known, _)| *known == name)
}

/// Returns the bounds of a frame's parameter, in a query and in JSON alike.
fn of_frame(name: &str) -> Option<Value> {
    Some(match name {
        "camera" => json!({ "minLength": 1, "maxLength": params::MAX_NAME_CHARS }),
        "format" => json!({ "$ref": WANTED_FORMAT }),
        "eye" | "target" => json!({ "items": number(-FARTHEST, FARTHEST) }),
        "fov" => {
            let [least, most] = FOV_RANGE_DEG;
            number(least, most)
        }
        "ortho_height" => {
            let [least, most] = ORTHO_HEIGHT_RANGE;
            number(least, most)
        }
        "w" | "h" => json!({ "minimum": 1, "maximum": MOST_ROWS }),
        "quality" => {
            let [least, most] = params::QUALITY_RANGE;
            json!({ "minimum": least, "maximum": most })
        }
        "deadline_ms" => json!({ "exclusiveMinimum": 0, "maximum": params::MAX_DEADLINE_MS }),
        setting => match plan::declared().iter().find(|known| known.name == setting)?.kind {
            SettingKind::Number { least, most, .. } => number(least, most),
            SettingKind::Choice { .. } | SettingKind::Flag | SettingKind::Text { .. } => {
                return None;
            }
        },
    })
}

/// Returns the bounds of an operation's parameter.
pub fn of_parameter(path: &str, place: &str, name: &str) -> Option<Value> {
    if path.ends_with("/mjpeg") && name == "format" {
        return Some(json!({ "$ref": null, "type": "string", "enum": [ImageFormat::Jpeg, JPG] }));
    }
    if path.ends_with("/mjpeg") && name == "output" {
        let outputs = [Output::Color, Output::Depth, Output::Normal, Output::Id];
        let outputs =
            outputs.iter().filter(|output| encode::accepts(ImageFormat::Jpeg, **output).is_ok());
        return Some(
            json!({ "$ref": null, "type": "string", "enum": outputs.collect::<Vec<_>>() }),
        );
    }
    let [least_fps, most_fps] = mjpeg::FPS_RANGE;
    Some(match (place, name) {
        ("path", "id") if path.starts_with("/v1/jobs") => json!({ "pattern": "^[0-9]{1,20}$" }),
        ("path", "id") | ("query", "id") => json!({ "pattern": ID_PATTERN }),
        ("path", "n") => json!({ "minimum": 0, "maximum": MOST_FRAMES }),
        ("path", "file") => json!({ "pattern": "^[a-z0-9-]{1,32}\\.[a-z]{1,4}$" }),
        ("path", _) => json!({ "minLength": 1, "maxLength": params::MAX_NAME_CHARS }),
        ("query", "name") => {
            json!({ "pattern": FILE_NAME_PATTERN, "minLength": 1, "maxLength": MAX_FILE_NAME_BYTES })
        }
        ("query", "path") => json!({ "minLength": 1, "maxLength": params::MAX_NAME_CHARS }),
        ("query", "fps") => json!({ "minimum": least_fps, "maximum": most_fps }),
        ("query", "x" | "y") => json!({ "maximum": MOST_ROWS - 1 }),
        ("query", "from") => json!({ "minimum": 0, "maximum": MOST_FRAMES }),
        ("header", "Idempotency-Key") => {
            // HTTP strips blanks and tabs around a header's value.
            json!({ "pattern": "^[\\t ]*[!-~]([ -~]*[!-~])?[\\t ]*$", "minLength": 1, "maxLength": job::MAX_KEY_BYTES })
        }
        ("query", _) => return of_frame(name),
        _ => return None,
    })
}

/// Returns whether an operation's query refuses a frame's parameter.
pub fn is_refused(path: &str, name: &str) -> bool {
    let without = match path {
        "/v1/scenes/{id}/mjpeg" => mjpeg::NAMES.without,
        "/v1/scenes/{id}/stream" => stream::WITHOUT,
        "/v1/scenes/{id}/pick" => pick::NAMES.without,
        _ => return false,
    };
    without.iter().any(|(refused, _)| *refused == name)
}

/// Adds bounds to the schemas, before flattened schemas take over their properties.
pub fn of_schemas(document: &mut Value) {
    each_object(document, &mut |object| {
        let Some(Value::Object(properties)) = object.get_mut("properties") else { return };
        for (name, property) in properties {
            if let Some((_, length)) = length_of(name)
                && property.get("items").is_some()
            {
                narrow(property, json!({ "minItems": length, "maxItems": length }));
            }
        }
    });
    let schemas = &mut document["components"]["schemas"];
    // Bodies have settings beside the other parameters.
    if let Some(settings) = schemas["Settings"]["properties"].as_object().cloned()
        && let Some(properties) = schemas["FrameParams"]["properties"].as_object_mut()
    {
        properties.extend(settings);
    }
    for name in params::names() {
        if let Some(bounds) = of_frame(name) {
            narrow(&mut schemas["FrameParams"]["properties"][name], bounds);
        }
    }
    let mut formats = schemas["ImageFormat"]["enum"].as_array().cloned().unwrap_or_default();
    formats.push(json!(JPG));
    schemas["WantedFormat"] =
        json!({ "type": "string", "enum": formats, "description": "Encodings; `jpg` is `jpeg`." });
    let format = &mut schemas["FrameParams"]["properties"]["format"];
    let wanted = json!([{ "$ref": WANTED_FORMAT }, { "type": "null" }]);
    narrow(format, json!({ "$ref": null, "oneOf": wanted }));
    for form in schemas["Up"]["oneOf"].as_array_mut().into_iter().flatten() {
        if form["type"] == "array" {
            let numbers = number(-FARTHEST, FARTHEST);
            narrow(form, json!({ "minItems": 3, "maxItems": 3, "items": numbers }));
        }
    }
    let box_of_scene =
        json!({ "minItems": 2, "maxItems": 2, "items": { "minItems": 3, "maxItems": 3 } });
    narrow(&mut schemas["SceneInfo"]["properties"]["bounds"], box_of_scene);
    of_node_changes(schemas);
}

/// Adds the bounds of `PATCH …/nodes/{node}`.
fn of_node_changes(schemas: &mut Value) {
    let most = LARGEST_COORDINATE;
    let factor = json!({ "anyOf": [number(1.0 / LARGEST_SCALE, LARGEST_SCALE), number(-LARGEST_SCALE, -1.0 / LARGEST_SCALE)] });
    let mut uniform = factor.clone();
    uniform["type"] = json!("number");
    schemas["Scale"] = json!({ "oneOf": [
        uniform,
        { "type": "array", "items": { "type": "number", "allOf": [factor] }, "minItems": 3, "maxItems": 3 } ] });
    let change = &mut schemas["NodeChange"];
    change["minProperties"] = json!(1);
    let properties = &mut change["properties"];
    narrow(&mut properties["translate"], json!({ "items": number(-most, most) }));
    narrow(&mut properties["rotate"], json!({ "items": number(-most, most) }));
    narrow(&mut properties["quaternion"], json!({ "items": number(-most, most) }));
    let (axis, place) = (number(-LARGEST_SCALE, LARGEST_SCALE), number(-most, most));
    let rows: Vec<Value> = (0..16)
        .map(|index| match index {
            15 => json!({ "const": 1 }),
            3 | 7 | 11 => json!({ "const": 0 }),
            12..15 => place.clone(),
            _ => axis.clone(),
        })
        .collect();
    narrow(&mut properties["matrix"], json!({ "prefixItems": rows }));
}

/// Adds the bounds of bodies that mix a frame's parameters with their own, after both are merged into one object.
pub fn of_bodies(schemas: &mut Value) {
    let frames = &mut schemas["FramesRequest"]["properties"];
    narrow(&mut frames["poses"], json!({ "minItems": 1, "maxItems": frames::MAX_POSES }));
    let place = json!({ "maximum": MOST_ROWS - 1 });
    let pixels = json!({ "minItems": 2, "maxItems": 2, "items": place });
    for name in ["x", "y"] {
        narrow(&mut schemas["PickRequest"]["properties"][name], place.clone());
    }
    narrow(
        &mut schemas["PickRequest"]["properties"]["pixels"],
        json!({ "minItems": 1, "maxItems": MOST_PIXELS, "items": pixels }),
    );
    for (name, _) in pick::NAMES.without {
        remove_property(&mut schemas["PickRequest"], name);
    }
    for (name, _) in stream::WITHOUT {
        remove_property(&mut schemas["StreamPose"], name);
    }
    of_comparisons(schemas);
    let accuracy = &mut schemas["AccuracyRequest"]["properties"];
    for side in ["w", "h"] {
        narrow(&mut accuracy[side], json!({ "minimum": 1, "maximum": MOST_ROWS }));
    }
    narrow(&mut accuracy["repeats"], json!({ "minimum": 1, "maximum": MOST_REPEATS }));
    let name = json!({ "minLength": 1, "maxLength": params::MAX_NAME_CHARS });
    narrow(
        &mut accuracy["cameras"],
        json!({ "minItems": 1, "maxItems": MOST_CAMERAS, "items": name }),
    );
    let state = "The path's name in the scene, or the path itself. A list shows only the number of `keys` of such a path.";
    schemas["JobState"]["properties"]["path"] = json!({ "description": state, "oneOf": [
        { "type": "string" }, { "type": "object" } ] });
    let request = &mut schemas["JobRequest"];
    for (name, _) in job::NOT_HERE {
        remove_property(request, name);
    }
    let properties = &mut request["properties"];
    let [least_fps, most_fps] = FPS_RANGE;
    let [least_kbps, most_kbps] = KBPS_RANGE;
    narrow(&mut properties["scene"], json!({ "pattern": ID_PATTERN }));
    properties["path"] = path_of_job("Name of a path in the scene, or the content of a path file.");
    narrow(&mut properties["fps"], number(least_fps, most_fps));
    narrow(&mut properties["from"], json!({ "minimum": 0, "maximum": MOST_FRAMES }));
    narrow(&mut properties["to"], json!({ "minimum": 0, "maximum": MOST_FRAMES }));
    narrow(&mut properties["want"], json!({ "minItems": 1, "maxItems": job::MAX_WANTED }));
    narrow(&mut properties["bitrate_kbps"], json!({ "minimum": least_kbps, "maximum": most_kbps }));
}

/// Adds the bounds of comparisons: each side has settings alone.
fn of_comparisons(schemas: &mut Value) {
    for (name, _) in compare::NAMES.without {
        remove_property(&mut schemas["CompareRequest"], name);
    }
    let known = schemas["FrameParams"]["properties"].clone();
    let settings: serde_json::Map<String, Value> =
        Given::NAMES.iter().map(|name| ((*name).to_owned(), known[name].clone())).collect();
    let mut formats: Vec<Value> = compare::FORMATS.iter().map(|format| json!(format)).collect();
    formats.push(json!(JPG));
    let properties = &mut schemas["CompareRequest"]["properties"];
    let format = json!([{ "type": "string", "enum": formats }, { "type": "null" }]);
    narrow(&mut properties["format"], json!({ "oneOf": format }));
    for side in ["a", "b"] {
        refer(&mut properties[side], "#/components/schemas/ComparedSettings");
    }
    schemas["ComparedSettings"] = json!({
        "type": "object", "description": "Settings of one side of a comparison.", "properties": settings,
        "additionalProperties": false,
    });
}

/// Replaces the reference in a schema, or in one of its alternatives.
fn refer(schema: &mut Value, target: &str) {
    if let Some(reference) = schema.get_mut("$ref") {
        *reference = json!(target);
    }
    for other in schema.get_mut("oneOf").and_then(Value::as_array_mut).into_iter().flatten() {
        refer(other, target);
    }
}

/// Schema of a job's path: a name, or the path itself.
fn path_of_job(description: &str) -> Value {
    json!({ "description": description, "oneOf": [
        { "type": "string", "minLength": 1, "maxLength": params::MAX_NAME_CHARS },
        { "$ref": "#/components/schemas/PathFile" } ] })
}

/// Adds the upload's body for each media type.
pub fn of_uploads(document: &mut Value) {
    let content = &mut document["paths"]["/v1/scenes"]["post"]["requestBody"]["content"];
    content["application/json"]["schema"] = json!({ "$ref": "#/components/schemas/SceneFile" });
    content["multipart/form-data"]["schema"] = json!({
        "type": "object",
        "description": "Files with their names, and the scene's JSON in the field `scene`.",
        "minProperties": 1,
        "properties": { "scene": { "type": "string" } },
        "additionalProperties": { "oneOf": [
            { "type": "string", "format": "binary" },
            { "type": "array", "items": { "type": "string", "format": "binary" }, "minItems": 1, "maxItems": upload::MAX_FILES } ] } });
}

/// Adds keywords to a schema; `items` extends the schema of the items. A `null` removes a keyword.
pub fn narrow(schema: &mut Value, keywords: Value) {
    let Value::Object(keywords) = keywords else { return };
    for (keyword, value) in keywords {
        match (keyword.as_str(), &value) {
            // The removed value is not needed.
            (_, Value::Null) => drop(schema.as_object_mut().map(|schema| schema.remove(&keyword))),
            ("items", Value::Object(_)) => narrow(&mut schema["items"], value),
            _ => schema[keyword] = value,
        }
    }
}

fn number(least: f64, most: f64) -> Value {
    json!({ "minimum": least, "maximum": most })
}
