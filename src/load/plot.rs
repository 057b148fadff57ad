//! The saturation curve as an SVG: throughput, latency and requests without a frame, each against the offered rate.
//!
//! The SVG has no scripts and no outside files, so that any page can contain it. Its colours follow the reader's colour scheme,
//! light or dark, also where it is embedded as an image. Lines differ in their dashes and in the labels at their ends, not in
//! colour alone.

use std::fmt::Write;

use super::report::{JudgedPoint, Report, three_digits};
use super::tally::{Percentiles, Point};
use crate::markup::{escaped, shortened};

const WIDTH: f64 = 860.0;
/// Characters of a line of the heading.
const MOST_LETTERS: usize = 112;
const LEFT: f64 = 84.0;
/// Right edge of the panels. The lines' labels stand to the right of it.
const RIGHT: f64 = WIDTH - 96.0;

/// Top and bottom of each panel.
const THROUGHPUT: [f64; 2] = [92.0, 302.0];
const LATENCY: [f64; 2] = [346.0, 556.0];
const UNANSWERED: [f64; 2] = [600.0, 680.0];
const HEIGHT: f64 = 744.0;

const STYLE: &str = "\
  svg { --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --grid: #d8dee4; --a: #0a58ca; --b: #1a7f37; --c: #9a6700; --d: #b5176b; --e: #cf222e; }
  @media (prefers-color-scheme: dark) {
    svg { --paper: #0d1117; --ink: #e6edf3; --soft: #9aa4af; --grid: #2b323a; --a: #6cb0ff; --b: #56d364; --c: #e3b341; --d: #ff8ac4; --e: #ff7b72; }
  }
  text { font: 13px system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif; fill: var(--ink); }
  .title { font-size: 18px; font-weight: 600; }
  .soft { fill: var(--soft); }
  .end { text-anchor: end; }
  .middle { text-anchor: middle; }
  .paper { fill: var(--paper); }
  .grid { stroke: var(--grid); stroke-width: 1; }
  .frame { stroke: var(--soft); stroke-width: 1; fill: none; }
  .line { fill: none; stroke-width: 2; stroke-linejoin: round; }
  .ideal { stroke: var(--soft); stroke-dasharray: 2 4; }
  .knee { stroke: var(--soft); stroke-width: 1.5; stroke-dasharray: 7 4; }
  .a { stroke: var(--a); } .b { stroke: var(--b); } .c { stroke: var(--c); } .d { stroke: var(--d); } .e { stroke: var(--e); }
  .dot { fill: var(--paper); stroke-width: 2; }
  text.a, text.b, text.c, text.d, text.e { stroke: none; }
  text.a { fill: var(--a); } text.b { fill: var(--b); } text.c { fill: var(--c); } text.d { fill: var(--d); } text.e { fill: var(--e); }
";

/// A line of the plot: its CSS class, dashes, label, and its value at a point.
struct Line {
    class: &'static str,
    dashes: &'static str,
    label: &'static str,
    value: fn(&Point) -> Option<f64>,
}

const fn line(
    class: &'static str,
    dashes: &'static str,
    label: &'static str,
    value: fn(&Point) -> Option<f64>,
) -> Line {
    Line { class, dashes, label, value }
}

fn latency_ms(point: &Point, pick: fn(&Percentiles) -> Option<u64>) -> Option<f64> {
    percentile_ms(&point.latency, pick)
}

fn percentile_ms(percentiles: &Percentiles, pick: fn(&Percentiles) -> Option<u64>) -> Option<f64> {
    match pick(percentiles) {
        // The logarithm of 0 does not exist. No answer takes less than a microsecond.
        Some(ns) => Some((ns as f64 / 1e6).max(1e-3)),
        // The percentile falls among requests without an answer: beyond any axis.
        None => (percentiles.endless > 0).then_some(f64::INFINITY),
    }
}

fn share(point: &Point, count: u64) -> Option<f64> {
    (point.requests > 0).then(|| 100.0 * count as f64 / point.requests as f64)
}

fn pose_ms(point: &Point, pick: fn(&Percentiles) -> Option<u64>) -> Option<f64> {
    point.streams.as_ref().and_then(|streams| percentile_ms(&streams.latency, pick))
}

const THROUGHPUT_LINES: [Line; 2] = [
    line("a", "none", "frames", |point| Some(point.throughput_per_s)),
    line("e", "4 2", "on streams", |point| Some(point.streams.as_ref()?.frames_per_s)),
];
const LATENCY_LINES: [Line; 6] = [
    line("e", "12 3", "stream p99", |point| pose_ms(point, |latency| latency.p99_ns)),
    line("e", "4 2", "stream p50", |point| pose_ms(point, |latency| latency.p50_ns)),
    line("d", "1 4", "p99.9", |point| latency_ms(point, |latency| latency.p99_9_ns)),
    line("c", "8 3 2 3", "p99", |point| latency_ms(point, |latency| latency.p99_ns)),
    line("b", "7 3", "p95", |point| latency_ms(point, |latency| latency.p95_ns)),
    line("a", "none", "p50", |point| latency_ms(point, |latency| latency.p50_ns)),
];
const UNANSWERED_LINES: [Line; 3] = [
    line("c", "none", "refused", |point| share(point, point.counts.refused)),
    line("e", "7 3", "lost", |point| share(point, point.counts.lost())),
    line("d", "1 4", "failed", |point| share(point, point.counts.failed)),
];

/// Maps values to coordinates, linearly or by their logarithms.
#[derive(Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
    from_px: f64,
    to_px: f64,
    is_log: bool,
    /// Distance between ticks of a linear axis.
    step: f64,
    /// Whether some values lie beyond the axis. They are drawn at its end.
    is_exceeded: bool,
}

