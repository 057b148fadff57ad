//! The plot of a survey as an SVG: error against GPU time, with quartiles and the Pareto front.
//!
//! The SVG has no scripts and no outside files. Its colours follow the reader's colour scheme, light or dark. Families of settings differ in
//! their shapes as well as in their colours.

use std::fmt::Write;

use crate::accuracy::results::{Entry, Results, Scope, three_digits};
use crate::markup::{escaped, shortened};

const WIDTH: f64 = 980.0;
/// Characters of a line of the heading.
const MOST_LETTERS: usize = 128;
const HEIGHT: f64 = 620.0;
const LEFT: f64 = 72.0;
const RIGHT: f64 = WIDTH - 24.0;
const TOP: f64 = 118.0;
const BOTTOM: f64 = HEIGHT - 58.0;
/// Width of a letter of a label, and height of a label, in pixels.
const LETTER: f64 = 6.4;
const LABEL_HEIGHT: f64 = 14.0;

const STYLE: &str = "\
  svg { --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --grid: #e3e8ed; --c0: #0a58ca; --c1: #b5176b; --c2: #1a7f37; --c3: #9a6700; --c4: #6f42c1; --c5: #0b7285; }
  @media (prefers-color-scheme: dark) {
    svg { --paper: #0d1117; --ink: #e6edf3; --soft: #9aa4af; --grid: #232a32; --c0: #6cb0ff; --c1: #ff8ac4; --c2: #56d364; --c3: #e3b341; --c4: #b69cff; --c5: #4dd0e1; }
  }
  text { font: 13px system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif; fill: var(--ink); }
  .title { font-size: 18px; font-weight: 600; }
  .soft { fill: var(--soft); }
  .end { text-anchor: end; }
  .middle { text-anchor: middle; }
  .label { font-size: 11.5px; paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
  .paper { fill: var(--paper); }
  .grid { stroke: var(--grid); stroke-width: 1; }
  .frame { stroke: var(--soft); stroke-width: 1; fill: none; }
  .front { fill: none; stroke: var(--ink); stroke-width: 1.5; stroke-dasharray: 6 3; }
  .usual { fill: none; stroke: var(--ink); stroke-width: 1.2; stroke-dasharray: 2 2; }
  .bar { stroke-width: 1.2; opacity: 0.55; }
  .dot { fill: var(--paper); fill-opacity: 0.6; stroke-width: 1.6; }
  .best { fill-opacity: 1; }
  .c0 { stroke: var(--c0); } .c1 { stroke: var(--c1); } .c2 { stroke: var(--c2); } .c3 { stroke: var(--c3); } .c4 { stroke: var(--c4); } .c5 { stroke: var(--c5); }
  .f0 { fill: var(--c0); } .f1 { fill: var(--c1); } .f2 { fill: var(--c2); } .f3 { fill: var(--c3); } .f4 { fill: var(--c4); } .f5 { fill: var(--c5); }
";

// Writing to a string cannot fail, so results of `write!` are dropped below.

/// Range of values on an axis, and where it lies in the image.
struct Axis {
    low: f64,
    high: f64,
    from_px: f64,
    to_px: f64,
}

impl Axis {
    /// An axis around all values, with a margin of a twentieth on both sides.
    fn around(values: impl Iterator<Item = f64>, [from_px, to_px]: [f64; 2], least: f64) -> Axis {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values.filter(|value| value.is_finite()) {
            (low, high) = (low.min(value), high.max(value));
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let margin = (0.05 * (high - low)).max(0.5 * (least - (high - low)));
        Axis { low: low - margin, high: high + margin, from_px, to_px }
    }

    fn px(&self, value: f64) -> f64 {
        let share = ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        self.from_px + share * (self.to_px - self.from_px)
    }

    /// Multiples of 1, 2 or 5 times a power of ten, at most eleven of them.
    fn ticks(&self) -> Vec<f64> {
        let rough = (self.high - self.low) / 10.0;
        let power = 10f64.powf(rough.log10().floor());
        let steps = [1.0, 2.0, 5.0, 10.0].map(|times| times * power);
        let step = steps.into_iter().find(|step| *step >= rough).unwrap_or(rough);
        let first = (self.low / step).ceil() as i64;
        (first..).map(|tick| tick as f64 * step).take_while(|tick| *tick <= self.high).collect()
    }

    /// 1, 2 and 5 times powers of ten on an axis of decimal logarithms, or powers alone where these are many.
    fn ticks_of_logarithms(&self) -> Vec<f64> {
        let decades = self.low.floor() as i32..=self.high.ceil() as i32;
        let steps: &[f64] = if self.high - self.low > 4.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        decades
            .flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)))
            .filter(|value| (self.low..=self.high).contains(&value.log10()))
            .collect()
    }
}

