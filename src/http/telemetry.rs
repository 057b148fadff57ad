//! OpenTelemetry, where an operator asks for it: traces of requests, and the metrics of `/metrics`, sent to a collector by OTLP over HTTP.
//!
//! ```text
//! traceparent of the client
//!   └─ GET /v1/scenes/{id}/frame      from the request's head to the last byte of its answer
//!        ├─ queue, record, device wait, readback, encode wait, encode      the stages of the frame's receipt
//!        └─ draw
//!             └─ the passes on the GPU, where the adapter times them
//! ```
//!
//! The SDK collects spans and sends them in batches from a thread of its own. While the collector is away or slow, spans are dropped:
//! no request waits. The `OTEL_…` variables for headers, resource attributes, sampling and intervals apply.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use axum::http::HeaderMap;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry::trace::{Span, SpanKind, Status, TraceContextExt, Tracer, TracerProvider};
use opentelemetry::{Context, KeyValue};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{self, SdkTracer, SdkTracerProvider, SpanData};

use self::push::Pusher;
use super::journal::{Line, Spent};

mod push;

/// Time limit of a request to the collector.
const LIMIT: Duration = Duration::from_secs(10);
/// Methods that have a name in spans.
const METHODS: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
/// Attribute of the service's name, and how the SDK begins it where none is given.
const SERVICE_NAME: &str = "service.name";
const UNKNOWN: &str = "unknown_service";

/// What is sent to a collector.
#[derive(Debug)]
pub struct Telemetry {
    provider: SdkTracerProvider,
    tracer: SdkTracer,
    pusher: Pusher,
}

/// The span of another service that a request belongs to.
#[derive(Clone, Debug, Default)]
pub struct Parent(Context);

/// Headers, as the propagator reads them.
struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(|name| name.as_str()).collect()
    }
}

impl Parent {
    /// Reads `traceparent` and `tracestate`, and ignores invalid ones.
    pub fn of(headers: &HeaderMap) -> Parent {
        // Not the caller's current context, which has nothing to do with the client.
        Parent(
            TraceContextPropagator::new().extract_with_context(&Context::new(), &Headers(headers)),
        )
    }
}

/// An exporter that tells when spans begin to be lost.
#[derive(Debug)]
struct Watched {
    exporter: SpanExporter,
    is_failing: AtomicBool,
}

impl trace::SpanExporter for Watched {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let spans = batch.len();
        let exported = self.exporter.export(batch).await;
        let was_failing = self.is_failing.swap(exported.is_err(), Ordering::Relaxed);
        if let (Err(error), false) = (&exported, was_failing) {
            tracing::warn!(%error, spans, "cannot send spans to the OpenTelemetry collector; they are lost");
        }
        exported
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.exporter.shutdown_with_timeout(timeout)
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.exporter.force_flush()
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.exporter.set_resource(resource);
    }
}

impl Telemetry {
    /// Prepares to send to a collector, such as `http://127.0.0.1:4318`. Not for a thread of an asynchronous runtime.
    ///
    /// # Errors
    /// The text is no address, or a variable cannot be used. A collector that is not there is no error.
    pub fn open(url: &str) -> Result<Telemetry, String> {
        let base = url.trim_end_matches('/');
        let is_http =
            reqwest::Url::parse(base).is_ok_and(|url| matches!(url.scheme(), "http" | "https"));
        if !is_http {
            return Err("expected http://HOST:4318 or https://HOST".to_owned());
        }
        // Another crate may have chosen a provider of cryptography already, which is as good.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        let client = reqwest::blocking::Client::builder()
            .timeout(LIMIT)
            .redirect(reqwest::redirect::Policy::none())
            .build();
        let exporter = SpanExporter::builder()
            .with_http()
            .with_http_client(client.map_err(|error| error.to_string())?)
            .with_protocol(Protocol::HttpBinary)
            .with_endpoint(format!("{base}/v1/traces"))
            .build()
            .map_err(|error| error.to_string())?;
        let resource = resource();
        let pusher = Pusher::new(base, &resource)?;
        let provider = SdkTracerProvider::builder()
            .with_resource(resource)
            .with_batch_exporter(Watched { exporter, is_failing: AtomicBool::new(false) })
            .build();
        let tracer = provider.tracer("pointillist");
        Ok(Telemetry { provider, tracer, pusher })
    }

