//! What one more decibel costs in several scenes, as a plot (SVG) and as a page of Markdown.

use std::fmt::Write;

use super::markdown::cell;
use super::plot::{Area, BELOW, KINDS, LEFT, begin, box_of, line, mark};
use crate::accuracy::cost::{Costs, Curve, Point};
use crate::accuracy::results::three_digits;
use crate::accuracy::sweep::Quartiles;

/// Height of the plot's area, of the head above the answers, and of an answer.
const AREA: f64 = 430.0;
const HEAD: f64 = 80.0;
const ANSWER: f64 = 20.0;

// Writing to a string cannot fail, so results of `write!` are dropped below.

/// The Pareto fronts of all scenes in one plot, with the answers in words above it.
pub fn cost_svg(costs: &Costs) -> String {
    let adapters = distinct(&costs.curves, |curve| curve.adapter.clone());
    let sizes = distinct(&costs.curves, |curve| format!("{}x{}", curve.width, curve.height));
    let dates = distinct(&costs.curves, |curve| day(&curve.date).to_owned());
    let subject = format!("{adapters} · {sizes} · {dates}");
    let top = HEAD + ANSWER * costs.curves.len() as f64 + 4.0;
    let height = top + AREA + BELOW;
    let lines = [(49.0, "soft", subject.as_str()), (70.0, "", costs.summary.as_str())];
    let mut out = begin(height, "What does one more decibel cost?", &lines);
    let place = |point: &Point| (point.gpu_ms, point.decibels());
    let points: Vec<(Quartiles, f64)> =
        costs.curves.iter().flat_map(|curve| &curve.points).map(place).collect();
    let area = Area::around(&points, [top, top + AREA]);
    area.grid(&mut out);
    let mut taken = Vec::new();
    for (number, curve) in costs.curves.iter().enumerate() {
        let y = HEAD + ANSWER * number as f64 + 8.0;
        let class = format!("dot best c{0} f{0}", number % KINDS);
        let _ = writeln!(
            out,
            "{}<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            mark(number, (LEFT + 6.0, y), &class, curve.name()),
            LEFT + 20.0,
            y + 4.5,
            crate::markup::escaped(&curve.answer())
        );
        let places: Vec<(f64, f64)> =
            curve.points.iter().map(|point| area.place(place(point))).collect();
        for point in &curve.points {
            area.bar(&mut out, place(point), number);
        }
        line(&mut out, &format!("curve c{}", number % KINDS), &places);
        for (point, at) in curve.points.iter().zip(&places) {
            let title = format!(
                "{}, {}: {} ms, {}",
                curve.name(),
                point.label,
                three_digits(point.gpu_ms.median),
                decibels(point)
            );
            let _ = writeln!(out, "{}", mark(number, *at, &class, &title));
        }
        taken.extend(places.iter().copied().map(box_of));
    }
    for curve in &costs.curves {
        for point in &curve.points {
            area.label(&mut out, &point.label, area.place(place(point)), &mut taken);
        }
    }
    out += "</svg>\n";
    out
}

/// The answers, what each level of PSNR costs in each scene, and the points of the fronts.
pub fn cost_markdown(costs: &Costs) -> String {
    let mut out = format!("# What does one more decibel cost?\n\n{}\n\n", costs.summary);
    for curve in &costs.curves {
        let _ = writeln!(out, "- {}.", cell(&curve.answer()));
    }
    out += "\nA frame with at least so many decibels takes the time of the fastest setting that has them; × is that time over the time of the \
        level above it in the table.\n\n| at least |";
    for curve in &costs.curves {
        let _ = write!(out, " {} | GPU, ms | × |", cell(curve.name()));
    }
    out += "\n|---|";
    out += &"---|--:|--:|".repeat(costs.curves.len());
    out += "\n";
    for level in &costs.levels {
        let _ = write!(out, "| {:.0} dB |", level.least_db);
        for reached in &level.scenes {
            let _ = match reached {
                None => write!(out, " not reached | – | – |"),
                Some(at) => write!(
                    out,
                    " {} | {} | {} |",
                    cell(&at.label),
                    three_digits(at.gpu_ms),
                    at.times.map_or("–".to_owned(), three_digits)
                ),
            };
        }
        out += "\n";
    }
    out += "\nThe Pareto fronts: no other setting is both faster and closer to the reference, beyond the noise of the times.\n\n| scene | setting | GPU, ms (quartiles) | PSNR |\n|---|---|---|---|\n";
    for curve in &costs.curves {
        for point in &curve.points {
            let [low, median, high] =
                [point.gpu_ms.low, point.gpu_ms.median, point.gpu_ms.high].map(three_digits);
            let _ = writeln!(
                out,
                "| {} | {} | {median} ({low}–{high}) | {} |",
                cell(curve.name()),
                cell(&point.label),
                decibels(point)
            );
        }
    }
    out += "\n| scene | poses | frames | adapter and driver | date (UTC) | version | reference |\n|---|---|---|---|---|---|---|\n";
    for curve in &costs.curves {
        let Curve {
            scene, poses, width, height, repeats, adapter, date, version, reference, ..
        } = curve;
        let _ = writeln!(
            out,
            "| {} | {} | {width}x{height}, {repeats} times | {} | {} | pointillist {} | {} |",
            cell(scene),
            cell(poses),
            cell(adapter),
            cell(date),
            cell(version),
            cell(reference)
        );
    }
    out
}

fn decibels(point: &Point) -> String {
    point.psnr_db.map_or("equal to the reference".to_owned(), |db| format!("{db:.2} dB"))
}

/// The day of a date with a time.
fn day(date: &str) -> &str {
    date.split(' ').next().unwrap_or(date)
}

/// The different values of all curves, in order.
fn distinct(curves: &[Curve], of: impl Fn(&Curve) -> String) -> String {
    let mut found: Vec<String> = Vec::new();
    for value in curves.iter().map(of) {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::cost::tests::costs;

    #[test]
    fn the_plot_has_a_curve_bars_and_an_answer_for_each_scene() {
        let text = cost_svg(&costs());
        let document = roxmltree::Document::parse(&text).unwrap();
        let find = |class: &str| {
            let has = |node: &roxmltree::Node<'_, '_>| {
                node.attribute("class").is_some_and(|all| all.split(' ').any(|one| one == class))
            };
            document.descendants().filter(has).collect::<Vec<_>>()
        };
        let curves: Vec<usize> = find("curve")
            .iter()
            .filter_map(|node| node.attribute("points"))
            .map(|points| points.split(' ').count())
            .collect();
        assert_eq!(curves, [3, 1]);
        // Each point has a bar and a mark, and each scene a mark beside its answer.
        assert_eq!((find("bar").len(), find("dot").len()), (4, 6));
        for expected in [
            "town: 15 % more time for one more decibel",
            "lone: no slower setting is more exact",
            "One more decibel costs 15 % more time on average (rough: ",
            "A · 4x3 · 2026-01-02",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }

    #[test]
    fn the_page_has_levels_fronts_and_circumstances() {
        let text = cost_markdown(&costs());
        for expected in [
            "| 25 dB | fast | 2.00 | – | only | 5.00 | – |",
            "| 30 dB | good &lt;way> | 8.00 | 4.00 | only | 5.00 | 1.00 |",
            "| 35 dB | good &lt;way> | 8.00 | 1.00 | not reached | – | – |",
            "| town | exact | 20.0 (18.0–24.0) | equal to the reference |",
            "| town.json | all poses | 4x3, 3 times | A | 2026-01-02 | pointillist 1 | the reference |",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
    }
}