impl Axis {
    fn px(&self, value: f64) -> f64 {
        let scale = |value: f64| if self.is_log { value.ln() } else { value };
        let share = (scale(value) - scale(self.low)) / (scale(self.high) - scale(self.low));
        self.from_px + share.clamp(0.0, 1.0) * (self.to_px - self.from_px)
    }

    /// A linear axis from 0 to the first tick at or above `most`.
    fn linear(most: f64, from_px: f64, to_px: f64) -> Self {
        let step = tick_step(most);
        let high = (most / step).ceil().max(1.0) * step;
        Self { low: 0.0, high, from_px, to_px, is_log: false, step, is_exceeded: false }
    }

    /// A logarithmic axis of whole decades around all of `values`, and one decade more if some are infinite.
    fn decades(values: impl Iterator<Item = f64> + Clone, from_px: f64, to_px: f64) -> Self {
        let is_exceeded = values.clone().any(f64::is_infinite);
        let finite = values.filter(|value| value.is_finite());
        let least = finite.clone().fold(f64::INFINITY, f64::min);
        let most = finite.fold(f64::NEG_INFINITY, f64::max);
        let (least, most) = if least <= most { (least, most) } else { (1.0, 1.0) };
        let low = 10f64.powf(least.log10().floor());
        let high = 10f64.powf(most.log10().ceil()).max(10.0 * low);
        let high = if is_exceeded { 10.0 * high } else { high };
        Self { low, high, from_px, to_px, is_log: true, step: 0.0, is_exceeded }
    }

    fn ticks(&self) -> Vec<f64> {
        if self.is_log {
            let decades = (self.high / self.low).log10().round() as i32;
            return (0..=decades).map(|decade| self.low * 10f64.powi(decade)).collect();
        }
        (0..=(self.high / self.step).round() as u32)
            .map(|tick| f64::from(tick) * self.step)
            .collect()
    }
}

/// A round step, 1, 2 or 5 times a power of ten, about a sixth of `most`.
fn tick_step(most: f64) -> f64 {
    let rough = if most > 0.0 { most / 6.0 } else { 0.2 };
    let power = 10f64.powf(rough.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|times| times * power);
    steps.into_iter().find(|step| *step >= 0.999 * rough).unwrap_or(10.0 * power)
}

fn tick_label(value: f64) -> String {
    if value == 0.0 || value >= 1.0 { format!("{value:.0}").to_owned() } else { format!("{value}") }
}

// Writing to a string cannot fail, so results of `write!` are dropped below.

