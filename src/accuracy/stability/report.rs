//! The report as a table, in plain text and in Markdown.

use std::collections::BTreeSet;
use std::fmt;

use comfy_table::{CellAlignment, Table, TableStyle, presets};

use super::super::steady::SIZE;
use super::{Compared, Row, Stability};

const HEADER: [&str; 14] = [
    "splats",
    "regular",
    "unbounded",
    "ours",
    "bound",
    "of it",
    "exact",
    "bound",
    "of it",
    "difference",
    "naive",
    "paper",
    "NaN, ∞",
    "verdict",
];

const SCENES: [&str; 8] =
    ["scene", "views", "refused", "NaN", "changed", "allowed", "unsteady", "verdict"];

const LEGEND: &str = "\
regular: splats entirely in front of the camera plane, which alone have an outline to judge.
Worst error of an outline in px: edges of its box, centre, and the outline itself in 16 directions, within ±2^20 px.
ours: the shaders' perspective filter, run on the adapter; boxes are judged in whole pixels. exact: kernel coordinates of the shaders' exact
filter at 16 points of the outline, carried back to the image; – where every disk is too thin for f32 pixel coordinates to tell.
bound: the largest of the splats' bounds from rounding analysis; of it: the largest error over its own splat's bound. unbounded: splats with an error
for which the analysis gives no bound within ±2^20 px; that error is not judged.
difference: the dual conic with V as a difference of squares. naive: the dual conic formed as it stands.
paper: Zwicker et al. 2004 by the inverse; in brackets what its condition number discards. × n: splats with NaN or ∞.
";

fn px(value: f64) -> String {
    if value == 0.0 { "0".into() } else { format!("{value:.1e}") }
}

fn compared(of: &Compared) -> String {
    match of.not_finite {
        0 => px(of.worst_px),
        n => format!("{} × {n}", px(of.worst_px)),
    }
}

fn cells(row: &Row) -> [String; HEADER.len()] {
    let (ours, exact) = (row.ours(), row.ours_exact);
    let discarded = match row.paper_discarded {
        0 => String::new(),
        n => format!(" ({n})"),
    };
    let judged = |text: String| if exact.bound_px > 0.0 { text } else { "–".into() };
    let verdict = match (row.holds, row.misclassified) {
        (true, _) => "holds".to_owned(),
        (false, 0) => "BROKEN".to_owned(),
        (false, n) => format!("BROKEN, {n} on the wrong side"),
    };
    [
        row.class.clone(),
        row.regular.to_string(),
        row.unbounded.to_string(),
        px(ours.worst_px),
        px(ours.bound_px),
        format!("{:.2}", ours.worst_share),
        judged(px(exact.worst_px)),
        judged(px(exact.bound_px)),
        judged(format!("{:.2}", exact.worst_share)),
        compared(&row.dual_difference),
        compared(&row.dual_naive),
        compared(&row.paper) + &discarded,
        row.ours_not_finite.to_string(),
        verdict,
    ]
}

impl Stability {
    fn table(&self, style: TableStyle) -> Table {
        let mut table = Table::new();
        table.load_style(style).set_header(HEADER);
        for row in &self.rows {
            table.add_row(cells(row));
        }
        for column in table.column_iter_mut().skip(1).take(HEADER.len() - 2) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        table
    }

    /// Scenes as rows; `None` where none were drawn.
    fn scenes(&self, style: TableStyle) -> Option<Table> {
        let mut table = Table::new();
        table.load_style(style).set_header(SCENES);
        for found in &self.scenes {
            let with = |(settings, count): (&String, &u64)| format!("{settings} × {count}");
            let broken: Vec<String> = found.broken_with.iter().map(with).collect();
            let verdict = match broken.as_slice() {
                [] if found.views == 0 => "every view was refused".to_owned(),
                [] => "holds".to_owned(),
                broken => format!("BROKEN: {}", broken.join(", ")),
            };
            table.add_row([
                found.scene.clone(),
                found.views.to_string(),
                found.refused.values().sum::<u64>().to_string(),
                found.not_finite.to_string(),
                found.worst.changed.to_string(),
                found.worst.allowed.to_string(),
                found.unsteady.to_string(),
                verdict,
            ]);
        }
        for column in table.column_iter_mut().skip(1).take(SCENES.len() - 2) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        (!self.scenes.is_empty()).then_some(table)
    }

    /// What the table of scenes means, and why views were refused.
    fn scenes_legend(&self) -> String {
        let [width, height] = SIZE;
        let settings = self.scenes.iter().map(|found| found.settings).max().unwrap_or(0);
        let reasons: BTreeSet<&String> =
            self.scenes.iter().flat_map(|found| found.refused.keys()).collect();
        let reasons: Vec<&str> = reasons.into_iter().map(String::as_str).collect();
        let refused = match reasons.as_slice() {
            [] => String::new(),
            reasons => format!("\nrefused: {}.", reasons.join("; ")),
        };
        format!(
            "Random views of {width}×{height} px with up to {settings} settings a scene, 16 views each, each beside a view 0.001 px aside.\nNaN: views with depths that are no numbers or normals that are no unit vectors. changed: pixels whose colour differs by more than 32 of 255, in the pair where that is the largest share of the pixels that its edges explain (allowed). unsteady: pairs with more, or with a change away from every edge.{refused}"
        )
    }

    /// The report as a page of Markdown.
    pub fn markdown(&self) -> String {
        let Stability { adapter, seed, count, .. } = self;
        let legend = LEGEND.trim_end().replace('\n', "  \n");
        let table = self.table(presets::ASCII_MARKDOWN);
        let scenes = self.scenes(presets::ASCII_MARKDOWN).map_or_else(String::new, |scenes| {
            let legend = self.scenes_legend().replace('\n', "  \n");
            format!("\n# Random views of scenes\n\n{legend}\n\n{scenes}\n")
        });
        format!(
            "# Outlines of splats in f32\n\n{count} splats a row, seed {seed}, {adapter}.\n\n{legend}\n\n{table}\n{scenes}"
        )
    }
}

impl fmt::Display for Stability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n\n{LEGEND}adapter: {}\n", self.table(presets::NOTHING), self.adapter)?;
        match self.scenes(presets::NOTHING) {
            Some(scenes) => write!(f, "\n{scenes}\n\n{}\n", self.scenes_legend()),
            None => Ok(()),
        }
    }
}
