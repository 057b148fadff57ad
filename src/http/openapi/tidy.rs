//! Corrects the generated schemas so that clients and validators can use them.
//!
//! `utoipa` writes a flattened field as `allOf` of the outer and the inner object. Where the inner object refuses unknown
//! properties, that schema refuses every document. `utoipa` also lets query parameters be `null`, and knows neither lengths nor
//! ranges.

use serde_json::{Map, Value, json};

/// The document's schemas by name.
type Schemas = Map<String, Value>;

/// Replaces every `allOf` of objects by one equivalent object.
pub fn flatten(document: &mut Value) {
    let Some(schemas) = document.pointer("/components/schemas").and_then(Value::as_object) else {
        return;
    };
    let known = schemas.clone();
    each_object(document, &mut |object| {
        let Some(Value::Array(parts)) = object.get("allOf") else { return };
        let Some(mut whole) = merged(parts, &known) else { return };
        object.remove("allOf");
        whole.append(object);
        *object = whole;
    });
}

/// Merges `parts` into one object; `None` where a part is no object.
fn merged(parts: &[Value], known: &Schemas) -> Option<Map<String, Value>> {
    let (mut properties, mut required) = (Map::new(), Vec::new());
    let mut is_closed = false;
    for part in parts {
        let (part, is_optional) = match without_null(part) {
            Some(part) => (part, true),
            None => (part.clone(), false),
        };
        let object = resolved(&part, known)?;
        is_closed |= object.get("additionalProperties") == Some(&json!(false));
        let inner = object.get("properties").and_then(Value::as_object);
        properties.extend(inner.into_iter().flatten().map(|(name, of)| (name.clone(), of.clone())));
        if !is_optional {
            required.extend(
                object.get("required").and_then(Value::as_array).into_iter().flatten().cloned(),
            );
        }
    }
    let mut whole = Map::new();
    whole.insert("type".to_owned(), json!("object"));
    whole.insert("properties".to_owned(), Value::Object(properties));
    if !required.is_empty() {
        whole.insert("required".to_owned(), Value::Array(required));
    }
    if is_closed {
        whole.insert("additionalProperties".to_owned(), json!(false));
    }
    Some(whole)
}

/// Returns the object schema that a part of an `allOf` is, or refers to.
fn resolved(part: &Value, known: &Schemas) -> Option<Map<String, Value>> {
    let object = part.as_object()?;
    if let Some(name) = object.get("$ref").and_then(Value::as_str) {
        return resolved(known.get(name.rsplit('/').next()?)?, known);
    }
    if let Some(Value::Array(parts)) = object.get("allOf") {
        return merged(parts, known);
    }
    (object.get("type") == Some(&json!("object"))).then(|| object.clone())
}

/// Returns the other half of a `oneOf` of a schema and `null`.
fn without_null(schema: &Value) -> Option<Value> {
    let variants = schema.get("oneOf")?.as_array()?;
    let (nulls, mut others): (Vec<&Value>, Vec<&Value>) =
        variants.iter().partition(|variant| variant.get("type") == Some(&json!("null")));
    (nulls.len() == 1 && others.len() == 1).then(|| others.remove(0).clone())
}

/// Removes `null` from a parameter of an address or header: it is there or not, never `null`.
pub fn never_null(schema: &mut Value) {
    if let Some(inner) = without_null(schema) {
        *schema = inner;
    }
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|of| of != "null");
        if let [only] = &types[..] {
            let only = only.clone();
            schema["type"] = only;
        }
    }
}

/// Removes a property from an object schema.
pub fn remove_property(schema: &mut Value, name: &str) {
    if let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        properties.remove(name);
    }
}

/// Moves the definitions of a JSON Schema document to `components/schemas` under names with `prefix`, and returns the rest.
pub fn adopt(document: &mut Value, mut schema: Value, prefix: &str) -> Value {
    let mut definitions = Map::new();
    if let Some(object) = schema.as_object_mut() {
        object.remove("$schema");
        if let Some(Value::Object(found)) = object.remove("$defs") {
            definitions = found;
        }
    }
    let rename = |value: &mut Value| {
        each_object(value, &mut |object| {
            if let Some(Value::String(target)) = object.get_mut("$ref")
                && let Some(name) = target.strip_prefix("#/$defs/")
            {
                *target = format!("#/components/schemas/{prefix}{name}");
            }
        });
    };
    rename(&mut schema);
    for (name, mut definition) in definitions {
        rename(&mut definition);
        document["components"]["schemas"][format!("{prefix}{name}")] = definition;
    }
    schema
}

/// Calls `change` with every object, inner objects first.
pub fn each_object(value: &mut Value, change: &mut impl FnMut(&mut Map<String, Value>)) {
    match value {
        Value::Object(object) => {
            object.values_mut().for_each(|value| each_object(value, change));
            change(object);
        }
        Value::Array(items) => items.iter_mut().for_each(|item| each_object(item, change)),
        _ => {}
    }
}

