//! The contract, generated from the handlers and wire types.
//!
//! Handlers document their successes. A table, [`problems`], lists the problems that each operation answers, so the document has every
//! status and its `type`s. [`tidy`] straightens the generator's schemas, and [`bounds`] adds the ranges and lengths that the
//! handlers enforce. `openapi.yaml` at the root of the repository is this document; a test holds the two equal.

mod bounds;
mod problems;
#[cfg(test)]
mod reference;
mod tidy;

use std::collections::BTreeMap;

use serde_json::{Value, json};
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, Ref, RefOr, ResponseBuilder};
use utoipa::{Modify, OpenApi};

use super::access;
use super::problem::{Kind, PROBLEM_JSON, ProblemDocument};
use super::{
    accuracy, compare, frame, frames, jobs, mjpeg, paths, pick, scenes, service, stream, upload,
    viewer,
};
use crate::engine::Receipt;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Pointillist",
        description = "A headless render server: a camera pose goes in, a frame and its receipt come out.\n\n\
            Every failure is `application/problem+json` with a stable `type`. Nothing is silently clamped: \
            what cannot be used is refused, with what would be accepted.\n\n\
            An address that is not in this document is answered with 404 (`urn:pointillist:problem:unknown-route`), \
            a method that an address does not take with 405 (`urn:pointillist:problem:method-not-allowed`) and the header `Allow`. \
            Over HTTP/2, a head that is too large is answered with 431 without a body.\n\n\
            Some parameters exclude or need each other, as their descriptions say; a request that breaks such a rule is answered \
            with 422, although each parameter by itself is as its schema says.\n\n\
            Every answer has `X-Request-Id`: the request's own, if that is 1 to 128 letters, digits and `-_.:/+=@~`, or a new one. \
            Receipts and problems repeat it as `request_id`, and with `POINTILLIST_LOG=pointillist=debug` the log tells a frame's \
            whole way by it.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    paths(
        frame::frame,
        frames::frames,
        compare::compare,
        pick::pick,
        pick::pick_many,
        stream::stream,
        mjpeg::mjpeg,
        scenes::list,
        upload::create,
        upload::retry,
        scenes::show,
        scenes::remove,
        scenes::patch_node,
        accuracy::show,
        accuracy::begin,
        accuracy::cancel,
        accuracy::remove,
        paths::show,
        jobs::list,
        jobs::create::create,
        jobs::show,
        jobs::remove,
        jobs::cancel,
        jobs::resume,
        jobs::events::events,
        jobs::frames::manifest,
        jobs::frames::frame,
        jobs::frames::multipart,
        jobs::video::video,
        service::limits,
        service::scene_schema,
        service::settings,
        service::healthz,
        service::readyz,
        service::metrics,
        service::openapi,
        viewer::page,
        viewer::file,
    ),
    components(schemas(Receipt, ProblemDocument, stream::FrameHeader, stream::PoseFields)),
    tags(
        (name = "frames", description = "Images of scenes"),
        (name = "scenes", description = "Scenes that can be drawn"),
        (name = "jobs", description = "Camera paths drawn in the background"),
        (name = "service", description = "Health, metrics, limits and the contract"),
    ),
    modifiers(&Problems, &Keys),
)]
struct Contract;

/// Returns the contract as JSON.
///
/// # Errors
/// The types allow none; passes on an error of the serialiser.
pub fn openapi_json() -> anyhow::Result<Value> {
    let mut document = serde_json::to_value(Contract::openapi())?;
    let scene = tidy::adopt(&mut document, crate::scene::json_schema(), "File");
    let path = tidy::adopt(&mut document, crate::scene::path_json_schema(), "File");
    let schemas = &mut document["components"]["schemas"];
    schemas["SceneFile"] = scene;
    schemas["PathFile"] = path;
    bounds::of_schemas(&mut document);
    tidy::flatten(&mut document);
    bounds::of_bodies(&mut document["components"]["schemas"]);
    bounds::of_uploads(&mut document);
    parameters(&mut document);
    Ok(document)
}

/// Returns the contract as in `openapi.yaml`.
///
/// # Errors
/// The types allow none; passes on an error of the serialiser.
pub fn openapi_yaml() -> anyhow::Result<String> {
    let yaml = tidy::plain_numbers(&yaml_serde::to_string(&tidy::ordered(&openapi_json()?))?);
    Ok(format!(
        "# Generated from the code by `pointillist openapi`; a test holds it equal.\n{yaml}"
    ))
}

/// Adds bounds to parameters and removes those that an operation refuses.
fn parameters(document: &mut Value) {
    let Some(paths) = document["paths"].as_object_mut() else { return };
    for (path, item) in paths {
        let operations = item.as_object_mut().into_iter().flat_map(|item| item.values_mut());
        for list in
            operations.filter_map(|operation| operation.get_mut("parameters")?.as_array_mut())
        {
            list.retain(|parameter| {
                !bounds::is_refused(path, parameter["name"].as_str().unwrap_or_default())
            });
            for parameter in list {
                let text = |key: &str| parameter[key].as_str().unwrap_or_default().to_owned();
                let (place, name) = (text("in"), text("name"));
                let schema = &mut parameter["schema"];
                tidy::never_null(schema);
                if let Some((_, length)) = bounds::length_of(&name)
                    && schema.get("items").is_some()
                {
                    bounds::narrow(schema, json!({ "minItems": length, "maxItems": length }));
                }
                if let Some(bounds) = bounds::of_parameter(path, &place, &name) {
                    bounds::narrow(schema, bounds);
                }
            }
        }
    }
}