/// The plot of the first scope: all poses, or the only one.
pub fn svg(results: &Results) -> String {
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" aria-labelledby=\"title\">\n<style>\n{STYLE}</style>\n<rect class=\"paper\" width=\"{WIDTH}\" height=\"{HEIGHT}\"/>\n"
    );
    let identity = &results.identity;
    let subject = format!(
        "{} · {}x{} · {} · {}",
        identity.scene, identity.width, identity.height, identity.adapter, results.date
    );
    let first = results.summary.split_inclusive(". ").next().unwrap_or_default();
    for (y, class, text) in [
        (28.0, "title", "What accuracy costs in time"),
        (49.0, "soft", &subject),
        (69.0, "", first),
    ] {
        let id = if class == "title" { " id=\"title\"" } else { "" };
        let _ = writeln!(
            out,
            "<text class=\"{class}\"{id} x=\"{LEFT}\" y=\"{y}\">{}</text>",
            escaped(&shortened(text.trim(), MOST_LETTERS))
        );
    }
    if let Some(scope) = results.scopes.first() {
        plot(&mut out, scope);
    }
    out += "</svg>\n";
    out
}

fn time(entry: &Entry) -> f64 {
    entry.gpu_ms.map_or(f64::NAN, |time| time.median)
}

fn plot(out: &mut String, scope: &Scope) {
    let entries: Vec<&Entry> = scope.plotted().collect();
    let mut families: Vec<&str> = Vec::new();
    for entry in &entries {
        if !families.contains(&entry.family.as_str()) {
            families.push(&entry.family);
        }
    }
    let times = entries.iter().filter_map(|entry| entry.gpu_ms);
    let times = times.flat_map(|time| [time.low.log10(), time.high.log10()]);
    let x = Axis::around(times, [LEFT, RIGHT], 0.3);
    let y = Axis::around(entries.iter().map(|entry| entry.decibels()), [BOTTOM, TOP], 2.0);
    grid(out, &x, &y);
    legend(out, &families);
    let family =
        |entry: &Entry| families.iter().position(|name| *name == entry.family).unwrap_or(0);
    let place = |entry: &Entry| (x.px(time(entry).log10()), y.px(entry.decibels()));
    for entry in &entries {
        if let Some(time) = entry.gpu_ms {
            let (_, at) = place(entry);
            let (low, high) = (x.px(time.low.log10()), x.px(time.high.log10()));
            let _ = writeln!(
                out,
                "<path class=\"bar c{}\" d=\"M{low:.1} {at:.1}H{high:.1}M{low:.1} {:.1}v6M{high:.1} {:.1}v6\"/>",
                family(entry) % 6,
                at - 3.0,
                at - 3.0
            );
        }
    }
    let front: Vec<&Entry> =
        scope.fronts["psnr"].iter().filter_map(|row| scope.entry(row)).collect();
    let points: Vec<String> =
        front.iter().map(|entry| place(entry)).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(out, "<polyline class=\"front\" points=\"{}\"/>", points.join(" "));
    for entry in &entries {
        let number = family(entry);
        let is_best = entry.is_on(scope, "psnr");
        let class = if is_best {
            format!("dot best c{0} f{0}", number % 6)
        } else {
            format!("dot c{}", number % 6)
        };
        let is_default = scope.default.as_ref() == Some(&entry.row);
        if is_default {
            let (x, y) = place(entry);
            let _ = writeln!(out, "<circle class=\"usual\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"8\"/>");
        }
        let title = format!(
            "{}{}: {} ms, {:.2} dB{}",
            entry.row,
            if is_default { " (default)" } else { "" },
            three_digits(time(entry)),
            entry.decibels(),
            if is_best { ", on the Pareto front" } else { "" }
        );
        let _ = writeln!(out, "{}", mark(number, place(entry), &class, &title));
    }
    let mut taken: Vec<[f64; 4]> = front
        .iter()
        .map(|entry| place(entry))
        .map(|(x, y)| [x - 5.0, y - 5.0, x + 5.0, y + 5.0])
        .collect();
    for entry in &front {
        let (text, at) = (escaped(&entry.row), place(entry));
        let width = LETTER * entry.row.chars().count() as f64;
        if let Some([left, _, _, bottom]) = room(at, width, &taken) {
            taken.push([left, bottom - LABEL_HEIGHT, left + width, bottom]);
            let _ = writeln!(
                out,
                "<text class=\"label\" x=\"{left:.1}\" y=\"{:.1}\">{text}</text>",
                bottom - 3.0
            );
        }
    }
}

