//! Metrics for a collector: the OpenMetrics text of `/metrics` becomes an OTLP message, family by family.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use opentelemetry_proto::tonic::collector::metrics::v1::{
    ExportMetricsServiceRequest, ExportMetricsServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::{AnyValue, InstrumentationScope, KeyValue, any_value};
use opentelemetry_proto::tonic::metrics::v1::{
    AggregationTemporality, Gauge, Histogram, HistogramDataPoint, Metric, NumberDataPoint,
    ResourceMetrics, ScopeMetrics, Sum, metric, number_data_point,
};
use opentelemetry_proto::tonic::resource::v1::Resource;
use prost::Message;
use reqwest::header::{CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue};
use reqwest::redirect::Policy;

use super::LIMIT;

/// Interval unless `OTEL_METRIC_EXPORT_INTERVAL` says otherwise, as the OpenTelemetry specification has it.
const INTERVAL: Duration = Duration::from_secs(60);

/// Longest answer of a collector that is read, in bytes.
const MOST_ANSWER: usize = 64 << 10;

/// Sends metrics.
#[derive(Debug)]
pub struct Pusher {
    client: reqwest::Client,
    url: String,
    resource: Resource,
    /// Beginning of all sums.
    began: SystemTime,
    pub interval: Duration,
}

impl Pusher {
    /// Prepares to send to the collector at `base`.
    ///
    /// # Errors
    /// A variable of the environment cannot be used.
    pub fn new(base: &str, resource: &opentelemetry_sdk::Resource) -> Result<Pusher, String> {
        let variable = |name: &str| std::env::var(name).ok().filter(|text| !text.is_empty());
        let named = |name| variable(name).map(|text| (name, text));
        let headers = named("OTEL_EXPORTER_OTLP_METRICS_HEADERS")
            .or_else(|| named("OTEL_EXPORTER_OTLP_HEADERS"))
            .map_or_else(|| Ok(HeaderMap::new()), |(name, text)| parse_headers(name, &text))?;
        let interval = match variable("OTEL_METRIC_EXPORT_INTERVAL") {
            None => INTERVAL,
            Some(text) => text
                .parse()
                .ok()
                .filter(|ms| *ms > 0)
                .map(Duration::from_millis)
                .ok_or_else(|| {
                    format!("OTEL_METRIC_EXPORT_INTERVAL={text}: expected a number of milliseconds")
                })?,
        };
        let client = reqwest::Client::builder()
            .timeout(LIMIT)
            .redirect(Policy::none())
            .default_headers(headers)
            .build();
        let attributes = resource.iter().map(|(key, value)| KeyValue {
            key: key.to_string(),
            value: Some(value.clone().into()),
            ..KeyValue::default()
        });
        Ok(Pusher {
            client: client.map_err(|error| error.to_string())?,
            url: format!("{base}/v1/metrics"),
            resource: Resource { attributes: attributes.collect(), ..Resource::default() },
            began: SystemTime::now(),
            interval,
        })
    }

    /// Sends the metrics of an OpenMetrics text.
    ///
    /// # Errors
    /// The collector does not answer or refuses them.
    pub async fn push(&self, openmetrics: &str, now: SystemTime) -> Result<(), String> {
        let scope = InstrumentationScope {
            name: "pointillist".to_owned(),
            version: crate::VERSION.to_owned(),
            ..InstrumentationScope::default()
        };
        let metrics =
            Span { began: nanoseconds(self.began), now: nanoseconds(now) }.convert(openmetrics);
        let scope_metrics =
            vec![ScopeMetrics { scope: Some(scope), metrics, ..ScopeMetrics::default() }];
        let resource = Some(self.resource.clone());
        let all = ResourceMetrics { resource, scope_metrics, ..ResourceMetrics::default() };
        let message = ExportMetricsServiceRequest { resource_metrics: vec![all] };
        let request = self.client.post(&self.url).header(CONTENT_TYPE, "application/x-protobuf");
        let answer = request.body(message.encode_to_vec()).send().await;
        let mut answer = answer.map_err(|error| error.to_string())?;
        if !answer.status().is_success() {
            return Err(format!("{}: {}", self.url, answer.status()));
        }
        // A collector may take a part.
        let mut body = Vec::new();
        while let Ok(Some(piece)) = answer.chunk().await {
            if body.len() + piece.len() > MOST_ANSWER {
                return Err(format!("{}: the answer is too long", self.url));
            }
            body.extend_from_slice(&piece);
        }
        let taken = ExportMetricsServiceResponse::decode(&body[..]).ok();
        match taken.and_then(|taken| taken.partial_success) {
            Some(partial) if partial.rejected_data_points > 0 => {
                let why: String = partial.error_message.chars().take(200).collect();
                let count = partial.rejected_data_points;
                Err(format!("{}: {count} values are refused: {why}", self.url))
            }
            _ => Ok(()),
        }
    }
}