/// Returns whether an operation reads its query, if only to refuse one.
fn reads_query(path: &str) -> bool {
    path.starts_with("/v1/") && path != "/v1/scene-schema.json"
}

struct Problems;

impl Modify for Problems {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        each_operation(openapi, |path, method, operation| {
            let mut kinds = problems::of_operation(path, method);
            kinds.extend([
                Kind::MalformedRequest,
                Kind::HeadTooLarge,
                Kind::WrongHost,
                Kind::Internal,
            ]);
            if path.contains('{') {
                // A segment may be empty or not UTF-8.
                kinds.push(Kind::UnknownRoute);
            }
            if reads_query(path) {
                kinds.extend([Kind::BadParameter, Kind::UnknownParameter]);
            }
            kinds.sort_by_key(|kind| Kind::ALL.iter().position(|known| known == kind));
            kinds.dedup();
            let verb = axum::http::Method::from_bytes(method.to_uppercase().as_bytes());
            if access::needed(&verb.unwrap_or_default(), path).is_some() {
                kinds.extend([Kind::Unauthorized, Kind::Forbidden, Kind::TooManyRequests]);
                if access::draws(path) {
                    kinds.push(Kind::DeviceQuota);
                }
            }
            let mut by_status: BTreeMap<u16, Vec<Kind>> = BTreeMap::new();
            for kind in kinds {
                by_status.entry(kind.facts().0).or_default().push(kind);
            }
            for (status, kinds) in by_status {
                operation.responses.responses.insert(status.to_string(), answer(&kinds));
            }
        });
    }
}

fn answer(kinds: &[Kind]) -> RefOr<utoipa::openapi::Response> {
    let lines: Vec<String> = kinds
        .iter()
        .map(|kind| {
            let (_, urn, title) = kind.facts();
            format!("{title} (`{urn}`)")
        })
        .collect();
    let schema = RefOr::Ref(Ref::from_schema_name("Problem"));
    let content = ContentBuilder::new().schema(Some(schema)).build();
    RefOr::T(
        ResponseBuilder::new().description(lines.join("; ")).content(PROBLEM_JSON, content).build(),
    )
}

/// Documents API keys for every operation that may need one.
struct Keys;

impl Modify for Keys {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        let mut http = Http::new(HttpAuthScheme::Bearer);
        http.description = Some(
            "An API key, where the server asks for one: not on loopback by default, where only requests \
             to `localhost` and loopback addresses are answered. `GET` works without a key at an address that \
             `pointillist sign` has signed; its query ends with `signed_by`, `signed_until`, `signed_pixels`, \
             `signed_ms`, `signed_open` and `signature`"
                .to_owned(),
        );
        let components = openapi.components.get_or_insert_with(Default::default);
        components.add_security_scheme("key", SecurityScheme::Http(http));
        each_operation(openapi, |path, method, operation| {
            let verb = axum::http::Method::from_bytes(method.to_uppercase().as_bytes());
            if let Some(scope) = access::needed(&verb.unwrap_or_default(), path) {
                let scope = format!("{scope:?}").to_lowercase();
                operation.security = Some(vec![
                    SecurityRequirement::default(),
                    SecurityRequirement::new("key", [scope]),
                ]);
            }
        });
    }
}

fn each_operation(
    openapi: &mut utoipa::openapi::OpenApi,
    mut change: impl FnMut(&str, &str, &mut Operation),
) {
    for (path, item) in &mut openapi.paths.paths {
        for (method, operation) in [
            ("get", &mut item.get),
            ("post", &mut item.post),
            ("patch", &mut item.patch),
            ("delete", &mut item.delete),
        ] {
            if let Some(operation) = operation {
                change(path, method, operation);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_what_the_code_says() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
        let yaml = openapi_yaml().unwrap();
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(path, &yaml).unwrap();
        }
        let file = std::fs::read_to_string(path).unwrap();
        assert!(
            file == yaml,
            "openapi.yaml differs from the code; run the test with UPDATE=1 and look at the change"
        );
    }

    /// YAML 1.1 reads `1e100` as text; YAML 1.2 reads it as a number.
    #[test]
    fn numbers_are_numbers_to_every_reader_of_yaml() {
        let yaml = openapi_yaml().unwrap();
        assert!(yaml.contains("maximum: 1.0e+100\n") && yaml.contains("minimum: 1.0e-6\n"));
        let read: Value = yaml_serde::from_str(&yaml).unwrap();
        assert_eq!(read, openapi_json().unwrap());
    }

    #[test]
    fn every_route_is_in_the_document() {
        let document = openapi_json().unwrap();
        let paths = document["paths"].as_object().unwrap();
        for route in crate::http::ROUTES.iter().filter(|route| route.starts_with('/')) {
            assert!(paths.contains_key(*route), "{route}");
        }
        assert_eq!(paths.len(), crate::http::ROUTES.len() - 1);
    }

    #[test]
    fn every_kind_of_problem_is_in_the_document() {
        let text = openapi_yaml().unwrap();
        for kind in Kind::ALL {
            let (_, urn, _) = kind.facts();
            // Types that occur only in a job's `error` are listed there without the common prefix.
            let short = urn.rsplit(':').next().unwrap();
            assert!(text.contains(urn) || text.contains(&format!("`{short}`")), "{kind:?}");
        }
    }
}
