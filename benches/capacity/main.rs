//! How far does it go? Simulates clusters of up to 1,000 workers and daemons with 100,000 clients, and prints beside it what was measured.
//!
//! Nothing is drawn: the program's own queue, desk and pacing decide, and costs are recorded ones (`measured.json`, from
//! `scripts/capacity.py`, and recorded benches). Results depend on the seed alone. `CAPACITY_RECORD=1` writes the tables into
//! docs/capacity.md.

#[path = "../common/mod.rs"]
mod common;
mod interactive;
mod measured;
mod workers;

use anyhow::Context;
use common::report::markdown_table;
use measured::Measured;

const PAGE: &str = "docs/capacity.md";
const BEGIN: &str = "<!-- tables of `make capacity` -->\n";
const END: &str = "<!-- end of tables -->\n";

/// A table with its title.
pub struct Section {
    title: String,
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

impl Section {
    /// Prints the table.
    pub fn shown(self) -> Section {
        println!("\n{}\n{}", self.title, common::report::render(&self.header, &self.rows));
        self
    }

    fn markdown(&self) -> String {
        format!("{}\n\n{}\n", self.title, markdown_table(&self.header, &self.rows))
    }
}

fn main() -> anyhow::Result<()> {
    let measured = Measured::read()?;
    let mut text = String::new();
    let parts = [
        ("Films", workers::sections(&measured)),
        ("Frames for clients", interactive::sections(&measured)),
    ];
    for (title, sections) in parts {
        text += &format!("### {title}\n\n");
        for section in sections {
            text += &section.markdown();
        }
    }
    if std::env::var("CAPACITY_RECORD").is_ok_and(|value| value == "1") {
        let page = std::fs::read_to_string(PAGE).context(PAGE)?;
        let (before, rest) = page.split_once(BEGIN).context("the page has no place for tables")?;
        let (_, after) = rest.split_once(END).context("the tables of the page have no end")?;
        std::fs::write(PAGE, format!("{before}{BEGIN}\n{text}{END}{after}")).context(PAGE)?;
        println!("wrote {PAGE}");
    }
    Ok(())
}

/// A share in percent.
pub fn percent(share: f64) -> String {
    format!("{} %", common::report::number(100.0 * share))
}

/// The difference of a simulated value from a measured one.
pub fn difference(simulated: f64, measured: f64) -> String {
    format!("{:+.0} %", 100.0 * (simulated / measured - 1.0))
}

pub const SECOND: u64 = 1_000_000_000;

/// Nanoseconds.
pub fn ns(ms: f64) -> u64 {
    (ms * 1e6) as u64
}