/// Parses `name=value,name=value`, with percent-encoded values, of a variable. Errors do not repeat the text, which may be secret.
fn parse_headers(variable: &str, text: &str) -> Result<HeaderMap, String> {
    let mut headers = HeaderMap::new();
    for (number, pair) in text.split(',').map(str::trim).enumerate() {
        if pair.is_empty() {
            continue;
        }
        let wrong = || {
            let place = number + 1;
            format!("{variable}: part {place} is no header; expected NAME=VALUE,NAME=VALUE")
        };
        let (name, value) = pair.split_once('=').ok_or_else(wrong)?;
        let value = percent_encoding::percent_decode_str(value.trim()).decode_utf8_lossy();
        let name: HeaderName = name.trim().parse().map_err(|_| wrong())?;
        headers.insert(name, HeaderValue::from_str(&value).map_err(|_| wrong())?);
    }
    Ok(headers)
}

fn nanoseconds(time: SystemTime) -> u64 {
    let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// A sample of the text.
struct Sample<'a> {
    /// What follows the family's name.
    suffix: &'a str,
    labels: BTreeMap<&'a str, String>,
    value: f64,
}

/// A family of the text.
#[derive(Default)]
struct Family<'a> {
    name: &'a str,
    kind: &'a str,
    unit: &'a str,
    help: &'a str,
    samples: Vec<Sample<'a>>,
}

/// Splits an OpenMetrics text. What is not understood is left out: the text is our own.
fn families(text: &str) -> Vec<Family<'_>> {
    let mut families: Vec<Family> = Vec::new();
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("# ") {
            let mut words = rest.splitn(3, ' ');
            let (Some(what), Some(name)) = (words.next(), words.next()) else { continue };
            let value = words.next().unwrap_or("");
            if families.last().is_none_or(|family| family.name != name) {
                families.push(Family { name, ..Family::default() });
            }
            let Some(family) = families.last_mut() else { continue };
            match what {
                "TYPE" => family.kind = value,
                "UNIT" => family.unit = value,
                _ => family.help = value,
            }
        } else if let Some(family) = families.last_mut() {
            family.samples.extend(sample(line, family.name));
        }
    }
    families
}

/// Parses `NAME{LABELS} VALUE`.
fn sample<'a>(line: &'a str, family: &str) -> Option<Sample<'a>> {
    let rest = line.strip_prefix(family)?;
    let name_end = rest.find(['{', ' '])?;
    let (suffix, mut rest) = rest.split_at(name_end);
    let mut labels = BTreeMap::new();
    if let Some(inner) = rest.strip_prefix('{') {
        rest = inner;
        while let Some((name, after)) = rest.split_once("=\"") {
            let (value, after) = quoted(after)?;
            labels.insert(name.trim_start_matches(','), value);
            rest = after;
            if let Some(after) = rest.strip_prefix('}') {
                rest = after;
                break;
            }
        }
    }
    Some(Sample { suffix, labels, value: rest.split_whitespace().next()?.parse().ok()? })
}

/// Takes a label's value up to its closing quote.
fn quoted(text: &str) -> Option<(String, &str)> {
    let mut value = String::new();
    let mut letters = text.char_indices();
    while let Some((at, letter)) = letters.next() {
        match letter {
            '"' => return Some((value, &text[at + 1..])),
            '\\' => value.push(match letters.next()?.1 {
                'n' => '\n',
                other => other,
            }),
            other => value.push(other),
        }
    }
    None
}

/// The time that sums cover, in nanoseconds since 1970.
#[derive(Clone, Copy)]
struct Span {
    began: u64,
    now: u64,
}

impl Span {
    fn convert(self, text: &str) -> Vec<Metric> {
        families(text).into_iter().filter_map(|family| self.metric(family)).collect()
    }

    fn metric(self, family: Family) -> Option<Metric> {
        let cumulative = AggregationTemporality::Cumulative.into();
        let data = match family.kind {
            "gauge" => metric::Data::Gauge(Gauge { data_points: self.numbers(&family, "") }),
            "counter" => metric::Data::Sum(Sum {
                data_points: self.numbers(&family, "_total"),
                aggregation_temporality: cumulative,
                is_monotonic: true,
            }),
            "histogram" => metric::Data::Histogram(Histogram {
                data_points: self.histograms(&family),
                aggregation_temporality: cumulative,
            }),
            _ => return None,
        };
        // Units by the Unified Code for Units of Measure.
        let unit = match family.unit {
            "seconds" => "s",
            "bytes" => "By",
            other => other,
        };
        Some(Metric {
            name: family.name.to_owned(),
            description: family.help.trim_end_matches('.').to_owned(),
            unit: unit.to_owned(),
            data: Some(data),
            ..Metric::default()
        })
    }

