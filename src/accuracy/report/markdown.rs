//! The report as a page of Markdown.

use std::fmt::Write;

use crate::accuracy::journal::{Identity, PathRecord};
use crate::accuracy::results::{Along, Entry, Results, Scope, three_digits};

// Writing to a string cannot fail, so results of `write!` are dropped below.

/// The whole page: the summary, what was measured, a table of all rows, and the front of each pose.
pub fn markdown(results: &Results) -> String {
    let Identity { scene, adapter, version, width, height, repeats, seed, reference, .. } =
        &results.identity;
    let mut out =
        format!("# What accuracy costs in time: {}\n\n{}\n\n", cell(scene), cell(&results.summary));
    out += "| | |\n|---|---|\n";
    let poses: Vec<&str> = results.identity.poses.iter().map(|pose| pose.name.as_str()).collect();
    for (name, value) in [
        ("scene", scene.clone()),
        ("adapter and driver", adapter.clone()),
        ("date (UTC)", results.date.clone()),
        ("version", format!("pointillist {version}")),
        (
            "frames",
            format!("{width}x{height}, each timed {repeats} times in random order (seed {seed})"),
        ),
        ("poses", poses.join(", ")),
        ("reference", reference.clone()),
    ] {
        let _ = writeln!(out, "| {name} | {} |", cell(&value));
    }
    out += "\nTimes are GPU timestamps of all passes of a frame: the median, with the quartiles in parentheses. **●** marks the Pareto front: no \
        other setting is both faster and closer to the reference in PSNR.\n";
    for (number, scope) in results.scopes.iter().enumerate() {
        let _ = writeln!(out, "\n## {}\n", cell(&scope.name));
        let mut entries: Vec<&Entry> = scope.plotted().collect();
        if number > 0 {
            out += "The Pareto front of this pose:\n\n";
            entries.retain(|entry| entry.is_on(scope, "psnr"));
        }
        entries.sort_by(|a, b| ms(a).total_cmp(&ms(b)));
        table(&mut out, scope, &entries);
        if number == 0 {
            steps(&mut out, scope);
        }
        others(&mut out, scope);
    }
    if let Some((path, along)) = results.identity.path.as_ref().zip(results.along.as_ref()) {
        flicker(&mut out, path, along);
    }
    out
}

/// What was found along a path.
fn flicker(out: &mut String, path: &PathRecord, along: &Along) {
    let _ = writeln!(out, "\n## Along {}\n\n{}\n", cell(&path.name), cell(&along.summary));
    *out += "Flicker energy is the mean squared difference of the errors of two consecutive frames. The next column divides it by that of the same way to draw \
        samples at full detail without antialiasing. A pop is a connected area of pixels that changes by more than 32 of 255 beyond the change of the \
        reference; the number of pops counts areas of at least four pixels.\n\n\
        | setting | frames | PSNR, dB | flicker energy | × full detail | largest pop, px | in frame | pops |\n|---|---|---|---|---|---|---|---|\n";
    let rows = |same: bool| along.entries.iter().filter(move |row| row.same_as.is_some() == same);
    for entry in rows(false) {
        let _ = writeln!(
            out,
            "| {}{} | {} | {} | {} | {} | {} | {} | {} |",
            cell(&entry.row),
            if along.default.as_ref() == Some(&entry.row) { " (default)" } else { "" },
            entry.frames,
            entry.psnr_db.map_or("equal".to_owned(), |psnr| format!("{psnr:.2}")),
            three_digits(entry.flicker),
            entry.flicker_times.map_or("–".to_owned(), three_digits),
            entry.pop_px,
            entry.pop_frame.map_or("–".to_owned(), |frame| frame.to_string()),
            entry.pops,
        );
    }
    let mut same = rows(true).peekable();
    if same.peek().is_some() {
        *out += "\nDrawn as another row in all frames:\n\n| setting | drawn as |\n|---|---|\n";
    }
    for entry in same {
        let is_default = along.default.as_ref() == Some(&entry.row);
        let row = if is_default { format!("{} (default)", entry.row) } else { entry.row.clone() };
        let _ = writeln!(
            out,
            "| {} | {} |",
            cell(&row),
            cell(entry.same_as.as_deref().unwrap_or_default())
        );
    }
    refused(out, &along.refused);
}

fn ms(entry: &Entry) -> f64 {
    entry.gpu_ms.map_or(f64::INFINITY, |time| time.median)
}

