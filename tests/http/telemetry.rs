//! Traces and metrics that a collector gets by OTLP.

use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::State;
use axum::routing::post;
use opentelemetry_proto::tonic::collector::metrics::v1::ExportMetricsServiceRequest;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::{KeyValue, any_value};
use opentelemetry_proto::tonic::metrics::v1::{metric, number_data_point};
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;

use super::daemon::{Daemon, eventually};

/// What a collector got.
#[derive(Default)]
struct Got {
    spans: Vec<Span>,
    resource: Vec<KeyValue>,
    metrics: Vec<ExportMetricsServiceRequest>,
}

/// A collector that keeps everything.
struct Collector {
    address: SocketAddr,
    got: Arc<Mutex<Got>>,
    _runtime: tokio::runtime::Runtime,
}

impl Collector {
    fn start() -> Collector {
        let got = Arc::new(Mutex::new(Got::default()));
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        listener.set_nonblocking(true).unwrap();
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.unwrap();
        let router = axum::Router::new()
            .route("/v1/traces", post(take_spans))
            .route("/v1/metrics", post(take_metrics))
            .with_state(got.clone());
        runtime.spawn(async move {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            axum::serve(listener, router).await.unwrap();
        });
        Collector { address, got, _runtime: runtime }
    }

    fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Returns the spans of a request.
    fn spans(&self, trace: &[u8]) -> Vec<Span> {
        let got = self.got.lock().unwrap();
        got.spans.iter().filter(|span| span.trace_id == trace).cloned().collect()
    }
}

async fn take_spans(State(got): State<Arc<Mutex<Got>>>, body: Bytes) {
    let message = ExportTraceServiceRequest::decode(body).unwrap();
    let mut got = got.lock().unwrap();
    for of_resource in message.resource_spans {
        got.resource = of_resource.resource.unwrap().attributes;
        got.spans.extend(of_resource.scope_spans.into_iter().flat_map(|scope| scope.spans));
    }
}

async fn take_metrics(State(got): State<Arc<Mutex<Got>>>, body: Bytes) {
    got.lock().unwrap().metrics.push(ExportMetricsServiceRequest::decode(body).unwrap());
}

fn text(attributes: &[KeyValue], key: &str) -> Option<String> {
    let found = attributes.iter().find(|attribute| attribute.key == key)?;
    match found.value.as_ref()?.value.as_ref()? {
        any_value::Value::StringValue(text) => Some(text.clone()),
        any_value::Value::IntValue(number) => Some(number.to_string()),
        other => panic!("{key}: {other:?}"),
    }
}