/// Order of keys for readers; other keys follow in alphabetical order.
const ORDER: [&str; 34] = [
    "openapi",
    "info",
    "title",
    "paths",
    "components",
    "name",
    "in",
    "get",
    "post",
    "patch",
    "delete",
    "tags",
    "summary",
    "type",
    "description",
    "operationId",
    "parameters",
    "requestBody",
    "format",
    "enum",
    "required",
    "schema",
    "content",
    "properties",
    "additionalProperties",
    "items",
    "minItems",
    "maxItems",
    "minimum",
    "maximum",
    "exclusiveMinimum",
    "exclusiveMaximum",
    "responses",
    "security",
];

/// Returns the document for YAML, with its keys in the order of [`ORDER`].
pub fn ordered(value: &Value) -> yaml_serde::Value {
    match value {
        Value::Object(object) => {
            let rank =
                |key: &str| ORDER.iter().position(|known| *known == key).unwrap_or(ORDER.len());
            let mut entries: Vec<(&String, &Value)> = object.iter().collect();
            entries.sort_by_key(|(key, _)| (rank(key), (*key).clone()));
            let entries = entries
                .into_iter()
                .map(|(key, value)| (yaml_serde::Value::from(key.as_str()), ordered(value)));
            yaml_serde::Value::Mapping(entries.collect())
        }
        Value::Array(items) => yaml_serde::Value::Sequence(items.iter().map(ordered).collect()),
        Value::String(text) => text.as_str().into(),
        Value::Bool(flag) => (*flag).into(),
        Value::Null => yaml_serde::Value::Null,
        Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
            (Some(number), ..) => number.into(),
            (_, Some(number), _) => number.into(),
            (.., number) => number.unwrap_or_default().into(),
        },
    }
}

/// Rewrites exponents so that YAML 1.1 and 1.2 both read numbers: `1.0e+100` instead of `1e100`.
pub fn plain_numbers(yaml: &str) -> String {
    let mut plain = String::with_capacity(yaml.len());
    for line in yaml.lines() {
        let written = line.rsplit_once(' ').filter(|(before, _)| before.ends_with([':', '-']));
        let (before, number) = written.unwrap_or((line, ""));
        plain.push_str(before);
        if written.is_some() {
            plain.push(' ');
        }
        match number.split_once('e').filter(|_| number.parse::<f64>().is_ok()) {
            Some((digits, exponent)) => {
                let fraction = if digits.contains('.') { "" } else { ".0" };
                let sign = if exponent.starts_with(['-', '+']) { "" } else { "+" };
                plain.extend([digits, fraction, "e", sign, exponent]);
            }
            None => plain.push_str(number),
        }
        plain.push('\n');
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_written_with_a_point_and_a_sign() {
        for (written, plain) in [
            ("a: 1e100", "a: 1.0e+100"),
            ("  - -1.5e-9", "  - -1.5e-9"),
            ("- minimum: 1e-9", "- minimum: 1.0e-9"),
            ("a: 12", "a: 12"),
            ("a: yes: e", "a: yes: e"),
            ("text of 1e5", "text of 1e5"),
            ("a:", "a:"),
        ] {
            assert_eq!(plain_numbers(written), format!("{plain}\n"));
        }
    }

    #[test]
    fn flattened_objects_accept_what_each_part_accepts() {
        let mut document = json!({ "components": { "schemas": {
            "Inner": { "type": "object", "properties": { "a": {} }, "required": ["a"], "additionalProperties": false },
            "Maybe": { "type": "object", "properties": { "c": {} }, "required": ["c"] },
            "Outer": { "description": "x", "allOf": [
                { "$ref": "#/components/schemas/Inner" },
                { "oneOf": [{ "$ref": "#/components/schemas/Maybe" }, { "type": "null" }] },
                { "type": "object", "properties": { "b": {} }, "required": ["b"] } ] } } } });
        flatten(&mut document);
        let whole = json!({ "type": "object", "description": "x", "properties": { "a": {}, "b": {}, "c": {} },
            "required": ["a", "b"], "additionalProperties": false });
        assert_eq!(document["components"]["schemas"]["Outer"], whole);
    }

    #[test]
    fn parameters_are_never_null() {
        for (before, after) in [
            (json!({ "type": ["string", "null"] }), json!({ "type": "string" })),
            (json!({ "oneOf": [{ "type": "null" }, { "$ref": "#/a" }] }), json!({ "$ref": "#/a" })),
            (json!({ "type": "integer" }), json!({ "type": "integer" })),
        ] {
            let mut schema = before;
            never_null(&mut schema);
            assert_eq!(schema, after);
        }
    }

    #[test]
    fn definitions_move_with_those_who_refer_to_them() {
        let mut document = json!({ "components": { "schemas": {} } });
        let schema = json!({ "$schema": "x", "type": "object", "properties": { "n": { "$ref": "#/$defs/Node" } },
            "$defs": { "Node": { "items": { "$ref": "#/$defs/Node" } } } });
        let rest = adopt(&mut document, schema, "File");
        let to = json!({ "$ref": "#/components/schemas/FileNode" });
        assert_eq!(rest, json!({ "type": "object", "properties": { "n": to } }));
        assert_eq!(document["components"]["schemas"]["FileNode"], json!({ "items": to }));
    }
}
