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
use super::journal::{Asked, Journal, Line, Spent};
use super::problem::Problem;
use super::rules::Rules;
use super::telemetry::{Parent, Telemetry};
use super::{
    App, Caller, FRAME, Owner, ROUTES, TIMING_ALLOW_ORIGIN, UNMATCHED, access, address, body,
    journal, naming,
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
    let rules = app.rules();
    let proxies = &rules.bounds.trusted_proxies;
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
    let outlets = Outlets {
        access_log: app.settings.edge.access_log.clone(),
        telemetry: app.settings.edge.telemetry.clone().map(|t| (t, Parent::of(request.headers()))),
    };
    let pending = Pending { app: &app, asked, outlets, is_answered: false };
    let span = tracing::debug_span!("request", request_id = %id, %method, route);
    let answer = answer(&app, &rules, &pending.asked, request, next).instrument(span);
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
    outlets: Outlets,
    is_answered: bool,
}

/// Receivers of the line of each request that has ended.
#[derive(Clone)]
struct Outlets {
    access_log: Option<Arc<Journal>>,
    telemetry: Option<(Arc<Telemetry>, Parent)>,
}

impl Outlets {
    fn is_empty(&self) -> bool {
        self.access_log.is_none() && self.telemetry.is_none()
    }

    /// Leaves out what a request that was not let in may not choose: strangers have no spans, and the others no traces of their choice.
    fn keep_from(&mut self, asked: &Asked) {
        if asked.is_let_in.load(Ordering::Relaxed) {
            return;
        }
        match &mut self.telemetry {
            Some((_, parent)) if asked.key.get().is_some() => *parent = Parent::default(),
            telemetry => *telemetry = None,
        }
    }

    fn tell(&self, line: &Line, at: Instant) {
        if let Some(journal) = &self.access_log {
            journal.write(line);
        }
        if let Some((telemetry, parent)) = &self.telemetry {
            telemetry.record(line, line.spent.as_ref(), parent, at.elapsed());
        }
    }
}

impl Pending<'_> {
    /// Returns whether the request may change something.
    fn may_change(&self) -> bool {
        access::needed(&self.asked.method, self.asked.route) > Some(access::Scope::Read)
    }

    /// Writes the audit line of a change or a refused key now, and the access line when the answer has been sent.
    fn answered(mut self, mut response: Response) -> Response {
        self.is_answered = true;
        if self.outlets.is_empty() && self.app.settings.edge.audit_log.is_none() {
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
        } else if self.may_change() {
            let event = match status {
                ..400 => Some("change"),
                // It may have been made in part.
                500 | 507 => Some("change-failed"),
                _ => None,
            };
            if let Some(event) = event {
                self.app.audit(&line.clone().event(event));
            }
        }
        if self.outlets.is_empty() {
            return response;
        }
        self.outlets.keep_from(&self.asked);
        let line = line.spent(response.extensions_mut().remove::<Spent>());
        let (outlets, at) = (self.outlets.clone(), self.asked.at);
        response.map(|body| journal::logged(body, line, at, move |line| outlets.tell(line, at)))
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
        self.outlets.keep_from(&self.asked);
        self.outlets.tell(&line, self.asked.at);
    }
}

/// Marks the answer to a request whose key is not known or has expired.
#[derive(Clone, Copy)]
struct WrongKey;

/// Checks access and answers the request.
async fn answer(app: &App, rules: &Rules, asked: &Asked, request: Request, next: Next) -> Response {
    // A client that waits for `100 Continue` sends no body after a refusal, so there is nothing to read.
    let expects = request.headers().contains_key(header::EXPECT);
    let (mut request, rest) = if request.body().is_end_stream() || expects {
        (request, None)
    } else {
        let (parts, whole) = request.into_parts();
        let (body, rest) = body::share(whole);
        (Request::from_parts(parts, body), Some(rest))
    };
    let response = match admit(app, rules, asked, &request) {
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
fn admit(
    app: &App,
    rules: &Rules,
    asked: &Asked,
    request: &Request,
) -> Result<(Caller, Owner), Denied> {
    let (route, headers, now) = (asked.route, request.headers(), asked.at);
    // Probes must not fail because others ask too often.
    let is_probe = matches!(route, "/healthz" | "/readyz");
    if let (Some(from), false) = (asked.address, is_probe) {
        app.limits.admit_address(from, rules.bounds.requests_per_second_per_address, now)?;
    }
    let checked = rules.access.check(&asked.method, request.uri(), route, headers);
    let admitted = match checked {
        Ok(admitted) => admitted,
        Err(refused) => return Err(deny(app, asked, refused)),
    };
    let Some(Admitted { key, caps, is_signed }) = admitted else {
        let client = match asked.address {
            Some(from) => Client::Caller(app.callers.hash_one(address::network(from))),
            None => Client::Unnamed,
        };
        let owner = Owner { is_admin: true, ..Owner::default() };
        return Ok((Caller(client, Caps::default()), owner));
    };
    // Nobody else sets it.
    let _ = asked.key.set(key.name.clone());
    asked.is_signed.store(is_signed, Ordering::Relaxed);
    let number = app.number_of(key);
    app.limits.admit_key(number, &key.quotas, now)?;
    // The handler of frames answers 304 where the client has the frame, and checks the time otherwise.
    let is_conditional = route == FRAME && headers.contains_key(header::IF_NONE_MATCH);
    if access::draws(route) && !is_conditional {
        app.limits.check_device(number, now)?;
    }
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