/// A place beside a point for a label of this width that covers nothing which is taken; `None` where there is none.
fn room((x, y): (f64, f64), width: f64, taken: &[[f64; 4]]) -> Option<[f64; 4]> {
    let offsets = [
        (9.0, 5.0),
        (-9.0 - width, 5.0),
        (6.0, -6.0),
        (-6.0 - width, -6.0),
        (6.0, 18.0),
        (-6.0 - width, 18.0),
        (-0.5 * width, -10.0),
        (-0.5 * width, 22.0),
    ];
    let boxes = offsets.into_iter().flat_map(|(dx, dy)| {
        [0.0, -13.0, 13.0].map(|shift| {
            let (left, bottom) = (x + dx, y + dy + shift);
            [left, bottom - LABEL_HEIGHT, left + width, bottom]
        })
    });
    let is_inside = |[left, top, right, bottom]: &[f64; 4]| {
        *left >= LEFT && *right <= RIGHT && *top >= TOP && *bottom <= BOTTOM
    };
    let overlaps =
        |a: &[f64; 4], b: &[f64; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    let mut free =
        boxes.filter(is_inside).filter(|own| !taken.iter().any(|other| overlaps(own, other)));
    free.next()
}

fn grid(out: &mut String, x: &Axis, y: &Axis) {
    for tick in x.ticks_of_logarithms() {
        let at = x.px(tick.log10());
        let _ = writeln!(
            out,
            "<path class=\"grid\" d=\"M{at:.1} {TOP}V{BOTTOM}\"/><text class=\"soft middle\" x=\"{at:.1}\" y=\"{}\">{}</text>",
            BOTTOM + 18.0,
            number(tick)
        );
    }
    for tick in y.ticks() {
        let at = y.px(tick);
        let _ = writeln!(
            out,
            "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{RIGHT}\"/><text class=\"soft end\" x=\"{}\" y=\"{:.1}\">{}</text>",
            LEFT - 8.0,
            at + 4.5,
            number(tick)
        );
    }
    let (middle, centre) = (0.5 * (LEFT + RIGHT), 0.5 * (TOP + BOTTOM));
    let _ = writeln!(
        out,
        "<rect class=\"frame\" x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\"/>\n\
         <text class=\"middle\" x=\"{middle}\" y=\"{}\">GPU time of a frame in milliseconds, logarithmic; bars from the lower to the upper quartile</text>\n\
         <text class=\"middle\" transform=\"rotate(-90 22 {centre})\" x=\"22\" y=\"{centre}\">PSNR against the reference, dB</text>",
        RIGHT - LEFT,
        BOTTOM - TOP,
        HEIGHT - 16.0
    );
}

/// A number without needless digits.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn legend(out: &mut String, families: &[&str]) {
    let mut at = LEFT;
    for (number, name) in families.iter().enumerate() {
        let class = format!("dot best c{0} f{0}", number % 6);
        let _ = writeln!(
            out,
            "{}<text x=\"{:.1}\" y=\"98\">{}</text>",
            mark(number, (at + 5.0, 93.5), &class, name),
            at + 14.0,
            escaped(name)
        );
        at += 34.0 + 7.4 * name.chars().count() as f64;
    }
    let _ = writeln!(
        out,
        "<path class=\"front\" d=\"M{at:.1} 93.5h26\"/><text x=\"{:.1}\" y=\"98\">Pareto front (filled)</text>\
         <circle class=\"usual\" cx=\"{:.1}\" cy=\"93.5\" r=\"7\"/><text x=\"{:.1}\" y=\"98\">default</text>",
        at + 32.0,
        at + 178.0,
        at + 190.0
    );
}