/// The whole plot.
pub fn svg(report: &Report) -> String {
    let points = &report.points;
    let most_offered = most(points, |point| Some(point.offered_per_s));
    let most_arrived = THROUGHPUT_LINES.iter().map(|line| most(points, line.value));
    let most_arrived = most_arrived.fold(0.0, f64::max);
    let x = Axis::linear(most_offered, LEFT, RIGHT);
    let mut out = String::with_capacity(16 << 10);
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" aria-labelledby=\"title subject\">\n<style>\n{STYLE}</style>\n<rect class=\"paper\" width=\"{WIDTH}\" height=\"{HEIGHT}\"/>"
    );
    heading(&mut out, report);
    let throughput = Axis::linear(most_arrived.max(1e-3), THROUGHPUT[1], THROUGHPUT[0]);
    panel(&mut out, &x, &throughput, "frames per second", &THROUGHPUT_LINES, points, |out| {
        ideal(out, &x, &throughput);
    });
    let values = points
        .iter()
        .flat_map(|judged| LATENCY_LINES.iter().filter_map(|line| (line.value)(&judged.point)));
    let latency = Axis::decades(values, LATENCY[1], LATENCY[0]);
    panel(&mut out, &x, &latency, "latency since due, ms", &LATENCY_LINES, points, |_| {});
    let unanswered = Axis {
        low: 0.0,
        high: 100.0,
        from_px: UNANSWERED[1],
        to_px: UNANSWERED[0],
        is_log: false,
        step: 25.0,
        is_exceeded: false,
    };
    panel(&mut out, &x, &unanswered, "no frame, %", &UNANSWERED_LINES, points, |_| {});
    knee(&mut out, &x, report);
    let _ = writeln!(
        out,
        "<text class=\"middle\" x=\"{:.1}\" y=\"{:.1}\">offered requests per second</text>\n</svg>",
        0.5 * (LEFT + RIGHT),
        HEIGHT - 22.0
    );
    out
}

fn most(points: &[JudgedPoint], value: fn(&Point) -> Option<f64>) -> f64 {
    points.iter().filter_map(|judged| value(&judged.point)).fold(0.0, f64::max)
}

fn heading(out: &mut String, report: &Report) {
    let run = &report.run;
    let (arrivals, duration) = (format!("{:?}", run.spacing).to_lowercase(), run.duration_s);
    let subject = shortened(&report.subject(), MOST_LETTERS);
    let streams = match run.streams {
        0 => String::new(),
        count => format!(", {count} streams of {} poses/s", three_digits(run.poses_per_s)),
    };
    let how = format!("{} · {arrivals} arrivals{streams}, {duration} s a step", report.adapter());
    let how = shortened(&how, MOST_LETTERS);
    for (y, class, id, text) in [
        (30.0, "title", " id=\"title\"", "Frames under load"),
        (52.0, "soft", " id=\"subject\"", subject.as_str()),
        (71.0, "soft", "", how.as_str()),
    ] {
        let _ = writeln!(
            out,
            "<text class=\"{class}\"{id} x=\"{LEFT}\" y=\"{y}\">{}</text>",
            escaped(text)
        );
    }
}

/// Draws the grid, the frame, the axes' labels, and the lines with their labels.
fn panel(
    out: &mut String,
    x: &Axis,
    y: &Axis,
    label: &str,
    lines: &[Line],
    points: &[JudgedPoint],
    beneath: impl FnOnce(&mut String),
) {
    let (top, bottom) = (y.to_px, y.from_px);
    for tick in x.ticks() {
        let at = x.px(tick);
        let _ = writeln!(out, "<path class=\"grid\" d=\"M{at:.1} {top}V{bottom}\"/>");
        let _ = writeln!(
            out,
            "<text class=\"soft middle\" x=\"{at:.1}\" y=\"{:.1}\">{}</text>",
            bottom + 18.0,
            tick_label(tick)
        );
    }
    let ticks = y.ticks();
    // A low panel has no room for all labels.
    let every = (ticks.len() as f64 * 20.0 / (bottom - top)).ceil().max(1.0) as usize;
    for (index, tick) in ticks.iter().enumerate() {
        let at = y.px(*tick);
        let _ = writeln!(out, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{RIGHT}\"/>");
        let label = match y.is_exceeded && index + 1 == ticks.len() {
            true => "lost".to_owned(),
            false => tick_label(*tick),
        };
        if index % every == 0 {
            let _ = writeln!(
                out,
                "<text class=\"soft end\" x=\"{:.1}\" y=\"{:.1}\">{label}</text>",
                LEFT - 8.0,
                at + 4.5
            );
        }
    }
    let middle = 0.5 * (top + bottom);
    let _ = writeln!(
        out,
        "<text class=\"middle\" transform=\"translate(24 {middle:.1}) rotate(-90)\">{label}</text>"
    );
    beneath(out);
    let mut ends = Vec::new();
    for line in lines {
        ends.extend(curve(out, x, y, line, points).map(|end_px| (line, end_px)));
    }
    end_labels(out, ends, bottom);
    let _ = writeln!(
        out,
        "<rect class=\"frame\" x=\"{LEFT}\" y=\"{top}\" width=\"{:.1}\" height=\"{:.1}\"/>",
        RIGHT - LEFT,
        bottom - top
    );
}

