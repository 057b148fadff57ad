//! One table of every target, from what the benches before it wrote; `--record` keeps a copy in `benches/results/`.

mod common;

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, ensure};
use common::folder;
use common::report::{markdown_table, number, render, verdict};
use serde_json::{Value, json};

const BENCHES: [&str; 17] = [
    "points",
    "statue",
    "triangles",
    "splats",
    "closed",
    "equal",
    "pull_push",
    "lines",
    "trees",
    "lod",
    "pops",
    "audit",
    "daemon",
    "stream",
    "memory",
    "first",
    "large",
];

fn main() -> anyhow::Result<()> {
    let mut results = Vec::new();
    for name in BENCHES {
        let file = folder().join(format!("{name}.json"));
        match std::fs::read(&file) {
            Ok(bytes) => results.push(
                serde_json::from_slice::<Value>(&bytes)
                    .with_context(|| file.display().to_string())?,
            ),
            Err(_) => println!("!! no results of {name}"),
        }
    }
    let first = results.first().context("no results: run the benches first")?;
    let adapter = first["adapter"].as_str().unwrap_or("unknown").to_owned();
    let date = date();
    let header = ["target", "measured", "asked", ""];
    let rows: Vec<Vec<String>> = results.iter().flat_map(target_rows).collect();
    println!("\n== summary, {adapter}, {date}\n{}", render(&header, &rows));
    let written = json!({ "date": date, "adapter": adapter, "benches": results });
    let text = serde_json::to_vec_pretty(&written)?;
    let table = markdown(&adapter, &date, &results, &rows);
    std::fs::write(folder().join("summary.json"), &text)?;
    std::fs::write(folder().join("summary.md"), &table)?;
    if std::env::args().any(|argument| argument == "--record") {
        let quick = results.iter().any(|result| result["quick"] == true);
        ensure!(!quick, "a smoke check is not recorded: its figures mean nothing");
        let stem = PathBuf::from("benches/results").join(format!("{}-{date}", slug(&adapter)));
        for (extension, content) in [("json", text), ("md", table.into_bytes())] {
            let file = stem.with_file_name(format!(
                "{}.{extension}",
                stem.file_name().unwrap_or_default().to_string_lossy()
            ));
            std::fs::write(&file, content).with_context(|| file.display().to_string())?;
            println!("recorded {}", file.display());
        }
    }
    Ok(())
}

fn target_rows(result: &Value) -> Vec<Vec<String>> {
    let targets = result["targets"].as_array().map(Vec::as_slice).unwrap_or_default();
    targets
        .iter()
        .map(|target| {
            let text = |key: &str| target[key].as_str().unwrap_or_default().to_owned();
            let unit = text("unit");
            vec![
                text("what"),
                target["measured"].as_f64().map_or("—".to_owned(), number) + " " + &unit,
                text("target") + " " + &unit,
                verdict(target["met"].as_bool()).to_owned(),
            ]
        })
        .collect()
}

/// The summary and every table, to read.
fn markdown(adapter: &str, date: &str, results: &[Value], rows: &[Vec<String>]) -> String {
    let machine = &results.first().map_or(Value::Null, |result| result["machine"].clone());
    let fact = |key: &str| match &machine[key] {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let mut text = format!(
        "# {adapter}, {date}\n\n{}, {} cores, {}, {}; version {}, commit {}{}\n\n",
        fact("cpu"),
        fact("cores"),
        fact("memory"),
        fact("system"),
        fact("version"),
        fact("commit"),
        if machine["changed_since_commit"] == true { " with changes" } else { "" },
    );
    text += &markdown_table(&["target", "measured", "asked", ""], rows);
    for result in results {
        text += &format!("\n## {}\n", result["bench"].as_str().unwrap_or_default());
        for table in result["tables"].as_array().map(Vec::as_slice).unwrap_or_default() {
            let strings = |value: &Value| -> Vec<String> {
                let cells = value.as_array().map(Vec::as_slice).unwrap_or_default();
                cells.iter().map(|cell| cell.as_str().unwrap_or_default().to_owned()).collect()
            };
            let header = strings(&table["columns"]);
            let header: Vec<&str> = header.iter().map(String::as_str).collect();
            let rows: Vec<Vec<String>> = table["rows"]
                .as_array()
                .map(Vec::as_slice)
                .unwrap_or_default()
                .iter()
                .map(strings)
                .collect();
            text += &format!("\n{}\n\n", table["title"].as_str().unwrap_or_default());
            text += &markdown_table(&header, &rows);
        }
    }
    text
}

/// Letters, digits and single dashes.
fn slug(adapter: &str) -> String {
    // The driver in brackets repeats what the name says.
    let name = adapter.split('[').next().unwrap_or(adapter).to_lowercase();
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("-")
}

/// Today in UTC, as ISO 8601: H. Hinnant, "chrono-compatible low-level date algorithms".
fn date() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let days = (since.as_secs() / 86_400) as i64 + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year}-{month:02}-{day:02}")
}
