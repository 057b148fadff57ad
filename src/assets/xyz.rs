//! Reader for text point clouds: XYZ, PTS, CSV, TSV, TXT.
//!
//! Rows are streamed once. Columns beyond x, y, z are kept as they are until the end, because their
//! meaning follows from a header line that names them, or else from their number and from what all
//! their rows hold ([`layout`]):
//!
//! | columns | meaning |
//! |---|---|
//! | 3 | x y z |
//! | 4 | x y z intensity |
//! | 6 | x y z and colour (whole numbers 0..=255) or normal (anything else) |
//! | 7 | x y z intensity r g b (PTS), or x y z r g b intensity where that alone fits |
//! | 9 | x y z, colour and normal in either order |
//!
//! Other numbers of columns are read group by group in the same way. Blanks, tabs, commas and
//! semicolons separate columns. Where a header names columns between tabs, commas or semicolons, blanks are part of a
//! column, and so are separators between double quotes. Where semicolons or such tabs separate, or blanks do and x, y and z
//! have a comma each, the comma is the decimal sign. Lines that begin with `#` or `//` are comments; a first one
//! that names x, y and z is a header. A line with one whole number is a count of points, as PTS has it.

mod layout;

use std::io::BufRead;
use std::path::Path;

use glam::DVec3;

use super::points::{self, Lines, malformed, quote, skipped_warning};
use super::{Asset, AssetError, Geometry, PointCloud, ReadOptions};
use layout::Kept;

/// Bytes of a point's attributes beside its position.
const ATTRIBUTE_BYTES: u64 = 24;
/// More columns than this are no point cloud.
const MAX_COLUMNS: usize = 64;

/// Reads a text point cloud.
///
/// # Errors
/// I/O, a token that is no number where one belongs (with line and column), rows of different
/// lengths, no point at all, or more than the options allow.
pub fn read(path: &Path, name: &str, options: &ReadOptions) -> Result<Asset, AssetError> {
    read_from(points::open(path, name, options)?, name, options)
}

/// Like [`read`], from a stream. At most [`ReadOptions::max_decompressed_bytes`] are read.
///
/// # Errors
/// See [`read`].
pub fn read_from(
    reader: impl BufRead,
    name: &str,
    options: &ReadOptions,
) -> Result<Asset, AssetError> {
    let mut lines = Lines::new(reader, name, options);
    let mut table = Table::default();
    let mut meter = options.admission.meter(name);
    loop {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else { break };
        table.line(line, number, name)?;
        let count = table.positions.len() as u64;
        points::check_count(name, count, options)?;
        meter.reach(count * table.row_bytes())?;
    }
    // Columns become attributes while they are still there.
    options.admission.grow(name, table.positions.len() as u64 * ATTRIBUTE_BYTES)?;
    options.progress.report(1.0);
    table.finish(name)
}

/// Separator of columns, found in the header or in the first line that is no comment.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Delimiter {
    Blank,
    /// Under a header that tabs separate, too.
    Tab,
    Comma,
    Semicolon,
    BlankDecimalComma,
}

impl Delimiter {
    /// The separator of a line. Tabs without a header are blanks.
    fn of(line: &str) -> Self {
        // Blanks keep numbers apart that have a comma each: "1,5 2,0 3,25".
        let decimal = |word: &&str| {
            let halves = word.split_once(',');
            halves.is_some_and(|(a, b)| a.parse::<i64>().is_ok() && b.parse::<u64>().is_ok())
        };
        let coordinates = line.split_ascii_whitespace().take(3).filter(decimal).count();
        let has = |separator: char| line.split('"').step_by(2).any(|bare| bare.contains(separator));
        if has(';') {
            Self::Semicolon
        } else if coordinates == 3 {
            Self::BlankDecimalComma
        } else if has(',') {
            Self::Comma
        } else {
            Self::Blank
        }
    }

    /// The columns of a line. A separator at the end adds none.
    fn columns(self, line: &str, are_whole: bool) -> Vec<&str> {
        let mut columns = Vec::new();
        self.split(line, are_whole, &mut |column| columns.push(column));
        columns.pop_if(|last| last.is_empty());
        columns
    }