/// Draws a line with a dot at each point, interrupted where a point has no value. Returns where the line ends, if it has any
/// value.
fn curve(out: &mut String, x: &Axis, y: &Axis, line: &Line, points: &[JudgedPoint]) -> Option<f64> {
    let (mut path, mut dots, mut end_px) = (String::new(), String::new(), None);
    let mut pen = 'M';
    for judged in points {
        let Some(value) = (line.value)(&judged.point) else {
            pen = 'M';
            continue;
        };
        let (at_x, at_y) = (x.px(judged.point.offered_per_s), y.px(value));
        let _ = write!(path, "{pen}{at_x:.1} {at_y:.1}");
        let _ = writeln!(
            dots,
            "<circle class=\"dot {}\" cx=\"{at_x:.1}\" cy=\"{at_y:.1}\" r=\"3\"><title>{} {}</title></circle>",
            line.class,
            line.label,
            if value.is_finite() { three_digits(value) } else { "lost".to_owned() }
        );
        pen = 'L';
        end_px = Some(at_y);
    }
    if !path.is_empty() {
        let _ = writeln!(
            out,
            "<path class=\"line {}\" stroke-dasharray=\"{}\" d=\"{path}\"/>",
            line.class, line.dashes
        );
    }
    out.push_str(&dots);
    end_px
}

/// Places labels at the lines' ends so that none overlaps another or lies below the panel.
fn end_labels(out: &mut String, mut ends: Vec<(&Line, f64)>, bottom: f64) {
    const APART_PX: f64 = 15.0;
    ends.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut places: Vec<f64> = Vec::with_capacity(ends.len());
    for (_, end_px) in &ends {
        let free_px = places.last().map_or(f64::NEG_INFINITY, |last| last + APART_PX);
        places.push((end_px + 4.5).max(free_px));
    }
    let mut free_px = bottom + 2.0;
    for place in places.iter_mut().rev() {
        *place = place.min(free_px);
        free_px = *place - APART_PX;
    }
    for ((line, _), at) in ends.into_iter().zip(places) {
        let _ = writeln!(
            out,
            "<text class=\"{}\" x=\"{:.1}\" y=\"{at:.1}\">{}</text>",
            line.class,
            RIGHT + 10.0,
            line.label
        );
    }
}

/// Draws the throughput of a server that turns every request into a frame at once.
fn ideal(out: &mut String, x: &Axis, y: &Axis) {
    let most = x.high.min(y.high);
    let _ = writeln!(
        out,
        "<path class=\"line ideal\" d=\"M{:.1} {:.1}L{:.1} {:.1}\"><title>all that is offered</title></path>",
        x.px(0.0),
        y.px(0.0),
        x.px(most),
        y.px(most)
    );
    let _ = writeln!(
        out,
        "<text class=\"soft end\" x=\"{:.1}\" y=\"{:.1}\">as offered</text>",
        x.px(most) - 44.0,
        y.px(most) + 16.0
    );
}