#[test]
fn a_collector_gets_the_stages_of_a_frame_and_the_metrics() {
    let collector = Collector::start();
    let environment = [
        ("OTEL_BSP_SCHEDULE_DELAY", "50"),
        ("OTEL_METRIC_EXPORT_INTERVAL", "200"),
        ("OTEL_RESOURCE_ATTRIBUTES", "deployment.environment=test"),
    ];
    let daemon = Daemon::start_within(&environment, |_| {}, &["--otlp", &collector.url()]);
    let client = daemon.client();
    let trace: Vec<u8> = (1..=16).collect();
    let parent = [7, 0, 0, 0, 0, 0, 0, 9];
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let header = format!("00-{}-{}-01", hex(&trace), hex(&parent));
    let headers = [("traceparent", &header[..]), ("x-request-id", "one-frame")];
    let frame = "/v1/scenes/grid/frame?w=64&h=64";
    assert_eq!(client.send("GET", frame, &headers, None).status, 200);
    // Probes are no spans. A request without a parent begins a trace.
    assert_eq!(client.send("GET", "/healthz", &headers, None).status, 200);
    assert_eq!(client.get("/v1/scenes/none").status, 404);
    let roots = || {
        let got = collector.got.lock().unwrap();
        got.spans.iter().filter(|span| span.parent_span_id.is_empty()).count()
    };
    eventually("both requests", || collector.spans(&trace).len() >= 8 && roots() == 1);
    let spans = collector.spans(&trace);
    let request: Vec<_> = spans.iter().filter(|span| span.parent_span_id == parent).collect();
    let [request] = request[..] else { panic!("{} requests", request.len()) };
    assert_eq!(request.name, "GET /v1/scenes/{id}/frame");
    let of = |key: &str| text(&request.attributes, key).unwrap_or_default();
    assert_eq!(of("http.response.status_code"), "200");
    assert_eq!(
        (of("pointillist.request_id"), of("pointillist.target")),
        ("one-frame".into(), "grid".into())
    );
    assert!(of("http.response.body.size").parse::<u64>().unwrap() > 100);
    let children = |parent: &Span| {
        let own = spans.iter().filter(|span| span.parent_span_id == parent.span_id);
        own.cloned().collect::<Vec<_>>()
    };
    let stages = children(request);
    let names: Vec<&str> = stages.iter().map(|span| &span.name[..]).collect();
    let expected = ["queue", "record", "device wait", "draw", "readback", "encode wait", "encode"];
    assert_eq!(names, expected);
    let is_within = |inner: &Span, outer: &Span| {
        inner.start_time_unix_nano >= outer.start_time_unix_nano
            && inner.end_time_unix_nano <= outer.end_time_unix_nano
    };
    for pair in stages.windows(2) {
        assert_eq!(pair[0].end_time_unix_nano, pair[1].start_time_unix_nano);
    }
    let outside: Vec<_> = stages.iter().filter(|stage| !is_within(stage, request)).collect();
    assert!(outside.is_empty(), "{outside:?} are not within {request:?}");
    let passes = children(&stages[3]);
    assert!(passes.iter().any(|pass| pass.name == "clear") || passes.len() > 2, "{passes:?}");
    assert!(passes.iter().all(|pass| is_within(pass, &stages[3])), "{passes:?}");
    // All spans are told of the same process.
    let resource = collector.got.lock().unwrap().resource.clone();
    let of = |key: &str| text(&resource, key).unwrap_or_default();
    assert_eq!(
        (of("service.name"), of("deployment.environment")),
        ("pointillist".into(), "test".into())
    );

    let frames = || {
        let got = collector.got.lock().unwrap();
        let latest = got.metrics.last()?;
        let metrics = &latest.resource_metrics[0].scope_metrics[0].metrics;
        let found = metrics.iter().find(|found| found.name == "pointillist_engine_frames")?;
        let Some(metric::Data::Sum(sum)) = &found.data else { panic!("{found:?}") };
        match sum.data_points[0].value? {
            number_data_point::Value::AsDouble(value) => Some(value),
            number_data_point::Value::AsInt(value) => Some(value as f64),
        }
    };
    let count = client.metric("pointillist_engine_frames_total");
    assert!(count >= 1.0);
    eventually("the count of frames", || frames() == Some(count));
}

#[test]
fn a_collector_that_never_answers_holds_nothing_up() {
    // Connections to it are made, and nobody answers.
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", silent.local_addr().unwrap());
    let environment = [
        ("OTEL_BSP_SCHEDULE_DELAY", "20"),
        ("OTEL_BSP_MAX_QUEUE_SIZE", "8"),
        ("OTEL_BSP_MAX_EXPORT_BATCH_SIZE", "4"),
        ("OTEL_METRIC_EXPORT_INTERVAL", "50"),
    ];
    let mut daemon = Daemon::start_within(&environment, |_| {}, &["--otlp", &url]);
    let client = daemon.client();
    // Many more spans than the queue holds. A time limit of the collector's connections is ten seconds each.
    let began = Instant::now();
    for _ in 0..300 {
        assert_eq!(client.get("/v1/limits").status, 200);
    }
    let elapsed = began.elapsed();
    assert!(elapsed < Duration::from_secs(60), "300 requests took {elapsed:?}");
    let complaints = |what: &str| daemon.log().matches(what).count();
    eventually("a complaint about each", || {
        complaints("cannot send metrics") == 1 && complaints("cannot send spans") == 1
    });
    assert!(!daemon.is_lost());
}
