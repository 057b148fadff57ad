//! What the plots of reports share: the style, the axes of time and error, marks, and labels that keep clear of each other.
//!
//! The SVGs have no scripts and no outside files. Their colours follow the reader's colour scheme, light or dark. Groups of points differ in
//! their shapes as well as in their colours.

use std::fmt::Write;

use crate::accuracy::sweep::Quartiles;
use crate::markup::{escaped, shortened};

pub(super) const WIDTH: f64 = 980.0;
pub(super) const LEFT: f64 = 72.0;
pub(super) const RIGHT: f64 = WIDTH - 24.0;
/// Height below a plot for the numbers and the title of its axis.
pub(super) const BELOW: f64 = 58.0;
/// Characters of a line of the heading.
const MOST_LETTERS: usize = 128;
/// Width of a letter of a label, and height of a label, in pixels.
const LETTER: f64 = 6.4;
const LABEL_HEIGHT: f64 = 14.0;
/// Number of colours and of shapes.
pub(super) const KINDS: usize = 6;

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
  .curve { fill: none; stroke-width: 1.8; }
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

/// Begins an image of this height: the title, and further lines, each with its class and the height at which it stands.
pub(super) fn begin(height: f64, title: &str, lines: &[(f64, &str, &str)]) -> String {
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" role=\"img\" aria-labelledby=\"title\">\n<style>\n{STYLE}</style>\n<rect class=\"paper\" width=\"{WIDTH}\" height=\"{height}\"/>\n\
         <text class=\"title\" id=\"title\" x=\"{LEFT}\" y=\"28\">{}</text>\n",
        escaped(title)
    );
    for (y, class, text) in lines {
        let text = escaped(&shortened(text.trim(), MOST_LETTERS));
        let _ = writeln!(out, "<text class=\"{class}\" x=\"{LEFT}\" y=\"{y}\">{text}</text>");
    }
    out
}

/// The area of a plot: time grows to the right, on a logarithmic axis, and decibels grow upwards.
pub(super) struct Area {
    x: Axis,
    y: Axis,
}

impl Area {
    /// An area with room for all points, which are times in milliseconds and decibels.
    pub(super) fn around(points: &[(Quartiles, f64)], [top, bottom]: [f64; 2]) -> Area {
        let times = points.iter().flat_map(|(time, _)| [time.low.log10(), time.high.log10()]);
        Area {
            x: Axis::around(times, [LEFT, RIGHT], 0.3),
            y: Axis::around(points.iter().map(|point| point.1), [bottom, top], 2.0),
        }
    }

    pub(super) fn place(&self, (time, decibels): (Quartiles, f64)) -> (f64, f64) {
        (self.x.px(time.median.log10()), self.y.px(decibels))
    }

    fn top(&self) -> f64 {
        self.y.to_px
    }

    fn bottom(&self) -> f64 {
        self.y.from_px
    }

    /// The lines of the grid with their numbers, the frame, and the titles of the axes.
    pub(super) fn grid(&self, out: &mut String) {
        let (top, bottom) = (self.top(), self.bottom());
        for tick in self.x.ticks_of_logarithms() {
            let at = self.x.px(tick.log10());
            let _ = writeln!(
                out,
                "<path class=\"grid\" d=\"M{at:.1} {top}V{bottom}\"/><text class=\"soft middle\" x=\"{at:.1}\" y=\"{}\">{}</text>",
                bottom + 18.0,
                number(tick)
            );
        }
        for tick in self.y.ticks() {
            let at = self.y.px(tick);
            let _ = writeln!(
                out,
                "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{RIGHT}\"/><text class=\"soft end\" x=\"{}\" y=\"{:.1}\">{}</text>",
                LEFT - 8.0,
                at + 4.5,
                number(tick)
            );
        }
        let (middle, centre) = (0.5 * (LEFT + RIGHT), 0.5 * (top + bottom));
        let _ = writeln!(
            out,
            "<rect class=\"frame\" x=\"{LEFT}\" y=\"{top}\" width=\"{}\" height=\"{}\"/>\n\
             <text class=\"middle\" x=\"{middle}\" y=\"{}\">GPU time of a frame in milliseconds, logarithmic; bars from the lower to the upper quartile</text>\n\
             <text class=\"middle\" transform=\"rotate(-90 22 {centre})\" x=\"22\" y=\"{centre}\">PSNR against the reference, dB</text>",
            RIGHT - LEFT,
            bottom - top,
            bottom + 42.0
        );
    }

    /// The bar of a point's quartiles, in the colour of its group.
    pub(super) fn bar(&self, out: &mut String, point: (Quartiles, f64), group: usize) {
        let (time, (_, at)) = (point.0, self.place(point));
        let (low, high) = (self.x.px(time.low.log10()), self.x.px(time.high.log10()));
        let _ = writeln!(
            out,
            "<path class=\"bar c{}\" d=\"M{low:.1} {at:.1}H{high:.1}M{low:.1} {:.1}v6M{high:.1} {:.1}v6\"/>",
            group % KINDS,
            at - 3.0,
            at - 3.0
        );
    }

    /// Writes a label beside a point, unless all places there are taken.
    pub(super) fn label(
        &self,
        out: &mut String,
        text: &str,
        at: (f64, f64),
        taken: &mut Vec<[f64; 4]>,
    ) {
        let width = LETTER * text.chars().count() as f64;
        if let Some([left, _, _, bottom]) = self.room(at, width, taken) {
            taken.push([left, bottom - LABEL_HEIGHT, left + width, bottom]);
            let _ = writeln!(
                out,
                "<text class=\"label\" x=\"{left:.1}\" y=\"{:.1}\">{}</text>",
                bottom - 3.0,
                escaped(text)
            );
        }
    }

    /// A place beside a point for a label of this width that covers nothing which is taken; `None` where there is none.
    fn room(&self, (x, y): (f64, f64), width: f64, taken: &[[f64; 4]]) -> Option<[f64; 4]> {
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
            *left >= LEFT && *right <= RIGHT && *top >= self.top() && *bottom <= self.bottom()
        };
        let overlaps =
            |a: &[f64; 4], b: &[f64; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
        let mut free =
            boxes.filter(is_inside).filter(|own| !taken.iter().any(|other| overlaps(own, other)));
        free.next()
    }
}

/// The box that the mark of a point covers.
pub(super) fn box_of((x, y): (f64, f64)) -> [f64; 4] {
    [x - 5.0, y - 5.0, x + 5.0, y + 5.0]
}

/// A line through the marks of points, of a class.
pub(super) fn line(out: &mut String, class: &str, places: &[(f64, f64)]) {
    let points: Vec<String> = places.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(out, "<polyline class=\"{class}\" points=\"{}\"/>", points.join(" "));
}

/// A number without needless digits.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The mark of a group: its shape around a place.
pub(super) fn mark(group: usize, (x, y): (f64, f64), class: &str, title: &str) -> String {
    let path = match group % 6 {
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
        let area = Area::around(&[], [100.0, 500.0]);
        let (mut taken, at) = (Vec::new(), (400.0, 300.0));
        for _ in 0..5 {
            let own = area.room(at, 80.0, &taken).unwrap();
            assert!(taken.iter().all(|other: &[f64; 4]| own[0] >= other[2]
                || other[0] >= own[2]
                || own[1] >= other[3]
                || other[1] >= own[3]));
            taken.push(own);
        }
        assert_eq!(area.room((LEFT, 100.0), 2.0 * WIDTH, &[]), None);
    }
}