fn knee(out: &mut String, x: &Axis, report: &Report) {
    let Some(rate) = report.knee.as_ref().and_then(|knee| knee.keeps_up_to_per_s) else { return };
    let at = x.px(rate);
    for [top, bottom] in [THROUGHPUT, LATENCY, UNANSWERED] {
        let _ = writeln!(out, "<path class=\"knee\" d=\"M{at:.1} {top}V{bottom}\"/>");
    }
    // The label stands on the side that has room for it.
    let (class, place) = if at > 0.5 * (LEFT + RIGHT) { ("end", at - 8.0) } else { ("", at + 8.0) };
    let _ = writeln!(
        out,
        "<text class=\"{class}\" x=\"{place:.1}\" y=\"{:.1}\">keeps up with {}/s</text>",
        THROUGHPUT[1] - 10.0,
        three_digits(rate)
    );
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::{point, report};
    use super::*;

    fn texts(svg: &str) -> Vec<String> {
        let document = roxmltree::Document::parse(svg).unwrap();
        let texts = document.descendants().filter(|node| node.has_tag_name("text"));
        texts.map(|node| node.text().unwrap_or_default().to_owned()).collect()
    }

    #[test]
    fn it_is_xml_with_every_label() {
        let svg = svg(&report(vec![point(40, 40), point(80, 80), point(200, 90)]));
        let texts = texts(&svg);
        for label in [
            "Frames under load",
            "<town> & \"country\" · w=64 format=jpeg",
            "frames per second",
            "latency since due, ms",
            "no frame, %",
            "offered requests per second",
            "frames",
            "p50",
            "p95",
            "p99",
            "p99.9",
            "refused",
            "lost",
            "failed",
            "keeps up with 80.0/s",
        ] {
            assert!(texts.iter().any(|text| text == label), "{label}: {texts:?}");
        }
        assert!(
            texts.iter().any(|text| text.starts_with("a <software> adapter · poisson arrivals"))
        );
    }

    /// Every coordinate is a number within the picture, even if there is nothing to draw.
    #[test]
    fn all_of_it_lies_in_the_picture() {
        for points in
            [vec![], vec![point(1, 0)], vec![point(1, 1)], vec![point(3, 3), point(9000, 8000)]]
        {
            let svg = svg(&report(points));
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            let document = roxmltree::Document::parse(&svg).unwrap();
            for node in document.descendants() {
                for (name, most) in [("x", WIDTH), ("cx", WIDTH), ("y", HEIGHT), ("cy", HEIGHT)] {
                    let Some(text) = node.attribute(name) else { continue };
                    let value: f64 = text.parse().unwrap();
                    assert!((0.0..=most).contains(&value), "{name}={text}");
                }
            }
        }
    }

    #[test]
    fn streams_have_lines_where_there_are_any() {
        use super::super::report::tests::point_with_stream;
        let has =
            |points, label: &str| texts(&svg(&report(points))).iter().any(|text| text == label);
        for label in ["stream p50", "stream p99", "on streams"] {
            assert!(!has(vec![point(40, 40)], label), "{label}");
            assert!(has(vec![point_with_stream(40, 40)], label), "{label}");
        }
        let svg = svg(&report(vec![point(20, 20), point_with_stream(40, 40)]));
        assert!(svg.contains("<title>stream p50 10.0</title>"), "{svg}");
    }

    /// A percentile among requests without an answer stands at the end of the axis, whose label says so.
    #[test]
    fn what_never_came_is_above_everything() {
        let svg = svg(&report(vec![point(40, 40), point(80, 80), point(200, 90)]));
        let document = roxmltree::Document::parse(&svg).unwrap();
        let dots = |label: &str| -> Vec<(String, f64)> {
            let titles = document.descendants().filter(|node| node.has_tag_name("title"));
            let of_line =
                titles.filter(|node| node.text().is_some_and(|text| text.starts_with(label)));
            let place =
                |node: roxmltree::Node<'_, '_>| node.parent()?.attribute("cy")?.parse().ok();
            of_line.map(|node| (node.text().unwrap().to_owned(), place(node).unwrap())).collect()
        };
        assert_eq!((dots("p50 ").len(), dots("p99 ").len(), dots("frames ").len()), (3, 3, 3));
        assert_eq!(dots("p99 ")[2], ("p99 lost".to_owned(), LATENCY[0]));
        assert!(dots("p50 ")[2].1 > LATENCY[0] && dots("p99 ")[1].1 > LATENCY[0]);
        assert_eq!(texts(&svg).iter().filter(|text| *text == "lost").count(), 2);
    }

    #[test]
    fn labels_at_ends_keep_apart() {
        let mut out = String::new();
        let ends = UNANSWERED_LINES.iter().map(|line| (line, 680.0)).collect();
        end_labels(&mut out, ends, 680.0);
        for y in ["652.0", "667.0", "682.0"] {
            assert!(out.contains(&format!("y=\"{y}\"")), "{out}");
        }
    }

    #[test]
    fn axes_have_round_ticks() {
        let linear = Axis::linear(187.0, 0.0, 100.0);
        assert_eq!(linear.ticks(), [0.0, 50.0, 100.0, 150.0, 200.0]);
        assert_eq!(linear.px(50.0), 25.0);
        let decades = Axis::decades([0.4, 70.0].into_iter(), 0.0, 300.0);
        assert_eq!(decades.ticks().len(), 4);
        assert!((decades.px(1.0) - 100.0).abs() < 1e-9);
        assert_eq!(tick_label(0.1), "0.1");
    }

    #[test]
    fn names_cannot_break_out() {
        assert_eq!(escaped("<b>&\u{1}\"é\n"), "&lt;b&gt;&amp;&quot;é");
        assert_eq!(shortened(&"x".repeat(500), MOST_LETTERS).chars().count(), 112);
    }
}
