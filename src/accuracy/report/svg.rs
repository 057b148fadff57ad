//! The plot of a survey as an SVG: error against GPU time, with quartiles and the Pareto front.

use std::fmt::Write;

use super::plot::{Area, BELOW, KINDS, LEFT, begin, box_of, line, mark};
use crate::accuracy::results::{Entry, Results, Scope, three_digits};
use crate::accuracy::sweep::Quartiles;
use crate::markup::escaped;

const HEIGHT: f64 = 620.0;
const TOP: f64 = 118.0;

// Writing to a string cannot fail, so results of `write!` are dropped below.

/// The plot of the first scope: all poses, or the only one.
pub fn svg(results: &Results) -> String {
    let identity = &results.identity;
    let subject = format!(
        "{} · {}x{} · {} · {}",
        identity.scene, identity.width, identity.height, identity.adapter, results.date
    );
    let first = results.summary.split_inclusive(". ").next().unwrap_or_default();
    let lines = [(49.0, "soft", subject.as_str()), (69.0, "", first)];
    let mut out = begin(HEIGHT, "What accuracy costs in time", &lines);
    if let Some(scope) = results.scopes.first() {
        plot(&mut out, scope);
    }
    out += "</svg>\n";
    out
}

fn plot(out: &mut String, scope: &Scope) {
    let entries: Vec<(&Entry, Quartiles)> =
        scope.plotted().filter_map(|entry| Some((entry, entry.gpu_ms?))).collect();
    let mut families: Vec<&str> = Vec::new();
    for (entry, _) in &entries {
        if !families.contains(&entry.family.as_str()) {
            families.push(&entry.family);
        }
    }
    let points: Vec<(Quartiles, f64)> =
        entries.iter().map(|(entry, time)| (*time, entry.decibels())).collect();
    let area = Area::around(&points, [TOP, HEIGHT - BELOW]);
    area.grid(out);
    legend(out, &families);
    let family =
        |entry: &Entry| families.iter().position(|name| *name == entry.family).unwrap_or(0);
    for (point, (entry, _)) in points.iter().zip(&entries) {
        area.bar(out, *point, family(entry));
    }
    let front: Vec<(&Entry, (f64, f64))> = scope.fronts["psnr"]
        .iter()
        .filter_map(|row| scope.entry(row))
        .filter_map(|entry| Some((entry, area.place((entry.gpu_ms?, entry.decibels())))))
        .collect();
    let places: Vec<(f64, f64)> = front.iter().map(|(_, place)| *place).collect();
    line(out, "front", &places);
    for (point, (entry, time)) in points.iter().zip(&entries) {
        let (number, place) = (family(entry), area.place(*point));
        let is_best = entry.is_on(scope, "psnr");
        let class = if is_best {
            format!("dot best c{0} f{0}", number % KINDS)
        } else {
            format!("dot c{}", number % KINDS)
        };
        let is_default = scope.default.as_ref() == Some(&entry.row);
        if is_default {
            let (x, y) = place;
            let _ = writeln!(out, "<circle class=\"usual\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"8\"/>");
        }
        let title = format!(
            "{}{}: {} ms, {:.2} dB{}",
            entry.row,
            if is_default { " (default)" } else { "" },
            three_digits(time.median),
            entry.decibels(),
            if is_best { ", on the Pareto front" } else { "" }
        );
        let _ = writeln!(out, "{}", mark(number, place, &class, &title));
    }
    let mut taken: Vec<[f64; 4]> = places.iter().copied().map(box_of).collect();
    for (entry, place) in &front {
        area.label(out, &entry.row, *place, &mut taken);
    }
}

fn legend(out: &mut String, families: &[&str]) {
    let mut at = LEFT;
    for (number, name) in families.iter().enumerate() {
        let class = format!("dot best c{0} f{0}", number % KINDS);
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
}
