//! What every request passes before and after its handler: its name, the access rules, the rates, counters and logs.

use std::hash::BuildHasher;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use axum::body::HttpBody;
use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tracing::Instrument;

use super::journal::{Asked, Spent};
use super::problem::{Kind, Problem};
use super::{
    App, Caller, Owner, ROUTES, TIMING_ALLOW_ORIGIN, UNMATCHED, access, address, body, journal,
    naming,
};
use crate::engine::Client;

/// Wraps every handler: gives the request a name, checks access, counts, logs.
pub async fn gate(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let matched = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let route = matched
        .and_then(|path| ROUTES.iter().find(|route| **route == path))
        .copied()
        .unwrap_or(UNMATCHED);
    let method = request.method().clone();
    let id = naming::of(request.headers());
    request.extensions_mut().insert(id.clone());
    let peer = request.extensions().get::<ConnectInfo<SocketAddr>>().map(|from| from.0.ip());
    let proxies = &app.settings.edge.trusted_proxies;
    let asked = Asked {
        request_id: id.clone(),
        address: peer.map(|peer| address::of_client(peer, request.headers(), proxies)),
        method: method.clone(),
        route,
        target: journal::target(request.uri()),
        at: Instant::now(),
    };
    let span = tracing::debug_span!("request", request_id = %id, %method, route);
    let answer = answer(&app, &asked, request, next).instrument(span);
    let mut response = naming::within(id.clone(), answer).await;
    let headers = response.headers_mut();
    headers.extend(naming::header(&id).map(|value| (naming::REQUEST_ID, value)));
    headers.extend(app.timing_origins.clone().map(|value| (TIMING_ALLOW_ORIGIN, value)));
    app.metrics.answered(route, &method, response.status().as_u16());
    log(&app, &asked, response)
}

/// Writes the audit line of a change or a refusal now, and the access line when the answer has been sent.
fn log(app: &App, asked: &Asked, mut response: Response) -> Response {
    let edge = &app.settings.edge;
    if edge.access_log.is_none() && edge.audit_log.is_none() {
        return response;
    }
    let status = response.status().as_u16();
    let key = response.extensions_mut().remove::<Owner>().and_then(|owner| owner.name);
    let line = asked.answered(key.as_deref(), status);
    let may_change = access::needed(&asked.method, asked.route) > Some(access::Scope::Read);
    match status {
        401 | 403 => app.audit(&line.clone().event("refused")),
        0..=399 if may_change => app.audit(&line.clone().event("change")),
        _ => {}
    }
    let Some(journal) = edge.access_log.clone() else { return response };
    let spent = response.extensions_mut().remove::<Spent>();
    response.map(|body| journal::logged(body, journal, line, spent, asked.at))
}

/// Checks access and answers the request.
async fn answer(app: &App, asked: &Asked, request: Request, next: Next) -> Response {
    // A client that waits for `100 Continue` sends no body after a refusal, so there is nothing to read.
    let expects = request.headers().contains_key(header::EXPECT);
    let (request, rest) = if request.body().is_end_stream() || expects {
        (request, None)
    } else {
        let (parts, whole) = request.into_parts();
        let (body, rest) = body::share(whole);
        (Request::from_parts(parts, body), Some(rest))
    };
    let mut request = request;
    let response = match admit(app, asked, &request) {
        Ok((client, owner)) => {
            request.extensions_mut().insert(Caller(client));
            request.extensions_mut().insert(owner.clone());
            let mut response = next.run(request).await;
            response.extensions_mut().insert(owner);
            response
        }
        Err(problem) => problem.into_response(),
    };
    if let (Some(rest), true) = (rest, response.status().as_u16() >= 400) {
        rest.linger().await;
    }
    response
}

/// Checks a request against the access rules and the rates. Returns its client and its key.
fn admit(app: &App, asked: &Asked, request: &Request) -> Result<(Client, Owner), Problem> {
    let (route, headers, now) = (asked.route, request.headers(), asked.at);
    let is_limited = access::needed(&asked.method, route).is_some();
    let rules = app.rules.read().clone();
    if let (Some(from), true) = (asked.address, is_limited) {
        let has_key =
            matches!(rules.access, access::Access::Keys(_)) && access::has_key(route, headers);
        app.limits.admit_address(from, has_key, now)?;
    }
    let checked = rules.access.check(&asked.method, request.uri(), route, headers);
    let key = checked.inspect_err(|problem| {
        if problem.kind != Kind::Unauthorized || !access::has_key(route, headers) {
            return;
        }
        let from = asked.address;
        tracing::warn!(request_id = %asked.request_id, address = ?from, route, "wrong API key");
        if let Some(from) = from {
            app.limits.wrong_key(from, now);
        }
    })?;
    let Some(key) = key else {
        let client = match asked.address {
            Some(from) => Client::Caller(app.callers.hash_one(from)),
            None => Client::Unnamed,
        };
        return Ok((client, Owner { is_admin: true, ..Owner::default() }));
    };
    let number = app.number_of(key);
    app.limits.admit_key(number, &key.quotas, access::draws(route), now)?;
    let is_admin = key.scope == access::Scope::Admin;
    let owner = Owner { name: Some(key.name.clone()), is_admin, quotas: key.quotas };
    Ok((Client::Caller(number), owner))
}