    /// Calls `take` with every column's text, blanks trimmed; a separator at the end adds an empty one. Between commas and semicolons,
    /// blanks separate columns too, unless columns are whole: then they may have blanks, and separators in quotes.
    fn split<'l>(self, line: &'l str, are_whole: bool, take: &mut impl FnMut(&'l str)) {
        let separator = match self {
            Self::Blank | Self::BlankDecimalComma => {
                return line.split_ascii_whitespace().for_each(take);
            }
            Self::Tab => '\t',
            Self::Comma => ',',
            Self::Semicolon => ';',
        };
        if are_whole && !line.contains('"') {
            return line.split(separator).for_each(|column| take(column.trim()));
        }
        if are_whole {
            // Quotes enclose a column that begins with one. In others they are text, as in 5".
            let (mut is_begin, mut has_quotes, mut is_open) = (true, false, false);
            let ends = |letter: char| {
                has_quotes |= is_begin && letter == '"';
                is_open ^= has_quotes && letter == '"';
                let is_end = letter == separator && !is_open;
                is_begin = is_end || is_begin && letter.is_ascii_whitespace();
                has_quotes &= !is_end;
                is_end
            };
            return line.split(ends).for_each(|column| take(column.trim()));
        }
        for piece in line.split(separator) {
            let mut words = piece.split_ascii_whitespace();
            take(words.next().unwrap_or(""));
            words.for_each(&mut *take);
        }
    }

    /// A column as a number; one that is empty is missing, which is not a number but no error.
    fn number(self, token: &str) -> Option<f64> {
        let token = token.trim_matches('"');
        if token.is_empty() {
            return Some(f64::NAN);
        }
        match token.parse() {
            Ok(value) => Some(value),
            Err(_) if self == Self::Comma || self == Self::Blank => None,
            Err(_) => token.replacen(',', ".", 1).parse().ok(),
        }
    }
}

/// The rows so far.
#[derive(Default)]
struct Table {
    positions: Vec<DVec3>,
    /// Kept columns, each as long as `positions`.
    extras: Vec<Vec<f64>>,
    /// Each kept column, when a header names them.
    named: Option<Vec<Kept>>,
    /// Whether tabs separate the names of the header.
    has_tabs: bool,
    /// Whether columns are whole between tabs, commas or semicolons, as in the header.
    are_whole: bool,
    /// For each column of the file where it goes: 0, 1, 2 for x, y, z, then `extras`.
    targets: Vec<Option<usize>>,
    delimiter: Option<Delimiter>,
    /// Sum of the counts that PTS announces.
    announced: Option<u64>,
    rows: u64,
    not_finite: u64,
    /// One row by target.
    row: Vec<f64>,
}

impl Table {
    /// Bytes of a row that is kept.
    fn row_bytes(&self) -> u64 {
        24 + 8 * self.extras.len() as u64
    }

    fn line(&mut self, line: &str, number: u64, name: &str) -> Result<(), AssetError> {
        let text = line.trim();
        if text.is_empty() {
            return Ok(());
        }
        if let Some(comment) = text.strip_prefix("//").or_else(|| text.strip_prefix('#')) {
            if self.targets.is_empty() {
                self.header(comment.trim_start_matches(['/', '#', ' ', '\t']));
            }
            return Ok(());
        }
        if self.delimiter.is_none() {
            if self.targets.is_empty() && self.header(line) {
                return Ok(());
            }
            if let Ok(count) = text.parse::<u64>() {
                self.announced = Some(self.announced.unwrap_or(0).saturating_add(count));
                return Ok(());
            }
            self.start(line, number, name)?;
        }
        let row = if self.delimiter == Some(Delimiter::Tab) { line } else { text };
        self.data(row, number, name)
    }

    /// Takes a line as the header if it names x, y and z.
    fn header(&mut self, line: &str) -> bool {
        let (text, delimiter) = (line.trim(), Delimiter::of(line));
        // Blanks beside commas separate columns, too, where no whole ones name a position.
        let ways =
            [(line, Delimiter::Tab, true), (text, delimiter, true), (text, delimiter, false)];
        let found = ways.into_iter().find_map(|(line, delimiter, are_whole)| {
            let columns = delimiter.columns(line, are_whole).into_iter();
            let roles: Vec<Kept> = columns.map(Kept::named).collect();
            let position = layout::position(&roles).filter(|_| roles.len() <= MAX_COLUMNS)?;
            Some((delimiter == Delimiter::Tab, are_whole, roles, position))
        });
        let Some((has_tabs, are_whole, roles, position)) = found else { return false };
        (self.has_tabs, self.are_whole) = (has_tabs, are_whole);
        let mut named: Vec<Kept> = Vec::new();
        self.targets = roles
            .iter()
            .enumerate()
            .map(|(column, role)| match position.iter().position(|&axis| axis == column) {
                Some(axis) => Some(axis),
                // A role, or a field, that appears twice is taken from its first column.
                None if !role.role.is_position() && !named.contains(role) => {
                    named.push(role.clone());
                    Some(2 + named.len())
                }
                None => None,
            })
            .collect();
        self.extras = vec![Vec::new(); named.len()];
        self.named = Some(named);
        true
    }

