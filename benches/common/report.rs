//! A bench's tables, figures and targets, printed as they come and written to `target/bench/NAME.json`.

use std::process::Command;

use anyhow::Context;
use comfy_table::{CellAlignment, Table, presets};
use serde_json::{Map, Value, json};

pub struct Report {
    name: &'static str,
    adapter: String,
    values: Map<String, Value>,
    tables: Vec<Value>,
    targets: Vec<Value>,
}

/// Bound of a target.
#[derive(Clone, Copy)]
pub enum Bound {
    AtLeast(f64),
    AtMost(f64),
    /// Less than.
    Below(f64),
}

impl Report {
    pub fn new(name: &'static str, adapter: &str) -> Report {
        println!("\n== {name} on {adapter}");
        if super::is_quick() {
            println!("   quick: a smoke check, whose figures mean nothing");
        }
        Report {
            name,
            adapter: adapter.to_owned(),
            values: Map::new(),
            tables: Vec::new(),
            targets: Vec::new(),
        }
    }

    /// A figure for the JSON; `name` carries the unit.
    pub fn value(&mut self, name: &str, value: impl Into<Value>) {
        self.values.insert(name.to_owned(), value.into());
    }

    /// Prints a table, its first column to the left, and keeps it.
    pub fn table(&mut self, title: &str, header: &[&str], rows: &[Vec<String>]) {
        println!("\n{title}\n{}", render(header, rows));
        self.tables.push(json!({ "title": title, "columns": header, "rows": rows }));
    }

    /// Prints whether a target is met; `measured` is `None` where it could not be measured.
    pub fn target(&mut self, what: &str, measured: Option<f64>, bound: Bound, unit: &str) {
        let target = judged(what, measured, bound, unit);
        let (verdict, shown) = (verdict(target["met"].as_bool()), shown(&target));
        let limit = target["target"].as_str().unwrap_or_default();
        println!("{verdict}: {what}: {shown} {unit} (target {limit} {unit})");
        self.targets.push(target);
    }

    /// Writes the JSON.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(self) -> anyhow::Result<()> {
        let file = super::folder().join(format!("{}.json", self.name));
        let written = json!({
            "bench": self.name,
            "quick": super::is_quick(),
            "adapter": self.adapter,
            "machine": machine(),
            "values": self.values,
            "tables": self.tables,
            "targets": self.targets,
        });
        std::fs::write(&file, serde_json::to_vec_pretty(&written)?)
            .with_context(|| file.display().to_string())?;
        println!("\nwrote {}", file.display());
        Ok(())
    }
}

/// A target and what was measured, as the JSON has them.
pub fn judged(what: &str, measured: Option<f64>, bound: Bound, unit: &str) -> Value {
    let (sign, limit, met) = match bound {
        Bound::AtLeast(limit) => ("≥", limit, measured.map(|value| value >= limit)),
        Bound::AtMost(limit) => ("≤", limit, measured.map(|value| value <= limit)),
        Bound::Below(limit) => ("<", limit, measured.map(|value| value < limit)),
    };
    json!({
        "what": what,
        "measured": measured,
        "unit": unit,
        "target": format!("{sign} {}", number(limit)),
        "limit": limit,
        "met": met,
    })
}

/// The measured value of a target, as text. A value that breaks the bound by little has more digits, so that it does not look like the bound.
pub fn shown(target: &Value) -> String {
    let Some(value) = target["measured"].as_f64() else { return "—".to_owned() };
    let text = number(value);
    let is_alike = target["limit"].as_f64().is_some_and(|limit| number(limit) == text);
    if is_alike && target["met"] == false { format!("{value:.6}") } else { text }
}

pub fn verdict(met: Option<bool>) -> &'static str {
    match met {
        Some(true) => "met",
        Some(false) => "NOT MET",
        None => "not measured",
    }
}

pub fn render(header: &[&str], rows: &[Vec<String>]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header);
    table.add_rows(rows);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// A table of Markdown, its first column to the left.
pub fn markdown_table(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut text =
        format!("| {} |\n|---|{}\n", header.join(" | "), "--:|".repeat(header.len() - 1));
    for row in rows {
        text += &format!("| {} |\n", row.join(" | "));
    }
    text
}

/// Three or four significant digits, thousands grouped.
pub fn number(value: f64) -> String {
    let size = value.abs();
    let digits = match size {
        _ if !value.is_finite() => return "—".to_owned(),
        _ if size >= 100.0 || value == value.trunc() => 0,
        _ if size >= 10.0 => 1,
        _ if size >= 1.0 => 2,
        _ => 3,
    };
    let text = format!("{value:.digits$}");
    if size < 10_000.0 {
        return text;
    }
    let mut grouped = String::new();
    for (index, digit) in text.chars().enumerate() {
        if index > 0 && digit.is_ascii_digit() && (text.len() - index).is_multiple_of(3) {
            grouped.push(' ');
        }
        grouped.push(digit);
    }
    grouped.replace("- ", "-")
}

/// Facts besides the program on which the figures depend.
fn machine() -> Value {
    let field = |file: &str, name: &str| {
        let text = std::fs::read_to_string(file).ok()?;
        let line = text.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    json!({
        "cpu": field("/proc/cpuinfo", "model name"),
        "cores": std::thread::available_parallelism().ok().map(usize::from),
        "memory": field("/proc/meminfo", "MemTotal"),
        "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        "version": pointillist::VERSION,
        "commit": git(&["rev-parse", "--short=12", "HEAD"]),
        "changed_since_commit": git(&["status", "--porcelain", "--untracked-files=no"]).map(|text| !text.is_empty()),
        "load_average_1_min": std::fs::read_to_string("/proc/loadavg")
            .ok()
            .and_then(|text| text.split(' ').next()?.parse::<f64>().ok()),
    })
}