    fn numbers(self, family: &Family, suffix: &str) -> Vec<NumberDataPoint> {
        let samples = family.samples.iter().filter(|sample| sample.suffix == suffix);
        let point = |sample: &Sample| NumberDataPoint {
            attributes: attributes(&sample.labels),
            start_time_unix_nano: self.began,
            time_unix_nano: self.now,
            value: Some(number_data_point::Value::AsDouble(sample.value)),
            ..NumberDataPoint::default()
        };
        samples.map(point).collect()
    }

    /// Puts together the samples of each histogram. The text counts what is at most each bound, the message what lies between bounds.
    fn histograms(self, family: &Family) -> Vec<HistogramDataPoint> {
        let mut points: BTreeMap<BTreeMap<&str, String>, HistogramDataPoint> = BTreeMap::new();
        for sample in &family.samples {
            let mut labels = sample.labels.clone();
            let bound = labels.remove("le");
            let point = points.entry(labels.clone()).or_insert_with(|| HistogramDataPoint {
                attributes: attributes(&labels),
                start_time_unix_nano: self.began,
                time_unix_nano: self.now,
                ..HistogramDataPoint::default()
            });
            match (sample.suffix, bound) {
                ("_sum", _) => point.sum = Some(sample.value),
                ("_count", _) => point.count = sample.value as u64,
                ("_bucket", Some(bound)) => {
                    let before: u64 = point.bucket_counts.iter().sum();
                    point.bucket_counts.push((sample.value as u64).saturating_sub(before));
                    let bound = bound.parse::<f64>().ok().filter(|bound| bound.is_finite());
                    point.explicit_bounds.extend(bound);
                }
                _ => {}
            }
        }
        points.into_values().collect()
    }
}

fn attributes(labels: &BTreeMap<&str, String>) -> Vec<KeyValue> {
    let attribute = |(name, value): (&&str, &String)| KeyValue {
        key: (*name).to_owned(),
        value: Some(AnyValue { value: Some(any_value::Value::StringValue(value.clone())) }),
        ..KeyValue::default()
    };
    labels.iter().map(attribute).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"# HELP p_open Streams open.
# TYPE p_open gauge
p_open 3
# HELP p_wait_seconds A frame's wait.
# TYPE p_wait_seconds histogram
# UNIT p_wait_seconds seconds
p_wait_seconds_sum{class="still"} 1.5
p_wait_seconds_count{class="still"} 4
p_wait_seconds_bucket{le="0.1",class="still"} 1
p_wait_seconds_bucket{le="0.2",class="still"} 3
p_wait_seconds_bucket{le="+Inf",class="still"} 4
# HELP p_requests Requests.
# TYPE p_requests counter
p_requests_total{route="/a\"b\\c\n,d}",status="200"} 7
p_requests_total{route="/",status="404"} 2
# EOF
"#;

    #[test]
    fn texts_become_messages() {
        let metrics = Span { began: 1, now: 2 }.convert(TEXT);
        let names: Vec<_> =
            metrics.iter().map(|m| (&m.name[..], &m.unit[..], &m.description[..])).collect();
        let expected = [
            ("p_open", "", "Streams open"),
            ("p_wait_seconds", "s", "A frame's wait"),
            ("p_requests", "", "Requests"),
        ];
        assert_eq!(names, expected);
        let Some(metric::Data::Gauge(open)) = &metrics[0].data else { panic!("no gauge") };
        assert_eq!(open.data_points[0].value, Some(number_data_point::Value::AsDouble(3.0)));
        let Some(metric::Data::Histogram(wait)) = &metrics[1].data else { panic!("no histogram") };
        let [point] = &wait.data_points[..] else { panic!("{} points", wait.data_points.len()) };
        assert_eq!((point.count, point.sum), (4, Some(1.5)));
        assert_eq!(
            (&point.bucket_counts[..], &point.explicit_bounds[..]),
            (&[1, 2, 1][..], &[0.1, 0.2][..])
        );
        assert_eq!(point.attributes, attributes(&BTreeMap::from([("class", "still".to_owned())])));
        let Some(metric::Data::Sum(requests)) = &metrics[2].data else { panic!("no sum") };
        assert!(requests.is_monotonic);
        let [odd, _] = &requests.data_points[..] else {
            panic!("{} points", requests.data_points.len())
        };
        let labels =
            BTreeMap::from([("route", "/a\"b\\c\n,d}".to_owned()), ("status", "200".to_owned())]);
        assert_eq!(odd.attributes, attributes(&labels));
        assert_eq!((odd.start_time_unix_nano, odd.time_unix_nano), (1, 2));
    }

    #[test]
    fn headers_are_decoded() {
        let headers = parse_headers("X", "Authorization=Basic%20abc, x-tenant=a=b").unwrap();
        assert_eq!(headers["authorization"], "Basic abc");
        assert_eq!(headers["x-tenant"], "a=b");
        for wrong in ["alone", "a b=c", "a=%0A"] {
            assert!(parse_headers("X", wrong).unwrap_err().contains("NAME=VALUE"), "{wrong}");
        }
    }
}