/// Text of a cell of a table.
pub(super) fn cell(text: &str) -> String {
    text.split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
        .replace('|', "\\|")
        .replace('<', "&lt;")
        .replace('[', "\\[")
}

fn table(out: &mut String, scope: &Scope, entries: &[&Entry]) {
    *out += "| | setting | GPU, ms | PSNR, dB | SSIM | FLIP | max error | hole pixels | leak pixels | silhouette IoU | depth error, median / max | normal error, median |\n\
        |---|---|---|---|---|---|---|---|---|---|---|---|\n";
    for entry in entries {
        let Some(metrics) = &entry.metrics.others else { continue };
        let time = entry.gpu_ms.map_or("–".to_owned(), |time| {
            let [low, median, high] = [time.low, time.median, time.high].map(three_digits);
            format!("{median} ({low}–{high})")
        });
        let depth = metrics
            .depth
            .map_or("–".to_owned(), |depth| format!("{:.1e} / {:.1e}", depth.median, depth.max));
        let normal =
            metrics.normal_deg.map_or("–".to_owned(), |normal| format!("{:.2}°", normal.median));
        let psnr = entry.psnr_db.map_or("equal".to_owned(), |psnr| format!("{psnr:.2}"));
        let _ = writeln!(
            out,
            "| {} | {}{} | {time} | {psnr} | {:.4} | {:.4} | {} | {} | {} | {:.4} | {depth} | {normal} |",
            if entry.is_on(scope, "psnr") { "●" } else { "" },
            cell(&entry.row),
            if scope.default.as_ref() == Some(&entry.row) { " (default)" } else { "" },
            metrics.ssim,
            metrics.flip,
            metrics.max_error,
            metrics.coverage.holes,
            metrics.coverage.leaks,
            metrics.coverage.silhouette_iou,
        );
    }
}

fn steps(out: &mut String, scope: &Scope) {
    if scope.steps.is_empty() {
        return;
    }
    *out += "\nSteps along the Pareto front:\n\n| from | to | time | time for each decibel |\n|---|---|---|---|\n";
    for step in &scope.steps {
        let _ = writeln!(
            out,
            "| {:.2} dB | {:.2} dB | × {} | {} |",
            step.from_db,
            step.to_db,
            three_digits(step.times),
            step.times_per_db
                .map_or("–".to_owned(), |times| format!("× {}", three_digits(times)))
        );
    }
}

/// Rows that are drawn as others, and rows that are refused.
fn others(out: &mut String, scope: &Scope) {
    let same: Vec<&Entry> = scope.entries.iter().filter(|entry| entry.same_as.is_some()).collect();
    if !same.is_empty() {
        *out += "\nDrawn as another row, and so neither timed nor plotted:\n\n| setting | drawn as | because |\n|---|---|---|\n";
        for entry in same {
            let same_as = entry.same_as.as_deref().unwrap_or_default();
            let _ = writeln!(
                out,
                "| {} | {} | {} |",
                cell(&entry.row),
                cell(same_as),
                cell(&entry.notes.join("; "))
            );
        }
    }
    refused(out, &scope.refused);
}

fn refused(out: &mut String, rows: &[(String, String)]) {
    if rows.is_empty() {
        return;
    }
    *out += "\nRefused by the program:\n\n| setting | reason |\n|---|---|\n";
    for (row, why) in rows {
        let _ = writeln!(out, "| {} | {} |", cell(row), cell(why));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::results::tests::results;

    #[test]
    fn the_page_has_the_summary_all_rows_and_the_reasons() {
        let text = markdown(&results());
        for expected in [
            "From 29.9 dB to 40.0 dB costs 3.06× the time",
            "| reference | the reference |",
            "| ● | fast way | 1.60 (1.55–1.65) | 29.97 |",
            "|  | beaten way |",
            "| ● | good way (default) |",
            "## back & side",
            "| other way | good way | reason 0 |",
            "| gone &lt;way> | too large |",
            "| 29.97 dB | 40.00 dB | × 3.06 | × 1.12 |",
            "## Along fly \\[1]",
            "| good way (default) | 2 | 38.13 | 4.00 | 1.00 | 0 | – | 0 |",
            "| beaten way | 2 | 38.13 | 8.00 | 1.00 | 7 | 4 | 1 |",
            "| other way | good way |",
            "| gone &lt;way> | frame 3: too large |",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
        let columns = text
            .lines()
            .filter(|line| line.starts_with("| ● |"))
            .map(|line| line.matches('|').count());
        assert!(columns.eq([13; 6]), "{text}");
    }
}
