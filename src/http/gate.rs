//! The middleware around every handler: it names the request, checks access and rates, counts, and logs.

use std::hash::BuildHasher;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use axum::body::HttpBody;
use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tracing::Instrument;

use super::access::signed::{self, Caps};
use super::access::{Admitted, Refused};
use super::journal::{Asked, Spent};
use super::problem::Problem;
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
        key: OnceLock::new(),
        is_let_in: AtomicBool::new(false),
        is_signed: AtomicBool::new(false),
        address: peer.map(|peer| address::of_client(peer, request.headers(), proxies)),
        method: method.clone(),
        route,
        target: journal::target(request.uri()),
        at: Instant::now(),
    };
    let pending = Pending { app: &app, asked, is_answered: false };
    let span = tracing::debug_span!("request", request_id = %id, %method, route);
    let answer = answer(&app, &pending.asked, request, next).instrument(span);
    let mut response = naming::within(id.clone(), answer).await;
    let headers = response.headers_mut();
    headers.extend(naming::header(&id).map(|value| (naming::REQUEST_ID, value)));
    headers.extend(app.timing_origins.clone().map(|value| (TIMING_ALLOW_ORIGIN, value)));
    app.metrics.answered(route, &method, response.status().as_u16());
    pending.answered(response)
}

/// A request whose answer is not known yet. If its client goes away before that, it is dropped, and logged without a status.
struct Pending<'a> {
    app: &'a App,
    asked: Asked,
    is_answered: bool,
}

impl Pending<'_> {
    /// Returns whether the request may change something.
    fn may_change(&self) -> bool {
        access::needed(&self.asked.method, self.asked.route) > Some(access::Scope::Read)
    }

    /// Writes the audit line of a change or a refused key now, and the access line when the answer has been sent.
    fn answered(mut self, mut response: Response) -> Response {
        self.is_answered = true;
        let edge = &self.app.settings.edge;
        if edge.access_log.is_none() && edge.audit_log.is_none() {
            return response;
        }
        let status = response.status().as_u16();
        let place = response.headers().get(header::LOCATION).and_then(|place| place.to_str().ok());
        let made = place.and_then(|place| place.parse().ok()).as_ref().and_then(journal::target);
        let line = self.asked.line(Some(status), made);
        let is_refused = response.extensions_mut().remove::<WrongKey>().is_some();
        if is_refused || status == 403 {
            if self.app.limits.tells_refusal(self.asked.address, Instant::now()) {
                self.app.audit(&line.clone().event("refused"));
            }
        } else if status < 400 && self.may_change() {
            self.app.audit(&line.clone().event("change"));
        }
        let Some(journal) = edge.access_log.clone() else { return response };
        let spent = response.extensions_mut().remove::<Spent>();
        let at = self.asked.at;
        response.map(|body| journal::logged(body, journal, line, spent, at))
    }
}

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        if self.is_answered {
            return;
        }
        let line = self.asked.line(None, None).after(self.asked.at);
        // The change may have been made nevertheless.
        if self.may_change() && self.asked.is_let_in.load(Ordering::Relaxed) {
            self.app.audit(&line.clone().event("client-gone"));
        }
        if let Some(journal) = &self.app.settings.edge.access_log {
            journal.write(&line);
        }
    }
}

/// Marks the answer to a request whose key is not known or has expired.
#[derive(Clone, Copy)]
struct WrongKey;

/// Checks access and answers the request.
async fn answer(app: &App, asked: &Asked, request: Request, next: Next) -> Response {
    // A client that waits for `100 Continue` sends no body after a refusal, so there is nothing to read.
    let expects = request.headers().contains_key(header::EXPECT);
    let (mut request, rest) = if request.body().is_end_stream() || expects {
        (request, None)
    } else {
        let (parts, whole) = request.into_parts();
        let (body, rest) = body::share(whole);
        (Request::from_parts(parts, body), Some(rest))
    };
    let response = match admit(app, asked, &request) {
        Ok((caller, owner)) => {
            asked.is_let_in.store(true, Ordering::Relaxed);
            // Only signed addresses have an end.
            if let Some(own) =
                signed::without_signature(request.uri()).filter(|_| caller.1.until.is_some())
            {
                *request.uri_mut() = own;
            }
            request.extensions_mut().insert(caller);
            request.extensions_mut().insert(owner);
            next.run(request).await
        }
        Err(Denied { problem, is_audited }) => {
            let mut response = problem.into_response();
            if is_audited {
                response.extensions_mut().insert(WrongKey);
            }
            response
        }
    };
    if let (Some(rest), true) = (rest, response.status().as_u16() >= 400) {
        rest.linger().await;
    }
    response
}

/// Why a request was not let in.
struct Denied {
    problem: Problem,
    /// Whether the audit log tells it: a key was sent, and it was not one of many wrong ones.
    is_audited: bool,
}

impl From<Problem> for Denied {
    fn from(problem: Problem) -> Denied {
        Denied { problem, is_audited: false }
    }
}

/// Checks a request against the access rules and the rates. Returns its client and its key.
fn admit(app: &App, asked: &Asked, request: &Request) -> Result<(Caller, Owner), Denied> {
    let (route, headers, now) = (asked.route, request.headers(), asked.at);
    // Probes must not fail because others ask too often.
    let is_probe = matches!(route, "/healthz" | "/readyz");
    if let (Some(from), false) = (asked.address, is_probe) {
        app.limits.admit_address(from, now)?;
    }
    let rules = app.rules.read().clone();
    let checked = rules.access.check(&asked.method, request.uri(), route, headers);
    let admitted = match checked {
        Ok(admitted) => admitted,
        Err(refused) => return Err(deny(app, asked, refused)),
    };
    let Some(Admitted { key, caps, is_signed }) = admitted else {
        let client = match asked.address {
            Some(from) => Client::Caller(app.callers.hash_one(from)),
            None => Client::Unnamed,
        };
        let owner = Owner { is_admin: true, ..Owner::default() };
        return Ok((Caller(client, Caps::default()), owner));
    };
    // Nobody else sets it.
    let _ = asked.key.set(key.name.clone());
    asked.is_signed.store(is_signed, Ordering::Relaxed);
    let number = app.number_of(key);
    app.limits.admit_key(number, &key.quotas, access::draws(route), now)?;
    let is_admin = key.scope == access::Scope::Admin && !is_signed;
    let owner = Owner { name: Some(key.name.clone()), is_admin, quotas: key.quotas };
    Ok((Caller(Client::Caller(number), caps), owner))
}

/// Counts and logs a wrong key.
fn deny(app: &App, asked: &Asked, refused: Refused) -> Denied {
    let Refused { problem, key, is_guess } = refused;
    let mut is_audited = is_guess;
    if let Some(name) = key {
        is_audited = true;
        // Nobody else sets it.
        let _ = asked.key.set(name);
    }
    let from = asked.address;
    if let (true, Some(from)) = (is_guess, from)
        && let Err(problem) = app.limits.wrong_key(from, asked.at)
    {
        return problem.into();
    }
    if is_guess {
        tracing::warn!(request_id = %asked.request_id, address = ?from, route = asked.route, "wrong API key");
    }
    Denied { problem: *problem, is_audited }
}
