//! The page of the docs that lists every operation of the HTTP API, made of the contract.

use serde_json::Value;

use super::openapi_json;

/// Text of a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

/// Type, range, values and pattern of a parameter.
fn values(schema: &Value) -> String {
    let own = |key: &str| schema.get(key).filter(|value| !value.is_null());
    if let Some(name) = text(schema, "$ref").rsplit('/').next().filter(|name| !name.is_empty()) {
        return format!("`{name}`");
    }
    if let Some(choices) = own("enum").and_then(Value::as_array) {
        let choices = choices.iter().filter_map(Value::as_str);
        return choices.map(|choice| format!("`{choice}`")).collect::<Vec<_>>().join(", ");
    }
    if let Some(Value::Array(any)) = own("oneOf").or(own("anyOf")) {
        return any
            .iter()
            .map(values)
            .filter(|text| text != "null")
            .collect::<Vec<_>>()
            .join(" or ");
    }
    let kind = match own("type") {
        Some(Value::Array(kinds)) => {
            let kinds = kinds.iter().filter_map(Value::as_str).filter(|kind| *kind != "null");
            kinds.collect::<Vec<_>>().join(" or ")
        }
        kind => kind.and_then(Value::as_str).unwrap_or_default().to_owned(),
    };
    let range = match (own("minimum"), own("maximum")) {
        (Some(least), Some(most)) => format!(", {least} to {most}"),
        (Some(least), None) => format!(", {least} or more"),
        (None, Some(most)) => format!(", {most} or less"),
        (None, None) => String::new(),
    };
    let items = own("items").map(|items| format!(" of {}", values(items))).unwrap_or_default();
    format!("{kind}{items}{range}")
}

fn operation(path: &str, method: &str, operation: &Value) -> String {
    let summary = text(operation, "summary");
    let mut page = format!("\n### `{} {path}`\n\n{}\n", method.to_uppercase(), summary);
    if let Some(description) = operation["description"].as_str() {
        page += &format!("\n{description}\n");
    }
    let parameters = operation["parameters"].as_array().map(Vec::as_slice).unwrap_or_default();
    if !parameters.is_empty() {
        page += "\n| parameter | in | values | meaning |\n|---|---|---|---|\n";
    }
    for parameter in parameters {
        let required = if parameter["required"] == true { ", required" } else { "" };
        page += &format!(
            "| `{}` | {}{required} | {} | {} |\n",
            text(parameter, "name"),
            text(parameter, "in"),
            cell(&values(&parameter["schema"])),
            cell(text(parameter, "description")),
        );
    }
    if let Some(body) = operation["requestBody"]["content"].as_object() {
        let kinds: Vec<String> = body.keys().map(|kind| format!("`{kind}`")).collect();
        page += &format!("\nBody: {}.\n", kinds.join(", "));
    }
    if let Some(answers) = operation["responses"].as_object() {
        let codes: Vec<String> = answers.keys().map(|code| format!("`{code}`")).collect();
        page += &format!("\nStatus: {}.\n", codes.join(", "));
    }
    page
}

fn page() -> String {
    let document = openapi_json().unwrap();
    let mut page = String::from(
        "# HTTP operations\n\nEvery operation with its parameters, from [openapi.yaml](../openapi.yaml), which has the schemas of bodies and answers as \
         well. See also [Use the HTTP API](http.md).\n",
    );
    let paths = document["paths"].as_object().unwrap();
    let operations = || {
        paths.iter().flat_map(|(path, methods)| {
            let methods = methods.as_object().unwrap().iter();
            methods.map(move |(method, operation)| (path, method, operation))
        })
    };
    let mut tags: Vec<&str> = Vec::new();
    for (_, _, found) in operations() {
        let tag = found["tags"][0].as_str().unwrap();
        if !tags.contains(&tag) {
            tags.push(tag);
        }
    }
    for tag in tags {
        page += &format!("\n## {tag}\n");
        for (path, method, found) in operations().filter(|(_, _, found)| found["tags"][0] == tag) {
            page += &operation(path, method, found);
        }
    }
    page
}

/// `UPDATE=1` writes the page anew.
#[test]
fn the_docs_list_every_operation() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/operations.md");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&file, page()).unwrap();
    }
    assert_eq!(std::fs::read_to_string(file).unwrap(), page(), "UPDATE=1 writes it anew");
}