    /// Sends the metrics of an OpenMetrics text.
    ///
    /// # Errors
    /// The collector does not answer or refuses them.
    pub async fn push(&self, openmetrics: &str) -> Result<(), String> {
        self.pusher.push(openmetrics, SystemTime::now()).await
    }

    /// Returns the interval at which metrics are to be sent.
    pub fn interval(&self) -> Duration {
        self.pusher.interval
    }

    /// Sends the spans that wait, at most for `patience`, and stops.
    ///
    /// # Errors
    /// The collector did not take them in time.
    pub fn close(&self, patience: Duration) -> Result<(), String> {
        self.provider.shutdown_with_timeout(patience).map_err(|error| error.to_string())
    }

    /// Records a request whose answer has been sent or given up just now, after `total`.
    pub fn record(&self, line: &Line, spent: Option<&Spent>, parent: &Parent, total: Duration) {
        // Probes and scrapes would drown the rest.
        if matches!(line.route, "/healthz" | "/readyz" | "/metrics") {
            return;
        }
        let end = SystemTime::now();
        // A client may send any word as method, and any path.
        let is_known = METHODS.contains(&&line.method[..]);
        let method = if is_known { &line.method[..] } else { "_OTHER" };
        let route = Some(line.route).filter(|route| route.starts_with('/'));
        let named = if is_known { method } else { "HTTP" };
        let name = route.map_or_else(|| named.to_owned(), |route| format!("{named} {route}"));
        let mut attributes = vec![
            KeyValue::new("http.request.method", method.to_owned()),
            KeyValue::new("pointillist.request_id", line.request_id.clone()),
        ];
        attributes.extend(route.map(|route| KeyValue::new("http.route", route)));
        let optional = [
            ("client.address", line.address.map(|address| address.to_string())),
            ("pointillist.key", line.key.clone()),
            ("pointillist.target", line.target.clone()),
        ];
        let optional =
            optional.into_iter().filter_map(|(name, value)| Some(KeyValue::new(name, value?)));
        attributes.extend(optional);
        attributes.extend(
            line.status.map(|status| KeyValue::new("http.response.status_code", i64::from(status))),
        );
        let bytes = line.bytes.and_then(|bytes| i64::try_from(bytes).ok());
        attributes.extend(bytes.map(|bytes| KeyValue::new("http.response.body.size", bytes)));
        let mut span = self
            .tracer
            .span_builder(name)
            .with_kind(SpanKind::Server)
            .with_start_time(end.checked_sub(total).unwrap_or(end))
            .with_attributes(attributes)
            .start_with_context(&self.tracer, &parent.0);
        match line.status {
            None => span.set_status(Status::error("the client went away before the answer")),
            Some(500..) => span.set_status(Status::error("")),
            Some(_) => {}
        }
        let is_recorded = span.is_recording();
        let context = parent.0.with_span(span);
        if let (Some(spent), true) = (spent, is_recorded) {
            self.record_stages(spent, &context);
        }
        context.span().end_with_timestamp(end);
    }

    /// Records the stages of a frame, one after the other.
    fn record_stages(&self, spent: &Spent, request: &Context) {
        let total: u64 = spent.stages.iter().map(|stage| stage.1).sum();
        let Some(mut at) = spent.ready_at.checked_sub(Duration::from_nanos(total)) else { return };
        for &(name, ns) in &spent.stages {
            let context = self.child(name, at, ns, request);
            let mut pass_at = at;
            for &(pass, ns) in spent.passes.iter().filter(|_| name == Spent::DRAW) {
                self.child(pass, pass_at, ns, &context);
                pass_at += Duration::from_nanos(ns);
            }
            at += Duration::from_nanos(ns);
        }
    }

    fn child(&self, name: &'static str, at: SystemTime, ns: u64, parent: &Context) -> Context {
        let builder = self.tracer.span_builder(name).with_start_time(at);
        let mut span = builder.start_with_context(&self.tracer, parent);
        span.end_with_timestamp(at + Duration::from_nanos(ns));
        parent.with_span(span)
    }
}

/// Returns what every span and metric says of this process. The environment may name it otherwise.
fn resource() -> Resource {
    let version = KeyValue::new("service.version", crate::VERSION);
    let found = Resource::builder().with_attribute(version.clone()).build();
    let name = found.get(&SERVICE_NAME.into());
    match name.is_some_and(|name| !name.as_str().starts_with(UNKNOWN)) {
        true => found,
        false => {
            Resource::builder().with_attribute(version).with_service_name("pointillist").build()
        }
    }
}
