//! Validates bodies, answers and parameters by the contract.

use serde_json::{Value, json};

/// The document as JSON, from the same types as `openapi.yaml`.
pub struct Contract(pub Value);

impl Contract {
    pub fn new() -> Contract {
        Contract(pointillist::http::openapi_json().unwrap())
    }

    /// A validator for a schema, which may refer to any schema of the document.
    fn validator(&self, schema: &Value) -> jsonschema::Validator {
        let whole = json!({ "components": self.0["components"], "allOf": [schema] });
        jsonschema::draft202012::new(&whole).unwrap_or_else(|error| panic!("{error}: {schema}"))
    }

    /// The errors of a value by a schema of the document.
    pub fn faults(&self, schema: &Value, value: &Value) -> Vec<String> {
        let validator = self.validator(schema);
        let faults = validator.iter_errors(value);
        faults.map(|fault| format!("{}: {fault}", fault.instance_path())).collect()
    }

    /// Compiles every schema of the document.
    pub fn compile_all(&self) {
        for (_, _, operation) in self.operations() {
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                self.validator(&parameter["schema"]);
            }
        }
        for schema in self.0["components"]["schemas"].as_object().unwrap().values() {
            self.validator(schema);
        }
    }

    /// A component by its name.
    pub fn component(&self, name: &str) -> &Value {
        let schema = &self.0["components"]["schemas"][name];
        assert!(schema.is_object(), "no schema {name}");
        schema
    }

    /// Path, method and description of all operations.
    pub fn operations(&self) -> impl Iterator<Item = (&str, &str, &Value)> {
        let paths = self.0["paths"].as_object().unwrap();
        paths.iter().flat_map(|(path, item)| {
            let methods = item.as_object().unwrap().iter();
            methods.map(|(method, operation)| (path.as_str(), method.as_str(), operation))
        })
    }

    /// The operation for a request, and its path template in the document.
    pub fn operation(&self, method: &str, path: &str) -> Option<(&str, &Value)> {
        let wanted: Vec<&str> = path.split('/').collect();
        let fits = |template: &str| {
            let parts: Vec<&str> = template.split('/').collect();
            parts.len() == wanted.len()
                && parts
                    .iter()
                    .zip(&wanted)
                    .all(|(part, given)| part == given || part.starts_with('{'))
        };
        let found = |exact: bool| {
            self.operations().find(|(template, of, _)| {
                of.eq_ignore_ascii_case(method)
                    && if exact { *template == path } else { fits(template) }
            })
        };
        found(true).or_else(|| found(false)).map(|(template, _, operation)| (template, operation))
    }

    /// The errors of a query by the parameters of an operation.
    pub fn query_faults(&self, operation: &Value, query: &[(String, String)]) -> Vec<String> {
        let mut faults = Vec::new();
        for (name, text) in query {
            let parameters = operation["parameters"].as_array().into_iter().flatten();
            let mut of_query = parameters.filter(|parameter| parameter["in"] == "query");
            let Some(parameter) = of_query.find(|parameter| parameter["name"] == name.as_str())
            else {
                faults.push(format!("there is no parameter `{name}`"));
                continue;
            };
            let schema = &parameter["schema"];
            let number =
                |text: &str| serde_json::from_str(text).unwrap_or_else(|_| Value::from(text));
            let value = match schema["type"].as_str() {
                Some("array") => Value::Array(text.split(',').map(number).collect()),
                Some("string") | None => Value::from(text.as_str()),
                Some(_) => number(text),
            };
            faults.extend(
                self.faults(schema, &value).into_iter().map(|fault| format!("{name}: {fault}")),
            );
        }
        faults
    }
}
