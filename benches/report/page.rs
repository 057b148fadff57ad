//! The report's pages: the same sections as Markdown and as one self-contained HTML page.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use crate::common::report::markdown_table;

/// A part of a section.
pub enum Block {
    Text(String),
    /// Title, columns and rows.
    Table(String, Vec<String>, Vec<Vec<String>>),
    /// An SVG, and its file beside the pages.
    Plot(String, &'static str),
    /// A PNG, its file beside the pages, and what it shows.
    Picture(Vec<u8>, String, String),
    /// A page in a folder beside the pages, and what it shows.
    Link(String, String),
}

pub struct Section {
    pub title: String,
    pub blocks: Vec<Block>,
}

impl Section {
    pub fn new(title: &str) -> Section {
        Section { title: title.to_owned(), blocks: Vec::new() }
    }

    pub fn text(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Text(text.into()));
    }

    pub fn table(&mut self, title: &str, columns: &[&str], rows: Vec<Vec<String>>) {
        let columns = columns.iter().map(|&column| column.to_owned()).collect();
        self.blocks.push(Block::Table(title.to_owned(), columns, rows));
    }

    /// Takes over the tables of a bench's JSON whose titles begin so.
    pub fn tables_of(&mut self, bench: &Value, beginning: &str) {
        for table in bench["tables"].as_array().into_iter().flatten() {
            let title = table["title"].as_str().unwrap_or_default();
            if title.starts_with(beginning) {
                let rows = table["rows"].as_array().into_iter().flatten().map(strings).collect();
                self.blocks.push(Block::Table(title.to_owned(), strings(&table["columns"]), rows));
            }
        }
    }

    pub fn json(&self) -> Value {
        let block = |block: &Block| match block {
            Block::Text(text) => json!({ "text": text }),
            Block::Table(title, columns, rows) => {
                json!({ "title": title, "columns": columns, "rows": rows })
            }
            Block::Plot(_, file) => json!({ "plot": file }),
            Block::Picture(_, file, _) => json!({ "picture": file }),
            Block::Link(file, _) => json!({ "page": file }),
        };
        let blocks: Vec<Value> = self.blocks.iter().map(block).collect();
        json!({ "title": self.title, "blocks": blocks })
    }
}

fn strings(value: &Value) -> Vec<String> {
    let cells = value.as_array().into_iter().flatten();
    cells.map(|cell| cell.as_str().unwrap_or_default().to_owned()).collect()
}

pub fn markdown(title: &str, sections: &[Section]) -> String {
    let mut out = format!("# {title}\n");
    let cell = |text: &String| text.replace('|', "\\|").replace('<', "&lt;");
    for section in sections {
        out += &format!("\n## {}\n", section.title);
        for block in &section.blocks {
            out += &match block {
                Block::Text(text) => format!("\n{}\n", cell(text)),
                Block::Table(title, columns, rows) => {
                    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
                    let rows: Vec<Vec<String>> =
                        rows.iter().map(|row| row.iter().map(cell).collect()).collect();
                    format!("\n{}\n\n{}", cell(title), markdown_table(&columns, &rows))
                }
                Block::Plot(_, file) => format!("\n![{}]({file})\n", section.title),
                Block::Picture(_, file, text) => format!("\n![{text}]({file})\n"),
                Block::Link(file, text) => format!("\n[{text}]({file})\n"),
            };
        }
    }
    out
}

const STYLE: &str = "\
  :root { color-scheme: light dark; --back: #ffffff; --text: #1b1f24; --line: #d0d7de; }
  @media (prefers-color-scheme: dark) { :root { --back: #0d1117; --text: #e6edf3; --line: #30363d; } }
  body { margin: 2rem auto; max-width: 72rem; padding: 0 1rem; background: var(--back); color: var(--text); font: 15px/1.5 system-ui, sans-serif; }
  div.wide { overflow-x: auto; }
  table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; font-variant-numeric: tabular-nums; }
  caption { text-align: left; padding: 0.5rem 0; font-weight: 600; }
  th, td { border-bottom: 1px solid var(--line); padding: 0.25rem 0.7rem; text-align: right; }
  th:first-child, td:first-child { text-align: left; }
  svg, img { max-width: 100%; height: auto; }
";

pub fn html(title: &str, sections: &[Section]) -> String {
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>{0}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{0}</h1>\n",
        escaped(title)
    );
    for section in sections {
        out += &format!("<h2>{}</h2>\n", escaped(&section.title));
        for block in &section.blocks {
            out += &match block {
                Block::Text(text) => format!("<p>{}</p>\n", escaped(text)),
                Block::Table(title, columns, rows) => {
                    let cells = |tag: &str, cells: &[String]| -> String {
                        cells
                            .iter()
                            .map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)))
                            .collect()
                    };
                    let rows: String =
                        rows.iter().map(|row| format!("<tr>{}</tr>\n", cells("td", row))).collect();
                    format!(
                        "<div class=\"wide\"><table><caption>{}</caption>\n<thead><tr>{}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n",
                        escaped(title),
                        cells("th", columns)
                    )
                }
                Block::Plot(svg, _) => format!("<figure>{svg}</figure>\n"),
                Block::Picture(png, _, text) => format!(
                    "<figure><img alt=\"{}\" src=\"data:image/png;base64,{}\"></figure>\n",
                    escaped(text),
                    STANDARD.encode(png)
                ),
                Block::Link(file, text) => {
                    format!("<p><a href=\"{}\">{}</a></p>\n", escaped(file), escaped(text))
                }
            };
        }
    }
    out + "</body>\n</html>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