    /// Fixes separator and number of columns at the first row.
    fn start(&mut self, line: &str, number: u64, name: &str) -> Result<(), AssetError> {
        let (mut by_tabs, columns) = (0_usize, self.targets.len());
        Delimiter::Tab.split(line, true, &mut |_| by_tabs += 1);
        // Other numbers of tabs align columns. One may end the row.
        let has_tabs = self.has_tabs && (columns..=columns + 1).contains(&by_tabs);
        let delimiter = if has_tabs { Delimiter::Tab } else { Delimiter::of(line) };
        self.delimiter = Some(delimiter);
        if self.targets.is_empty() {
            let columns = delimiter.columns(line.trim(), false).len();
            if !(3..=MAX_COLUMNS).contains(&columns) {
                return Err(malformed(
                    name,
                    format!("line {number}"),
                    format!("has {columns} columns; a point needs at least x, y and z"),
                ));
            }
            self.targets = (0..columns).map(Some).collect();
            self.extras = vec![Vec::new(); columns - 3];
        }
        self.row = vec![0.0; 3 + self.extras.len()];
        Ok(())
    }

    fn data(&mut self, line: &str, number: u64, name: &str) -> Result<(), AssetError> {
        let delimiter = self.delimiter.unwrap_or(Delimiter::Blank);
        let (mut column, mut bad, mut is_last_empty) = (0, None, false);
        let (targets, row, named) = (&self.targets, &mut self.row, self.named.as_deref());
        let is_optional = |target: usize| {
            let kept = named.zip(target.checked_sub(3)).and_then(|(named, at)| named.get(at));
            kept.is_some_and(Kept::is_optional)
        };
        delimiter.split(line, self.are_whole, &mut |token| {
            if let Some(&Some(target)) = targets.get(column) {
                match delimiter.number(token) {
                    Some(value) => row[target] = value,
                    // Columns that nobody asked for may hold text.
                    None if is_optional(target) => row[target] = f64::NAN,
                    None => bad = bad.or(Some((column, token))),
                }
            }
            column += 1;
            is_last_empty = token.is_empty();
        });
        // A separator at the end of a row adds no column.
        column -= usize::from(is_last_empty && column == targets.len() + 1);
        if let Some((column, token)) = bad {
            let place = format!("line {number}, column {}", column + 1);
            return Err(malformed(name, place, format!("{} is not a number", quote(token))));
        }
        if column != targets.len() {
            if column == 1
                && let Ok(count) = line.parse::<u64>()
            {
                self.announced = Some(self.announced.unwrap_or(0).saturating_add(count));
                return Ok(());
            }
            let reason = format!("has {column} columns, the rows before have {}", targets.len());
            return Err(malformed(name, format!("line {number}"), reason));
        }
        self.rows += 1;
        let position = DVec3::new(self.row[0], self.row[1], self.row[2]);
        if !position.is_finite() {
            self.not_finite += 1;
            return Ok(());
        }
        self.positions.push(position);
        for (column, &value) in self.extras.iter_mut().zip(&self.row[3..]) {
            column.push(value);
        }
        Ok(())
    }

    fn finish(self, name: &str) -> Result<Asset, AssetError> {
        if self.positions.is_empty() {
            return Err(malformed(
                name,
                "file",
                match self.rows {
                    0 => "holds no points".to_owned(),
                    rows => format!("none of its {rows} points is finite"),
                },
            ));
        }
        let mut warnings = Vec::new();
        if let Some(count) = self.announced.filter(|&count| count != self.rows) {
            warnings.push(format!("announces {count} points and holds {}", self.rows));
        }
        warnings.extend(skipped_warning(self.not_finite, "no finite position"));
        let roles = match self.named {
            Some(named) => named,
            None => layout::by_content(&self.extras),
        };
        let cloud = layout::cloud(self.positions, self.extras, &roles, &mut warnings);
        let mut asset = Asset::single("xyz", name, Geometry::Points(cloud));
        asset.warnings = warnings;
        Ok(asset)
    }
}

#[cfg(test)]
mod tests;