/// The mark of a family: its shape around a place.
fn mark(family: usize, (x, y): (f64, f64), class: &str, title: &str) -> String {
    let path = match family % 6 {
        0 => format!("M{:.1} {y:.1}a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0Z", x - 4.5),
        1 => format!("M{:.1} {:.1}h8v8h-8Z", x - 4.0, y - 4.0),
        2 => format!("M{x:.1} {:.1}l5 9h-10Z", y - 5.5),
        3 => format!("M{x:.1} {:.1}l5.5 5.5l-5.5 5.5l-5.5 -5.5Z", y - 5.5),
        4 => format!("M{x:.1} {:.1}l5 -9h-10Z", y + 5.5),
        _ => format!("M{:.1} {:.1}h4l3 3.5l-3 3.5h-4l-3 -3.5Z", x - 2.0, y - 3.5),
    };
    format!("<path class=\"{class}\" d=\"{path}\"><title>{}</title></path>", escaped(title))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;

    #[test]
    fn the_plot_is_well_formed_and_has_the_front_and_its_labels() {
        let text = svg(&results());
        let document = roxmltree::Document::parse(&text).unwrap();
        let find = |class: &str| {
            let has = |node: &roxmltree::Node<'_, '_>| {
                node.attribute("class").is_some_and(|all| all.split(' ').any(|one| one == class))
            };
            document.descendants().filter(has).collect::<Vec<_>>()
        };
        // Two families in the legend, and three rows.
        assert_eq!(find("dot").len(), 6);
        assert_eq!(find("bar").len(), 3);
        // The default in the legend and in the plot.
        assert_eq!(find("usual").len(), 2);
        let front: Vec<_> =
            find("front").into_iter().filter_map(|node| node.attribute("points")).collect();
        assert_eq!(front.len(), 1);
        assert_eq!(front[0].split(' ').count(), 2);
        let labels: Vec<_> = find("label").iter().filter_map(|node| node.text()).collect();
        assert_eq!(labels, ["fast way", "good way"]);
        assert!(text.contains("prefers-color-scheme: dark"));
    }

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let axis = Axis::around([27.3, 41.9].into_iter(), [0.0, 100.0], 2.0);
        assert_eq!(axis.ticks(), [28.0, 30.0, 32.0, 34.0, 36.0, 38.0, 40.0, 42.0]);
        assert_eq!((axis.px(-1e9), axis.px(1e9)), (0.0, 100.0));
        let axis = Axis::around([0.2, 2.1].into_iter(), [0.0, 100.0], 0.3);
        assert_eq!(axis.ticks_of_logarithms(), [2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        let lone = Axis::around([30.0].into_iter(), [0.0, 100.0], 2.0);
        assert_eq!((lone.low, lone.high, lone.px(30.0)), (29.0, 31.0, 50.0));
        let none = Axis::around(std::iter::empty(), [0.0, 100.0], 2.0);
        assert!(none.low < none.high);
    }

    #[test]
    fn labels_avoid_each_other() {
        let (mut taken, at) = (Vec::new(), (400.0, 300.0));
        for _ in 0..5 {
            let own = room(at, 80.0, &taken).unwrap();
            assert!(taken.iter().all(|other: &[f64; 4]| own[0] >= other[2]
                || other[0] >= own[2]
                || own[1] >= other[3]
                || other[1] >= own[3]));
            taken.push(own);
        }
        assert_eq!(room((LEFT, TOP), 2.0 * WIDTH, &[]), None);
    }
}
